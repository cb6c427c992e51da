// @ts-check
// Drawing on the map: tools, shapes with handles, and their list. A gesture ends as one edit of the recipe;
// while it lasts nothing is asked of the server.

import { chipOf, drawBar, fieldsOf, fillBar, fitButton, groupOf, linesOf, marksOf, meant, node, SECOND, shapesOf, TOOLS } from "./drawing_parts.js";
import { makeEdits, MOST_LINES } from "./drawing_edits.js";
import { makeHandle, wheelFactor } from "./handles.js";
import { gripsOf, kindOf, moved, placeOf, pointText, setPixel, spans, straightened, withCorner, withoutCorner, written } from "./shapes.js";

/** @typedef {Record<string, any>} Dict */
/** @typedef {import("./shapes.js").Point} Point */
/** @typedef {import("./drawing_parts.js").Shape} Shape */

/** CSS pixels within which Alt finds a peak or valley. */
const SNAP = 14;

/** @param {Dict} options el: the map, bar: of the tools, list: of the shapes; session(), edit(edits, label), insert(step, label), shown(a, b), say(text), place(request): peaks near a point, or the aperture */
export function makeDrawing({ el, bar, list, session, edit, insert, shown, say, place }) {
  /** @type {{ centre: number[], scale: number, size: number[] } | null} */
  let seen = null;
  let tool = "";
  let keep = false;
  let chosen = "";
  let radius = 0;
  /** @type {Point[]} */
  let pen = [];
  let [draft, copied] = /** @type {(Dict | null)[]} */ ([null, null]); // draft: of a gesture, or of a handle that is held
  let held = "";
  /** @type {Map<number, Point>} */
  let centres = new Map();
  /** @type {Map<string, [Point, number][]>} */
  let marks = new Map(); // peak and valley by the name of their section
  /** @type {Map<string, import("./handles.js").Grip>} */
  let grips = new Map();

  const svg = /** @type {SVGElement} */ (node("svg", { "aria-hidden": "true" })); // the list says what is drawn
  svg.classList.add("draw-shapes");
  const pad = document.createElement("div");
  pad.className = "draw-pad";
  pad.hidden = true;
  el.append(svg, pad);

  const toScreen = (/** @type {Point} */ p) => (seen ? [(p[0] - seen.centre[0]) / seen.scale + seen.size[0] / 2, seen.size[1] / 2 - (p[1] - seen.centre[1]) / seen.scale] : [0, 0]);
  const toMap = (/** @type {number} */ x, /** @type {number} */ y) => /** @type {Point} */ (seen ? [seen.centre[0] + (x - seen.size[0] / 2) * seen.scale, seen.centre[1] + (seen.size[1] / 2 - y) * seen.scale] : [0, 0]);

  const shapes = () => shapesOf(session(), centres);
  const current = () => shapes().find((one) => one.id === chosen);

  // ---- edits ----------------------------------------------------------------------------------

  const { change, insertOrAdd, drop, turn } = makeEdits({ session, edit, insert, say });

  function add(/** @type {Dict} */ table) {
    chosen = insertOrAdd(table, keep || tool === "crop") ?? chosen;
  }

  function remove() {
    const shape = current();
    chosen = "";
    if (shape) drop(shape);
  }

  function flip() {
    const shape = current();
    if (shape?.what === "step") return turn(shape);
    keep = !keep;
    return drawBar(bar, tool, keep);
  }

  // ---- gestures -------------------------------------------------------------------------------

  const at = (/** @type {MouseEvent} */ event) => {
    const box = pad.getBoundingClientRect();
    return toMap(event.clientX - box.left, event.clientY - box.top);
  };
  const clicks = () => tool === "polygon" || tool === "distance";

  function begin(/** @type {PointerEvent} */ event) {
    if (event.button !== 0 || !seen) return;
    event.preventDefault();
    event.stopPropagation();
    pad.setPointerCapture(event.pointerId);
    if (!clicks()) pen = [at(event)];
  }

  function follow(/** @type {PointerEvent} */ event) {
    if (!seen || !pen.length) return;
    let p = at(event);
    if (clicks()) {
      draft = unfinished([...pen, p]);
    } else if (pad.hasPointerCapture(event.pointerId)) {
      if (["section", "step", "groove"].includes(tool) && event.shiftKey) p = straightened(pen[0], p);
      if (tool === "free" || tool === "brush") pen.push(p);
      else pen = [pen[0], p];
      draft = unfinished(pen);
    }
    draw();
  }

  function end(/** @type {PointerEvent} */ event) {
    if (!seen || !pad.hasPointerCapture(event.pointerId) || !(pen.length || clicks())) return; // Escape gave it up
    if (clicks()) {
      const p = at(event);
      const shift = event.shiftKey;
      if (event.altKey) snapped(p).then((q) => click(q, shift));
      else click(p, shift);
      return;
    }
    const far = pen.length > 1 && Math.hypot(...toScreen(pen[0]).map((v, i) => v - toScreen(pen[pen.length - 1])[i])) >= 3;
    const made = far || tool === "free" || tool === "brush" ? unfinished(pen) : null;
    pen = [];
    draft = null;
    if (made && (made.shape !== "polygon" || made.points.length > 2)) add(made);
    draw();
  }

  /** The peak or valley near a point, whichever is nearer; the point where there is none. @param {Point} p @returns {Promise<Point>} */
  async function snapped(p) {
    const found = await place({ what: "extremes", at: p, radius: SNAP * (seen?.scale ?? 0) });
    const far = (/** @type {Point | null | undefined} */ q) => (q ? Math.hypot(q[0] - p[0], q[1] - p[1]) : Infinity);
    const [peak, valley] = [found?.peak, found?.valley];
    if (!peak) say("Nothing was measured there: no peak or valley is near.");
    return far(peak) <= far(valley) ? peak ?? p : valley;
  }

  /** Lay a round section into what was measured. */
  async function fitAperture(/** @type {Shape} */ shape) {
    const found = await place({ what: "aperture" });
    if (!found) return;
    const { from, sides, unit } = placeOf(shape.table);
    change(shape, { ...shape.table, centre: pointText(from(found.centre), unit), radius: written((0.98 * found.radius) / Math.max(...sides), unit) });
  }

  function click(/** @type {Point} */ p, /** @type {boolean} */ shift) {
    const near = (/** @type {Point | undefined} */ q) => q && Math.hypot(...toScreen(p).map((v, i) => v - toScreen(q)[i])) < 9;
    if (tool === "polygon" && pen.length > 2 && near(pen[0])) return close();
    if (near(pen[pen.length - 1])) return pen.length > 1 ? close() : undefined; // the second click of a double click
    pen.push(p), svg.classList.remove("bad");
    if (tool === "distance" && pen.length === 3) return close(shift);
    draft = unfinished(pen);
    return draw();
  }

  function close(round = false) {
    const made = pen.length < 2 ? null : unfinished(pen);
    if (tool === "polygon" && !spans(pen)) return svg.classList.add("bad"), say("A polygon has three corners or more, not all on one line.");
    pen = [];
    draft = null;
    if (made) add(made.kind === "angle" && round ? { ...made, kind: "circle3" } : made);
    draw();
  }

  const brush = () => radius || 8 * (seen?.scale ?? 0);
  const unfinished = (/** @type {Point[]} */ points) => meant(tool, points, step / 2 || (seen?.scale ?? 0), brush());

  function cancel() {
    if (held || pen.length) {
      pen = [];
      draft = null;
      held = "";
    } else if (tool) {
      use("");
    } else {
      chosen = "";
    }
    drawAll();
  }

  function use(/** @type {string} */ next) {
    if (next && !ready()) return;
    tool = next && next === tool ? SECOND[next] ?? "" : next;
    [pen, draft] = [[], null];
    svg.classList.remove("bad");
    if (tool) chosen = "";
    pad.hidden = !tool;
    drawAll();
  }

  const ready = () => session().kind === "map" && step > 0; // its picture has come

  pad.addEventListener("pointerdown", begin);
  pad.addEventListener("pointermove", follow);
  pad.addEventListener("pointerup", end);
  pad.addEventListener("wheel", (event) => {
    if (tool !== "brush" || !seen) return;
    event.preventDefault();
    event.stopPropagation();
    radius = brush() * wheelFactor(event);
    say(`Brush: radius ${written(radius)}`);
  }, { passive: false });

  /** Keys that belong to the drawing; true where one was taken. @param {KeyboardEvent} event */
  function key(event) {
    if (event.ctrlKey || event.metaKey) {
      const shape = current();
      if (event.key === "c" && shape && !String(getSelection())) copied = shape.table;
      else if (event.key === "v" && copied && seen) paste(copied);
      else return false;
      return true;
    }
    if (event.key === "Escape" && (tool || pen.length || held || chosen)) cancel();
    else if (event.key === "Enter" && pen.length && clicks()) close();
    else if (event.key === "Delete" && chosen) dropCorner() || remove();
    else return false;
    return true;
  }

  function dropCorner() {
    const which = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.grip?.split(" ");
    const shape = current();
    if (which?.[0] !== "point" || !shape?.table.points) return false;
    const table = withoutCorner(shape.table, Number(which[1]));
    if (table) change(shape, table);
    else say(`A ${kindOf(shape.table)} keeps its last corners; delete the whole of it in the list.`);
    return true;
  }

  function paste(/** @type {Dict} */ table) {
    const [move] = gripsOf(table, centres.get(current()?.index ?? -1) ?? null);
    const by = 20 * (seen?.scale ?? 0);
    const { to, from } = placeOf(table);
    const [x, y] = to(move.at);
    add(moved(table, "move", from([x + by, y - by]), move.at));
  }

  // ---- pictures -------------------------------------------------------------------------------

  let step = 0; // m, or 1 px: of a pixel

  function drawn(/** @type {Dict} */ table, /** @type {Point | null} */ fitted, /** @type {string} */ name, /** @type {Shape | null} */ shape) {
    const group = groupOf(table, fitted, name, toScreen, seen?.scale ?? 1, shape && table === shape.table ? marks.get(shape.name) : []);
    if (shape) {
      group.addEventListener("pointerdown", (event) => {
        event.stopPropagation();
        const rect = svg.getBoundingClientRect();
        const p = toMap(event.clientX - rect.left, event.clientY - rect.top);
        if (chosen === shape.id && shape.table.points) change(shape, withCorner(shape.table, placeOf(shape.table).from(p)));
        else choose(shape.id);
      });
    }
    return group;
  }

  function draw() {
    if (!seen) return;
    const all = shapes();
    const made = all.map((one) => drawn(held && one.id === chosen && draft ? draft : one.table, one.fitted,
      `${one.what === "step" ? (one.keep ? "keep" : "exclude") : `section-${one.index % MOST_LINES}`}${one.id === chosen ? " chosen" : ""}`, one));
    if (draft && !held) made.push(drawn(draft, null, "draft", null));
    svg.replaceChildren(...made);
    drawGrips(all.find((one) => one.id === chosen));
  }

  function drawGrips(/** @type {Shape | undefined} */ shape) {
    const table = held && draft ? draft : shape?.table;
    const wanted = shape && table && !tool ? gripsOf(table, shape.fitted).filter((g) => g.at.every(Number.isFinite)) : [];
    const ids = new Set(wanted.map((g) => `${shape?.id} ${g.key}`));
    for (const [id, grip] of grips) if (!ids.has(id)) grip.el.remove(), grips.delete(id);
    for (const g of wanted) {
      const id = `${shape?.id} ${g.key}`;
      if (!grips.has(id)) grips.set(id, gripFor(g));
      const grip = /** @type {import("./handles.js").Grip} */ (grips.get(id));
      grip.place(.../** @type {[number, number]} */ (toScreen(placeOf(table ?? {}).to(g.at))));
      grip.describe(pointText(g.at, placeOf(table ?? {}).unit));
    }
  }

  function gripFor(/** @type {import("./shapes.js").Grip} */ g) {
    const to = (/** @type {Point} */ p) => {
      const shape = current();
      if (!shape || !held) return;
      draft = moved(draft ?? shape.table, g.key, placeOf(shape.table).from(p), shape.fitted);
      draw();
    };
    const grip = makeHandle(el, {
      label: `${current()?.name}, ${g.label}`, text: g.key === "move" ? "✥" : g.label.length === 1 ? g.label : "",
      moved: (x, y) => to(toMap(x, y)),
      stepped(dx, dy) {
        const table = draft ?? current()?.table ?? {};
        const now = gripsOf(table, current()?.fitted ?? null).find((one) => one.key === g.key);
        const [x, y] = placeOf(table).to(now?.at ?? [0, 0]);
        if (now && seen) to([x + dx * seen.scale, y - dy * seen.scale]);
      },
      held(is) {
        const shape = current();
        const table = draft;
        if (is) held = g.key;
        else if (held) {
          held = "";
          draft = null;
          if (shape && table) change(shape, table);
          draw();
        }
      },
    });
    grip.el.classList.add("handle-shape");
    grip.el.dataset.grip = g.key;
    return grip;
  }

  function choose(/** @type {string} */ id) {
    chosen = chosen === id ? "" : id;
    const shape = current();
    if (shape?.table.kind === "line") shown(.../** @type {[Point, Point]} */ (gripsOf(shape.table).slice(1, 3).map((g) => placeOf(shape.table).to(g.at))));
    drawAll();
  }

  function drawList() {
    const shape = current();
    const had = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.shape;
    list.replaceChildren(...shapes().map((one) => chipOf(one, one.index % MOST_LINES, one.id === chosen, choose)), ...(shape ? fieldsOf(shape, change) : []), ...(shape?.table.kind === "circle" ? [fitButton(() => fitAperture(shape))] : []));
    if (!list.childElementCount) list.append(Object.assign(document.createElement("span"), { className: "soft", textContent: "What you draw is listed here, with its values." }));
    if (had) /** @type {HTMLElement | null} */ (list.querySelector(`[data-shape="${had}"]`))?.focus();
  }

  function drawAll() {
    drawBar(bar, tool, keep);
    drawList();
    draw();
  }

  fillBar(bar, (name) => (name === "keep" ? flip() : use(name)));
  el.addEventListener("projected", (event) => {
    seen = /** @type {CustomEvent} */ (event).detail;
    draw();
  });
  drawAll();
  return {
    key, lines: () => linesOf(shapes()),
    addLine: () => tool !== "section" && use("section"),
    /** What keys do, by letter. @type {Record<string, () => void>} */
    acts: { n: flip, ...Object.fromEntries(TOOLS.map(([letter, name]) => [letter.toLowerCase(), () => use(name)])) },
    /** Another recipe, or another file. */
    show() {
      if (chosen && !current()) chosen = "";
      if (held) return;
      drawAll();
    },
    /** What the full pass and the picture say. @param {Dict} header */
    learn(header) {
      for (const one of header.stages ?? []) if (one.centre) centres.set(one.index, one.centre);
      if (header.rows && !header.is_preview) marks = marksOf(header.rows);
      if ("pixel" in header) step = setPixel(header.pixel, header.first ?? undefined);
      draw();
    },
    reset() {
      [tool, chosen, pen, draft, held, step] = ["", "", [], null, "", 0];
      setPixel([1e-6, 1e-6]); // until a map says otherwise
      [centres, marks] = [new Map(), new Map()];
      pad.hidden = true;
    },
  };
}
