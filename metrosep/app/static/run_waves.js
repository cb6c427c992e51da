// @ts-check
// Amplitude against wavelength, one line for each feedrate: geometry stays, a vibration slides. And
// what each wavelength is judged by, with the threshold as a handle.
//
// Traits: wavelength, lines [{amplitude, words}], estimate {wavelength, amplitude, selected, sd, low, high,
// reason, reasons} or null, vibrations [{frequency, source, at: [{feed, wavelength, amplitude}]}],
// statistics [{name, key, value, unit, keeps, values}], statistic (index shown), shortest, movable, stale,
// message; wanted {key, value} (written here on release).

import { si } from "./format.js";
import { frame, ink, makePlot, uprightHandle } from "./plots.js";
import { makeHandle } from "./handles.js";
import { fillBand, inside, nearest, penOf, strokeCurve } from "./run_curves.js";

/** @typedef {import("./wire.js").Model} Model */

const TEXTS = ["readout", "plot-empty", "plot-busy"];

/** @param {any} u @param {number} x @param {number} y @param {number} size @param {string} colour @param {boolean} full */
function dot(u, x, y, size, colour, full) {
  inside(u, (ctx, ratio) => {
    ctx.beginPath();
    ctx.arc(u.valToPos(x, "x", true), u.valToPos(y, "y", true), size * ratio, 0, 7);
    ctx.lineWidth = ratio;
    ctx.strokeStyle = colour;
    ctx.fillStyle = colour;
    if (full) ctx.fill();
    else ctx.stroke();
  });
}

/** Return the least and greatest number above zero. @param {ArrayLike<number>[]} lists @returns {[number, number]} */
function positive(lists) {
  let [low, high] = [Infinity, -Infinity];
  for (const list of lists) {
    for (let i = 0; i < list.length; i += 1) {
      const v = list[i];
      if (!(v > 0)) continue;
      if (v < low) low = v;
      if (v > high) high = v;
    }
  }
  return [low, high];
}

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const [read, words, busy] = frame(el, TEXTS);
  let pointed = "";
  /** @type {number | null} */
  let moving = null;
  let taken = 0;
  const shortest = () => moving ?? model.get("shortest");

  const plot = makePlot(el, {
    title: "Amplitude against wavelength, one line for each feedrate",
    log: true,
    series: [{ stroke: "rgba(0,0,0,0)" }, { stroke: "rgba(0,0,0,0)" }],
    behind(u) {
      const at = shortest();
      if (!at || u.data[0].length < 2) return;
      inside(u, (ctx) => {
        ctx.fillStyle = ink("--band");
        const from = Math.max(u.bbox.left, u.valToPos(at, "x", true));
        ctx.fillRect(from, u.bbox.top, u.bbox.left + u.bbox.width - from, u.bbox.height);
      });
    },
    placed(u) {
      if (u.data[0].length >= 2) lines(u);
      const at = shortest();
      grip.follow(at ? si(at) : "");
      if (!at || !model.get("movable")) grip.show(false);
      cursor.follow(spoken(looked));
    },
    pointed(u) {
      pointed = u.cursor.left < 0 || u.data[0].length < 2 ? "" : spoken(u.posToVal(u.cursor.left, "x"));
      tell();
    },
  });

  function lines(/** @type {any} */ u) {
    const x = model.get("wavelength") ?? [];
    const found = model.get("estimate");
    if (found?.low) {
      const known = found.high.map((/** @type {number} */ v, /** @type {number} */ i) => (found.amplitude[i] > 0 ? v : NaN));
      fillBand(u, found.wavelength, found.low, known, ink("--band"));
    }
    for (const one of model.get("vibrations") ?? []) slide(u, one);
    (model.get("lines") ?? []).forEach((/** @type {any} */ line, /** @type {number} */ i) => {
      strokeCurve(u, { x, low: line.amplitude, high: line.amplitude }, { ...penOf(line.feed ?? i), width: 1.5 });
    });
    if (found) {
      for (let i = 0; i < found.wavelength.length; i += 1) {
        if (!(found.amplitude[i] > 0)) continue;
        const full = Boolean(found.selected?.[i]);
        dot(u, found.wavelength[i], found.amplitude[i], full ? 3.4 : 2.2, ink(full ? "--ink" : "--faint"), full);
      }
    }
  }

  function slide(/** @type {any} */ u, /** @type {any} */ vibration) {
    const places = vibration.at.map((/** @type {any} */ p, /** @type {number} */ i) => ({ ...p, i }))
      .filter((/** @type {any} */ p) => p.amplitude > 0)
      .map((/** @type {any} */ p) => ({ i: p.i, x: u.valToPos(p.wavelength, "x", true), y: u.valToPos(p.amplitude, "y", true) }));
    if (!places.length) return;
    inside(u, (ctx, ratio) => {
      ctx.strokeStyle = ink("--bad");
      ctx.lineWidth = 1.25 * ratio;
      ctx.setLineDash([3 * ratio, 3 * ratio]);
      ctx.beginPath();
      for (const { x, y } of places) ctx.lineTo(x, y);
      ctx.stroke();
      ctx.setLineDash([]);
      for (const { x, y, i } of places) {
        const r = 5 * ratio;
        ctx.beginPath();
        ctx.moveTo(x, y - r);
        for (const [dx, dy] of [[r, 0], [0, r], [-r, 0]]) ctx.lineTo(x + dx, y + dy);
        ctx.closePath();
        ctx.fillStyle = penOf(i).colour;
        ctx.fill();
        ctx.stroke();
      }
      ctx.fillStyle = ink("--bad");
      ctx.font = `600 ${12 * ratio}px system-ui, sans-serif`;
      ctx.textAlign = "center";
      const top = Math.min(...places.map((/** @type {any} */ p) => p.y));
      const middle = (places[0].x + places[places.length - 1].x) / 2;
      const height = Math.max(u.bbox.top + 12 * ratio, top - 10 * ratio);
      ctx.strokeStyle = ink("--panel");
      ctx.lineWidth = 4 * ratio;
      ctx.strokeText(si(vibration.frequency, "Hz", 3), middle, height);
      ctx.fillText(si(vibration.frequency, "Hz", 3), middle, height);
    });
  }

  function spoken(/** @type {number} */ at) {
    const x = model.get("wavelength") ?? [];
    const found = model.get("estimate");
    const parts = [];
    let shown = at;
    if (found?.wavelength.length) {
      const i = nearest(found.wavelength, at, true);
      shown = found.wavelength[i];
      const u = found.sd?.[i];
      parts.push(`amplitude ${si(found.amplitude[i])}${Number.isFinite(u) ? `, u ${si(u, "m", 2)}` : ""}`,
        `${found.selected?.[i] ? "repeats" : "not selected"} (${found.reasons[found.reason[i]]})`);
    }
    const k = nearest(x, shown, true);
    if (k >= 0) parts.push(...(model.get("lines") ?? []).map((/** @type {any} */ line) => `${line.words} ${si(line.amplitude[k], "m", 3)}`));
    return `λ ${si(shown)}: ${parts.join("; ")}`;
  }

  const grip = uprightHandle(plot.u, {
    label: "Shortest wavelength of the model",
    text: "λ",
    value: () => shortest(),
    put(value) {
      moving = value;
      plot.redraw();
      tell();
    },
    held(is) {
      if (is) {
        taken ||= shortest();
        return;
      }
      const was = taken;
      taken = 0;
      if (moving === null || moving === was) return;
      const pixel = Math.abs(plot.u.posToVal(plot.u.valToPos(moving, "x") + 1, "x") - moving);
      model.set("wanted", { key: "shortest", value: moving, resolution: pixel });
      model.save_changes();
    },
  });
  grip.el.dataset.handle = "shortest";

  // With the keyboard: from wavelength to wavelength; seen while it has the focus.
  let looked = NaN;
  const cursor = uprightHandle(plot.u, {
    label: "Read out a wavelength",
    value: () => looked,
    put(value) {
      const x = model.get("estimate")?.wavelength ?? model.get("wavelength") ?? [];
      const now = nearest(x, looked, true);
      let i = nearest(x, value, true);
      if (i === now) i += value < looked ? 1 : -1; // wavelengths fall
      looked = x[Math.max(0, Math.min(x.length - 1, i))];
      pointed = spoken(looked);
      plot.redraw();
      tell();
    },
  });
  cursor.el.classList.add("handle-look");
  cursor.el.addEventListener("blur", () => {
    pointed = "";
    tell();
  });

  function tell() {
    const at = shortest();
    read.textContent = moving !== null ? `shortest wavelength ${si(moving)}`
      : pointed || (at ? `shortest wavelength of the model ${si(at)}` : "");
    read.title = read.textContent ?? "";
  }

  function draw() {
    moving = taken ? moving : null;
    const x = model.get("wavelength") ?? [];
    const found = model.get("estimate");
    const lists = (model.get("lines") ?? []).map((/** @type {any} */ line) => line.amplitude);
    words.textContent = model.get("message") || (lists.length ? "" : model.get("stale") ?? "");
    el.classList.toggle("stale", Boolean(model.get("stale")) && Boolean(found));
    busy.textContent = found ? model.get("stale") ?? "" : "";
    const [x0, x1] = positive([x, found?.wavelength ?? []]);
    const [low, high] = positive([...lists, (found?.amplitude ?? []), (found?.high ?? [])]);
    const least = Math.max(low, high * 1e-5); // what lies further below is nothing
    if (!Number.isFinite(looked)) looked = x[0] ?? NaN;
    plot.put(x1 > 0 && high > 0 ? [[x0, x1], [least, least], [high, high]] : [[], [], []]);
    tell();
  }

  model.on("change", draw);
  draw();
  return () => plot.destroy();
}

/** @param {{ model: Model, el: HTMLElement }} given */
function evidence({ model, el }) {
  const [read, words, busy] = frame(el, TEXTS);
  let pointed = "";
  /** @type {number | null} */
  let moving = null;
  let taken = 0;
  const one = () => (model.get("statistics") ?? [])[model.get("statistic") ?? 0] ?? null;
  const unit = () => ({ m2: "m²", m3: "m³", 1: "" })[/** @type {"1"} */ (one()?.unit)] ?? one()?.unit ?? "m";
  const value = () => moving ?? model.get("threshold") ?? one()?.value;

  const plot = makePlot(el, {
    title: "What each wavelength is judged by, against its wavelength, with the threshold",
    log: true,
    series: [{ stroke: "rgba(0,0,0,0)" }, { stroke: "rgba(0,0,0,0)" }],
    yUnit: unit,
    behind(u) {
      const now = one();
      if (!now || u.data[0].length < 2) return;
      inside(u, (ctx) => {
        const y = u.valToPos(value(), "y", true);
        const { left, top, width, height } = u.bbox;
        ctx.fillStyle = ink("--band");
        if (now.keeps === "below") ctx.fillRect(left, y, width, top + height - y);
        else ctx.fillRect(left, top, width, y - top);
      });
    },
    placed(u) {
      const now = one();
      const shown = Boolean(now) && u.data[0].length >= 2;
      grip.show(shown);
      if (!shown) return;
      const found = model.get("estimate");
      const x = found.wavelength;
      const pen = { colour: ink("--line"), width: 1.25, alpha: model.get("in_use") === false ? 0.45 : 1 };
      if (!(now.least > 0)) strokeCurve(u, { x, low: now.values, high: now.values }, pen);
      for (let i = 0; i < x.length; i += 1) {
        if (now.values[i] > 0) dot(u, x[i], now.values[i], found.selected?.[i] ? 3.2 : 2, ink(found.selected?.[i] ? "--ink" : "--faint"), Boolean(found.selected?.[i]));
      }
      grip.place(0, Math.max(0, Math.min(u.over.clientHeight, u.valToPos(value(), "y"))));
      grip.describe(si(value(), unit(), 3));
    },
    pointed(u) {
      const now = one();
      const found = model.get("estimate");
      if (u.cursor.left < 0 || !now || !found) pointed = "";
      else {
        const i = nearest(found.wavelength, u.posToVal(u.cursor.left, "x"), true);
        pointed = `λ ${si(found.wavelength[i])}: ${now.values[i] <= now.least ? "≤ " : ""}${si(now.values[i], unit(), 3)}; ${found.reasons[found.reason[i]]}`;
      }
      tell();
    },
  });

  const within = (/** @type {number} */ y) => Math.max(0, Math.min(plot.u.over.clientHeight, y));
  const put = (/** @type {number} */ y) => {
    moving = Math.min(plot.u.posToVal(within(y), "y"), one()?.key === "false_discovery_rate" ? 0.99 : Infinity);
    plot.redraw();
    tell();
  };
  const grip = makeHandle(plot.u.over, {
    label: "Threshold",
    kind: "level",
    moved: (_, y) => put(y),
    stepped: (dx, dy) => put(plot.u.valToPos(value(), "y") + dy - dx),
    held(is) {
      if (is) {
        taken ||= value();
        return;
      }
      const was = taken;
      taken = 0;
      if (moving === null || moving === was) return;
      model.set("wanted", { key: one()?.key, value: moving });
      model.save_changes();
    },
  });
  grip.el.dataset.handle = "threshold";
  grip.el.addEventListener("mousedown", (event) => event.stopPropagation());

  function tell() {
    const now = one();
    const level = now ? `${now.key} ${si(value(), unit(), 3)}: passes ${now.keeps}` : "";
    read.textContent = moving !== null ? level : pointed || (now && model.get("in_use") === false ? `${level} (not in use)` : level);
    read.title = now?.name ?? "";
  }

  function draw() {
    moving = taken ? moving : null;
    const now = one();
    grip.el.setAttribute("aria-label", now ? `Threshold ${now.key}` : "Threshold");
    words.textContent = model.get("message") || (now ? "" : model.get("estimate") ? "this method has no threshold" : model.get("stale") || model.get("words") || "");
    el.classList.toggle("bare", !now); // axes without numbers would say 1 m to 10 m
    el.classList.toggle("stale", Boolean(model.get("stale")) && Boolean(now));
    busy.textContent = now ? model.get("stale") ?? "" : "";
    const x = model.get("estimate")?.wavelength ?? [];
    const [x0, x1] = positive([x]);
    const [low, high] = now ? positive([now.values, [value() / 5, value() * (now.unit === "1" ? 1 : 5)]]) : [1, 0];
    plot.put(now && x1 > 0 ? [[x0, x1], [low, low], [high, high]] : [[], [], []]);
    tell();
  }

  model.on("change", draw);
  draw();
  return () => plot.destroy();
}

/** The widget of the evidence, of the same model. */
export const thresholds = { render: evidence };

export default { render };
