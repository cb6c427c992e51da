// @ts-check
// Pictures of a method: curves, about a circle too; of a machine its terms and what the readings do not determine.

import { painted } from "./colours.js";
import { places, plain, scaleFor, si, ticks } from "./format.js";
import { DASHES, roundOf } from "./machine_round.js";
import { Refusal, Superseded } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

const [WIDTH, HEIGHT] = [760, 210];
const FRAME = { left: 74, right: 12, top: 8, bottom: 38 };

function make_(/** @type {string} */ tag, /** @type {Dict} */ properties = {}, /** @type {(Node | string)[]} */ ...children) {
  const made = /** @type {any} */ (Object.assign(document.createElement(tag), properties));
  made.append(...children);
  return made;
}

function svg_(/** @type {string} */ tag, /** @type {Dict} */ attributes, /** @type {string} */ text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [k, v] of Object.entries(attributes)) made.setAttribute(k, String(v));
  if (text) made.textContent = text;
  return made;
}

/** Return the ends of finite numbers, a little wider. @param {number[]} values @returns {[number, number]} */
function ends(values) {
  const known = values.filter(Number.isFinite);
  const [low, high] = [Math.min(...known), Math.max(...known)];
  if (!known.length) return [0, 1];
  const margin = 0.06 * (high - low) || Math.abs(high) || 1;
  return [low - margin, high + margin];
}

/** A unit that a person reads: turns in degrees. @param {string} unit @returns {[number, string]} */
const turned = (unit) => (unit === "rad" ? [Math.PI / 180, "deg"] : [0, ""]);

/** Return the factor and name of the unit of an axis. @param {number[]} at @param {string} unit @param {boolean} [position] */
function scaled(at, unit, position = false) {
  const [degrees, name] = position ? turned(unit) : [0, ""];
  return degrees ? /** @type {[number, string]} */ ([degrees, name]) : scaleFor(Math.max(...at.map(Math.abs)), unit === "1" ? "" : unit);
}

/** Return one panel of curves as a drawing. @param {Dict} panel @param {Dict} chart */
function panelOf(panel, chart) {
  const number = (/** @type {any} */ v) => (v === null ? NaN : v);
  const curves = panel.curves.map((/** @type {Dict} */ c) => ({ ...c, x: c.x.map(number), y: c.y.map(number), u: c.u?.map(number) ?? null }));
  const [x0, x1] = ends(curves.flatMap((/** @type {Dict} */ c) => c.x));
  const [y0, y1] = ends(curves.flatMap((/** @type {Dict} */ c) => (c.u ? c.y.flatMap((/** @type {number} */ y, /** @type {number} */ i) => [y - c.u[i], y + c.u[i]]) : c.y)));
  const left = (/** @type {number} */ x) => FRAME.left + ((x - x0) / (x1 - x0)) * (WIDTH - FRAME.left - FRAME.right);
  const top = (/** @type {number} */ y) => HEIGHT - FRAME.bottom - ((y - y0) / (y1 - y0)) * (HEIGHT - FRAME.top - FRAME.bottom);
  const svg = svg_("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "machine-plot", role: "img" });
  svg.setAttribute("aria-label", `${panel.title || chart.title} over ${chart.x.name}`);
  const [fx, ux] = scaled([x0, x1], chart.x.unit, true);
  const [fy, uy] = scaled([y0, y1], panel.unit);
  const xs = places(x0 / fx, x1 / fx, (x1 - x0) / fx / 5, "").map((v) => v * fx);
  const ys = places(y0 / fy, y1 / fy, (y1 - y0) / fy / 5, "").map((v) => v * fy);
  ticks(xs, fx).forEach((text, i) => svg.append(svg_("line", { x1: left(xs[i]), x2: left(xs[i]), y1: FRAME.top, y2: HEIGHT - FRAME.bottom, class: "grid" }),
    svg_("text", { x: left(xs[i]), y: HEIGHT - FRAME.bottom + 15, "text-anchor": "middle" }, text)));
  ticks(ys, fy).forEach((text, i) => svg.append(svg_("line", { y1: top(ys[i]), y2: top(ys[i]), x1: FRAME.left, x2: WIDTH - FRAME.right, class: "grid" }),
    svg_("text", { x: FRAME.left - 6, y: top(ys[i]) + 4, "text-anchor": "end" }, text)));
  svg.append(svg_("text", { x: WIDTH - FRAME.right, y: HEIGHT - 6, "text-anchor": "end", class: "unit" }, `${chart.x.name}${ux ? ` / ${ux}` : ""}`),
    svg_("text", { x: 4, y: FRAME.top + 10, class: "unit" }, uy));
  curves.forEach((/** @type {Dict} */ c, /** @type {number} */ k) => {
    const colour = `var(--feed-${k % 6})`;
    const at = c.x.map((/** @type {number} */ x, /** @type {number} */ i) => [x, c.y[i], c.u ? c.u[i] : 0]).filter((/** @type {number[]} */ p) => p.every(Number.isFinite));
    if (c.u) {
      const edge = [...at.map((/** @type {number[]} */ p) => [p[0], p[1] + p[2]]), ...[...at].reverse().map((p) => [p[0], p[1] - p[2]])];
      svg.append(svg_("path", { d: edge.map((p, i) => `${i ? "L" : "M"}${left(p[0]).toFixed(1)} ${top(p[1]).toFixed(1)}`).join(""), class: "band", style: `fill: ${colour}` }));
    }
    if (c.points) {
      for (const p of at) svg.append(svg_("circle", { cx: left(p[0]).toFixed(1), cy: top(p[1]).toFixed(1), r: 1.9, style: `fill: ${colour}` }));
    } else {
      svg.append(svg_("path", { d: at.map((/** @type {number[]} */ p, /** @type {number} */ i) => `${i ? "L" : "M"}${left(p[0]).toFixed(1)} ${top(p[1]).toFixed(1)}`).join(""),
        class: "line", style: `stroke: ${colour}`, "stroke-dasharray": DASHES[k % DASHES.length] }));
    }
  });
  const readout = make_("span", { className: "machine-readout soft" });
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    const x = x0 + (((event.clientX - box.left) / box.width) * WIDTH - FRAME.left) / (WIDTH - FRAME.left - FRAME.right) * (x1 - x0);
    const near = curves.filter((/** @type {Dict} */ c) => c.x.length).map((/** @type {Dict} */ c) => {
      const i = c.x.reduce((/** @type {number} */ best, /** @type {number} */ v, /** @type {number} */ j) => (Math.abs(v - x) < Math.abs(c.x[best] - x) ? j : best), 0);
      return `${c.label ? `${c.label} ` : ""}${si(c.y[i], panel.unit)}${c.u ? ` (u ${si(c.u[i], panel.unit, 2)})` : ""}`;
    });
    const place = ux === "deg" ? `${plain(x / fx, 4)} deg` : si(x, chart.x.unit);
    readout.textContent = `${place}: ${near.join(", ")}`;
  });
  svg.addEventListener("pointerleave", () => { readout.textContent = ""; });
  const legend = make_("span", { className: "machine-legend" });
  curves.forEach((/** @type {Dict} */ c, /** @type {number} */ k) => {
    if (!c.label) return;
    const mark = svg_("svg", { width: 26, height: 8, "aria-hidden": "true" });
    mark.append(c.points ? svg_("circle", { cx: 13, cy: 4, r: 3, style: `fill: var(--feed-${k % 6})` })
      : svg_("line", { x1: 1, x2: 25, y1: 4, y2: 4, "stroke-width": 2, style: `stroke: var(--feed-${k % 6})`, "stroke-dasharray": DASHES[k % DASHES.length] }));
    legend.append(make_("span", {}, mark, ` ${c.label}`));
  });
  return [make_("div", { className: "machine-head" }, make_("b", { textContent: panel.title }), legend, readout), svg];
}

/** Return the motion of a spindle in polar form: revolutions thin, the synchronous motion over them. @param {Dict} chart */
function spindleOf(chart) {
  const { angle, unit, synchronous } = chart;
  const [low, high, ...turns] = chart.motion;
  const curves = [...turns.map((/** @type {number[]} */ z) => ({ angle, z, thin: true })), { angle, z: synchronous }];
  const values = Object.entries(chart.values).map(([name, value]) => `${name} ${si(/** @type {number} */ (value), unit)}`).join(", ");
  return [make_("div", { className: "machine-head" }, make_("b", { textContent: chart.direction }), make_("span", { className: "machine-readout", textContent: values })),
    roundOf(curves, unit, chart.title, { band: [{ angle, z: low }, { angle, z: high }], circles: [Math.min(...synchronous), Math.max(...synchronous)] })];
}

/** Return curves over an angle: about a circle too, the first panel or each, all enlarged alike. @param {Dict} chart */
function curvesOf(chart) {
  const panels = chart.panels.flatMap((/** @type {Dict} */ panel) => panelOf(panel, chart));
  if (!chart.closed) return panels;
  const turned = chart.each ? chart.panels : chart.panels.slice(0, 1);
  const all = (/** @type {Dict[]} */ some, /** @type {string} */ unit) => some.filter((one) => one.unit === unit).flatMap((one) => one.curves.flatMap((/** @type {Dict} */ c) => c.y)).filter((v) => v !== null);
  return [make_("div", { className: "machine-rounds" }, ...turned.map((/** @type {Dict} */ panel) => {
    const own = all([panel], panel.unit);
    const circles = chart.each && panel.curves.length === 1 ? [Math.min(...own), Math.max(...own)] : [];
    const round = roundOf(panel.curves.map((/** @type {Dict} */ c) => ({ angle: c.x, z: c.y })), panel.unit, panel.title || chart.title, { circles, most: Math.max(...all(turned, panel.unit).map(Math.abs)) });
    return make_("figure", {}, round, ...(turned.length > 1 ? [make_("figcaption", { textContent: panel.title })] : []));
  })), ...panels];
}

/** Return values with their uncertainty as bars. @param {Dict} chart */
function barsOf(chart) {
  const [name] = Object.keys(chart.series);
  const [values, us] = [chart.series[name], chart.u?.[name] ?? []];
  const largest = Math.max(...values.map((/** @type {number} */ v, /** @type {number} */ i) => Math.abs(v) + (us[i] ?? 0)), 0) || 1;
  const body = make_("tbody");
  chart.labels.forEach((/** @type {string} */ label, /** @type {number} */ i) => {
    const at = (/** @type {number} */ v) => 50 + (48 * v) / largest;
    const bar = svg_("svg", { viewBox: "0 0 100 10", preserveAspectRatio: "none", "aria-hidden": "true", class: "machine-bar" });
    bar.append(svg_("line", { x1: 50, x2: 50, y1: 0, y2: 10, class: "zero" }),
      svg_("rect", { x: Math.min(at(0), at(values[i])), width: Math.abs(at(values[i]) - 50), y: 2, height: 6 }),
      svg_("line", { x1: at(values[i] - (us[i] ?? 0)), x2: at(values[i] + (us[i] ?? 0)), y1: 5, y2: 5, class: "u" }));
    body.append(make_("tr", {}, make_("th", { scope: "row", textContent: label }), make_("td", { className: "machine-bars" }, bar),
      make_("td", { className: "number", textContent: si(values[i], chart.unit) }),
      make_("td", { className: "number soft", textContent: us[i] === undefined ? "" : `u ${si(us[i], chart.unit, 2)}` })));
  });
  return [make_("table", { className: "machine-table" }, body)];
}

/** Return the harmonics that were kept as bars: those that were removed would dwarf them. @param {Dict} chart */
function harmonicsOf({ k, amplitude, u, unit, suppressed }) {
  const kept = k.map((/** @type {number} */ order, /** @type {number} */ i) => ({ order, i })).filter((/** @type {Dict} */ one) => !suppressed.includes(one.order));
  const of = (/** @type {number[] | null} */ values) => (values ? kept.map((/** @type {Dict} */ one) => values[one.i]) : []);
  return barsOf({ labels: kept.map((/** @type {Dict} */ one) => String(one.order)), series: { amplitude: of(amplitude) }, u: { amplitude: of(u) }, unit });
}

/** Return maps as pictures with their scale. @param {Dict} chart */
function mapsOf(chart) {
  return Object.entries(chart.parts).flatMap(([name, rows]) => {
    const table = /** @type {(number | null)[][]} */ (rows);
    const [height, width] = [table.length, table[0].length];
    const known = table.flat().filter((v) => v !== null).map(Number);
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const index = new Uint8Array(width * height);
    table.forEach((row, j) => row.forEach((v, i) => {
      index[(height - 1 - j) * width + i] = v === null ? 0 : 1 + Math.round((254 * (v - low)) / (high - low || 1));
    }));
    const canvas = make_("canvas", { width, height, className: "machine-map" });
    canvas.getContext("2d").putImageData(painted(index, null, width, height, "viridis"), 0, 0);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${name}: ${si(low, chart.unit)} to ${si(high, chart.unit)}`);
    const bar = make_("canvas", { width: 1, height: 255, className: "machine-scale" });
    bar.getContext("2d").putImageData(painted(Uint8Array.from({ length: 255 }, (_, i) => 255 - i), null, 1, 255, "viridis"), 0, 0);
    const readout = make_("span", { className: "machine-readout soft" });
    const [x0, y0] = chart.origin_m;
    canvas.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => {
      const box = canvas.getBoundingClientRect();
      const i = Math.min(width - 1, Math.max(0, Math.floor(((event.clientX - box.left) / box.width) * width)));
      const j = Math.min(height - 1, Math.max(0, height - 1 - Math.floor(((event.clientY - box.top) / box.height) * height)));
      readout.textContent = `${si(x0 + i * chart.dx_m)}, ${si(y0 + j * chart.dy_m)}: ${si(table[j][i], chart.unit)}`;
    });
    canvas.addEventListener("pointerleave", () => { readout.textContent = ""; });
    const right = x0 + (width - 1) * chart.dx_m;
    const upper = y0 + (height - 1) * chart.dy_m;
    return [make_("div", { className: "machine-head" }, make_("b", { textContent: name }), readout),
      make_("div", { className: "machine-picture" },
        make_("div", { className: "machine-ends" }, make_("span", { textContent: si(upper) }), make_("span", { textContent: si(y0) })),
        make_("div", {}, canvas, make_("div", { className: "machine-below" }, make_("span", { textContent: si(x0) }), make_("span", { textContent: si(right) }))),
        bar, make_("div", { className: "machine-ends" }, make_("span", { textContent: si(high, chart.unit) }), make_("span", { textContent: si(low, chart.unit) })))];
  });
}

const DRAWN = /** @type {Record<string, (chart: Dict) => Node[]>} */ ({
  curves: curvesOf,
  polar: spindleOf,
  harmonics: harmonicsOf,
  bars: barsOf,
  maps: mapsOf,
});

/** @param {import("./tabs.js").Context} context @returns {import("./tabs.js").Tab} */
export function make({ el, wire, session, schema, edit, fail }) {
  let of = "";
  const state = make_("p", { className: "soft ranking-state" });
  state.setAttribute("role", "status");
  const scroll = make_("div", { className: "scroll machine", tabIndex: 0, role: "region", ariaLabel: "Terms and pictures of the machine" });
  el.replaceChildren(state, scroll);

  async function show() {
    if (of === session().hash) return;
    const wanted = session().hash;
    state.textContent = "computing…";
    scroll.classList.add("outdated");
    try {
      const { header } = await wire.ask("machine");
      if (session().hash !== wanted) return;
      of = wanted;
      state.textContent = "";
      scroll.classList.remove("outdated");
      draw(header);
    } catch (error) {
      if (error instanceof Superseded || session().hash !== wanted) return;
      if (error instanceof Refusal) state.textContent = `not computed: ${error.message}`;
      else fail(error);
    }
  }

  function termsOf(/** @type {Dict[]} */ rows) {
    const body = make_("tbody");
    for (const row of rows) {
      const known = row.value !== null;
      const tr = make_("tr", { className: known ? "" : "soft" }, make_("th", { scope: "row", textContent: row.term }), make_("td", { textContent: row.words }),
        make_("td", { className: "number", textContent: known ? si(row.value, row.unit) : "not determined" }),
        make_("td", { className: "number soft", textContent: known ? `u ${si(row.u, row.unit, 2)}` : "" }),
        make_("td", { className: "soft", textContent: row.kind === "P-V" ? `P-V over ${row.axis}, largest u` : "" }));
      tr.dataset.term = row.term;
      body.append(tr);
    }
    const table = make_("table", { className: "machine-table" }, body);
    table.setAttribute("aria-label", "Error terms of the machine");
    return table;
  }

  function listOf(/** @type {string} */ title, /** @type {string[]} */ texts, /** @type {string} */ name) {
    if (!texts.length) return [];
    return [make_("h2", { textContent: title }), make_("ul", { className: name }, ...texts.map((textContent) => make_("li", { textContent })))];
  }

  /** The centre of the motion of a spindle, chosen beside its picture: an edit of the step. */
  function centres() {
    const { op, keys } = session().steps[0];
    const known = schema().find((one) => one.op === op)?.keys.find((/** @type {Dict} */ one) => one.name === "center");
    if (!known) return [];
    const select = make_("select", {}, ...known.choices.map((/** @type {string} */ value) => make_("option", { value, textContent: value })));
    select.value = keys.center ?? known.choices[0];
    select.addEventListener("change", () => edit([{ path: ["step", 0, "center"], old: session().steps[0].keys.center ?? null, new: select.value }], `centre ${select.value}`));
    return [make_("label", { className: "machine-centre", title: known.help ?? "" }, "centre ", select)];
  }

  /** What is about a circle is first, then maps. @param {Dict} chart */
  const order = (chart) => (chart.closed ? 0 : chart.kind === "maps" ? 1 : 2);

  function draw(/** @type {Dict} */ found) {
    const pictures = [...found.charts].sort((a, b) => order(a) - order(b));
    scroll.replaceChildren(
      ...(found.rows.length ? [make_("h2", { textContent: "Terms, actual minus nominal" }), termsOf(found.rows)] : []),
      ...listOf("What the readings do not determine", found.null, "machine-null"),
      ...pictures.flatMap((/** @type {Dict} */ chart) => [make_("h2", { textContent: chart.title }),
        ...(chart.kind === "polar" && ["radial", "tilt"].includes(chart.direction) ? centres() : []), ...(DRAWN[chart.kind]?.(chart) ?? []), ...(chart.caption ? [make_("p", { className: "soft machine-caption", textContent: chart.caption })] : [])]),
      ...(pictures.length || found.rows.length ? [] : [make_("p", { className: "soft", textContent: "This method draws nothing: its numbers are in the list beside, and in the report." })]),
      ...listOf("Messages", found.messages, "machine-messages"),
    );
  }

  return {
    show,
    changed(next, isNewFile) {
      if (isNewFile) {
        of = "";
        scroll.replaceChildren();
      } else if (of !== next.hash) {
        scroll.classList.add("outdated");
      }
    },
  };
}
