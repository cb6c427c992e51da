// @ts-check
// Distribution of the heights with the material ratio curve; two heights are dragged, their ratios read.
//
// Traits: edges, shares, heights, curve (arrays), ratios and the heights that they are of, is_preview, message; at [c1, c2] (m about the mean,
// written here; null: where 10 and 80 % lie).

import { si } from "./format.js";
import { frame, ink, makePlot, pointedAt, uprightHandle } from "./plots.js";
import { typed } from "./wire.js";

/** @typedef {import("./wire.js").Model} Model */

const percent = (/** @type {number} */ v) => `${(100 * v).toFixed(v > 0.0995 && v < 0.9995 ? 1 : 2)}\u2009%`;

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const [read, words] = frame(el);
  let pointed = "";
  let [edges, shares, heights, curve] = Array.from({ length: 4 }, () => /** @type {number[]} */ ([]));
  const at = () => model.get("at") ?? [0, 0];

  const plot = makePlot(el, {
    title: "Distribution of heights: material ratio in percent, and how often each height occurs, of its most frequent class",
    yUnit: () => "", yName: "% material ratio; bars: % of the most frequent height",
    series: [{ stroke: () => ink("--ink"), width: 1.75 }],
    behind(u) {
      const most = Math.max(...shares);
      if (!(most > 0)) return;
      u.ctx.save();
      u.ctx.fillStyle = ink("--fill");
      u.ctx.beginPath();
      u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
      u.ctx.clip();
      const foot = u.valToPos(0, "y", true);
      shares.forEach((share, i) => {
        const [a, b, top] = [u.valToPos(edges[i], "x", true), u.valToPos(edges[i + 1], "x", true), u.valToPos((100 * share) / most, "y", true)];
        u.ctx.fillRect(a, top, Math.max(1, b - a - 0.5), foot - top);
      });
      u.ctx.restore();
    },
    placed: () => grips.forEach((grip, k) => grip.follow(`${si(at()[k])}, material ratio ${percent(model.get("ratios")?.[k] ?? NaN)}`)),
    pointed(u) {
      const i = pointedAt(u);
      const k = i < 0 ? -1 : edges.findLastIndex((v) => v <= u.data[0][i]);
      pointed = i < 0 ? "" : `${si(u.data[0][i])} about the mean: material ratio ${percent(u.data[1][i] / 100)}${shares[k] >= 0 ? `, ${percent(shares[k])} of the heights in its class` : ""}`;
      tell();
    },
  });
  const grips = [0, 1].map((k) => uprightHandle(plot.u, {
    label: `Height c${k + 1} of the material ratio`, text: String(k + 1),
    value: () => at()[k],
    put(value) {
      model.set("at", at().map((/** @type {number} */ v, /** @type {number} */ i) => (i === k ? value : v)));
      model.save_changes();
    },
  }));

  function tell() {
    const ratios = model.get("ratios");
    const sign = model.get("is_preview") ? "≈ " : "";
    const of = model.get("of") ?? at(); // a handle may be ahead of the answer
    const one = (/** @type {number} */ k) => `c${k + 1} ${si(of[k])}: ${sign}${percent(ratios[k])}`;
    read.textContent = pointed || (ratios && heights.length ? `${one(0)}   ${one(1)}   between them ${sign}${percent(Math.abs(ratios[1] - ratios[0]))}, ${si(Math.abs(of[1] - of[0]))}` : "");
    read.classList.toggle("preview", Boolean(model.get("is_preview")));
  }

  function draw() {
    words.textContent = model.get("message") ?? "";
    [edges, shares, heights, curve] = ["edges", "shares", "heights", "curve"].map((name) => [...typed(model.get(name), Float64Array) ?? []]);
    plot.put([heights, curve.map((v) => 100 * v)]);
    plot.u.root.style.visibility = heights.length ? "" : "hidden"; // axes without heights mean nothing
    tell();
  }

  model.on("change:heights change:message change:ratios", draw);
  model.on("change:at", () => plot.redraw());
  draw();
  return () => plot.destroy();
}

export default { render };
