// @ts-check
// Changes that the server did not get: they are kept in the page, and sent once more when the connection is back
// and the recipe is still the one that they were made on.

import { Superseded } from "./wire.js";

/** @typedef {import("./recipe.js").Edit[]} Edits */

/**
 * @param {(edits: Edits, label: string, isAgain: boolean) => Promise<void>} edit
 * @param {() => string} hash of the recipe that is shown
 * @param {(text: string) => void} say
 */
export function makePending(edit, hash, say) {
  /** @type {{ edits: Edits, label: string, of: string }[]} */
  let kept = [];
  return {
    /** Keep a change that was lost with the connection; return whether it is kept. @param {unknown} error @param {Edits} edits @param {string} label @param {string} of hash */
    keep(error, edits, label, of) {
      if (!(error instanceof Superseded)) return false;
      kept.push({ edits, label, of });
      return true;
    },
    /** The connection is back. */
    async again() {
      const all = kept;
      kept = [];
      if (all.length && all[0].of !== hash()) {
        say(`The recipe changed while the connection was lost; look whether these changes are in it: ${all.map((one) => one.label).join(", ")}.`);
        return;
      }
      for (const { edits, label } of all) await edit(edits, label, true);
    },
  };
}
