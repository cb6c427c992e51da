// @ts-check
// Numbers for people: SI prefixes, a thin space before the unit, a point as decimal sign. Nothing
// here asks the locale of the browser: 1000 is never "1,000".

const THIN = "\u2009";
const MINUS = "\u2212";
const SUPER = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/** Units that take a prefix. */
const SCALED = new Set(["m", "rad", "s", "Hz", "V", "m/s", "N", "px", "m/K", "rad/K"]);
/** @type {[number, string][]} */
const PREFIXES = [
  [1e-15, "f"], [1e-12, "p"], [1e-9, "n"], [1e-6, "µ"], [1e-3, "m"], [1, ""], [1e3, "k"], [1e6, "M"],
];

/** Whether lengths are read in inches; what is stored stays as it was typed. */
let inches = false;
/** @param {boolean} is */
export const setInches = (is) => void (inches = is);
export const inInches = () => inches;

/**
 * Return a plain number with a real minus sign.
 * @param {string} text
 */
function signed(text) {
  return text.replace(/^-/, MINUS);
}

/**
 * Return digits of a number without a unit.
 * @param {number} value
 * @param {number} [digits] significant ones
 * @returns {string}
 */
export function plain(value, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e-3 && size < 1e6) {
    const text = value.toPrecision(digits);
    return signed(text.includes("e") ? String(Number(text)) : text);
  }
  const [mantissa, power] = value.toExponential(digits - 1).split("e");
  const raised = power.replace("+", "").replace(/\d/g, (d) => SUPER[Number(d)]).replace("-", "⁻");
  return `${signed(mantissa)}${THIN}×${THIN}10${raised}`;
}

/**
 * Return the factor and name of the prefix that suits a size.
 * @param {number} size
 * @param {string} unit
 * @returns {[number, string]}
 */
export function scaleFor(size, unit) {
  if (unit === "px" || !SCALED.has(unit)) return [1, unit];
  const value = Math.abs(size);
  if (inches && unit === "m") return value >= 25.4e-6 ? [25.4e-3, "in"] : value >= 25.4e-11 || !value ? [25.4e-9, "µin"] : [25.4e-12, "nin"];
  if (!(value > 0) || !Number.isFinite(value)) return [1, unit];
  let found = PREFIXES[0];
  for (const entry of PREFIXES) if (value * (1 + 5e-5) >= entry[0]) found = entry;
  if (unit === "rad" && found[0] > 1) found = [1, ""];
  return [found[0], found[1] + unit];
}

/**
 * Return a value with its unit, such as "9.130 nm".
 * @param {number | null | undefined} value
 * @param {string} [unit]
 * @param {number} [digits]
 * @returns {string}
 */
export function si(value, unit = "m", digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return unit === "1" || unit === "" ? "0" : `0${THIN}${scaleFor(0, unit)[1]}`;
  if ((unit === "1" || unit === "") && Number.isInteger(value) && Math.abs(value) < 1e6) return signed(String(value)); // a count
  const [factor, name] = scaleFor(value, unit);
  const text = plain(value / factor, digits);
  return name === "1" || name === "" ? text : `${text}${THIN}${powers(name)}`;
}

/**
 * Return a unit with raised powers: m^2 becomes m².
 * @param {string} unit
 */
export function powers(unit) {
  return unit.replace(/\^(-?\d+)/g, (_, n) => n.replace(/\d/g, (/** @type {string} */ d) => SUPER[Number(d)]).replace("-", "⁻"));
}

/** @param {string} unit */
export const baseOf = (unit) => (inches && unit === "m" ? 25.4e-3 : 1);

/** Return the power of ten below a size, of inches where these are read. @param {number} raw @param {string} unit */
export function powerBelow(raw, unit) {
  return baseOf(unit) * 10 ** Math.floor(Math.log10(raw / baseOf(unit)));
}

/** Return round places between two. @param {number} low @param {number} high @param {number} least apart @param {string} unit */
export function places(low, high, least, unit) {
  const power = powerBelow(least, unit);
  const step = ([1, 2, 5].find((n) => n * power >= least * (1 - 1e-9)) ?? 10) * power;
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.max(0, Math.floor(high / step + 1e-9) - first + 1) }, (_, i) => (first + i) * step);
}

/**
 * Return labels of ticks, one unit for the axis if all are near each other.
 * @param {(number | null)[]} splits
 * @param {number} factor
 * @returns {string[]}
 */
export function ticks(splits, factor) {
  const values = splits.map((v) => (v === null ? NaN : v / factor));
  const finite = values.filter(Number.isFinite);
  const gap = finite.length > 1 ? Math.abs(finite[1] - finite[0]) : 1;
  // as many decimals as the gap itself needs: 2.5 needs one, though it is above 1
  let decimals = Math.max(0, Math.min(6, -Math.floor(Math.log10(gap || 1) + 1e-9)));
  while (decimals < 6 && Math.abs(Number(gap.toFixed(decimals)) - gap) > 1e-3 * gap) decimals += 1;
  return values.map((v) => (Number.isFinite(v) ? signed((Math.abs(v) < gap * 1e-6 ? 0 : v).toFixed(decimals)) : ""));
}

/**
 * Return the label of a tick of a logarithmic axis: "50 µm".
 * @param {number | null} value
 * @param {string} [unit]
 */
export function logTick(value, unit = "m") {
  if (value === null || !(value > 0)) return "";
  const [factor, name] = scaleFor(value, unit);
  return `${signed(String(Number((value / factor).toPrecision(3))))}${THIN}${name}`;
}

/**
 * Return how long ago a moment was.
 * @param {number | null | undefined} seconds since 1970
 */
export function ago(seconds) {
  if (!seconds) return "not yet saved";
  const passed = Math.max(0, Date.now() / 1000 - seconds);
  if (passed < 60) return `saved ${Math.round(passed)}${THIN}s ago`;
  if (passed < 3600) return `saved ${Math.round(passed / 60)}${THIN}min ago`;
  return `saved ${Math.round(passed / 3600)}${THIN}h ago`;
}

/**
 * Return the words for what was measured in one pixel column.
 * @param {number | null | undefined} low
 * @param {number | null | undefined} high
 * @returns {string}
 */
export function spanned(low, high) {
  if (!Number.isFinite(low)) return "not measured";
  return Number(high) > Number(low) ? `${si(low)} to ${si(high)}` : si(low);
}
