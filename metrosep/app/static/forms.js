// @ts-check
// Forms by tiles with pictures: what is chosen and typed becomes the text that the recipe holds.

import { painted } from "./colours.js";
import { make } from "./dialogs.js";

/** @typedef {Record<string, any>} Dict */
/** @typedef {(u: number, v: number) => number} Relief */

/** What each form looks like, over -1 to 1. @type {Record<string, Relief>} */
const RELIEFS = {
  plane: (u, v) => u + 0.5 * v,
  sphere: (u, v) => Math.sqrt(Math.max(0, 2.2 - u * u - v * v)),
  cylinder: (u) => Math.sqrt(Math.max(0, 1.4 - u * u)),
  conic: (u, v) => -(u * u + v * v),
  asphere: (u, v) => ((q) => 2.4 * q * q - 2 * q)(u * u + v * v),
  biconic: (u, v) => -(u * u) - 0.3 * v * v,
  toric: (u, v) => u * u - 0.7 * v * v,
  polynomial: (u, v) => u * u * u - u * v + 0.5 * v * v,
  zernike: (u, v) => (u * u + v * v > 1 ? NaN : u * u * u - 3 * u * v * v),
  qforbes: (u, v) => ((q) => (q > 1 ? NaN : Math.cos(5 * q)))(Math.hypot(u, v)),
  sine_grid: (u, v) => Math.sin(9 * u) + Math.sin(9 * v),
  expression: (u, v) => Math.sin(4 * u) * Math.exp(-v),
};
const [WIDE, HIGH] = [44, 32];

/** A small picture of a form. @param {string} name */
function pictureOf(name) {
  const canvas = make("canvas", { width: WIDE, height: HIGH });
  canvas.setAttribute("aria-hidden", "true");
  const relief = RELIEFS[name] ?? (() => 0);
  const z = Array.from({ length: WIDE * HIGH }, (_, i) => relief((2 * (i % WIDE)) / (WIDE - 1) - 1, 1 - (2 * Math.floor(i / WIDE)) / (HIGH - 1)));
  const known = z.filter(Number.isFinite);
  const [low, high] = [Math.min(...known), Math.max(...known)];
  const index = Uint8Array.from(z, (v) => (Number.isFinite(v) ? 1 + Math.round((254 * (v - low)) / (high - low || 1)) : 0));
  canvas.getContext("2d").putImageData(painted(index, null, WIDE, HIGH, "viridis"), 0, 0);
  return canvas;
}

/** Name and values of a form from its text. @param {string} text @returns {{ name: string, values: Record<string, string> }} */
export function formOf(text) {
  const at = text.indexOf(":");
  const name = (at < 0 ? text : text.slice(0, at)).trim().toLowerCase().replaceAll(/[- ]/g, "_");
  const rest = at < 0 ? "" : text.slice(at + 1);
  if (name === "expression") {
    const [formula, letters = ""] = rest.split(";");
    return { name, values: { formula: formula.trim(), letters: letters.replaceAll(/ SI\b/g, "").trim() } };
  }
  const pairs = rest.split(",").map((part) => part.split("=").map((one) => one.trim())).filter((pair) => pair.length === 2);
  return { name, values: Object.fromEntries(pairs) };
}

/** The text of a form. @param {string} name @param {Record<string, string>} values */
export function textOf(name, values) {
  const plain = name.replaceAll("_", "-");
  if (name === "expression") {
    const letters = (values.letters ?? "").split(",").map((one) => one.trim()).filter(Boolean);
    return `${plain}: ${values.formula}; ${letters.map((one) => (/=\s*[-+.\de]+$/i.test(one) ? `${one} SI` : one)).join(", ")}`;
  }
  const pairs = Object.entries(values).filter(([, value]) => value);
  return pairs.length ? `${plain}: ${pairs.map(([k, v]) => `${k}=${v}`).join(", ")}` : plain;
}

/**
 * Return the tiles of the forms with the fields of the chosen one.
 * @param {Dict[]} forms of the server
 * @param {string} text of the recipe
 * @param {(text: string) => void} changed
 * @returns {HTMLElement}
 */
export function makeForms(forms, text, changed) {
  let { name, values } = formOf(text);
  const written = { name, values };
  const tiles = make("div", { className: "tiles" });
  tiles.setAttribute("role", "radiogroup");
  tiles.setAttribute("aria-label", "Form");
  const below = make("div", { className: "tile-fields" });

  function draw() {
    const chosen = forms.find((one) => one.name === name);
    for (const tile of tiles.children) {
      tile.setAttribute("aria-checked", String(tile.dataset.form === name));
      tile.tabIndex = tile.dataset.form === (chosen?.name ?? forms[0]?.name) ? 0 : -1;
    }
    below.replaceChildren(make("p", { className: "note", textContent: chosen?.what ?? `${text}: is not in the menu` }), ...(chosen?.fields ?? []).flatMap(fieldOf));
  }

  function fieldOf(/** @type {Dict} */ field) {
    const input = make(field.choices.length ? "select" : "input", { title: field.help, spellcheck: false, id: `form-${field.name}` });
    if (field.choices.length) {
      const given = values[field.name] ?? "";
      const all = given && !field.choices.includes(given) ? [...field.choices, given] : field.choices; // typed into the recipe
      input.append(...(field.required ? [] : [new Option("usual", "")]), ...all.map((/** @type {string} */ one) => new Option(one, one)));
    }
    else input.placeholder = field.hint;
    input.value = values[field.name] ?? "";
    input.dataset.field = field.name;
    input.addEventListener("change", () => {
      values = { ...values, [field.name]: input.value.trim() };
      commit();
    });
    return [make("label", { textContent: field.label, title: field.help, htmlFor: input.id }), input];
  }

  /** The edit, where all is there that the form needs. */
  function commit() {
    const fields = forms.find((one) => one.name === name)?.fields ?? [];
    const lacking = fields.find((/** @type {Dict} */ field) => field.required && !values[field.name]);
    if (lacking) below.querySelector(`[data-field="${lacking.name}"]`)?.focus();
    else changed(textOf(name, values));
  }

  const lengths = ["R", "Rx", "Ry", "k", "radius"]; // what means the same in another form

  function pick(/** @type {string} */ next) {
    if (next === name) return;
    name = next;
    const fields = forms.find((one) => one.name === next)?.fields ?? [];
    const known = next === written.name ? written.values : Object.fromEntries(Object.entries(written.values).filter(([k]) => lengths.includes(k) && fields.some((/** @type {Dict} */ one) => one.name === k)));
    values = { ...Object.fromEntries(fields.filter((/** @type {Dict} */ one) => one.value).map((/** @type {Dict} */ one) => [one.name, one.value])), ...known };
    draw();
    commit();
  }

  for (const form of forms) {
    const tile = make("button", { type: "button", className: "tile", title: form.what }, pictureOf(form.name), make("span", { textContent: form.title }));
    tile.setAttribute("role", "radio");
    tile.setAttribute("aria-label", `${form.title}: ${form.what}`);
    tile.dataset.form = form.name;
    tile.addEventListener("click", () => pick(form.name));
    tiles.append(tile);
  }
  tiles.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
    const step = /** @type {Record<string, number>} */ ({ ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 })[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    const all = [...tiles.children];
    const next = all[(all.indexOf(document.activeElement) + step + all.length) % all.length];
    for (const tile of all) tile.tabIndex = tile === next ? 0 : -1;
    next.focus();
  });
  draw();
  return make("div", { className: "forms" }, tiles, below);
}
