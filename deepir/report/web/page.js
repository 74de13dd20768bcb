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

find("#theme").addEventListener("click", () => {
  const root = document.documentElement;
  const now =
    root.style.colorScheme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  root.style.colorScheme = now === "dark" ? "light" : "dark";
});
