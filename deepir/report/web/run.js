// The report of a run.

function words() {
  document.title = `deepir: ${data.title}, ${data.source}`;
  find("h1").append(make("b", { text: data.title }), make("span", { text: data.source }));
  find("#figures").append(
    ...data.figures.map(([name, value]) =>
      make("div", { class: "figure" }, make("b", { text: value }), make("span", { text: name })),
    ),
  );
  const { severity, sentence, more } = data.verdict;
  find("#verdict").classList.add(severity);
  find("#verdict").append(
    make("p", { text: sentence }),
    make("p", { class: "hint" }, ...withCode(more)),
  );
  const lines = data.messages.length ? data.messages : ["Nothing to object to in this burst."];
  find("#messages").append(
    make("ul", {}, ...lines.map((text) => make("li", { class: kind(text), text }))),
    ...(data.stop_reason ? [make("p", { class: "hint", text: `The solver ${data.stop_reason}.` })] : []),
  );
  if (!data.config) return find("#full").remove();
  find("#config").textContent = data.config;
  find("#metrics").textContent = JSON.stringify(data.metrics, null, 2);
}

/** How a line of the messages is drawn: a warning, a note, or neither. */
const kind = (text) => /^(warning|note)\b/.exec(text)?.[0] ?? "good";

/** Text whose parts in backquotes are typed. */
function withCode(text) {
  return text.split("`").map((text, i) => make(i % 2 ? "code" : "span", { text }));
}

async function start() {
  words();
  choosePalette();
  await Promise.all(
    data.maps.map(async (map) => {
      map.decoded = await unpacked(map);
    }),
  );
  compare();
  data.maps.filter((map) => map.name !== "raw").forEach(card);
  views.forEach((view) => view.show());
  if (data.stages) find("#plots").append(...curves());
  else find("#curves").remove();
  document.documentElement.dataset.ready = "";
}

start();
