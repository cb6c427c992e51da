// @ts-check
// The workbench: one session of the server, shown. What the user does becomes an edit of the recipe;
// what is shown comes from the library.

import { makeBrowser } from "./browser.js";
import { COLOUR_NAMES } from "./colours.js";
import { alertText, askFile, clearAlerts, showHelp, showText } from "./dialogs.js";
import { makeDrawing } from "./drawing.js";
import { takeMenus } from "./editor.js";
import { makeExports } from "./exports.js";
import { listenToDrops, openPaths, uploadAll } from "./files.js";
import { makeFollow } from "./follow.js";
import { makeHeadline } from "./headline.js";
import { makeHistory } from "./history.js";
import { KEYS, listenToKeys } from "./keys.js";
import { makeLadder } from "./ladder.js";
import { mendButtons, scaleLine } from "./mends.js";
import { makeMetrics } from "./metrics.js";
import { grooveOf } from "./profile.js";
import { makeLengths, makeMemory } from "./remember.js";
import { written } from "./shapes.js";
import { make as makeCompare } from "./tab_compare.js";
import { make as makeFolder } from "./tab_folder.js";
import { make as makeMachine } from "./tab_machine.js";
import { make as makeRanking } from "./tab_ranking.js";
import { make as makeReport } from "./tab_report.js";
import { make as makeRuns } from "./tab_runs.js";
import { make as makeTable } from "./tab_table.js";
import { makePending } from "./pending.js";
import { makeSplits } from "./splits.js";
import { makeTabs } from "./tabs.js";
import { makeTree } from "./tree.js";
import { makeViews } from "./views.js";
import { lostWords, Refusal, Superseded, Wire } from "./wire.js";

/** @typedef {Record<string, any>} Dict */

const el = (/** @type {string} */ id) => /** @type {any} */ (document.getElementById(id));

// The token moves from the address to this tab, so that it is in no history and no picture.
const address = new URL(location.href);
const token = address.searchParams.get("token") ?? sessionStorage.getItem("token") ?? "";
sessionStorage.setItem("token", token);
if (address.searchParams.has("token")) history.replaceState(null, "", "/");

/** @type {Dict} */
let session = { recipe: null, steps: [], files: [], kind: null, messages: [] };
let [schema, version, notes, started] = [/** @type {Dict[]} */ ([]), "", /** @type {string[]} */ ([]), 0];

const wire = new Wire(`ws://${location.host}/ws?token=${encodeURIComponent(token)}`);
const ladder = makeLadder(show, stop);
const { drawSession, drawStage, drawFull, drawSaved, drawMessages } = makeHeadline({ session: () => session, stage: () => tree.chosen, notes: () => notes });
const memory = makeMemory({ wire, session: () => session });
const metrics = makeMetrics(el("metrics"), el("verdict"), edit);
const tree = makeTree(el("steps"), {
  edit,
  choose() {
    views.newRange();
    drawStage();
    views.profile.put({ groove: grooveOf(session.steps, tree.chosen) });
    views.show();
  },
  size: () => views.size(),
  middle: () => views.middle(),
});
const views = makeViews({
  wire, level: () => ladder.level, stage: () => tree.chosen, kind: () => session.kind ?? "none", failed: fail,
  judged: () => shownStep()?.op === "psd", shown: memory.put, learn: (header) => drawing.learn(header), reached: drawStage, lines: () => drawing.lines(),
  insert: (step, label) => tree.insert(step, label),
  grooved: ({ index, ...lengths }) => edit(Object.entries(lengths).map(([key, value]) => ({ path: ["step", index, key], old: session.steps[index].keys[key], new: written(value) })), "move the groove"),
});
const drawing = makeDrawing({
  el: el("map"), bar: el("tools"), list: el("shapes"), session: () => session, edit, insert: tree.insert, say: alertText,
  place: (request) => wire.ask("places", { stage: tree.chosen, level: ladder.level, ...request }).then(({ header }) => header, fail),
  shown: (a, b) => (views.map.set("a", a), views.map.set("b", b), views.map.save_changes()),
});

const pending = makePending(edit, () => session.hash, alertText);
const { save, exportResult } = makeExports({ wire, status: el("status-link"), session: () => session, take, fail });

const follow = makeFollow(el("follow"), wire, (paths) => open(paths, true, false), fail);

el("no-scale").append(scaleLine(edit, () => session, () => {
  const [a, b] = [views.map.get("a"), views.map.get("b")];
  return a && b ? Math.hypot(b[0] - a[0], b[1] - a[1]) : 0;
}, (given) => wire.ask("scale", given).then(({ header }) => header, fail)));
views.map.on("change:unit", () => {
  el("no-scale").hidden = views.map.get("unit") !== "px";
  document.body.classList.toggle("unscaled", !el("no-scale").hidden);
});

const isOf = (/** @type {string[]} */ ...kinds) => (/** @type {Dict} */ one) => kinds.includes(one.kind);
const tabs = makeTabs(el("tabs"), [
  { id: "view", label: (one) => (one.kind === "map" ? "Map" : "Profile"), fits: isOf("map", "profile"), make: null },
  { id: "runs", label: () => "Runs", fits: isOf("runs"), make: makeRuns },
  { id: "ranking", label: () => "Ranking", fits: (one) => one.kind === "method" && one.op === "rank", make: makeRanking },
  { id: "machine", label: (one) => (["calibrate", "circle", "thermal", "iso230_7"].includes(one.op) ? "Machine" : "Pictures"), fits: (one) => one.kind === "method" && one.op !== "rank", make: makeMachine },
  { id: "table", label: () => "Table", fits: isOf("runs"), make: makeTable },
  { id: "report", label: () => "Report", fits: () => true, make: makeReport },
  { id: "compare", label: () => "Compare", fits: () => true, make: makeCompare },
  { id: "folder", label: () => "Run on folder", fits: isOf("map", "profile", "runs"), make: makeFolder },
], {
  wire, session: () => session, schema: () => schema, edit, fail, open, shown: memory.put,
  written(text, files = []) {
    el("status-link").textContent = text;
    el("status-link").title = files.join("\n");
  },
});

const splits = makeSplits(document.querySelectorAll("[data-split]"));

/** What is looked at, and the way back to it. */
const seen = makeHistory(() => {
  const view = session.kind ? views.looked() : null;
  return view && { tab: tabs.chosen, stage: tree.chosen, splits: splits.get(), view, own: tabs.looked() };
}, ({ tab, stage, view, own, splits: was }) => {
  splits.put(was);
  tree.go(stage);
  drawStage();
  if (tab !== tabs.chosen) tabs.choose(tab);
  tabs.look(own);
  views.look(view);
});

function fail(/** @type {unknown} */ error) {
  if (error instanceof Superseded) return; // a newer wish took its place
  const mends = error instanceof Refusal ? error.mends : [];
  alertText(error instanceof Error ? error.message : String(error), mends.length ? mendButtons(mends, edit, clearAlerts) : null);
  if (!(error instanceof Refusal)) console.error(error);
}

// ---- what is shown -----------------------------------------------------------------------------

async function show(/** @type {import("./ladder.js").Level} */ level) {
  if (!session.kind) return;
  if (level === "full") {
    await full();
  } else {
    await views.show(level); // the picture first
    await askMetrics(level).catch(fail);
  }
}

function stop() {
  wire.cancel("metrics full");
}

async function full() {
  const of = session.hash;
  started = performance.now();
  drawFull("busy", "full resolution…");
  try {
    const header = await askMetrics("full");
    if (!header) return;
    ladder.reached();
    if (header.failed) drawFull("stopped", `stopped at step ${header.failed.index + 1}`);
    else drawFull("done", `full resolution, ${((performance.now() - started) / 1000).toFixed(1)}\u2009s`);
    document.body.dataset.full = of;
    views.show("full");
    tabs.reached(header);
  } catch (error) {
    if (!(error instanceof Superseded)) drawFull("", "full resolution failed");
    if (error instanceof Refusal && tabs.chosen === "runs") return; // the runs say it where they are
    fail(error);
  }
}

async function askMetrics(/** @type {import("./ladder.js").Level} */ level) {
  const of = session.hash;
  let header;
  try {
    ({ header } = await wire.ask("metrics", { level }, level === "full" ? "metrics full" : "metrics"));
  } catch (error) {
    if (!(error instanceof Refusal)) throw error;
    // What the numbers refuse, their own panel says, and the tabs say what is theirs: no alert above both.
    if (session.hash === of) metrics.put({ rows: [], refused: error.message, mends: error.mends, elsewhere: session.kind === "runs", is_preview: false });
    if (session.hash === of && level === "full") drawFull("", "full resolution failed");
    return null;
  }
  if (session.hash !== of || header.hash !== of) return null; // of another recipe, or another file
  if (level !== "full" && ladder.level === "full") return null;
  metrics.put(header);
  drawing.learn(header);
  const said = new Map((header.stages ?? []).map((/** @type {Dict} */ stage) => [stage.index, stage.messages]));
  tree.tell(header.failed ?? null, said);
  notes = [...(header.refused ? [header.refused] : []), ...(header.failed ? [`step ${header.failed.index + 1}: ${header.failed.message}`] : []), ...(header.messages ?? [])];
  drawMessages();
  return header;
}

function take(/** @type {Dict} */ next, isNewFile = false) {
  const changed = next.hash !== session.hash || isNewFile;
  const rescaled = !isNewFile && session.input?.lateral_step !== next.input?.lateral_step;
  session = next;
  document.body.dataset.kind = session.kind ?? "none";
  if (isNewFile) {
    const view = session.view ?? {};
    tree.reset();
    drawing.reset();
    memory.begin(view);
    views.reset(view);
    el("shade").checked = view.hill_shade ?? el("shade").checked;
    el("colours").value = views.map.get("colours");
    notes = [];
    seen.reset();
    follow.stop();
  }
  if (rescaled) { // places in px are no places in m
    views.reset(session.view ?? {});
    drawing.reset();
    seen.reset();
  }
  follow.allow(["map", "profile"].includes(session.kind ?? "") && session.files?.length === 1);
  drawSession();
  tree.show(session, schema);
  drawing.show();
  views.profile.put({ groove: grooveOf(session.steps, tree.chosen) });
  if (changed) metrics.stale();
  metrics.show(session);
  if (!changed || isNewFile) drawStage(); // else with the picture: until then it is the one before
  tabs.changed(isNewFile, isNewFile ? session.view?.tab : undefined);
  if (!changed || !session.kind) return;
  drawFull("busy", "full resolution…"); // as the verdict waits for it
  ladder.climb();
}

/** The step that is shown; of all steps the last that is carried out. */
const shownStep = () => (session.steps ?? [])[tree.chosen] ?? (tree.chosen === -1 ? session.steps?.findLast((/** @type {Dict} */ one) => one.enabled) : undefined);

// ---- what is done ------------------------------------------------------------------------------

async function edit(/** @type {import("./recipe.js").Edit[]} */ edits, /** @type {string} */ label, isAgain = false) {
  if (!edits.length) return;
  const of = session.hash;
  try {
    // Edits never replace each other: each has its own slot.
    const { header } = await wire.ask("edit", { edits, label }, `edit ${wire.next}`);
    clearAlerts();
    take(header.session);
  } catch (error) {
    failUnmade(error, !isAgain && pending.keep(error, edits, label, of) ? "this change was not made, and is sent again when the connection is back" : undefined);
    tree.show(session, schema); // what was typed and refused goes back
    metrics.show(session);
  }
}

async function again(/** @type {"undo" | "redo"} */ which) {
  if (!session[`can_${which}`]) return;
  try {
    const { header } = await wire.ask(which, {}, `${which} ${wire.next}`);
    clearAlerts();
    take(header.session);
  } catch (error) {
    failUnmade(error);
  }
}

/** A change is never replaced by a newer one: without a connection it was not made. */
function failUnmade(/** @type {unknown} */ error, what = "this change was not made") {
  if (error instanceof Superseded) alertText(`${what}: ${error.message}`);
  else fail(error);
}

async function open(/** @type {string[]} */ paths, keep = false, asks = true) {
  drawFull("busy", "reading…");
  try {
    const answer = await openPaths(wire, paths, {}, keep, asks);
    drawFull("", "");
    if (!answer) return;
    clearAlerts();
    take(answer.header.session, true);
  } catch (error) {
    drawFull("", "");
    failUnmade(error, "the file was not opened");
  }
}

async function receive(/** @type {File[]} */ files, keep = false) {
  try {
    const paths = await uploadAll(files, token, (name) => drawFull("busy", `taking ${name}…`));
    await open(paths, keep);
  } catch (error) {
    drawFull("", "");
    fail(error);
  }
}

async function choose() {
  const browse = (/** @type {(paths: string[], open: boolean) => void} */ chosen) => makeBrowser(wire, chosen);
  const given = await askFile(session.home ?? "", Boolean(session.kind) && session.kind !== "method", browse);
  if (given?.files?.length) receive(given.files, given.keep);
  else if (given?.paths?.length) open(given.paths, given.keep);
}

async function hello() {
  try {
    const { header } = await wire.ask("hello");
    schema = header.schema.steps;
    takeMenus(header.menus);
    version = header.version;
    const other = String(header.session.files) !== String(session.files);
    take(header.session, other);
    pending.again();
  } catch (error) {
    fail(error);
  }
}

// ---- wiring ------------------------------------------------------------------------------------

wire.onState = (connected) => {
  const link = el("status-link");
  link.className = connected ? "" : "lost";
  link.textContent = connected ? "" : lostWords(wire.tries);
  if (connected) hello();
};
wire.onNews = (header) => {
  if (header.ok === false) {
    // The first file may not say its unit: its name begins the message and lies in the first folder.
    if (header.error.ask) open(header.paths ?? [header.error.ask.path]);
    else alertText(header.error.message);
  } else if (header.k === "session") {
    if (header.session.hash !== session.hash) clearAlerts(); // another page put right what this one said
    take(header.session, String(header.session.files) !== String(session.files));
  } else if (header.k === "saved") {
    session = { ...session, saved_at: header.saved_at, keeping: header.keeping, messages: header.messages };
    drawSaved();
    drawMessages();
  } else {
    const asked = wire.open.get(header.of)?.kind; // what the server works on
    if (header.text && asked === "metrics") drawFull("busy", header.text);
    if (header.text && asked === "export") el("status-link").textContent = `${header.text}…`;
    tabs.news(header);
  }
};
document.addEventListener("visibilitychange", () => {
  if (!document.hidden && wire.connected) hello(); // another tab may have edited
});

for (const name of COLOUR_NAMES) el("colours").add(new Option(name, name, false, name === views.map.get("colours")));
el("colours").addEventListener("change", () => views.colours(el("colours").value));
el("shade").addEventListener("change", () => views.shade(el("shade").checked));
const acts = {
  open: choose, "open-empty": choose, undo: () => again("undo"), redo: () => again("redo"), save, export: exportResult,
  recipe: () => showText("Recipe", session.recipe ?? ""), help: () => showHelp(KEYS, version),
  fit: () => views.fit(), "profile-fit": () => views.fit(),
  messages: () => showText("Messages", [...(session.messages ?? []), ...notes].join("\n\n")),
  "section-add": () => (/** @type {HTMLElement} */ (document.querySelector("#parts button")).click(), drawing.addLine()), // a narrow page shows the picture first
};
for (const [id, act] of Object.entries(acts)) el(id).addEventListener("click", act);
listenToKeys({
  z: acts.undo, "shift+z": acts.redo, "alt+arrowleft": seen.back, "alt+arrowright": seen.forward, "?": acts.help, o: choose, s: save, e: exportResult, f: acts.fit,
  h: () => el("shade").click(), r: () => session.kind && tabs.choose("report"), v: () => el("relief-on").click(), ...drawing.acts,
}, (panel) => {
  const profile = session.kind === "profile";
  const shown = tabs.chosen === "view" ? [profile ? "panel-profile" : "panel-map", profile ? "panel-profile" : "panel-section", "panel-spectrum"]
    : [`panel-${tabs.chosen}`, `panel-${tabs.chosen}`, `panel-${tabs.chosen}`];
  el(["panel-steps", ...shown, "panel-metrics", "status"][panel - 1])?.focus();
}, (event) => session.kind === "map" && tabs.chosen === "view" && drawing.key(event));
listenToDrops((files) => receive(files));
setInterval(drawSaved, 5000), makeLengths(el("lengths")), wire.connect();
