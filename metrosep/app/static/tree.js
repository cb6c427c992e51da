// @ts-check
// The steps: on and off, order, removal, addition, and the editor of the chosen one.

import { makeEditor, strayKeys } from "./editor.js";
import { mendButtons } from "./mends.js";
import { freshStep, ownSize, reordered, storedSteps, summary, switched } from "./recipe.js";

/** @typedef {Record<string, any>} Dict */

/**
 * Return the tree.
 * @param {HTMLElement} el
 * @param {object} options
 * @param {(edits: import("./recipe.js").Edit[], label: string) => void} options.edit
 * @param {(stage: number) => void} options.choose -2 measured, -1 all steps, else the step
 * @param {() => number} options.size of what was measured, m
 * @param {() => number} options.middle of it along x, m
 */
export function makeTree(el, { edit, choose, size, middle }) {
  /** @type {Dict | null} */
  let session = null;
  /** @type {Dict[]} */
  let schema = [];
  let chosen = -1;
  let seen = -1;
  /** @type {{ index: number, message: string, mends?: Dict[] } | null} */
  let failed = null;
  /** @type {Map<number, string[]>} */
  let notes = new Map();

  function pick(/** @type {number} */ stage) {
    chosen = stage;
    draw();
    choose(stage);
  }

  function button(/** @type {string} */ text, /** @type {string} */ title, /** @type {() => void} */ act, off = false) {
    const made = document.createElement("button");
    made.type = "button";
    made.className = "icon";
    made.textContent = text;
    made.title = title;
    made.setAttribute("aria-label", title);
    made.disabled = off;
    made.addEventListener("click", act);
    return made;
  }

  function source() {
    const item = document.createElement("li");
    item.className = `step${chosen === -2 ? " chosen" : ""}`;
    const row = document.createElement("div");
    row.className = "step-row";
    const open = document.createElement("button");
    open.type = "button";
    open.className = "pick";
    open.setAttribute("aria-pressed", String(chosen === -2));
    const name = document.createElement("b");
    name.textContent = "measured";
    const words = document.createElement("span");
    words.textContent = "before all steps";
    open.append(name, words);
    open.addEventListener("click", () => pick(chosen === -2 ? -1 : -2));
    row.append(open);
    item.append(row);
    return item;
  }

  function item(/** @type {Dict} */ step, /** @type {Dict[]} */ stored) {
    const i = step.index;
    const el_ = document.createElement("li");
    const fails = failed?.index === i;
    el_.className = ["step", chosen === i && "chosen", fails && "failed", !step.enabled && "off"].filter(Boolean).join(" ");
    el_.dataset.step = String(i);
    const row = document.createElement("div");
    row.className = "step-row";
    const on = document.createElement("input");
    on.type = "checkbox";
    on.checked = step.enabled;
    on.setAttribute("aria-label", `Step ${i + 1}, ${step.op}: on`);
    on.title = step.enabled ? "On; click to skip this step" : "Skipped; click to carry it out";
    on.addEventListener("change", () =>
      edit([switched(stored[i], i, on.checked)], `${on.checked ? "switch on" : "switch off"} ${step.op}`));
    const open = document.createElement("button");
    open.type = "button";
    open.className = "pick";
    open.setAttribute("aria-expanded", String(chosen === i));
    const name = document.createElement("b");
    name.textContent = `${i + 1} ${step.op}`;
    const words = document.createElement("span");
    words.textContent = summary(step);
    open.title = `${schema.find((one) => one.op === step.op)?.what ?? step.op}${words.textContent ? ` (${words.textContent})` : ""}`;
    open.append(name, words);
    open.addEventListener("click", () => pick(chosen === i ? -1 : i));
    const tools = document.createElement("span");
    tools.className = "tools";
    tools.append(
      button("↑", `Move step ${i + 1} up`, () => move(i, i - 1), i === 0),
      button("↓", `Move step ${i + 1} down`, () => move(i, i + 1), i === stored.length - 1),
      button("✕", `Remove step ${i + 1}`, () => {
        const next = stored.filter((_, k) => k !== i);
        if (chosen >= next.length || chosen === i) chosen = -1;
        edit([{ path: ["step", i], old: stored[i], new: null }], `remove ${step.op}`);
      }),
    );
    const hit = document.createElement("label"); // a target of 24 px about the box
    hit.className = "hit";
    hit.append(on);
    row.append(hit, open, tools);
    el_.append(row);
    if (fails || step.message) {
      const why = document.createElement("p");
      why.className = "why";
      why.textContent = fails ? failed?.message ?? "" : step.message;
      el_.append(why);
      if (fails && failed?.mends?.length) el_.append(mendButtons(failed.mends, edit));
    }
    if (chosen === i) {
      const keys = schema.find((one) => one.op === step.op)?.keys ?? [];
      el_.append(makeEditor(keys, step.keys, (key, value) => {
        const edits = [{ path: ["step", i, key], old: step.keys[key] ?? null, new: value }];
        // another kind of filter does not know the keys of the one before, and needs a size of its own
        for (const stray of step.op === "filter" && key === "kind" ? strayKeys(value ?? "gaussian", step.keys) : []) {
          edits.push({ path: ["step", i, stray], old: step.keys[stray], new: null });
        }
        const own = edits.length > 1 ? ownSize(value ?? "gaussian", step.keys, freshStep("filter", session?.kind, size()).lambda_c) : null;
        if (own) edits.push({ path: ["step", i, own[0]], old: null, new: own[1] });
        edit(edits, `${step.op}: ${key}`);
      }));
      for (const text of notes.get(i) ?? []) {
        const note = document.createElement("p");
        note.className = "note";
        note.textContent = text;
        el_.append(note);
      }
    }
    return el_;
  }

  function move(/** @type {number} */ from, /** @type {number} */ to) {
    if (!session) return;
    const before = storedSteps(session);
    const after = [...before];
    after.splice(to, 0, ...after.splice(from, 1));
    if (chosen === from) chosen = to;
    edit(reordered(before, after), `move ${before[from].op}`);
  }

  function add(/** @type {string} */ op) {
    if (!session) return;
    chosen = insert(freshStep(op, session.kind, size(), middle()), `add ${op}`);
    choose(chosen);
  }

  /** Add a step after the chosen one; return its number. */
  function insert(/** @type {Dict} */ fresh, /** @type {string} */ label) {
    const before = storedSteps(session ?? {});
    const evaluates = (/** @type {Dict} */ s) => schema.find((one) => one.op === s.op)?.evaluates ?? false;
    let at = chosen >= 0 ? chosen + 1 : before.length;
    // what changes the map goes above the evaluations at the end: one map is shown and judged
    if (!evaluates(fresh)) at = Math.min(at, before.findLastIndex((s) => !evaluates(s)) + 1);
    edit(reordered(before, [...before.slice(0, at), fresh, ...before.slice(at)]), label);
    return at;
  }

  function adder() {
    const el_ = document.createElement("div");
    el_.className = "add-step";
    const select = document.createElement("select");
    select.id = "add-step";
    select.setAttribute("aria-label", "Add a step");
    select.title = "Add a step after the chosen one";
    select.add(new Option("+ add step…", ""));
    const fits = { map: "Surface", profile: "Profile", runs: "runs" }[session?.kind ?? ""] ?? "";
    if (!fits) return el_;
    for (const one of schema.filter((step) => step.applies.includes(fits))) {
      if (one.op === "mask") select.add(new Option("crop: keep a rectangle of a map, a piece of a profile", "crop"));
      select.add(new Option(`${one.op}: ${one.what}`, one.op));
    }
    select.addEventListener("change", () => {
      const op = select.value;
      select.value = "";
      if (op) add(op);
    });
    select.style.width = "100%";
    el_.append(select);
    return el_;
  }

  function draw() {
    if (!session?.recipe) {
      el.replaceChildren();
      return;
    }
    const active = /** @type {HTMLElement | null} */ (document.activeElement);
    const had = active && el.contains(active) ? place(active) : null;
    const opened = el.querySelector("details")?.open ?? false;
    const scrolled = el.scrollTop;
    const stored = storedSteps(session);
    const list = document.createElement("ol");
    list.className = "steps";
    list.append(...(["map", "profile"].includes(session.kind) ? [source()] : []), ...session.steps.map((/** @type {Dict} */ step) => item(step, stored)));
    el.replaceChildren(list, adder());
    const details = el.querySelector("details");
    if (details) details.open = opened;
    el.scrollTop = scrolled;
    if (had) again(had);
    if (chosen !== seen) {
      seen = chosen;
      el.querySelector(".chosen")?.scrollIntoView({ block: "nearest" });
    }
  }

  // The list is drawn anew after each edit: the focus goes back to where it was.
  function place(/** @type {HTMLElement} */ active) {
    const step = /** @type {HTMLElement | null} */ (active.closest("[data-step]"));
    return { id: active.id.startsWith("field-") ? "" : active.id, step: step?.dataset.step, key: active.dataset.key,
      label: active.getAttribute("aria-label"), pick: active.classList.contains("pick") };
  }
  function again(/** @type {any} */ was) {
    const within = was.step === undefined ? el : el.querySelector(`[data-step="${was.step}"]`) ?? el;
    const found = was.id ? document.getElementById(was.id)
      : was.key ? within.querySelector(`[data-key="${was.key}"]`)
        : was.label ? within.querySelector(`[aria-label="${CSS.escape(was.label)}"]`)
          : within.querySelector(".pick");
    /** @type {HTMLElement | null} */ (found ?? within.querySelector(".pick"))?.focus({ preventScroll: true });
  }

  return {
    insert,
    /** @param {Dict} next @param {Dict[]} steps */
    show(next, steps) {
      session = next;
      schema = steps;
      if (chosen >= next.steps.length) chosen = -1;
      draw();
    },
    /** @param {{ index: number, message: string } | null} which @param {Map<number, string[]>} said */
    tell(which, said) {
      if (JSON.stringify(which) === JSON.stringify(failed) && JSON.stringify([...said]) === JSON.stringify([...notes])) return;
      failed = which;
      notes = said;
      draw();
    },
    get chosen() {
      return chosen;
    },
    /** Show a stage again. @param {number} stage */
    go(stage) {
      if (stage === chosen || stage >= (session?.steps.length ?? 0)) return;
      chosen = stage;
      draw();
    },
    reset() {
      chosen = -1;
      failed = null;
      notes = new Map();
    },
  };
}
