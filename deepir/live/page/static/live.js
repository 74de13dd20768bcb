"use strict";
// Asks for one frame after the other, and tells how it goes.

const RETRY_AFTER = 1000; // ms, where the connection is lost
const ZERO_CELSIUS = 273.15; // K
const chosen = { palette: data.palette, tones: data.tone };
let socket = null;
let seen = 0; // number of the frame that is shown
let isStale = false; // whether it is to be shown again, in another way
let command = null;
let parts = []; // pictures whose status has not come yet
let limits = null; // values, and kelvin if they are known, that the palette begins and ends with
let kelvin = null;
let now = { number: 0 };

/** What each state means, and what to do. */
const STATES = {
  "waiting for motion": [
    "Waiting for motion",
    "Move the camera: the correction is learned from frames that show the same things displaced.",
  ],
  learning: ["Learning", "Keep moving: frames are corrected from the first estimate on."],
  correcting: ["Correcting", "It gets better while the camera moves."],
  holding: ["Holding", "Nothing further is learned."],
  "uncorrected: the maps do not fit": [
    "The maps do not fit",
    "Frames pass as they are until the next estimate. Move the camera.",
  ],
};

function connect() {
  const address = new URL("watch", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  socket = new WebSocket(address);
  socket.addEventListener("open", ask);
  socket.addEventListener("message", (event) => take(event.data));
  socket.addEventListener("close", () => {
    parts = [];
    allow(false);
    if (!now.ended) headline("Connection lost", "deepir has ended, or cannot be reached. Trying again.", "bad");
    setTimeout(connect, RETRY_AFTER);
  });
}

/** Ask for the next frame once the last one is shown; nothing is asked for while the page is hidden. */
function ask() {
  requestAnimationFrame(() => {
    if (socket.readyState !== WebSocket.OPEN) return;
    const number = isStale ? 0 : seen;
    const at = point() && [point().x, point().y];
    socket.send(JSON.stringify({ seen: number, ...chosen, raw: showsRaw(), point: at, command }));
    isStale = false;
    command = null;
  });
}

async function take(part) {
  if (part instanceof Blob) {
    parts.push(part);
    return;
  }
  const [status, pictures] = [JSON.parse(part), parts];
  parts = [];
  if (pictures.length) {
    await showPictures(pictures);
    seen = status.number;
    ({ limits, kelvin } = status);
  }
  tell(status);
  ask();
}

function tell(status) {
  now = status;
  document.documentElement.dataset.frame = status.number;
  if (status.ended) headline("Ended", sentence(`${status.ended}; this is the last frame.`), "still");
  else if (status.state) headline(...(STATES[status.state] ?? [status.state, ""]), status.state.split(":")[0]);
  else headline("Waiting for frames", "None has come yet.", "still");
  text(find("#message"), sentence(status.message ?? ""));
  find("#estimating").hidden = !status.estimating || status.ended !== "";
  text(find("#recorder"), sentence(status.recorder));
  text(find("#recorded"), status.recording ? `(${status.recorded} frames so far)` : "");
  find("#hold").setAttribute("aria-pressed", Boolean(status.holding));
  const record = find("#record");
  record.setAttribute("aria-pressed", status.recording);
  text(record, status.recording ? "Stop" : "Record");
  allow(!status.ended && status.number > 0);
  figures(status);
  ["#low", "#high"].forEach((name, end) => {
    const words = kelvin ? degrees(kelvin[end]) : limits ? valued(limits[end]) : ["dark", "bright"][end];
    text(find(name), words);
  });
  if (status.spot && point()) read(status.spot);
}

/** Change a text only where it differs: screen readers read what changes. */
function text(element, words) {
  if (element.textContent !== words) element.textContent = words;
}

const sentence = (words) => words.charAt(0).toUpperCase() + words.slice(1);

function headline(words, hint, kind) {
  text(find("#headline"), words);
  text(find("#hint"), hint);
  find("#state").dataset.kind = kind;
}

function allow(running) {
  for (const name of ["#hold", "#reset", "#record"]) find(name).disabled = !running;
}

function figures(status) {
  if (!status.number) return;
  const shown = {
    "frames/s": said(status.rate, 0),
    "ms delay": said(status.delay, 1),
    dropped: status.dropped,
    keyframes: status.keyframes,
    estimates: status.estimates,
    rejected: status.rejected,
  };
  for (const [name, value] of Object.entries(shown)) {
    let figure = find(`#figures [data-name="${name}"]`);
    if (!figure) {
      figure = make("div", { class: "figure", "data-name": name }, make("dt", { text: name }), make("dd"));
      find("#figures").append(figure);
    }
    text(figure.querySelector("dd"), String(value));
  }
}

/** A value of a frame with as many digits as the range that is shown is worth, and its unit. */
function valued(value) {
  const span = limits ? limits[1] - limits[0] : 0;
  const digits = span > 0 ? Math.max(0, Math.min(6, 2 - Math.floor(Math.log10(span)))) : undefined;
  return `${said(value ?? NaN, digits)} ${now.unit}`.trim();
}

const degrees = (kelvin) => `${said(kelvin - ZERO_CELSIUS, 1)} °C`;

function read(spot) {
  const warm = spot.kelvin === null ? [] : [degrees(spot.kelvin)];
  const { x, y, raw, corrected } = spot;
  const words = [`x ${x}, y ${y}`, ...warm, `corrected ${valued(corrected)}`, `raw ${valued(raw)}`];
  text(find("#bubble"), warm[0] ?? valued(corrected));
  text(find("#reading"), words.join(" · "));
}

function choose(key, name) {
  chosen[key] = name;
  isStale = true;
  find("#bar").src = `palettes/${chosen.palette}.png`;
  find("#png").href = `snapshot.png?${new URLSearchParams(chosen)}`;
}

text(find("#title"), data.title);
document.title = data.title ? `${data.title} – deepir live` : "deepir live";
const swatch = (name) => [make("img", { src: `palettes/${name}.png`, alt: "" })];
choices("#palettes", "palette", data.palettes, chosen.palette, (name) => choose("palette", name), swatch);
choices("#tones", "tones", data.tones, chosen.tones, (name) => choose("tones", name));
choose("palette", chosen.palette);
slider.addEventListener("input", () => (isStale = true));
find("#hold").addEventListener("click", () => (command = now.holding ? "learn" : "hold"));
find("#record").addEventListener("click", () => (command = now.recording ? "stop" : "record"));
find("#reset").addEventListener("click", () => {
  if (confirm("Forget what was learned, and learn anew?")) command = "reset";
});
connect();
