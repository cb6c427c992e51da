// @ts-check
// Amplitude against wavelength with two limits that are dragged; what lies between them is filled.
//
// Traits: wavelength (falling), amplitude, low, high (repeatability band or null), inside, outside
// (RMS), unit (of wavelengths; "px" without lateral calibration), message, notes, is_preview;
// band [shortest, longest] and moving (written here).

import { si } from "./format.js";
import { frame, gapped, ink, makePlot, pointedAt, uprightHandle } from "./plots.js";
import { typed } from "./wire.js";

/** @typedef {import("./wire.js").Model} Model */

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const [read, words] = frame(el);
  let pointed = "";
  /** @type {number[]} */
  let x = [];

  const unit = () => model.get("unit") ?? "m";
  const band = () => {
    const given = model.get("band");
    if (given) return given;
    if (x.length < 2) return [1, 2];
    const [short, long] = [Math.log(x[0]), Math.log(x[x.length - 1])];
    return [Math.exp(short + (long - short) / 3), Math.exp(short + (2 * (long - short)) / 3)];
  };

  const plot = makePlot(el, {
    title: "Amplitude against wavelength",
    log: true,
    xUnit: unit,
    series: [
      { stroke: () => ink("--line"), width: 1.25 },
      { stroke: () => ink("--line"), width: 2, fill: () => ink("--fill"), fillTo: (/** @type {any} */ u) => u.scales.y.min },
      { stroke: () => ink("--faint"), width: 1 },
      { stroke: () => ink("--faint"), width: 1 },
    ],
    bands: [{ series: [4, 3], fill: () => ink("--band") }],
    behind(u) {
      if (x.length < 2) return;
      const [left, right] = band().map((/** @type {number} */ v) => u.valToPos(v, "x", true));
      const box = u.bbox;
      const [from, to] = [Math.max(box.left, left), Math.min(box.left + box.width, right)];
      if (!(to > from)) return;
      u.ctx.save();
      u.ctx.fillStyle = ink("--band");
      u.ctx.fillRect(from, box.top, to - from, box.height);
      u.ctx.restore();
    },
    placed: follow,
    pointed(u) {
      const i = pointedAt(u);
      pointed = i < 0 ? "" : `λ ${si(u.data[0][i], unit())}: amplitude ${si(u.data[1][i])}`;
      tell();
    },
  });

  const grips = [0, 1].map((k) => uprightHandle(plot.u, {
    label: k === 0 ? "Shortest wavelength of the band" : "Longest wavelength of the band",
    value: () => band()[k],
    put(value) {
      const now = [...band()];
      now[k] = k === 0 ? Math.min(value, now[1] * 0.999) : Math.max(value, now[0] * 1.001);
      model.set("band", now);
      model.save_changes();
      draw();
    },
    held(is) {
      model.set("moving", is);
      model.save_changes();
    },
  }));

  function follow() {
    const now = band();
    grips.forEach((grip, k) => grip.follow(si(now[k], unit())));
  }

  function tell() {
    if (!x.length) {
      read.textContent = "";
      return;
    }
    const sign = model.get("is_preview") ? "≈ " : "";
    const now = band();
    read.textContent = pointed || [
      `${si(now[0], unit())} to ${si(now[1], unit())}`,
      `RMS inside ${sign}${si(model.get("inside"))}`,
      `outside ${sign}${si(model.get("outside"))}`,
    ].join("   ");
    read.classList.toggle("preview", Boolean(model.get("is_preview")));
    el.title = (model.get("notes") ?? []).join("\n");
  }

  function draw() {
    words.textContent = model.get("message") ?? "";
    const wavelength = typed(model.get("wavelength"), Float64Array);
    if (!wavelength?.length) {
      x = [];
      plot.put([[], [], [], [], []]);
      tell();
      return;
    }
    x = /** @type {number[]} */ (gapped(wavelength, true, true));
    const amplitude = gapped(typed(model.get("amplitude"), Float64Array), true, true);
    const [short, long] = band();
    const selected = typed(model.get("selected"), Uint8Array);
    const n = x.length;
    const taken = amplitude.map((v, i) =>
      ((selected ? selected[n - 1 - i] : x[i] >= short && x[i] <= long) ? v : null));
    const none = new Array(n).fill(null);
    const [low, high] = ["low", "high"].map((name) => typed(model.get(name), Float64Array));
    plot.put([x, amplitude, taken, low ? gapped(low, true, true) : none, high ? gapped(high, true, true) : none]);
    tell();
  }

  model.on("change:wavelength change:message change:band change:inside", draw);
  draw();
  return () => plot.destroy();
}

export default { render };
