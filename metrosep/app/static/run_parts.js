// @ts-check
// Small parts of the tab "Runs": lengths as they are typed, samples of lines, answers as traits.

import { si } from "./format.js";
import { penOf } from "./run_curves.js";

/**
 * Return a length as it is typed, no finer than what was pointed at.
 * @param {number} value m
 * @param {number} resolution m
 * @param {[number, number]} [within] the rounded value stays in it
 */
export function typedLength(value, resolution, within = [-Infinity, Infinity]) {
  const power = Math.max(-9, Math.floor(Math.log10(resolution)));
  const step = 10 ** power;
  let n = Math.round(value / step);
  if (n * step < within[0] - 1e-12) n += 1;
  if (n * step > within[1] + 1e-12) n -= 1;
  const text = (n * 10 ** (power + 3)).toFixed(Math.max(0, -(power + 3)));
  return { text: `${text.includes(".") ? text.replace(/\.?0+$/, "") : text} mm`, value: n * step };
}

/** Return an element with class and text. @param {string} name @param {string} [cls] @param {string} [text] @returns {any} */
export function make_(name, cls = "", text = "") {
  const el = document.createElement(name);
  if (cls) el.className = cls;
  if (text) el.textContent = text;
  return el;
}

/** Return a sample of a line for the legend. @param {number} feed */
export function sample(feed) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("width", "30");
  svg.setAttribute("height", "8");
  svg.setAttribute("aria-hidden", "true");
  const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
  for (const [k, v] of Object.entries({ x1: 1, x2: 29, y1: 4, y2: 4, "stroke-width": 2 })) line.setAttribute(k, String(v));
  line.style.stroke = `var(--feed-${feed % 6})`;
  line.setAttribute("stroke-dasharray", penOf(feed).dash.join(" "));
  svg.append(line);
  return svg;
}

/**
 * Return what an answer `curves` is for the widget.
 * @param {Record<string, any>} header
 * @param {Record<string, any>} arrays
 * @param {(feed: number | null) => number} place of a feedrate in the list
 * @returns {Record<string, any>}
 */
export function curvesOf(header, arrays, place) {
  const curve = (/** @type {string} */ name) => ({ x: arrays[`${name}_x`], low: arrays[`${name}_low`], high: arrays[`${name}_high`] });
  const listed = (/** @type {string} */ name, /** @type {(one: any, i: number) => any} */ act) => (header[name] ?? []).map(act);
  return {
    extent: header.full_travel, travel: header.travel, range: header.range, message: "",
    runs: listed("runs", (run, i) => ({ ...run, ...curve(`run_${i}`), feed: place(run.feed) })),
    ...(header.separated ? {
      separated: listed("separated", (one, i) => ({
        ...one, ...curve(`error_${i}`), band_low: arrays[`error_${i}_band_low`], band_high: arrays[`error_${i}_band_high`],
      })),
      means: listed("means", (one, i) => ({
        ...one, feed: place(one.feed), before: curve(`mean_${i}_before`), after: curve(`mean_${i}_after`),
      })),
    } : {}),
  };
}

/**
 * Return the numbers of a separation as words.
 * @param {Record<string, any>} header
 * @returns {HTMLElement[]}
 */
export function numbersOf(header) {
  const rms = { value: header.residual_rms, unit: "m", u: null, definition: "RMS of the readings about the separated error" };
  return /** @type {[string, any][]} */ ([
    ["P-V", header.pv], ["delay of the reading", header.lag], ["slope taken off", header.slope], ["lost motion", header.lost_motion], ["left in the readings, RMS", rms],
  ]).filter(([, q]) => q && q.value !== null).map(([name, q]) => {
    const item = make_("span", "", `${name} ${si(q.value, q.unit)}${q.u === null ? "" : ` (u ${si(q.u, q.unit, 2)})`}`);
    item.title = q.definition ?? "";
    return item;
  });
}

/**
 * Return what the tab looks at, and how it looks at it again, for the way back.
 * @param {HTMLElement} el
 * @param {HTMLSelectElement} ways direction of travel
 * @param {import("./wire.js").Model} curves
 */
export const looking = (el, ways, curves) => ({
  looked: () => ({ window: curves.get("window"), way: ways.value, shown: /** @type {HTMLInputElement} */ (el.querySelector("input[type=radio]:checked")).value }),
  /** @param {Record<string, any>} was */
  look(was) {
    const radio = /** @type {HTMLInputElement | null} */ (el.querySelector(`input[type=radio][value="${was.shown}"]`));
    if (radio && !radio.checked) radio.click();
    if (was.way !== ways.value) (ways.value = was.way), ways.dispatchEvent(new Event("change"));
    curves.set("window", was.window);
    curves.save_changes();
  },
});
