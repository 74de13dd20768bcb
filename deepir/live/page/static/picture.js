"use strict";
// The picture: the raw frame over the corrected one, as far as the slider says, and the point that is read.

const box = find("#pair");
const slider = find("#slider");
let kept = null; // the point that was clicked, as fractions of the width and of the height
let pointed = null; // the point under the pointer
let size = { width: 1, height: 1 };

const point = () => pointed ?? kept;
const showsRaw = () => slider.value > 0;

function paint(canvas, bitmap) {
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
    canvas.width = bitmap.width;
    canvas.height = bitmap.height;
  }
  canvas.getContext("2d").drawImage(bitmap, 0, 0);
  bitmap.close();
}

/** Show a corrected frame, and the raw one if there is one, at the same time. */
async function showPictures(pictures) {
  const [corrected, raw] = await Promise.all(pictures.map((each) => createImageBitmap(each)));
  size = { width: corrected.width, height: corrected.height };
  box.style.aspectRatio = `${size.width} / ${size.height}`;
  find("#view").style.setProperty("--ratio", size.width / size.height);
  find("#nothing").hidden = true;
  paint(find("#corrected"), corrected);
  if (raw) paint(find("#raw"), raw);
}

function split() {
  box.style.setProperty("--split", `${slider.value}%`);
  box.classList.toggle("whole", !showsRaw());
}

/** Mark the point; its values come with the next answer. */
function mark() {
  const here = point();
  for (const each of [find("#cross"), find("#bubble")]) {
    each.hidden = !here;
    if (!here) continue;
    each.style.left = `${100 * here.x}%`;
    each.style.top = `${100 * here.y}%`;
  }
  find("#bubble").classList.toggle("flip", here?.x > 0.7);
  if (!here) find("#reading").textContent = "\u00a0";
}

function pointAt(here) {
  pointed = here;
  mark();
}

function keep(here) {
  kept = here;
  pointAt(null);
}

slider.addEventListener("input", split);
box.addEventListener("pointermove", (event) => event.pointerType === "mouse" && pointAt(under(event, box)));
box.addEventListener("pointerleave", () => pointAt(null));
box.addEventListener("click", (event) => event.target !== slider && keep(under(event, box)));
box.addEventListener("keydown", (event) => {
  if (event.key === "Escape") keep(null);
  const next = event.target === box && stepped(event, kept ?? { x: 0.5, y: 0.5 }, size);
  if (next) keep(next);
});
/** Large pixels stay square, small ones are averaged. */
new ResizeObserver(() => {
  box.classList.toggle("coarse", box.clientWidth * devicePixelRatio >= 2 * size.width);
}).observe(box);
split();
