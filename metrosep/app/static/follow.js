// @ts-check
// Following a file that is written again, or the newest like it in its folder: it is opened with the present
// steps and limits when it has rested for a second.

import { Superseded } from "./wire.js";

const POLL_MS = 1000;

/**
 * @param {HTMLSelectElement} choice "", "file" or "folder"
 * @param {import("./wire.js").Wire} wire
 * @param {(paths: string[]) => Promise<void>} open with the present recipe
 * @param {(error: unknown) => void} fail
 */
export function makeFollow(choice, wire, open, fail) {
  let [shown, seen] = ["", ""]; // stamps: of what is open, of the last look
  let busy = false;

  async function look() {
    if (!choice.value || busy || !wire.connected) return;
    busy = true;
    try {
      const { header } = await wire.ask("latest", { of: choice.value });
      if (!header.path) return;
      if (header.is_open) shown = header.stamp; // as it was read; what was written since is shown
      if (header.stamp !== shown && header.stamp === seen) {
        shown = header.stamp; // also where it cannot be read: not again before it changes
        await open([header.path]);
      }
      seen = header.stamp;
    } catch (error) {
      if (error instanceof Superseded) return;
      choice.value = "";
      fail(error);
    } finally {
      busy = false;
    }
  }

  choice.addEventListener("change", () => {
    [shown, seen] = ["", ""];
    look();
  });
  setInterval(look, POLL_MS);
  return {
    /** Another file was opened by hand. */
    stop() {
      if (!busy) choice.value = "";
    },
    /** @param {boolean} can */
    allow(can) {
      choice.hidden = !can;
      if (!can) choice.value = "";
    },
  };
}
