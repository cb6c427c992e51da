// @ts-check
// The preview ladder: a coarse picture at once, a finer one when the hand rests, the full data after
// that. Verdict and P-V come from the last rung only.

/** @typedef {"drag" | "idle" | "full"} Level */

const IDLE_MS = 150;
const FULL_MS = 600;

/**
 * Return a ladder.
 * @param {(level: Level) => void} show asks the server for everything at a level
 * @param {() => void} stop cancels what is under way
 */
export function makeLadder(show, stop) {
  /** @type {number[]} */
  let timers = [];
  /** @type {Level} */
  let level = "drag";
  return {
    /** Something changed: begin at the lowest rung. */
    climb() {
      timers.forEach(clearTimeout);
      stop();
      level = "drag";
      show("drag");
      timers = [
        window.setTimeout(() => {
          level = "idle";
          show("idle");
        }, IDLE_MS),
        window.setTimeout(() => show("full"), FULL_MS),
      ];
    },
    /** The full data have been evaluated: from now on everything may come from them. */
    reached() {
      level = "full";
      timers.forEach(clearTimeout);
    },
    /** @returns {Level} the best level that answers at once */
    get level() {
      return level;
    },
  };
}
