// Where maps are shown: before against after, and a card for each; a point is marked and read in all of them.

const palettes = Object.fromEntries(Object.entries(data.palettes).map(([name, text]) => [name, bytes(text)]));
const others = Object.fromEntries(Object.entries(data.others).map(([name, text]) => [name, bytes(text)]));
const byName = Object.fromEntries(data.maps.map((map) => [map.name, map]));
let palette = data.palette;
const views = []; // {map, box, cross, readout, words(point), show()}

const coloursOf = (map) => others[map.colours] ?? palettes[palette];

/** Show a point, given as fractions, in every view; null: in none. */
function pointAt(point, aloud = null) {
  for (const view of views) {
    view.cross.hidden = !point;
    view.readout.textContent = point ? view.words(point) : "\u00a0";
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
  box.addEventListener("pointermove", (event) => pointAt(under(event, box)));
  box.addEventListener("pointerdown", (event) => pointAt(under(event, box)));
  box.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && pointAt(null));
  let at = { x: 0.5, y: 0.5 };
  box.addEventListener("keydown", (event) => {
    if (event.key === "Escape") pointAt(null);
    const next = event.target === box && stepped(event, at, map);
    if (!next) return;
    at = next;
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

/** The raw frame over the scene, as far as the slider says. */
function compare() {
  const { raw, scene } = byName;
  const [before, after] = [make("canvas", { class: "before" }), make("canvas", { class: "after" })];
  const slider = make("input", {
    type: "range",
    min: 0,
    max: 100,
    step: 0.5,
    value: 50,
    "aria-label": `${raw.title} to the left, ${scene.title} to the right`,
  });
  const mark = cross();
  const box = make(
    "div",
    { class: "pair" },
    after,
    before,
    make("span", { class: "handle" }),
    slider,
    mark,
    make("span", { class: "tag left", text: raw.title }),
    make("span", { class: "tag right", text: scene.title }),
  );
  box.style.aspectRatio = `${scene.width} / ${scene.height}`;
  box.style.setProperty("--ratio", scene.width / scene.height);
  const readout = make("p", { class: "reading", text: "\u00a0" });
  find("#compare .stage").append(box, readout);
  const split = () => box.style.setProperty("--split", `${slider.value}%`);
  slider.addEventListener("input", split);
  split();
  const kelvin = byName.scene_kelvin;
  const words = (point) =>
    [
      place(scene, point),
      `raw ${reading(raw, point)}`,
      `scene ${reading(scene, point)}`,
      ...(kelvin ? [reading(kelvin, point)] : []),
    ].join(" · ");
  const show = () => {
    const both = find("#same").checked;
    const from = both ? scene : raw;
    paint(before, raw, coloursOf(raw), from.low, from.high);
    paint(after, scene, coloursOf(scene));
    const bars = both ? { "": scene } : { [raw.title]: raw, [scene.title]: scene };
    find("#scales").replaceChildren(
      ...Object.entries(bars).map(([name, map]) => scale(coloursOf(map), map, name)),
    );
  };
  find("#same").addEventListener("change", show);
  listen({ map: scene, box, cross: mark, readout, words, show });
  [before, after].forEach((each) => sharp.observe(each));
}

/** A map with its scale and the value under the pointer. */
function card(map) {
  const canvas = make("canvas");
  const mark = cross();
  const box = make(
    "div",
    { class: "map", tabindex: 0, role: "img", "aria-label": `${map.title}; arrow keys read values` },
    canvas,
    mark,
  );
  box.style.aspectRatio = `${map.width} / ${map.height}`;
  const [bar, readout] = [make("div"), make("p", { class: "reading", text: "\u00a0" })];
  const larger = make("button", {
    type: "button",
    class: "larger",
    "aria-pressed": "false",
    "aria-label": `${map.title}, larger`,
    text: "⤢",
  });
  const figure = make(
    "figure",
    { class: "card" },
    make("figcaption", {}, make("span", { text: map.title }), larger),
    box,
    bar,
    readout,
  );
  larger.addEventListener("click", () =>
    larger.setAttribute("aria-pressed", figure.classList.toggle("wide")),
  );
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
  choices("#palette", "palette", Object.keys(palettes), palette, (name) => {
    palette = name;
    views.forEach((view) => view.show());
  });
}
