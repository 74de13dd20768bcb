"use strict";
// What all pages share: their data, elements made of text and never of markup, and dark or light.

const data = JSON.parse(document.getElementById("data").textContent);
const find = (selector) => document.querySelector(selector);

/** An HTML element with properties (`class`, `text`, attributes) and children. */
function make(tag, properties = {}, ...children) {
  return dress(document.createElement(tag), properties, children);
}

/** The same in SVG. */
function draw(tag, properties = {}, ...children) {
  return dress(document.createElementNS("http://www.w3.org/2000/svg", tag), properties, children);
}

function dress(element, properties, children) {
  for (const [name, value] of Object.entries(properties)) {
    if (name === "text") element.textContent = value;
    else if (typeof value === "function") element.addEventListener(name, value);
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** A number to read: so many digits after the point, or four that count. */
function said(value, digits) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const far = size && (size < 1e-3 || size >= 1e6);
  const plain = far ? value.toExponential(2).replace(/\.?0*e\+?/, "e") : String(+value.toPrecision(4));
  return (digits === undefined ? plain : value.toFixed(digits)).replace("-", "−");
}

/** A fraction of a width or height, kept inside. */
const within = (value) => Math.max(0, Math.min(1 - 1e-9, value));

/** Where an event is in a box: fractions of its width and height. */
function under(event, box) {
  const rect = box.getBoundingClientRect();
  const [x, y] = [(event.clientX - rect.left) / rect.width, (event.clientY - rect.top) / rect.height];
  return { x: within(x), y: within(y) };
}

/** Where an arrow key leads from a point: a pixel on, or ten with Shift; null for another key. */
function stepped(event, { x, y }, { width, height }) {
  const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  if (!(event.key in steps)) return null;
  event.preventDefault();
  const [dx, dy] = steps[event.key].map((each) => each * (event.shiftKey ? 10 : 1));
  return { x: within(x + dx / width), y: within(y + dy / height) };
}

/** Names to choose one of, in a box; `change` is called with it, `picture` gives what stands beside a name. */
function choices(box, key, names, chosen, change, picture = () => []) {
  for (const name of names) {
    const input = make("input", { type: "radio", name: key, value: name, change: () => change(name) });
    input.checked = name === chosen;
    find(box).append(make("label", {}, input, make("span", { text: name }, ...picture(name))));
  }
}

find("#theme").addEventListener("click", () => {
  const root = document.documentElement;
  const now =
    root.style.colorScheme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  root.style.colorScheme = now === "dark" ? "light" : "dark";
});
