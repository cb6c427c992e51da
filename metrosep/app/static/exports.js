// @ts-check
// Files that the user asks for: the recipe, its result.

import { askForm, clearAlerts, download } from "./dialogs.js";
import { Refusal } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

/**
 * Return a path in the folder where results go unless the user says otherwise.
 * @param {Dict} session @param {string} name
 */
export function inTarget(session, name) {
  const folder = String(session.target ?? "");
  return folder ? `${folder.replace(/[/\\]$/, "")}${folder.includes("\\") ? "\\" : "/"}${name}` : name;
}

/** Return the name of what was opened, without its end. @param {Dict} session */
export function stemOf(session) {
  return String(session.home ?? "").replace(/^.*[/\\]/, "").replace(/\.[^.]*$/, "");
}

/**
 * Write a file; where one is there that may be replaced, ask first and write again.
 * @param {(overwrite: boolean) => Promise<void>} write
 * @param {(error: unknown) => void} fail
 * @param {RegExp} [offer] words of a refusal that asking may help
 */
export async function writeOrAsk(write, fail, offer = /exists already/) {
  try {
    await write(false);
  } catch (error) {
    if (!(error instanceof Refusal && offer.test(error.message))) {
      fail(error);
      return;
    }
    const sure = await askForm({ title: "Overwrite?", text: error.message, fields: [], ok: "Overwrite" });
    if (sure) await write(true).catch(fail);
  }
}

/**
 * Return what writes files.
 * @param {object} options
 * @param {import("./wire.js").Wire} options.wire
 * @param {HTMLElement} options.status where it is told what was written
 * @param {() => Dict} options.session
 * @param {(session: Dict) => void} options.take a session came back
 * @param {(error: unknown) => void} options.fail
 */
export function makeExports({ wire, status, session, take, fail }) {
  async function save() {
    if (!session().recipe) return;
    const get = document.createElement("button");
    get.type = "button";
    get.textContent = "Download it instead";
    get.style.justifySelf = "start";
    get.addEventListener("click", () => {
      download(session().recipe ?? "", `${session().name ?? "recipe.toml"}`);
      get.closest("dialog")?.close("");
    });
    const given = await askForm({
      title: "Save the recipe", ok: "Save", extra: [get],
      text: `It gives the same result with: metrosep run RECIPE${session().op && session().files.length ? " FILE" : ""}${isUpload()
        ? "\nThe file is a copy that goes when metrosep ends, and its session with it; put the file beside the recipe." : ""}`,
      fields: [{ name: "path", label: "File", value: inTarget(session(), session().name ?? "recipe.toml") }],
    });
    if (given?.path) await exported("recipe", given.path);
  }

  /** Whether the file came through the browser: its folder goes with the session. */
  function isUpload() {
    return /metrosep-ui-/.test(session().home ?? "");
  }

  async function exportResult() {
    if (!session().recipe) return;
    const given = await askForm({
      title: "Export the result", ok: "Run and write",
      text: "Runs the recipe on the full data and writes its result into a folder.",
      fields: [{ name: "path", label: "Folder", value: inTarget(session(), `${stemOf(session())}_result`) }],
    });
    if (given?.path) await exported("result", given.path);
  }

  const exported = (/** @type {string} */ what, /** @type {string} */ path) => writeOrAsk(async (overwrite) => {
    status.textContent = what === "result" ? "running…" : "";
    try {
      const { header } = await wire.ask("export", { what, path, overwrite });
      clearAlerts();
      if (header.session) take(header.session);
      status.textContent = `written: ${header.files.map((/** @type {string} */ f) => f.split(/[\\/]/).pop()).join(", ")}`;
      status.title = header.files.join("\n");
    } catch (error) {
      status.textContent = "";
      throw error;
    }
  }, fail);

  return { save, exportResult };
}
