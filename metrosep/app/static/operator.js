// @ts-check
// Operator mode: a name once a shift, a serial number for each part, a verdict. A scanner is a keyboard that
// ends with Enter.

import { si } from "./format.js";

/** @typedef {Record<string, any>} Dict */

const el = (/** @type {string} */ id) => /** @type {any} */ (document.getElementById(id));
const WORDS = /** @type {Dict} */ ({ accept: "✓ Accepted", reject: "✗ Rejected", inconclusive: "? Inconclusive" });
const EVERY_MS = 700;
if (location.search) history.replaceState(null, "", "/"); // the token stays in the cookie

let busy = false;
let shown = "";
/** @type {Dict | null} the file that the page shows: it is sent with the serial number, and no other is judged */
let offered = null;
let replaced = ""; // the file that it showed before, until the operator has been made to look

/** @param {Dict | null} asked what to do; null: only look */
async function ask(asked = null) {
  const answer = asked
    ? await fetch("/act", { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(asked) })
    : await fetch("/state");
  const found = await answer.json();
  if (!answer.ok) throw new Error(found.message);
  return found;
}

async function act(/** @type {Dict} */ asked) {
  if (busy) return;
  busy = true;
  el("message").textContent = "";
  if (asked.do === "measure") el("file").textContent = "measuring…";
  try {
    draw(await ask(asked));
  } catch (error) {
    el("message").textContent = error instanceof Error ? error.message : String(error);
    offered = null;
    await ask().then(draw, () => {}); // what the refusal is about
    if (asked.do === "measure") el("serial").select();
  } finally {
    busy = false;
  }
}

function draw(/** @type {Dict} */ state) {
  el("title").textContent = state.title;
  el("recipe").textContent = `${state.recipe}, ${state.hash}`;
  el("who").textContent = state.operator;
  document.title = state.title;
  const part = state.part;
  const mode = !state.operator ? "name" : part ? (part.needs_reason ? "reason" : "part") : "serial";
  el("name-form").hidden = mode !== "name";
  el("serial-form").hidden = mode !== "serial";
  el("part").hidden = !part || mode === "name";
  offer(state, mode === "serial" && shown === mode);
  if (part) drawPart(part, state.reasons);
  if (mode === shown) return;
  shown = mode;
  document.body.dataset.mode = mode;
  const field = { name: "name", serial: "serial", part: "next", reason: state.reasons.length ? "reason" : "reason-text" }[mode];
  if (mode === "serial") el("serial").value = "";
  el(field).focus();
}

/** @param {Dict} state @param {boolean} seen whether the operator has another file before his eyes */
function offer(state, seen) {
  const { file, failed } = state;
  if (!seen || !file || !offered) replaced = "";
  else if (JSON.stringify(file) !== JSON.stringify(offered) && !failed.includes(offered.name)) replaced = offered.name;
  offered = file;
  const more = state.waiting > 1 ? ` ${state.waiting} files wait: ${file.name} is judged with this serial number.` : "";
  const bad = failed.length ? ` Could not be measured: ${failed.join(", ")}.` : "";
  el("file").textContent = file ? `Measurement: ${file.name}.${more}${bad}` : state.idle;
}

/** @returns {Dict | null} null: another file came between the look and the scan */
function measure() {
  if (!replaced || !offered) return { do: "measure", text: el("serial").value, file: offered };
  el("message").textContent = `${offered.name} is shown now, ${replaced} was before: scan again if this part is ${offered.name}.`;
  replaced = "";
  el("serial").select();
  return null;
}

function drawPart(/** @type {Dict} */ part, /** @type {string[]} */ reasons) {
  el("verdict").className = part.verdict;
  el("verdict").textContent = WORDS[part.verdict] ?? part.verdict;
  const again = part.number > 1 ? ` Measurement ${part.number} of this part.` : "";
  el("about").textContent = `${part.serial}, ${part.file}.${again}${part.reason ? ` ${part.reason}.` : ""}`;
  el("rows").tBodies[0].replaceChildren(...part.rows.map((/** @type {Dict} */ row) => {
    const tr = document.createElement("tr");
    const limits = ["lower", "upper"].filter((k) => row[k] !== null).map((k) => `${k === "lower" ? "≥" : "≤"} ${si(row[k], row.unit)}`);
    for (const text of [row.name ?? row.metric, si(row.value, row.unit), limits.join(", "), WORDS[row.verdict]]) tr.insertCell().textContent = text;
    return tr;
  }));
  el("reason-form").hidden = !part.needs_reason;
  el("next").disabled = part.needs_reason;
  el("reason").hidden = !reasons.length;
  el("reason-text").hidden = Boolean(reasons.length);
  // none is chosen beforehand: the first of a list is not a reason
  if (reasons.length && el("reason").options.length !== reasons.length + 1) el("reason").replaceChildren(new Option("choose…", ""), ...reasons.map((text) => new Option(text, text)));
  if (part.needs_reason && shown !== "reason") el("reason").value = "";
}

function onSubmit(/** @type {string} */ id, /** @type {() => Dict | null} */ asked) {
  el(id).addEventListener("submit", (/** @type {Event} */ event) => {
    event.preventDefault();
    const what = asked();
    if (what) act(what);
  });
}

onSubmit("name-form", () => ({ do: "name", text: el("name").value }));
onSubmit("serial-form", measure);
onSubmit("reason-form", () => ({ do: "reason", text: el("reason").hidden ? el("reason-text").value : el("reason").value }));
el("next").addEventListener("click", () => act({ do: "next" }));

async function look() {
  if (!busy) {
    try {
      const state = await ask();
      if (!busy) draw(state);
    } catch {
      el("message").textContent = "No connection: is metrosep still running?";
    }
  }
  setTimeout(look, EVERY_MS);
}
look();
