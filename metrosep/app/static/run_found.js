// @ts-check
// What a separation found about its runs: what it did about a delay of the reading, a table with one row
// and one strip for each run, and the messages.

import { plain } from "./format.js";
import { make_ } from "./run_parts.js";

/** @typedef {Record<string, any>} Dict */

const WIDE = 240;
const HIGH = 30;
const HEADS = ["run", "feed", "misfit", "gain", "u", "shift", "u"];
const TITLES = ["", "", "chi-square per degree of freedom of the run against what the others predict: 1 where the noise explains it",
  "1 where the run reads the error of the others, −1 with the opposite sign", "standard uncertainty of the gain",
  "0 where the run shows the error at the place of the others", "standard uncertainty of the shift"];

/**
 * Return the radio buttons that choose what is shown above.
 * @param {(value: string) => void} act
 * @returns {HTMLElement[]}
 */
export function choices(act) {
  return [["repeats", "repeats"], ["separated", "separated"], ["change", "before/after"], ["found", "run by run"]].map(([value, label]) => {
    const choice = make_("label", "check");
    const input = make_("input");
    Object.assign(input, { type: "radio", name: "runs-shown", value, checked: value === "repeats" });
    input.addEventListener("change", () => act(value));
    choice.append(input, ` ${label}`);
    return choice;
  });
}

/** Return a number with fixed digits and a real minus sign. @param {number | null} value @param {number} digits */
const fixed = (value, digits) => (value === null ? "–" : value.toFixed(digits).replace(/^-(?=0\.0*$)/, "").replace("-", "\u2212"));
/** Return two significant digits. @param {number | null} value */
const two = (value) => (value === null ? "–" : plain(value, 2));

/**
 * Return the strip of a run: its readings minus what the others predict.
 * @param {Dict} row
 * @param {number} limit nm at the upper edge
 * @param {[number, number]} travel mm
 */
function strip(row, limit, travel) {
  const NS = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(NS, "svg");
  for (const [k, v] of Object.entries({ viewBox: `0 0 ${WIDE} ${HIGH}`, preserveAspectRatio: "none", role: "img" })) svg.setAttribute(k, String(v));
  const known = row.strip_nm.filter((/** @type {number | null} */ v) => v !== null);
  const rms = Math.sqrt(known.reduce((/** @type {number} */ s, /** @type {number} */ v) => s + v * v, 0) / Math.max(1, known.length));
  svg.setAttribute("aria-label", `run minus what the others predict, RMS ${plain(rms, 2)} nm`);
  let path = "";
  let pen = "M";
  row.strip_nm.forEach((/** @type {number | null} */ v, /** @type {number} */ i) => {
    if (v === null) { pen = "M"; return; } // not measured: the line is broken
    const x = (row.x_mm[i] - travel[0]) / (travel[1] - travel[0]) * WIDE;
    path += `${pen}${x.toFixed(1)} ${(HIGH / 2 * (1 - v / limit)).toFixed(1)}`;
    pen = "L";
  });
  for (const [cls, d] of [["zero", `M0 ${HIGH / 2}H${WIDE}`], ["line", path]]) {
    const one = document.createElementNS(NS, "path");
    one.setAttribute("class", cls);
    one.setAttribute("d", d);
    svg.append(one);
  }
  return svg;
}

/**
 * Return what was found: sentences, the table, and what its columns are.
 * @param {Dict} found of an answer `curves`
 * @param {() => void} joint take the method that compares runs
 * @returns {HTMLElement[]}
 */
export function foundOf(found, joint) {
  const out = found.lag.map((/** @type {string[]} */ [way, phrase]) => make_("p", "", `Delay of the reading${way && `, ${way}`}: ${phrase}`));
  const said = found.messages.map((/** @type {string} */ text) => make_("p", "said", text));
  if (!found.runs.length) {
    const button = Object.assign(make_("button", "small", "Set method = joint"), { type: "button", onclick: joint });
    return [...out, ...said, make_("p", "soft", "This method does not compare the runs with one another; the joint one does."), button];
  }
  const all = found.runs.flatMap((/** @type {Dict} */ row) => row.strip_nm ?? []).filter((/** @type {number | null} */ v) => v !== null);
  const limit = Math.max(...all.map(Math.abs), 0) || 1;
  const places = found.runs.flatMap((/** @type {Dict} */ row) => row.x_mm ?? []);
  const travel = /** @type {[number, number]} */ ([Math.min(...places), Math.max(...places)]);
  const ways = new Set(found.runs.map((/** @type {Dict} */ row) => row.direction)).size > 1;
  const placed = found.runs.some((/** @type {Dict} */ row) => row.offset_mm !== null);
  const names = placed ? [...HEADS, "placed", "u"] : HEADS;
  const table = make_("table");
  const head = table.createTHead().insertRow();
  names.forEach((name, i) => {
    const cell = make_("th", i > 0 ? "number" : "", name);
    cell.scope = "col";
    cell.title = TITLES[i] ?? "fitted position offset: the run shows the error of x minus it, and was moved back by it";
    head.append(cell);
  });
  const last = make_("th", "", all.length ? `run minus what the others predict, ±${plain(limit, 2)} nm` : "");
  last.scope = "col";
  head.append(last);
  const body = table.createTBody();
  for (const row of found.runs) {
    const odd = row.finding !== "" || !row.used;
    const line = body.insertRow();
    line.classList.toggle("odd", odd);
    const name = make_("th", "", ways ? `${row.short} (${row.direction})` : row.short);
    name.scope = "row";
    name.title = row.run;
    const feed = row.feed_mm_min === null ? "–" : `${Number(row.feed_mm_min.toPrecision(6))} mm/min`;
    const shift = row.shift_mm === null ? "–" : `${fixed(row.shift_mm, 3)} mm`;
    const offset = row.offset_mm === null ? "–" : `${row.offset_mm > 0 ? "+" : ""}${fixed(row.offset_mm, 3)} mm`;
    const cells = [feed, fixed(row.misfit, 2), fixed(row.gain, 3), two(row.u_gain), shift, two(row.u_shift_mm)];
    line.append(name, ...(placed ? [...cells, offset, two(row.u_offset_mm)] : cells)
      .map((text) => make_("td", "number", text)));
    const drawn = make_("td", "strip");
    if (row.strip_nm) drawn.append(strip(row, limit, travel));
    line.append(drawn);
    if (odd) {
      const second = body.insertRow();
      second.className = "odd said";
      const cell = second.insertCell();
      cell.colSpan = names.length + 1;
      cell.textContent = `▸ ${row.short}: ${[row.used ? "" : "left out", row.finding].filter(Boolean).join("; ")}`;
    }
  }
  return [...out, table, ...said];
}
