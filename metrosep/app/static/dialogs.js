// @ts-check
// Dialogs: they wait for an answer and give the focus back. Errors stay until they are read.

/** @typedef {Record<string, any>} Dict */

/**
 * @param {string} tag
 * @param {Dict} properties
 * @param {(Node | string)[]} children
 */
export function make(tag, properties = {}, ...children) {
  const el = /** @type {any} */ (Object.assign(document.createElement(tag), properties));
  el.append(...children);
  return el;
}

/**
 * Ask for some values.
 * @param {object} options
 * @param {string} options.title
 * @param {string} [options.text]
 * @param {{ name: string, label: string, value?: string, hint?: string, choices?: string[] }[]} options.fields
 * @param {string} options.ok
 * @param {Node[]} [options.extra]
 * @param {Node[]} [options.sample] what the question is about, above the fields
 * @returns {Promise<Record<string, string> | null>} null: given up
 */
export function askForm({ title, text = "", fields, ok, extra = [], sample = [] }) {
  const inputs = fields.map(({ name, value = "", hint = "", choices }) => {
    if (!choices?.length) return make("input", { name, value, placeholder: hint, spellcheck: false, autocomplete: "off" });
    const list = `list-${name}`;
    return make("span", {}, make("input", { name, value, placeholder: hint, spellcheck: false, style: "width:100%" }),
      make("datalist", { id: list }, ...choices.map((one) => make("option", { value: one }))));
  });
  const labels = fields.map(({ label }, i) => make("label", {}, label, inputs[i]));
  for (const label of labels) {
    const list = label.querySelector("datalist");
    if (list) label.querySelector("input").setAttribute("list", list.id);
  }
  const form = make("form", { method: "dialog" }, make("h2", { textContent: title }),
    ...(text ? [make("p", { className: "ask", textContent: text })] : []), ...sample, ...labels, ...extra,
    make("div", { className: "buttons" }, make("button", { type: "button", textContent: "Cancel", value: "no" }),
      make("button", { className: "main", textContent: ok, value: "yes" })));
  return shown(form, sample.length || form.querySelector(".files") ? "wide" : "", (dialog) => {
    form.querySelector("[value=no]").addEventListener("click", () => dialog.close(""));
    const first = form.querySelector("label input");
    first?.focus();
    first?.select();
  }).then((answer) => (answer === "yes"
    ? Object.fromEntries(fields.map(({ name }) => [name, form.querySelector(`[name="${name}"]`).value.trim()]))
    : null));
}

/**
 * @param {HTMLElement} form
 * @param {string} className
 * @param {(dialog: HTMLDialogElement) => void} [ready]
 * @returns {Promise<string>}
 */
function shown(form, className, ready) {
  const dialog = /** @type {HTMLDialogElement} */ (make("dialog", { className }, form));
  document.body.append(dialog);
  const title = form.querySelector("h2");
  if (title) dialog.setAttribute("aria-label", title.textContent ?? "");
  dialog.showModal();
  ready?.(dialog);
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve(dialog.returnValue);
    });
  });
}

/**
 * Return the paths that a line names: separated by semicolons; in quotes, a path may hold these too.
 * @param {string} text
 * @param {string} [offered] a single path that stood there: left as it is, it is one
 * @returns {string[]}
 */
export function pathsOf(text, offered = "") {
  const whole = text.trim();
  if (whole && whole === offered.trim()) return [whole];
  const found = [];
  for (const line of whole.split(/[\r\n]+/)) {
    for (const [, quoted, plain] of line.matchAll(/\s*(?:"([^"]*)"\s*(?=;|$)|([^;]+))(?:;|$)/g)) {
      const path = quoted ?? (plain ?? "").trim();
      if (path) found.push(path);
    }
  }
  return found;
}

/**
 * Choose files: paths on this computer, or such as are handed over by the browser.
 * @param {string} path shown to begin with
 * @param {boolean} canKeep whether a recipe is there that may be carried out on them
 * @param {(chosen: (paths: string[], open: boolean) => void) => Node} browse makes the list of files
 * @returns {Promise<{ paths?: string[], files?: File[], keep: boolean } | null>}
 */
export async function askFile(path, canKeep, browse) {
  /** @type {File[]} */
  let chosen = [];
  const picker = make("input", { type: "file", multiple: true });
  const label = make("label", {}, "or choose; copies are worked on (several: one set of runs)", picker);
  picker.addEventListener("change", () => {
    chosen = [...picker.files ?? []];
    if (chosen.length) picker.closest("dialog")?.close("file");
  });
  const keep = make("input", { type: "checkbox", id: "keep-recipe" });
  const keepLabel = make("label", { className: "check" }, keep, "keep the present steps and limits: carry them out on this file");
  const list = browse((paths, open) => {
    const field = /** @type {HTMLInputElement | null} */ (document.querySelector("dialog [name=path]"));
    if (!field) return;
    field.value = paths.map((one) => (one.includes(";") || paths.length > 1 ? `"${one}"` : one)).join("; ");
    if (open) /** @type {HTMLButtonElement} */ (document.querySelector("dialog button[value=yes]")).click();
  });
  const given = await askForm({
    title: "Open a measurement, runs or a recipe", sample: [list],
    fields: [{ name: "path", label: "File on this computer, inside the folders that metrosep was started with; several runs: separated by ; (a name that holds ; stands in \"quotes\")", value: path }],
    ok: "Open",
    extra: canKeep ? [label, keepLabel] : [label],
  });
  if (chosen.length) return { files: chosen, keep: keep.checked };
  const paths = pathsOf(given?.path ?? "", path);
  return paths.length ? { paths, keep: keep.checked } : null;
}

/**
 * Hand a text or a picture over as a download.
 * @param {string | Blob} content
 * @param {string} name of the file
 */
export function download(content, name) {
  const blob = content instanceof Blob ? content : new Blob([content], { type: "application/toml" });
  const link = make("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/**
 * Show a text that may be long.
 * @param {string} title
 * @param {string} text
 */
export function showText(title, text) {
  const pre = make("pre", { textContent: text, tabIndex: 0 });
  return shown(make("form", { method: "dialog" }, make("h2", { textContent: title }), pre,
    make("div", { className: "buttons" }, make("button", { className: "main", textContent: "Close" }))), "wide");
}

/**
 * Show the keys.
 * @param {[string, string][]} keys
 * @param {string} version
 */
export function showHelp(keys, version) {
  const list = make("dl", { className: "keys" }, ...keys.flatMap(([key, what]) =>
    [make("dt", {}, ...key.split(" ").map((one) => make("kbd", { textContent: one }))), make("dd", { textContent: what })]));
  return shown(make("form", { method: "dialog" }, make("h2", { textContent: "Keys" }), list,
    make("p", { className: "soft", textContent: `metrosep ${version}` }),
    make("div", { className: "buttons" }, make("button", { className: "main", textContent: "Close" }))), "");
}

/**
 * Show an error at the top of the page until it is read.
 * @param {string} text of the server
 */
export function alertText(text, more = null) {
  const place = document.getElementById("alerts");
  if (!place || [...place.querySelectorAll("p")].some((p) => p.textContent === text)) return;
  const close = make("button", { type: "button", className: "small", textContent: "Close" });
  const el = make("div", { className: "alert" }, make("p", { textContent: text }), ...(more ? [more] : []), close);
  close.addEventListener("click", () => el.remove());
  place.append(el);
}

/** Take errors away: what was wrong has been put right. */
export function clearAlerts() {
  document.getElementById("alerts")?.replaceChildren();
}
