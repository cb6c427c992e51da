// @ts-check
// The lines between the windows: dragged, moved by the arrow keys by 10 pixels (Shift: 100), by Home and End to
// their ends, and back to where they were by a double click or Enter. They are kept for every file and start.

import { prefer, preferred } from "./remember.js";

/** @typedef {Record<string, any>} Dict */
/** @typedef {{ low: number, high: number, across: boolean, span: () => [number, number], put: (share: number | null) => Dict }} Split */

const GAP = 6; // px between two windows, as in the style of #main
const main = () => /** @type {HTMLElement} */ (document.getElementById("main"));
const percent = (/** @type {number | null} */ share) => (share === null ? null : `${(100 * share).toFixed(2)}%`);

/** The first of some windows that is shown. @param {string[]} ids */
function shown(...ids) {
  return ids.map((id) => document.getElementById(id)).find((one) => one?.checkVisibility())?.getBoundingClientRect();
}

/** @returns {[number, number, number, number]} the room of the windows: left, top, right, bottom */
function room() {
  const box = main().getBoundingClientRect();
  const style = getComputedStyle(main());
  const [left, top, right, bottom] = [style.paddingLeft, style.paddingTop, style.paddingRight, style.paddingBottom].map(parseFloat);
  return [box.left + left, box.top + top, box.right - right, box.bottom - bottom];
}

/** By name: ends of its share, its direction, the room it shares out, and what the style takes. @type {Record<string, Split>} */
const SPLITS = {
  left: {
    low: 0.18, high: 0.45, across: true, span: () => [room()[0] + GAP / 2, room()[2] + GAP / 2],
    put: (share) => ({ "--left-w": percent(share) }),
  },
  middle: {
    low: 0.25, high: 0.7, across: true, span: () => [(shown("panel-map")?.left ?? room()[0]) + GAP / 2, room()[2] - GAP / 2],
    put: (share) => ({ "--map-w": share === null ? null : `${share.toFixed(4)}fr`, "--side-w": share === null ? null : `${(1 - share).toFixed(4)}fr` }),
  },
  right: {
    low: 0.25, high: 0.75, across: false, span: () => [shown("panel-section", "panel-profile")?.top ?? room()[1], room()[3]],
    put: (share) => ({ "--right-at": percent(share) }),
  },
  lower: {
    low: 0.25, high: 0.75, across: false, span: () => [room()[1], room()[3]],
    put: (share) => ({ "--lower-at": percent(share) }),
  },
};

/**
 * Return the splits of the page.
 * @param {NodeListOf<HTMLElement>} lines each with the name of its split
 */
export function makeSplits(lines) {
  /** @type {Record<string, number | null>} */
  const shares = {};
  /** @type {(() => void)[]} */
  const telling = [];

  for (const line of lines) {
    const name = line.dataset.split ?? "";
    const { low, high, across, span } = SPLITS[name];
    /** Where the line is now, of the room. */
    const at = () => {
      const [start, end] = span();
      const box = line.getBoundingClientRect();
      return ((across ? box.left + box.width / 2 : box.top + box.height / 2) - start) / (end - start);
    };
    const tell = () => line.checkVisibility() && line.setAttribute("aria-valuenow", String(Math.round(100 * at())));
    telling.push(tell);
    line.setAttribute("aria-valuemin", String(100 * low));
    line.setAttribute("aria-valuemax", String(100 * high));

    const put = (/** @type {number | null} */ share) => set(name, share === null ? null : Math.min(high, Math.max(low, share)));
    const keep = () => prefer(`split-${name}`, shares[name] === null ? "" : String(shares[name]?.toFixed(4)));
    let grabbed = 0;
    line.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      event.preventDefault();
      line.focus({ preventScroll: true });
      line.setPointerCapture(event.pointerId);
      line.classList.add("held");
      const [start, end] = span();
      grabbed = (across ? event.clientX : event.clientY) - start - at() * (end - start);
    });
    line.addEventListener("pointermove", (event) => {
      if (!line.classList.contains("held")) return;
      const [start, end] = span();
      put(((across ? event.clientX : event.clientY) - grabbed - start) / (end - start));
    });
    const drop = () => {
      if (!line.classList.contains("held")) return;
      line.classList.remove("held");
      keep();
    };
    line.addEventListener("pointerup", drop);
    line.addEventListener("lostpointercapture", drop);
    line.addEventListener("dblclick", () => (put(null), keep()));
    line.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const [back, on] = across ? ["ArrowLeft", "ArrowRight"] : ["ArrowUp", "ArrowDown"];
      const way = event.key === back ? -1 : Number(event.key === on);
      const [start, end] = span();
      if (way) put(at() + (way * (event.shiftKey ? 100 : 10)) / (end - start));
      else if (event.key === "Home" || event.key === "End") put(event.key === "Home" ? low : high);
      else if (event.key === "Enter") put(null);
      else return;
      event.preventDefault();
      event.stopPropagation();
      keep();
    });
    const was = Number(preferred(`split-${name}`, ""));
    put(was > 0 ? was : null);
  }

  function set(/** @type {string} */ name, /** @type {number | null} */ share) {
    shares[name] = share;
    for (const [key, value] of Object.entries(SPLITS[name].put(share))) {
      if (value === null) main().style.removeProperty(key);
      else main().style.setProperty(key, value);
    }
    for (const tell of telling) tell();
  }

  new ResizeObserver(() => telling.forEach((tell) => tell())).observe(main());
  return {
    /** Shares, null where it was not moved. @returns {Record<string, number | null>} */
    get: () => ({ ...shares }),
    /** @param {Record<string, number | null>} was */
    put(was) {
      for (const [name, share] of Object.entries(was)) if (share !== shares[name]) set(name, share);
    },
  };
}
