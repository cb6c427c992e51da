// @ts-check
// The section from A to B: extremes of each pixel column, two cursors with their differences.
//
// Traits: distance, low, high (arrays, NaN is a gap), length, pv, sq, share_valid, unit, is_preview,
// message; cursors [0..1, 0..1], parts of the length (written here).

import { si, spanned } from "./format.js";
import { frame, gapped, ink, makePlot, pointedAt, uprightHandle } from "./plots.js";
import { typed } from "./wire.js";

/** @typedef {import("./wire.js").Model} Model */

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const [read, words] = frame(el);
  let shown = model.get("cursors") ?? [0.25, 0.75];
  let pointed = "";
  const unit = () => model.get("unit") ?? "m";
  const length = () => model.get("length") ?? 1;

  const plot = makePlot(el, {
    title: "Section: height over the distance from A to B",
    xUnit: unit,
    series: [
      { stroke: () => ink("--line"), width: 1.25 },
      { stroke: () => ink("--line"), width: 1.25 },
    ],
    bands: [{ series: [2, 1], fill: () => ink("--line") }],
    placed: follow,
    pointed(u) {
      const i = pointedAt(u);
      pointed = i < 0 ? "" : `${si(u.data[0][i], unit())}: ${spanned(u.data[1][i], u.data[2][i])}`;
      tell();
    },
  });

  const grips = [0, 1].map((k) => uprightHandle(plot.u, {
    label: `Cursor ${k + 1} of the section`,
    text: String(k + 1),
    value: () => shown[k] * length(),
    put(value) {
      shown = shown.map((/** @type {number} */ v, /** @type {number} */ i) => (i === k ? value / length() : v));
      model.set("cursors", shown);
      model.save_changes();
      follow();
      tell();
    },
  }));

  /** Height at a part of the length: middle of the column there, null in a gap. */
  function heightAt(/** @type {number} */ part) {
    const x = plot.u.data[0];
    if (!x.length) return null;
    const at = plot.u.valToIdx(part * length());
    const [low, high] = [plot.u.data[1][at], plot.u.data[2][at]];
    return low === null || low === undefined ? null : (low + high) / 2;
  }

  function follow() {
    grips.forEach((grip, k) => grip.follow(`${si(shown[k] * length(), unit())}, height ${si(heightAt(shown[k]))}`));
  }

  function tell() {
    const length_ = model.get("length");
    if (length_ === null || length_ === undefined || !plot.u.data[0].length) {
      read.textContent = "";
      return;
    }
    const sign = model.get("is_preview") ? "≈ " : "";
    const [z1, z2] = shown.map(heightAt);
    const dz = z1 === null || z2 === null ? null : z2 - z1;
    const parts = [
      `Δx ${si(Math.abs(shown[1] - shown[0]) * length_, unit())}`,
      `Δz ${sign}${dz === null ? "– (gap)" : si(dz)}`,
      `P-V ${sign}${si(model.get("pv"))}`,
      `Sq ${sign}${si(model.get("sq"))}`,
    ];
    read.textContent = pointed || parts.join("   ");
    read.classList.toggle("preview", Boolean(model.get("is_preview")));
  }

  function update() {
    words.textContent = model.get("message") ?? "";
    const x = typed(model.get("distance"), Float64Array);
    plot.put(x
      ? [Array.from(x), gapped(typed(model.get("low"), Float32Array)), gapped(typed(model.get("high"), Float32Array))]
      : [[], [], []]);
    tell();
  }

  model.on("change:distance change:message", update);
  update();
  return () => plot.destroy();
}

export default { render };
