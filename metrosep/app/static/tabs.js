// @ts-check
// The tabs of the right side: the pictures of what is open, and what else can be done with it.

/** @typedef {Record<string, any>} Dict */

/**
 * @typedef {object} Context what a tab gets
 * @property {HTMLElement} el its panel
 * @property {import("./wire.js").Wire} wire
 * @property {() => Dict} session
 * @property {() => Dict[]} schema
 * @property {(edits: import("./recipe.js").Edit[], label: string) => Promise<void>} edit
 * @property {(error: unknown) => void} fail
 * @property {(text: string, files?: string[]) => void} written tells of files in the status line
 * @property {(paths: string[], keep?: boolean) => void} open other files, with the present recipe or their own
 * @property {(view: Dict) => void} shown what is to be remembered of the view
 */

/**
 * @typedef {object} Tab
 * @property {() => Dict} [looked] what it looks at, for the way back
 * @property {(was: Dict) => void} [look] look at it again
 * @property {() => unknown} [show] it is the chosen tab: draw what is outdated
 * @property {(session: Dict, isNewFile: boolean) => void} [changed] the recipe changed
 * @property {(header: Dict) => void} [reached] the full data have been evaluated (answer of metrics)
 * @property {(news: Dict) => void} [news] frames without id
 */

/** @typedef {{ id: string, label: (session: Dict) => string, fits: (session: Dict) => boolean, make: ((context: Context) => Tab) | null }} Entry */

/**
 * Return the tabs.
 * @param {HTMLElement} strip
 * @param {Entry[]} entries each has a panel `panel-<id>`; the first shows the pictures
 * @param {Omit<Context, "el">} context
 */
export function makeTabs(strip, entries, context) {
  /** @type {Map<string, Tab>} */
  const made = new Map();
  let chosen = "";
  for (const { id, make } of entries) {
    const el = document.getElementById(`panel-${id}`);
    if (make && el) made.set(id, make({ ...context, el }));
  }

  const fitting = () => entries.filter((entry) => context.session().kind && entry.fits(context.session()));

  function draw() {
    const had = strip.contains(document.activeElement);
    strip.replaceChildren(...fitting().map((entry) => {
      const button = document.createElement("button");
      button.type = "button";
      button.id = `tab-${entry.id}`;
      button.setAttribute("role", "tab");
      button.setAttribute("aria-selected", String(entry.id === chosen));
      button.tabIndex = entry.id === chosen ? 0 : -1;
      button.textContent = entry.label(context.session());
      button.addEventListener("click", () => choose(entry.id));
      return button;
    }));
    document.body.dataset.tab = chosen;
    if (had) document.getElementById(`tab-${chosen}`)?.focus();
  }

  function choose(/** @type {string} */ id) {
    chosen = id;
    context.shown({ tab: id });
    draw();
    // of a narrow page one part is seen: that of what was chosen
    if (matchMedia("(max-width: 699px)").matches) /** @type {HTMLElement | null} */ (document.querySelector("#parts [data-part=picture]"))?.click();
    made.get(id)?.show?.();
  }

  strip.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const ids = fitting().map((entry) => entry.id);
    choose(ids[(ids.indexOf(chosen) + step + ids.length) % ids.length]);
  });

  return {
    /** The recipe changed. @param {boolean} isNewFile @param {string} [first] tab to begin with */
    changed(isNewFile, first) {
      const ids = fitting().map((entry) => entry.id);
      if (isNewFile || !ids.includes(chosen)) chosen = first && ids.includes(first) ? first : ids[0] ?? "";
      for (const tab of made.values()) tab.changed?.(context.session(), isNewFile);
      draw();
      made.get(chosen)?.show?.();
    },
    /** @param {Dict} header of metrics at full resolution */
    reached(header) {
      for (const tab of made.values()) tab.reached?.(header);
    },
    /** @param {Dict} news */
    news(news) {
      for (const tab of made.values()) tab.news?.(news);
    },
    choose,
    looked: () => made.get(chosen)?.looked?.() ?? null,
    look: (/** @type {Dict | null} */ was) => was && made.get(chosen)?.look?.(was),
    get chosen() {
      return chosen;
    },
  };
}

/** Parts of a narrow page: one at a time. The wide page shows them all. @param {HTMLElement} bar */
export function listenToParts(bar) {
  const buttons = /** @type {HTMLElement[]} */ ([...bar.querySelectorAll("[data-part]")]);
  function choose(/** @type {HTMLElement} */ chosen) {
    document.body.dataset.part = chosen.dataset.part;
    for (const one of buttons) {
      one.setAttribute("aria-selected", String(one === chosen));
      one.tabIndex = one === chosen ? 0 : -1;
    }
  }
  buttons.forEach((one, i) => {
    one.addEventListener("click", () => choose(one));
    one.addEventListener("keydown", (event) => {
      const by = { ArrowRight: 1, ArrowLeft: -1 }[/** @type {KeyboardEvent} */ (event).key];
      if (!by) return;
      const next = buttons[(i + by + buttons.length) % buttons.length];
      choose(next);
      next.focus();
    });
  });
}
