// @ts-check
// Pictures of the whole map besides the map itself: in 3-D, the distribution of heights, the waves in all
// directions. Each asks the server where it is shown.

import { download } from "./dialogs.js";
import { makeRelief } from "./relief.js";

/** @typedef {import("./ladder.js").Level} Level */
/** @typedef {Record<string, any>} Dict */

/**
 * @typedef {object} Asking what every picture asks with
 * @property {import("./wire.js").Wire} wire
 * @property {() => Level} level
 * @property {() => number} stage
 * @property {() => string} kind
 * @property {() => number} epoch rises with each file
 * @property {(error: unknown, show: (text: string) => void) => void} refused
 */

/** What a picture of the whole map says before it is there the first time. */
const WAIT = "being computed\u2026";

const el = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));

/**
 * Return the view in 3-D.
 * @param {Asking & { lines: () => number[][], table: () => string }} options lines: ends of sections, table: of colours
 */
export function makeReliefView({ wire, level, stage, kind, epoch, refused, lines, table }) {
  /** @type {ReturnType<typeof makeRelief> | null} */
  let relief = null; // made when it is asked for
  async function askRelief(/** @type {Level} */ at = level()) {
    if (el("relief").hidden || kind() !== "map") return;
    const mine = epoch();
    try {
      const { header, arrays } = await wire.ask("relief", { stage: stage(), level: at, side: 512 });
      if (mine === epoch()) relief?.put(header, arrays);
    } catch (error) {
      refused(error, (text) => (relief?.say(""), (el("map-message").textContent = text)));
    }
  }
  const lamp = /** @type {HTMLInputElement} */ (el("relief-light"));
  lamp.addEventListener("input", () => relief?.light(Number(lamp.value)));
  const scale = /** @type {HTMLInputElement} */ (el("relief-height"));
  scale.addEventListener("input", () => relief?.height(Number(scale.value)));
  el("relief-on").addEventListener("click", () => {
    const on = el("relief").hidden;
    el("map").hidden = on;
    el("relief").hidden = el("relief-bar").hidden = !on;
    el("relief-bar").parentElement?.classList.toggle("turned", on); // the room of the tools stays: the picture does not jump
    el("relief-on").setAttribute("aria-pressed", String(on));
    relief ??= makeRelief(el("relief"), { table, lines, lit: (degrees) => (lamp.value = String(degrees)), stretched: (steps) => (scale.value = String(steps)) });
    if (on) relief.say(WAIT);
    askRelief();
  });
  el("relief-save").addEventListener("click", () => relief?.picture().toBlob((blob) => blob && download(blob, "map-3d.png")));
  return {
    ask: askRelief,
    paint: () => relief?.paint(),
    /** How it is turned, null where it is off; show it so. @param {number[] | null} [was] @returns {number[] | null} */
    pose(was) {
      if (was !== undefined && Boolean(was) === el("relief").hidden) el("relief-on").click();
      return el("relief").hidden ? null : relief?.pose(was ?? undefined) ?? null;
    },
  };
}

/**
 * Return what asks for the heights and for the waves.
 * @param {Asking & { lower: () => string, heights: any, waves: any, counted: () => void }} options lower: which of them is shown
 */
export function makeWholeViews({ wire, level, stage, kind, epoch, refused, lower, heights, waves, counted }) {
  /** How the heights are shared out, where that is shown. */
  async function askHeights(/** @type {Level} */ at = level()) {
    if (lower() !== "heights") return;
    const mine = epoch();
    if (!heights.get("edges")) heights.put({ message: WAIT });
    try {
      const { header, arrays } = await wire.ask("heights", { stage: stage(), level: at, at: heights.get("at") });
      if (mine !== epoch()) return;
      heights.put({ edges: arrays.edges, shares: arrays.shares, curve: arrays.curve, is_preview: header.is_preview, message: "" });
      if (!heights.get("at")) heights.put({ at: header.at });
      heights.put({ of: header.at, ratios: header.ratios, heights: arrays.heights });
      counted();
    } catch (error) {
      refused(error, (text) => heights.put({ edges: null, shares: null, curve: null, ratios: null, message: text, heights: null }));
    }
  }

  /** The waves in all directions, where they are shown. */
  async function askWaves(/** @type {Level} */ at = level()) {
    if (lower() !== "waves2d" || kind() !== "map") return;
    const mine = epoch();
    if (!waves.get("index")) waves.put({ message: WAIT });
    try {
      const { header, arrays } = await wire.ask("waves2d", { stage: stage(), level: at });
      if (mine !== epoch()) return;
      const [short, long] = [2.2 / Math.max(header.window[2], header.window[3]), 8 / header.window[2]];
      if (!waves.get("ring") || waves.get("unit") !== header.unit) waves.put({ ring: [2 * short, Math.max(long, 4 * short)] });
      waves.put({ shape: arrays.index.shape, unit: header.unit, window: header.window, amplitude: header.amplitude, decades: header.decades,
        peak: header.peak, notes: header.notes, is_preview: header.is_preview, message: "", index: arrays.index });
      counted();
    } catch (error) {
      refused(error, (text) => waves.put({ index: null, message: text }));
    }
  }

  return { askHeights, askWaves };
}
