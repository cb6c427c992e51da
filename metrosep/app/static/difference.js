// @ts-check
// What two results differ by, drawn: the difference map, or both curves above their difference.

import colourbarWidget from "./colourbar.js";
import { DIVERGING } from "./colours.js";
import { si } from "./format.js";
import { preferred } from "./remember.js";
import mapWidget from "./map.js";
import { ink, makePlot } from "./plots.js";
import { makeModel, Superseded } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

/**
 * Return one x for several lines: null where a line was not measured, undefined where it has no
 * sample at this x, so that nothing is drawn as a gap that is none.
 * @param {{ x: ArrayLike<number>, low: ArrayLike<number>, high: ArrayLike<number> }[]} lines
 * @returns {any[][]}
 */
export function joined(lines) {
  const all = [...new Set(lines.flatMap((line) => Array.from(line.x)))].sort((a, b) => a - b);
  const at = new Map(all.map((x, i) => [x, i]));
  const out = /** @type {any[][]} */ ([all]);
  for (const line of lines) {
    for (const values of [line.low, line.high]) {
      const column = new Array(all.length).fill(undefined);
      for (let i = 0; i < line.x.length; i += 1) {
        column[/** @type {number} */ (at.get(line.x[i]))] = Number.isNaN(values[i]) ? null : values[i];
      }
      out.push(column);
    }
  }
  return out;
}

/**
 * Two maps beside one another in the same colours: one window, one cursor, one colour bar.
 * @param {(side: "a" | "b", view: Dict) => Promise<import("./wire.js").Answer>} ask
 * @param {() => boolean} known whether there is another result: a map that is cleared moves its view too
 * @param {(error: unknown) => void} fail
 */
function makeSides(ask, known, fail) {
  const el = document.createElement("div");
  el.className = "side-row";
  el.hidden = true;
  let following = false; // a map that follows the other does not lead
  const maps = (/** @type {("a" | "b")[]} */ (["a", "b"])).map((side) => {
    const [box, name, map] = ["div", "p", "div"].map((tag) => document.createElement(tag));
    box.append(name, map);
    el.append(box);
    const model = makeModel({ colours: preferred("colours", "viridis") }, (changes) => {
      if ("limits" in changes) limit(changes.limits);
      if (!("view" in changes)) return;
      load();
      const to = other();
      if (following || !to.model.get("extent")) return;
      following = true;
      to.model.put(model.get("view").fitted ? { fit: 1 } : { goto: model.get("view").window });
      following = false;
    });
    const other = () => maps[side === "a" ? 1 : 0];
    model.on("change:cursor", () => other().model.put({ linked: model.get("cursor") }));
    mapWidget.render({ model, el: map });
    async function load() {
      if (el.hidden || !known()) return;
      const view = model.get("view");
      try {
        const { header, arrays } = await ask(side, { window: model.get("extent") ? view?.window ?? null : null, pixels: view?.pixels ?? [512, 512], range: model.get("limits") ?? null });
        model.put({ shape: arrays.index.shape, window: header.window, unit: header.unit, range: header.range,
          ...(model.get("limits") ? {} : { auto_range: header.range }), index: arrays.index });
        if (String(model.get("extent")) !== String(header.extent)) model.put({ extent: header.extent });
        el.dataset.drawn = String(maps.filter((one) => one.model.get("index")).length);
      } catch (error) {
        if (!(error instanceof Superseded)) fail(error);
      }
    }
    return { model, name, map, load };
  });
  const bar = document.createElement("div");
  el.append(bar);
  colourbarWidget.render({ model: maps[1].model, el: bar });

  function limit(/** @type {number[] | null} */ limits) {
    for (const one of maps) {
      one.model.put({ limits });
      one.load();
    }
  }

  return {
    el,
    /** @param {string[]} names */
    name(names) {
      maps.forEach((one, i) => {
        one.name.textContent = names[i];
        one.map.querySelector("canvas")?.setAttribute("aria-label", `Map of ${names[i]}. Wheel or plus and minus zoom, drag or arrows pan; the other map follows.`);
        one.model.put({ index: null, shape: null, extent: null, limits: null, auto_range: null });
      });
    },
    show: () => maps.forEach((one) => one.load()),
  };
}

/**
 * @param {HTMLElement} el
 * @param {import("./wire.js").Wire} wire
 * @param {(error: unknown) => void} fail
 */
export function makeDifference(el, wire, fail) {
  /** @type {Dict | null} */
  let against = null;
  /** @type {Dict | null} of whom both maps are there */
  let besides = null;
  const title = document.createElement("p");
  title.className = "difference-title";
  const mapRow = document.createElement("div");
  mapRow.className = "map-row";
  const [mapEl, barEl] = [document.createElement("div"), document.createElement("div")];
  mapRow.append(mapEl, barEl);
  const both = document.createElement("div");
  both.className = "plot";
  const left = document.createElement("div");
  left.className = "plot";
  el.replaceChildren(title, mapRow, both, left);
  el.hidden = true;
  const model = makeModel({ colours: DIVERGING }, (changes) => {
    if ("view" in changes || "limits" in changes) ask();
  });
  const sides = makeSides((side, view) => wire.ask("compare", { against: besides, picture: { of: side, ...view } }, `compare ${side}`), () => besides !== null, fail);
  mapRow.after(sides.el);
  const toggle = document.createElement("button");
  Object.assign(toggle, { type: "button", className: "small", textContent: "side by side", title: "Both maps with one cursor, or their difference" });
  toggle.addEventListener("click", () => showSides(sides.el.hidden));
  title.after(toggle);
  mapWidget.render({ model, el: mapEl });
  colourbarWidget.render({ model, el: barEl });
  mapEl.querySelector("canvas")?.setAttribute("aria-label", "Difference map. Wheel or plus and minus zoom, drag or arrows pan.");
  const line = (/** @type {string} */ colour, /** @type {number[] | undefined} */ dash = undefined) =>
    ({ stroke: () => ink(colour), width: 1.5, ...(dash ? { dash } : {}) });
  const pair = makePlot(both, { title: "Both curves over position", series: [line("--open", [6, 4]), line("--open", [6, 4]), line("--line"), line("--line")] });
  const one = makePlot(left, { title: "Difference over position", series: [line("--ink"), line("--ink")] });
  let chosen = ""; // direction that is shown, where there are several
  const heads = [both, left].map((plot) => {
    const head = document.createElement("div");
    head.className = "readout";
    plot.append(head);
    return head;
  });

  async function ask() {
    if (!against) return;
    const mine = against;
    const view = model.get("view");
    try {
      const { header, arrays } = await wire.ask("compare", {
        against, picture: { window: model.get("extent") ? view?.window ?? null : null, pixels: view?.pixels ?? [512, 512], range: model.get("limits") ?? null },
      }, "compare picture");
      if (mine !== against) return;
      model.put({
        shape: arrays.index.shape, window: header.window, unit: header.unit, range: header.range,
        ...(model.get("limits") ? {} : { auto_range: header.range }), index: arrays.index,
      });
      if (String(model.get("extent")) !== String(header.extent)) model.put({ extent: header.extent });
      const mean = Math.abs(header.mean) > 1e-6 * header.pv ? `, mean ${si(header.mean)} subtracted` : ""; // below that it is rounding
      title.textContent = `difference map: P-V ${si(header.pv)}, RMS ${si(header.rms)}${mean}; ${(100 * header.share_valid).toFixed(1)}\u2009% measured in both`;
      el.dataset.drawn = "map";
    } catch (error) {
      if (!(error instanceof Superseded)) fail(error);
    }
  }

  function showSides(/** @type {boolean} */ on) {
    toggle.setAttribute("aria-pressed", String(on));
    sides.el.hidden = !on;
    mapRow.hidden = on || !against;
    if (on) sides.show();
  }

  return {
    /** @param {Dict | null} header @param {Dict} arrays @param {Dict | null} other */
    put(header, arrays, other) {
      against = header?.shown === "map" ? other : null;
      el.dataset.drawn = "";
      el.hidden = !header?.shown && !header?.refused;
      mapRow.hidden = header?.shown !== "map";
      both.hidden = left.hidden = header?.shown !== "curves";
      title.className = header?.refused ? "difference-title refused" : "difference-title";
      title.textContent = header?.refused ?? "";
      model.put({ index: null, shape: null, extent: null, limits: null, auto_range: null });
      besides = header?.maps ? other : null;
      toggle.hidden = !besides;
      sides.name(header?.names ?? ["", ""]);
      showSides(Boolean(besides) && (!against || !sides.el.hidden));
      if (against) {
        title.textContent = "difference map…";
        ask();
      }
      if (header?.shown !== "curves") return;
      const tails = Object.keys(arrays).filter((key) => key.startsWith("a_x")).map((key) => key.slice(3));
      const tail = tails.includes(chosen) ? chosen : tails[0];
      if (tails.length > 1) {
        const ways = document.createElement("select");
        ways.setAttribute("aria-label", "Direction of travel");
        for (const one of tails) ways.add(new Option(one.trim(), one, false, one === tail));
        ways.addEventListener("change", () => {
          chosen = ways.value;
          this.put(header, arrays, other);
          title.querySelector("select")?.focus();
        });
        title.append(title.textContent ? " " : "", ways);
      }
      const of = (/** @type {string} */ name) => ({ x: arrays[`${name}_x${tail}`], low: arrays[`${name}_low${tail}`], high: arrays[`${name}_high${tail}`] });
      pair.put(joined([of("a"), of("b")]));
      heads[0].textContent = `${tail ? `${tail.trim()}: ` : ""}dashed ${header.names[0]}, full ${header.names[1]}`;
      const has = `difference_x${tail}` in arrays;
      left.hidden = !has;
      if (has) one.put(joined([of("difference")]));
      heads[1].textContent = `${header.names[1]} minus ${header.names[0]}`;
      el.dataset.drawn = "curves";
    },
  };
}
