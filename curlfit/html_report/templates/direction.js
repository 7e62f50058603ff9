moving.direction = (root, data) => {
  const part = parts(root), slider = part("at"), path = part("path"), other = part("other");
  const tell = teller(part("status"));
  const height = path.ownerSVGElement.viewBox.baseVal.height;
  const drawn = points => lineThrough(points, data, height);

  function show(told) {
    const k = Number(slider.value), values = data.values[k];
    path.setAttribute("d", drawn(data.paths[k]));
    other.setAttribute("d", drawn(data.alone[k]));
    values.forEach((value, i) => {
      root.querySelector(`[data-value="${i}"]`).textContent = Number(value.toPrecision(5));
      const bar = root.querySelector(`[data-bar="${i}"]`);
      bar.style.width = `${100 * Math.abs(value) / data.sizes[i]}%`;
    });
    const change = data.changes[k], alone = data.apart[k], chi = data.chi_squared[k];
    let said = data.names.map((name, i) => `${name} = ${Number(values[i].toPrecision(4))}`).join(", ");
    said += change ? `: ${data.what} changes by ${change.text}` : ": the law admits no motion here";
    if (chi !== null) said += `; chi squared ${Number(chi.toPrecision(6))}`;
    if (alone && k !== data.start) said += `. ${data.names[0]} alone: ${alone.text}`;
    slider.setAttribute("aria-valuetext", said);
    if (told) tell(`${said}.`, true);
  }
  slider.addEventListener("input", () => show(true));
  part("back").addEventListener("click", () => { slider.value = data.start; show(true); });
  let before = data.start; // in print the slider is at an end, where the change is visible
  finishedInPrint(
    () => { before = slider.value; slider.value = slider.max; show(false); },
    () => { slider.value = before; show(false); });
  show(false);
};
