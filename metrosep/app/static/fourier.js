// @ts-check
// The waves of a map in all directions: power over fx and fy, in the colours of the map over six decades.
// A ring of wavelengths is dragged; what lies in it is kept, or what is longer or shorter is taken out.
//
// Traits: index, shape, unit (m, or px of a map without lateral scale), window [f0x, f0y, f1x, f1y] in 1/unit, amplitude (m, of a wave at the top), decades, peak,
// notes, colours, is_preview, message; ring [shortest, longest] (written here).

import { painted } from "./colours.js";
import { places, si } from "./format.js";
import { listenToPinch, makeHandle, wheelFactor } from "./handles.js";
import { typed } from "./wire.js";

/** @typedef {import("./wire.js").Model} Model */

const degrees = (/** @type {number} */ v) => `${((v * 180) / Math.PI).toFixed(1)}°`;

/** @param {{ model: Model, el: HTMLElement, act: (step: Record<string, string>, label: string) => void, text: (m: number) => string }} given */
function render({ model, el, act, text }) {
  el.classList.add("plot", "fourier");
  const make = (/** @type {string} */ tag, /** @type {string} */ name) => Object.assign(document.createElement(tag), { className: name });
  const [read, words, bar, field, how] = ["readout", "plot-empty", "fourier-bar", "fourier-field", "fourier-how"].map((name) => make("div", name));
  const canvas = /** @type {HTMLCanvasElement} */ (make("canvas", ""));
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "Power of the waves over their frequencies along x and y. Wheel or plus and minus zoom.");
  field.append(canvas);
  el.replaceChildren(read, words, field, bar, how);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const picture = document.createElement("canvas");
  let [side, scale, zoom] = [1, 0, 0]; // CSS pixels; 1/m for one of them; 1: all frequencies, 0: not chosen yet
  let pointed = "";
  const ring = () => model.get("ring") ?? [1, 1];
  const index = () => typed(model.get("index"), Uint8Array);
  const long = (/** @type {number} */ v, /** @type {number} */ digits = 4) => si(v, model.get("unit") ?? "m", digits);

  /** @type {[string, string, (short: string, long: string) => Record<string, string>][]} */
  const acts = [
    ["keep ring", "Filter that leaves the waves in the ring", (short, long) => ({ op: "filter", lambda_s: short, lambda_c: long })],
    ["remove ring", "Filter that takes out the waves in the ring, to its ends, with sharp edges; its message says which others stay whole", (short, long) => ({ op: "filter", lambda_s: short, lambda_c: long, band: "stop" })],
    ["remove shorter", "Filter that takes out what is shorter than the ring", (short) => ({ op: "filter", cutoff: short })],
    ["remove longer", "Filter that takes out what is longer than the ring", (_, long) => ({ op: "filter", cutoff: long, band: "short" })],
  ];
  for (const [name, title, step] of acts) {
    const button = /** @type {HTMLButtonElement} */ (make("button", "small"));
    Object.assign(button, { type: "button", textContent: name, title });
    button.addEventListener("click", () => act(step(text(ring()[0]), text(ring()[1])), name));
    bar.append(button);
  }
  const grips = [0, 1].map((k) => makeHandle(field, {
    label: k ? "Longest wavelength of the ring" : "Shortest wavelength of the ring", text: k ? "L" : "S",
    moved: (x, y) => put(k, Math.hypot(x - side / 2, y - side / 2) * scale),
    stepped: (dx, dy) => put(k, Math.max(scale, 1 / ring()[k] + (dx - dy) * scale)),
  }));

  function put(/** @type {number} */ k, /** @type {number} */ frequency) {
    if (!(frequency > 0)) return;
    const next = [...ring()];
    next[k] = 1 / Math.min(frequency, (side / 2) * scale * zoom);
    if (next[0] < next[1]) model.set("ring", next), model.save_changes();
    draw();
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    const [seen, shape, box] = [index(), model.get("shape"), model.get("window")];
    words.textContent = model.get("message") ?? "";
    field.hidden = how.hidden = !seen;
    bar.hidden = !seen || model.get("unit") === "px"; // a filter waits for the scale
    if (!seen || !box) return tell();
    const room = el.getBoundingClientRect();
    side = Math.max(60, Math.min(room.width - 20, room.height - 80));
    field.style.width = field.style.height = `${side}px`;
    canvas.width = canvas.height = Math.round(side * ratio);
    const widest = Math.max(box[2] - box[0], box[3] - box[1]);
    if (!model.get("ring")) zoom = 0; // another file
    if (!zoom) zoom = Math.max(1, Math.min(200, 0.32 * ring()[0] * widest)); // the ring fills the picture at first
    scale = widest / side / zoom;
    [picture.height, picture.width] = shape;
    /** @type {CanvasRenderingContext2D} */ (picture.getContext("2d")).putImageData(painted(seen, null, shape[1], shape[0], model.get("colours") ?? "viridis"), 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, side, side);
    context.imageSmoothingEnabled = false;
    context.drawImage(picture, side / 2 + box[0] / scale, side / 2 - box[3] / scale, (box[2] - box[0]) / scale, (box[3] - box[1]) / scale);
    ring().forEach((/** @type {number} */ wave, /** @type {number} */ k) => {
      const r = 1 / wave / scale;
      for (const [colour, width] of /** @type {[string, number][]} */ ([["#000", 4], ["#fff", 1.75]])) {
        Object.assign(context, { strokeStyle: colour, lineWidth: width });
        context.beginPath();
        context.arc(side / 2, side / 2, r, 0, 2 * Math.PI);
        context.stroke();
      }
      const turn = k ? Math.PI / 4 : 0; // two handles that do not lie on one another
      grips[k].place(side / 2 + r * Math.cos(turn), side / 2 - r * Math.sin(turn));
      grips[k].describe(long(wave));
    });
    number();
    tell();
  }

  /** Numbers of the axes, at the foot and at the left of the picture, and their unit. */
  function number() {
    const isPx = model.get("unit") === "px";
    const most = 0.5 * side * scale;
    const [factor, name] = isPx ? [1, "1/px"] : most >= 1e6 ? [1e6, "1/µm"] : most >= 1e3 ? [1e3, "1/mm"] : [1, "1/m"];
    Object.assign(context, { font: "11px system-ui, sans-serif", lineWidth: 3, strokeStyle: "#000", fillStyle: "#fff", lineJoin: "round" });
    const put = (/** @type {string} */ words, /** @type {number} */ x, /** @type {number} */ y, /** @type {CanvasTextAlign} */ align) => {
      context.textAlign = align;
      context.strokeText(words, x, y);
      context.fillText(words, x, y);
    };
    const step = (most / factor) * Math.max(0.25, 110 / side);
    for (const v of places(-most / factor, most / factor, step, "1")) {
      const words = String(Number(v.toPrecision(6))).replace("-", "\u2212");
      const at = side / 2 + (v * factor) / scale;
      if (at > 44 && at < side - 62) put(words, at, side - 5, "center");
      if (at > 16 && at < side - 24) put(words, 4, side - at + 4, "left");
      context.fillRect(at - 0.5, side - 3, 1, 3);
      context.fillRect(0, side - at - 0.5, 3, 1);
    }
    put(`fx, ${name}`, side - 4, side - 5, "right");
    put(`fy, ${name}`, 4, 12, "left");
  }

  function tell() {
    const [peak, notes] = [model.get("peak"), model.get("notes") ?? []];
    read.textContent = pointed || (peak && index() ? `ring ${long(ring()[0], 3)} to ${long(ring()[1], 3)}   peak λ ${long(peak.wavelength, 3)} at ${degrees(peak.direction)}: ${si(model.get("amplitude"), "m", 3)}` : "");
    read.classList.toggle("preview", Boolean(model.get("is_preview")));
    how.textContent = how.title = index() ? notes.join("; ") : "";
  }

  canvas.addEventListener("pointermove", (event) => {
    const [seen, shape, box] = [index(), model.get("shape"), model.get("window")];
    if (!seen || !box) return;
    const at = canvas.getBoundingClientRect();
    const [fx, fy] = [(event.clientX - at.left - side / 2) * scale, (side / 2 - event.clientY + at.top) * scale];
    const column = Math.floor(((fx - box[0]) / (box[2] - box[0])) * shape[1]);
    const row = Math.floor(((box[3] - fy) / (box[3] - box[1])) * shape[0]);
    const k = column >= 0 && row >= 0 && column < shape[1] && row < shape[0] ? seen[row * shape[1] + column] : 0;
    const size = model.get("amplitude") * 10 ** ((model.get("decades") / 2) * ((k - 1) / 254 - 1));
    pointed = k && (fx || fy) ? `λ ${long(1 / Math.hypot(fx, fy))} at ${degrees((Math.atan2(fy, fx) + Math.PI) % Math.PI)}, amplitude ${k > 1 ? "≈" : "<"} ${si(size, "m", 2)}` : "";
    tell();
  });
  function zoomed(/** @type {number} */ factor) {
    zoom = Math.max(1, Math.min(200, zoom * factor));
    draw();
  }
  listenToPinch(canvas, (factor) => zoomed(1 / factor));
  canvas.tabIndex = 0;
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomed(1 / wheelFactor(event));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const factor = { "+": 1.25, "=": 1.25, "-": 0.8 }[event.key];
    if (factor) event.preventDefault(), zoomed(factor);
  });
  canvas.addEventListener("pointerleave", () => {
    pointed = "";
    tell();
  });
  const watcher = new ResizeObserver(draw);
  watcher.observe(el);
  model.on("change:index change:message change:colours change:ring", draw);
  return () => watcher.disconnect();
}

export default { render };
