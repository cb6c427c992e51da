// @ts-check
// The socket to the server, and the model that a widget talks to. In a notebook the model is that of
// anywidget; here `makeModel` offers the same four methods.

/** @typedef {Record<string, any>} Dict */
/** @typedef {{ header: Dict, arrays: Record<string, any> }} Answer */

const TYPES = /** @type {Record<string, any>} */ ({
  u1: Uint8Array, i4: Int32Array, f4: Float32Array, f8: Float64Array,
});

/** What the server says when it refuses; its text is that of the command line. */
export class Refusal extends Error {
  /** @param {Dict} error @param {string} kind */
  constructor(error, kind) {
    super(error.message);
    this.code = error.code;
    this.ask = error.ask ?? null;
    this.mends = error.mends ?? [];
    this.kind = kind;
  }
}

/** A newer wish took the place of this one, or it was cancelled. */
export class Superseded extends Error {}

/**
 * Return header and arrays of a frame; the arrays are views, nothing is copied.
 * @param {ArrayBuffer} buffer
 * @returns {Answer}
 */
export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const arrays = /** @type {Record<string, any>} */ ({});
  let at = 4 + length;
  for (const { name, dtype, shape } of header.arrays ?? []) {
    const Type = TYPES[dtype];
    const n = shape.reduce((/** @type {number} */ a, /** @type {number} */ b) => a * b, 1);
    arrays[name] = new Type(buffer, at, n);
    arrays[name].shape = shape;
    at += Math.ceil((n * Type.BYTES_PER_ELEMENT) / 8) * 8;
  }
  return { header, arrays };
}

/** One socket: for each slot one request is under way, and only the latest wish waits. */
export class Wire {
  /** @param {string} address */
  constructor(address) {
    this.address = address;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.next = 1;
    /** @type {Map<number, { slot: string, kind: string, resolve: (a: Answer) => void, reject: (e: Error) => void }>} */
    this.open = new Map();
    /** @type {Map<string, number>} */
    this.busy = new Map();
    /** @type {Map<string, { body: Dict, resolve: (a: Answer) => void, reject: (e: Error) => void }>} */
    this.wishes = new Map();
    /** @type {(header: Dict) => void} */
    this.onNews = () => {};
    /** @type {(connected: boolean) => void} */
    this.onState = () => {};
    this.tries = 0;
  }

  connect() {
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.tries = 0;
      this.onState(true);
    };
    socket.onmessage = (event) => this.take(event.data);
    socket.onclose = () => {
      const waiting = [...this.open.values(), ...this.wishes.values()];
      this.open.clear();
      this.busy.clear();
      this.wishes.clear();
      for (const { reject } of waiting) reject(new Superseded("the connection was lost"));
      this.tries += 1;
      this.onState(false);
      setTimeout(() => this.connect(), Math.min(5000, 500 * this.tries));
    };
  }

  /** @returns {boolean} */
  get connected() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  /**
   * Ask the server. A wish of the same slot that still waits is dropped.
   * @param {string} kind
   * @param {Dict} [body]
   * @param {string} [slot] the kind, if omitted
   * @returns {Promise<Answer>}
   */
  ask(kind, body = {}, slot = kind) {
    return new Promise((resolve, reject) => {
      if (!this.connected) {
        reject(new Superseded("there is no connection"));
        return;
      }
      const wish = { body: { ...body, k: kind }, resolve, reject };
      if (this.busy.has(slot)) {
        this.wishes.get(slot)?.reject(new Superseded("a newer wish came"));
        this.wishes.set(slot, wish);
      } else {
        this.send(slot, wish);
      }
    });
  }

  /**
   * Stop what is under way in a slot.
   * @param {string} slot
   */
  cancel(slot) {
    const wish = this.wishes.get(slot);
    if (wish) {
      this.wishes.delete(slot);
      wish.reject(new Superseded("cancelled"));
    }
    const id = this.busy.get(slot);
    if (id !== undefined && this.connected) this.socket?.send(JSON.stringify({ k: "cancel", of: id }));
  }

  /**
   * @param {string} slot
   * @param {{ body: Dict, resolve: (a: Answer) => void, reject: (e: Error) => void }} wish
   */
  send(slot, { body, resolve, reject }) {
    const id = this.next;
    this.next += 1;
    this.busy.set(slot, id);
    this.open.set(id, { slot, kind: body.k, resolve, reject });
    this.socket?.send(JSON.stringify({ id, ...body }));
  }

  /** @param {ArrayBuffer} data */
  take(data) {
    const { header, arrays } = unpack(data);
    const entry = this.open.get(header.id);
    if (!entry) {
      this.onNews(header);
      return;
    }
    this.open.delete(header.id);
    this.busy.delete(entry.slot);
    const wish = this.wishes.get(entry.slot);
    if (wish) {
      this.wishes.delete(entry.slot);
      this.send(entry.slot, wish);
    }
    if (header.ok) entry.resolve({ header, arrays });
    else if (header.error?.code === 130) entry.reject(new Superseded("cancelled"));
    else entry.reject(new Refusal(header.error, entry.kind));
  }
}

/**
 * @typedef {object} Model
 * @property {(name: string) => any} get
 * @property {(name: string, value: any) => void} set
 * @property {(event: string, heard: () => void) => void} on
 * @property {(event: string, heard?: () => void) => void} off
 * @property {() => void} save_changes
 */

/**
 * Return a model as anywidget has it: `set` tells listeners on this side at once, `save_changes`
 * hands what was set to `saved`.
 * @param {Dict} start
 * @param {(changes: Dict) => void} [saved]
 * @returns {Model & { put: (values: Dict) => void }}
 */
export function makeModel(start, saved = () => {}) {
  const values = { ...start };
  /** @type {Dict} */
  let changes = {};
  /** @type {Map<string, Set<() => void>>} */
  const listeners = new Map();
  const tell = (/** @type {string} */ event) => listeners.get(event)?.forEach((heard) => heard());
  return {
    get: (name) => values[name],
    set(name, value) {
      values[name] = value;
      changes[name] = value;
      tell(`change:${name}`);
    },
    on(event, heard) {
      for (const one of event.split(" ")) {
        if (!listeners.has(one)) listeners.set(one, new Set());
        listeners.get(one)?.add(heard);
      }
    },
    off(event, heard) {
      for (const one of event.split(" ")) {
        if (heard) listeners.get(one)?.delete(heard);
        else listeners.delete(one);
      }
    },
    save_changes() {
      const sent = changes;
      changes = {};
      saved(sent);
    },
    /** What the other side says: told to listeners, not sent back. */
    put(given) {
      Object.assign(values, given);
      for (const name of Object.keys(given)) tell(`change:${name}`);
      tell("change");
    },
  };
}

/**
 * Return an array of a model as a typed array; a notebook hands over a DataView.
 * @param {any} value
 * @param {any} Type
 */
export function typed(value, Type) {
  if (value instanceof DataView) {
    return new Type(value.buffer.slice(value.byteOffset, value.byteOffset + value.byteLength));
  }
  return value;
}

/** What to do without a connection. @param {number} tries */
export const lostWords = (tries) => (tries > 3
  ? "no connection: is metrosep still running? After a new start open the address that it prints"
  : "connection lost, trying again…");
