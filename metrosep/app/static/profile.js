// @ts-check
// A long profile: extremes of each pixel column of the measured and of the evaluated profile.
//
// Traits: series {measured: {x, low, high}, residual: {...}}, shown ("measured" | "residual"),
// message, is_preview; window [x0, x1] or null (written here).

import { si, spanned } from "./format.js";
import { frame, gapped, ink, makePlot, pointedAt, windowed } from "./plots.js";

/** @typedef {import("./wire.js").Model} Model */

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const [read, words] = frame(el);
  let pointed = "";
  const plot = makePlot(el, {
    title: "Profile: height over position",
    series: [
      { stroke: () => ink("--line"), width: 1.25 },
      { stroke: () => ink("--line"), width: 1.25 },
    ],
    bands: [{ series: [2, 1], fill: () => ink("--line") }],
    ...windowed(model),
    pointed(u) {
      const i = pointedAt(u);
      pointed = i < 0 ? "" : `x ${si(u.data[0][i])}: ${spanned(u.data[1][i], u.data[2][i])}`;
      tell();
    },
  });

  function tell() {
    const x = plot.u.data[0];
    read.textContent = pointed || (x.length ? `${si(x[0])} to ${si(x[x.length - 1])}${model.get("window") ? " (double click or F: all)" : ""}` : "");
  }

  function update() {
    words.textContent = model.get("message") ?? "";
    const one = (model.get("series") ?? {})[model.get("shown")];
    plot.put(one ? [Array.from(one.x), gapped(one.low), gapped(one.high)] : [[], [], []]);
    tell();
  }

  model.on("change:series change:shown change:message", update);
  update();
  return () => plot.destroy();
}

export default { render };
