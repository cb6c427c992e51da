// @ts-check
// The map: canvas with square pixels, wheel to zoom, drag to pan, a section from A to B.
//
// Traits: index, shade (bytes), shape [h, w], window and extent [x0, y0, x1, y1], range [low, high],
// unit, colours; a, b [x, y] and moving (written here); view {window, pixels, fitted} (written here: what is
// wished to be seen); goto, a window to be shown again;
// cursor [x, y] or null (written here), linked: the cursor of a map beside this one.

import { painted } from "./colours.js";
import { powerBelow, si } from "./format.js";
import { listenToPinch, makeHandle, wheelFactor } from "./handles.js";
import { typed } from "./wire.js";

/** @typedef {import("./wire.js").Model} Model */

const DEEPEST_ZOOM = 1e-5;

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  el.classList.add("map");
  const canvas = document.createElement("canvas");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "Map of heights. Wheel or plus and minus zoom, drag or arrows pan, F shows all.");
  const line = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  line.classList.add("map-line");
  line.setAttribute("aria-hidden", "true"); // its ends say where it lies
  const strokes = ["under", "over"].map((name) => {
    const stroke = document.createElementNS("http://www.w3.org/2000/svg", "line");
    stroke.classList.add(name);
    line.append(stroke);
    return stroke;
  });
  const read = document.createElement("div");
  read.className = "readout map-readout";
  const ruler = document.createElement("div");
  ruler.className = "map-ruler";
  const cross = document.createElement("div");
  cross.className = "map-cross";
  cross.hidden = true;
  el.replaceChildren(canvas, line, read, ruler, cross);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));

  // What is seen: its centre in m, and m per CSS pixel.
  let centre = [0, 0];
  let scale = 0;
  let fitted = true;
  let size = [1, 1];
  /** @type {HTMLCanvasElement | null} */
  let picture = null;

  const toScreen = (/** @type {number[]} */ p) => [
    (p[0] - centre[0]) / scale + size[0] / 2, size[1] / 2 - (p[1] - centre[1]) / scale,
  ];
  const toMap = (/** @type {number} */ x, /** @type {number} */ y) => [
    centre[0] + (x - size[0] / 2) * scale, centre[1] + (size[1] / 2 - y) * scale,
  ];

  function repaint() {
    const index = typed(model.get("index"), Uint8Array);
    const shape = model.get("shape");
    if (!index || !shape) {
      picture = null;
      draw();
      return;
    }
    picture ??= document.createElement("canvas");
    [picture.height, picture.width] = shape;
    const shade = typed(model.get("shade"), Uint8Array);
    const paint = /** @type {CanvasRenderingContext2D} */ (picture.getContext("2d"));
    paint.putImageData(painted(index, shade, shape[1], shape[0], model.get("colours")), 0, 0);
    draw();
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, size[0], size[1]);
    const extent = model.get("extent");
    const box = model.get("window");
    if (picture && extent && box && scale > 0) {
      context.save();
      const [left, top] = toScreen([extent[0], extent[3]]);
      const [right, bottom] = toScreen([extent[2], extent[1]]);
      context.beginPath();
      context.rect(left, top, right - left, bottom - top);
      context.clip();
      context.fillStyle = "rgb(138, 138, 138)"; // not yet there, or not measured
      context.fill();
      const [x, y] = toScreen([box[0], box[3]]);
      const [x1, y1] = toScreen([box[2], box[1]]);
      context.imageSmoothingEnabled = false;
      context.drawImage(picture, x, y, x1 - x, y1 - y);
      context.restore();
    }
    placeSection();
    drawRuler();
    // who draws over the map needs to know where it is
    if (scale > 0) el.dispatchEvent(new CustomEvent("projected", { detail: { centre, scale, size } }));
  }

  function drawRuler() {
    if (!(scale > 0) || !picture) {
      ruler.hidden = true;
      return;
    }
    const raw = 120 * scale;
    const power = powerBelow(raw, model.get("unit") ?? "m");
    const step = [5, 2, 1].find((n) => n * power <= raw) ?? 1;
    ruler.hidden = false;
    ruler.style.width = `${(step * power) / scale}px`;
    ruler.textContent = si(step * power, model.get("unit") ?? "m", 3).replace(/\.0+(?=\D|$)/, "");
  }

  function fit() {
    const extent = model.get("extent");
    if (!extent) return;
    centre = [(extent[0] + extent[2]) / 2, (extent[1] + extent[3]) / 2];
    scale = Math.max((extent[2] - extent[0]) / (size[0] - 24), (extent[3] - extent[1]) / (size[1] - 24));
    fitted = true;
  }

  function wish() {
    draw();
    if (!(scale > 0)) return;
    const [x0, y1] = toMap(0, 0);
    const [x1, y0] = toMap(size[0], size[1]);
    const ratio = window.devicePixelRatio || 1;
    model.set("view", {
      window: [x0, y0, x1, y1],
      fitted,
      pixels: [Math.max(1, Math.round(size[0] * ratio)), Math.max(1, Math.round(size[1] * ratio))],
    });
    model.save_changes();
  }

  function zoom(/** @type {number} */ factor, x = size[0] / 2, y = size[1] / 2) {
    const extent = model.get("extent");
    if (!extent || !(scale > 0)) return;
    const widest = Math.max(extent[2] - extent[0], extent[3] - extent[1]);
    const next = Math.min((4 * widest) / size[0], Math.max((widest * DEEPEST_ZOOM) / size[0], scale * factor));
    const held = toMap(x, y);
    scale = next;
    const now = toMap(x, y);
    centre = [centre[0] + held[0] - now[0], centre[1] + held[1] - now[1]];
    fitted = false;
    wish();
  }

  function pan(/** @type {number} */ dx, /** @type {number} */ dy) {
    centre = [centre[0] - dx * scale, centre[1] + dy * scale];
    fitted = false;
    wish();
  }

  // ---- section ------------------------------------------------------------------------------

  function put(/** @type {"a" | "b"} */ name, /** @type {number[]} */ place) {
    const other = model.get(name === "a" ? "b" : "a");
    if (place[0] === other[0] && place[1] === other[1]) return;
    model.set(name, place);
    placeSection();
    model.save_changes();
  }

  function held(/** @type {boolean} */ is) {
    model.set("moving", is);
    model.save_changes();
  }

  const grips = (/** @type {const} */ (["a", "b"])).map((name) => makeHandle(el, {
    label: `Section end ${name.toUpperCase()}`,
    text: name.toUpperCase(),
    moved: (x, y) => put(name, toMap(x, y)),
    stepped: (dx, dy) => put(name, [model.get(name)[0] + dx * scale, model.get(name)[1] - dy * scale]),
    held,
  }));

  function placeSection() {
    const [a, b] = [model.get("a"), model.get("b")];
    const shown = Boolean(a && b && picture && scale > 0);
    line.toggleAttribute("hidden", !shown);
    grips.forEach((grip) => grip.show(shown));
    if (!shown) return;
    const unit = model.get("unit") ?? "m";
    const [p, q] = [toScreen(a), toScreen(b)];
    for (const stroke of strokes) {
      const at = { x1: p[0], y1: p[1], x2: q[0], y2: q[1] };
      for (const [key, value] of Object.entries(at)) stroke.setAttribute(key, value.toFixed(2));
    }
    [a, b].forEach((end, i) => {
      grips[i].place(...(/** @type {[number, number]} */ (i === 0 ? p : q)));
      grips[i].describe(`x ${si(end[0], unit)}, y ${si(end[1], unit)}`);
    });
  }

  // ---- pointer and keys ---------------------------------------------------------------------

  /** @type {{ x: number, y: number, draws: boolean } | null} */
  let drag = null;
  const at = (/** @type {MouseEvent} */ event) => {
    const box = canvas.getBoundingClientRect();
    return /** @type {[number, number]} */ ([event.clientX - box.left, event.clientY - box.top]);
  };
  el.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(wheelFactor(event), ...at(event));
  }, { passive: false });
  listenToPinch(canvas, (factor, x, y) => {
    const box = canvas.getBoundingClientRect();
    zoom(factor, x - box.left, y - box.top);
  });
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || !picture) return;
    canvas.setPointerCapture(event.pointerId);
    const [x, y] = at(event);
    drag = { x, y, draws: event.shiftKey };
    if (drag.draws) {
      held(true);
      model.set("a", toMap(x, y));
    } else {
      canvas.classList.add("panning");
    }
  });
  canvas.addEventListener("pointermove", (event) => {
    const [x, y] = at(event);
    if (scale > 0) model.set("cursor", toMap(x, y));
    tell(x, y);
    if (!drag) return;
    if (drag.draws) {
      put("b", toMap(x, y));
    } else {
      pan(x - drag.x, y - drag.y);
      [drag.x, drag.y] = [x, y];
    }
  });
  canvas.addEventListener("lostpointercapture", () => {
    if (drag?.draws) held(false);
    drag = null;
    canvas.classList.remove("panning");
  });
  canvas.addEventListener("pointerleave", () => {
    read.textContent = "";
    model.set("cursor", null);
  });
  model.on("change:linked", () => {
    const place = model.get("linked");
    cross.hidden = !place || !(scale > 0);
    if (cross.hidden) read.textContent = "";
    else {
      const [x, y] = toScreen(place);
      cross.style.transform = `translate(${x.toFixed(2)}px, ${y.toFixed(2)}px)`;
      tell(x, y);
    }
  });
  canvas.addEventListener("dblclick", () => {
    fit();
    wish();
  });
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const n = event.shiftKey ? 100 : 20;
    const moves = /** @type {Record<string, () => void>} */ ({
      "+": () => zoom(0.8), "=": () => zoom(0.8), "-": () => zoom(1.25),
      ArrowLeft: () => pan(n, 0), ArrowRight: () => pan(-n, 0),
      ArrowUp: () => pan(0, n), ArrowDown: () => pan(0, -n),
    });
    if (!(event.key in moves)) return;
    event.preventDefault();
    moves[event.key]();
  });

  function tell(/** @type {number} */ x, /** @type {number} */ y) {
    const index = typed(model.get("index"), Uint8Array);
    const [box, shape, range] = [model.get("window"), model.get("shape"), model.get("range")];
    if (!index || !box || !shape) return;
    const unit = model.get("unit") ?? "m";
    const p = toMap(x, y);
    const column = Math.floor(((p[0] - box[0]) / (box[2] - box[0])) * shape[1]);
    const row = Math.floor(((box[3] - p[1]) / (box[3] - box[1])) * shape[0]);
    const inside = column >= 0 && row >= 0 && column < shape[1] && row < shape[0];
    const k = inside ? index[row * shape[1] + column] : 0;
    let height = "not measured";
    if (k > 0 && range) {
      const z = range[0] + ((k - 1) / 254) * (range[1] - range[0]);
      height = k === 1 || k === 255 ? `z ${k === 1 ? "≤" : "≥"} ${si(z)}` : `z ≈ ${si(z, "m", 3)}`;
    }
    read.textContent = `x ${si(p[0], unit)}   y ${si(p[1], unit)}   ${height}`;
  }

  const watcher = new ResizeObserver(() => {
    const box = el.getBoundingClientRect();
    if (box.width < 2 || box.height < 2) return;
    const ratio = window.devicePixelRatio || 1;
    size = [box.width, box.height];
    canvas.width = Math.round(box.width * ratio);
    canvas.height = Math.round(box.height * ratio);
    if (fitted) fit();
    wish();
  });
  watcher.observe(el);

  model.on("change:index change:shade change:colours", repaint);
  model.on("change:a change:b", placeSection);
  model.on("change:extent", () => {
    if (!fitted && scale > 0) return;
    fit();
    wish();
  });
  model.on("change:goto", () => {
    const [x0, y0, x1, y1] = model.get("goto");
    centre = [(x0 + x1) / 2, (y0 + y1) / 2];
    scale = Math.max((x1 - x0) / size[0], (y1 - y0) / size[1]);
    fitted = false;
    wish();
  });
  model.on("change:fit", () => {
    fit();
    wish();
  });
  repaint();
  return () => watcher.disconnect();
}

export default { render };
