// @ts-check
// The report of the full result, in a frame without scripts, and the file that is made of it.

import { askForm } from "./dialogs.js";
import { inTarget, stemOf, writeOrAsk } from "./exports.js";
import { Refusal, Superseded } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

/** @param {import("./tabs.js").Context} context @returns {import("./tabs.js").Tab} */
export function make({ el, wire, session, fail, written }) {
  let of = ""; // hash of the recipe that is shown
  let asked = "";
  let formats = ["html"];

  const bar = document.createElement("div");
  bar.className = "report-bar";
  const words = document.createElement("span");
  words.className = "soft";
  words.setAttribute("role", "status");
  const grow = document.createElement("span");
  grow.className = "grow";
  const button = document.createElement("button");
  button.type = "button";
  button.id = "report-make";
  button.className = "main";
  button.textContent = "Make the report…";
  button.disabled = true;
  button.addEventListener("click", ask);
  bar.append(words, grow, button);
  /** @type {HTMLIFrameElement | null} */
  let frame = null;
  el.replaceChildren(bar);

  /** Each report gets a frame of its own: one that is led to a second page may stay empty. */
  function put(/** @type {string} */ page) {
    frame?.remove();
    frame = document.createElement("iframe");
    frame.title = "Report";
    frame.setAttribute("sandbox", ""); // no scripts, no forms, an origin of its own
    frame.className = "report-frame";
    frame.srcdoc = page;
    el.append(frame);
  }

  function draw() {
    const outdated = of !== session().hash;
    frame?.classList.toggle("outdated", outdated && of !== "");
    button.disabled = outdated;
    button.title = outdated ? "The report is of another recipe: wait for the full resolution" : "Write it into a file";
    el.dataset.of = outdated ? "" : of;
  }

  async function show() {
    draw();
    const wanted = session().hash;
    if (of === wanted || asked === wanted) return;
    asked = wanted;
    words.textContent = of ? "of an earlier recipe; the full resolution is being computed…" : "waits for the full resolution…";
    try {
      const { header, arrays } = await wire.ask("report");
      formats = header.formats;
      if (header.hash !== session().hash) return;
      put(new TextDecoder().decode(arrays.html));
      of = header.hash;
      words.textContent = "of the full data; nothing in it comes from a preview";
    } catch (error) {
      if (!(error instanceof Superseded) && session().hash === wanted) {
        words.textContent = error instanceof Refusal ? `there is no report: ${error.message}` : "";
        if (!(error instanceof Refusal)) fail(error);
      }
    } finally {
      if (asked === wanted) asked = "";
      draw();
    }
  }

  async function ask() {
    const given = await askForm({
      title: "Make the report", ok: "Write",
      text: "Writes the report of the full result into a file.",
      fields: [
        { name: "path", label: "File", value: inTarget(session(), `${stemOf(session())}_report.html`) },
        { name: "format", label: "Format", value: formats[0], choices: formats },
      ],
    });
    if (given?.path) await write(given.path, given.format || "html");
  }

  async function write(/** @type {string} */ path, /** @type {string} */ format) {
    const named = path.replace(/\.html$/i, format === "html" ? ".html" : `.${format}`);
    await writeOrAsk(async (overwrite) => {
      const { header } = await wire.ask("report", { write: named, format, overwrite }, "report write");
      written(`written: ${header.files[0].split(/[\\/]/).pop()}`, header.files);
    }, fail);
  }

  return {
    show,
    changed(_, isNewFile) {
      if (isNewFile) {
        of = "";
        asked = "";
        frame?.remove();
        frame = null;
        words.textContent = "";
      }
      draw();
    },
    news(news) {
      if (asked && news.k === "progress" && news.words) words.textContent = `${news.words}…`;
    },
  };
}
