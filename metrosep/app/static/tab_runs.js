// @ts-check
// Repeated runs by hand: the runs over one another, the error that repeats, what is left, amplitude
// against wavelength for each feedrate, and the thresholds. A handle that is let go is one edit of the
// step "separate"; until the separation is done anew the old curves stay, greyed.

import { mendButtons } from "./mends.js";
import runCurves, { wayOf } from "./run_curves.js";
import { choices, foundOf } from "./run_found.js";
import { curvesOf, looking, make_, numbersOf, sample, typedLength } from "./run_parts.js";
import runWaves, { thresholds } from "./run_waves.js";
import { makeModel, Refusal, Superseded } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

const COMPUTING = "computing…";
const SETTLE = 200;

/** @param {import("./tabs.js").Context} context @returns {import("./tabs.js").Tab} */
export function make(context) {
  const { el, wire } = context;
  let seen = "";
  let dirty = false;
  let epoch = 0;
  let timer = 0;
  let settled = false;
  /** @type {Dict[]} */
  let feeds = [];

  // ---- what is there -----------------------------------------------------------------------

  const curves = makeModel({ shown: "repeats", window: null, direction: 1 }, (changes) => {
    if ("window" in changes) askCurves();
    if (changes.wanted) moveRange(changes.wanted);
  });
  const waves = makeModel({ statistic: 0, movable: true, direction: 1 }, (changes) => {
    if (changes.wanted) moveKey(changes.wanted);
  });

  const head = make_("header");
  head.append(make_("h2", "", "Runs"));
  const about = make_("span", "soft");
  about.id = "runs-about";
  const ways = make_("select");
  ways.id = "runs-direction";
  ways.setAttribute("aria-label", "Direction of travel");
  ways.hidden = true;
  ways.addEventListener("change", () => {
    curves.set("direction", Number(ways.value));
    waves.set("direction", Number(ways.value));
    askWaves(settled ? "full" : "idle");
  });
  head.append(about, make_("span", "grow"), ways);
  head.append(...choices((value) => {
    found.hidden = value !== "found";
    upper.hidden = legend.hidden = !found.hidden;
    if (found.hidden) curves.set("shown", value);
    drawLegend();
  }));
  const fit = make_("button", "small", "Fit");
  fit.title = "Show the whole travel (double click)";
  fit.type = "button";
  fit.addEventListener("click", () => {
    curves.set("window", null);
    curves.save_changes();
  });
  head.append(fit);

  const legend = make_("div", "runs-legend");
  const upper = make_("div", "runs-upper");
  upper.id = "run-curves";
  const found = make_("div", "runs-found");
  Object.assign(found, { id: "runs-found", hidden: true, tabIndex: 0 });
  const numbers = make_("div", "runs-numbers");
  numbers.id = "runs-numbers";
  const message = make_("div", "runs-message");
  message.setAttribute("role", "status");
  message.hidden = true;

  const low = make_("header");
  low.append(make_("h2", "", "Amplitude against wavelength"));
  const part = make_("span", "soft");
  part.id = "runs-part";
  const automatic = make_("button", "small", "Let the data choose");
  automatic.type = "button";
  automatic.id = "runs-automatic";
  automatic.title = "Take the shortest wavelength out of the recipe";
  automatic.addEventListener("click", () => setKey("shortest", null, "shortest wavelength"));
  const judged = make_("select");
  judged.id = "runs-statistic";
  judged.setAttribute("aria-label", "What the wavelengths are judged by");
  judged.addEventListener("change", () => {
    waves.put({ statistic: Number(judged.value), threshold: stated(waves.get("statistics")[Number(judged.value)]) });
    drawWords();
  });
  const usual = make_("button", "small", "Usual threshold");
  usual.type = "button";
  usual.id = "runs-usual";
  usual.addEventListener("click", () => setKey(usual.dataset.key ?? "", null, `threshold ${usual.dataset.key}`));
  const words = make_("span");
  words.id = "runs-words";
  low.append(make_("span", "grow"), automatic, judged, usual);
  const state = make_("div", "runs-numbers");
  state.append(words, part);
  const lower = make_("div", "runs-lower");
  const left = make_("div");
  left.id = "run-waves";
  const right = make_("div");
  right.id = "run-evidence";
  lower.append(left, right);
  el.append(head, legend, upper, found, numbers, message, low, state, lower);
  runCurves.render({ model: curves, el: upper });
  runWaves.render({ model: waves, el: left });
  thresholds.render({ model: waves, el: right });

  // ---- what is asked -----------------------------------------------------------------------

  const width = (/** @type {HTMLElement} */ of) => Math.max(200, of.clientWidth - 60);

  function refused(/** @type {unknown} */ error) {
    if (error instanceof Superseded) return;
    if (!(error instanceof Refusal)) {
      context.fail(error);
      return;
    }
    message.replaceChildren(error.message, ...(error.mends.length ? [mendButtons(error.mends, context.edit)] : []));
    message.hidden = false;
    for (const model of [curves, waves]) model.put({ stale: "not separated" });
    drawWords();
  }

  async function askCurves(level = settled ? "full" : "idle") {
    const mine = epoch;
    try {
      const { header, arrays } = await wire.ask("curves", {
        level, window: curves.get("window"), columns: width(upper),
      });
      if (mine === epoch) putCurves(header, arrays);
    } catch (error) {
      if (mine === epoch) refused(error);
    }
  }

  async function askWaves(/** @type {"idle" | "full"} */ level) {
    const mine = epoch;
    try {
      const { header, arrays } = await wire.ask("waves", { level, direction: waves.get("direction") || null }, `waves ${level}`);
      if (mine !== epoch) return;
      putWaves(header, arrays);
      if (level === "full") {
        settled = true;
        message.hidden = true;
        await askCurves("full");
        if (mine !== epoch) return;
        for (const model of [curves, waves]) model.put({ stale: "" });
        document.body.dataset.runs = seen;
        drawWords();
      }
    } catch (error) {
      if (mine === epoch) refused(error);
    }
  }

  function refresh() {
    dirty = false;
    epoch += 1;
    settled = false;
    delete document.body.dataset.runs;
    message.hidden = true;
    for (const model of [curves, waves]) model.put({ stale: COMPUTING });
    drawWords();
    askCurves("idle");
    if (!waves.get("wavelength")?.length) askWaves("idle");
    clearTimeout(timer);
    const mine = epoch;
    timer = window.setTimeout(() => mine === epoch && askWaves("full"), SETTLE);
  }

  // ---- what came ---------------------------------------------------------------------------

  const nearestFeed = (/** @type {number | null} */ feed) =>
    feed === null ? 0 : feeds.reduce((best, one, i) => (Math.abs(one.feed - feed) < Math.abs(feeds[best].feed - feed) ? i : best), 0);

  function putCurves(/** @type {Dict} */ header, /** @type {Dict} */ arrays) {
    feeds = header.feeds.length ? header.feeds : [{ feed: null, feed_words: "feed not known" }];
    const given = curvesOf(header, arrays, nearestFeed);
    given.feeds = feeds.map((one) => one.feed_words);
    if (header.found) found.replaceChildren(...foundOf(header.found, () => setKey("method", "joint", "method joint")));
    if (header.separated) numbers.replaceChildren(...numbersOf(header));
    if (ways.options.length !== header.directions.length) {
      ways.replaceChildren(...header.directions.map((/** @type {number} */ d) => new Option(wayOf(d), String(d))));
      ways.hidden = header.directions.length < 2;
    }
    if (!header.directions.includes(curves.get("direction"))) {
      [given.direction] = header.directions;
      waves.put({ direction: header.directions[0] });
    }
    const gaps = header.runs.filter((/** @type {Dict} */ run) => run.not_measured > 0).length;
    about.textContent = [`${header.runs.length} runs`, gaps ? `${gaps} with gaps` : "", header.levelled].filter(Boolean).join("; ");
    about.title = [about.textContent, ...header.messages].join("\n");
    curves.put(given);
    putStated(header.stated);
    drawLegend();
  }

  function putStated(/** @type {Dict} */ now) {
    const given = /** @type {Dict} */ ({ stated: now, movable: now.method !== "mean" });
    if (now.shortest !== null) given.shortest = now.shortest;
    const shown = (waves.get("statistics") ?? [])[waves.get("statistic")];
    if (shown) given.threshold = now[shown.key] ?? (settled ? shown.value : waves.get("threshold"));
    waves.put(given);
    drawWords();
  }

  const stated = (/** @type {Dict | undefined} */ statistic) =>
    (statistic ? (waves.get("stated") ?? {})[statistic.key] ?? statistic.value : null);

  function putWaves(/** @type {Dict} */ header, /** @type {Dict} */ arrays) {
    const full = !header.is_preview;
    const found = /** @type {Dict} */ ({
      wavelength: arrays.wavelength, message: "",
      lines: header.feeds.map((/** @type {Dict} */ one, /** @type {number} */ i) => ({
        words: one.feed_words, feed: nearestFeed(one.feed), amplitude: arrays[`feed_${i}`],
      })),
    });
    part.textContent = `lines: ${header.part}`;
    part.title = part.textContent;
    if (full) {
      const statistics = (header.statistics ?? []).map((/** @type {Dict} */ one, /** @type {number} */ i) => ({ ...one, values: arrays[`statistic_${i}`] }));
      const same = statistics.map((/** @type {Dict} */ one) => one.key).join() === (waves.get("statistics") ?? []).map((/** @type {Dict} */ one) => one.key).join();
      const at = same ? waves.get("statistic") : 0;
      Object.assign(found, {
        estimate: arrays.estimate_wavelength ? {
          wavelength: arrays.estimate_wavelength, amplitude: arrays.estimate_amplitude, selected: arrays.selected,
          sd: arrays.sd, low: arrays.low, high: arrays.high, reason: arrays.reason, reasons: header.reasons,
        } : null,
        vibrations: header.vibrations, statistics, statistic: at, words: header.words, in_use: header.thresholds_in_use,
        threshold: statistics[at]?.value ?? null, shortest: header.shortest?.value ?? null, m: header.m, notes: header.messages, stated: header.stated,
      });
      if (header.stated.shortest !== null) found.shortest = header.stated.shortest;
      if (!same) judged.replaceChildren(...statistics.map((/** @type {Dict} */ one, /** @type {number} */ i) => new Option(`${one.key}: ${one.name}`, String(i))));
      judged.value = String(at);
    }
    waves.put(found);
    drawWords();
  }

  // ---- words -------------------------------------------------------------------------------

  function drawLegend() {
    const shown = curves.get("shown");
    const names = shown !== "separated" ? feeds.map((one) => one.feed_words)
      : (curves.get("separated") ?? []).map((/** @type {Dict} */ one) => wayOf(one.direction) || "both directions");
    const items = names.map((/** @type {string} */ name, /** @type {number} */ i) => {
      const item = make_("span");
      item.append(sample(names.length === 1 && name === "reverse" ? 1 : i), ` ${name}`);
      return item;
    });
    const both = ways.options.length > 1;
    const words = shown === "repeats" ? `one line for each run${both ? ", reverse runs dotted" : ""}`
      : shown === "separated" ? "separated error with its band of ±2 u; shaded: evaluation range"
        : "mean of the runs of each feedrate: faint before, strong after the error is taken off";
    legend.replaceChildren(...items, make_("span", "soft", words));
  }

  function drawWords(news = "") {
    const stale = waves.get("stale");
    words.textContent = stale ? [stale, news].filter(Boolean).join(" ") : [waves.get("words"), ...(waves.get("notes") ?? [])].filter(Boolean).join("; ");
    words.title = words.textContent;
    const now = waves.get("stated") ?? {};
    automatic.hidden = now.shortest === null || now.shortest === undefined;
    const statistic = (waves.get("statistics") ?? [])[waves.get("statistic")];
    judged.hidden = (waves.get("statistics") ?? []).length < 2;
    usual.hidden = !statistic || now[statistic.key] === null || now[statistic.key] === undefined;
    usual.dataset.key = statistic?.key ?? "";
    usual.title = `Take ${usual.dataset.key} out of the recipe`;
    el.classList.toggle("busy", stale === COMPUTING);
    found.classList.toggle("stale", Boolean(stale));
  }

  // ---- what is done ------------------------------------------------------------------------

  const step = () => context.session().steps.find((/** @type {Dict} */ one) => one.op === "separate");

  function setKey(/** @type {string} */ key, /** @type {any} */ value, /** @type {string} */ label) {
    return setKeys({ [key]: value }, label);
  }

  async function setKeys(/** @type {Dict} */ values, /** @type {string} */ label) {
    const { index, keys } = step();
    const edits = Object.entries(values).filter(([key, value]) => (keys[key] ?? null) !== value)
      .map(([key, value]) => ({ path: ["step", index, key], old: keys[key] ?? null, new: value }));
    const before = context.session().hash;
    if (edits.length) await context.edit(edits, label);
    if (context.session().hash === before) askCurves(); // nothing changed, or it was refused: handles go back
  }

  function moveRange(/** @type {number[]} */ wanted) {
    const [x0, x1] = curves.get("window") ?? curves.get("extent");
    const travel = /** @type {[number, number]} */ (curves.get("travel"));
    const [from, to] = [Math.max(wanted[0], travel[0]), Math.min(wanted[1], travel[1])];
    const pixel = (x1 - x0) / Math.max(1, width(upper));
    const [was, end] = curves.get("range");
    const given = step().keys.start;
    // What was not moved stays as it is, to the nanometre.
    const start = from === was ? { ...typedLength(was, 1e-9), ...(given ? { text: given } : {}) } : typedLength(from, pixel, travel);
    const stop = to === end ? end : typedLength(to, pixel, travel).value;
    const length = typedLength(stop - start.value, 1e-9);
    setKeys({ start: start.text, length: length.text }, "evaluation range");
  }

  function moveKey(/** @type {Dict} */ { key, value, resolution }) {
    if (key === "shortest") {
      const typed = typedLength(value, resolution);
      waves.put({ shortest: typed.value });
      setKey(key, typed.text, "shortest wavelength");
    } else {
      const rounded = Number(value.toPrecision(3));
      waves.put({ threshold: rounded });
      setKey(key, rounded, `threshold ${key}`);
    }
  }

  return {
    ...looking(el, ways, curves),
    show: () => dirty && refresh(),
    changed(session, isNewFile) {
      if (session.kind !== "runs") {
        epoch += 1;
        dirty = false;
        seen = "";
        return;
      }
      if (isNewFile) {
        curves.put({ runs: [], separated: [], means: [], window: null, range: null, extent: null, direction: 1 });
        waves.put({ wavelength: null, lines: [], estimate: null, statistics: [], vibrations: [], shortest: null, threshold: null, direction: 0, words: "" });
        for (const box of [numbers, found]) box.replaceChildren();
        ways.replaceChildren();
      }
      if (session.hash !== seen || isNewFile) {
        seen = session.hash;
        dirty = true;
        epoch += 1;
      }
    },
    news(news) {
      if (news.k === "progress" && news.text && waves.get("stale") === COMPUTING) drawWords(`(${news.text})`);
    },
  };
}
