// @ts-check
// A long profile: extremes of each pixel column of the measured and of the evaluated profile.
//
// Traits: series {measured: {x, low, high}, residual: {...}}, shown ("measured" | "residual"),
// message, is_preview; window [x0, x1] or null (written here).

import { si } from "./format.js";
import { gapped, ink, makePlot } from "./plots.js";

/** @typedef {import("./wire.js").Model} Model */

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  el.classList.add("plot");
  const read = document.createElement("div");
  read.className = "readout";
  const words = document.createElement("div");
  words.className = "plot-empty";
  el.replaceChildren(read, words);
  let pointed = "";
  const zoom = (/** @type {number[] | null} */ window) => {
    model.set("window", window);
    model.save_changes();
  };
  const plot = makePlot(el, {
    title: "Profile: height over position",
    series: [
      { stroke: () => ink("--line"), width: 1.25 },
      { stroke: () => ink("--line"), width: 1.25 },
    ],
    bands: [{ series: [2, 1], fill: () => ink("--line") }],
    zoomed: (low, high) => zoom([low, high]),
    whole: () => zoom(null),
    pointed(u) {
      const i = u.cursor.idx;
      if (i === null || i === undefined || u.cursor.left < 0 || !u.data[0].length) pointed = "";
      else {
        const [low, high] = [u.data[1][i], u.data[2][i]];
        pointed = `x ${si(u.data[0][i])}: ${low === null ? "not measured" : low === high ? si(low) : `${si(low)} to ${si(high)}`}`;
      }
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

  plot.u.over.addEventListener("wheel", (/** @type {WheelEvent} */ event) => {
    const { min, max } = plot.u.scales.x;
    if (!(max > min)) return;
    event.preventDefault();
    const at = plot.u.posToVal(event.offsetX, "x");
    const factor = Math.exp(Math.max(-0.5, Math.min(0.5, event.deltaY * 0.0015)));
    zoom([at - (at - min) * factor, at + (max - at) * factor]);
  }, { passive: false });
  model.on("change:series change:shown change:message", update);
  update();
  return () => plot.destroy();
}

export default { render };
