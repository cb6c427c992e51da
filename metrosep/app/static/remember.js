// @ts-check
// What is shown is kept in the recipe, table [view], some time after the hand rests. It is not an edit. What a
// user prefers for all files is a cookie: unlike other stores of a browser it holds for every port.

import { setInches } from "./format.js";

/** @typedef {Record<string, any>} Dict */

const REST_MS = 900;
const isPair = (/** @type {any} */ v) => Array.isArray(v) && v.length === 2 && v.every((one) => Number.isFinite(one));
const round = (/** @type {number} */ v) => Number(v.toPrecision(9));

/** @param {string} name @param {string} usual */
export function preferred(name, usual) {
  const start = `metrosep-${name}=`;
  return document.cookie.split("; ").find((one) => one.startsWith(start))?.slice(start.length) ?? usual;
}

/** @param {string} name @param {string} value letters, digits and points */
export function prefer(name, value) {
  document.cookie = `metrosep-${name}=${value}; path=/; max-age=31536000; samesite=strict`;
}

setInches(preferred("lengths", "metric") === "inch"); // before a picture is made

/** The choice of metric lengths or inches; all is drawn anew. @param {HTMLSelectElement} select */
export function makeLengths(select) {
  select.value = preferred("lengths", "metric");
  select.addEventListener("change", () => {
    prefer("lengths", select.value);
    location.reload();
  });
}

/**
 * Return the memory of the view.
 * @param {object} options
 * @param {import("./wire.js").Wire} options.wire
 * @param {() => Dict} options.session
 */
export function makeMemory({ wire, session }) {
  /** @type {Dict} */
  let view = {};
  let timer = 0;

  function keep() {
    timer = 0;
    if (session().recipe) wire.ask("view", { view }).catch(() => {}); // what is shown is worth no alarm
  }

  return {
    /** Another file: begin with what its recipe holds. @param {Dict} kept */
    begin(kept) {
      clearTimeout(timer);
      view = { ...kept };
    },
    /** @param {Dict} changes keys of [view]; null takes one out */
    put(changes) {
      const next = { ...view, ...changes };
      for (const key of Object.keys(next)) if (next[key] === null || next[key] === undefined) delete next[key];
      if (JSON.stringify(next) === JSON.stringify(view)) return;
      view = next;
      clearTimeout(timer);
      timer = window.setTimeout(keep, REST_MS);
    },
  };
}

/** @param {[number[], number[]] | null} ends m, or pixels @param {string} unit of the map @returns {Dict} */
export function sectionView(ends, unit) {
  if (!ends?.[0] || !ends[1]) return {};
  const is = unit === "m";
  const value = ends.map((end) => end.map((v) => round(is ? v * 1e3 : v)));
  if (String(value[0]) === String(value[1])) return {}; // a point is not a section: the last one is kept
  return { section_mm: is ? value : null, section_px: is ? null : value };
}

/** @param {Dict} view @param {string} unit @returns {[number[], number[]] | null} */
export function sectionOf(view, unit) {
  const kept = unit === "m" ? view.section_mm : view.section_px;
  if (!Array.isArray(kept) || kept.length !== 2 || !kept.every(isPair) || String(kept[0]) === String(kept[1])) return null;
  return /** @type {any} */ (kept.map((/** @type {number[]} */ end) => end.map((v) => (unit === "m" ? v / 1e3 : v))));
}

/** @param {number[] | null} band m, or pixels @param {string} unit of the map @returns {Dict} */
export function bandView(band, unit) {
  const is = unit === "m";
  const value = band ? band.map((v) => round(is ? v * 1e3 : v)) : null;
  return { band_mm: is ? value : null, band_px: is ? null : value };
}

/** @param {Dict} view @param {string} unit @returns {number[] | null} */
export function bandOf(view, unit) {
  const kept = unit === "m" ? view.band_mm : view.band_px;
  return isPair(kept) && kept[0] > 0 && kept[1] > kept[0] ? kept.map((/** @type {number} */ v) => (unit === "m" ? v / 1e3 : v)) : null;
}
