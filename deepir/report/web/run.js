// The report of a run.

const palettes = Object.fromEntries(Object.entries(data.palettes).map(([name, text]) => [name, bytes(text)]));
const others = Object.fromEntries(Object.entries(data.others).map(([name, text]) => [name, bytes(text)]));
const byName = Object.fromEntries(data.maps.map((map) => [map.name, map]));
let palette = data.palette;
const views = []; // where a map is shown: {map, box, canvas, readout?, paint}

const coloursOf = (map) => others[map.colours] ?? palettes[palette];

/** Show a point, given as fractions, in every view; null: in none. */
function pointAt(point, aloud = null) {
  for (const view of views) {
    view.cross.hidden = !point;
    if (view.readout) view.readout.textContent = point ? view.words(point) : "\u00a0";
    if (!point) continue;
    view.cross.style.left = `${100 * point.x}%`;
    view.cross.style.top = `${100 * point.y}%`;
  }
  if (aloud && point) find("#said").textContent = aloud.words(point);
}

function place(map, point) {
  return `x ${Math.floor(point.x * map.width)}, y ${Math.floor(point.y * map.height)}`;
}

/** Let a view be pointed at, and moved in by the arrow keys. */
function listen(view) {
  const { box, map } = view;
  const clamp = (value) => Math.max(0, Math.min(1 - 1e-9, value));
  const inside = (event) => {
    const rect = box.getBoundingClientRect();
    return { x: clamp((event.clientX - rect.left) / rect.width), y: clamp((event.clientY - rect.top) / rect.height) };
  };
  box.addEventListener("pointermove", (event) => pointAt(inside(event)));
  box.addEventListener("pointerdown", (event) => pointAt(inside(event)));
  box.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && pointAt(null));
  let at = { x: 0.5, y: 0.5 };
  const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  box.addEventListener("keydown", (event) => {
    if (event.key === "Escape") pointAt(null);
    if (event.target !== box || !(event.key in steps)) return;
    event.preventDefault();
    const [dx, dy] = steps[event.key].map((each) => each * (event.shiftKey ? 10 : 1));
    at = { x: clamp(at.x + dx / map.width), y: clamp(at.y + dy / map.height) };
    pointAt(at, view);
  });
  views.push(view);
}

const cross = () => make("span", { class: "cross", hidden: "", "aria-hidden": "true" });

/** Large pixels stay square, small ones are averaged. */
const sharp = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    target.classList.toggle("pixels", target.clientWidth * devicePixelRatio >= target.width);
  }
});

function compare() {
  const { raw, scene } = byName;
  const [before, after] = [make("canvas", { class: "before" }), make("canvas", { class: "after" })];
  const slider = make("input", { type: "range", min: 0, max: 100, step: 0.5, value: 50, "aria-label": "Raw frame to the left, scene to the right" });
  const mark = cross();
  const box = make("div", { class: "pair" }, after, before, make("span", { class: "handle" }), slider, mark,
    make("span", { class: "tag left", text: "raw frame" }), make("span", { class: "tag right", text: "scene" }));
  box.style.aspectRatio = `${scene.width} / ${scene.height}`;
  box.style.setProperty("--ratio", scene.width / scene.height);
  const readout = make("p", { class: "reading", text: "\u00a0" });
  find("#compare .stage").append(box, readout);
  const split = () => box.style.setProperty("--split", `${slider.value}%`);
  slider.addEventListener("input", split);
  split();
  const kelvin = byName.scene_kelvin;
  const words = (point) => [place(scene, point), `raw ${reading(raw, point)}`, `scene ${reading(scene, point)}`,
    ...(kelvin ? [reading(kelvin, point)] : [])].join(" · ");
  const show = () => {
    const both = find("#same").checked;
    const from = both ? scene : raw;
    paint(before, raw, coloursOf(raw), from.low, from.high);
    paint(after, scene, coloursOf(scene));
    const bars = both ? [[scene, ""]] : [[raw, "raw"], [scene, "scene"]];
    find("#scales").replaceChildren(...bars.map(([map, name]) => scale(coloursOf(map), map, name)));
  };
  find("#same").addEventListener("change", show);
  listen({ map: scene, box, cross: mark, readout, words, show });
  [before, after].forEach((each) => sharp.observe(each));
}

function card(map) {
  const canvas = make("canvas");
  const mark = cross();
  const box = make("div", { class: "map", tabindex: 0, role: "img", "aria-label": `${map.title}; arrow keys read values` }, canvas, mark);
  box.style.aspectRatio = `${map.width} / ${map.height}`;
  const [bar, readout] = [make("div"), make("p", { class: "reading", text: "\u00a0" })];
  const larger = make("button", { type: "button", class: "larger", "aria-pressed": "false", "aria-label": `${map.title}, larger`, text: "⤢" });
  const figure = make("figure", { class: "card" }, make("figcaption", {}, make("span", { text: map.title }), larger), box, bar, readout);
  larger.addEventListener("click", () => larger.setAttribute("aria-pressed", figure.classList.toggle("wide")));
  const words = (point) => `${place(map, point)} · ${reading(map, point)}`;
  const show = () => {
    paint(canvas, map, coloursOf(map));
    bar.replaceChildren(scale(coloursOf(map), map));
  };
  find("#maps").append(figure);
  listen({ map, box, cross: mark, readout, words, show });
  sharp.observe(canvas);
}

function choosePalette() {
  for (const name of Object.keys(palettes)) {
    const input = make("input", { type: "radio", name: "palette", value: name });
    input.checked = name === palette;
    input.addEventListener("change", () => {
      palette = name;
      views.forEach((view) => view.show());
    });
    find("#palette").append(make("label", {}, input, make("span", { text: name })));
  }
}

function words() {
  document.title = `deepir: ${data.title}, ${data.source}`;
  find("h1").append(make("b", { text: data.title }), make("span", { text: data.source }));
  find("#figures").append(...data.figures.map(([name, value]) =>
    make("div", { class: "figure" }, make("b", { text: value }), make("span", { text: name }))));
  const good = !data.messages.length;
  const lines = good ? ["Nothing to object to in this burst."] : data.messages;
  find("#verdict").append(make("ul", { class: good ? "good" : "warned" }, ...lines.map((text) => make("li", { text }))),
    make("p", { class: "hint", text: `The solver ended: ${data.stop_reason}.` }));
  find("#config").textContent = data.config;
  find("#metrics").textContent = JSON.stringify(data.metrics, null, 2);
}

function curves() {
  const into = find("#plots");
  let start = 0;
  const losses = [];
  const errors = [];
  for (const stage of data.stages) {
    const known = stage.loss.filter(Number.isFinite);
    const least = Math.min(...known);
    const first = start;
    const points = stage.loss.map((loss, i) => [first + i + 1, loss - least + 1, `${stage.name} ${i + 1}: loss ${said(loss)}`]);
    losses.push({ name: stage.name, points: points.filter((each) => Number.isFinite(each[1])) });
    for (const [i, error] of stage.held_out) {
      if (Number.isFinite(error)) errors.push([first + i, error, `${stage.name} ${i}: held-out error ${said(error)} ${data.unit}`]);
    }
    start += stage.loss.length;
  }
  const drawn = losses.filter((each) => each.points.length);
  if (drawn.length) into.append(plot("Loss of each stage, less its least", drawn, { x: "iteration", y: "nats", logY: true }));
  if (errors.length > 1) into.append(plot("Held-out error", [{ name: "", points: errors, dots: true }], { x: "iteration", y: data.unit }));
  if (data.motion.length > 1) {
    const points = data.motion.map(([frame, x, y, turn]) => [x, -y, `frame ${frame}: x ${said(x)}, y ${said(y)} px, turned ${said(turn, 2)}°`]);
    into.append(plot("Motion of the frame's centre", [{ name: "", points, dots: true }], { x: "x (px)", y: "up (px)", equal: true }));
  }
  if (data.level.length > 1) {
    const points = data.level.map((level, frame) => [frame, level, `frame ${frame}: ${said(level)} ${data.unit}`]);
    into.append(plot("Level of each frame", [{ name: "", points, dots: true }], { x: "frame", y: data.unit }));
  }
  const { low, high, shares } = data.histogram;
  const series = Object.entries(shares).map(([name, each]) => ({
    name, area: true, points: each.map((share, i) => {
      const value = low + ((i + 0.5) / each.length) * (high - low);
      return [value, 100 * share, `${name}: ${said(100 * share, 2)} % near ${said(value)} ${data.unit}`];
    }),
  }));
  into.append(plot("Histogram", series, { x: data.unit || "value", y: "% of the pixels" }));
}

async function start() {
  words();
  choosePalette();
  await Promise.all(data.maps.map(async (map) => { map.decoded = await unpacked(map); }));
  compare();
  data.maps.filter((map) => map.name !== "raw").forEach(card);
  views.forEach((view) => view.show());
  curves();
  document.documentElement.dataset.ready = "";
}

start();
