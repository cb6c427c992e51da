// @ts-check
// Lines by uPlot with what a measurement needs: gaps stay gaps, axes in SI units, colours of the page,
// upright handles on the x axis.

import { baseOf, inInches, logTick, places, scaleFor, ticks } from "./format.js";
import { makeHandle, wheelFactor } from "./handles.js";
import Lines from "./vendor/uPlot.esm.js";

/** @type {any} */
const uPlot = Lines;

/** Least value that a logarithmic axis begins at, of the largest: what lies below is rounding. */
const LEAST = 1e-7;

/** @typedef {import("./handles.js").Grip} Grip */

/** @type {HTMLElement[]} elements that have the colours, in a notebook where the page has none */
let palettes = [];
/** @type {Set<() => void>} */
const drawn = new Set();

/**
 * Return a colour of the page, or of the widget in a notebook.
 * @param {string} name of a custom property
 */
export function ink(name) {
  const from = palettes.find((el) => el.isConnected) ?? document.documentElement;
  return getComputedStyle(from).getPropertyValue(name).trim() || "#888";
}

/**
 * Take colours from an element as long as it is on the page, and draw all plots in them.
 * @param {HTMLElement} el
 */
export function inkFrom(el) {
  palettes = [el, ...palettes.filter((one) => one !== el && one.isConnected)];
  drawn.forEach((recolour) => recolour());
}

/**
 * Return plain values with null where nothing was measured: uPlot draws straight through NaN.
 * @param {ArrayLike<number> | null | undefined} values
 * @param {boolean} [positive] also drop what a logarithm cannot show
 * @param {boolean} [reversed]
 * @returns {(number | null)[]}
 */
export function gapped(values, positive = false, reversed = false) {
  if (!values) return [];
  const n = values.length;
  const out = new Array(n);
  for (let i = 0; i < n; i += 1) {
    const v = values[reversed ? n - 1 - i : i];
    out[i] = Number.isNaN(v) || (positive && !(v > 0)) ? null : v;
  }
  return out;
}

/**
 * Return width and height within the axes, CSS pixels, as uPlot has them: a notebook takes a plot off
 * the page for a moment, and one that is not on the page measures nothing.
 * @param {any} u
 * @returns {[number, number]}
 */
function plotSize(u) {
  return [parseFloat(u.over.style.width) || 0, parseFloat(u.over.style.height) || 0];
}

/**
 * Clear an element for a plot and give it its texts, empty, one over another.
 * @param {HTMLElement} el
 * @param {string[]} [names] their classes
 * @returns {HTMLElement[]}
 */
export function frame(el, names = ["readout", "plot-empty"]) {
  el.classList.add("plot");
  const made = names.map((name) => {
    const one = document.createElement("div");
    one.className = name;
    return one;
  });
  el.replaceChildren(...made);
  return made;
}

/**
 * Return curves with x of their own as one set of columns: a curve goes on where another has a point, and
 * its gaps stay gaps.
 * @param {any[][]} tables
 * @returns {any[][]}
 */
export const joined = (tables) => uPlot.join(tables);

/**
 * Return which of rising values is nearest; -1 beyond the ends by more than a step.
 * @param {number[]} x
 * @param {number} at
 */
export function nearest(x, at) {
  const n = x.length;
  if (!n || !Number.isFinite(at)) return -1;
  let [low, high] = [0, n - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (x[middle] < at) low = middle;
    else high = middle;
  }
  const step = n > 1 ? (x[n - 1] - x[0]) / (n - 1) : 0;
  if (at < x[0] - step || at > x[n - 1] + step) return -1;
  return at - x[low] < x[high] - at ? low : high;
}

const WIDENED = 150; // ms after a plot last changed its width

/** Act where plots have another width: their pixel columns are others. @param {HTMLElement[]} plots @param {() => void} act */
export function whenWidened(plots, act) {
  let [widths, later] = ["", 0];
  const sizes = new ResizeObserver(() => {
    const now = plots.map((plot) => plot.clientWidth).join(" ");
    if (now !== widths) clearTimeout(later), (later = window.setTimeout(act, WIDENED));
    widths = now;
  });
  plots.forEach((plot) => sizes.observe(plot));
}

/**
 * Return the options of a plot whose part that is shown is the trait `window`: [x0, x1] or null.
 * @param {import("./wire.js").Model} model
 */
export function windowed(model) {
  const put = (/** @type {number[] | null} */ window) => {
    model.set("window", window);
    model.save_changes();
  };
  return { wheel: true, zoomed: (/** @type {number} */ low, /** @type {number} */ high) => put([low, high]), whole: () => put(null) };
}

/**
 * Return which sample is pointed at, -1 where there is none.
 * @param {any} u
 * @returns {number}
 */
export function pointedAt(u) {
  return u.cursor.left < 0 || !u.data[0].length ? -1 : u.cursor.idx ?? -1;
}

/**
 * @typedef {object} Plot
 * @property {any} u the uPlot
 * @property {(data: any[][]) => void} put
 * @property {() => void} redraw
 * @property {() => void} destroy
 */

/**
 * Return a plot that fills its element.
 * @param {HTMLElement} el
 * @param {object} options
 * @param {any[]} options.series as uPlot has them, without the first
 * @param {any[]} [options.bands]
 * @param {boolean} [options.log] both axes logarithmic
 * @param {() => string} [options.xUnit]
 * @param {() => string} [options.yUnit]
 * @param {string} [options.yName] in the corner above the y axis
 * @param {string} options.title for screen readers
 * @param {(u: any) => void} [options.behind] draws under the lines
 * @param {(u: any) => void} [options.placed] after each drawing: places handles
 * @param {(u: any) => void} [options.pointed] the pointer moved; `pointedAt`
 * @param {(low: number, high: number) => void} [options.zoomed] a part was marked
 * @param {boolean} [options.wheel] the wheel zooms too, about the pointer
 * @param {() => void} [options.whole] double click
 * @returns {Plot}
 */
export function makePlot(el, options) {
  const { series, bands = [], log = false, title } = options;
  const xUnit = options.xUnit ?? (() => "m");
  const yUnit = options.yUnit ?? (() => "m");
  const corner = document.createElement("div");
  corner.className = "plot-unit";
  corner.textContent = options.yName ?? "";
  const foot = document.createElement("div");
  foot.className = "plot-unit plot-unit-x";
  const holder = document.createElement("div");
  holder.className = "plot-holder";
  holder.setAttribute("role", "group"); // its handles are controls; the picture is the canvas
  holder.setAttribute("aria-label", title);
  el.append(holder, corner, foot);

  const font = "12px system-ui, sans-serif";
  const axis = (/** @type {any} */ more) => ({
    stroke: () => ink("--soft"), font, grid: { stroke: () => ink("--grid"), width: 1 },
    ticks: { stroke: () => ink("--grid"), width: 1, size: 5 }, ...more,
  });
  const round = (/** @type {() => string} */ unit) => (inInches()
    ? { splits: (/** @type {any} */ _, /** @type {number} */ __, /** @type {number} */ min, /** @type {number} */ max, /** @type {number} */ gap) => places(min, max, gap, unit()) } : {});
  const linear = (/** @type {HTMLElement} */ label, /** @type {string} */ key, /** @type {() => string} */ unit) =>
    (/** @type {any} */ u, /** @type {number[]} */ splits) => {
      const { min, max } = u.scales[key];
      const [factor, name] = scaleFor(Math.max(Math.abs(min ?? 0), Math.abs(max ?? 0)), unit());
      label.textContent = key === "y" && options.yName ? options.yName : name;
      return ticks(splits, factor);
    };
  const logarithmic = (/** @type {() => string} */ unit) =>
    (/** @type {any} */ _, /** @type {(number | null)[]} */ splits) => splits.map((v) => logTick(v, unit()));
  // Ticks 1 to 9 of each decade, of many decades 1 alone; those with labels stand as close as `room`
  // pixels for a decade allow, and never closer than `least`.
  const decimal = (/** @type {number} */ room, /** @type {number} */ least, /** @type {() => string} */ unit) => ({
    splits(/** @type {any} */ _, /** @type {number} */ __, /** @type {number} */ min, /** @type {number} */ max) {
      const out = [];
      const last = max / min > 1e7 ? 1 : 9;
      const base = baseOf(unit());
      for (let k = Math.floor(Math.log10(min / base)); base * 10 ** k <= max; k += 1) {
        for (let d = 1; d <= last; d += 1) {
          const v = Number(`${d}e${k}`) * base;
          if (v >= min * (1 - 1e-9) && v <= max * (1 + 1e-9)) out.push(v);
        }
      }
      return out;
    },
    filter(/** @type {any} */ self, /** @type {number[]} */ splits, /** @type {number} */ index) {
      const { min, max } = self.scales[index === 0 ? "x" : "y"];
      const side = plotSize(self)[index === 0 ? 0 : 1];
      const each = side / Math.max(0.3, Math.log10(max / min));
      const digits = each > room ? [1, 2, 5] : [1];
      const step = Math.max(1, Math.ceil(least / each));
      const labelled = (/** @type {number} */ v) => {
        const [digit, power] = Number((v / baseOf(unit())).toPrecision(9)).toExponential().split("e").map(Number);
        return digits.includes(digit) && power % step === 0;
      };
      return splits.map((v) => (labelled(v) ? v : null));
    },
  });
  const decades = (/** @type {any} */ u, /** @type {number} */ min, /** @type {number} */ max) => {
    if (!(min > 0) || !(max > 0)) return [1, 10];
    return min === max ? [min / 3, max * 3] : [min, max];
  };

  const u = new uPlot({
    width: 300, height: 150, legend: { show: false }, padding: [24, 24, 0, 0],
    cursor: {
      drag: { x: Boolean(options.zoomed), y: false, setScale: false, dist: 6 },
      points: { show: false }, bind: { dblclick: () => () => (options.whole?.(), null) },
    },
    scales: log
      ? { x: { time: false, distr: 3, range: decades }, y: { distr: 3, range: (/** @type {any} */ _u, /** @type {number} */ a, /** @type {number} */ b) => decades(_u, Math.max(a / 1.5, b * LEAST), b * 1.5) } }
      : { x: { time: false, range: (/** @type {any} */ _u, /** @type {number} */ a, /** @type {number} */ b) => (a === b ? [a - 1, b + 1] : [a, b]) } },
    axes: log
      ? [axis({ values: logarithmic(xUnit), size: 34, ...decimal(inInches() ? 230 : 180, 56, xUnit) }), axis({ values: logarithmic(yUnit), size: 62, ...decimal(60, 16, yUnit) })]
      : [axis({ values: linear(foot, "x", xUnit), size: 34, space: 60, ...round(xUnit) }), axis({ values: linear(corner, "y", yUnit), size: 56, space: 30, ...round(yUnit) })],
    series: [{}, ...series.map((one) => ({ points: { show: false }, spanGaps: false, ...one }))],
    bands,
    hooks: {
      drawClear: [(/** @type {any} */ self) => options.behind?.(self)],
      draw: [(/** @type {any} */ self) => options.placed?.(self)],
      setCursor: [(/** @type {any} */ self) => options.pointed?.(self)],
      setSelect: [(/** @type {any} */ self) => {
        const { left, width } = self.select;
        if (width < 4 || !options.zoomed) return;
        const ends = [self.posToVal(left, "x"), self.posToVal(left + width, "x")];
        self.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        options.zoomed(ends[0], ends[1]);
      }],
    },
  }, [[], ...series.map(() => [])], holder);
  u.ctx.canvas.setAttribute("role", "img");
  u.ctx.canvas.setAttribute("aria-label", title);

  if (options.wheel) {
    u.over.addEventListener("wheel", (/** @type {WheelEvent} */ event) => {
      const { min, max } = u.scales.x;
      if (!(max > min)) return;
      event.preventDefault();
      const at = u.posToVal(event.offsetX, "x");
      const factor = wheelFactor(event);
      options.zoomed?.(at - (at - min) * factor, at + (max - at) * factor);
    }, { passive: false });
  }
  const watcher = new ResizeObserver(() => {
    const box = holder.getBoundingClientRect();
    if (box.width > 40 && box.height > 40) u.setSize({ width: Math.floor(box.width), height: Math.floor(box.height) });
  });
  watcher.observe(holder);
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  const recolour = () => u.redraw(false, true);
  scheme.addEventListener("change", recolour);
  drawn.add(recolour);
  return {
    u,
    put: (data) => u.setData(data),
    redraw: () => u.redraw(false, false),
    destroy() {
      watcher.disconnect();
      scheme.removeEventListener("change", recolour);
      drawn.delete(recolour);
      u.destroy();
    },
  };
}

/**
 * Return an upright handle on a plot.
 * @param {any} u
 * @param {object} options
 * @param {string} options.label
 * @param {string} [options.text]
 * @param {() => number} options.value where it stands
 * @param {(value: number) => void} options.put
 * @param {(held: boolean) => void} [options.held]
 * @returns {Grip & { follow: (words: string) => void }}
 */
export function uprightHandle(u, { label, text, value, put, held }) {
  const within = (/** @type {number} */ x) => Math.max(0, Math.min(plotSize(u)[0], x));
  const grip = makeHandle(u.over, {
    label, text, kind: "upright", held,
    moved: (x) => put(u.posToVal(within(x), "x")),
    stepped: (dx, dy) => put(u.posToVal(within(u.valToPos(value(), "x") + dx - dy), "x")),
    ended: (end) => put(end === "Home" ? u.scales.x.min : u.scales.x.max),
  });
  grip.el.addEventListener("mousedown", (event) => event.stopPropagation());
  return {
    ...grip,
    follow(words) {
      const x = u.valToPos(value(), "x");
      const shown = Number.isFinite(x) && u.data[0].length > 0;
      grip.show(shown);
      if (!shown) return;
      grip.place(within(x), 0);
      grip.describe(words);
    },
  };
}
