// Maps: unpacked from their levels, coloured, read at a point.

const MISSING = 65535;
const bytes = (text) => Uint8Array.from(atob(text), (each) => each.charCodeAt(0));

/** The levels of a map as deepir/report/html.py packs them: differences along x, high bytes before low ones. */
async function unpacked(map) {
  const stream = new Blob([bytes(map.levels)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const size = map.width * map.height;
  const levels = new Uint16Array(size);
  for (let i = 0; i < size; i++) {
    const before = i % map.width ? levels[i - 1] : 0;
    levels[i] = before + 256 * planes[i] + planes[size + i];
  }
  return levels;
}

/** The value at a point, given as fractions of the width and of the height; NaN where there is none. */
function valueAt(map, point) {
  const x = Math.min(Math.floor(point.x * map.width), map.width - 1);
  const y = Math.min(Math.floor(point.y * map.height), map.height - 1);
  const level = map.decoded[y * map.width + x];
  return level === MISSING ? NaN : map.base + map.step * level;
}

/** The value in words, with no more digits than the map holds, and its unit. */
function reading(map, point) {
  const digits = Math.max(0, Math.min(6, Math.floor(-Math.log10(map.step))));
  return `${said(valueAt(map, point), digits)} ${map.unit}`.trim();
}

/** Paint a map on a canvas: `colours` holds 256 x 3 bytes from `low` to `high`; missing values are clear. */
function paint(canvas, map, colours, low = map.low, high = map.high) {
  canvas.width = map.width;
  canvas.height = map.height;
  const context = canvas.getContext("2d");
  const image = context.createImageData(map.width, map.height);
  const slope = (255 * map.step) / (high - low);
  const start = (255 * (map.base - low)) / (high - low);
  map.decoded.forEach((level, i) => {
    if (level === MISSING) return;
    const shade = 3 * Math.max(0, Math.min(255, Math.round(start + slope * level)));
    image.data.set([colours[shade], colours[shade + 1], colours[shade + 2], 255], 4 * i);
  });
  context.putImageData(image, 0, 0);
}

/** A bar of the colours with the values at its ends, and of what it is. */
function scale(colours, { low, high, unit }, name = "") {
  const canvas = make("canvas", { width: 256, height: 1, "aria-hidden": "true" });
  const bar = {
    width: 256,
    height: 1,
    base: 0,
    step: 1,
    decoded: Uint16Array.from({ length: 256 }, (_, i) => i),
  };
  paint(canvas, bar, colours, 0, 255);
  const end = (value) => make("span", { text: `${said(value)} ${unit}`.trim() });
  return make(
    "div",
    { class: "scale" },
    ...(name ? [make("b", { text: name })] : []),
    end(low),
    canvas,
    end(high),
  );
}
