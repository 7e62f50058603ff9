moving.rests = (root, data) => {
  const part = parts(root), tell = teller(part("status"));
  const slider = part("shown"), button = part("play"), stone = part("stone");
  const number = data.x.length, times = data.t;
  const PACE = 12; // seconds of the throw per second of the animation
  let shown = number, since = 0, sliding = false, alone = false;

  function place(k, time) { // x, y and angle of a draw, linear between its times
    const end = Math.min(time, data.rest[k]);
    let i = 1;
    while (i < times.length - 1 && times[i] < end) i += 1;
    const late = Math.min(times[i], Math.max(data.rest[k], times[i - 1]));
    const span = late - times[i - 1];
    const s = span > 0 ? Math.min((end - times[i - 1]) / span, 1) : 1;
    return ["x", "y", "phi"].map(name => data[name][k][i - 1] * (1 - s) + data[name][k][i] * s);
  }
  function dots(count) {
    let text = "";
    for (let k = 0; k < count; k += 1) {
      const last = data.x[k].length - 1;
      text += `M${data.x[k][last]} ${(data.y[k][last] - data.tee).toFixed(4)}h0`;
    }
    return text;
  }
  function put([x, y, phi]) {
    stone.setAttribute("transform", `translate(${x.toFixed(4)} ${y.toFixed(4)}) rotate(${(phi * 180 / Math.PI).toFixed(2)})`);
  }
  function said() {
    if (!shown) return "No throw yet.";
    const k = shown - 1, last = data.x[k].length - 1, beyond = data.y[k][last] - data.tee;
    const inside = data.inside.slice(0, shown).filter(Boolean).length;
    return `Throw ${shown} of ${number} rests ${Math.abs(beyond).toFixed(2)} m ${beyond < 0 ? "before" : "beyond"} the tee line, ${side(data.x[k][last])}; ${inside} of ${shown} in the house.`;
  }
  function show(count, told) {
    shown = Math.min(Math.max(count, 0), number);
    sliding = false;
    stone.classList.add("resting");
    part("dots").setAttribute("d", dots(shown));
    part("trail").setAttribute("d", "");
    stone.style.display = shown ? "" : "none";
    if (shown) put(place(shown - 1, Infinity));
    slider.value = shown;
    slider.setAttribute("aria-valuetext", said());
    if (told !== undefined) tell(said(), told);
  }
  function trail(k, time) {
    let text = "";
    for (let i = 0; i < times.length && times[i] < time; i += 1) {
      text += `${i ? "L" : "M"}${data.x[k][i]} ${data.y[k][i]}`;
    }
    const [x, y] = place(k, time);
    return text ? `${text}L${x.toFixed(4)} ${y.toFixed(4)}` : "";
  }
  function advance(passed) {
    if (!sliding) {
      if (shown >= number) return pause();
      sliding = true;
      since = Math.max(data.rest[shown] - PACE * 0.8, 0); // the last part of the throw
      stone.style.display = "";
      stone.classList.remove("resting");
    }
    since += passed * PACE;
    if (since >= data.rest[shown] || matchMedia("(prefers-reduced-motion: reduce)").matches) {
      show(shown + 1, false);
      if (alone || shown >= number) pause();
      return;
    }
    put(place(shown, since));
    part("trail").setAttribute("d", trail(shown, since));
  }

  const time = clock(advance);
  function pause() {
    time.stop();
    alone = false;
    button.textContent = "Play";
    show(shown, true);
  }
  function start(one) {
    if (shown >= number) show(0);
    alone = one;
    button.textContent = "Pause";
    time.start();
  }
  function toggle() { if (time.on) pause(); else start(false); }
  button.addEventListener("click", toggle);
  part("next").addEventListener("click", () => { if (time.on) pause(); start(true); });
  slider.addEventListener("input", () => { if (time.on) pause(); show(Number(slider.value), true); });
  spaceToggles(root, toggle);
  let before = number;
  finishedInPrint(() => { before = shown; show(number); }, () => show(before));
  show(number);
};
