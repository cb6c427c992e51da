// @ts-check
// What the page says about the session: its file and title, the step that is shown, the state of the full
// pass and of the file of the recipe, the messages.

import { ago } from "./format.js";

/** @typedef {Record<string, any>} Dict */

const el = (/** @type {string} */ id) => /** @type {any} */ (document.getElementById(id));

/** @param {{ session: () => Dict, stage: () => number, notes: () => string[] }} options notes: of the last evaluation */
export function makeHeadline({ session, stage, notes }) {
  function drawSession() {
    const first = (session().files?.[0] ?? session().home ?? "").split(/[\\/]/).pop();
    const more = (session().files?.length ?? 0) - 1;
    const name = more > 0 ? `${first} and ${more} more` : first;
    el("title").textContent = name || "no file";
    el("title").title = (session().files ?? []).join("\n");
    el("subtitle").textContent = session().title && !name?.startsWith(session().title) ? session().title : "";
    document.title = name ? `${name} · metrosep` : "metrosep";
    for (const which of ["undo", "redo"]) {
      el(which).disabled = !session()[`can_${which}`];
      const label = session()[`${which}_label`];
      el(which).title = `${which === "undo" ? "Undo (Z)" : "Redo (Shift+Z)"}${label ? `: ${label}` : ""}`;
    }
    for (const id of ["recipe", "save", "export"]) el(id).disabled = !session().recipe;
    drawSaved();
    drawMessages();
  }

  /**
   * What the picture shows.
   * @param {number | null} [failed] the step that could not be run: the picture is of what came before
   * @param {number | null} [done] so many steps were carried out: the picture of a large map, while a hand moves
   */
  function drawStage(failed = null, done = null) {
    const op = (/** @type {number} */ k) => session().steps?.[k]?.op ?? "";
    const after = (/** @type {number} */ k) => (k < 0 ? "as measured" : `after step ${k + 1}, ${op(k)}`);
    const i = stage();
    const at = failed ?? done;
    const before = at !== null && (i === -1 || i >= at);
    const words = before ? `${after(at - 1)}: step ${at + 1}, ${op(at)}, ${failed === null ? "follows" : "failed"}` : i === -1 ? "after all steps" : after(i);
    el("map-stage").textContent = words;
    el("profile-stage").textContent = words;
  }

  function drawFull(/** @type {string} */ state, /** @type {string} */ words) {
    el("status-full").className = state;
    el("status-full").textContent = words;
  }

  function drawSaved() {
    const words = { waiting: "recipe: waiting for the disk…", failed: "recipe NOT kept: save it elsewhere" }[session().keeping];
    el("status-saved").textContent = session().recipe ? words ?? `recipe ${ago(session().saved_at)}` : "";
    el("status-saved").className = session().keeping === "failed" ? "lost" : "";
  }

  function drawMessages() {
    const all = [...(session().messages ?? []), ...notes()];
    el("messages").hidden = all.length === 0;
    el("messages").textContent = all.length === 1 ? all[0] : `${all.length} messages`;
    el("messages").title = all.join("\n");
  }

  return { drawSession, drawStage, drawFull, drawSaved, drawMessages };
}
