// @ts-check
// A handle on a picture: dragged with the pointer, moved with the arrow keys by 1 pixel, with Shift
// by 10. It takes the focus and tells a screen reader what it is.

/**
 * @typedef {object} Grip
 * @property {HTMLElement} el
 * @property {(x: number, y: number) => void} place in CSS pixels of the parent
 * @property {(text: string) => void} describe
 * @property {(shown: boolean) => void} show
 */

/**
 * Return a handle.
 * @param {HTMLElement} parent it is placed in, position relative or absolute
 * @param {object} options
 * @param {string} options.label name for screen readers
 * @param {string} [options.text] letter on it
 * @param {string} [options.kind] class: point, upright or level
 * @param {(x: number, y: number) => void} options.moved pointer in CSS pixels of the parent
 * @param {(dx: number, dy: number) => void} options.stepped arrows, y down
 * @param {(held: boolean) => void} [options.held] taken and let go
 * @param {(end: "Home" | "End") => void} [options.ended]
 * @returns {Grip}
 */
export function makeHandle(parent, { label, text = "", kind = "point", moved, stepped, held, ended }) {
  const el = document.createElement("div");
  el.className = `handle handle-${kind}`;
  el.tabIndex = 0;
  el.setAttribute("role", "slider");
  el.setAttribute("aria-label", label);
  el.setAttribute("aria-valuenow", "0");
  if (kind !== "point") el.setAttribute("aria-orientation", kind === "level" ? "vertical" : "horizontal");
  el.textContent = text;
  parent.append(el);

  let grabbed = { x: 0, y: 0 };
  let place = { x: 0, y: 0 };
  let timer = 0;
  el.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    event.preventDefault();
    event.stopPropagation();
    el.focus({ preventScroll: true });
    el.setPointerCapture(event.pointerId);
    grabbed = { x: event.clientX - place.x, y: event.clientY - place.y };
    el.classList.add("held");
    held?.(true);
  });
  el.addEventListener("pointermove", (event) => {
    if (!el.hasPointerCapture(event.pointerId)) return;
    event.stopPropagation();
    moved(event.clientX - grabbed.x, event.clientY - grabbed.y);
  });
  const drop = () => {
    if (!el.classList.contains("held")) return;
    el.classList.remove("held");
    held?.(false);
  };
  el.addEventListener("pointerup", drop);
  el.addEventListener("lostpointercapture", drop);
  el.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const n = event.shiftKey ? 10 : 1;
    const steps = /** @type {Record<string, [number, number]>} */ ({
      ArrowLeft: [-n, 0], ArrowRight: [n, 0], ArrowUp: [0, -n], ArrowDown: [0, n],
    });
    if (event.key in steps) {
      held?.(true);
      stepped(...steps[event.key]);
      clearTimeout(timer);
      timer = window.setTimeout(() => held?.(false), 150);
    } else if ((event.key === "Home" || event.key === "End") && ended) {
      ended(event.key);
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
  });
  return {
    el,
    place(x, y) {
      place = { x, y };
      el.style.transform = `translate(${x.toFixed(2)}px, ${y.toFixed(2)}px)`;
      el.setAttribute("aria-valuenow", (kind === "level" ? y : x).toFixed(1));
    },
    describe(words) {
      el.setAttribute("aria-valuetext", words);
      el.title = `${label}: ${words}`;
    },
    show(shown) {
      el.hidden = !shown;
    },
  };
}

/**
 * Return how much longer what is shown becomes by a turn of the wheel.
 * @param {WheelEvent} event
 */
export function wheelFactor(event) {
  return Math.exp(Math.max(-0.5, Math.min(0.5, event.deltaY * 0.0015)));
}

/**
 * Two fingers on a picture zoom it; until both are lifted nothing else hears of them.
 * @param {HTMLElement} el
 * @param {(factor: number, x: number, y: number) => void} zoomed as the wheel does; place in CSS pixels of the window
 */
export function listenToPinch(el, zoomed) {
  /** @type {Map<number, [number, number]>} */
  const held = new Map();
  let [span, pinches] = [0, false];
  el.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "touch") return;
    held.set(event.pointerId, [event.clientX, event.clientY]);
    span = 0;
    pinches ||= held.size > 1;
    if (pinches) event.stopImmediatePropagation();
  }, true);
  el.addEventListener("pointermove", (event) => {
    if (!held.has(event.pointerId)) return;
    held.set(event.pointerId, [event.clientX, event.clientY]);
    if (!pinches) return;
    event.stopImmediatePropagation();
    if (held.size !== 2) return;
    const [[ax, ay], [bx, by]] = [...held.values()];
    const now = Math.hypot(bx - ax, by - ay);
    if (span > 0 && now > 0) zoomed(span / now, (ax + bx) / 2, (ay + by) / 2);
    span = now;
  }, true);
  for (const end of ["pointerup", "pointercancel"]) {
    el.addEventListener(end, (event) => {
      held.delete(/** @type {PointerEvent} */ (event).pointerId);
      span = 0;
      if (!held.size) pinches = false;
    }, true);
  }
}
