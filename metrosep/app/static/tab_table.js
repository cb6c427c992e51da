// @ts-check
// A controller's table of the recipe: its form, what the controller makes of it, and its file. The
// recipe is the only state; a controller that must be told something first waits as a draft.

import { inTarget, writeOrAsk } from "./exports.js";
import { askForm } from "./dialogs.js";
import { mendButtons } from "./mends.js";
import { dryRun, findings, make as element, preview, sign } from "./table_facts.js";
import { makeForm, missing, withController } from "./table_form.js";
import plot from "./table_plot.js";
import { makeModel, Refusal, Superseded } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

/** @param {import("./tabs.js").Context} context @returns {import("./tabs.js").Tab} */
export function make(context) {
  const { el, wire, edit, fail, written } = context;
  /** @type {{ controllers: Dict[], machine: Dict[] } | null} */
  let known = null;
  let number = 0;
  let height = "2 um";
  /** @type {Dict | null} the output as it would be */
  let draft = null;
  /** @type {Dict} */
  let header = {};
  let shownFor = ""; // what the answer on the page is of
  let busy = "";

  const state = element("span", { className: "soft", role: "status" });
  state.id = "table-state";
  const which = element("select", { ariaLabel: "Table of the recipe" });
  which.addEventListener("change", () => choose(Number(which.value)));
  const add = element("button", { type: "button", className: "small", textContent: "Add a table" });
  add.id = "table-add";
  add.addEventListener("click", append);
  const head = element("header", {}, element("h2", { textContent: "Compensation table" }), which, add,
    element("span", { className: "grow" }), state);
  const side = element("div", { className: "table-form" });
  const picture = element("div", {});
  picture.id = "table-plot";
  const facts = element("div", { className: "table-facts-all" });
  const reason = element("span", { className: "table-reason" });
  reason.id = "table-reason";
  const button = element("button", { type: "button", className: "main", textContent: "Export table…" });
  button.id = "table-export";
  button.setAttribute("aria-describedby", reason.id);
  button.addEventListener("click", () => write());
  const right = element("div", { className: "table-right" }, picture, facts,
    element("footer", { className: "table-foot" }, reason, element("span", { className: "grow" }), button));
  const empty = element("div", { className: "table-empty" });
  el.append(head, element("div", { className: "table-body" }, side, right), empty);

  const model = makeModel({ curves: null, one_column: false, message: "", is_preview: false });
  plot.render({ model, el: picture });
  const form = makeForm(side, {
    changed(name, value) {
      const now = { ...output(), [name]: value };
      if (["axis", "compensates"].includes(name)) delete now.sign_confirmed; // it was tried on others
      change(now, name);
    },
    machine(name, value, isOption) {
      const now = { ...output(), machine: { ...(output().machine ?? {}), [name]: value } };
      if (isOption) delete now.sign_confirmed; // it was tried with other facts
      change(now, name);
    },
    controller: other,
    keep: () => setDraft(null),
  });

  const session = () => context.session();
  const stored = () => (session().outputs ?? []).map((/** @type {Dict} */ o, /** @type {number} */ i) => ({ at: i, output: o }))
    .filter((/** @type {Dict} */ one) => one.output.kind === "table");
  const output = () => /** @type {Dict} */ (draft ?? stored()[number]?.output ?? {});
  const find = (/** @type {string} */ id) => known?.controllers.find((c) => c.id === id);

  // ---- changes ---------------------------------------------------------------------------------

  /** Return an output without what is left out. @param {Dict} given */
  function bare(given) {
    const out = Object.fromEntries(Object.entries(given).filter(([, v]) => v !== null && v !== undefined));
    if (out.machine) out.machine = Object.fromEntries(Object.entries(out.machine).filter(([, v]) => v !== null && v !== undefined));
    if (out.machine && !Object.keys(out.machine).length) delete out.machine;
    return out;
  }

  /** The output shall be another: one edit, with only what changed in it. @param {Dict} given @param {string} what */
  async function change(given, what) {
    const next = bare(given);
    const one = find(next.controller);
    if (one && missing(next, one).length) {
      setDraft(next);
      return;
    }
    const { at, output: old } = stored()[number];
    const isNew = draft !== null;
    draft = null;
    const edits = isNew ? [{ path: ["output", at], old, new: next }] : differences(at, old, next);
    await edit(edits, `table: ${what.replaceAll("_", " ")}`);
    drawForm(); // what was refused goes back
  }

  /** @param {number} at @param {Dict} old @param {Dict} next */
  function differences(at, old, next) {
    const edits = [];
    const same = (/** @type {any} */ a, /** @type {any} */ b) => JSON.stringify(a ?? null) === JSON.stringify(b ?? null);
    for (const key of new Set([...Object.keys(old), ...Object.keys(next)])) {
      if (same(old[key], next[key])) continue;
      if (key !== "machine" || !old.machine || !next.machine) {
        edits.push({ path: ["output", at, key], old: old[key] ?? null, new: next[key] ?? null });
        continue;
      }
      for (const name of new Set([...Object.keys(old.machine), ...Object.keys(next.machine)])) {
        if (same(old.machine[name], next.machine[name])) continue;
        edits.push({ path: ["output", at, key, name], old: old.machine[name] ?? null, new: next.machine[name] ?? null });
      }
    }
    return edits;
  }

  /** @param {string} id */
  async function other(id) {
    const next = find(id);
    const base = stored()[number]?.output;
    if (!next || !known || !base) return;
    if (id === base.controller) {
      setDraft(null);
      return;
    }
    return change(withController(base, next, find(base.controller), known.machine), `controller ${id}`);
  }

  /** @param {Dict | null} next */
  function setDraft(next) {
    draft = next;
    drawForm();
    ask();
  }

  /** @param {string} check @param {boolean} on */
  function waive(check, on) {
    const now = (output().waive ?? []).filter((/** @type {string} */ name) => name !== check);
    if (on) now.push(check);
    change({ ...output(), waive: now.length ? now : null }, `${on ? "waive" : "do not waive"} ${check}`);
  }

  async function append() {
    const n = stored().length;
    let made = header.suggested;
    if (n) {
      const last = stored()[n - 1].output;
      const [stem, suffix] = [last.path.replace(/\.[^.]*$/, ""), last.path.match(/\.[^.]*$/)?.[0] ?? ""];
      made = { ...last, path: `${stem}-${n + 1}${suffix}` };
      delete made.waive;
      delete made.sign_confirmed;
    }
    if (!made) return;
    draft = null;
    await edit([{ path: ["output", (session().outputs ?? []).length], old: null, new: made }], "add a table");
    choose(stored().length - 1);
    side.querySelector("select")?.focus();
  }

  /** @param {number} next */
  function choose(next) {
    number = Math.max(0, next);
    draft = null;
    drawForm();
    ask();
  }

  // ---- what is shown ---------------------------------------------------------------------------

  function drawForm() {
    const tables = stored();
    number = Math.min(number, Math.max(0, tables.length - 1));
    el.classList.toggle("without", tables.length === 0);
    which.hidden = tables.length < 2;
    which.replaceChildren(...tables.map((/** @type {Dict} */ one, /** @type {number} */ i) =>
      new Option(`${i + 1} of ${tables.length}: ${one.output.path}`, String(i))));
    which.value = String(number);
    if (known && tables.length) {
      form.show(output(), known.controllers, { machine: known.machine, draft: draft !== null, kept: tables[number].output.controller });
    }
  }

  function drawFacts() {
    const had = /** @type {any} */ (facts.contains(document.activeElement) ? document.activeElement : null)?.dataset?.key;
    facts.replaceChildren(
      ...dryRun(header), ...findings(header, waive, header.refused?.mends?.length ? [mendButtons(header.refused.mends, edit)] : []),
      ...sign(header, {
        height, trial: (given) => write(given),
        setHeight(given) {
          height = given;
          ask();
        },
        confirm: (on) => change({ ...output(), sign_confirmed: on ? true : null }, on ? "sign confirmed" : "sign not confirmed"),
      }),
      ...preview(header),
    );
    if (had) facts.querySelector(`[data-key="${CSS.escape(had)}"]`)?.focus();
  }

  function drawState() {
    const why = busy || (draft ? "the controller must be told more first" : "") || (stored().length ? "" : "the recipe has no table")
      || (header.refused ? refusal(header.refused) : "") || (header.preview ? "" : "nothing is computed yet");
    button.disabled = Boolean(why);
    reason.textContent = why ? `Not yet: ${why}` : "In order: dry-run passed, nothing refused.";
    reason.classList.toggle("ready", !why);
    state.textContent = busy;
    el.setAttribute("aria-busy", String(Boolean(busy)));
    facts.classList.toggle("stale", Boolean(busy));
    const trial = /** @type {any} */ (facts.querySelector("#table-trial"));
    if (trial) trial.disabled = Boolean(busy || draft);
  }

  /** @param {Dict} refused */
  function refusal(refused) {
    if (refused.check === "sign") return "its sign is not documented; try it on the machine and confirm it";
    if (refused.checks?.length) return `refused by ${refused.checks.map((/** @type {string} */ c) => `“${c}”`).join(", ")}`;
    return "it is refused, see the findings";
  }

  async function ask() {
    if (session().kind !== "runs") return;
    const wish = { output: number, trial: height, ...(draft ? { draft } : {}) };
    const of = `${session().hash} ${JSON.stringify(wish)}`;
    if (of === shownFor) return;
    if (busy) wire.cancel("table");
    shownFor = of;
    busy = "separating…";
    drawState();
    /** @type {Dict} */
    let arrays = {};
    try {
      known ??= /** @type {any} */ ((await wire.ask("controllers")).header);
      drawForm();
      const answer = await wire.ask("table", wish);
      if (of !== shownFor) return;
      ({ header, arrays } = answer);
    } catch (error) {
      if (of !== shownFor) return;
      shownFor = "";
      if (error instanceof Superseded) return; // what took its place shows itself
      header = { refused: { message: error instanceof Error ? error.message : String(error), check: "", checks: [], mends: error instanceof Refusal ? error.mends : [] } };
      if (!(error instanceof Refusal)) fail(error);
    }
    busy = "";
    model.put({
      curves: arrays.x ? arrays : null, one_column: Boolean(header.one_column), is_preview: Boolean(header.refused),
      message: arrays.x ? "" : "nothing to draw: see the findings",
    });
    drawEmpty();
    drawFacts();
    drawState();
  }

  function drawEmpty() {
    const made = header.suggested;
    empty.replaceChildren(...(made ? [
      element("p", { className: "large", textContent: "The recipe has no table yet" }),
      element("p", { textContent: `Add one: ${made.compensates} over ${made.axis}, every ${made.spacing}, as ${made.controller}. Then choose your controller.` }),
      Object.assign(element("button", { type: "button", className: "main", textContent: "Add a table" }), { onclick: append, id: "table-first" }),
    ] : header.refused ? [element("p", { textContent: header.refused.message })] : []));
    add.hidden = !stored().length;
  }

  // ---- files -----------------------------------------------------------------------------------

  /** @param {string} [trial] height of a bump instead of the table */
  async function write(trial) {
    const name = String(output().path);
    const given = await askForm({
      title: trial ? "Write a trial file" : "Export the table", ok: "Write",
      text: trial ? "One bump that tells the sign. It corrects nothing and is not for cutting." : "The table and its sidecar. Keep the two together.",
      fields: [{ name: "path", label: "File", value: inTarget(session(), trial ? `trial-${name}` : name) }],
    });
    if (given?.path) await put(given.path, trial);
  }

  /** @param {string} path @param {string | undefined} trial */
  async function put(path, trial) {
    await writeOrAsk(async (overwrite) => {
      const answer = await wire.ask("table", { output: number, write: path, hash: session().hash, overwrite, ...(trial ? { trial } : {}) }, "table write");
      const names = answer.header.files.map((/** @type {string} */ f) => f.split(/[\\/]/).pop());
      written(`written: ${names.join(", ")}`, answer.header.files);
    }, fail, /overwrite it/);
  }

  return {
    show: () => ask(),
    changed(_, isNewFile) {
      if (isNewFile) {
        number = 0;
        draft = null;
        header = {};
        shownFor = "";
        model.put({ curves: null, message: "" });
        facts.replaceChildren();
      }
      if (draft && !stored()[number]) draft = null;
      drawForm();
      drawState();
    },
    news(news) {
      if (busy && news.k === "progress" && /separat/.test(news.text ?? "")) {
        busy = `${news.text}…`;
        state.textContent = busy;
      }
    },
  };
}
