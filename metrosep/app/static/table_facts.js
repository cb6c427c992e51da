// @ts-check
// What is known of a table before it is written: the dry-run, findings with waivers, the sign, the
// bytes. Numbers and sentences are the server's.

import { si } from "./format.js";

/** @typedef {Record<string, any>} Dict */

/**
 * @param {string} tag
 * @param {Dict} [properties]
 * @param {(Node | string)[]} children
 * @returns {any}
 */
export function make(tag, properties = {}, ...children) {
  const { dataset, ...rest } = properties;
  const el = Object.assign(document.createElement(tag), rest);
  Object.assign(el.dataset, dataset ?? {});
  el.append(...children);
  return el;
}

/** @param {string} title @param {Node[]} children */
function block(title, ...children) {
  const el = make("section", { className: "table-block" }, make("h2", { textContent: title }), ...children);
  el.setAttribute("aria-label", title);
  return el;
}

/** @param {string} state good, bad or open @param {string} icon @param {string} words */
function chip(state, icon, words) {
  return make("span", { className: `table-chip ${state}` }, make("span", { className: "sign", textContent: icon }), ` ${words}`);
}

/** @param {number | null} value @param {number | null | undefined} U */
function withU(value, U) {
  return make("td", {}, si(value), ...(U ? [make("small", { textContent: `U ${si(U, "m", 2)}` })] : []));
}

/**
 * Return the block of the dry-run.
 * @param {Dict} header
 * @returns {HTMLElement[]}
 */
export function dryRun(header) {
  const said = header.verification;
  if (!said?.residuals) return [];
  const rows = said.residuals.map((/** @type {Dict} */ r) => make("tr", { dataset: { direction: r.direction } },
    make("th", { scope: "row", textContent: `${r.direction}, ${r.n_runs} runs` }),
    withU(r.before_pv_m, r.U_before_pv_m), withU(r.after_pv_m, r.U_after_pv_m),
    withU(r.before_rms_m, r.U_before_rms_m), withU(r.after_rms_m, r.U_after_rms_m),
    make("td", { className: "soft", textContent: si(r.wrong_sign_rms_m) })));
  const head = (/** @type {string} */ words, /** @type {Dict} */ more = {}) => make("th", { scope: "col", textContent: words, ...more });
  const table = make("table", { className: "table-dry-run" },
    make("thead", {}, make("tr", {}, head("direction"), head("P-V before"), head("P-V after"), head("RMS before"), head("RMS after"),
      head("RMS, sign reversed"))), make("tbody", {}, ...rows));
  const span = said.span_m.map((/** @type {number} */ v) => si(v)).join(" to ");
  const lost = said.lost_motion;
  return [block("Dry-run of these bytes", chip(said.passed ? "good" : "bad", said.passed ? "✓" : "✗",
    said.passed ? "the error shrinks in every direction" : "the error does not shrink"), table,
  make("p", { className: "table-help", textContent: `${span}; ${said.definition}. ${said.removed === "line" ? "Line" : "Offset"} removed. U: k = ${said.k}.` }),
  ...(lost ? [make("p", { className: "table-help", textContent: `lost motion ${si(lost.before_m)} before, ${si(lost.after_m)} after` })] : []),
  ...(said.not_verified?.length ? [make("p", { className: "table-help", textContent: `not verified, no run went this way: ${said.not_verified.join(", ")}` })] : []))];
}

/**
 * Return the block of the findings.
 * @param {Dict} header
 * @param {(check: string, on: boolean) => void} waive
 * @param {Node[]} mends what may be done about a refusal
 * @returns {HTMLElement[]}
 */
export function findings(header, waive, mends) {
  const found = header.findings ?? [];
  const refused = header.refused;
  const items = found.map((/** @type {Dict} */ f) => {
    const [state, icon, word] = f.level !== "error" ? ["open", "△", "Warning"] : f.waived ? ["open", "!", "Waived"] : ["bad", "✗", "Refused"];
    const item = make("li", { dataset: { check: f.check } }, chip(state, icon, word), make("code", { textContent: f.check }),
      make("p", { textContent: f.fix ? `${f.problem}: ${f.fix}` : f.problem }));
    if (f.waivable) {
      const box = make("input", { type: "checkbox", checked: f.waived, dataset: { key: `waive ${f.check}` } });
      box.addEventListener("change", () => waive(f.check, box.checked));
      item.append(make("label", { className: "check" }, box, `waive “${f.check}”: ${f.about}`));
    }
    return item;
  });
  const inside = found.some((/** @type {Dict} */ f) => f.level === "error" && refused?.checks?.includes(f.check));
  if (refused && !inside) {
    items.unshift(make("li", { dataset: { check: refused.check } }, chip("bad", "✗", "Refused"),
      make("code", { textContent: refused.check }), make("p", { textContent: refused.message })));
  }
  if (!items.length) return [block("Findings", chip("good", "✓", "nothing to complain about"))];
  return [block("Findings", make("ul", { className: "table-findings" }, ...items), ...mends)];
}

/**
 * Return the block of the sign.
 * @param {Dict} header
 * @param {object} acts
 * @param {string} acts.height of the bump
 * @param {(height: string) => void} acts.setHeight
 * @param {(height: string) => void} acts.trial
 * @param {(on: boolean) => void} acts.confirm
 * @returns {HTMLElement[]}
 */
export function sign(header, { height, setHeight, trial, confirm }) {
  const said = header.sign;
  if (!said) return [];
  const [state, icon, word] = !said.needs_trial ? ["good", "✓", said.status] : said.confirmed
    ? ["open", "!", "confirmed by you on the machine"] : ["bad", "✗", "not documented"];
  const parts = [chip(state, icon, `Sign: ${word}`), make("p", { textContent: said.words })];
  const procedure = make("div", { className: "table-trial" });
  if (said.trial_possible) {
    const input = make("input", { type: "text", value: height, spellcheck: false, dataset: { key: "trial" } });
    input.addEventListener("change", () => setHeight(input.value.trim()));
    const button = make("button", { type: "button", textContent: "Write a trial file…" });
    button.id = "table-trial";
    button.addEventListener("click", () => trial(input.value.trim()));
    const told = header.trial ?? {};
    procedure.append(
      ...(told.instruction ? [make("ol", {}, ...[told.instruction, told.if_right, told.if_wrong].map((words) => make("li", { textContent: words })))] : []),
      ...(told.refused ? [make("p", { textContent: told.refused })] : []),
      make("div", { className: "table-trial-row" }, make("label", {}, "Height of the bump ", input), button),
    );
  }
  if (said.needs_trial) {
    const box = make("input", { type: "checkbox", checked: said.confirmed, dataset: { key: "confirmed" } });
    box.id = "table-confirmed";
    box.addEventListener("change", () => confirm(box.checked));
    parts.push(procedure, make("label", { className: "check" }, box, "sign confirmed on the machine"));
  } else if (said.trial_possible) {
    parts.push(make("details", {}, make("summary", { textContent: "Try it all the same" }), procedure));
  }
  return [block("Sign", ...parts)];
}

/**
 * Return the block of the bytes.
 * @param {Dict} header
 * @returns {HTMLElement[]}
 */
export function preview(header) {
  const said = header.preview;
  const facts = about(header);
  if (!said) {
    return [block("File", ...facts, make("p", { className: "table-help", textContent: "There is no file: a run of the recipe would write nothing." }))];
  }
  const { lines, after, left_out: out } = said;
  const all = out ? [...lines.slice(0, after), `⋯ ${out} more lines ⋯`, ...lines.slice(after)] : lines;
  const pre = make("pre", { tabIndex: 0, textContent: all.join("\n") });
  pre.setAttribute("aria-label", `First and last lines of ${header.name}`);
  const sha = make("span", { className: "table-hash", title: header.sha256, textContent: `SHA-256 ${header.sha256.slice(0, 16)}…` });
  return [block(`File ${header.name}`, ...facts,
    make("p", { className: "table-help" }, `${said.n_lines} lines, ${said.n_bytes} bytes, `, sha), pre)];
}

/** @param {Dict} header @returns {HTMLElement[]} */
function about(header) {
  const words = [];
  if (header.n_points) {
    words.push(`${header.n_points} entries`);
    words.push(`${header.is_uniform ? "every" : "about every"} ${si(header.spacing_m)}`);
    words.push(`largest ${si(header.largest_m)}`);
    words.push(header.one_column ? "one column for both directions" : "forward and reverse apart");
  } else if (header.degree !== undefined) words.push(`polynomial of degree ${header.degree}`);
  const span = (/** @type {number[]} */ ends) => ends.map((v) => si(v)).join(" to ");
  if (header.held_m) {
    words.push(`holds ${span(header.held_m)}`);
    if (span(header.held_m) !== span(header.span_m)) words.push(`measured ${span(header.span_m)}`);
  }
  if (header.facts?.quantisation_m > 0) words.push(`rounding up to ${si(header.facts.quantisation_m, "m", 2)}`);
  return words.length ? [make("p", { className: "table-about", textContent: words.join(" · ") })] : [];
}
