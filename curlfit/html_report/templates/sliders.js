moving.sliders = (root, data) => {
  const part = parts(root), tell = teller(part("status"));
  const inputs = [...root.querySelectorAll("input")];
  const outputs = [...root.querySelectorAll("output")];
  const path = part("path"), height = path.ownerSVGElement.viewBox.baseVal.height;

  // The step along a slider at its position: as many positions on either side of the fit,
  // closer to one another near it, where residuals are of the size of the noise.
  function stepOf(k) {
    const position = Number(inputs[k].value), steps = data.sliders[k].steps;
    const end = position > 0 ? steps[steps.length - 1] : steps[0];
    return end * (position / data.positions) ** 2;
  }
  // The four steps of a table around a step, with the weights of the cubic through them.
  function cubicAround(steps, step) {
    let first = steps.findIndex(node => node >= step) - 2;
    first = Math.min(Math.max(first, 0), steps.length - 4);
    const places = [first, first + 1, first + 2, first + 3];
    return places.map(place => [place, places.reduce((product, other) => other === place
      ? product : product * (step - steps[other]) / (steps[place] - steps[other]), 1)]);
  }
  function curvesAt(steps) {
    const change = new Array(data.base.length).fill(0);
    const add = (values, weight) => values.forEach((value, i) => { change[i] += weight * value; });
    const shares = steps.map((step, k) => {
      const nodes = data.sliders[k].steps;
      return step === 0 ? 0 : step / (step > 0 ? nodes[nodes.length - 1] : nodes[0]);
    });
    steps.forEach((step, k) => {
      if (step === 0) return;
      const {steps: nodes, changes} = data.sliders[k];
      for (const [place, weight] of cubicAround(nodes, step)) add(changes[place], weight);
    });
    for (const {sliders: [k, l], ends} of data.pairs) {
      const share = shares[k] * shares[l];
      if (share !== 0) add(ends[Number(steps[k] > 0)][Number(steps[l] > 0)], share);
    }
    return data.base.map((value, i) => value === null ? null : value + data.unit * change[i]);
  }
  function valuesAt(steps) {
    const values = [...data.values];
    steps.forEach((step, k) => {
      for (const [place, weight] of data.sliders[k].direction) values[place] += weight * step;
    });
    return values;
  }
  // Chi squared of the model while one slider alone is away from the fit.
  function chiSquaredAt(steps) {
    const away = steps.flatMap((step, k) => step === 0 ? [] : [k]);
    if (away.length > 1) return null;
    if (away.length === 0) return data.chi_squared;
    const {steps: nodes, chi_squared: known} = data.sliders[away[0]];
    return cubicAround(nodes, steps[away[0]])
      .reduce((sum, [place, weight]) => sum + weight * known[place], 0);
  }
  function drawResiduals(name, residuals, unit) {
    const dots = root.querySelector(`[data-residual="${name}"]`);
    const panel = dots.ownerSVGElement.viewBox.baseVal;
    const finite = residuals.filter(value => value !== null);
    const reach = Math.max(...finite.map(Math.abs), 1e-9);
    const [from, to] = [data.t[0], data.t[data.t.length - 1]];
    dots.setAttribute("d", residuals.map((value, i) => {
      if (value === null) return "";
      const u = data.margin + (data.t[i] - from) / (to - from) * (panel.width - 2 * data.margin);
      return `M${u.toFixed(2)} ${(panel.height / 2 * (1 - 0.9 * value / reach)).toFixed(2)}h0`;
    }).join(""));
    const rms = Math.sqrt(finite.reduce((sum, value) => sum + value * value, 0) / finite.length);
    const milli = value => `${Number((1000 * value).toPrecision(3))} m${unit}`;
    root.querySelector(`[data-scale="${name}"]`).textContent =
      `${name}, measured minus computed, over time: up to ${milli(reach)}`;
    return `${milli(rms)} in ${name}`;
  }
  function show(told) {
    const steps = inputs.map((_, k) => stepOf(k));
    const curves = curvesAt(steps), values = valuesAt(steps);
    const drawn = data.drawn.map(([first, last]) => curves.slice(first, last));
    path.setAttribute("d", lineThrough(drawn.length > 1 ? drawn : [data.instants, drawn[0]], data, height));
    const sizes = data.residuals.map(({name, unit, span: [first, last]}) =>
      drawResiduals(name, curves.slice(first, last), unit));
    outputs.forEach((output, k) => {
      const {direction} = data.sliders[k];
      const [[place, weight]] = direction;
      output.textContent = direction.length > 1
        ? `${steps[k] < 0 ? "" : "+"}${Number((weight * steps[k]).toPrecision(3))}`
        : String(Number(values[place].toPrecision(6)));
      inputs[k].setAttribute("aria-valuetext", output.textContent);
    });
    const chi = chiSquaredAt(steps);
    const beyond = data.names.filter((_, i) => {
      const [lower, upper] = data.bounds[i], rounding = 1e-12;
      return lower !== null && values[i] < lower - rounding || upper !== null && values[i] > upper + rounding;
    });
    let said = `Residuals of ${sizes.join(", ")} (rms)`;
    if (chi !== null) said += `; chi squared ${Number(chi.toPrecision(6))}, of the fit ${Number(data.chi_squared.toPrecision(6))}`;
    if (beyond.length) said += `. Beyond its bounds: ${beyond.join(", ")}`;
    tell(`${said}.`, told);
  }
  for (const input of inputs) {
    input.addEventListener("input", () => show(true));
  }
  part("back").addEventListener("click", () => {
    for (const input of inputs) input.value = 0;
    show(true);
  });
  part("data").setAttribute("d", data.data[0].map((along, i) => {
    const across = data.data[1][i];
    const dot = along === null || across === null ? ""
      : lineThrough([[along], [across]], data, height);
    return dot && `${dot}h0`;
  }).join(""));
  show(true);
};
