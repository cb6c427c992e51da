// @ts-check
// The error of an axis, and the correction that a controller makes of a table: its entries, and how
// they are joined, in both directions.
//
// Traits: curves {x, error_forward, error_reverse, applied_forward, applied_reverse, entries_at,
// forward, reverse}, one_column, message, is_preview (nothing is written of it).

import { si } from "./format.js";
import { frame, gapped, ink, makePlot, pointedAt } from "./plots.js";

/** @typedef {import("./wire.js").Model} Model */

/** @type {{ key: string, name: string, dash?: number[], colour: string, width: number }[]} */
const LINES = [
  { key: "error_forward", name: "error, forward", colour: "--faint", width: 1.5 },
  { key: "error_reverse", name: "error, reverse", colour: "--faint", width: 1.5, dash: [5, 4] },
  { key: "applied_forward", name: "correction, forward", colour: "--line", width: 1.75 },
  { key: "applied_reverse", name: "correction, reverse", colour: "--open", width: 1.75, dash: [6, 4] },
];
const MOST_POINTS = 250; // more entries are one thick line

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  el.classList.add("table-plot");
  const [read, legend, words] = frame(el, ["readout", "table-legend", "plot-empty"]);
  let pointed = "";
  /** @type {number[] | null} */
  let window = null;

  const points = (/** @type {string} */ colour) => ({
    stroke: () => ink(colour), width: 0, paths: () => null,
    points: { show: true, size: 5.5, width: 1.5, stroke: () => ink(colour), fill: () => ink("--panel") },
  });
  const plot = makePlot(el, {
    title: "Error and correction over position",
    series: [
      ...LINES.map(({ colour, width, dash }) => ({ stroke: () => ink(colour), width, dash })),
      points("--line"), points("--open"),
    ],
    zoomed: (low, high) => zoom([low, high]),
    whole: () => zoom(null),
    pointed(u) {
      const i = pointedAt(u);
      pointed = "";
      if (i >= 0) {
        const at = LINES.map(({ name }, k) => [name, u.data[k + 1][i]]).filter(([, v]) => v !== null && v !== undefined);
        const entry = u.data[5][i] !== null && u.data[5][i] !== undefined ? "entry at " : "";
        pointed = [`${entry}${si(u.data[0][i], "m", 6)}`, ...at.map(([name, v]) => `${name} ${si(v)}`)].join("   ");
      }
      tell();
    },
  });

  function zoom(/** @type {number[] | null} */ to) {
    window = to;
    const x = plot.u.data[0];
    if (!x.length) return;
    plot.u.setScale("x", { min: to ? to[0] : x[0], max: to ? to[1] : x[x.length - 1] });
    tell();
  }

  function tell() {
    read.textContent = pointed || (window ? `${si(window[0])} to ${si(window[1])} (double click: all)` : "");
  }

  function update() {
    words.textContent = model.get("message") ?? "";
    const curves = model.get("curves");
    const one = Boolean(model.get("one_column"));
    el.classList.toggle("not-written", Boolean(model.get("is_preview")));
    if (!curves?.x?.length) {
      plot.put([[], [], [], [], [], [], []]);
      legend.replaceChildren();
      tell();
      return;
    }
    const x = Array.from(curves.x);
    const none = new Array(x.length).fill(null);
    const line = (/** @type {string} */ key) => (curves[key] && !(one && key === "applied_reverse") ? gapped(curves[key]) : none);
    const entries = (/** @type {string} */ key) => {
      const at = curves.entries_at;
      if (!at?.length || at.length > MOST_POINTS || (one && key === "reverse")) return none;
      const out = none.slice();
      at.forEach((/** @type {number} */ i, /** @type {number} */ k) => {
        out[i] = curves[key][k];
      });
      return out;
    };
    plot.put([x, ...LINES.map(({ key }) => line(key)), entries("forward"), entries("reverse")]);
    if (window) zoom(window);
    legend.replaceChildren(...LINES.filter(({ key }) => line(key) !== none).map(({ key, name, colour, dash }) => {
      const item = document.createElement("span");
      const mark = document.createElement("i");
      mark.style.borderTop = `2px ${dash ? "dashed" : "solid"} var(${colour})`;
      item.append(mark, one && key === "applied_forward" ? "correction, both directions" : name);
      return item;
    }));
    if (entries("forward") !== none) {
      const item = document.createElement("span");
      item.append("○ entry");
      legend.append(item);
    }
    tell();
  }

  model.on("change:curves change:one_column change:message change:is_preview", update);
  update();
  return () => plot.destroy();
}

export default { render };
