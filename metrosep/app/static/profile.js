// @ts-check
// A long profile: extremes of each pixel column of the measured and of the evaluated profile.
//
// Traits: series {measured: {x, low, high}, residual: {...}}, shown ("measured" | "residual"),
// message, is_preview; window [x0, x1] or null (written here); groove {index, width, middle} of a step height.

import { si, spanned } from "./format.js";
import { frame, gapped, ink, makePlot, pointedAt, uprightHandle, windowed } from "./plots.js";
import { metres } from "./shapes.js";

/** @typedef {import("./wire.js").Model} Model */

/** @typedef {{ index: number, width: number, middle: number }} Groove m */

/** Bars of a groove in widths from its middle: upper, lower, upper (ISO 5436-1). */
const BARS = [[-3 / 2, -5 / 6], [-1 / 6, 1 / 6], [5 / 6, 3 / 2]];

/**
 * Return the groove of the chosen step, else of the last step that has one.
 * @param {Record<string, any>[]} steps
 * @param {number} chosen
 * @returns {Groove | null}
 */
export function grooveOf(steps, chosen) {
  const all = steps.filter((one) => one.op === "step_height" && one.enabled).map((one) => ({ index: one.index, width: metres(one.keys.width), middle: metres(one.keys.middle) }));
  const known = all.filter((one) => one.width > 0 && Number.isFinite(one.middle));
  return known.find((one) => one.index === chosen) ?? known[known.length - 1] ?? null;
}

/** @param {{ model: Model, el: HTMLElement, act?: (groove: Groove) => void }} given act: the groove was moved */
function render({ model, el, act }) {
  const [read, words] = frame(el);
  let pointed = "";
  /** @type {Groove | null} */
  let held = null; // while it is dragged
  const groove = () => held ?? /** @type {Groove | null} */ (model.get("groove") ?? null);
  const plot = makePlot(el, {
    title: "Profile: height over position",
    series: [
      { stroke: () => ink("--line"), width: 1.25 },
      { stroke: () => ink("--line"), width: 1.25 },
    ],
    bands: [{ series: [2, 1], fill: () => ink("--line") }],
    behind(u) {
      const now = groove();
      if (!now || !u.data[0].length) return;
      u.ctx.save();
      u.ctx.beginPath();
      u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
      u.ctx.clip();
      u.ctx.globalAlpha = 0.16;
      u.ctx.fillStyle = ink("--accent");
      for (const [from, to] of BARS) {
        const [left, right] = [from, to].map((part) => u.valToPos(now.middle + part * now.width, "x", true));
        u.ctx.fillRect(left, u.bbox.top, right - left, u.bbox.height);
      }
      u.ctx.restore();
    },
    placed: () => follow(),
    ...windowed(model),
    pointed(u) {
      const i = pointedAt(u);
      pointed = i < 0 ? "" : `x ${si(u.data[0][i])}: ${spanned(u.data[1][i], u.data[2][i])}`;
      tell();
    },
  });

  /** Edges and middle of the groove: an edge keeps the other one. */
  const grips = ["Left edge", "Middle", "Right edge"].map((label, k) => uprightHandle(plot.u, {
    label: `${label} of the groove`,
    value: () => ((now) => (now ? now.middle + ((k - 1) * now.width) / 2 : NaN))(groove()),
    put(value) {
      const now = groove();
      if (!now) return;
      if (k === 1) held = { ...now, middle: value };
      else {
        const other = now.middle - ((k - 1) * now.width) / 2;
        const width = (k - 1) * (value - other);
        if (width > 0) held = { ...now, width, middle: (value + other) / 2 };
      }
      plot.redraw();
    },
    held(is) {
      if (is || !held) return;
      const made = held;
      model.put({ groove: made }); // stays till the recipe has it
      held = null;
      act?.(made);
    },
  }));

  function follow() {
    const now = groove();
    for (const grip of grips) {
      if (now) grip.follow(`middle ${si(now.middle)}, width ${si(now.width)}`);
      else grip.show(false);
    }
  }

  function tell() {
    const x = plot.u.data[0];
    const [from, to] = model.get("extent") ?? [x[0], x[x.length - 1]]; // columns hold several samples: their middles are not the ends
    read.textContent = pointed || (x.length ? `${si(from)} to ${si(to)}${model.get("window") ? " (double click or F: all)" : ""}` : "");
  }

  function update() {
    words.textContent = model.get("message") ?? "";
    const one = (model.get("series") ?? {})[model.get("shown")];
    plot.put(one ? [Array.from(one.x), gapped(one.low), gapped(one.high)] : [[], [], []]);
    tell();
  }

  model.on("change:series change:shown change:message", update);
  model.on("change:groove", () => (plot.redraw(), follow()));
  update();
  return () => plot.destroy();
}

export default { render };
