// How the run went, as curves.

/** The curves that there is something to draw of. */
function curves() {
  return [losses(), heldOut(), motion(), levels(), histogram()].filter((each) => each !== null);
}

/** The stages, each with the number of iterations before it. */
function staged() {
  let before = 0;
  return data.stages.map((stage) => {
    before += stage.loss.length;
    return { ...stage, before: before - stage.loss.length };
  });
}

function losses() {
  const series = staged().map(({ name, loss, before }) => {
    const least = smallest(loss.filter(Number.isFinite));
    const points = loss.map((each, i) => [
      before + i + 1,
      each - least + 1,
      `${name} ${i + 1}: loss ${said(each)}`,
    ]);
    return { name, points: points.filter((_, i) => Number.isFinite(loss[i])) };
  });
  const drawn = series.filter((each) => each.points.length);
  if (!drawn.length) return null;
  return plot("Loss of each stage, less its least", drawn, { x: "iteration", y: "nats", logY: true });
}

function heldOut() {
  const points = staged().flatMap(({ name, held_out, before }) =>
    held_out
      .filter(([, error]) => Number.isFinite(error))
      .map(([i, error]) => [before + i, error, `${name} ${i}: held-out error ${said(error)} ${data.unit}`]),
  );
  return points.length > 1 ? dotted("Held-out error", points, { x: "iteration", y: data.unit }) : null;
}

function motion() {
  const points = data.motion.map(([frame, x, y, turn]) => {
    const label = `frame ${frame}: x ${said(x)}, y ${said(y)} px, turned ${said(turn, 2)}°`;
    return [x, -y, label]; // y is down
  });
  const axes = { x: "x (px)", y: "up (px)", equal: true };
  return points.some(([x, y]) => x || y) ? dotted("Motion of the frame's centre", points, axes) : null;
}

function levels() {
  const points = data.level.map((level, frame) => [
    frame,
    level,
    `frame ${frame}: ${said(level)} ${data.unit}`,
  ]);
  return points.length > 1 ? dotted("Level of each frame", points, { x: "frame", y: data.unit }) : null;
}

function histogram() {
  const { low, high, shares } = data.histogram;
  const series = Object.entries(shares).map(([name, each]) => ({
    name,
    area: true,
    points: each.map((share, i) => {
      const value = low + ((i + 0.5) / each.length) * (high - low);
      return [value, 100 * share, `${name}: ${said(100 * share, 2)} % near ${said(value)} ${data.unit}`];
    }),
  }));
  return plot("Histogram", series, { x: data.unit || "value", y: "% of the pixels" });
}

const dotted = (title, points, axes) => plot(title, [{ name: "", points, dots: true }], axes);
