// @ts-check
// The section from A to B: extremes of each pixel column, two cursors with their differences.
//
// `others` are the curves of the sections in the recipe, [{name, index, x, low, high}], each in its colour.
//
// Traits: distance, low, high (arrays, NaN is a gap), length, pv, sq, share_valid, unit, is_preview,
// message; cursors [0..1, 0..1], parts of the length (written here); heights [[part, height]], read from
// the map there. The columns hold many samples each: no number is read from them.

import { si, spanned } from "./format.js";
import { frame, gapped, ink, joined, makePlot, nearest, pointedAt, uprightHandle } from "./plots.js";
import { typed } from "./wire.js";

/** @typedef {import("./wire.js").Model} Model */

const MOST = 8;
const NOTHING = [[0], [null], [null]];

/** @param {{ model: Model, el: HTMLElement }} given */
function render({ model, el }) {
  const [read, words, names] = frame(el, ["readout", "plot-empty", "plot-names"]);
  /** @type {any[][]} distance, least and greatest height from A to B */
  let own = [[], [], []];
  const hidden = /** @type {Set<string>} */ (new Set());
  let shown = model.get("cursors") ?? [0.25, 0.75];
  let pointed = "";
  const unit = () => model.get("unit") ?? "m";
  const length = () => model.get("length") ?? 1;

  const plot = makePlot(el, {
    title: "Section: height over the distance from A to B",
    xUnit: unit,
    series: [
      ...[0, 1].map(() => ({ stroke: () => ink("--line"), width: 1.25 })),
      ...Array.from({ length: 2 * MOST }, (_, i) => ({ stroke: () => ink(`--curve-${i >> 1}`), width: 1.5 })),
    ],
    bands: [{ series: [2, 1], fill: () => ink("--line") },
      ...Array.from({ length: MOST }, (_, k) => ({ series: /** @type {[number, number]} */ ([2 * k + 4, 2 * k + 3]), fill: () => ink(`--curve-${k}`) }))],
    placed: follow,
    pointed(u) {
      const i = pointedAt(u);
      const x = i < 0 ? NaN : u.data[0][i];
      const at = (/** @type {any[][]} */ curve, name = "") => {
        const k = nearest(curve[0], x);
        return k < 0 ? [] : [`${name}${spanned(curve[1][k], curve[2][k])}`];
      };
      pointed = i < 0 ? "" : `${si(x, unit())}: ${[...at(own), ...others().flatMap((one) => at(one.curve, `${one.name} `))].join("   ")}`;
      tell();
    },
  });

  const grips = [0, 1].map((k) => uprightHandle(plot.u, {
    label: `Cursor ${k + 1} of the section`,
    text: String(k + 1),
    value: () => shown[k] * length(),
    put(value) {
      model.set("cursors", shown.map((/** @type {number} */ v, /** @type {number} */ i) => (i === k ? value / length() : v)));
      model.save_changes();
    },
  }));

  /** Curves of the recipe that are shown. @returns {{ name: string, index: number, curve: any[][] }[]} */
  const others = () => (model.get("others") ?? []).filter((/** @type {any} */ one) => !hidden.has(one.name));

  /** Height at a part of the length: null in a gap, undefined before it was read. @param {number} part @returns {number | null | undefined} */
  function heightAt(part) {
    const found = (model.get("heights") ?? []).find((/** @type {[number, number | null]} */ one) => one[0] === part);
    return found?.[1];
  }

  function follow() {
    grips.forEach((grip, k) => {
      const z = heightAt(shown[k]);
      grip.follow(`${si(shown[k] * length(), unit())}, height ${z === undefined ? "…" : si(z)}`);
    });
  }

  function tell() {
    const length_ = model.get("length");
    if (length_ === null || length_ === undefined || !plot.u.data[0].length) {
      read.textContent = "";
      return;
    }
    const sign = model.get("is_preview") ? "≈ " : "";
    const [z1, z2] = shown.map(heightAt);
    const isRead = z1 !== undefined && z2 !== undefined;
    const dz = typeof z1 !== "number" || typeof z2 !== "number" ? null : z2 - z1;
    const parts = [
      `Δx ${si(Math.abs(shown[1] - shown[0]) * length_, unit())}`,
      `Δz ${isRead ? `${sign}${dz === null ? "– (gap)" : si(dz)}` : "…"}`,
      `P-V ${sign}${si(model.get("pv"))}`,
      `Sq ${sign}${si(model.get("sq"))}`,
    ];
    read.textContent = pointed || parts.join("   ");
    read.classList.toggle("preview", Boolean(model.get("is_preview")));
  }

  function update() {
    words.textContent = model.get("message") ?? "";
    const x = typed(model.get("distance"), Float64Array);
    own = x ? [Array.from(x), gapped(typed(model.get("low"), Float32Array)), gapped(typed(model.get("high"), Float32Array))] : [[], [], []];
    const shown = others();
    const curves = Array.from({ length: MOST }, (_, k) => shown.find((one) => one.index % MOST === k)?.curve);
    if (!shown.length) plot.put([...own, ...curves.flatMap(() => [own[0].map(() => null), own[0].map(() => null)])]);
    else plot.put(joined([own, ...curves.map((one) => one ?? NOTHING)]));
    names.replaceChildren(...(model.get("others") ?? []).map(nameOf));
    follow();
    tell();
  }

  /** A name that shows and hides its curve. */
  function nameOf(/** @type {{ name: string, index: number }} */ one) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = one.name;
    button.style.setProperty("--own", `var(--curve-${one.index % MOST})`);
    button.setAttribute("aria-pressed", String(!hidden.has(one.name)));
    button.addEventListener("click", () => {
      if (!hidden.delete(one.name)) hidden.add(one.name);
      update();
      /** @type {HTMLElement | undefined} */ ([...names.children].find((el_) => el_.textContent === one.name))?.focus();
    });
    return button;
  }

  model.on("change:distance change:message change:others", update);
  model.on("change:cursors", () => {
    shown = model.get("cursors");
    follow();
    tell();
  });
  update();
  return () => plot.destroy();
}

export default { render };
