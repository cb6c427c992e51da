// @ts-check
// The way back through what was looked at: Alt with the arrows left and right, 50 deep. It is not the undo of
// the recipe, which stays as it is.

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
