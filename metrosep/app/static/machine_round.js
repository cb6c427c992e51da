// @ts-check
// Curves over a whole turn about a circle: the motion of a spindle, the readings of a ballbar.

import { si } from "./format.js";
import { ink } from "./plots.js";
import { ringed } from "./polar.js";

/** Dashes of the curves, by their number. */
export const DASHES = ["", "7 4", "2 3", "10 3 2 3", "14 4", "5 2 1 2"];
const ROUND = 380;

/**
 * Return curves over a whole turn about a circle. A band has two curves, and dashed circles stand at deviations.
 * @param {{ angle: number[], z: (number | null)[], thin?: boolean }[]} curves thin ones in the colour of a band
 * @param {string} unit
 * @param {string} what
 * @param {{ band?: { angle: number[], z: number[] }[], circles?: number[], most?: number }} [more] most: of all that are enlarged alike
 */
export function roundOf(curves, unit, what, { band = [], circles = [], most = 0 } = {}) {
  const values = [...curves, ...band].flatMap((one) => one.z.filter((v) => v !== null).map((v) => Math.abs(Number(v))));
  most ||= Math.max(...values) || 1;
  const ratio = window.devicePixelRatio || 1;
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: ROUND * ratio, height: ROUND * ratio, className: "machine-round" });
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${what} about a circle, largest deviation ${si(most, unit)}`);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const [centre, r] = [/** @type {[number, number]} */ ([ROUND / 2 - 6, ROUND / 2 + 6]), 0.29 * ROUND];

  function paint() {
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, ROUND, ROUND);
    const at = ringed(context, centre, r, `+${si(most, unit)}`, most, "0°");
    /** Lines over a turn, with a gap where ten usual steps are missing. @param {{ angle: number[], z: (number | null)[] }} one */
    const along = ({ angle, z }) => {
      const n = angle.length;
      const steps = angle.map((a, i) => (angle[(i + 1) % n] - a + 2 * Math.PI) % (2 * Math.PI));
      const usual = [...steps].sort((p, q) => p - q)[Math.floor(n / 2)];
      let joined = false;
      for (let k = 0; k <= n; k += 1) {
        const v = z[k % n];
        joined &&= v !== null && steps[k - 1] <= 10 * usual;
        if (v === null) continue;
        context[joined ? "lineTo" : "moveTo"](...at(angle[k % n], v));
        joined = true;
      }
    };
    context.fillStyle = context.strokeStyle = ink("--faint");
    context.globalAlpha = 0.35;
    context.beginPath();
    band.forEach(along);
    context.fill("evenodd");
    context.globalAlpha = 1;
    for (const z of circles) {
      context.setLineDash([5, 4]);
      context.beginPath();
      context.arc(...centre, Math.abs(at(0, z)[0] - centre[0]), 0, 2 * Math.PI);
      context.stroke();
    }
    const named = curves.filter((one) => !one.thin);
    for (const one of curves) {
      const k = named.indexOf(one);
      context.strokeStyle = ink(one.thin ? "--faint" : `--feed-${k % 6}`);
      context.lineWidth = one.thin ? 0.6 : 1.6;
      context.setLineDash(one.thin ? [] : DASHES[k % DASHES.length].split(" ").filter(Boolean).map(Number));
      context.beginPath();
      along(one);
      context.stroke();
    }
    context.setLineDash([]);
  }

  requestAnimationFrame(paint);
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  scheme.addEventListener("change", function again() {
    if (canvas.isConnected) paint();
    else scheme.removeEventListener("change", again);
  });
  return canvas;
}
