// Curves as SVG, with what is under the pointer in words.

const BOX = { width: 420, height: 260, left: 58, right: 12, top: 12, bottom: 40 };

const smallest = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
const largest = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);

/** Round numbers between two ends, about `count` of them; on a log axis 1, 2, 5 of a decade, or powers of ten. */
function ticks(low, high, count, log) {
  if (log) {
    const all = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) {
      for (const each of [1, 2, 5]) all.push(each * 10 ** power);
    }
    const inside = all.filter((each) => each >= low && each <= high);
    const whole = inside.filter((each) => Number.isInteger(+Math.log10(each).toFixed(9)));
    const kept = inside.length <= count + 1 ? inside : whole;
    return kept.filter((_, i) => i % Math.ceil(kept.length / (count + 1)) === 0);
  }
  const raw = (high - low) / count;
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = size * [1, 2, 5, 10].find((each) => each * size >= raw);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(i * step);
  return found;
}

/** A map from values to the page, with a little room at both ends. */
function axis(values, from, to, { log = false, room = 0.04, least = 0 } = {}) {
  const turn = log ? Math.log10 : (each) => each;
  let [low, high] = [smallest(values.map(turn)), largest(values.map(turn))];
  const wanting = Math.max(least - (high - low), high > low ? 0 : log ? 0.1 : Math.abs(low) * 0.1 || 1);
  const pad = wanting / 2 + room * (high - low);
  [low, high] = [low - pad, high + pad];
  const place = (value) => from + ((turn(value) - low) / (high - low)) * (to - from);
  const back = (each) => (log ? 10 ** each : each);
  return { place, low: back(low), high: back(high), log };
}

/**
 * A plot in a card. `series`: [{name, points: [[x, y, label?]], dots?, area?, bars?}], where `bars` has the
 * least and the greatest y of each point; options: x and y (names of the axes), logX, logY, equal (one scale).
 */
function plot(title, series, { x = "", y = "", logX = false, logY = false, equal = false } = {}) {
  const box = { ...BOX };
  const points = series.flatMap((each) => each.points);
  const spread = (i) => largest(points.map((p) => p[i])) - smallest(points.map((p) => p[i]));
  const [wide, high] = [box.width - box.left - box.right, box.height - box.top - box.bottom];
  const perPixel = equal ? Math.max(spread(0) / wide, spread(1) / high) || 1 / high : 0;
  const room = equal ? 0.08 : 0.03;
  const across = axis(
    points.map((p) => p[0]),
    box.left,
    box.left + wide,
    { log: logX, room, least: perPixel * wide },
  );
  const ys = [...points.map((p) => p[1]), ...series.flatMap((each) => each.bars ?? []).flat()];
  const upward = axis(ys, box.top + high, box.top, { log: logY, room, least: perPixel * high });
  const svg = draw("svg", {
    viewBox: `0 0 ${box.width} ${box.height}`,
    tabindex: 0,
    role: "img",
    "aria-label": `${title}; arrow keys read values`,
  });
  axes(svg, box, across, upward, x, y);
  const shown = series.map((each, i) => curve(svg, each, i, across, upward, box));
  const readout = follow(svg, box, shown.flat());
  const named = series.length > 1 ? [legend(series)] : [];
  return make("figure", { class: "card plot" }, make("figcaption", { text: title }), svg, ...named, readout);
}

/** Mark the point nearest to the pointer, or the next by the arrow keys; where what it says is shown. */
function follow(svg, box, points) {
  const readout = make("p", { class: "reading", "aria-live": "polite", text: "\u00a0" });
  const mark = draw("circle", { class: "mark", r: 5, visibility: "hidden" });
  svg.append(mark);
  let at = -1;
  const show = (index) => {
    at = index;
    const [x, y] = points[at]?.at ?? [0, 0];
    dress(mark, { cx: x, cy: y, visibility: at < 0 ? "hidden" : "visible" }, []);
    readout.textContent = points[at]?.text ?? "\u00a0";
  };
  svg.addEventListener("pointerleave", () => show(-1));
  svg.addEventListener("pointermove", (event) => {
    const rect = svg.getBoundingClientRect();
    const x = ((event.clientX - rect.left) / rect.width) * box.width;
    const y = ((event.clientY - rect.top) / rect.height) * box.height;
    const away = points.map((each) => Math.hypot(each.at[0] - x, 0.5 * (each.at[1] - y)));
    show(away.indexOf(smallest(away)));
  });
  svg.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    show(Math.max(0, Math.min(points.length - 1, at + step)));
  });
  return readout;
}

function axes(svg, box, across, upward, x, y) {
  const floor = box.height - box.bottom;
  for (const each of ticks(across.low, across.high, 5, across.log)) {
    const at = across.place(each);
    svg.append(draw("line", { class: "grid", x1: at, x2: at, y1: box.top, y2: floor }));
    svg.append(draw("text", { x: at, y: floor + 15, "text-anchor": "middle", text: said(each) }));
  }
  for (const each of ticks(upward.low, upward.high, 4, upward.log)) {
    const at = upward.place(each);
    svg.append(draw("line", { class: "grid", x1: box.left, x2: box.width - box.right, y1: at, y2: at }));
    svg.append(draw("text", { x: box.left - 6, y: at + 4, "text-anchor": "end", text: said(each) }));
  }
  svg.append(
    draw("text", {
      class: "axis",
      x: (box.left + box.width - box.right) / 2,
      y: box.height - 6,
      "text-anchor": "middle",
      text: x,
    }),
  );
  const middle = (box.top + floor) / 2;
  svg.append(
    draw("text", {
      class: "axis",
      x: 12,
      y: middle,
      "text-anchor": "middle",
      transform: `rotate(-90 12 ${middle})`,
      text: y,
    }),
  );
}

/** Draw one series; where its points are, and what they say. */
function curve(svg, series, index, across, upward, box) {
  const at = series.points.map(([x, y]) => [across.place(x), upward.place(y)]);
  const path = at.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ");
  const colour = `series s${index % 6}`;
  if (series.area) {
    const floor = box.height - box.bottom;
    svg.append(
      draw("polygon", {
        class: `${colour} area`,
        points: `${at[0][0]},${floor} ${path} ${at.at(-1)[0]},${floor}`,
      }),
    );
  }
  svg.append(draw("polyline", { class: colour, points: path }));
  series.bars?.forEach(([low, high], i) =>
    svg.append(
      draw("line", {
        class: colour,
        x1: at[i][0],
        x2: at[i][0],
        y1: upward.place(low),
        y2: upward.place(high),
      }),
    ),
  );
  if (series.dots)
    at.forEach(([x, y]) => svg.append(draw("circle", { class: `${colour} dot`, cx: x, cy: y, r: 3.5 })));
  return series.points.map(([x, y, label], i) => ({
    at: at[i],
    text: label ?? `${series.name ? `${series.name}: ` : ""}${said(x)}, ${said(y)}`,
  }));
}

function legend(series) {
  const keys = series.map((each, i) => make("span", { class: `key s${i % 6}`, text: each.name }));
  return make("p", { class: "legend" }, ...keys);
}
