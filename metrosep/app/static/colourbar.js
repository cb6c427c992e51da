// @ts-check
// The colour bar: two limits that are dragged; what lies beyond them has the colour of the end.
//
// Traits: range [low, high] (what is drawn), auto_range, limits [low, high] or null (written here),
// colours, moving (written here).

import { colours } from "./colours.js";
import { scaleFor, si, ticks } from "./format.js";
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
  let height = 100;
  /** @type {[number, number]} heights at the bottom and top of the bar */
  let span = [0, 1];
  let frozen = false;

  const limits = () => model.get("limits") ?? model.get("auto_range") ?? model.get("range");
  const toY = (/** @type {number} */ z) => height * (1 - (z - span[0]) / (span[1] - span[0]));
  const toZ = (/** @type {number} */ y) => span[0] + (1 - y / height) * (span[1] - span[0]);

  function move(/** @type {0 | 1} */ end, /** @type {number} */ y) {
    const now = [...limits()];
    const least = (span[1] - span[0]) / height;
    const z = toZ(Math.max(0, Math.min(height, y)));
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
    moved: (_, y) => move(end, y),
    stepped: (dx, dy) => move(end, toY(limits()[end]) + dy - dx),
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
    const width = canvas.width;
    const image = context.createImageData(width, canvas.height);
    const table = colours(model.get("colours"));
    for (let row = 0; row < canvas.height; row += 1) {
      const z = toZ(((row + 0.5) / canvas.height) * height);
      const part = Math.max(0, Math.min(1, (z - range[0]) / (range[1] - range[0])));
      const c = 3 * Math.round(1 + 254 * part);
      for (let i = row * width * 4; i < (row + 1) * width * 4; i += 4) {
        image.data.set([table[c], table[c + 1], table[c + 2], 255], i);
      }
    }
    context.putImageData(image, 0, 0);
    grips.forEach((grip, end) => {
      grip.place(0, toY(range[end]));
      grip.describe(si(range[end]));
    });
    drawLabels();
  }

  function drawLabels() {
    const wide = span[1] - span[0];
    const raw = wide / Math.max(2, height / 60);
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = ([1, 2, 5, 10].find((n) => n * power >= raw) ?? 10) * power;
    const splits = [];
    for (let k = Math.ceil(span[0] / step); k * step <= span[1]; k += 1) splits.push(k * step);
    const [factor, name] = scaleFor(Math.max(...span.map(Math.abs)), "m");
    const texts = ticks(splits, factor);
    unitLabel.textContent = name;
    labels.replaceChildren(...splits.map((z, i) => {
      const label = document.createElement("span");
      label.textContent = texts[i];
      label.style.top = `${toY(z).toFixed(1)}px`;
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
    height = box.height;
    canvas.width = 1;
    canvas.height = Math.round(height);
    draw();
  });
  watcher.observe(track);
  model.on("change:range change:auto_range change:colours change:limits", draw);
  draw();
  return () => watcher.disconnect();
}

export default { render };
