// @ts-check
// The pictures of the page in one widget for a notebook: map, section and spectrum, or profile and
// spectrum. What is wished goes to Python as traits, frames come back, as the server sends them.
//
// Traits: kind ("map" | "profile"), colours, height; a, b, band, limits, window (both sides write
// them), cursors (the same), view (written here); map_frame, section_frame, spectrum_frame, profile_frame (bytes).

import colourbarWidget from "./colourbar.js";
import { si } from "./format.js";
import mapWidget from "./map.js";
import { inkFrom } from "./plots.js";
import profileWidget from "./profile.js";
import sectionWidget from "./section.js";
import spectrumWidget from "./spectrum.js";
import { makeModel, unpack } from "./wire.js";

/** @typedef {Record<string, any>} Dict */
/** @typedef {import("./wire.js").Model} Model */

const NARROW = 640; // CSS pixels, below which the pictures stand under one another
const LOST = 2000; // ms after which an answer is no longer waited for
const IDLE = 250; // ms after the last move, when the finer picture is asked for

/** Whether the notebook is dark: by its own word, else by that of the system. */
function isDark() {
  for (const el of [document.body, document.documentElement]) {
    if (el.dataset.jpThemeLight) return el.dataset.jpThemeLight === "false";
    const words = `${el.className} ${el.dataset.theme ?? ""} ${el.dataset.vscodeThemeKind ?? ""}`;
    if (/\bdark\b/i.test(words)) return true;
    if (/\blight\b/i.test(words)) return false;
  }
  return matchMedia("(prefers-color-scheme: dark)").matches;
}

/**
 * Return a way to Python on which one wish is under way and only the latest waits.
 * @param {Model} model
 */
function makeSender(model) {
  let waits = false;
  let more = false;
  let timer = 0;
  function answered() {
    clearTimeout(timer);
    waits = false;
    if (more) send();
  }
  function send() {
    more = waits;
    if (waits) return;
    waits = true;
    timer = window.setTimeout(answered, LOST);
    model.save_changes();
  }
  return {
    answered,
    /** @param {Dict} values */
    wish(values) {
      const news = Object.entries(values).filter(([k, v]) => JSON.stringify(v) !== JSON.stringify(model.get(k) ?? null));
      for (const [name, value] of news) model.set(name, value);
      if (news.length) send();
    },
    stop: () => clearTimeout(timer),
  };
}

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const root = document.createElement("div");
  root.className = "metrosep-explore";
  root.dataset.kind = model.get("kind");
  el.append(root);
  const sender = makeSender(model);
  /** @type {(() => void)[]} */
  const ends = [() => sender.stop()];
  const isMap = model.get("kind") === "map";

  /** @param {string} name @param {string} title */
  function box(name, title) {
    const panel = document.createElement("div");
    panel.className = "box";
    panel.style.gridArea = name;
    const head = document.createElement("div");
    head.className = "title";
    const word = document.createElement("b");
    word.textContent = title;
    const note = document.createElement("span");
    head.append(word, note);
    const body = document.createElement("div");
    body.dataset.picture = name;
    panel.append(head, body);
    root.append(panel);
    return { panel, body, note };
  }

  /** @param {{ render: (given: { model: Model, el: HTMLElement }) => () => void }} widget @param {Model} own @param {HTMLElement} place */
  const show = (widget, own, place) => ends.push(widget.render({ model: own, el: place }));

  /**
   * Hear of frames of a picture, the present one first.
   * @param {string} name
   * @param {(header: Dict, arrays: Dict) => void} put
   * @param {(message: string) => void} refuse
   */
  function frames(name, put, refuse) {
    const heard = () => {
      const value = model.get(name);
      if (!value?.byteLength) return;
      const bytes = ArrayBuffer.isView(value) ? value.buffer.slice(value.byteOffset, value.byteOffset + value.byteLength) : value;
      const { header, arrays } = unpack(/** @type {ArrayBuffer} */ (bytes));
      if (header.ok) put(header, arrays);
      else refuse(header.error.message);
      root.dataset[name.replace("_frame", "s")] = String(header.n);
      sender.answered();
    };
    model.on(`change:${name}`, heard);
    ends.push(() => model.off(`change:${name}`, heard));
    return heard;
  }

  /** Hear what Python sets; not while the hand holds the same thing. @param {Model & { put: (v: Dict) => void }} own @param {string[]} names */
  function follow(own, names) {
    for (const name of names) {
      const heard = () => {
        if (own.get("moving") || JSON.stringify(own.get(name)) === JSON.stringify(model.get(name))) return;
        own.put({ [name]: model.get(name) });
      };
      model.on(`change:${name}`, heard);
      ends.push(() => model.off(`change:${name}`, heard));
    }
  }

  function makeMap() {
    const { panel, body, note } = box("map", "Map");
    const row = document.createElement("div");
    row.className = "map-row";
    const bar = document.createElement("div");
    const message = document.createElement("div");
    message.className = "panel-message";
    message.hidden = true;
    panel.append(row, message);
    row.append(body, bar);
    let timer = 0;
    const start = { colours: model.get("colours"), a: model.get("a"), b: model.get("b"), limits: model.get("limits") };
    const map = makeModel(start, (changes) => {
      const { view, ...others } = changes;
      const sent = /** @type {Dict} */ ({});
      for (const name of ["a", "b", "limits"]) if (name in others) sent[name] = others[name];
      if (view) {
        sent.view = { ...view, level: "drag" };
        clearTimeout(timer);
        timer = window.setTimeout(() => sender.wish({ view: { ...view, level: "idle" } }), IDLE);
      }
      sender.wish(sent);
    });
    show(mapWidget, map, body);
    show(colourbarWidget, map, bar);
    follow(map, ["a", "b", "limits", "colours"]);
    ends.push(() => clearTimeout(timer));
    return frames("map_frame", (header, arrays) => {
      message.hidden = true;
      map.put({
        shape: arrays.index.shape, window: header.window, unit: header.unit, range: header.range,
        auto_range: header.auto_range, shade: null, index: arrays.index, is_preview: header.is_preview,
      });
      if (String(map.get("extent")) !== String(header.extent)) map.put({ extent: header.extent });
      note.textContent = header.coverage < 1 ? `${(100 * header.coverage).toFixed(1)}\u2009% measured` : "";
    }, (text) => {
      message.textContent = text;
      message.hidden = false;
      map.put({ index: null, shape: null, range: null, auto_range: null });
    });
  }

  function makeSection() {
    const { body, note } = box("section", "Section A–B");
    const section = makeModel({ cursors: model.get("cursors") ?? [0.25, 0.75] }, (changes) => {
      if ("cursors" in changes) sender.wish({ cursors: changes.cursors });
    });
    show(sectionWidget, section, body);
    follow(section, ["cursors"]);
    return frames("section_frame", (header, arrays) => {
      section.put({
        low: arrays.low, high: arrays.high, length: header.length, pv: header.pv, sq: header.sq, unit: header.unit,
        share_valid: header.share_valid, is_preview: header.is_preview, message: "", heights: header.heights, distance: arrays.distance,
      });
      const share = header.share_valid < 1 ? `, ${(100 * header.share_valid).toFixed(1)}\u2009% measured` : "";
      note.textContent = `${si(header.length, header.unit)}${share}`;
    }, (text) => {
      note.textContent = "";
      section.put({ low: null, high: null, length: null, message: text, distance: null });
    });
  }

  function makeProfile() {
    const { body } = box("profile", "Profile");
    const profile = makeModel({ shown: "measured", window: model.get("window") ?? null }, (changes) => {
      if ("window" in changes) sender.wish({ window: changes.window });
    });
    show(profileWidget, profile, body);
    follow(profile, ["window"]);
    return frames("profile_frame",
      (_, arrays) => profile.put({ message: "", series: { measured: arrays } }),
      (text) => profile.put({ series: {}, message: text }));
  }

  function makeSpectrum() {
    const { body, note } = box("spectrum", "Amplitude against wavelength");
    const spectrum = makeModel({ band: model.get("band") ?? null }, (changes) => {
      if ("band" in changes) sender.wish({ band: changes.band });
    });
    show(spectrumWidget, spectrum, body);
    follow(spectrum, ["band"]);
    return frames("spectrum_frame", (header, arrays) => {
      spectrum.put({
        amplitude: arrays.amplitude, low: null, high: null, selected: null, outside: header.outside,
        notes: header.messages, is_preview: header.is_preview, message: "", unit: header.unit,
      });
      spectrum.put({ inside: header.inside, wavelength: arrays.wavelength });
      note.textContent = header.messages?.join("; ") ?? "";
      note.title = note.textContent;
    }, (text) => spectrum.put({ wavelength: null, amplitude: null, message: text }));
  }

  function measure() {
    const narrow = isMap && root.clientWidth > 0 && root.clientWidth < NARROW;
    root.classList.toggle("narrow", narrow);
    root.style.height = `${Math.round(model.get("height") * (narrow ? 1.7 : 1))}px`;
  }

  function recolour() {
    const scheme = isDark() ? "dark" : "light";
    root.dataset.scheme = scheme;
    inkFrom(root);
  }

  measure();
  recolour();
  const first = isMap ? [makeMap(), makeSection(), makeSpectrum()] : [makeProfile(), makeSpectrum()];
  first.forEach((heard) => heard());

  const sizes = new ResizeObserver(() => {
    measure();
    recolour(); // the first time it is on the page, its colours are known
  });
  sizes.observe(root);
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  scheme.addEventListener("change", recolour);
  const themes = new MutationObserver(recolour);
  for (const one of [document.body, document.documentElement]) {
    themes.observe(one, { attributes: true, attributeFilter: ["class", "data-theme", "data-jp-theme-light", "data-vscode-theme-kind"] });
  }
  model.on("change:height", measure);
  return () => {
    sizes.disconnect();
    themes.disconnect();
    scheme.removeEventListener("change", recolour);
    model.off("change:height", measure);
    ends.forEach((end) => end());
    root.remove();
  };
}

export default { render };
