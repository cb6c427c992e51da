// @ts-check
// The present result beside another: values with U of their difference, what differs, the picture.

import { inTarget } from "./exports.js";
import { makeBrowser } from "./browser.js";
import { makeDifference } from "./difference.js";
import { askForm } from "./dialogs.js";
import { si } from "./format.js";
import { VERDICTS } from "./metrics.js";
import { Superseded } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

function tag(/** @type {string} */ name, /** @type {Dict} */ properties = {}, /** @type {(Node | string)[]} */ ...children) {
  const made = /** @type {any} */ (Object.assign(document.createElement(name), properties));
  made.append(...children);
  return made;
}

/** One place that says what a difference looks like. */
function stateOf(/** @type {Dict} */ row) {
  if (row.exceeds === true) return { sign: "▲", word: "larger than U", className: "reject", order: 0 };
  if (row.message && row.difference === null && row.value_a === null && row.value_b === null) return { sign: "–", word: row.message, className: "", order: 3 }; // a picture, below the numbers
  if (row.message && row.difference === null) return { sign: "!", word: row.message, className: "inconclusive", order: 1 };
  if (row.exceeds === false) return { sign: "✓", word: "within U", className: "accept", order: 4 };
  if (row.difference === 0) return { sign: "=", word: "the same", className: "", order: 5 };
  if (row.difference === null) return { sign: "–", word: "not known", className: "", order: 3 };
  return { sign: "≠", word: "U not known", className: "", order: 2 };
}

const signed = (/** @type {number | null} */ value, /** @type {string} */ unit) =>
  (value !== null && value > 0 ? `+${si(value, unit)}` : si(value, unit));

/** @param {import("./tabs.js").Context} context @returns {import("./tabs.js").Tab} */
export function make({ el, wire, session, fail }) {
  /** @type {string[]} */
  let pins = [];
  /** @type {Dict | null} */
  let against = null;
  /** @type {Dict | null} */
  let found = null;
  let of = "";
  let sorted = "state";
  let count = 0;

  const button = (/** @type {string} */ id, /** @type {string} */ text, /** @type {() => void} */ act, className = "") => {
    const made = tag("button", { type: "button", id, textContent: text, className });
    made.addEventListener("click", act);
    return made;
  };
  const choice = tag("select", { id: "compare-with", title: "What the present result is compared with" });
  choice.setAttribute("aria-label", "Compare with");
  choice.addEventListener("change", () => choose(choice.value));
  const remove = button("compare-unpin", "Unpin", unpin, "small");
  const words = tag("span", { className: "soft" });
  words.setAttribute("role", "status");
  const bar = tag("div", { className: "compare-bar" }, button("compare-pin", "Pin the present result…", pin, "main"),
    tag("label", { className: "check" }, "compare with", choice), remove, words);
  const table = tag("div", { className: "scroll compare-rows", tabIndex: -1 });
  const picture = tag("div", { className: "compare-picture" });
  el.replaceChildren(bar, tag("div", { className: "compare-split" }, table, picture));
  const difference = makeDifference(picture, wire, fail);

  async function pin() {
    count += 1;
    const given = await askForm({
      title: "Pin the present result", ok: "Pin",
      text: "It is kept until metrosep ends, whatever the recipe does next.",
      fields: [{ name: "label", label: "Name", value: `${(session().undo_label ?? "first").slice(0, 48)} (${count})` }],
    });
    if (!given?.label) return;
    words.textContent = "full resolution…";
    try {
      const { header } = await wire.ask("compare", { pin: given.label }, "compare pin");
      pins = header.pins;
      against = { pin: given.label };
      of = "";
      drawChoice();
      show();
    } catch (error) {
      words.textContent = "";
      fail(error);
    }
  }

  async function unpin() {
    if (!against?.pin) return;
    try {
      const { header } = await wire.ask("compare", { unpin: against.pin }, "compare pin");
      pins = header.pins;
      against = null;
      [found, of] = [null, ""];
      difference.put(null, {}, null);
      drawChoice();
      draw();
    } catch (error) {
      fail(error);
    }
  }

  async function choose(/** @type {string} */ value) {
    if (value.startsWith("pin ")) against = { pin: value.slice(4) };
    else if (value === "result" || value === "files") {
      const isResult = value === "result";
      const put = (/** @type {string[]} */ paths, /** @type {boolean} */ isChosen) => {
        /** @type {HTMLInputElement} */ (document.querySelector("dialog input[name=path]")).value = paths.join("; ");
        if (isChosen) /** @type {HTMLElement} */ (document.querySelector("dialog [value=yes]")).click();
      };
      const given = await askForm({
        title: isResult ? "Compare with a stored result" : "Compare with another file by the same recipe", ok: "Compare",
        text: isResult ? "A result.json, inside the folders that were opened." : "It is evaluated by the present recipe. For several runs of a set write their names one after another, separated by semicolons.",
        extra: [makeBrowser(wire, put)],
        fields: [{ name: "path", label: isResult ? "result.json" : "File", value: inTarget(session(), "") }],
      });
      if (given?.path) against = isResult ? { result: given.path } : { files: given.path.split(";").map((one) => one.trim()).filter(Boolean) };
    }
    of = "";
    drawChoice();
    show();
  }

  function drawChoice() {
    const named = against?.result ?? against?.files?.join("; ");
    choice.replaceChildren(
      new Option(pins.length ? "choose…" : "nothing yet", ""), ...pins.map((label) => new Option(label, `pin ${label}`)),
      ...(named ? [new Option(named.split(/[\\/]/).slice(-2).join("/"), "now")] : []),
      new Option("a stored result…", "result"), ...(session().files?.length ? [new Option("another file by this recipe…", "files")] : []));
    choice.value = against?.pin ? `pin ${against.pin}` : named ? "now" : "";
    remove.disabled = !against?.pin;
  }

  async function show() {
    drawChoice();
    if (!against || of === session().hash) {
      if (!against) draw();
      return;
    }
    const wanted = session().hash;
    const mine = against;
    words.textContent = "full resolution…";
    table.classList.add("outdated");
    picture.classList.add("outdated");
    try {
      const { header, arrays } = await wire.ask("compare", { against });
      if (mine !== against || session().hash !== wanted) return;
      [found, of] = [header, wanted];
      pins = header.pins;
      words.textContent = "";
      table.classList.remove("outdated");
      picture.classList.remove("outdated");
      draw();
      difference.put(header, arrays, against);
      el.dataset.of = wanted;
    } catch (error) {
      if (error instanceof Superseded || mine !== against) return;
      words.textContent = "";
      against = null;
      drawChoice();
      fail(error);
    }
  }

  function draw() {
    if (!found) {
      table.replaceChildren(tag("p", { className: "ranking-words soft", textContent:
        "Pin the present result, change the recipe, and see what the change does. Or compare with a stored result, or with another file by the same recipe." }));
      return;
    }
    const [a, b] = found.names;
    const columns = /** @type {[string, string, string][]} */ ([
      ["metric", "value", ""], ["value_a", a, "The other result"], ["value_b", b, "The present result"],
      ["difference", "difference", `${b} minus ${a}`], ["U", "U", "Expanded uncertainty of the difference, root sum of squares of both; for independent measurements"],
      ["state", "", "Differences larger than U first"],
    ]);
    const head = tag("tr");
    for (const [key, label, title] of columns) {
      const by = tag("button", { type: "button", className: "icon", textContent: label || "against U", title: `${title}\nClick: sort` });
      by.dataset.sort = key;
      by.addEventListener("click", () => {
        sorted = key;
        draw();
        /** @type {HTMLElement | null} */ (table.querySelector(`[data-sort="${key}"]`))?.focus();
      });
      const th = tag("th", { scope: "col", className: ["metric", "state"].includes(key) ? "" : "number" }, by);
      if (sorted === key) th.setAttribute("aria-sort", key === "metric" || key === "state" ? "ascending" : "descending");
      head.append(th);
    }
    const size = (/** @type {Dict} */ row) => (row[sorted] === null ? -Infinity : Math.abs(row[sorted]));
    const rows = found.rows.map((/** @type {Dict} */ row, /** @type {number} */ i) => ({ ...row, i }));
    rows.sort((/** @type {Dict} */ x, /** @type {Dict} */ y) => (sorted === "metric" ? (x.metric < y.metric ? -1 : x.metric > y.metric ? 1 : 0)
      : sorted === "state" ? stateOf(x).order - stateOf(y).order : size(y) - size(x)) || x.i - y.i);
    const body = tag("tbody");
    for (const row of rows) {
      const state = stateOf(row);
      const verdict = (/** @type {string | null} */ one) => {
        const known = one ? VERDICTS[one] : null;
        return known ? [" ", tag("span", { className: one, textContent: known.sign, title: known.word, ariaLabel: known.word })] : [];
      };
      const tr = tag("tr", {},
        tag("td", {}, row.metric, ...(row.name && row.name !== row.metric ? [tag("small", { textContent: row.name, title: row.name })] : [])),
        tag("td", { className: "number" }, si(row.value_a, row.unit), ...verdict(row.verdict_a)),
        tag("td", { className: "number" }, si(row.value_b, row.unit), ...verdict(row.verdict_b)),
        tag("td", { className: "number", textContent: row.value_a === null && row.value_b === null ? si(row.difference, row.unit) : signed(row.difference, row.unit) }),
        tag("td", { className: "number", textContent: si(row.U, row.unit, 2) }),
        tag("td", { className: `state ${state.className}` }, tag("b", { textContent: state.sign, ariaHidden: "true" }), ` ${state.word}`));
      tr.dataset.metric = row.metric;
      if (row.exceeds) tr.className = "exceeds";
      body.append(tr);
    }
    const made = tag("table", { className: "ranking compare" }, tag("thead", {}, head), body);
    made.setAttribute("aria-label", "Both results");
    table.replaceChildren(made, ...lists());
  }

  function lists() {
    const out = [];
    const { recipe = [], inputs = [], versions = [], other = [], messages = [] } = found ?? {};
    if (messages.length) out.push(tag("p", { className: "ranking-words", textContent: messages.join("\n") }));
    if (recipe.length) {
      const text = tag("pre", { className: "diff" });
      for (const line of recipe.slice(2)) {
        const kind = line.startsWith("+") ? "added" : line.startsWith("-") ? "removed" : line.startsWith("@@") ? "place" : "";
        text.append(tag("span", { className: kind, textContent: `${line}\n` }));
      }
      out.push(tag("h2", { textContent: `Recipe: − ${found?.names[0]}, + ${found?.names[1]}` }), text);
    } else {
      out.push(tag("p", { className: "ranking-words soft", textContent: "The recipes are the same." }));
    }
    for (const [title, lines] of [["Input", inputs], ["Versions", versions], ["Beside", other]]) {
      if (!lines.length) continue;
      out.push(tag("details", {}, tag("summary", { textContent: `${title}: ${lines.length === 1 ? "1 difference" : `${lines.length} differences`}` }),
        ...lines.map((/** @type {string} */ text) => tag("p", { textContent: text }))));
    }
    return out;
  }

  return {
    show,
    changed(next, isNewFile) {
      if (of !== next.hash) {
        table.classList.toggle("outdated", found !== null);
        picture.classList.toggle("outdated", found !== null);
        el.dataset.of = "";
      }
      if (!isNewFile) return;
      [found, of, against] = [null, "", null];
      difference.put(null, {}, null);
      table.classList.remove("outdated");
      wire.ask("compare", {}, "compare pins").then(({ header }) => {
        pins = header.pins;
        drawChoice();
      }).catch(() => {}); // nothing is open yet
    },
    news(news) {
      if (words.textContent && news.k === "progress" && news.words) words.textContent = `${news.words}…`;
    },
  };
}
