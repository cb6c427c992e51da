// @ts-check
// The parts of drawing on the map: the tools, the list of shapes with what may be typed, and their outlines.

import { dragged, kindOf, outline, placeOf, pointText, simplified, written } from "./shapes.js";

/** @typedef {Record<string, any>} Dict */
/** @typedef {import("./shapes.js").Point} Point */
/** @typedef {{ id: string, what: "step" | "section", index: number, table: Dict, name: string, keep: boolean, fitted: Point | null }} Shape */

/** Tools: key, name, words. @type {[string, string, string][]} */
export const TOOLS = [
  ["C", "circle", "Circle: drag from its centre; again for a ring"],
  ["X", "rectangle", "Rectangle: drag from corner to corner; again to crop: what lies outside is removed"],
  ["P", "polygon", "Polygon: click its corners; Enter, a double click or the first corner closes it"],
  ["L", "free", "Free-hand: draw around what is meant"],
  ["B", "brush", "Brush: draw; the wheel changes its radius"],
  ["A", "section", "Section: drag from A to B; with Shift along 0, 45 or 90 degrees"],
  ["G", "round", "Round section: drag from its centre"],
  ["T", "step", "Step height: drag across its edge; again for a groove or ridge: drag from edge to edge; with Shift along 0, 45 or 90 degrees"],
  ["M", "extremes", "Peak and valley: drag from the centre of the circle that is searched"],
  ["D", "distance", "Distance: click two points, then Enter; a third makes an angle, with Shift a circle; Alt takes the peak or valley near by"],
];
/** What sections are called, with a number. */
const NAMES = /** @type {Dict} */ ({ line: "line", circle: "round", distance: "distance", angle: "angle", circle3: "circle", step: "step", groove: "groove", extremes: "spot" });
/** Tools that a second press of their key turns into another. */
export const SECOND = /** @type {Record<string, string>} */ ({ circle: "ring", rectangle: "crop", step: "groove" });

/** @param {Dict[]} sections @param {string} kind */
export function nextName(sections, kind) {
  const taken = new Set(sections.map((s) => s.name));
  let n = 1;
  while (taken.has(`${NAMES[kind]}${n}`)) n += 1;
  return `${NAMES[kind]}${n}`;
}

/** What is drawn of a recipe. @param {Dict} now the session @param {Map<number, Point>} centres that were fitted @returns {Shape[]} */
export function shapesOf(now, centres) {
  const masks = (now.steps ?? []).filter((/** @type {Dict} */ s) => s.op === "mask" && s.enabled && s.keys.aperture);
  return [
    ...masks.map((/** @type {Dict} */ s) => ({ id: `step ${s.index}`, what: "step", index: s.index, table: s.keys.aperture, name: `mask ${s.index + 1}`, keep: s.keys.outside !== false, fitted: centres.get(s.index) ?? null })),
    ...(now.sections ?? []).map((/** @type {Dict} */ t, /** @type {number} */ i) => ({ id: `section ${i}`, what: "section", index: i, table: t, name: t.name ?? `section ${i + 1}`, keep: true, fitted: null })),
  ];
}

/** Ends of the straight sections, of steps and grooves from their one face to the other, x0, y0, x1, y1 on the map. @param {Shape[]} all */
export const linesOf = (all) => all.filter((one) => ["line", "step", "groove"].includes(one.table.kind)).map((one) => outline(one.table).lines[0].points.flatMap(placeOf(one.table).to));

/**
 * Return what the points of a gesture mean so far.
 * @param {string} tool
 * @param {Point[]} points
 * @param {number} near m: how far a line that is drawn may be straightened
 * @param {number} radius m: of the brush
 * @returns {Dict | null}
 */
export function meant(tool, points, near, radius) {
  if (tool === "polygon") return { shape: "polygon", points: points.map((p) => pointText(p)) };
  if (tool === "free") return { shape: "polygon", points: simplified(points, near).map((p) => pointText(p)) };
  if (tool === "brush") return { shape: "brush", radius: written(radius), points: simplified(points, near).map((p) => pointText(p)) };
  if (tool === "distance") {
    const [a, b, c] = points.map((p) => pointText(p));
    return c ? { kind: "angle", a, b, c } : b ? { kind: "distance", a, b } : null;
  }
  return points.length > 1 ? dragged(tool, points[0], points[points.length - 1]) : null;
}

const SVG = "http://www.w3.org/2000/svg";

/** @param {HTMLElement} bar @param {(name: string) => void} act */
export function fillBar(bar, act) {
  for (const [letter, name, words] of [...TOOLS, ["N", "keep", "Keep or exclude what is drawn, or the chosen mask"]]) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "small";
    button.dataset.tool = name;
    button.textContent = name;
    button.dataset.widest = name === "keep" ? "keep inside" : [name, SECOND[name] ?? ""].sort((a, b) => b.length - a.length)[0];
    button.title = `${words} (${letter})`;
    button.addEventListener("click", () => act(name));
    bar.append(button);
  }
}

/** @param {HTMLElement} bar @param {string} tool @param {boolean} keep */
export function drawBar(bar, tool, keep) {
  for (const button of bar.querySelectorAll("button")) {
    const name = button.dataset.tool ?? "";
    button.setAttribute("aria-pressed", String(name === "keep" ? keep : name === tool || (tool && SECOND[name] === tool)));
    if (name === "keep") button.textContent = keep ? "keep inside" : "exclude";
    if (name in SECOND) button.textContent = tool === SECOND[name] ? tool : name;
  }
}

/** @param {Shape} one @param {number} colour @param {boolean} isChosen @param {(id: string) => void} choose */
export function chipOf(one, colour, isChosen, choose) {
  const chip = document.createElement("button");
  chip.type = "button";
  chip.className = `draw-chip ${one.what === "section" ? `section-${colour}` : ""}`;
  chip.dataset.shape = one.id;
  chip.textContent = one.what === "section" ? one.name : `${one.keep ? "keep" : "exclude"}: ${kindOf(one.table)}`;
  chip.title = `${one.name}; Delete removes it, N keeps or excludes`;
  chip.setAttribute("aria-pressed", String(isChosen));
  chip.addEventListener("click", () => choose(one.id));
  return chip;
}

/** Keys of a shape that are chosen. @type {Record<string, string[]>} */
const CHOICES = { bottom: ["flat", "round"] };

/** What may be typed of a shape. @param {Shape} shape @param {(shape: Shape, table: Dict) => void} change */
export function fieldsOf(shape, change) {
  const { points, ...plain } = shape.table;
  const rows = Object.entries(plain).filter(([k]) => !["shape", "kind", "harmonics"].includes(k));
  if (shape.table.kind === "line" && !plain.width) rows.push(["width", ""]);
  if (shape.table.kind === "groove" && !plain.bottom) rows.push(["bottom", "flat"]);
  if (shape.table.shape === "rectangle" && !plain.angle) rows.push(["angle", "0 deg"]);
  const each = points && points.length <= 12 ? points.map((/** @type {any} */ p, /** @type {number} */ i) => [i, p]) : [];
  return [...rows, ...each].map(([k, value]) => {
    const label = document.createElement("label");
    const choices = CHOICES[String(k)];
    const input = document.createElement(choices ? "select" : "input");
    if (input instanceof HTMLSelectElement) for (const one of choices) input.add(new Option(one, one));
    label.append(typeof k === "number" ? `corner ${k + 1}` : String(k).replaceAll("_", " "), input);
    label.className = "draw-field";
    input.value = Array.isArray(value) ? value.join(", ") : String(value);
    input.dataset.key = String(k);
    input.addEventListener("change", () => {
      const text = input.value.trim();
      const isPair = k === "centre" && shape.what === "step" && text.includes(",");
      if (typeof k === "number") change(shape, { ...shape.table, points: points.map((/** @type {any} */ p, /** @type {number} */ i) => (i === k ? text : p)) });
      else if (!text) change(shape, Object.fromEntries(Object.entries(shape.table).filter(([name]) => name !== k)));
      else change(shape, { ...shape.table, [k]: isPair ? text.split(",").map((v) => v.trim()) : text });
    });
    return label;
  });
}

/** @param {string} name @param {Dict} keys */
export function node(name, keys) {
  const made = document.createElementNS(SVG, name);
  for (const [k, v] of Object.entries(keys)) made.setAttribute(k, typeof v === "number" ? v.toFixed(2) : String(v));
  return made;
}

/**
 * Return the outline of a shape.
 * @param {Dict} table
 * @param {Point | null} fitted
 * @param {string} name class
 * @param {(p: Point) => number[]} toScreen of a point of the map
 * @param {number} scale of the map for a pixel of the screen
 * @param {[Point, number][]} marks peaks (1: the tip points down to it) and valleys (-1)
 */
export function groupOf(table, fitted, name, toScreen, scale, marks = []) {
  const { circles, lines } = outline(table, fitted);
  const { to, sides: [dx, dy] } = placeOf(table);
  const on = (/** @type {Point} */ p) => toScreen(to(p));
  const group = node("g", { class: `draw-shape ${name}` });
  /** Of the map for one of the shape, across its first line. @param {Point[]} points */
  const across = ([a, b]) => (b ? Math.hypot((b[1] - a[1]) * dx, (b[0] - a[0]) * dy) / (Math.hypot(b[0] - a[0], b[1] - a[1]) || 1) : dx);
  const both = (/** @type {string} */ tag, /** @type {Dict} */ keys) => group.append(node(tag, { ...keys, class: "under" }), node(tag, { ...keys, class: "over" }));
  for (const [p, sign] of marks) {
    const [x, y] = on(p);
    const d = 7 * sign;
    if (!Number.isFinite(x)) continue;
    both("polygon", { points: `${x},${y} ${x - 6},${y - d * 1.6} ${x + 6},${y - d * 1.6}`, class: "mark" });
    const word = node("text", { x: x + 9, y: y - d + 4, class: "mark-word" });
    word.textContent = sign > 0 ? "peak" : "valley";
    group.append(word);
  }
  for (const { c, r } of circles) {
    const [cx, cy] = on(c);
    const [rx, ry] = [(r * dx) / scale, (r * dy) / scale];
    if (!Number.isFinite(cx)) continue;
    if (rx === ry) both("circle", { cx, cy, r: rx });
    else both("ellipse", { cx, cy, rx, ry });
  }
  for (const { points, closed, width } of lines) {
    const text = points.map((p) => on(p).map((v) => v.toFixed(2)).join(",")).join(" ");
    if (text.includes("NaN")) continue;
    if (width) group.append(node("polyline", { points: text, class: `band${kindOf(table) === "brush" ? " round" : ""}`, "stroke-width": (width * across(points)) / scale }));
    both(closed ? "polygon" : "polyline", { points: text });
  }
  return group;
}

/** Peak and valley of each section that looks for them. @param {Dict[]} rows of the metrics @returns {Map<string, [Point, number][]>} */
export function marksOf(rows) {
  const found = new Map();
  const by = new Map(rows.map((row) => [row.symbol, row.value]));
  for (const symbol of by.keys()) {
    const name = /^section\.(.+)\.peak_x$/.exec(symbol)?.[1];
    const place = (/** @type {string} */ what) => ["x", "y"].map((axis) => by.get(`section.${name}.${what}_${axis}`) ?? NaN);
    if (name) found.set(name, [[place("peak"), 1], [place("valley"), -1]]);
  }
  return found;
}

/** A button that lays a round section into what was measured. @param {() => void} act */
export function fitButton(act) {
  const button = document.createElement("button");
  Object.assign(button, { type: "button", className: "small", textContent: "fit to aperture", title: "Middle of what was measured, 2 % inside its rim" });
  button.addEventListener("click", act);
  return button;
}
