// @ts-check
// The pictures of the page: models of the widgets, and what they ask the server for.

import colourbarWidget from "./colourbar.js";
import densityWidget from "./density.js";
import fourierWidget from "./fourier.js";
import heightsWidget from "./heights.js";
import polarWidget from "./polar.js";
import { written } from "./shapes.js";
import { si } from "./format.js";
import { makeLooks } from "./history.js";
import mapWidget from "./map.js";
import { gapped, whenWidened } from "./plots.js";
import profileWidget from "./profile.js";
import { bandOf, bandView, prefer, preferred, sectionOf, sectionView } from "./remember.js";
import sectionWidget from "./section.js";
import spectrumWidget from "./spectrum.js";
import { listenToParts } from "./tabs.js";
import { makeReliefView, makeWholeViews } from "./whole_views.js";
import { makeModel, Refusal, Superseded } from "./wire.js";

/** @typedef {import("./ladder.js").Level} Level */
/** @typedef {Record<string, any>} Dict */

/**
 * Return the pictures.
 * @param {object} options
 * @param {import("./wire.js").Wire} options.wire
 * @param {() => Level} options.level
 * @param {() => number} options.stage
 * @param {() => string} options.kind
 * @param {() => boolean} options.judged whether the step that is shown compares a spectrum with a limit
 * @param {(error: unknown) => void} options.failed
 * @param {(view: Dict) => void} options.shown told what is to be remembered of the view
 * @param {() => number[][]} options.lines ends of sections
 * @param {(step: Dict, label: string) => void} options.insert a step
 * @param {(failed: number | null, done: number | null) => void} options.reached told which step failed before what is shown, or how many were carried out so far
 * @param {(groove: import("./profile.js").Groove) => void} options.grooved the groove of a step height was moved on a profile
 * @param {(header: Dict) => void} options.learn told what a picture of the map says of it
 */
export function makeViews({ wire, level, stage, kind, judged, failed, shown, learn, reached, lines, insert, grooved }) {
  const el = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
  let shade = false;
  let placed = false;
  /** @type {Dict} */
  let kept = {}; // [view] of the recipe, until the first picture is there
  let epoch = 0; // rises with each file: answers about another file are dropped
  const counts = { section: 0, spectrum: 0, map: 0 };
  const counted = (/** @type {"section" | "spectrum" | "map"} */ what) => {
    counts[what] += 1;
    document.body.dataset[`${what}s`] = String(counts[what]);
  };

  const map = makeModel({ colours: preferred("colours", "viridis") }, (changes) => {
    if ("view" in changes || "limits" in changes) askMap();
    if ("a" in changes || "b" in changes) {
      askSection();
      askSpectrum();
      shown(sectionView([map.get("a"), map.get("b")], map.get("unit") ?? "m"));
    }
  });
  const section = makeModel({ cursors: [0.25, 0.75], others: [] }, (changes) => "cursors" in changes && askSection());
  const spectrum = makeModel({ band: null }, (changes) => {
    if ("band" in changes) {
      askSpectrum();
      shown(bandView(spectrum.get("band"), unit()));
    }
  });
  const density = makeModel({});
  const heights = makeModel({ at: null }, (changes) => "at" in changes && askHeights());
  const waves = makeModel({ ring: null, colours: preferred("colours", "viridis") });
  const polar = makeModel({ rounds: [] });
  const profile = makeModel({ shown: "residual", window: null }, (changes) => {
    if ("window" in changes) askProfile();
  });
  mapWidget.render({ model: map, el: el("map") });
  colourbarWidget.render({ model: map, el: el("colourbar") });
  sectionWidget.render({ model: section, el: el("section") });
  spectrumWidget.render({ model: spectrum, el: el("spectrum") });
  densityWidget.render({ model: density, el: el("density") });
  heightsWidget.render({ model: heights, el: el("heights") });
  fourierWidget.render({ model: waves, el: el("waves2d"), act: insert, text: written });
  polarWidget.render({ model: polar, el: el("polar") });
  profileWidget.render({ model: profile, el: el("profile"), act: grooved });

  const { ask: askRelief, paint: paintRelief, pose: reliefPose } = makeReliefView({ wire, level, stage, kind, lines: () => [...lines(), ...(map.get("a") && map.get("b") ? [[...map.get("a"), ...map.get("b")]] : [])], epoch: () => epoch, refused, table: () => map.get("colours") });

  const { looked, look } = makeLooks({ map, section, spectrum, profile, heights, waves }, {
    kind, unit: () => unit(), choice: () => choice, shade: () => shade, relief: reliefPose,
    ready: () => (kind() === "profile" ? true : placed && Boolean(spectrum.get("wavelength") || lower() !== "line")), shown });

  for (const one of document.querySelectorAll("input[name=shown]")) {
    one.addEventListener("change", () => profile.put({ shown: /** @type {HTMLInputElement} */ (one).value }));
  }
  listenToParts(el("parts"));
  const unit = () => (kind() === "map" ? map.get("unit") ?? "m" : "m");

  /** Errors of a picture are shown in it; the rest of the page goes on. */
  function refused(/** @type {unknown} */ error, /** @type {(text: string) => void} */ show) {
    if (error instanceof Superseded) return;
    if (error instanceof Refusal) show(error.message);
    else failed(error);
  }

  async function askMap(/** @type {Level} */ at = level()) {
    if (kind() !== "map") return;
    const view = map.get("view");
    const message = el("map-message");
    const mine = epoch;
    try {
      const { header, arrays } = await wire.ask("map", {
        stage: stage(), level: at, window: placed ? view?.window ?? null : null,
        pixels: view?.pixels ?? [512, 512], range: map.get("limits") ?? null, shade,
      });
      if (mine !== epoch) return;
      message.hidden = true;
      const first = !placed;
      placed = true;
      if (first) beginSection(header.extent, header.unit);
      map.put({
        shape: arrays.index.shape, window: header.window, unit: header.unit, range: header.range,
        ...(map.get("limits") ? {} : { auto_range: header.range }),
        shade: arrays.shade ?? null, index: arrays.index, is_preview: header.is_preview, coverage: header.coverage,
      });
      if (String(map.get("extent")) !== String(header.extent)) map.put({ extent: header.extent });
      learn(header);
      reached(header.failed, header.done);
      counted("map");
    } catch (error) {
      refused(error, (text) => {
        message.textContent = text;
        message.hidden = false;
        map.put({ index: null, shape: null, range: null, auto_range: null });
      });
    }
  }

  function beginSection(/** @type {number[]} */ [x0, y0, x1, y1], /** @type {string} */ unit) {
    const y = (y0 + y1) / 2;
    const usual = [[x0 + 0.08 * (x1 - x0), y], [x1 - 0.08 * (x1 - x0), y]];
    const was = sectionOf(kept, unit);
    const inside = was?.every(([x, v]) => x >= x0 && x <= x1 && v >= y0 && v <= y1);
    const [a, b] = inside && was ? was : usual;
    map.put({ a, b });
    askSection();
    askSpectrum();
  }

  async function askSection(/** @type {Level} */ at = level()) {
    if (kind() !== "map" || !map.get("a")) return;
    const mine = epoch;
    try {
      const { header, arrays } = await wire.ask("section", {
        stage: stage(), level: at, a: map.get("a"), b: map.get("b"), columns: Math.max(100, el("section").clientWidth - 70),
        cursors: section.get("cursors"),
      });
      if (mine !== epoch) return;
      section.put({
        low: arrays.low, high: arrays.high, length: header.length, pv: header.pv, sq: header.sq, unit: header.unit,
        share_valid: header.share_valid, is_preview: header.is_preview, message: "", heights: header.heights, distance: arrays.distance,
      });
      const share = header.share_valid < 1 ? `, ${(100 * header.share_valid).toFixed(1)}\u2009% measured` : "";
      el("section-of").textContent = `${si(header.length, header.unit)}${share}`;
      counted("section");
    } catch (error) {
      refused(error, (text) => section.put({ low: null, high: null, length: null, message: text, distance: null }));
    }
  }

  /** The curves of the sections in the recipe. */
  async function askSections(/** @type {Level} */ at = level()) {
    if (kind() !== "map") return;
    const mine = epoch;
    try {
      const { header, arrays } = await wire.ask("sections", { stage: stage(), level: at, columns: Math.max(100, el("section").clientWidth - 70) });
      if (mine !== epoch) return;
      const others = header.curves.map((/** @type {Dict} */ one) => ({ ...one,
        curve: [Array.from(arrays[`${one.index}_x`]), gapped(arrays[`${one.index}_low`]), gapped(arrays[`${one.index}_high`])] }));
      section.put({ others });
      polar.put({ is_preview: header.is_preview, rounds: others.filter((/** @type {Dict} */ one) => one.kind === "circle") });
    } catch (error) {
      refused(error, () => (section.put({ others: [] }), polar.put({ rounds: [] })));
    }
  }

  /** What stands in the lower panel: along the section, or of the whole map. */
  const choice = /** @type {HTMLSelectElement} */ (el("lower"));
  const lower = () => (kind() === "map" || choice.value === "heights" ? choice.value : "line");
  const { askHeights, askWaves } = makeWholeViews({ wire, level, stage, kind, lower, heights, waves, epoch: () => epoch, refused, counted: () => counted("spectrum") });

  function drawLower() {
    for (const option of choice.options) option.hidden = kind() !== "map" && ["waves2d", "polar"].includes(option.value);
    choice.options[0].text = kind() === "map" ? "waves along the section" : "waves along the profile";
    for (const id of ["heights", "waves2d", "polar"]) el(id).hidden = lower() !== id;
    for (const id of ["spectrum", "density"]) el(id).hidden = lower() !== "line" || (id === "density") !== judged();
    el("spectrum-of").hidden = lower() !== "line";
    el("spectrum-title").textContent = { heights: "Distribution of heights", waves2d: "Waves in all directions", polar: "Round sections" }[lower()]
      ?? (judged() ? "Power spectral density" : "Amplitude against wavelength");
  }
  choice.addEventListener("change", () => {
    drawLower();
    shown({ lower: choice.value });
    Promise.all([askHeights(), askWaves(), askSpectrum()]);
  });

  /** Density and limit of the step that is shown; it stands where the amplitudes stand. */
  async function askDensity(/** @type {Level} */ at) {
    const mine = epoch;
    try {
      const { header, arrays } = await wire.ask("density", { stage: stage(), level: at });
      if (mine !== epoch) return;
      density.put({
        density: arrays.density, limit: arrays.limit, mean: arrays.mean, unit: header.unit, bands: header.bands,
        words: header.words, verdict: header.verdict, is_preview: header.is_preview, message: "",
      });
      density.put({ wavelength: arrays.wavelength });
      el("spectrum-of").textContent = `${header.limit}, lines along ${header.direction}`;
      counted("spectrum");
    } catch (error) {
      refused(error, (text) => density.put({ density: null, words: "", message: text, wavelength: null }));
    }
  }

  async function askSpectrum(/** @type {Level} */ at = level()) {
    const of = kind();
    drawLower();
    if (lower() !== "line") return;
    if (judged()) {
      await askDensity(at);
      return;
    }
    if (of !== "profile" && !map.get("a")) return;
    const mine = epoch;
    try {
      const { header, arrays } = await wire.ask("spectrum", {
        stage: stage(), level: at, of: of === "profile" ? "profile" : "section",
        a: map.get("a") ?? null, b: map.get("b") ?? null, band: spectrum.get("band"),
      });
      if (mine !== epoch) return;
      spectrum.put({
        amplitude: arrays.amplitude, low: arrays.low ?? null, high: arrays.high ?? null, selected: arrays.selected ?? null,
        outside: header.outside, notes: header.messages, is_preview: header.is_preview, message: "", unit: header.unit,
      });
      spectrum.put({ inside: header.inside, wavelength: arrays.wavelength });
      if (!spectrum.get("band")) beginBand(arrays.wavelength);
      el("spectrum-of").textContent = header.messages?.length ? header.messages.join("; ") : of === "profile" ? "of the profile" : "of the section";
      counted("spectrum");
    } catch (error) {
      refused(error, (text) => spectrum.put({ wavelength: null, amplitude: null, message: text }));
    }
  }

  /** The band begins with the middle third, so that RMS inside and outside belong to it at once. */
  function beginBand(/** @type {Float64Array} */ wavelength) {
    const n = wavelength?.length ?? 0;
    if (n < 2) return;
    const was = bandOf(kept, unit());
    if (was) {
      spectrum.put({ band: was });
      askSpectrum();
      return;
    }
    const [long, short] = [Math.log(wavelength[0]), Math.log(wavelength[n - 1])];
    spectrum.set("band", [Math.exp(short + (long - short) / 3), Math.exp(short + (2 * (long - short)) / 3)]);
    spectrum.save_changes();
  }

  async function askProfile(/** @type {Level} */ at = level()) {
    if (kind() !== "profile") return;
    const mine = epoch;
    try {
      const { header, arrays } = await wire.ask("profile", {
        stage: stage(), level: at, series: ["measured", "residual"], window: profile.get("window"),
        columns: Math.max(200, el("profile").clientWidth - 70),
      });
      if (mine !== epoch) return;
      const one = (/** @type {string} */ name) => ({ x: arrays[`${name}_x`], low: arrays[`${name}_low`], high: arrays[`${name}_high`] });
      reached(header.failed, header.done);
      profile.put({ is_preview: header.is_preview, message: "", extent: header.extent, series: { measured: one("measured"), residual: one("residual") } });
    } catch (error) {
      refused(error, (text) => profile.put({ series: {}, message: text }));
    }
  }

  whenWidened([el("section"), el("profile")], () => Promise.all([askSection(), askSections(), askProfile()]));

  return {
    map, section, spectrum, profile,
    /** @param {Level} [at] */
    async show(at) {
      await Promise.all([askMap(at), askProfile(at), askRelief(at)]);
      await Promise.all([askSection(at), askSections(at), askSpectrum(at), askHeights(at), askWaves(at)]);
    },
    /** Another file: begin anew, with what its recipe holds of the view. @param {Dict} view */
    reset(view = {}) {
      kept = view && typeof view === "object" ? view : {};
      if (typeof kept.hill_shade === "boolean") shade = kept.hill_shade;
      const known = [.../** @type {HTMLSelectElement} */ (el("colours")).options].map((one) => one.value);
      if (known.includes(kept.colours)) map.put({ colours: kept.colours });
      placed = false;
      epoch += 1;
      map.put({ index: null, shape: null, extent: null, limits: null, auto_range: null, a: null, b: null, view: map.get("view") });
      section.put({ distance: null, length: null, message: "", others: [] });
      spectrum.put({ wavelength: null, band: null, message: "" });
      density.put({ wavelength: null, words: "", message: "" });
      heights.put({ at: null, ratios: null, edges: null, shares: null, curve: null, message: "", heights: null });
      waves.put({ ring: null, index: null, message: "" });
      polar.put({ rounds: [] });
      choice.value = [...choice.options].some((one) => one.value === kept.lower) ? kept.lower : "line";
      profile.put({ series: {}, window: null, message: "" });
    },
    looked,
    /** Look at it again. @param {Dict} was */
    look(was) {
      shade = was.shade ?? shade;
      look(was);
      this.show();
    },
    /** Another stage is shown: its heights have another range. */
    newRange() {
      map.put({ limits: null });
    },
    fit() {
      if (kind() === "map") map.put({ fit: 1 });
      else profile.set("window", null), profile.save_changes();
    },
    /** @param {boolean} on */
    shade(on) {
      shade = on;
      shown({ hill_shade: on });
      askMap();
    },
    /** @param {string} name */
    colours(name) {
      prefer("colours", name);
      map.put({ colours: name });
      waves.put({ colours: name });
      paintRelief();
      shown({ colours: name });
    },
    /** Middle of what was measured along x, m. */
    middle() {
      const [x0, , x1] = map.get("extent") ?? [0, 0, 0];
      const x = profile.get("series")?.measured?.x;
      return x?.length ? (x[0] + x[x.length - 1]) / 2 : (x0 + x1) / 2;
    },
    /** Largest side of what was measured, m. */
    size() {
      const extent = map.get("extent");
      if (extent) return Math.min(extent[2] - extent[0], extent[3] - extent[1]);
      const x = profile.get("series")?.measured?.x;
      return x?.length ? x[x.length - 1] - x[0] : 0;
    },
  };
}
