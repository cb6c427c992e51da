// @ts-check
// Keys of the page. They rest while somebody types or a dialog is open.

/** @type {[string, string][]} */
export const KEYS = [
  ["1 2 3 4 5 6", "steps, map or profile, section, spectrum, metrics, status"],
  ["Tab", "to the next control or handle"],
  ["← → ↑ ↓", "move the focused handle by 1 pixel, with Shift by 10; pan the focused map"],
  ["+ -", "zoom the focused map; also the wheel"],
  ["F", "show all of the map or profile"],
  ["C X P L B", "draw a circle or ring, a rectangle to exclude or to crop, a polygon, free-hand shape, brush"],
  ["A G D", "draw a section, a round section, a distance or angle"],
  ["T M", "a step height or groove, a peak and valley"],
  ["N", "keep or exclude what is drawn"],
  ["Del", "delete the chosen shape, or the corner that has the focus"],
  ["Ctrl+C Ctrl+V", "copy the chosen shape"],
  ["H", "hill-shade"],
  ["V", "the map in three dimensions; arrows turn it, page keys change its height scale, square brackets the light"],
  ["Z", "undo; with Shift redo"],
  ["Alt+←→", "back and forward through what was looked at"],
  ["O", "open"],
  ["S", "save the recipe"],
  ["E", "export the result"],
  ["R", "the report"],
  ["Esc", "leave a field without a change, close a dialog"],
  ["?", "this help"],
];

/**
 * Listen to keys.
 * @param {Record<string, () => void>} acts by key; Shift+Z is "shift+z"
 * @param {(panel: number) => void} goTo
 * @param {(event: KeyboardEvent) => boolean} first asked before all others; true where it took the key
 */
export function listenToKeys(acts, goTo, first) {
  document.addEventListener("keydown", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    if (event.defaultPrevented || document.querySelector("dialog[open]")) return;
    const control = event.ctrlKey || event.metaKey;
    const typing = target.matches("input:not([type=checkbox]):not([type=radio]), textarea, select");
    if (typing) return;
    if (event.altKey) {
      const act = acts[`alt+${event.key.toLowerCase()}`];
      if (act) event.preventDefault(), act();
      return;
    }
    if (first(event)) {
      event.preventDefault();
      return;
    }
    const key = event.key.toLowerCase();
    const name = event.shiftKey && key === "z" ? "shift+z" : key;
    if (control && key !== "z") return;
    if (!control && /^[1-6]$/.test(key)) goTo(Number(key));
    else if (name in acts) acts[name]();
    else return;
    event.preventDefault();
  });
}
