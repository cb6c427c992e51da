// @ts-check
// Round sections in polar form: deviations from the mean height, laid about a circle and enlarged alike, each
// in its colour. What was not measured is a gap.
//
// Traits: rounds [{name, index, x, z (lowest and highest of each column), radius}], message.

import { si } from "./format.js";
import { frame, ink } from "./plots.js";

/** @typedef {import("./wire.js").Model} Model */

/**
 * Draw the mean circle, those of the largest deviations, and return where a deviation at an angle lies.
 * @param {CanvasRenderingContext2D} context
 * @param {[number, number]} centre
 * @param {number} r of the mean circle, px
 * @param {string} words of the outer circle
 * @param {number} most deviation of the outer circle
 * @param {string} zero words where the angle is zero
 */
export function ringed(context, [cx, cy], r, words, most, zero) {
  context.font = "12px system-ui, sans-serif";
  for (const part of [-1, 0, 1]) {
    context.strokeStyle = ink(part ? "--grid" : "--faint");
    context.beginPath();
    context.arc(cx, cy, r * (1 + 0.5 * part), 0, 2 * Math.PI);
    context.stroke();
  }
  context.fillStyle = ink("--soft");
  context.fillText(words, cx + 4, cy - 1.5 * r - 3);
  context.fillText(zero, cx + 1.5 * r + 5, cy + 4);
  return (/** @type {number} */ angle, /** @type {number} */ dz) => {
    const d = r * (1 + (0.5 * dz) / most);
    return /** @type {[number, number]} */ ([cx + d * Math.cos(angle), cy - d * Math.sin(angle)]);
  };
}

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const [read, words] = frame(el);
  const canvas = document.createElement("canvas");
  canvas.className = "polar";
  canvas.setAttribute("role", "img");
  el.append(canvas);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));

  function draw() {
    const rounds = /** @type {any[]} */ (model.get("rounds") ?? []);
    words.textContent = rounds.length ? "" : "Draw a round section on the map (G): its heights stand here about a circle.";
    const box = el.getBoundingClientRect();
    const ratio = window.devicePixelRatio || 1;
    canvas.hidden = !rounds.length || box.width < 20;
    read.textContent = "";
    if (canvas.hidden) return;
    canvas.width = Math.round(box.width * ratio);
    canvas.height = Math.round(box.height * ratio);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, box.width, box.height);
    const [cx, cy] = [box.width / 2, box.height / 2 + 16];
    const r = 0.6 * Math.min(cx, box.height - cy);
    const about = rounds.map((one) => {
      const known = one.curve[1].map((/** @type {number | null} */ v, /** @type {number} */ i) => (v === null ? null : (v + one.curve[2][i]) / 2));
      const valid = known.filter((/** @type {number | null} */ v) => v !== null);
      const mean = valid.reduce((/** @type {number} */ s, /** @type {number} */ v) => s + v, 0) / (valid.length || 1);
      const ends = one.curve[1].flatMap((/** @type {number | null} */ v, /** @type {number} */ i) => (v === null ? [] : [v, one.curve[2][i]]));
      return { ...one, mean, pv: Math.max(...ends) - Math.min(...ends), most: Math.max(...ends.map((/** @type {number} */ v) => Math.abs(v - mean))) };
    });
    const most = Math.max(...about.map((one) => one.most)) || 1;
    const at = ringed(context, [cx, cy], r, `+${si(most)}`, most, "+x 0°");
    for (const one of about) {
      context.strokeStyle = ink(`--curve-${one.index % 8}`);
      context.lineWidth = 1.5;
      context.beginPath();
      let joined = false;
      one.curve[0].forEach((/** @type {number} */ x, /** @type {number} */ i) => {
        const v = one.curve[1][i];
        if (v === null || v === undefined) {
          joined = false;
          return;
        }
        for (const z of [v, one.curve[2][i]]) {
          context[joined ? "lineTo" : "moveTo"](...at(x / one.radius, z - one.mean));
          joined = true;
        }
      });
      if (joined && one.curve[1][0] !== null) context.lineTo(...at(0, one.curve[1][0] - one.mean));
      context.stroke();
    }
    read.textContent = about.map((one) => `${one.name}: radius ${si(one.radius)}, P-V ${model.get("is_preview") ? "≈ " : ""}${si(one.pv)}`).join("   ");
    canvas.setAttribute("aria-label", `Polar picture. ${read.textContent}`);
  }

  const watcher = new ResizeObserver(draw);
  watcher.observe(el);
  model.on("change:rounds change:message", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
  return () => watcher.disconnect();
}

export default { render };
