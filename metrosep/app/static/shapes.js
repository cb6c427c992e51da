// @ts-check
// Shapes on a map: what a gesture means in the recipe, and where the recipe lies on the map. Tables hold
// texts with units, as a person types them; here everything is in metres, or in px of the full map where a table
// counts pixels. Nothing touches the page.

/** @typedef {Record<string, any>} Dict */
/** @typedef {[number, number]} Point */
/** @typedef {{ key: string, at: Point, label: string }} Grip */

const UNITS = /** @type {Record<string, number>} */ ({ nm: 1e-9, um: 1e-6, "µm": 1e-6, "μm": 1e-6, mm: 1e-3, cm: 1e-2, m: 1, in: 25.4e-3, px: 1, pixel: 1, pixels: 1 });
const NUMBER = /^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*([a-zA-Zµμ]+)\s*$/i;

/** Digits behind the point of a millimetre; the map says how many its pixels deserve. */
let decimals = 6;

/** Steps of the map and its first pixel, m; null where it has no scale. @type {{ steps: number[], first: number[] } | null} */
let grid = null;
/** What new shapes are written in. */
let base = "mm";

/**
 * Take the scale of a map: texts keep a thousandth of its pixels.
 * @param {number[] | null} steps along x and y, m; null: shapes count pixels
 * @param {number[]} first x and y of the first pixel, m
 * @returns {number} the finest step, 1 px where it is not known
 */
export function setPixel(steps, first = [0, 0]) {
  grid = steps ? { steps, first } : null;
  base = steps ? "mm" : "px";
  const pixel = steps ? Math.min(...steps) : 1;
  if (steps) decimals = Math.max(0, Math.min(12, Math.ceil(-Math.log10(pixel * 1e3)) + 3));
  return pixel;
}

/** Whether new shapes count pixels. */
export const countsPixels = () => base === "px";

/** What a shape is written in: px, or mm for every unit of length. @param {Dict} t */
const unitOf = (t) => (/\d\s*p(x|ixel)/.test(JSON.stringify([t.diameter, t.radius, t.width, t.points, t.a, t.centre])) ? "px" : "mm");

/** Where a shape lies on the map: its own coordinates are those of the map, or px of a map with a scale. @param {Dict} t */
export function placeOf(t) {
  const [same, unit] = [(/** @type {Point} */ p) => p, unitOf(t)];
  if (!grid || unit !== "px") return { to: same, from: same, sides: [1, 1], unit };
  const { steps: [dx, dy], first: [x, y] } = grid;
  return {
    to: (/** @type {Point} */ p) => /** @type {Point} */ ([x + p[0] * dx, y + p[1] * dy]),
    from: (/** @type {Point} */ p) => /** @type {Point} */ ([(p[0] - x) / dx, (p[1] - y) / dy]),
    sides: [dx, dy],
    unit,
  };
}

/** @param {any} text @returns {number} m, or px; NaN where the page does not know the unit */
export function metres(text) {
  const found = NUMBER.exec(String(text));
  return found && UNITS[found[2]] ? Number(found[1]) * UNITS[found[2]] : NaN;
}

/** @param {number} value m, or px @returns {string} */
export const written = (value, unit = base) => (unit === "px" ? `${Number(value.toFixed(3)) + 0} px` : `${Number((value * 1e3).toFixed(decimals)) + 0} mm`);

/** @param {any} value "1 mm, 2 mm", or two texts @returns {Point} */
export function pointOf(value) {
  const parts = typeof value === "string" ? value.split(",") : Array.isArray(value) ? value : [];
  return [metres(parts[0]), metres(parts[1])];
}

/** @param {Point} p */
export const pointText = (p, unit = base) => `${written(p[0], unit)}, ${written(p[1], unit)}`;

/** @param {any} text @returns {number} rad */
function radians(text) {
  const found = NUMBER.exec(String(text ?? "0 rad"));
  if (!found) return NaN;
  return Number(found[1]) * ({ deg: Math.PI / 180, rad: 1, mrad: 1e-3 }[found[2]] ?? NaN);
}

const degrees = (/** @type {number} */ v) => `${Number(((v * 180) / Math.PI).toFixed(3)) + 0} deg`;
const size = (/** @type {number} */ v, unit = base) => written(Math.max(v, unit === "px" ? 1e-3 : 10 ** -decimals * 1e-3), unit);
const plus = (/** @type {Point} */ p, /** @type {number} */ x, /** @type {number} */ y) => /** @type {Point} */ ([p[0] + x, p[1] + y]);
const away = (/** @type {Point} */ p, /** @type {Point} */ q) => Math.hypot(p[0] - q[0], p[1] - q[1]);
const between = (/** @type {Point} */ p, /** @type {Point} */ q) => /** @type {Point} */ ([(p[0] + q[0]) / 2, (p[1] + q[1]) / 2]);

/** What is drawn: shape of an aperture, or kind of a section. @param {Dict} t */
export const kindOf = (t) => String(t.shape ?? t.kind ?? "circle");

/** @param {Dict} t */
const isRound = (t) => ["circle", "ring", "extremes"].includes(kindOf(t));

/** @param {Dict} t @param {Point | null} fitted where centre = "fit" was found */
export function centreOf(t, fitted = null) {
  if (t.centre === undefined || t.centre === "fit") return fitted ?? /** @type {Point} */ ([NaN, NaN]);
  return pointOf(t.centre);
}

/** @param {Dict} t @returns {Point[]} */
const corners = (t) => (Array.isArray(t.points) ? t.points.map(pointOf) : ["a", "b", "c"].filter((k) => k in t).map((k) => pointOf(t[k])));

function turned(/** @type {Dict} */ t, /** @type {Point} */ c) {
  const [angle, w, h] = [radians(t.angle), metres(t.width) / 2, metres(t.height) / 2];
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return { angle, w, h, at: (/** @type {number} */ u, /** @type {number} */ v) => plus(c, u * cos - v * sin, u * sin + v * cos) };
}

/**
 * Return what is drawn: lines, closed or not; round ones as circles.
 * @param {Dict} t
 * @param {Point | null} fitted
 * @returns {{ circles: { c: Point, r: number }[], lines: { points: Point[], closed: boolean, width?: number }[] }}
 */
export function outline(t, fitted = null) {
  const kind = kindOf(t);
  const c = centreOf(t, fitted);
  if (isRound(t)) {
    const sizes = "radius" in t ? [2 * metres(t.radius)] : [metres(t.diameter), metres(t.inner_diameter)];
    return { circles: sizes.filter((d) => d > 0).map((d) => ({ c, r: d / 2 })), lines: [] };
  }
  if (kind === "rectangle") {
    const { w, h, at } = turned(t, c);
    return { circles: [], lines: [{ points: [at(-w, -h), at(w, -h), at(w, h), at(-w, h)], closed: true }] };
  }
  const points = corners(t);
  if (kind === "circle3") {
    const found = through(points);
    return { circles: found ? [found] : [], lines: [] };
  }
  if (kind === "step" || kind === "groove") return { circles: [], lines: facesOf(t, points) };
  const width = kind === "brush" ? 2 * metres(t.radius) : kind === "line" && t.width ? metres(t.width) : undefined;
  return { circles: [], lines: [{ points, closed: kind === "polygon", width }] };
}

/** The parts of a band whose heights are fitted: thirds of a step; of a groove its bottom and faces. @param {Dict} t @param {Point[]} points */
function facesOf(t, [a, b]) {
  const [m, length, half] = [between(a, b), away(a, b) || 1, metres(t.width) / 2];
  const [u, v] = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
  const at = (/** @type {number} */ along, /** @type {number} */ across) => plus(m, u * along * length - v * across, v * along * length + u * across);
  const reach = kindOf(t) === "step" ? 1 / 2 : 3 / 2;
  const parts = kindOf(t) === "step" ? [[-1 / 2, -1 / 6], [1 / 6, 1 / 2]] : [[-3 / 2, -5 / 6], [-1 / 6, 1 / 6], [5 / 6, 3 / 2]];
  return [{ points: [at(-reach, 0), at(reach, 0)], closed: false },
    ...parts.map(([p, q]) => ({ points: [at(p, -half), at(q, -half), at(q, half), at(p, half)], closed: true }))];
}

/** @param {Point[]} points three @returns {{ c: Point, r: number } | null} */
function through([a, b, c]) {
  if (!c) return null;
  const [ux, uy, vx, vy] = [a[0] - b[0], a[1] - b[1], c[0] - b[0], c[1] - b[1]];
  const cross = 2 * (ux * vy - uy * vx);
  if (!cross) return null;
  const [u, v] = [ux * ux + uy * uy, vx * vx + vy * vy];
  const [x, y] = [(vy * u - uy * v) / cross, (ux * v - vx * u) / cross];
  return { c: plus(b, x, y), r: Math.hypot(x, y) };
}

/** Where a shape is held to be moved. @param {Dict} t @param {Point | null} fitted @returns {Point} */
function middle(t, fitted) {
  if (isRound(t) || kindOf(t) === "rectangle") return centreOf(t, fitted);
  const points = corners(t);
  if (["line", "distance", "step", "groove"].includes(kindOf(t))) return between(points[0], points[1]);
  const sum = points.reduce((s, p) => plus(s, p[0], p[1]), /** @type {Point} */ ([0, 0]));
  return [sum[0] / points.length, sum[1] / points.length];
}

/**
 * Return the handles of a shape.
 * @param {Dict} t
 * @param {Point | null} fitted
 * @returns {Grip[]}
 */
export function gripsOf(t, fitted = null) {
  const kind = kindOf(t);
  const m = middle(t, fitted);
  const grips = [{ key: "move", at: m, label: isRound(t) || kind === "rectangle" ? "centre" : "whole" }];
  if (isRound(t)) {
    grips.push({ key: "radius", at: plus(m, "radius" in t ? metres(t.radius) : metres(t.diameter) / 2, 0), label: "radius" });
    if (kind === "ring") grips.push({ key: "inner", at: plus(m, 0, metres(t.inner_diameter) / 2), label: "inner radius" });
  } else if (kind === "rectangle") {
    const { w, h, at } = turned(t, m);
    grips.push({ key: "corner", at: at(w, h), label: "corner" }, { key: "turn", at: at(w, 0), label: "angle" });
  } else {
    corners(t).forEach((p, i) => grips.push({ key: `point ${i}`, at: p, label: t.points ? `corner ${i + 1}` : "ABC"[i] }));
    if (["line", "step", "groove"].includes(kind)) grips.push({ key: "width", at: beside(t), label: "width" });
    if (kind === "brush") grips.push({ key: "brush", at: plus(corners(t)[0], 0, metres(t.radius)), label: "radius" });
  }
  return grips;
}

/** The side of a band, where its width is held. @param {Dict} t @returns {Point} */
function beside(t) {
  const [a, b] = corners(t);
  const length = away(a, b) || 1;
  const half = t.width ? metres(t.width) / 2 / length : 0.06; // a line without a band: pulled sideways it gets one
  return plus(between(a, b), -(b[1] - a[1]) * half, (b[0] - a[0]) * half);
}

/** @param {Dict} t @param {number} i @param {Point} p */
function withPoint(t, i, p) {
  if (!t.points) return { ...t, ["abc"[i]]: pointText(p, unitOf(t)) };
  return { ...t, points: t.points.map((/** @type {any} */ one, /** @type {number} */ k) => (k === i ? pointText(p, unitOf(t)) : one)) };
}

/**
 * Return a shape of which one handle was put elsewhere.
 * @param {Dict} t
 * @param {string} key
 * @param {Point} p
 * @param {Point | null} fitted
 * @returns {Dict}
 */
export function moved(t, key, p, fitted = null) {
  const m = middle(t, fitted);
  if (key === "move") {
    const [dx, dy] = [p[0] - m[0], p[1] - m[1]];
    if (isRound(t) || kindOf(t) === "rectangle") return { ...t, centre: "kind" in t ? pointText(p, unitOf(t)) : [written(p[0], unitOf(t)), written(p[1], unitOf(t))] };
    return corners(t).reduce((s, q, i) => withPoint(s, i, plus(q, dx, dy)), t);
  }
  if (key === "radius") return "radius" in t ? { ...t, radius: size(away(m, p), unitOf(t)) } : { ...t, diameter: size(2 * away(m, p), unitOf(t)) };
  if (key === "inner") return { ...t, inner_diameter: size(2 * away(m, p), unitOf(t)) };
  if (key === "brush") return { ...t, radius: size(away(corners(t)[0], p), unitOf(t)) };
  if (key === "turn") return { ...t, angle: degrees(Math.atan2(p[1] - m[1], p[0] - m[0])) };
  if (key === "corner") {
    const { angle } = turned(t, m);
    const [x, y] = [p[0] - m[0], p[1] - m[1]];
    const [u, v] = [x * Math.cos(angle) + y * Math.sin(angle), y * Math.cos(angle) - x * Math.sin(angle)];
    return { ...t, width: size(2 * Math.abs(u), unitOf(t)), height: size(2 * Math.abs(v), unitOf(t)) };
  }
  if (key === "width") {
    const [a, b] = corners(t);
    const across = Math.abs((p[0] - a[0]) * (b[1] - a[1]) - (p[1] - a[1]) * (b[0] - a[0])) / (away(a, b) || 1);
    return { ...t, width: size(2 * across, unitOf(t)) };
  }
  return withPoint(t, Number(key.split(" ")[1]), p);
}

/** A polygon with one corner less; null where three are left. @param {Dict} t @param {number} i */
export function withoutCorner(t, i) {
  if (!t.points || t.points.length <= (kindOf(t) === "polygon" ? 3 : 1)) return null;
  return { ...t, points: t.points.filter((/** @type {any} */ _, /** @type {number} */ k) => k !== i) };
}

/** A polygon with a corner more, on its edge that lies nearest. @param {Dict} t @param {Point} p */
export function withCorner(t, p) {
  const points = corners(t);
  const n = kindOf(t) === "polygon" ? points.length : points.length - 1;
  const far = Array.from({ length: n }, (_, i) => toSegment(p, points[i], points[(i + 1) % points.length]));
  const at = far.indexOf(Math.min(...far)) + 1;
  return { ...t, points: [...t.points.slice(0, at), pointText(p, unitOf(t)), ...t.points.slice(at)] };
}

/** @param {Point} p @param {Point} a @param {Point} b */
function toSegment(p, a, b) {
  const [ux, uy] = [b[0] - a[0], b[1] - a[1]];
  const square = ux * ux + uy * uy;
  const part = square ? Math.max(0, Math.min(1, ((p[0] - a[0]) * ux + (p[1] - a[1]) * uy) / square)) : 0;
  return Math.hypot(p[0] - a[0] - part * ux, p[1] - a[1] - part * uy);
}

/** Fewer points that lie nowhere farther than a distance (Douglas, Peucker). @param {Point[]} points @param {number} near */
function fewer(points, near) {
  const keep = new Set([0, points.length - 1]);
  const open = [[0, points.length - 1]];
  for (let part = open.pop(); part; part = open.pop()) {
    const [first, last] = part;
    let [far, at] = [near, -1];
    for (let i = first + 1; i < last; i += 1) {
      const d = toSegment(points[i], points[first], points[last]);
      if (d > far) [far, at] = [d, i];
    }
    if (at > 0) keep.add(at), open.push([first, at], [at, last]);
  }
  return points.filter((_, i) => keep.has(i));
}

/** @param {Point[]} points @param {number} near m @param {number} most @returns {Point[]} */
export function simplified(points, near, most = 400) {
  let found = fewer(points, near);
  for (let d = 1.5 * near; found.length > most; d *= 1.5) found = fewer(points, d);
  return found;
}

/** Ends of a line that shall run along 0, 45 or 90 degrees. @param {Point} a @param {Point} b @returns {Point} */
export function straightened(a, b) {
  const [x, y] = [b[0] - a[0], b[1] - a[1]];
  const angle = (Math.round(Math.atan2(y, x) / (Math.PI / 4)) * Math.PI) / 4;
  const along = x * Math.cos(angle) + y * Math.sin(angle);
  return plus(a, along * Math.cos(angle), along * Math.sin(angle));
}

/**
 * Return what a drag from one place to another means.
 * @param {string} tool
 * @param {Point} a
 * @param {Point} b
 * @returns {Dict | null} null where it is too short to be meant
 */
export function dragged(tool, a, b) {
  const r = away(a, b);
  const [w, h] = [Math.abs(b[0] - a[0]), Math.abs(b[1] - a[1])];
  const centre = (/** @type {Point} */ p) => [written(p[0]), written(p[1])];
  if (!(r > 0)) return null;
  if (tool === "circle") return { shape: "circle", diameter: size(2 * r), centre: centre(a) };
  if (tool === "ring") return { shape: "ring", diameter: size(2 * r), inner_diameter: size(r), centre: centre(a) };
  if (tool === "rectangle" || tool === "crop") return w > 0 && h > 0 ? { shape: "rectangle", width: size(w), height: size(h), centre: centre(between(a, b)) } : null;
  if (tool === "section") return { kind: "line", a: pointText(a), b: pointText(b) };
  if (tool === "round" || tool === "extremes") return { kind: tool === "round" ? "circle" : tool, centre: pointText(a), radius: size(r) };
  if (tool === "step" || tool === "groove") return { kind: tool, a: pointText(a), b: pointText(b), width: size(r / 2) };
  return null;
}

/** Whether corners span an area: three or more, not all on one line. One that crosses itself does. @param {Point[]} points */
export function spans(points) {
  const [x, y] = points[0] ?? [0, 0];
  const far = points.reduce((most, p) => (Math.hypot(p[0] - x, p[1] - y) > Math.hypot(most[0] - x, most[1] - y) ? p : most), [x, y]);
  const size = (far[0] - x) ** 2 + (far[1] - y) ** 2;
  return points.some((p) => Math.abs((far[0] - x) * (p[1] - y) - (far[1] - y) * (p[0] - x)) > 1e-6 * size);
}
