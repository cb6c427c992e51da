// @ts-check
// The map in three dimensions: plain WebGL2. Heights lie in one texture, vertices come from their number
// alone; where something was not measured no triangle is drawn.

import { colours } from "./colours.js";
import { si } from "./format.js";
import { listenToPinch } from "./handles.js";

/** @typedef {Record<string, any>} Dict */

const MISSING = -3e38;
const SLOW_MS = 33;
const LAMP = 130;
const [STEP, MOST_STEPS] = [1.25, 20]; // of the height scale
const COMMON = `#version 300 es
precision highp float; precision highp int;
uniform highp sampler2D heights; uniform ivec2 size; uniform int stride; uniform mat3 turn; uniform vec4 view; uniform vec3 unit;
float at(ivec2 p) { return texelFetch(heights, clamp(p, ivec2(0), size - 1), 0).r; }
vec3 place(vec2 p, float z) { return vec3((p - 0.5 * vec2(size - 1)) * unit.xy, z * unit.z); }
vec4 seen(vec3 p) { vec3 q = turn * p; return vec4(q.x * view.x + view.z, q.y * view.y + view.w, -q.z * 0.2, 1.0); }
`;
const SURFACE = `${COMMON}
out vec3 normal; out float height;
const ivec2 corner[6] = ivec2[6](ivec2(0,0), ivec2(1,0), ivec2(1,1), ivec2(0,0), ivec2(1,1), ivec2(0,1));
void main() {
  int across = (size.x - 1) / stride, cell = gl_VertexID / 6, k = gl_VertexID % 6, first = 3 * (k / 3);
  ivec2 from = ivec2(cell % across, cell / across) * stride, p = from + corner[k] * stride;
  for (int i = 0; i < 3; i++) if (at(from + corner[first + i] * stride) < -1e38) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  height = at(p);
  float l = at(p - ivec2(stride, 0)), r = at(p + ivec2(stride, 0)), d = at(p - ivec2(0, stride)), u = at(p + ivec2(0, stride));
  if (l < -1e38) l = height; if (r < -1e38) r = height; if (d < -1e38) d = height; if (u < -1e38) u = height;
  normal = turn * normalize(vec3((l - r) * unit.z / (2.0 * float(stride) * unit.x), (d - u) * unit.z / (2.0 * float(stride) * unit.y), 1.0));
  gl_Position = seen(place(vec2(p), height));
}`;
const PAINT = `#version 300 es
precision highp float; in vec3 normal; in float height; uniform sampler2D table; uniform vec2 range; uniform vec3 lamp; out vec4 colour;
void main() {
  float t = clamp((height - range.x) / (range.y - range.x), 0.0, 1.0);
  float light = 0.3 + 0.75 * (0.5 + 0.5 * dot(normalize(normal), lamp)); // half-Lambert: steep flanks stay readable
  colour = vec4(texture(table, vec2((1.0 + 254.0 * t + 0.5) / 256.0, 0.5)).rgb * light, 1.0);
}`;
const LINE = `${COMMON}
uniform vec4 ends; uniform int samples;
void main() {
  vec2 p = mix(ends.xy, ends.zw, float(gl_VertexID) / float(samples - 1));
  float z = at(ivec2(p + 0.5));
  if (z < -1e38 || any(lessThan(p, vec2(-0.5))) || any(greaterThan(p, vec2(size) - 0.5))) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); gl_PointSize = 1.0; return; }
  vec4 q = seen(place(p, z)); gl_Position = vec4(q.xy, q.z - 0.01, 1.0); gl_PointSize = 2.5;
}`;
const WHITE = "#version 300 es\nprecision highp float; out vec4 colour; void main() { colour = vec4(1.0, 1.0, 1.0, 1.0); }";

/**
 * Return the view of a map in three dimensions.
 * @param {HTMLElement} el
 * @param {object} options
 * @param {() => string} options.table name of the colours
 * @param {() => number[][]} options.lines ends of sections, [x0, y0, x1, y1] in m
 * @param {(degrees: number) => void} [options.lit] told where the light comes from
 * @param {(steps: number) => void} [options.stretched] told the height scale, in steps of a quarter
 */
export function makeRelief(el, { table, lines, lit = () => {}, stretched = () => {} }) {
  const canvas = document.createElement("canvas");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "Map in three dimensions. Drag or arrows turn it, the wheel or plus and minus zoom, page keys change the height scale, square brackets turn the light, a double click resets.");
  const axes = document.createElement("canvas");
  axes.className = "relief-axes";
  const words = document.createElement("div");
  words.className = "readout map-readout";
  const sentence = document.createElement("p");
  sentence.className = "plot-empty";
  el.replaceChildren(canvas, axes, words, sentence);
  const context = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
  /** @type {Dict | null} */
  let data = null;
  /** @type {Dict | null} */
  let made = null;
  let [azimuth, elevation, zoom, stretch] = [-0.6, 0.75, 1, 1];
  let lamp = LAMP; // direction of the light, degrees from the right of the screen
  let coarse = 1;
  let frames = 0;
  let waiting = 0;
  let moving = 0;
  let full = [0, 0]; // pixels of the picture at rest
  /** @type {(WebGLTexture | null)[]} */
  let textures = [null, null];
  if (!context) sentence.textContent = "This browser has no WebGL2, so that there is no view in three dimensions; map and numbers go on.";

  function program(/** @type {string} */ vertex, /** @type {string} */ fragment) {
    const gl = /** @type {WebGL2RenderingContext} */ (context);
    const one = /** @type {WebGLProgram} */ (gl.createProgram());
    for (const [kind, text] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(one, shader);
    }
    gl.linkProgram(one);
    if (!gl.getProgramParameter(one, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(`3-D: ${gl.getProgramInfoLog(one)}`);
    return one;
  }

  function texture(/** @type {number} */ unit, /** @type {number} */ kind, /** @type {number} */ width, /** @type {number} */ height, /** @type {number} */ format, /** @type {number} */ type, /** @type {ArrayBufferView} */ values) {
    const gl = /** @type {WebGL2RenderingContext} */ (context);
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.deleteTexture(textures[unit]);
    textures[unit] = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, textures[unit]);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, kind, width, height, 0, format, type, values);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
    for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
  }

  function load() {
    if (!context || !data || context.isContextLost()) return;
    const gl = context;
    made ??= { surface: program(SURFACE, PAINT), line: program(LINE, WHITE) };
    texture(0, gl.R32F, data.size[0], data.size[1], gl.RED, gl.FLOAT, data.z);
    texture(1, gl.RGB8, 256, 1, gl.RGB, gl.UNSIGNED_BYTE, colours(table()));
  }

  const wide = () => Math.max(data?.step[0] * (data?.size[0] - 1), data?.step[1] * (data?.size[1] - 1)) || 1;
  const factor = () => (0.3 * stretch * wide()) / (data ? data.range[1] - data.range[0] || 1 : 1);
  function turn() {
    const [c, s, d, t] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
    // columns of the matrix: x right, y up on the screen, z towards the eye
    return [c, s * t, -s * d, -s, c * t, -c * d, 0, d, t];
  }

  function draw() {
    waiting = 0;
    if (!context || !data || !made || context.isContextLost() || !full[0]) return;
    // where a frame is slow, half of the pixels along each side serve while the hand moves
    const part = moving && coarse >= 4 ? 0.5 : 1;
    const [width, height] = full.map((v) => Math.max(1, Math.round(part * v)));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const gl = context;
    const began = performance.now();
    const [unit, m] = [2 / wide(), turn()];
    const aspect = canvas.width / canvas.height;
    const scale = 0.68 * zoom;
    const view = aspect > 1 ? [scale / aspect, scale, 0, 0] : [scale, scale * aspect, 0, 0];
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const stride = moving ? coarse : 1;
    for (const one of [made.surface, made.line]) {
      gl.useProgram(one);
      const set = (/** @type {string} */ name) => gl.getUniformLocation(one, name);
      gl.uniform1i(set("heights"), 0);
      gl.uniform2i(set("size"), data.size[0], data.size[1]);
      gl.uniform1i(set("stride"), stride);
      gl.uniformMatrix3fv(set("turn"), false, m);
      gl.uniform4fv(set("view"), view);
      gl.uniform3f(set("unit"), data.step[0] * unit, data.step[1] * unit, factor() * unit);
      if (one === made.surface) {
        gl.uniform1i(set("table"), 1);
        gl.uniform2f(set("range"), data.shown[0], data.shown[1]);
        gl.uniform3f(set("lamp"), 0.62 * Math.cos((lamp * Math.PI) / 180), 0.62 * Math.sin((lamp * Math.PI) / 180), 0.785);
        gl.drawArrays(gl.TRIANGLES, 0, 6 * Math.floor((data.size[0] - 1) / stride) * Math.floor((data.size[1] - 1) / stride));
      } else {
        const pixel = (/** @type {number} */ v, /** @type {number} */ k) => (v - data?.origin[k % 2]) / data?.step[k % 2];
        for (const ends of lines()) {
          gl.uniform4fv(set("ends"), ends.map(pixel));
          gl.uniform1i(set("samples"), 1500);
          gl.drawArrays(gl.POINTS, 0, 1500);
        }
      }
    }
    // finish() does not wait for a graphics process of its own; a pixel that is read does
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    const took = performance.now() - began;
    if (moving && took > SLOW_MS) coarse = Math.min(8, coarse * 2);
    drawAxes(m, view, unit);
    frames += 1;
    canvas.dataset.frames = String(frames);
    canvas.dataset.angles = `${azimuth.toFixed(3)} ${elevation.toFixed(3)}`;
    const times = data.unit === "px" ? "" : `z × ${si(factor(), "", 3).trim()}   `; // no length has a ratio to pixels
    words.textContent = `${times}P-V ${si(data.pv)}   ${data.size[0]} × ${data.size[1]} points`;
  }

  /** The box around the map, with the numbers of its edges. */
  function drawAxes(/** @type {number[]} */ m, /** @type {number[]} */ view, /** @type {number} */ unit) {
    const pen = /** @type {CanvasRenderingContext2D} */ (axes.getContext("2d"));
    if (axes.width !== full[0] || axes.height !== full[1]) [axes.width, axes.height] = full;
    else pen.clearRect(0, 0, axes.width, axes.height);
    if (!data) return;
    const ratio = window.devicePixelRatio || 1;
    const half = [0, 1].map((k) => (data?.step[k] * (data?.size[k] - 1) * unit) / 2);
    const [low, high] = data.range.map((/** @type {number} */ v) => v * factor() * unit);
    const on = (/** @type {number} */ x, /** @type {number} */ y, /** @type {number} */ z) => {
      const q = [0, 1].map((r) => m[r] * x + m[3 + r] * y + m[6 + r] * z);
      return [((q[0] * view[0] + 1) / 2) * axes.width, ((1 - q[1] * view[1]) / 2) * axes.height];
    };
    const ink = getComputedStyle(el).getPropertyValue("--soft");
    [pen.strokeStyle, pen.fillStyle, pen.font] = [ink, ink, `${12 * ratio}px system-ui, sans-serif`];
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([i, j]) => on(i * half[0], j * half[1], low));
    pen.beginPath();
    corners.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath();
    const left = corners.reduce((a, b) => (b[0] < a[0] ? b : a));
    const k = corners.indexOf(left);
    const top = on([-1, 1, 1, -1][k] * half[0], [-1, -1, 1, 1][k] * half[1], high);
    pen.moveTo(left[0], left[1]);
    pen.lineTo(top[0], top[1]);
    pen.stroke();
    const across = data.step.map((/** @type {number} */ d, /** @type {number} */ i) => d * (data?.size[i] - 1));
    const say = (/** @type {string} */ text, /** @type {number[]} */ p, dy = 0) => pen.fillText(text, Math.max(2, Math.min(p[0], axes.width - 90 * ratio)), Math.max(12 * ratio, Math.min(p[1] + dy * ratio, axes.height - 4)));
    const mid = (/** @type {number[]} */ p, /** @type {number[]} */ q) => [(p[0] + q[0]) / 2, (p[1] + q[1]) / 2];
    const lower = (/** @type {number} */ a, /** @type {number} */ b) => (corners[a][1] + corners[(a + 1) % 4][1] > corners[b][1] + corners[(b + 1) % 4][1] ? a : b);
    const [ex, ey] = [lower(0, 2), lower(1, 3)];
    say(`x ${si(across[0], data.unit, 3)}`, mid(corners[ex], corners[(ex + 1) % 4]), 15);
    say(`y ${si(across[1], data.unit, 3)}`, mid(corners[ey], corners[(ey + 1) % 4]), 15);
    say(`z ${si(data.range[1], "m", 3)}`, top, -4);
    say(si(data.range[0], "m", 3), left, 15);
  }

  function wish(isMoving = false) {
    clearTimeout(moving);
    moving = isMoving ? window.setTimeout(() => ((moving = 0), wish()), 250) : 0;
    waiting ||= requestAnimationFrame(draw);
  }

  function rotate(/** @type {number} */ dx, /** @type {number} */ dy) {
    azimuth += dx;
    elevation = Math.max(0.02, Math.min(Math.PI / 2, elevation + dy));
    wish(true);
  }

  function light(/** @type {number} */ degrees) {
    lamp = ((degrees % 360) + 360) % 360;
    lit(lamp);
    wish(true);
  }

  /** @param {number} steps of a quarter, above the scale that fits */
  function height(steps) {
    stretch = STEP ** steps;
    stretched(steps);
    wish(true);
  }
  const taller = (/** @type {number} */ by) => height(Math.max(-MOST_STEPS, Math.min(MOST_STEPS, Math.round(Math.log(stretch) / Math.log(STEP)) + by)));

  const reset = () => (([azimuth, elevation, zoom] = [-0.6, 0.75, 1]), height(0), light(LAMP));
  const grow = (/** @type {number} */ by) => ((zoom = Math.max(0.2, Math.min(30, zoom * by))), wish(true));
  listenToPinch(canvas, (factor) => grow(1 / factor));
  let last = [0, 0]; // a finger has no movementX
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    last = [event.clientX, event.clientY];
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    rotate((event.clientX - last[0]) * 0.01, (event.clientY - last[1]) * 0.01);
    last = [event.clientX, event.clientY];
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    grow(Math.exp(-event.deltaY * 0.0015));
  }, { passive: false });
  canvas.addEventListener("dblclick", reset);
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const n = event.shiftKey ? 0.3 : 0.05;
    const acts = /** @type {Record<string, () => void>} */ ({
      ArrowLeft: () => rotate(-n, 0), ArrowRight: () => rotate(n, 0), ArrowUp: () => rotate(0, n), ArrowDown: () => rotate(0, -n),
      "+": () => grow(1.25), "=": () => grow(1.25), "-": () => grow(0.8), Home: reset,
      "[": () => light(lamp + 15), "]": () => light(lamp - 15),
      PageUp: () => taller(1), PageDown: () => taller(-1),
    });
    if (!(event.key in acts)) return;
    event.preventDefault();
    event.stopPropagation();
    acts[event.key]();
  });
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    [made, textures] = [null, [null, null]];
    sentence.textContent = "The graphics were lost for a moment; the view comes back by itself.";
  });
  canvas.addEventListener("webglcontextrestored", () => {
    sentence.textContent = "";
    load();
    wish();
  });
  const watcher = new ResizeObserver(() => {
    const ratio = window.devicePixelRatio || 1;
    full = [Math.round(el.clientWidth * ratio), Math.round(el.clientHeight * ratio)];
    wish();
  });
  watcher.observe(el);
  return {
    /** @param {Dict} header @param {Dict} arrays of a request relief */
    put(header, arrays) {
      const z = new Float32Array(arrays.z.length);
      for (let i = 0; i < z.length; i += 1) z[i] = Number.isNaN(arrays.z[i]) ? MISSING : arrays.z[i];
      data = { ...header, z, size: [arrays.z.shape[1], arrays.z.shape[0]] };
      coarse = 1;
      load();
      wish();
    },
    wish,
    /** What is said below it, until the next picture. @param {string} text */
    say: (text) => void (words.textContent = text),
    /** Another table of colours. */
    paint() {
      load();
      wish();
    },
    light,
    height,
    /** How it is turned, zoomed, stretched and lit; turn it so. @param {number[]} [was] */
    pose(was) {
      if (was) ([azimuth, elevation, zoom, stretch] = was), taller(0), light(was[4]);
      return [azimuth, elevation, zoom, stretch, lamp];
    },
    /** What is seen, with axes and words. */
    picture() {
      const made = document.createElement("canvas");
      [made.width, made.height] = full;
      const pen = /** @type {CanvasRenderingContext2D} */ (made.getContext("2d"));
      const style = getComputedStyle(document.body);
      pen.fillStyle = style.getPropertyValue("--panel");
      pen.fillRect(0, 0, ...full);
      pen.drawImage(canvas, 0, 0, ...full);
      pen.drawImage(axes, 0, 0, ...full);
      const ratio = window.devicePixelRatio || 1;
      pen.fillStyle = style.getPropertyValue("--ink");
      pen.font = `${12 * ratio}px system-ui, sans-serif`;
      pen.fillText(words.textContent ?? "", 8 * ratio, full[1] - 8 * ratio);
      return made;
    },
  };
}
