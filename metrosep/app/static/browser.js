// @ts-check
// The files below the opened folders: what they are, a small picture of the one that has the focus, the
// recent ones. Arrows move, Enter opens, what is typed above the list narrows it.

import { make } from "./dialogs.js";
import { Refusal, Superseded } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

const SIZES = ["B", "kB", "MB", "GB", "TB"];

/** @param {number} bytes */
function sizeText(bytes) {
  let [v, k] = [bytes, 0];
  while (v >= 999.5 && k < SIZES.length - 1) [v, k] = [v / 1000, k + 1];
  return `${k && v < 9.95 ? v.toFixed(1) : Math.round(v)} ${SIZES[k]}`;
}

/** Date and time of day on this computer. @param {number} seconds since 1970 */
function timeText(seconds) {
  const at = new Date(1000 * seconds);
  const two = (/** @type {number} */ v) => String(v).padStart(2, "0");
  return `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())} ${two(at.getHours())}:${two(at.getMinutes())}`;
}

const nameOf = (/** @type {string} */ path) => path.replace(/[/\\\\]+$/, "").split(/[/\\\\]/).pop() ?? path;

/**
 * Return the list of files.
 * @param {import("./wire.js").Wire} wire
 * @param {(paths: string[], open: boolean) => void} chosen
 * @returns {HTMLElement}
 */
export function makeBrowser(wire, chosen) {
  const where = make("select", { title: "Folder" });
  where.setAttribute("aria-label", "Folder");
  const find = make("input", { type: "search", placeholder: "find by name", spellcheck: false });
  find.setAttribute("aria-label", "Find by name");
  const rows = make("ul", { className: "files-list" });
  rows.setAttribute("role", "listbox");
  rows.setAttribute("aria-label", "Files");
  rows.setAttribute("aria-multiselectable", "true");
  const picture = make("img", { alt: "", hidden: true });
  const words = make("p", { className: "soft" });
  const el = make("div", { className: "files" }, make("div", { className: "files-bar" }, where, find), rows,
    make("div", { className: "files-shown" }, picture, words));
  let folder = "";
  /** @type {Set<string>} */
  const picked = new Set();
  let timer = 0;
  let url = "";

  async function load(/** @type {string | null} */ path, from = 0) {
    try {
      const { header } = await wire.ask("list", { path, from, text: find.value });
      if (path !== null && header.path !== folder) picked.clear();
      folder = header.path;
      draw(header, from);
    } catch (error) {
      if (!(error instanceof Superseded)) words.textContent = error instanceof Error ? error.message : String(error);
    }
  }

  function draw(/** @type {Dict} */ header, /** @type {number} */ from) {
    const places = [header.path, ...(header.up ? [header.up] : []), ...header.roots.filter((/** @type {string} */ one) => one !== header.path && one !== header.up)];
    where.replaceChildren(...places.map((one) => new Option(one === header.up ? `\u2191 ${one}` : one, one)),
      ...(header.recent.length ? [make("optgroup", { label: "Opened before" }, ...header.recent.map((/** @type {string[]} */ one) =>
        new Option(one.length > 1 ? `${nameOf(one[0])} and ${one.length - 1} more` : nameOf(one[0]), `\u0000${JSON.stringify(one)}`)))] : []));
    where.value = header.path;
    const made = header.rows.map(item);
    if (header.up && !from && !find.value) made.unshift(item({ name: "..", path: header.up, is_folder: true, kind: "folder", size: 0, changed: 0 }));
    rows.querySelector(".more")?.remove();
    if (from) rows.append(...made);
    else rows.replaceChildren(...made);
    const left = header.shown - from - header.rows.length;
    if (left > 0) rows.append(make("li", { className: "more" }, make("button", { type: "button", textContent: `${left} more`, onclick: () => load(folder, from + header.rows.length) })));
    if (!rows.querySelector("[tabindex='0']")) rows.querySelector("[role=option]")?.setAttribute("tabindex", "0");
    words.textContent = header.total ? `${header.total} in this folder` : find.value ? "no name holds this" : "nothing here";
    if (header.total > header.shown) words.textContent += `; the first ${header.shown} are listed, find the others by name`;
  }

  function item(/** @type {Dict} */ one) {
    const li = make("li", { tabIndex: -1, title: one.path },
      make("b", { textContent: one.is_folder ? `${one.name}/` : one.name }), make("span", { textContent: one.is_folder ? "" : one.kind || "not known" }),
      make("span", { textContent: one.is_folder ? "" : sizeText(one.size) }), make("span", { textContent: one.changed ? timeText(one.changed) : "" }));
    li.setAttribute("role", "option");
    li.setAttribute("aria-selected", String(picked.has(one.path)));
    li.dataset.path = one.path;
    li.dataset.folder = one.is_folder ? "yes" : "";
    li.classList.toggle("unknown", !one.is_folder && !one.kind);
    return li;
  }

  function pick(/** @type {HTMLElement} */ li, more = false) {
    const path = li.dataset.path ?? "";
    if (li.dataset.folder) return;
    if (!more) picked.clear();
    if (!picked.delete(path)) picked.add(path);
    for (const one of rows.querySelectorAll("[role=option]")) one.setAttribute("aria-selected", String(picked.has(one.dataset.path)));
    chosen([...picked], false);
    clearTimeout(timer);
    timer = window.setTimeout(() => preview(path), 150);
  }

  function enter(/** @type {HTMLElement} */ li) {
    if (li.dataset.folder) {
      find.value = "";
      load(li.dataset.path ?? null).then(() => rows.querySelector("[role=option]")?.focus());
    } else {
      if (!picked.has(li.dataset.path ?? "")) pick(li);
      chosen([...picked], true);
    }
  }

  async function preview(/** @type {string} */ path) {
    if (!el.isConnected) return;
    try {
      const { header, arrays } = await wire.ask("thumbnail", { path });
      URL.revokeObjectURL(url);
      url = arrays.png ? URL.createObjectURL(new Blob([arrays.png], { type: "image/png" })) : "";
      picture.hidden = !url;
      if (url) picture.src = url;
      picture.alt = `${nameOf(path)}: ${header.words}`;
      words.textContent = `${nameOf(path)}: ${header.words}`;
    } catch (error) {
      if (!(error instanceof Refusal)) return;
      picture.hidden = true;
      words.textContent = error.message;
    }
  }

  const optionOf = (/** @type {Event} */ event) => /** @type {HTMLElement | null} */ (/** @type {HTMLElement} */ (event.target).closest("[role=option]"));
  rows.addEventListener("click", (/** @type {MouseEvent} */ event) => {
    const li = optionOf(event);
    if (!li) return;
    focus(li);
    if (li.dataset.folder) enter(li);
    else pick(li, event.ctrlKey || event.metaKey);
  });
  rows.addEventListener("dblclick", (/** @type {MouseEvent} */ event) => {
    const li = optionOf(event);
    if (li && !li.dataset.folder) enter(li);
  });
  function focus(/** @type {HTMLElement} */ li) {
    for (const one of rows.querySelectorAll("[role=option]")) one.tabIndex = one === li ? 0 : -1;
    li.focus();
  }
  rows.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
    const all = /** @type {HTMLElement[]} */ ([...rows.querySelectorAll("[role=option]")]);
    const at = all.indexOf(/** @type {HTMLElement} */ (document.activeElement));
    const step = /** @type {Record<string, number>} */ ({ ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: all.length - 1 })[event.key];
    if (step !== undefined && all.length) {
      const next = all[Math.max(0, Math.min(all.length - 1, step))];
      focus(next);
      pick(next, event.shiftKey);
    } else if (event.key === "Enter" && at >= 0) enter(all[at]);
    else if (event.key === " " && at >= 0) pick(all[at], true);
    else if (event.key.length === 1 && !event.ctrlKey && !event.metaKey && event.key !== " ") {
      find.focus();
      return; // the letter goes there
    } else return;
    event.preventDefault();
  });
  where.addEventListener("change", () => {
    if (where.value.startsWith("\u0000")) chosen(JSON.parse(where.value.slice(1)), true);
    else load(where.value);
  });
  find.addEventListener("input", () => {
    clearTimeout(timer);
    timer = window.setTimeout(() => load(folder), 120);
  });
  find.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
    if (event.key === "ArrowDown") rows.querySelector("[role=option]")?.focus();
    else if (event.key !== "Enter") return;
    event.preventDefault();
  });
  load(null);
  return el;
}
