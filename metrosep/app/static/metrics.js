// @ts-check
// Numbers with their uncertainty, limits and the verdict. What a preview cannot know is not shown:
// means are grey with a sign for "about", extremes and the verdict wait for the full resolution.

import { mendButtons } from "./mends.js";
import { powers, scaleFor, si } from "./format.js";

/** @typedef {Record<string, any>} Dict */

/** Units of values that a limit may be typed in. */
const TYPED = new Set(["pm", "nm", "µm", "mm", "m", "nrad", "µrad", "mrad", "rad", "in", "µin"]);

/** Angles that a person reads in degrees; slopes and tilts stay in rad. */
const ANGLE = /^section\..+\.(angle|azimuth)$/;

const expanded = (/** @type {Dict | undefined} */ row) => (row?.u == null ? null : 2 * row.u);

const inDegrees = (/** @type {Dict} */ row) => row.unit === "rad" && ANGLE.test(row.symbol ?? row.metric ?? "");

/** One place that says what a verdict looks like. */
export const VERDICTS = /** @type {Record<string, { sign: string, word: string }>} */ ({
  accept: { sign: "✓", word: "Accepted" },
  reject: { sign: "✗", word: "Rejected" },
  inconclusive: { sign: "?", word: "Inconclusive" },
});

/**
 * Return factor and name of the unit in which a value with its uncertainty is shown: that of a limit typed beside it without one.
 * @param {number} value
 * @param {number | null} U expanded, k = 2
 * @param {string} unit
 * @returns {[number, string]}
 */
export function unitWithU(value, U, unit) {
  return scaleFor(Math.max(Math.abs(value), U ?? 0), unit);
}

/**
 * Return value and expanded uncertainty with the decimals that the uncertainty warrants.
 * @param {number} value
 * @param {number | null} U expanded, k = 2
 * @param {string} unit
 * @returns {[string, string]}
 */
export function withU(value, U, unit) {
  if (U === null || !(U > 0)) return [si(value, unit), "–"];
  const [factor, name] = unitWithU(value, U, unit);
  const tail = name === "1" || name === "" ? "" : `\u2009${powers(name)}`;
  const [v, u] = [value / factor, U / factor];
  const decimals = Math.max(0, 1 - Math.floor(Math.log10(u)));
  if (decimals > 6) return [si(value, unit), si(U, unit, 2)];
  const sure = (/** @type {number} */ x) => {
    const text = x.toFixed(decimals);
    return Number(text) === 0 ? "0" : text.replace(/^-/, "\u2212"); // what rounds to nothing has no sign
  };
  return [sure(v) + tail, si(U, unit, 2)];
}

/** The beginning of a long sentence, which is said in whole elsewhere. @param {string} text */
const brief = (text) => (text.length > BRIEF ? text.replace(/^(.{20,}?)[:;] .*$/s, "$1") : text);
const BRIEF = 120; // characters: three lines of the verdict

/**
 * Return the table of metrics.
 * @param {HTMLElement} el
 * @param {HTMLElement} verdictEl
 * @param {(edits: import("./recipe.js").Edit[], label: string) => void} edit
 */
export function makeMetrics(el, verdictEl, edit) {
  /** @type {Dict | null} */
  let session = null;
  /** @type {Dict | null} */
  let found = null;
  /** Which row is open: "check 0" or "row Sq". @type {string | null} */
  let open = null;
  /** The row that was open when the table was drawn. @type {string | null} */
  let drawn = null;

  function cell(/** @type {string} */ text, className = "") {
    const td = document.createElement("td");
    td.textContent = text;
    td.className = className;
    return td;
  }

  function valueCells(/** @type {Dict | undefined} */ row, /** @type {number | null} */ U) {
    if (!row) return [cell(found?.is_preview ? "…" : "–"), cell("–")];
    const preview = Boolean(found?.is_preview);
    if (row.waits || row.value === null) {
      const waiting = cell(row.waits ? "…" : "–", row.waits ? "preview" : "");
      if (row.waits) waiting.title = "waits for the full resolution";
      return [waiting, cell(row.waits ? "…" : "–", row.waits ? "preview" : "")];
    }
    const turned = inDegrees(row) ? 180 / Math.PI : 1;
    const [value, u] = withU(row.value * turned, U === null ? null : U * turned, turned === 1 ? row.unit : "°");
    const shown = cell(preview ? `≈ ${value}` : value, preview ? "preview" : "");
    shown.title = `${row.definition}: ${row.value} ${row.unit}`;
    return [shown, cell(u, preview ? "preview" : "")];
  }

  function nameCell(/** @type {string} */ name, /** @type {string} */ detail, /** @type {string} */ key, /** @type {string} */ title) {
    const td = document.createElement("td");
    const button = document.createElement("button");
    button.type = "button";
    button.className = "icon";
    button.textContent = name;
    button.title = `${title}\nClick: limits`;
    button.style.color = "var(--ink)";
    button.style.whiteSpace = "normal";
    button.style.textAlign = "left";
    button.dataset.row = key;
    button.setAttribute("aria-expanded", String(open === key));
    button.addEventListener("click", () => {
      open = open === key ? null : key;
      draw();
      /** @type {HTMLElement | null} */ (el.querySelector(".limit-form input"))?.focus();
    });
    td.append(button);
    if (detail) {
      const small = document.createElement("small");
      small.textContent = detail;
      small.style.paddingLeft = "5px";
      td.append(small);
    }
    return td;
  }

  /** The unit in which a value is shown: that of a limit typed beside it without one; "" where none is shown. @param {Dict | undefined} row @param {number | null} U */
  function unitOf(row, U) {
    if (!row || row.waits || typeof row.value !== "number") return "";
    if (inDegrees(row)) return "deg";
    const [, unit] = unitWithU(row.value, U, row.unit);
    return TYPED.has(unit) ? unit : "";
  }

  function limitForm(/** @type {Dict} */ check, /** @type {number | null} */ index, /** @type {Dict | undefined} */ of, /** @type {number | null} */ U) {
    const unit = unitOf(of, U);
    const row = document.createElement("tr");
    const td = document.createElement("td");
    td.colSpan = 4;
    const form = document.createElement("form");
    form.className = "limit-form";
    const such = (/** @type {number} */ n) => `such as ${n}${["1", ""].includes(of?.unit) ? "" : ` ${unit || "nm"}`}`;
    const fields = /** @type {[string, string, string][]} */ ([
      ["lower", "lower limit", "none"], ["upper", "upper limit", such(150)], ["U", "U (k = 2)", such(8)],
    ]);
    /** @type {Record<string, HTMLInputElement>} */
    const inputs = {};
    for (const [key, text, hint] of fields) {
      const label = document.createElement("label");
      label.textContent = unit ? `${text} / ${unit}` : text;
      const input = document.createElement("input");
      input.title = unit ? `A number without a unit is in ${unit}, as the value beside it` : "";
      input.type = "text";
      input.spellcheck = false;
      input.value = check[key] === undefined ? "" : String(check[key]);
      input.placeholder = hint;
      input.name = key;
      inputs[key] = input;
      label.append(input);
      form.append(label);
    }
    const buttons = document.createElement("div");
    buttons.className = "wide";
    const set = document.createElement("button");
    set.className = "main small";
    set.textContent = index === null ? "Set limits" : "Change";
    buttons.append(set);
    if (index !== null) {
      const remove = document.createElement("button");
      remove.type = "button";
      remove.className = "small";
      remove.textContent = "Remove limits";
      remove.addEventListener("click", () => {
        open = null;
        edit([{ path: ["check", index], old: check, new: null }], `remove limits of ${check.metric}`);
      });
      buttons.append(remove);
    }
    form.append(buttons);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const next = /** @type {Dict} */ ({ ...check });
      for (const [key] of fields) {
        const words = inputs[key].value.trim();
        const plainNumber = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(words);
        if (words === "") delete next[key];
        else if (plainNumber && String(check[key] ?? "") === words) continue; // as it stands in the recipe
        else next[key] = !plainNumber ? words : unit ? `${words} ${unit.replace("µ", "u")}` : Number(words);
      }
      open = null;
      edit([{ path: ["check", index ?? (session?.checks ?? []).length], old: index === null ? null : check, new: next }],
        `limits of ${check.metric}`);
    });
    form.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      open = null;
      draw();
    });
    td.append(form);
    row.append(td);
    return row;
  }

  function limitWords(/** @type {Dict} */ check) {
    const [lower, upper] = [check.lower, check.upper];
    if (lower !== undefined && upper !== undefined) return `${lower} to ${upper}`;
    return upper !== undefined ? `≤ ${upper}` : lower !== undefined ? `≥ ${lower}` : "";
  }

  function draw() {
    if (!session?.recipe) {
      el.replaceChildren();
      return;
    }
    const active = /** @type {HTMLElement | null} */ (document.activeElement);
    const within = active !== null && el.contains(active);
    if (within && open !== null && open === drawn && active.matches("input")) return; // somebody types
    const focused = within ? active.dataset.row ?? (open === null ? drawn : undefined) : undefined;
    drawn = open;
    const scrolled = el.scrollTop;
    const table = document.createElement("table");
    table.className = "metrics";
    const head = document.createElement("tr");
    for (const text of ["metric", "value", "U", "verdict"]) {
      const th = document.createElement("th");
      const name = document.createElement("span");
      name.textContent = text;
      name.className = ["metric", "verdict"].includes(text) ? "visually-hidden" : "";
      th.append(name);
      if (text === "U") th.title = "expanded uncertainty, k = 2";
      head.append(th);
    }
    table.append(head);
    const rows = new Map((found?.rows ?? []).map((/** @type {Dict} */ row) => [row.symbol, row]));
    const checks = session.checks ?? [];
    const used = new Set();
    checks.forEach((/** @type {Dict} */ check, /** @type {number} */ i) => {
      const judged = found?.checks?.[i];
      const row = judged && !found?.is_preview ? { ...judged, waits: false } : rows.get(check.metric);
      used.add(check.metric);
      const tr = document.createElement("tr");
      tr.dataset.metric = check.metric;
      const name = check.name && check.name !== check.metric ? `${check.name}` : check.metric;
      const detail = `${check.name && check.name !== check.metric ? `${check.metric}  ` : ""}${limitWords(check)}`;
      const U = judged?.U ?? expanded(row);
      const state = judged && !found?.is_preview ? VERDICTS[judged.verdict] : null;
      const ended = Boolean(found?.failed || found?.refused);
      const last = cell(state ? state.sign : ended ? "–" : "…", `state ${state ? judged.verdict : "preview"}`);
      last.title = state ? state.word : ended ? "no verdict" : "waits for the full resolution";
      last.setAttribute("aria-label", last.title);
      tr.append(nameCell(name, detail, `check ${i}`, row?.definition ?? check.metric), ...valueCells(row, U), last);
      table.append(tr);
      if (open === `check ${i}`) table.append(limitForm(check, i, row, U));
    });
    for (const [symbol, row] of rows) {
      if (used.has(symbol)) continue;
      const tr = document.createElement("tr");
      tr.dataset.metric = symbol;
      tr.append(nameCell(symbol, "", `row ${symbol}`, row.definition), ...valueCells(row, expanded(row)), cell(""));
      table.append(tr);
      if (open === `row ${symbol}`) table.append(limitForm({ metric: symbol }, null, row, expanded(row)));
    }
    el.replaceChildren(table);
    el.scrollTop = scrolled;
    if (focused) /** @type {HTMLElement | null} */ (el.querySelector(`[data-row="${CSS.escape(focused)}"]`))?.focus({ preventScroll: true });
  }

  function drawVerdict() {
    verdictEl.className = "";
    const sign = document.createElement("span");
    sign.className = "sign";
    const word = document.createElement("span");
    word.className = "word";
    const none = !(session?.checks ?? []).length;
    const state = !found || found.is_preview ? null : VERDICTS[found.verdict];
    if (found?.failed) word.textContent = `No verdict: step ${found.failed.index + 1} failed`;
    else if (found?.refused) {
      word.textContent = `No verdict: ${brief(found.refused)}`;
      word.title = found.refused;
      if (found.mends?.length) word.append(mendButtons(found.mends, edit));
      word.style.fontSize = "12px";
    }
    else if (none) word.textContent = "No limits set: click a metric";
    else if (state) {
      verdictEl.className = found?.verdict;
      sign.textContent = state.sign;
      word.textContent = state.word;
    } else word.textContent = "… waits for the full resolution";
    if (none && !found?.refused) word.style.fontSize = "13px";
    verdictEl.replaceChildren(...(sign.textContent ? [sign] : []), word);
  }

  return {
    /** @param {Dict} next */
    show(next) {
      session = next;
      draw();
      drawVerdict();
    },
    /** @param {Dict | null} next */
    put(next) {
      found = next;
      draw();
      drawVerdict();
    },
    /** What is shown belongs to another recipe now. */
    stale() {
      if (!found) return;
      found = { ...found, is_preview: true, verdict: null, checks: undefined, failed: undefined, refused: undefined, mends: undefined,
        rows: (found.rows ?? []).map((/** @type {Dict} */ row) => ({ ...row, waits: true, value: null })) };
      draw();
      drawVerdict();
    },
  };
}
