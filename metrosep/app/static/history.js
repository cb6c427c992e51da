// @ts-check
// The way back through what was looked at: Alt with the arrows left and right, 50 deep. It is not the undo of
// the recipe, which stays as it is.

import { bandView, sectionView } from "./remember.js";

const POLL_MS = 250;
const DEEPEST = 50;

/** @typedef {Record<string, any>} Dict */

/**
 * Return the history of what is shown. A state is kept when it has rested.
 * @param {() => Dict | null} look what is shown; null while a file opens
 * @param {(state: Dict) => void} show
 */
export function makeHistory(look, show) {
  /** @type {string[]} */
  let past = [];
  let at = -1;
  let seen = "";

  function poll() {
    const state = look();
    if (!state || document.querySelector(".held")) return;
    const now = JSON.stringify(state);
    if (now === past[at]) seen = now;
    else if (now !== seen) seen = now; // it moves: wait until it rests
    else {
      past = [...past.slice(0, at + 1), now].slice(-DEEPEST - 1);
      at = past.length - 1;
    }
  }

  function go(/** @type {number} */ by) {
    poll();
    const next = at + by;
    if (!past[next]) return;
    at = next;
    seen = past[at];
    show(JSON.parse(past[at]));
  }

  setInterval(poll, POLL_MS);
  return {
    back: () => go(-1),
    forward: () => go(1),
    /** Another file: begin anew. */
    reset() {
      [past, at, seen] = [[], -1, ""];
    },
  };
}

/**
 * Return what the pictures look at, and how they look at it again: window, colours, cursors, rings, which picture.
 * @param {Record<string, import("./wire.js").Model & { put: (values: Dict) => void }>} models map, section, spectrum, profile, heights, waves
 * @param {object} options
 * @param {() => string} options.kind
 * @param {() => string} options.unit of lengths of the map
 * @param {() => HTMLSelectElement} options.choice of the lower panel
 * @param {() => boolean} options.shade
 * @param {(pose?: number[] | null) => number[] | null} options.relief angles of the view in 3-D, null where it is off
 * @param {() => boolean} options.ready whether the pictures are there
 * @param {(view: Dict) => void} options.shown told what is to be remembered
 */
export function makeLooks({ map, section, spectrum, profile, heights, waves }, { kind, unit, choice, shade, relief, ready, shown }) {
  const part = () => document.body.dataset.part;
  const both = () => ({ band: spectrum.get("band"), lower: choice().value, at: heights.get("at"), part: part() });
  return {
    /** null while there is no picture yet. @returns {Dict | null} */
    looked() {
      if (!["map", "profile"].includes(kind())) return { part: part() };
      if (!ready()) return null;
      if (kind() === "profile") return { ...both(), window: profile.get("window"), measured: profile.get("shown") };
      const view = map.get("view");
      return view ? { ...both(), window: view.fitted ? null : view.window, limits: map.get("limits"), a: map.get("a"), b: map.get("b"),
        colours: map.get("colours"), shade: shade(), cursors: section.get("cursors"), ring: waves.get("ring"), relief: relief() } : null;
    },
    /** @param {Dict} was */
    look(was) {
      if (was.part !== part()) /** @type {HTMLElement | null} */ (document.querySelector(`#parts [data-part="${was.part}"]`))?.click();
      if (!("lower" in was)) return;
      choice().value = was.lower;
      spectrum.put({ band: was.band });
      heights.put({ at: was.at });
      if (kind() === "profile") {
        profile.put({ window: was.window, shown: was.measured });
        /** @type {HTMLInputElement} */ (document.querySelector(`input[name=shown][value="${was.measured}"]`)).checked = true;
      } else {
        map.put({ limits: was.limits, a: was.a, b: was.b, colours: was.colours });
        section.put({ cursors: was.cursors });
        waves.put({ colours: was.colours, ...(was.ring ? { ring: was.ring } : {}) });
        map.put(was.window ? { goto: was.window } : { fit: 1 });
        relief(was.relief);
        Object.assign(/** @type {any} */ (document.getElementById("shade")), { checked: was.shade });
        Object.assign(/** @type {any} */ (document.getElementById("colours")), { value: was.colours });
        shown({ ...sectionView([was.a, was.b], map.get("unit") ?? "m"), colours: was.colours, hill_shade: was.shade });
      }
      shown({ ...bandView(was.band, unit()), lower: was.lower });
    },
  };
}
