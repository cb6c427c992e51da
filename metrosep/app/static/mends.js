// @ts-check
// Buttons beside what went wrong: each makes an edit that the server has tried, or asks for one value first.

import { askForm } from "./dialogs.js";
import { si } from "./format.js";

/** @typedef {Record<string, any>} Dict */
/** @typedef {(edits: import("./recipe.js").Edit[], label: string) => void} Make */

/**
 * Return the buttons.
 * @param {Dict[]} mends of the server: label, edits, ask
 * @param {Make} make
 * @param {() => void} [done]
 */
export function mendButtons(mends, make, done = () => {}) {
  const bar = document.createElement("div");
  bar.className = "mends";
  for (const mend of mends) {
    const button = Object.assign(document.createElement("button"), { type: "button", className: "small", textContent: mend.label });
    button.addEventListener("click", async () => {
      const edits = structuredClone(mend.edits);
      if (mend.ask) {
        const given = await askForm({ title: mend.label.replace("\u2026", ""), ok: "OK", fields: [{ name: "value", ...mend.ask }] });
        if (!given?.value) return;
        edits[edits.length - 1].new = given.value;
      }
      done();
      make(edits, mend.label.toLowerCase());
    });
    bar.append(button);
  }
  return bar;
}

/**
 * Return the line of a map without lateral scale, with the control that gives it.
 * @param {Make} make
 * @param {() => Dict} session
 * @param {() => number} length of the section A-B, px
 * @param {(given: Dict) => Promise<Dict | undefined>} scale of the server, which reads what was typed
 */
export function scaleLine(make, session, length, scale) {
  const line = document.createElement("p");
  line.className = "scale-line";
  line.append("No lateral scale: lengths and shapes are in px. ");
  const button = Object.assign(document.createElement("button"), { type: "button", className: "small", textContent: "Give the scale\u2026" });
  button.addEventListener("click", async () => {
    const px = length();
    const given = await askForm({
      title: "Scale of the map", ok: "Give the scale",
      text: "The file does not say how large a pixel is. The recipe will, for every file that it is run on.",
      fields: [{ name: "step", label: "Size of a pixel, or its width and height", hint: "such as 3 um, or 2 um x 3 um" },
        ...(px > 0 ? [{ name: "known", label: `or the length of the section A\u2013B, which is ${si(px, "px")}`, hint: "such as 2 mm" }] : [])],
    });
    if (!given?.step && !given?.known) return;
    const step = (await scale({ ...given, px }))?.lateral_step;
    if (step) make([{ path: ["input", "lateral_step"], old: session().input?.lateral_step ?? null, new: step }], "scale of the map");
  });
  line.append(button);
  return line;
}
