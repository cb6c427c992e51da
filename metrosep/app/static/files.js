// @ts-check
// Files: handed over to the server, opened, dropped onto the page.

import { askForm } from "./dialogs.js";
import { Refusal } from "./wire.js";

/** @typedef {import("./wire.js").Wire} Wire */

/**
 * Hand a file over; return where the server keeps it.
 * @param {File} file
 * @param {string} token
 * @returns {Promise<string>}
 */
export async function upload(file, token) {
  let answer;
  try {
    answer = await fetch(`/upload?token=${encodeURIComponent(token)}`, {
      method: "POST", body: file, headers: { "X-File-Name": encodeURIComponent(file.name) },
    });
  } catch {
    throw new Error(`${file.name}: the server does not answer; is metrosep still running?`);
  }
  const text = await answer.text();
  let said;
  try {
    said = JSON.parse(text);
  } catch {
    throw new Error(text || `${file.name}: the upload failed (${answer.status})`);
  }
  if (!said.ok) throw new Refusal(said.error, "upload");
  return said.path;
}

/**
 * Open a file; ask the user for what it does not say.
 * @param {Wire} wire
 * @param {string} path
 * @param {Record<string, string>} [reading]
 * @returns {Promise<import("./wire.js").Answer | null>} null: given up
 */
export async function openPath(wire, path, reading = {}) {
  try {
    return await wire.ask("open", { path, reading });
  } catch (error) {
    if (!(error instanceof Refusal) || !error.ask) throw error;
    const { name, choices } = error.ask;
    const unit = name === "unit";
    const given = await askForm({
      title: unit ? "In which unit are the numbers of this file?" : `The file does not say: ${name}`,
      text: error.message,
      fields: [{ name, label: unit ? "Unit" : name, value: reading[name] ?? "", hint: unit ? "such as um" : "",
        choices: choices ?? (unit ? ["nm", "um", "mm", "m", "in"] : undefined) }],
      ok: "Open",
    });
    if (!given?.[name]) return null;
    return openPath(wire, path, { ...reading, ...given });
  }
}

/**
 * Take files that are dropped anywhere on the page.
 * @param {(file: File) => void} dropped
 */
export function listenToDrops(dropped) {
  const sign = /** @type {HTMLElement} */ (document.getElementById("dropping"));
  let depth = 0;
  const files = (/** @type {DragEvent} */ event) => event.dataTransfer?.types.includes("Files");
  document.addEventListener("dragenter", (event) => {
    if (!files(event)) return;
    depth += 1;
    sign.hidden = false;
  });
  document.addEventListener("dragleave", () => {
    depth = Math.max(0, depth - 1);
    sign.hidden = depth === 0;
  });
  document.addEventListener("dragover", (event) => event.preventDefault());
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    depth = 0;
    sign.hidden = true;
    const file = event.dataTransfer?.files?.[0];
    if (file) dropped(file);
  });
}
