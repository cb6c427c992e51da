// @ts-check
// The preview ladder: a coarse picture at once, a finer one when the hand rests, the full data after
// that. Verdict and P-V come from the last rung only. A rung waits for the one below it: two at a
// time would only make each other late.

/** @typedef {"drag" | "idle" | "full"} Level */

const IDLE_MS = 150;
const FULL_MS = 600;

const rest = (/** @type {number} */ ms) => new Promise((done) => setTimeout(done, Math.max(0, ms)));

/**
 * Return a ladder.
 * @param {(level: Level) => Promise<unknown>} show asks the server for everything at a level
 * @param {() => void} stop cancels what is under way
 */
export function makeLadder(show, stop) {
  let turn = 0;
  /** @type {Level} */
  let level = "drag";
  return {
    /** Something changed: begin at the lowest rung. */
    async climb() {
      turn += 1;
      const mine = turn;
      const start = performance.now();
      stop();
      level = "drag";
      await show("drag");
      await rest(start + IDLE_MS - performance.now());
      if (mine !== turn) return;
      level = "idle";
      await show("idle");
      await rest(start + FULL_MS - performance.now());
      if (mine === turn) await show("full");
    },
    /** The full data have been evaluated: from now on everything may come from them. */
    reached() {
      level = "full";
    },
    /** @returns {Level} the best level that answers at once */
    get level() {
      return level;
    },
  };
}
