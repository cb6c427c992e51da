// @ts-check
// The colour bar: two limits that are dragged; what lies beyond them has the colour of the end.
//
// Traits: range [low, high] (what is drawn), auto_range, limits [low, high] or null (written here),
// colours, moving (written here).

import { colours } from "./colours.js";
import { places, scaleFor, si, ticks } from "./format.js";
import { makeHandle } from "./handles.js";

/** @typedef {import("./wire.js").Model} Model */

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  el.classList.add("colourbar");
  const canvas = document.createElement("canvas");
  const labels = document.createElement("div");
  labels.className = "colourbar-labels";
  const unitLabel = document.createElement("div");
  unitLabel.className = "colourbar-unit";
  const auto = document.createElement("button");
  auto.type = "button";
  auto.className = "small";
  auto.textContent = "auto";
  auto.title = "Colours over the usual range again";
  const track = document.createElement("div");
  track.className = "colourbar-track";
  track.append(canvas, labels);
  el.replaceChildren(unitLabel, track, auto);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  let length = 100;
  let flat = false; // low values left, where the bar lies below the map of a narrow window
  /** @type {[number, number]} heights at the low and high end of the bar */
  let span = [0, 1];
  let frozen = false;

  const limits = () => model.get("limits") ?? model.get("auto_range") ?? model.get("range");
  const along = (/** @type {number} */ part) => (flat ? part : 1 - part);
  const toPx = (/** @type {number} */ z) => length * along((z - span[0]) / (span[1] - span[0]));
  const toZ = (/** @type {number} */ px) => span[0] + along(px / length) * (span[1] - span[0]);

  function move(/** @type {0 | 1} */ end, /** @type {number} */ px) {
    const now = [...limits()];
    const least = (span[1] - span[0]) / length;
    const z = toZ(Math.max(0, Math.min(length, px)));
    now[end] = end === 0 ? Math.min(z, now[1] - least) : Math.max(z, now[0] + least);
    model.set("limits", now);
    model.save_changes();
    draw();
  }

  function held(/** @type {boolean} */ is) {
    frozen = is;
    model.set("moving", is);
    model.save_changes();
    if (!is) draw();
  }

  const grips = (/** @type {const} */ ([0, 1])).map((end) => makeHandle(track, {
    label: end === 0 ? "Lower end of the colours" : "Upper end of the colours",
    kind: "level",
    moved: (x, y) => move(end, flat ? x : y),
    stepped: (dx, dy) => move(end, toPx(limits()[end]) + (flat ? dx - dy : dy - dx)),
    held,
  }));

  function draw() {
    const range = limits();
    const shown = Boolean(range && range[1] > range[0]);
    el.classList.toggle("empty", !shown);
    auto.disabled = !model.get("limits");
    if (!shown) return;
    if (!frozen) {
      const base = model.get("auto_range") ?? range;
      const room = 0.15 * (Math.max(base[1], range[1]) - Math.min(base[0], range[0]));
      span = [Math.min(base[0], range[0]) - room, Math.max(base[1], range[1]) + room];
    }
    const n = canvas.width * canvas.height; // one of them is 1
    const image = context.createImageData(canvas.width, canvas.height);
    const table = colours(model.get("colours"));
    for (let i = 0; i < n; i += 1) {
      const z = toZ(((i + 0.5) / n) * length);
      const part = Math.max(0, Math.min(1, (z - range[0]) / (range[1] - range[0])));
      const c = 3 * Math.round(1 + 254 * part);
      image.data.set([table[c], table[c + 1], table[c + 2], 255], 4 * i);
    }
    context.putImageData(image, 0, 0);
    grips.forEach((grip, end) => {
      const px = toPx(range[end]);
      grip.place(flat ? px : 0, flat ? 0 : px);
      grip.describe(si(range[end]));
      grip.el.classList.toggle("handle-level", !flat);
      grip.el.classList.toggle("handle-upright", flat);
      grip.el.setAttribute("aria-orientation", flat ? "horizontal" : "vertical");
      grip.el.setAttribute("aria-valuenow", px.toFixed(1));
    });
    drawLabels();
  }

  function drawLabels() {
    const wide = span[1] - span[0];
    const splits = places(span[0], span[1], wide / Math.max(2, length / (flat ? 80 : 60)), "m");
    const [factor, name] = scaleFor(Math.max(...span.map(Math.abs)), "m");
    const texts = ticks(splits, factor);
    unitLabel.textContent = name;
    labels.replaceChildren(...splits.map((z, i) => {
      const label = document.createElement("span");
      label.textContent = texts[i];
      label.style[flat ? "left" : "top"] = `${toPx(z).toFixed(1)}px`;
      return label;
    }));
  }

  auto.addEventListener("click", () => {
    model.set("limits", null);
    model.save_changes();
    draw();
  });
  const watcher = new ResizeObserver(() => {
    const box = track.getBoundingClientRect();
    if (box.height < 20) return;
    flat = box.width > 2 * box.height;
    el.classList.toggle("flat", flat);
    length = flat ? box.width : box.height;
    canvas.width = flat ? Math.round(length) : 1;
    canvas.height = flat ? 1 : Math.round(length);
    draw();
  });
  watcher.observe(track);
  model.on("change:range change:auto_range change:colours change:limits", draw);
  draw();
  return () => watcher.disconnect();
}

export default { render };
