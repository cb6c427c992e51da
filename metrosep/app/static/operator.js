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
  el("part").hidden = !part;
  const more = state.waiting > 1 ? ` (${state.waiting} wait; the newest is taken)` : "";
  if (!busy || mode !== "serial" || shown !== mode) el("file").textContent = state.file ? `Measurement: ${state.file}${more}` : "Waiting for a measurement in the inbox.";
  if (part) drawPart(part, state.reasons);
  if (mode === shown) return;
  shown = mode;
  document.body.dataset.mode = mode;
  const field = { name: "name", serial: "serial", part: "next", reason: state.reasons.length ? "reason" : "reason-text" }[mode];
  if (mode === "serial") el("serial").value = "";
  el(field).focus();
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

function onSubmit(/** @type {string} */ id, /** @type {() => Dict} */ asked) {
  el(id).addEventListener("submit", (/** @type {Event} */ event) => {
    event.preventDefault();
    act(asked());
  });
}

onSubmit("name-form", () => ({ do: "name", text: el("name").value }));
onSubmit("serial-form", () => ({ do: "measure", text: el("serial").value }));
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
