// @ts-check
// Files: handed over to the server, opened, dropped onto the page.

import { askForm, make } from "./dialogs.js";
import { Refusal } from "./wire.js";

/** @typedef {import("./wire.js").Wire} Wire */

/**
 * Hand a file over; return where the server keeps it.
 * @param {File} file
 * @param {string} token
 * @param {string} [set] name of a set: its files are kept in one folder
 * @returns {Promise<string>}
 */
export async function upload(file, token, set = "") {
  let answer;
  try {
    answer = await fetch(`/upload?token=${encodeURIComponent(token)}`, {
      method: "POST", body: file, headers: { "X-File-Name": encodeURIComponent(file.name), ...(set ? { "X-Set": set } : {}) },
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
 * Open a file, or several runs as a set; ask the user for what they do not say.
 * @param {Wire} wire
 * @param {string[]} paths
 * @param {Record<string, string>} [reading]
 * @param {boolean} [keep] carry out the present recipe on them
 * @param {boolean} [asks] false: nobody is there to answer, as where a file is followed that is half written
 * @returns {Promise<import("./wire.js").Answer | null>} null: given up
 */
export async function openPaths(wire, paths, reading = {}, keep = false, asks = true) {
  try {
    return await wire.ask("open", { paths, reading, keep_recipe: keep });
  } catch (error) {
    if (!asks || !(error instanceof Refusal) || !error.ask) throw error;
    const given = await askForm(question(error, reading));
    if (!given || !Object.values(given).some(Boolean)) return null;
    return openPaths(wire, paths, { ...reading, ...given }, keep);
  }
}

/** @param {Refusal} error @param {Record<string, string>} reading */
function question(error, reading) {
  const { name, choices, fields, sample } = error.ask;
  if (fields?.length) {
    const asks = (/** @type {string} */ what) => fields.some((/** @type {any} */ one) => one.name === what);
    const title = asks("channel") ? "Which data set of the file?" : asks("row_order") ? "Which row of the map is on top?" : asks("sheet") ? "Which table of the file?"
      : sample?.lines?.some((/** @type {any} */ one) => one.kind === "refused") ? "One line does not fit: what does it mean?"
      : asks("angle") ? "Is it a roundness trace, or what do the columns hold?" : !asks("x") && sample?.lines ? "How is the file written?" : asks("lateral_step") ? "Is it a map, or what do the columns hold?"
      : asks("feed") ? "Which column is what?" : "What do the columns hold?";
    return { title, text: error.message, fields, ok: "Open", sample: sampleOf(sample) };
  }
  const unit = name === "unit";
  return {
    title: unit ? "In which unit are the numbers of this file?" : `The file does not say: ${name}`,
    text: error.message,
    fields: [{ name, label: unit ? "Unit" : name, value: reading[name] ?? "", hint: unit ? "such as um" : "",
      choices: choices ?? (unit ? ["nm", "um", "mm", "m", "in"] : undefined) }],
    ok: "Open",
  };
}

/**
 * Show the first lines of a table, what its columns were read as, and the lines that are no rows.
 * @param {any} sample
 * @returns {Node[]}
 */
function sampleOf(sample) {
  if (!sample?.lines?.length) return [];
  const cell = (/** @type {string} */ text, kind = "td") => make(kind, { textContent: text });
  const lines = make("table", {}, ...sample.lines.flatMap((/** @type {any} */ one, /** @type {number} */ i) => [
    ...(i && one.number > sample.lines[i - 1].number + 1 ? [make("tr", {}, cell("\u22ee", "th"))] : []),
    make("tr", { className: one.kind === "refused" ? "refused" : "" }, cell(String(one.number), "th"), cell(one.kind), cell(one.text))]));
  const columns = sample.columns.length ? [make("table", {}, make("tr", {}, ...["column", "unit", "read as"].map((one) => cell(one, "th"))),
    ...sample.columns.map((/** @type {any} */ one) => make("tr", {}, cell(one.name), cell(one.unit || "none"), cell(one.role || "no role by its name"))))] : [];
  const left = sample.left.map((/** @type {any} */ one) => make("li", { textContent: `line ${one.lines}: ${one.why} (${one.text})` }));
  const rows = sample.n_rows === null ? "" : ` (${sample.n_rows} rows)`;
  return [make("div", { className: "sample", tabIndex: 0 }, make("h3", { textContent: `First lines${sample.part ? ` of ${sample.part}` : ""}${rows}` }), lines, ...columns,
    ...(left.length ? [make("h3", { textContent: "Lines that are no rows" }), make("ul", {}, ...left)] : []))];
}

/**
 * Take files that are dropped anywhere on the page.
 * @param {(files: File[]) => void} dropped
 */
export function listenToDrops(dropped) {
  const sign = /** @type {HTMLElement} */ (document.getElementById("dropping"));
  let depth = 0;
  const holds = (/** @type {DragEvent} */ event) => event.dataTransfer?.types.includes("Files");
  document.addEventListener("dragenter", (event) => {
    if (!holds(event)) return;
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
    const files = [...event.dataTransfer?.files ?? []];
    if (files.length) dropped(files);
  });
}

/**
 * Send files to the server; those of a set lie in one folder.
 * @param {File[]} files
 * @param {string} token
 * @param {(name: string) => void} tell
 * @returns {Promise<string[]>} where they are
 */
export async function uploadAll(files, token, tell) {
  const set = files.length > 1 ? Math.random().toString(36).slice(2, 12) : "";
  const paths = [];
  for (const file of files) {
    tell(file.name);
    paths.push(await upload(file, token, set));
  }
  return paths;
}
