// @ts-check
// Power spectral density against wavelength with the limit of ISO 10110-8: the line measured, the limit
// dashed, the mean of each band, and bands that are not accepted in their colour.
//
// Traits: wavelength (falling), density, limit, mean (NaN outside the bands), unit (of the density),
// bands [{low, high (wavelengths), ratio, verdict}], verdict, words, message, is_preview.

import { logTick, plain, powers, si } from "./format.js";
import { frame, gapped, ink, makePlot, pointedAt } from "./plots.js";
import { typed } from "./wire.js";

/** @typedef {import("./wire.js").Model} Model */
/** @typedef {{ low: number, high: number, ratio: number, verdict: string }} Band */

const WORDS = /** @type {Record<string, string>} */ ({ accept: "accepted", reject: "rejected", inconclusive: "inconclusive" });

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const [read, words] = frame(el);
  let pointed = "";

  const unit = () => powers(model.get("unit") ?? "");
  /** @returns {Band[]} */
  const bands = () => model.get("bands") ?? [];

  const plot = makePlot(el, {
    title: "Power spectral density against wavelength, with its limit",
    log: true,
    yUnit: () => "",
    yName: "nm² mm",
    series: [
      { stroke: () => ink("--line"), width: 1 },
      { stroke: () => ink("--ink"), width: 1.75, dash: [7, 4] },
      { stroke: () => ink("--line"), width: 3 },
    ],
    behind(u) {
      const box = u.bbox;
      u.ctx.save();
      for (const band of bands()) {
        const [a, b] = [band.low, band.high].map((v) => u.valToPos(v, "x", true));
        const [from, to] = [Math.max(box.left, a), Math.min(box.left + box.width, b)];
        if (!(to > from)) continue;
        u.ctx.fillStyle = ink({ reject: "--bad-back", inconclusive: "--open-back" }[band.verdict] ?? "--band");
        u.ctx.fillRect(from, box.top, to - from - 1, box.height);
      }
      u.ctx.restore();
    },
    pointed(u) {
      const i = pointedAt(u);
      pointed = i < 0 ? "" : at(u.data[0][i], u.data[1][i], u.data[2][i]);
      tell();
    },
  });

  function at(/** @type {number} */ x, /** @type {number | null} */ y, /** @type {number | null} */ limit) {
    const band = bands().find((one) => x >= one.low && x <= one.high);
    const of = limit === null || limit === undefined ? "" : `, limit ${plain(limit, 3)}`;
    return `λ ${si(x)}: ${y === null ? "–" : plain(y, 3)} ${unit()}${of}${band ? `   ${told(band)}, ${WORDS[band.verdict]}` : ""}`;
  }

  function told(/** @type {Band} */ band) {
    return `${logTick(band.low)} to ${logTick(band.high)}: ${plain(band.ratio, 3)} of the limit`;
  }

  function tell() {
    const rest = model.get("words") ?? "";
    const worst = bands().reduce((/** @type {Band | null} */ a, b) => (a && a.ratio >= b.ratio ? a : b), null);
    const verdict = model.get("is_preview") ? "≈" : `${WORDS[model.get("verdict")]}, worst band`;
    read.textContent = pointed || (rest && worst ? `${verdict} ${told(worst)}` : "");
    read.classList.toggle("preview", Boolean(model.get("is_preview")));
    el.title = rest;
  }

  function draw() {
    words.textContent = model.get("message") ?? "";
    const wavelength = typed(model.get("wavelength"), Float64Array);
    if (wavelength?.length) {
      const lines = ["density", "limit", "mean"].map((name) => gapped(typed(model.get(name), Float64Array), true, true));
      plot.put([gapped(wavelength, true, true), ...lines]);
    } else plot.put([[], [], [], []]);
    tell();
  }

  model.on("change:wavelength change:message", draw);
  draw();
  return () => plot.destroy();
}

export default { render };
