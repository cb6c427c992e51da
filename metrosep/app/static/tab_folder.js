// @ts-check
// The recipe on every file of a folder: progress while it runs, then the index, worst first.

import { inTarget } from "./exports.js";
import { si } from "./format.js";
import { VERDICTS } from "./metrics.js";

/** @typedef {Record<string, any>} Dict */

const ORDER = ["failed", "refused", "rejected", "inconclusive", "accepted", "measured", "to do", "done before", "unreadable"];
const OF_STATUS = { accepted: "accept", rejected: "reject", inconclusive: "inconclusive" };

/** @param {import("./tabs.js").Context} context @returns {import("./tabs.js").Tab} */
export function make({ el, wire, fail, written, open }) {
  /** @type {Dict | null} */
  let found = null;
  let running = 0;
  let sorted = "status";

  const form = document.createElement("form");
  form.className = "folder-form";
  const field = (/** @type {string} */ name, /** @type {string} */ label, hint = "") => {
    const input = document.createElement("input");
    Object.assign(input, { name, id: `folder-${name}`, placeholder: hint, spellcheck: false, autocomplete: "off" });
    const made = document.createElement("label");
    made.append(label, input);
    form.append(made);
    return input;
  };
  const folder = field("folder", "Folder with the files, and its subfolders");
  const pattern = field("pattern", "Names of the files");
  const out = field("out", "Folder for the results");
  const fresh = document.createElement("input");
  fresh.type = "checkbox";
  fresh.id = "folder-fresh";
  const freshLabel = document.createElement("label");
  freshLabel.className = "check";
  freshLabel.append(fresh, "do again what is done");
  const button = (/** @type {string} */ id, /** @type {string} */ text, main = false) => {
    const made = document.createElement("button");
    Object.assign(made, { type: "button", id, textContent: text, className: main ? "main" : "" });
    return made;
  };
  const start = button("folder-start", "Run", true);
  const look = button("folder-look", "Only list");
  const stop = button("folder-stop", "Stop");
  stop.hidden = true;
  const buttons = document.createElement("div");
  buttons.className = "buttons";
  buttons.append(freshLabel, look, start, stop);
  form.append(buttons);

  const bar = document.createElement("progress");
  bar.max = 1;
  bar.hidden = true;
  bar.setAttribute("aria-label", "Files done");
  const words = document.createElement("p");
  words.className = "folder-words";
  words.setAttribute("role", "status");
  const holder = document.createElement("div");
  holder.className = "scroll folder-rows";
  holder.tabIndex = -1;
  el.replaceChildren(form, bar, words, holder);

  async function run(/** @type {boolean} */ dry) {
    if (running) return;
    const asked = wire.ask("run_folder", {
      folder: folder.value.trim(), out: out.value.trim(), pattern: pattern.value.trim(), fresh: fresh.checked, dry_run: dry,
    });
    running = wire.next - 1;
    busy(true);
    words.textContent = "looking for files…";
    try {
      const { header } = await asked;
      found = header;
      written(header.files.length ? `written: index in ${header.out}` : "", header.files);
    } catch (error) {
      words.textContent = "";
      fail(error);
    } finally {
      running = 0;
      busy(false);
      draw();
    }
  }

  function busy(/** @type {boolean} */ is) {
    stop.hidden = !is;
    start.hidden = look.hidden = is;
    bar.hidden = !is;
    if (is) bar.removeAttribute("value");
  }

  function draw() {
    if (!found) {
      holder.replaceChildren();
      return;
    }
    words.textContent = [found.summary, ...found.messages].join("\n");
    const table = document.createElement("table");
    table.className = "index";
    const names = [...new Set(found.rows.flatMap((/** @type {Dict} */ row) =>
      (row.characteristics ?? []).filter((/** @type {Dict} */ c) => c.verdict).map((/** @type {Dict} */ c) => c.name)))].slice(0, 6);
    const shown = names.length ? names : [...new Set(found.rows.flatMap((/** @type {Dict} */ row) =>
      (row.characteristics ?? []).map((/** @type {Dict} */ c) => c.name)))].slice(0, 4);
    const head = table.createTHead().insertRow();
    for (const name of ["status", "unit", ...shown, "reason"]) {
      const cell = document.createElement("th");
      cell.scope = "col";
      if (sorted === name) cell.setAttribute("aria-sort", "ascending");
      const by = button("", name);
      by.className = "icon";
      by.addEventListener("click", () => {
        sorted = name;
        draw();
      });
      cell.append(by);
      head.append(cell);
    }
    const body = table.createTBody();
    for (const row of inOrder(found.rows)) body.append(line(row, shown));
    holder.replaceChildren(table);
  }

  const valueOf = (/** @type {Dict} */ row, /** @type {string} */ name) =>
    (row.characteristics ?? []).find((/** @type {Dict} */ c) => c.name === name);

  function inOrder(/** @type {Dict[]} */ rows) {
    const key = (/** @type {Dict} */ row) => {
      if (sorted === "status") return ORDER.indexOf(row.status);
      if (sorted === "unit" || sorted === "reason") return row[sorted] ?? "\uffff";
      return valueOf(row, sorted)?.value ?? Infinity;
    };
    return [...rows].sort((a, b) => {
      const [x, y] = [key(a), key(b)];
      return x < y ? -1 : x > y ? 1 : String(a.unit).localeCompare(String(b.unit), "en");
    });
  }

  function line(/** @type {Dict} */ row, /** @type {string[]} */ shown) {
    const made = document.createElement("tr");
    const status = made.insertCell();
    const verdict = /** @type {Dict} */ (OF_STATUS)[row.status];
    const failed = ["failed", "refused", "unreadable"].includes(row.status);
    status.className = `state ${verdict ?? (failed ? "reject" : "")}`;
    status.textContent = `${verdict ? VERDICTS[verdict].sign : failed ? "!" : "·"} ${row.status}${row.skipped ? ", before" : ""}`;
    const unit = made.insertCell();
    unit.className = "unit";
    const show = button("", row.unit);
    show.className = "link";
    show.title = `Open ${row.unit} with the present recipe`;
    show.addEventListener("click", () => open([`${found?.folder}/${row.unit}`], true));
    unit.append(show);
    for (const name of shown) {
      const one = valueOf(row, name);
      const cell = made.insertCell();
      cell.className = `number ${one?.verdict && one.verdict !== "accept" ? one.verdict : ""}`;
      cell.textContent = one?.value === null || one?.value === undefined ? "" : si(one.value, one.unit);
      if (one?.U) cell.title = `U ${si(one.U, one.unit)}`;
    }
    made.insertCell().textContent = row.reason ?? "";
    return made;
  }

  form.addEventListener("submit", (event) => {
    event.preventDefault();
    run(false);
  });
  start.addEventListener("click", () => run(false));
  look.addEventListener("click", () => run(true));
  stop.addEventListener("click", () => {
    words.textContent = "stopping: what is done is kept…";
    wire.cancel("run_folder");
  });

  return {
    changed(now, isNewFile) {
      if (!isNewFile) return;
      const place = String(now.home ?? "").replace(/[/\\][^/\\]*$/, "");
      const suffix = String(now.files?.[0] ?? "").match(/\.[^./\\]+$/)?.[0] ?? "";
      folder.value = place;
      pattern.value = `*${suffix}`;
      out.value = inTarget(now, "results");
      found = null;
      const sets = now.kind === "runs" && now.files.length > 1;
      words.textContent = `Carries out the present recipe on each ${sets ? "subfolder: its files are one set of runs" : "file"}, on the full data. What is done is not done again, unless file or recipe changed.`;
      draw();
    },
    news(frame) {
      const now = frame.batch;
      if (!now || !running) return;
      bar.max = now.total || 1;
      bar.value = now.done;
      const left = now.eta_s === null || now.eta_s === undefined ? "" : `, ${Math.ceil(now.eta_s)}\u2009s left`;
      words.textContent = `${now.done} of ${now.total}${left}: ${now.unit} ${now.status}${now.reason ? ` (${now.reason})` : ""}`;
    },
  };
}
