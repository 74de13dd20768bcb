// The report of a sweep: a table to sort, and curves.

/** A cell of a metric: the median, and the least and the greatest where they differ. */
function figure(spread, decimals, best) {
  if (!spread) return make("td", { text: "–" });
  const [middle, least, most] = spread.map((each) =>
    decimals === null ? String(+each.toPrecision(3)) : each.toFixed(decimals),
  );
  const range = least === most ? [] : [make("small", { text: ` ${least} to ${most}` })];
  return make("td", { class: best ? "best" : "" }, middle, ...range);
}

/** The runs of a row: each a link to its report, where there is one. */
function runs(row) {
  const done = row.runs.filter((run) => run.done).length;
  const text = (i) => (row.runs.length > 1 ? String(i + 1) : "report");
  const links = row.runs.flatMap(({ link, name }, i) =>
    link ? [" ", make("a", { href: link, title: name, text: text(i) })] : [],
  );
  return make("td", {}, `${done}/${row.runs.length}`, ...links);
}

function bestOf(index) {
  const medians = data.rows.map((row) => row.spreads[index]?.[0]).filter(Number.isFinite);
  if (new Set(medians).size < 2) return null;
  return index === 0 && data.most ? Math.max(...medians) : Math.min(...medians);
}

const columns = [
  ...data.axes.map((name, i) => ({
    name,
    key: (row) => row.values[i],
    cell: (row) => make("td", { text: row.values[i] }),
  })),
  ...data.metrics.map(({ name, decimals }, i) => {
    const best = bestOf(i);
    return {
      name,
      key: (row) => row.spreads[i]?.[0] ?? NaN,
      cell: (row) => figure(row.spreads[i], decimals, row.spreads[i]?.[0] === best),
    };
  }),
  { name: "finished", key: (row) => row.runs.filter((run) => run.done).length / row.runs.length, cell: runs },
];

/** Numbers by size and before words, words by their letters; what is missing comes last, whichever way. */
function order(a, b, way) {
  const [x, y] = [Number(a), Number(b)];
  if (a === b) return 0;
  if (typeof a === "number" && Number.isNaN(x) !== Number.isNaN(y)) return Number.isNaN(x) ? 1 : -1;
  if (Number.isNaN(x) || Number.isNaN(y))
    return way * String(a).localeCompare(String(b), "en", { numeric: true });
  return way * (x - y);
}

function fill(rows) {
  find("tbody").replaceChildren(
    ...rows.map((row) => make("tr", {}, ...columns.map((column) => column.cell(row)))),
  );
}

function sort(heading, column) {
  const down = heading.getAttribute("aria-sort") === "ascending";
  document.querySelectorAll("th").forEach((each) => each.removeAttribute("aria-sort"));
  heading.setAttribute("aria-sort", down ? "descending" : "ascending");
  fill([...data.rows].sort((a, b) => order(column.key(a), column.key(b), down ? -1 : 1)));
}

function table() {
  for (const column of columns) {
    const heading = make("th", { scope: "col" });
    heading.append(make("button", { type: "button", text: column.name, click: () => sort(heading, column) }));
    find("thead tr").append(heading);
  }
  fill(data.rows);
  const repeated = data.rows.some((row) => row.runs.length > 1);
  find("#note").textContent =
    `A heading sorts by its column.${repeated ? " Medians over seeds, with least and greatest." : ""}`;
}

function failures() {
  const lines = data.rows.flatMap((row) => row.runs).filter((run) => run.error);
  find("#failed").hidden = !lines.length;
  find("#failed ul").append(
    ...lines.map((run) => make("li", {}, make("b", { text: run.name }), ` ${run.error}`)),
  );
}

function curves() {
  const y = data.metrics[0].name;
  for (const [x, lines] of Object.entries(data.curves)) {
    const series = lines.map(({ name, points }) => ({
      name,
      dots: true,
      bars: points.map(([, , least, most]) => [least, most]),
      points: points.map(([at, middle]) => [at, middle, `${name} · ${said(at)} ${x}: ${said(middle)}`]),
    }));
    find("#plots").append(plot(`${y} against ${x}`, series, { x, y, logX: x === "seconds" }));
    find("#curves").hidden = false;
  }
}

document.title = data.title;
find("h1").append(make("b", { text: "deepir" }), make("span", { text: data.title.replace(/^deepir /, "") }));
table();
failures();
curves();
document.documentElement.dataset.ready = "";
