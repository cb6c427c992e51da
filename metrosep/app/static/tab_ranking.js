// @ts-check
// Error terms of a machine by what they do to the part: bars that can be edited, and what is left.

import { si } from "./format.js";
import { Refusal, Superseded } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

const COLUMNS = /** @type {[string, string, string][]} */ ([
  ["term", "error term", "Name of ISO 230-1, and what it is"],
  ["magnitude", "size", "As the recipe has it; type another and press Enter"],
  ["rms", "RMS on the part", "Of this term alone at its size, after the alignment; the line is the cumulative share"],
  ["pv", "P-V", "Of this term alone at its size, after the alignment"],
  ["rms_raw", "RMS, nothing removed", "Before the alignment"],
  ["share", "share", "Of the expected mean square of all terms together"],
  ["cumulative", "cumulative", "Share of this term and those above it"],
  ["group", "looks like", "Terms of one group make maps alike: one part cannot tell them apart"],
]);

const percent = (/** @type {number | null} */ x) =>
  (x === null ? "–" : x > 0 && x < 5e-4 ? "< 0.1\u2009%" : `${(100 * x).toFixed(1)}\u2009%`);

function make_(/** @type {string} */ tag, /** @type {Dict} */ properties = {}, /** @type {(Node | string)[]} */ ...children) {
  const made = /** @type {any} */ (Object.assign(document.createElement(tag), properties));
  made.append(...children);
  return made;
}

/** @param {import("./tabs.js").Context} context @returns {import("./tabs.js").Tab} */
export function make({ el, wire, session, edit, fail }) {
  /** @type {Dict | null} */
  let found = null;
  let of = "";
  let sorted = "rms";
  /** Sizes before a term was switched off. @type {Map<string, string>} */
  const before = new Map();

  const bar = make_("div", { className: "ranking-bar" });
  const scroll = make_("div", { className: "scroll", tabIndex: -1 });
  const state = make_("p", { className: "soft ranking-state" });
  state.setAttribute("role", "status");
  el.replaceChildren(bar, state, scroll);

  const keys = () => session().steps?.[0]?.keys ?? {};

  async function show() {
    if (of === session().hash) return;
    const wanted = session().hash;
    state.textContent = "ranking…";
    scroll.classList.add("outdated");
    try {
      const { header } = await wire.ask("ranking");
      if (session().hash !== wanted) return;
      [found, of] = [header, wanted];
      state.textContent = "";
      scroll.classList.remove("outdated");
      draw();
    } catch (error) {
      if (error instanceof Superseded || session().hash !== wanted) return;
      if (error instanceof Refusal) state.textContent = `not ranked: ${error.message}`;
      else fail(error);
    }
  }

  function respond(/** @type {string} */ response) {
    const now = keys();
    if ((now.response ?? "form") === response) return;
    const edits = [{ path: ["step", 0, "response"], old: now.response ?? null, new: response }];
    // keys that the other response refuses go with it, in the same step of undo
    for (const key of response === "form" ? ["mode", "n"] : ["direction"]) {
      if (now[key] !== undefined) edits.push({ path: ["step", 0, key], old: now[key], new: /** @type {any} */ (null) });
    }
    edit(edits, `rank by ${response}`);
  }

  function resize(/** @type {Dict} */ row, /** @type {string} */ size) {
    const old = (keys().errors ?? {})[row.path[3]] ?? null; // the recipe may be further than the rows
    if (size === (old ?? row.size)) return;
    edit([{ path: row.path, old, new: size }], `size of ${row.term}`);
  }

  function drawBar() {
    const group = make_("div", { className: "ranking-choice" });
    group.setAttribute("role", "radiogroup");
    group.setAttribute("aria-label", "Ranked by");
    for (const response of found?.responses ?? []) {
      const input = make_("input", { type: "radio", name: "response", value: response, checked: found?.response === response });
      input.addEventListener("change", () => respond(response));
      group.append(make_("label", { className: "check" }, input, `by ${response}`));
    }
    const total = make_("p", { className: "ranking-total" });
    const { rms, rms_raw: raw, U } = found?.total ?? {};
    total.append("all terms together: ", make_("b", { textContent: `${si(rms)} RMS` }),
      U === null || U === undefined ? " (U not known)" : ` (U = ${si(U, "m", 2)})`, `; nothing removed: ${si(raw)}`);
    total.title = `Root of the expected mean square; sizes are ${found?.distribution === "uniform" ? "half-widths" : "standard uncertainties"}`;
    const removed = make_("span", { className: "soft", textContent: `removed: ${(found?.removed ?? []).join(", ") || "nothing"}` });
    bar.replaceChildren(group, removed, make_("span", { className: "grow" }), total);
  }

  function sizeInput(/** @type {Dict} */ row) {
    const input = make_("input", { value: row.size, spellcheck: false, className: "ranking-size", autocomplete: "off" });
    input.setAttribute("aria-label", `Size of ${row.term}`);
    input.dataset.size = row.term;
    input.addEventListener("change", () => resize(row, input.value.trim()));
    input.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
      if (event.key === "Escape") {
        input.value = row.size;
        input.blur();
      }
    });
    return input;
  }

  function onOff(/** @type {Dict} */ row) {
    const input = make_("input", { type: "checkbox", checked: row.magnitude > 0, title: "Off: size zero; the other terms are ranked without it" });
    input.setAttribute("aria-label", `${row.term} takes part`);
    input.dataset.term = row.term;
    input.addEventListener("change", () => {
      const key = `${session().home} ${row.term}`;
      if (!input.checked) {
        before.set(key, row.size);
        resize(row, row.unit === "rad" ? "0 arcsec" : "0 um");
      } else if (before.has(key)) {
        resize(row, /** @type {string} */ (before.get(key)));
      } else {
        input.checked = false;
        /** @type {HTMLElement | null} */ (scroll.querySelector(`[data-size="${CSS.escape(row.term)}"]`))?.focus();
      }
    });
    return make_("label", { className: "hit" }, input);
  }

  function barCell(/** @type {Dict} */ row, /** @type {number} */ largest, /** @type {number[] | null} */ run) {
    const NS = "http://www.w3.org/2000/svg";
    const svg = document.createElementNS(NS, "svg");
    svg.setAttribute("viewBox", "0 0 100 10");
    svg.setAttribute("preserveAspectRatio", "none");
    svg.setAttribute("aria-hidden", "true");
    const rect = document.createElementNS(NS, "rect");
    for (const [k, v] of Object.entries({ x: 0, y: 2, height: 6, width: largest > 0 ? (100 * row.rms) / largest : 0 })) rect.setAttribute(k, String(v));
    svg.append(rect);
    if (run) {
      const line = document.createElementNS(NS, "line");
      for (const [k, v] of Object.entries({ x1: 100 * run[0], y1: 0, x2: 100 * run[1], y2: 10 })) line.setAttribute(k, String(v));
      svg.append(line);
    }
    return make_("td", { className: "ranking-cell" }, make_("div", {}, svg, make_("span", { textContent: si(row.rms) })));
  }

  function nameCell(/** @type {Dict} */ row) {
    return make_("td", {}, make_("b", { textContent: row.term }), make_("small", { textContent: row.words }));
  }

  function draw() {
    if (!found) return;
    const had = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset ?? {};
    const focused = had.size ? `[data-size="${CSS.escape(had.size)}"]` : had.term ? `[data-term="${CSS.escape(had.term)}"]`
      : had.sort ? `[data-sort="${had.sort}"]` : "";
    drawBar();
    const head = make_("tr", {}, make_("th", { textContent: "on" }));
    for (const [key, label, title] of COLUMNS) {
      const button = make_("button", { type: "button", className: "icon", textContent: key === "rms" && found.response === "wavefront" ? "RMS of the wavefront" : label, title: `${title}\nClick: sort` });
      button.dataset.sort = key;
      button.addEventListener("click", () => {
        sorted = key;
        draw();
      });
      const th = make_("th", { scope: "col" }, button);
      if (sorted === key) th.setAttribute("aria-sort", key === "term" || key === "group" ? "ascending" : "descending");
      head.append(th);
    }
    const rows = found.rows.map((/** @type {Dict} */ row, /** @type {number} */ i) => ({ ...row, cumulative: found?.cumulative[i], before: i ? found?.cumulative[i - 1] : 0 }));
    const text = sorted === "term";
    const order = [...rows].sort((a, b) => (text ? (a.term < b.term ? -1 : 1)
      : sorted === "group" ? (a.group || Infinity) - (b.group || Infinity) || 0
      : sorted === "cumulative" ? a.cumulative - b.cumulative : b[sorted] - a[sorted]));
    const largest = Math.max(...rows.map((/** @type {Dict} */ r) => r.rms), 0);
    const falling = sorted === "rms" && order.every((row, i) => row.cumulative !== null && (i === 0 || row.share <= order[i - 1].share + 1e-12));
    const body = make_("tbody");
    for (const row of order) {
      const tr = make_("tr", {}, make_("td", {}, onOff(row)), nameCell(row), make_("td", {}, sizeInput(row)),
        barCell(row, largest, falling ? [row.before, row.cumulative] : null),
        ...[si(row.pv), si(row.rms_raw), percent(row.share), falling ? percent(row.cumulative) : "–"]
          .map((textContent) => make_("td", { className: "number", textContent })),
        make_("td", { textContent: row.alike.join(", ") || "–" }));
      tr.dataset.row = row.term;
      body.append(tr);
    }
    const table = make_("table", { className: "ranking" }, make_("thead", {}, head), body);
    table.setAttribute("aria-label", "Error terms by what they do to the part");
    scroll.replaceChildren(...(rows.length ? [table] : [make_("p", { className: "ranking-words", textContent: "None of these terms leaves anything that could be seen on this part." })]),
      ...hiddenList(), ...leftList());
    if (focused) /** @type {HTMLElement | null} */ (el.querySelector(focused))?.focus({ preventScroll: true });
  }

  function hiddenList() {
    if (!found?.hidden.length) return [];
    const list = make_("ul", { className: "ranking-hidden" });
    for (const row of found.hidden) {
      const item = make_("li", {}, onOff(row), make_("span", {}, make_("b", { textContent: row.term }), ` ${row.words}`), sizeInput(row),
        make_("span", { className: "soft", textContent: row.why }));
      item.dataset.row = row.term;
      list.append(item);
    }
    return [make_("h2", { textContent: "Not to be seen on this part" }), list];
  }

  function leftList() {
    const steps = (found?.left ?? []).slice(1, 6).filter((/** @type {Dict} */ s) => s.names.length);
    if (!steps.length) return [];
    const list = make_("ol", { className: "ranking-left" });
    for (const step of steps) {
      const left = step.rms === 0 ? "nothing is left" : `${si(step.rms)} RMS left`;
      list.append(make_("li", {}, make_("b", { textContent: step.names.join(" + ") }), `: ${left}`));
    }
    return [make_("h2", { textContent: "Compensated one after the other" }), list];
  }

  return {
    show,
    changed(next, isNewFile) {
      if (isNewFile) {
        found = null;
        of = "";
        scroll.replaceChildren();
        bar.replaceChildren();
      } else if (of !== next.hash) {
        scroll.classList.add("outdated");
      }
    },
  };
}
