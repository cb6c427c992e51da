// @ts-check
// The form of a step, made from its schema: a new kind of step gets its form for nothing.

import { makeForms } from "./forms.js";

/** @typedef {Record<string, any>} Dict */

let serial = 0;

/** How the words of a key begin that only some methods know. */
const ONLY = /^([\w ]+) only: /;

/** Menus of the server: forms, and the keys of each filter. @type {Dict} */
let menus = { forms: [], filters: {} };
/** @param {Dict} given */
export const takeMenus = (given) => void (menus = given);

/** Forms stand in the recipe as a text; here they are chosen. @param {Dict} key */
const isForm = (key) => key.name === "form" && key.kind === "text" && key.required && menus.forms.length > 0;

/**
 * Return the keys of a filter that its kind does not know, of those that are given.
 * @param {string} kind
 * @param {Dict} values
 */
export const strayKeys = (kind, values) => Object.keys(values).filter((k) => k !== "kind" && menus.filters[kind] && !menus.filters[kind].includes(k));

/**
 * Return the editor of a step.
 * @param {Dict[]} keys of the schema
 * @param {Dict} values of the step, as the recipe has them
 * @param {(key: string, value: any) => void} changed value null: left out
 * @returns {HTMLElement}
 */
export function makeEditor(keys, values, changed) {
  const el = document.createElement("div");
  el.className = "editor";
  const isFilter = keys.some((key) => key.name === "lambda_s");
  const ofKind = isFilter ? menus.filters[values.kind ?? "gaussian"] : null;
  const known = keys.filter((key) => key.name !== "enabled" && (!ofKind || key.name === "kind" || ofKind.includes(key.name) || key.name in values));
  const method = known.find((key) => key.name === "method");
  const own = method && known.some((key) => ONLY.test(key.help ?? "")) ? ofMethod(known, String(values.method ?? method.default ?? "")) : [];
  const first = known.filter((key) => key.required || key.name in values || own.includes(key));
  const main = first.length ? first : known.slice(0, 2);
  const rest = known.filter((key) => !main.includes(key));
  for (const key of main) addField(el, key, values[key.name], (value) => changed(key.name, value));
  if (rest.length) {
    const details = document.createElement("details");
    const head = document.createElement("summary");
    head.textContent = `${rest.length} more`;
    const inner = document.createElement("div");
    for (const key of rest) addField(inner, key, values[key.name], (value) => changed(key.name, value));
    details.append(head, inner);
    el.append(details);
  }
  return el;
}

/**
 * Return the keys that a method knows; those that are for other methods say it: "kono only: ...".
 * @param {Dict[]} keys
 * @param {string} method
 */
export function ofMethod(keys, method) {
  return keys.filter((key) => {
    const only = ONLY.exec(key.help ?? "");
    return !only || only[1].split(" and ").includes(method);
  });
}

/**
 * @param {HTMLElement} el
 * @param {Dict} key
 * @param {any} value
 * @param {(value: any) => void} changed
 */
function addField(el, key, value, changed) {
  if (key.kind === "table" && key.keys.length) {
    const group = document.createElement("fieldset");
    const legend = document.createElement("legend");
    legend.textContent = key.name;
    legend.title = key.help;
    group.append(legend);
    const now = { ...(value ?? {}) };
    for (const inner of key.keys) {
      addField(group, inner, now[inner.name], (given) => {
        const next = { ...now };
        if (given === null) delete next[inner.name];
        else next[inner.name] = given;
        changed(Object.keys(next).length ? next : null);
      });
    }
    el.append(group);
    return;
  }
  if (isForm(key)) {
    el.append(makeForms(menus.forms, String(value ?? ""), changed));
    return;
  }
  const id = `field-${(serial += 1)}`;
  const label = document.createElement("label");
  label.htmlFor = id;
  label.textContent = key.name.replace("lambda_", "λ").replaceAll("_", " ");
  label.title = key.help;
  const input = key.kind === "flag" ? flag(key, value, changed)
    : key.choices.length ? choice(key, value, changed)
      : text(key, value, changed);
  input.id = id;
  input.dataset.key = key.name;
  input.title = key.help;
  el.append(label, input);
}

/** @param {Dict} key @param {any} value @param {(value: any) => void} changed */
function flag(key, value, changed) {
  const input = document.createElement("input");
  input.type = "checkbox";
  input.checked = value ?? key.default ?? false;
  input.style.justifySelf = "start";
  input.addEventListener("change", () => changed(input.checked === (key.default ?? false) ? null : input.checked));
  return input;
}

/** @param {Dict} key @param {any} value @param {(value: any) => void} changed */
function choice(key, value, changed) {
  const input = document.createElement("select");
  if (!key.required && (key.default === null || key.default === undefined)) input.add(new Option("–", ""));
  for (const one of key.choices) {
    input.add(new Option(one === key.default ? `${one} (usual)` : String(one), String(one)));
  }
  input.value = String(value ?? key.default ?? (key.required ? key.choices[0] : ""));
  input.addEventListener("change", () => {
    const found = key.choices.find((/** @type {any} */ one) => String(one) === input.value);
    changed(found === undefined || (!key.required && found === key.default) ? null : found);
  });
  return input;
}

/** @param {Dict} key @param {any} value @param {(value: any) => void} changed */
function text(key, value, changed) {
  const lines = key.kind === "table";
  const input = document.createElement(lines ? "textarea" : "input");
  if (input instanceof HTMLInputElement) {
    input.type = "text";
    input.spellcheck = false;
    input.autocomplete = "off";
  } else {
    input.rows = Math.max(1, Object.keys(value ?? {}).length);
    input.spellcheck = false;
  }
  input.placeholder = key.default !== null && key.default !== undefined ? String(key.default) : hint(key);
  const before = shown(key, value);
  input.value = before;
  input.addEventListener("change", () => {
    if (input.value.trim() !== before.trim()) changed(parsed(key, input.value.trim()));
  });
  input.addEventListener("keydown", (event) => {
    const pressed = /** @type {KeyboardEvent} */ (event);
    if (pressed.key === "Enter" && !lines) input.blur();
    if (pressed.key === "Escape") {
      input.value = before;
      input.blur();
    }
  });
  return input;
}

/** @param {Dict} key */
function hint(key) {
  if (key.kind === "table") return "name = value, one a line";
  if (key.kind === "lengths") return "1.5 mm, 2 mm";
  if (key.kind === "texts") return "separated by commas";
  if (key.dimension === "length") return "such as 0.8 mm";
  return "";
}

/** @param {Dict} key @param {any} value */
function shown(key, value) {
  if (value === null || value === undefined) return "";
  if (Array.isArray(value)) return value.join(", ");
  if (typeof value === "object") return Object.entries(value).map(([k, v]) => `${k} = ${v}`).join("\n");
  return String(value);
}

/**
 * Return what a typed text stands for in the recipe; whether it is right says the server.
 * @param {Dict} key
 * @param {string} words
 * @returns {any}
 */
export function parsed(key, words) {
  if (words === "") return null;
  const number = (/** @type {string} */ word) => (/^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(word) ? Number(word) : word);
  const list = () => words.split(",").map((word) => word.trim()).filter(Boolean);
  switch (key.kind) {
    case "number":
    case "integer":
      return number(words);
    case "texts":
    case "lengths":
      return list();
    case "table":
      return Object.fromEntries(words.split(/[\n;]/).map((line) => line.split("=")).filter((pair) => pair.length > 1)
        .map(([name, ...rest]) => [name.trim(), number(rest.join("=").trim())]));
    case "any":
      return words.includes(",") ? list().map(number) : number(words);
    default:
      return words;
  }
}
