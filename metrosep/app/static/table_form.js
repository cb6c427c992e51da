// @ts-check
// The form of a table: made from what the controller's dialect asks for. It edits one output of the
// recipe; each change is one edit. A controller that must be told something first is a draft until
// that is stated.

/** @typedef {Record<string, any>} Dict */
/** @typedef {{ name: string, label: string, value: any, kind: string, choices?: any[], help?: string, required?: boolean, hint?: string, place: string, standard?: any }} Field */

/**
 * Return the output that another controller gets: what belongs to the old one goes.
 * @param {Dict} output
 * @param {Dict} next controller
 * @param {Dict | undefined} before controller
 * @param {Dict[]} machine limits that any machine may have
 * @returns {Dict}
 */
export function withController(output, next, before, machine) {
  const shared = new Set(machine.map(({ name }) => name));
  const old = new Map((before?.options ?? []).map((/** @type {Dict} */ o) => [o.name, o]));
  for (const option of next.options) {
    // the same fact under the same name, such as the length of a count; never a sign
    if (option.kind === "length" && old.get(option.name)?.help === option.help) shared.add(option.name);
  }
  const made = /** @type {Dict} */ ({ ...output, controller: next.id });
  const kept = Object.entries(output.machine ?? {}).filter(([name]) => shared.has(name));
  if (kept.length) made.machine = Object.fromEntries(kept);
  else delete made.machine;
  delete made.waive;
  delete made.sign_confirmed; // it was tried on another controller
  if (next.carries !== "polynomial") delete made.degree;
  const suffix = before?.suffix ?? "";
  const path = String(output.path ?? "table");
  const stem = suffix && path.endsWith(suffix) ? path.slice(0, -suffix.length) : path.replace(/\.[^.]*$/, "");
  made.path = `${stem || "table"}${next.suffix}`;
  return made;
}

/**
 * Return required options that an output does not state.
 * @param {Dict} output
 * @param {Dict} controller
 * @returns {Dict[]}
 */
export function missing(output, controller) {
  return controller.options.filter((/** @type {Dict} */ o) => o.required && (output.machine?.[o.name] ?? null) === null);
}

/**
 * Return what a typed text stands for; whether it is right says the server.
 * @param {Field} field
 * @param {string} words
 * @returns {any}
 */
export function parsed(field, words) {
  const text = words.trim();
  if (text === "") return null;
  const isNumber = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(text);
  if (["integer", "number", "object", "count"].includes(field.kind) && isNumber) return Number(text);
  return text;
}

/**
 * Return the form; it is drawn anew by `show`.
 * @param {HTMLElement} el
 * @param {object} acts
 * @param {(name: string, value: any) => void} acts.changed a key of the output
 * @param {(name: string, value: any, isOption: boolean) => void} acts.machine a fact of the machine
 * @param {(id: string) => Promise<void>} acts.controller another dialect
 * @param {() => void} acts.keep give a draft up
 */
export function makeForm(el, acts) {
  let words = "";

  /** @param {Dict} output @param {Dict[]} all @param {Dict} given machine limits, draft? */
  function show(output, all, given) {
    const focus = remembered(el);
    const one = all.find(({ id }) => id === output.controller);
    el.replaceChildren();
    el.append(...chooser(output, all, one, given));
    if (one) {
      const fields = ofTable(output, one);
      const rows = [fields.flatMap((field) => row(field)), ofOptions(output, one)];
      el.append(...(given.draft ? rows.reverse() : rows).flat()); // what a draft asks for comes first
      el.append(more("Limits of the machine", given.machine.map((/** @type {Dict} */ o) => asField(o, output, "limit"))));
      el.append(facts(one));
    }
    restore(el, focus);
  }

  /** Go to what must be stated first. */
  function toMissing() {
    /** @type {HTMLElement | null} */ (el.querySelector("label:has(.missing) + *"))?.focus();
  }

  /** @param {Dict} output @param {Dict[]} all @param {Dict | undefined} one @param {Dict} given */
  function chooser(output, all, one, given) {
    const head = document.createElement("div");
    head.className = "table-controller";
    const label = document.createElement("label");
    label.textContent = "Controller";
    label.htmlFor = "table-controller";
    const search = /** @type {HTMLInputElement} */ (Object.assign(document.createElement("input"), {
      type: "search", placeholder: "search, such as pmac", value: words, spellcheck: false,
    }));
    search.dataset.key = "search";
    search.setAttribute("aria-label", "Search controllers");
    const select = document.createElement("select");
    select.id = "table-controller";
    select.dataset.key = "controller";
    const fill = () => {
      const wanted = words.trim().toLowerCase();
      const found = all.filter(({ id, title }) => id === output.controller || !wanted || `${id} ${title}`.toLowerCase().includes(wanted));
      select.replaceChildren(...[["table", "tables"], ["polynomial", "polynomials"], ["map", "maps: not for one axis"]].flatMap(([carries, title]) => {
        const own = found.filter((c) => c.carries === carries);
        if (!own.length) return [];
        const group = document.createElement("optgroup");
        group.label = title;
        group.append(...own.map((c) => Object.assign(document.createElement("option"), {
          value: c.id, textContent: `${c.id} · ${c.title}`, disabled: !c.fits, title: c.why,
        })));
        return [group];
      }));
      select.value = output.controller;
    };
    fill();
    search.addEventListener("input", () => {
      words = search.value;
      fill();
    });
    search.addEventListener("keydown", (event) => {
      if (event.key !== "Enter") return;
      const first = [...select.options].find((o) => !o.disabled && o.value !== output.controller);
      if (words.trim() && first) {
        words = "";
        acts.controller(first.value).then(toMissing);
      }
    });
    select.addEventListener("change", () => {
      words = "";
      acts.controller(select.value);
    });
    head.append(label, select, search);
    if (one) head.append(note(`${one.title}: ${one.carries}`));
    if (given.draft) {
      const box = document.createElement("div");
      box.className = "table-draft";
      const asked = one ? missing(output, one) : [];
      box.append(note(`${output.controller} must be told first: ${asked.map(({ name }) => name.replaceAll("_", " ")).join(", ")}. Then it becomes part of the recipe.`));
      const back = Object.assign(document.createElement("button"), { type: "button", className: "small", textContent: `Keep ${given.kept}` });
      back.addEventListener("click", acts.keep);
      box.append(back);
      head.append(box);
    }
    return [head];
  }

  /** @param {Dict} output @param {Dict} one @returns {Field[]} */
  function ofTable(output, one) {
    const key = (/** @type {string} */ name, /** @type {Partial<Field>} */ rest) => /** @type {Field} */ ({
      name, label: name.replaceAll("_", " "), value: output[name], kind: "text", place: "output", ...rest,
    });
    return [
      key("axis", { required: true, help: "its position is looked up" }),
      key("compensates", { help: "is corrected: the same axis for positioning, the one across for straightness", hint: output.axis }),
      ...(one.carries === "polynomial"
        ? [key("degree", { kind: "integer", hint: "chosen by the data", help: "degree of the polynomial" })]
        : [
          key("spacing", { kind: "count", required: true, help: "distance with its unit, or number of entries", hint: "0.5 mm" }),
          key("direction", { kind: "choice", choices: ["auto", "both", "split", "forward", "reverse"], standard: "auto", help: "one column, or one each way" }),
          key("reference", { hint: "0 mm", help: "position where the correction is zero" }),
        ]),
      key("path", { required: true, label: "file name", help: "of what a run of the recipe writes" }),
    ];
  }

  /** @param {Dict} output @param {Dict} one @returns {Node[]} */
  function ofOptions(output, one) {
    const fields = one.options.map((/** @type {Dict} */ o) => asField(o, output, "option"));
    const first = fields.filter((/** @type {Field} */ f) => f.required || f.value !== undefined);
    const rest = fields.filter((/** @type {Field} */ f) => !first.includes(f));
    const head = document.createElement("h2");
    head.textContent = `Facts for ${one.id}`;
    return [...(fields.length ? [head] : []), ...first.flatMap(row), ...(rest.length ? [more(`${rest.length} more facts`, rest)] : [])];
  }

  /** @param {Dict} option @param {Dict} output @param {string} place @returns {Field} */
  function asField(option, output, place) {
    return {
      name: option.name, label: option.name.replaceAll("_", " "), value: output.machine?.[option.name],
      kind: option.kind, choices: option.choices, help: option.help, required: option.required, place,
      hint: option.usual || (option.unit ? `such as ${option.unit}` : ""), standard: option.default,
    };
  }

  function put(/** @type {Field} */ field, /** @type {any} */ value) {
    if (field.place === "output") acts.changed(field.name, value);
    else acts.machine(field.name, value, field.place === "option");
  }

  /** @param {Field} field @returns {HTMLElement[]} */
  function row(field) {
    const label = document.createElement("label");
    const id = `table-${field.place}-${field.name}`;
    label.htmlFor = id;
    label.append(field.label);
    if (field.required) label.append(mark(field.value === undefined || field.value === ""));
    const input = field.kind === "flag" ? flag(field) : field.kind === "choice" ? choice(field) : text(field);
    input.id = id;
    input.dataset.key = `${field.place} ${field.name}`;
    if (field.required) input.setAttribute("aria-required", "true");
    const help = note(field.help ?? "");
    help.id = `${id}-help`;
    input.setAttribute("aria-describedby", help.id);
    return [label, input, help];
  }

  /** @param {Field} field */
  function flag(field) {
    const input = Object.assign(document.createElement("input"), { type: "checkbox", checked: Boolean(field.value ?? field.standard) });
    input.addEventListener("change", () => put(field, input.checked === Boolean(field.standard) ? null : input.checked));
    return input;
  }

  /** @param {Field} field */
  function choice(field) {
    const input = document.createElement("select");
    const free = field.standard === null || field.standard === undefined;
    if (free) input.add(new Option(field.required ? "choose…" : "–", ""));
    for (const one of field.choices ?? []) input.add(new Option(one === field.standard ? `${one} (usual)` : String(one), String(one)));
    input.value = String(field.value ?? (free ? "" : field.standard));
    input.addEventListener("change", () => {
      const found = (field.choices ?? []).find((one) => String(one) === input.value);
      put(field, found === undefined || (!field.required && found === field.standard) ? null : found);
    });
    return input;
  }

  /** @param {Field} field */
  function text(field) {
    const before = field.value === undefined || field.value === null ? "" : String(field.value);
    const input = Object.assign(document.createElement("input"), {
      type: "text", value: before, placeholder: field.hint ?? "", spellcheck: false, autocomplete: "off",
    });
    input.dataset.before = before;
    let sent = before;
    const send = () => {
      if (input.value.trim() === sent) return;
      sent = input.value.trim();
      input.dataset.before = input.value; // what is refused goes back to what the recipe says
      put(field, parsed(field, input.value));
    };
    input.addEventListener("change", send);
    input.addEventListener("keydown", (event) => {
      if (event.key === "Enter") send();
      if (event.key === "Escape") input.value = before;
    });
    return input;
  }

  /** @param {string} title @param {Field[]} fields */
  function more(title, fields) {
    const details = document.createElement("details");
    details.dataset.key = title;
    details.open = fields.some((field) => field.value !== undefined) || opened.has(title);
    details.addEventListener("toggle", () => (details.open ? opened.add(title) : opened.delete(title)));
    const head = Object.assign(document.createElement("summary"), { textContent: title });
    const inner = document.createElement("div");
    inner.className = "table-fields";
    inner.append(...fields.flatMap(row));
    details.append(head, inner);
    return details;
  }
  /** @type {Set<string>} */
  const opened = new Set();

  /** @param {Dict} one */
  function facts(one) {
    const details = document.createElement("details");
    const list = document.createElement("ul");
    list.className = "table-facts";
    list.append(...[...one.limits, ...one.notes].map((said) => Object.assign(document.createElement("li"), { textContent: said })));
    details.append(Object.assign(document.createElement("summary"), { textContent: `About ${one.id}` }), list);
    details.open = opened.has("about");
    details.addEventListener("toggle", () => (details.open ? opened.add("about") : opened.delete("about")));
    return details;
  }

  return { show };
}

function note(/** @type {string} */ words) {
  return Object.assign(document.createElement("p"), { className: "table-help", textContent: words });
}

/** @param {boolean} isMissing */
function mark(isMissing) {
  const el = document.createElement("span");
  el.className = isMissing ? "needed missing" : "needed";
  el.textContent = isMissing ? " needed" : " *";
  el.title = "must be stated";
  return el;
}

/** What the user is at, so that drawing the form anew does not take it away. @param {HTMLElement} el */
function remembered(el) {
  const at = /** @type {any} */ (document.activeElement);
  if (!el.contains(at) || !at.dataset?.key) return null;
  const dirty = "before" in at.dataset && at.value !== at.dataset.before;
  return { key: at.dataset.key, value: dirty ? at.value : null, from: at.selectionStart ?? null, to: at.selectionEnd ?? null };
}

/** @param {HTMLElement} el @param {ReturnType<typeof remembered>} focus */
function restore(el, focus) {
  if (!focus) return;
  const at = /** @type {any} */ (el.querySelector(`[data-key="${CSS.escape(focus.key)}"]`));
  if (!at) return;
  at.focus();
  if (focus.value !== null && at.dataset.before !== focus.value) at.value = focus.value;
  if (focus.from !== null && at.setSelectionRange && at.type === "text") at.setSelectionRange(focus.from, focus.to);
}
