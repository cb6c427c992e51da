// @ts-check
// Repeated runs over one another, the separated error with its band, and what is left of each feedrate.
//
// Traits: runs [{x, low, high, feed, direction, run}], separated [{x, low, high, band_low, band_high,
// direction}], means [{feed, direction, before: {x, low, high}, after: {...}}], feeds [words], shown
// ("repeats" | "separated" | "change"), direction, range [start, stop], travel [low, high], extent, stale,
// message; window [x0, x1] or null and wanted [start, stop] (written here, the latter on release).

import { si, spanned } from "./format.js";
import { frame, ink, makePlot, uprightHandle, windowed } from "./plots.js";

/** @typedef {import("./wire.js").Model} Model */
/** @typedef {{ x: ArrayLike<number>, low: ArrayLike<number>, high: ArrayLike<number> }} Curve */
/** @typedef {{ colour: string, dash?: number[], width?: number, alpha?: number }} Pen */

const DASHES = [[], [7, 4], [2, 3], [10, 3, 2, 3], [14, 4], [5, 2, 1, 2]];
const COLOURS = 6;

/**
 * Return how the line of a feedrate is drawn: colour and dash differ, for those who see no colours.
 * @param {number} feed its place in the list, slowest first
 * @returns {{ colour: string, dash: number[] }}
 */
export function penOf(feed) {
  return { colour: ink(`--feed-${feed % COLOURS}`), dash: DASHES[(feed + Math.floor(feed / COLOURS)) % DASHES.length] };
}

/**
 * Draw within the frame of a plot.
 * @param {any} u
 * @param {(ctx: CanvasRenderingContext2D, ratio: number) => void} act
 */
export function inside(u, act) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  act(ctx, devicePixelRatio || 1);
  ctx.restore();
}

/**
 * Draw a curve of extremes; where nothing was measured the line is broken.
 * @param {any} u
 * @param {Curve} curve
 * @param {Pen} pen
 */
export function strokeCurve(u, curve, pen) {
  inside(u, (ctx, ratio) => {
    const { x, low, high } = curve;
    let wide = 0;
    for (let i = 0; i < x.length; i += 1) {
      if (high[i] > low[i]) wide += Number(u.valToPos(low[i], "y", true) - u.valToPos(high[i], "y", true) > 3 * ratio);
    }
    ctx.strokeStyle = pen.colour;
    ctx.globalAlpha = pen.alpha ?? 1;
    ctx.lineWidth = (pen.width ?? 1.25) * ratio;
    ctx.lineJoin = "round";
    if (wide < 0.1 * x.length) ctx.setLineDash((pen.dash ?? []).map((v) => v * ratio));
    ctx.beginPath();
    let begun = false;
    for (let i = 0; i < x.length; i += 1) {
      if (!Number.isFinite(low[i])) {
        begun = false;
        continue;
      }
      const at = u.valToPos(x[i], "x", true);
      const a = u.valToPos(low[i], "y", true);
      if (begun) ctx.lineTo(at, a);
      else ctx.moveTo(at, a);
      if (high[i] > low[i]) ctx.lineTo(at, u.valToPos(high[i], "y", true));
      begun = true;
    }
    ctx.stroke();
  });
}

/**
 * Fill the band between two curves; gaps stay open.
 * @param {any} u
 * @param {ArrayLike<number>} x
 * @param {ArrayLike<number>} low
 * @param {ArrayLike<number>} high
 * @param {string} colour
 */
export function fillBand(u, x, low, high, colour) {
  inside(u, (ctx) => {
    ctx.fillStyle = colour;
    const bottom = u.bbox.top + u.bbox.height;
    const place = (/** @type {number} */ v) => {
      const y = u.valToPos(v, "y", true);
      return Number.isFinite(y) ? y : bottom; // zero on a logarithmic axis
    };
    for (let i = 0; i < x.length; i += 1) {
      const first = i;
      while (i < x.length && Number.isFinite(low[i]) && Number.isFinite(high[i])) i += 1;
      if (i - first < 2) continue;
      ctx.beginPath();
      for (let k = first; k < i; k += 1) ctx.lineTo(u.valToPos(x[k], "x", true), place(high[k]));
      for (let k = i - 1; k >= first; k -= 1) ctx.lineTo(u.valToPos(x[k], "x", true), place(low[k]));
      ctx.fill();
    }
  });
}

/**
 * Return the index of the value nearest to one.
 * @param {ArrayLike<number>} x
 * @param {number} at
 * @param {boolean} [log]
 */
export function nearest(x, at, log = false) {
  let best = -1;
  let away = Infinity;
  for (let i = 0; i < x.length; i += 1) {
    const d = log ? Math.abs(Math.log(x[i] / at)) : Math.abs(x[i] - at);
    if (d < away) [best, away] = [i, d];
  }
  return best;
}

/** What a direction is called. @param {number} direction */
export function wayOf(direction) {
  return direction > 0 ? "forward" : direction < 0 ? "reverse" : "";
}

/** @param {Curve[]} curves @param {[string, string]} [names] @returns {[number, number]} */
function extremes(curves, [low, high] = ["low", "high"]) {
  let [least, most] = [Infinity, -Infinity];
  for (const curve of /** @type {any[]} */ (curves)) {
    for (const v of curve[low]) if (v < least) least = v;
    for (const v of curve[high]) if (v > most) most = v;
  }
  return [least, most];
}

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const [read, words, busy] = frame(el, ["readout", "plot-empty", "plot-busy"]);
  let pointed = "";
  /** @type {number[] | null} */
  let moving = null;
  let taken = "";

  const range = () => moving ?? model.get("range") ?? [0, 1];
  const shown = () => model.get("shown") ?? "repeats";
  const mine = (/** @type {{ direction: number }} */ one) => one.direction === 0 || one.direction === model.get("direction");

  const plot = makePlot(el, {
    title: "Error over position: runs, separated error, before and after",
    series: [{ stroke: "rgba(0,0,0,0)" }, { stroke: "rgba(0,0,0,0)" }],
    ...windowed(model),
    behind(u) {
      if (u.data[0].length < 2) return;
      const [from, to] = range().map((/** @type {number} */ v) => u.valToPos(v, "x", true));
      inside(u, (ctx) => {
        ctx.fillStyle = ink("--band");
        ctx.fillRect(from, u.bbox.top, to - from, u.bbox.height);
      });
    },
    placed(u) {
      if (u.data[0].length >= 2) lines(u);
      follow();
    },
    pointed(u) {
      pointed = u.cursor.left < 0 || !u.data[0].length ? "" : spoken(u.posToVal(u.cursor.left, "x"));
      tell();
    },
  });

  function lines(/** @type {any} */ u) {
    if (shown() === "repeats") {
      for (const run of model.get("runs") ?? []) {
        const dash = run.direction < 0 ? [2, 3] : [];
        strokeCurve(u, run, { colour: penOf(run.feed).colour, dash, width: 1, alpha: 0.6 });
      }
    } else if (shown() === "separated") {
      for (const one of model.get("separated") ?? []) {
        fillBand(u, one.x, one.band_low, one.band_high, ink("--fill"));
        strokeCurve(u, one, { ...penOf(one.direction < 0 ? 1 : 0), width: 1.75 });
      }
    } else {
      for (const one of (model.get("means") ?? []).filter(mine)) {
        const { colour, dash } = penOf(one.feed);
        strokeCurve(u, one.before, { colour, dash, width: 1, alpha: 0.4 });
        strokeCurve(u, one.after, { colour, dash, width: 1.75 });
      }
    }
  }

  function spoken(/** @type {number} */ at) {
    const value = (/** @type {Curve} */ one, low = "low", high = "high") => {
      const i = nearest(one.x, at);
      const [a, b] = /** @type {any} */ ([one, one]).map((/** @type {any} */ c, /** @type {number} */ k) => c[k ? high : low][i]);
      return spanned(a, b);
    };
    const x = `x ${si(at)}`;
    if (shown() === "repeats") {
      const all = (model.get("runs") ?? []).map((/** @type {any} */ run) => `${run.run} ${value(run)}`);
      return `${x}: ${all.slice(0, 12).join(", ")}${all.length > 12 ? " …" : ""}`;
    }
    if (shown() === "separated") {
      return `${x}: ${(model.get("separated") ?? []).map((/** @type {any} */ one) =>
        `${wayOf(one.direction)} ${value(one)}, ±2 u ${value(one, "band_low", "band_high")}`).join("; ")}`;
    }
    return `${x}: ${(model.get("means") ?? []).filter(mine).map((/** @type {any} */ one) =>
      `${model.get("feeds")[one.feed]} ${value(one.before)} before, ${value(one.after)} after`).join("; ")}`;
  }

  const grips = [0, 1].map((k) => uprightHandle(plot.u, {
    label: k === 0 ? "Start of the evaluation range" : "End of the evaluation range",
    text: k === 0 ? "[" : "]",
    value: () => range()[k],
    put(value) {
      const [low, high] = model.get("travel") ?? [-Infinity, Infinity];
      const now = [...range()];
      const least = 0.02 * (high - low);
      now[k] = k === 0 ? Math.max(low, Math.min(value, now[1] - least)) : Math.min(high, Math.max(value, now[0] + least));
      moving = now;
      plot.redraw();
      tell();
    },
    held(is) {
      if (is) {
        taken ||= String(range());
        return;
      }
      const [was, now] = [taken, moving];
      taken = "";
      if (!now || String(now) === was) return;
      model.set("wanted", now);
      model.save_changes();
    },
  }));
  grips.forEach((grip, k) => { grip.el.dataset.handle = k === 0 ? "start" : "stop"; });

  function follow() {
    const now = range();
    grips.forEach((grip, k) => grip.follow(si(now[k])));
  }

  function tell() {
    if (moving) {
      read.textContent = `evaluation range ${si(moving[0])} to ${si(moving[1])}, ${si(moving[1] - moving[0])} long`;
      return;
    }
    const now = model.get("range");
    read.textContent = pointed || (now ? `range ${si(now[0])} to ${si(now[1])}${model.get("window") ? " (double click: all)" : ""}` : "");
  }

  function update() {
    const curves = shown() === "repeats" ? model.get("runs") ?? []
      : shown() === "separated" ? model.get("separated") ?? []
        : (model.get("means") ?? []).filter(mine).flatMap((/** @type {any} */ one) => [one.before, one.after]);
    const names = /** @type {[string, string]} */ (shown() === "separated" ? ["band_low", "band_high"] : ["low", "high"]);
    const stale = Boolean(model.get("stale")) && shown() !== "repeats";
    words.textContent = model.get("message") || (curves.length ? "" : shown() === "repeats" ? "" : "computing…");
    el.classList.toggle("stale", stale);
    busy.textContent = stale && curves.length ? model.get("stale") : "";
    let [low, high] = extremes(curves, names);
    if (shown() === "separated") {
      const bare = extremes(curves); // the band is not known everywhere
      [low, high] = [Math.min(low, bare[0]), Math.max(high, bare[1])];
    }
    const [x0, x1] = model.get("window") ?? model.get("extent") ?? [0, 1];
    plot.put(high >= low ? [[x0, x1], [low, low], [high, high]] : [[], [], []]);
    tell();
  }

  model.on("change:range", () => {
    moving = null;
  });
  model.on("change", update);
  model.on("change:shown change:direction", update);
  update();
  return () => plot.destroy();
}

export default { render };
