// @ts-check
// Edits of the recipe: what was there and what shall be. The page has no other state of its own.

import { countsPixels, written } from "./shapes.js";

/** @typedef {{ path: (string | number)[], old: any, new: any }} Edit */
/** @typedef {Record<string, any>} Dict */

/**
 * Return steps as they stand in the recipe. `enabled` is only there if the recipe says it.
 * @param {Dict} session
 * @returns {Dict[]}
 */
export function storedSteps(session) {
  const blocks = String(session.recipe ?? "").split(/^[ \t]*\[\[[ \t]*step[ \t]*\]\].*$/m).slice(1);
  return session.steps.map((/** @type {Dict} */ step, /** @type {number} */ i) => {
    if (step.stored) return step.stored;
    const own = (blocks[i] ?? "").split(/^[ \t]*\[/m)[0];
    const says = /^[ \t]*enabled[ \t]*=/m.test(own);
    return { op: step.op, ...step.keys, ...(says ? { enabled: step.enabled } : {}) };
  });
}

/**
 * Return the edits that turn one list of steps into another.
 * @param {Dict[]} before
 * @param {Dict[]} after
 * @returns {Edit[]}
 */
export function reordered(before, after) {
  /** @type {Edit[]} */
  const edits = [];
  const common = Math.min(before.length, after.length);
  for (let i = 0; i < common; i += 1) {
    if (JSON.stringify(before[i]) !== JSON.stringify(after[i])) edits.push({ path: ["step", i], old: before[i], new: after[i] });
  }
  for (let i = common; i < after.length; i += 1) edits.push({ path: ["step", i], old: null, new: after[i] });
  for (let i = before.length - 1; i >= common; i -= 1) edits.push({ path: ["step", i], old: before[i], new: null });
  return edits;
}

/**
 * Return the switch of a step.
 * @param {Dict} stored
 * @param {number} index
 * @param {boolean} on
 * @returns {Edit}
 */
export function switched(stored, index, on) {
  const old = "enabled" in stored ? stored.enabled : null;
  return { path: ["step", index, "enabled"], old, new: on ? null : false };
}

/** What each step is about, in a few words. @param {Dict} step */
export function summary(step) {
  const words = [];
  for (const [key, value] of Object.entries(step.keys)) {
    if (value && typeof value === "object" && !Array.isArray(value)) words.push(Object.entries(value).map(([k, v]) => (k === "shape" ? v : `${k.replaceAll("_", " ")} ${Array.isArray(v) ? v.join(", ") : v}`)).join(", "));
    else if (step.op === "mask" && key === "outside") words.push(value ? "keeps the inside" : "excludes the inside");
    else if (typeof value === "boolean") words.push(`${key.replaceAll("_", " ")} ${value ? "on" : "off"}`);
    else if (Array.isArray(value)) words.push(value.join(", "));
    else if (["form", "kind", "op", "names"].includes(key)) words.push(String(value));
    else words.push(`${key.replace("lambda_", "λ").replaceAll("_", " ")} ${value}`);
  }
  return words.join(" · ");
}

/**
 * Return a number that is 1, 2 or 5 with zeros, with unit, near a length.
 * @param {number} length m
 */
function near(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  const digit = [5, 2, 1].find((n) => n * power <= length) ?? 1;
  const micrometres = Number((digit * power * 1e6).toPrecision(3));
  return micrometres >= 1000 ? `${micrometres / 1000} mm` : `${micrometres} um`;
}

/**
 * Return the key and value of the length that a kind of filter needs, of one that had another.
 * @param {string} kind
 * @param {Dict} before
 * @param {string} usual
 * @returns {[string, string] | null}
 */
export function ownSize(kind, before, usual) {
  const length = before.lambda_c ?? before.cutoff ?? before.lambda_s ?? before.radius ?? before.length ?? usual;
  if (kind === "gaussian") return before.lambda_c || before.lambda_s || before.cutoff ? null : ["lambda_c", length];
  if (kind === "closing" || kind === "opening") return before.radius || before.length ? null : ["radius", length];
  return before.cutoff ? null : ["cutoff", length];
}

/**
 * Return a step to begin with.
 * @param {string} op
 * @param {string} kind map or profile
 * @param {number} size of what was measured, m, or px of a map without scale
 * @param {number} [middle] of what was measured, along x
 * @returns {Dict}
 */
export function freshStep(op, kind, size, middle = 0) {
  const pixels = kind === "map" && countsPixels();
  const length = size > 0 ? size : 1e-3;
  const width = pixels ? written(Math.round(0.9 * length)) : `${Number((0.9e3 * length).toPrecision(3))} mm`;
  if (kind === "map" && op === "mask") return { op, aperture: { shape: "circle", diameter: width, centre: "fit" } };
  if (op === "mask" || op === "crop") {
    return { op: "mask", aperture: { shape: "rectangle", width, ...(kind === "map" ? { height: width } : {}), centre: "fit" } };
  }
  if (op === "form") return { op, form: kind === "map" ? "plane" : "polynomial: degree=1" };
  if (op === "filter") return { op, kind: "gaussian", lambda_c: near(length / 5) };
  if (op === "psd") return { op, limit: `rms = 10 nm from ${near(length / 50)} to ${near(length / 5)}` };
  if (op === "step_height") return { op, width: pixels ? written(Math.round(length / 5)) : near(length / 5), middle: written(middle) };
  if (op === "surface_profile" || op === "line_profile") return { op, form: "sphere: R=50 mm" };
  return { op };
}
