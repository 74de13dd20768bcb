// The report of a run.

function words() {
  document.title = `deepir: ${data.title}, ${data.source}`;
  find("h1").append(make("b", { text: data.title }), make("span", { text: data.source }));
  find("#figures").append(
    ...data.figures.map(([name, value]) =>
      make("div", { class: "figure" }, make("b", { text: value }), make("span", { text: name })),
    ),
  );
  const good = !data.messages.length;
  const lines = good ? ["Nothing to object to in this burst."] : data.messages;
  find("#verdict").append(
    make("ul", { class: good ? "good" : "warned" }, ...lines.map((text) => make("li", { text }))),
    make("p", { class: "hint", text: `The solver ${data.stop_reason}.` }),
  );
  find("#config").textContent = data.config;
  find("#metrics").textContent = JSON.stringify(data.metrics, null, 2);
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
  find("#plots").append(...curves());
  document.documentElement.dataset.ready = "";
}

start();
