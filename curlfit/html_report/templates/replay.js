moving.replay = (root, data) => {
  const part = parts(root), tell = teller(part("status"));
  const t = data.t, first = t[0], last = t[t.length - 1];
  const stones = root.querySelectorAll('[data-part="stone"]');
  const cursors = root.querySelectorAll('[data-part="cursor"]');
  const world = part("world"), slider = part("time"), button = part("play");
  const scale = {phi: 1 / (2 * Math.PI)};
  let now = last;

  function row(time) { // the last row not later than time
    let low = 0, high = t.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (t[middle] <= time) low = middle; else high = middle;
    }
    return low;
  }
  // Cubic interpolation of the rows, with the slope at each from its neighbours.
  function at(values, time) {
    const k = row(time), step = t[k + 1] - t[k], s = step > 0 ? (time - t[k]) / step : 1;
    const slope = i => {
      const a = Math.max(i - 1, 0), b = Math.min(i + 1, t.length - 1);
      return (values[b] - values[a]) / (t[b] - t[a]) * step;
    };
    const a = values[k], b = values[k + 1], u = 1 - s;
    return a * (1 + 2 * s) * u * u + b * s * s * (3 - 2 * s)
      + slope(k) * s * u * u - slope(k + 1) * s * s * u;
  }
  function show(time, told) {
    now = Math.min(Math.max(time, first), last);
    const x = at(data.x, now), y = at(data.y, now), angle = at(data.phi, now) * 180 / Math.PI;
    for (const stone of stones) {
      stone.setAttribute("transform", `translate(${x.toFixed(4)} ${y.toFixed(4)}) rotate(${angle.toFixed(2)})`);
    }
    world.setAttribute("transform", `scale(1 -1) translate(${(-x).toFixed(4)} ${(-y).toFixed(4)})`);
    for (const cursor of cursors) {
      cursor.setAttribute("transform", `translate(${((now - first) / (last - first)).toFixed(4)} 0)`);
    }
    part("now").textContent = now.toFixed(2);
    for (const cell of root.querySelectorAll("[data-value]")) {
      const name = cell.dataset.value;
      cell.textContent = (at(data[name], now) * (scale[name] || 1)).toFixed(3);
    }
    const k = row(now), near = t[k + 1] - now < now - t[k] ? k + 1 : k;
    for (const cell of root.querySelectorAll("[data-residual]")) {
      const found = data.residuals[cell.dataset.residual];
      const value = found && found.values[near];
      cell.textContent = !found ? "" : value === null ? "not measured"
        : `${value > 0 ? "+" : ""}${value} ${found.unit}`;
    }
    slider.value = now;
    const said = `${now.toFixed(1)} s: ${y.toFixed(2)} m from the hack, ${side(x)}, ${at(data.speed, now).toFixed(2)} m/s`;
    slider.setAttribute("aria-valuetext", said);
    if (told !== undefined) tell(said, told);
  }
  const time = clock(passed => {
    show(now + passed * Number(part("speed").value), false);
    if (now >= last) pause();
  });
  function pause() {
    time.stop();
    button.textContent = "Play";
    show(now, true);
  }
  function toggle() {
    if (time.on) return pause();
    if (now >= last) show(first);
    button.textContent = "Pause";
    time.start();
  }
  button.addEventListener("click", toggle);
  slider.addEventListener("input", () => show(Number(slider.value), time.on ? undefined : true));
  spaceToggles(root, toggle);
  root.addEventListener("keydown", event => {
    const by = {ArrowRight: 1, ArrowLeft: -1}[event.key];
    if (!by || event.target !== root) return;
    event.preventDefault();
    show(now + by * (last - first) / 100, true);
  });
  let before = last;
  finishedInPrint(() => { before = now; show(last); }, () => show(before));
  show(last);
};
