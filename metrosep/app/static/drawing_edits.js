// @ts-check
// What a gesture on the map becomes: edits of the recipe, each with the name that undo shows.

import { nextName } from "./drawing_parts.js";

/** @typedef {Record<string, any>} Dict */
/** @typedef {import("./drawing_parts.js").Shape} Shape */

/** Straight sections that a map shows at most. */
export const MOST_LINES = 8;

/** @param {Dict} options session(), edit(edits, label), insert(step, label), say(text) */
export function makeEdits({ session, edit, insert, say }) {
  return {
    change(/** @type {Shape} */ shape, /** @type {Dict} */ table) {
      if (JSON.stringify(table) === JSON.stringify(shape.table)) return;
      const path = shape.what === "step" ? ["step", shape.index, "aperture"] : ["section", shape.index];
      edit([{ path, old: shape.table, new: table }], `${shape.name}: change`);
    },
    /** Add a mask or a section; return what is then chosen. @param {Dict} table @param {boolean} keep @returns {string | null} */
    insertOrAdd(table, keep) {
      if (table.shape) {
        insert({ op: "mask", aperture: table, ...(keep ? {} : { outside: false }) }, `${keep ? "keep" : "exclude"} a ${table.shape}`);
        return null;
      }
      const sections = session().sections ?? [];
      if (table.kind === "line" && sections.filter((/** @type {Dict} */ s) => s.kind === "line").length >= MOST_LINES) {
        say(`A map shows ${MOST_LINES} sections at most; delete one first.`);
        return null;
      }
      const name = nextName(sections, table.kind);
      const { kind, ...rest } = table;
      edit([{ path: ["section", sections.length], old: null, new: { kind, name, ...rest } }], `add ${name}`);
      return `section ${sections.length}`;
    },
    drop(/** @type {Shape} */ shape) {
      const step = session().steps?.[shape.index];
      const [path, old] = shape.what === "step" ? [["step", shape.index], step.stored] : [["section", shape.index], shape.table];
      edit([{ path, old, new: null }], `delete ${shape.name}`);
    },
    /** What a mask keeps it excludes, and the other way round. @param {Shape} shape */
    turn(shape) {
      const old = session().steps[shape.index].keys.outside ?? null;
      edit([{ path: ["step", shape.index, "outside"], old, new: shape.keep ? false : null }], `${shape.name}: ${shape.keep ? "exclude" : "keep"}`);
    },
  };
}
