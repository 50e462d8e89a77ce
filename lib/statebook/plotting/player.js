// Shows one frame at a time: a slider for each parameter, a button where it is a film.
// packed: base64 of the gzip of {parts: [line of SVG], frames: [[first part, how many, ...]], axes: [{name, values}],
//        start: [index], seconds: number or null}
(async function (root, packed) {
  if (!root || root.dataset.ready) return;
  root.dataset.ready = "yes";
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  const unpacked = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const data = await new Response(unpacked).json();
  const stage = root.querySelector(".sb-stage");
  const still = stage.querySelector("img");
  const description = still ? still.alt : "";
  const place = data.start.slice();
  const controls = document.createElement("div");
  controls.className = "sb-controls";
  // JupyterLab takes keys for its shortcuts as they pass the document: keep those of the sliders.
  window.addEventListener("keydown", (event) => {
    if (controls.contains(event.target)) event.stopPropagation();
  }, true);

  function show() {
    let number = 0;
    data.axes.forEach((axis, k) => { number = number * axis.values.length + place[k]; });
    const runs = data.frames[number];
    let text = "";
    for (let k = 0; k < runs.length; k += 2) {
      text += data.parts.slice(runs[k], runs[k] + runs[k + 1]).join("\n") + "\n";
    }
    stage.innerHTML = text;
    const drawing = stage.querySelector("svg");
    if (drawing) {
      const state = data.axes.map((axis, k) => axis.name + " = " + axis.values[place[k]]);
      drawing.setAttribute("role", "img");
      drawing.setAttribute("aria-label", description + " (" + state.join(", ") + ")");
    }
  }

  const sliders = data.axes.map((axis, k) => {
    const label = document.createElement("label");
    const value = document.createElement("output");
    const slider = document.createElement("input");
    slider.type = "range";
    slider.min = 0;
    slider.max = axis.values.length - 1;
    slider.step = 1;
    slider.value = place[k];
    slider.setAttribute("aria-label", axis.name);
    function moved() {
      place[k] = Number(slider.value);
      value.textContent = axis.name + " = " + axis.values[place[k]];
      slider.setAttribute("aria-valuetext", String(axis.values[place[k]]));
      show();
    }
    slider.addEventListener("input", moved);
    label.append(value, slider);
    controls.append(label);
    value.textContent = axis.name + " = " + axis.values[place[k]];
    return { slider, moved };
  });

  if (data.seconds) {
    const { slider, moved } = sliders[0];
    const last = Number(slider.max);
    const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    const button = document.createElement("button");
    let timer = null;
    button.type = "button";
    function label() {
      button.textContent = calm ? "step" : timer ? "pause" : "play";
    }
    function step() {
      slider.value = Number(slider.value) >= last ? 0 : Number(slider.value) + 1;
      moved();
      if (!calm && Number(slider.value) >= last) stop();
    }
    function stop() {
      clearInterval(timer);
      timer = null;
      label();
    }
    button.addEventListener("click", () => {
      if (calm) step();
      else if (timer) stop();
      else {
        if (Number(slider.value) >= last) slider.value = 0;
        timer = setInterval(step, (1000 * data.seconds) / last);
        label();
      }
    });
    slider.addEventListener("pointerdown", stop);
    label();
    controls.prepend(button);
  }
  stage.after(controls);
  show();
})
