"use strict";
// Plays what logs/viewing/page_data.py put into the page. All times are seconds since its origin.

const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16, 32, 64];
const TRAIL_S = 8;
const FONT = "11px system-ui, sans-serif";
const SEEN_FOR_S = 0.4; // how long what was seen stays in sight after its image
const BREAK_S = 2; // no curve is drawn over a longer gap that is ten usual steps too
const KINDS = { landmark: 0, bearing: 1, line: 2 };
const PANELS = [
  { title: "position error [m]", column: 0, sigma: 3, scale: 1 },
  { title: "heading error [°]", column: 1, sigma: 4, scale: 180 / Math.PI },
  { title: "NEES", column: 2, sigma: null, scale: 1, log: true },
];

// -- the data ---------------------------------------------------------------------------------------------------------

function decode(array) {
  const text = atob(array.data);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const kinds = { f4: Float32Array, f8: Float64Array, u4: Uint32Array, u1: Uint8Array };
  return new kinds[array.type](bytes.buffer);
}

function trajectory(packed) {
  const t = decode(packed.t);
  const steps = Array.from(t.subarray(1), (x, i) => x - t[i]).sort((a, b) => a - b);
  const gap = Math.max(BREAK_S, 10 * (steps[steps.length >> 1] || 0));
  return { t, pose: decode(packed.pose), covariance: packed.covariance ? decode(packed.covariance) : null, gap };
}

const truth = data.truth && trajectory(data.truth);
const runs = data.runs.map((run) => ({
  ...run,
  shown: true,
  path: trajectory(run.trajectory),
  errors: run.errors && { t: decode(run.errors.t), rows: decode(run.errors.columns), width: run.errors.width },
}));
const seen = data.seen && {
  t: decode(data.seen.t), ends: decode(data.seen.ends), segments: decode(data.seen.segments),
  kinds: decode(data.seen.kinds),
};

/** Index of the last time that is not after t, -1 before the first. */
function before(times, t) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

const turn = (angle) => angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));

/** Pose and covariance at a time, between the neighbours; null where the trajectory does not reach. */
function at(path, t) {
  const i = before(path.t, t);
  if (i < 0) return null;
  const last = i + 1 >= path.t.length;
  const step = last ? Infinity : path.t[i + 1] - path.t[i];
  if (step > path.gap) { // nothing comes soon: the last one holds for a moment
    if (t - path.t[i] > Math.min(path.gap, 0.5)) return null;
  }
  const share = step > path.gap ? 0 : (t - path.t[i]) / step;
  const mix = (array, width, k) => {
    const a = array[width * i + k];
    return share > 0 ? a + share * (array[width * (i + 1) + k] - a) : a;
  };
  const heading = path.pose[3 * i + 2];
  const turned = share > 0 ? share * turn(path.pose[3 * i + 5] - heading) : 0;
  const pose = [mix(path.pose, 3, 0), mix(path.pose, 3, 1), turn(heading + turned)];
  const covariance = path.covariance && [0, 1, 2, 3].map((k) => mix(path.covariance, 4, k));
  return { pose, covariance };
}

// -- state ------------------------------------------------------------------------------------------------------------

// look: counts up when colours or what is shown change, and with it all that is drawn
const state = { t: 0, playing: false, speed: 1, followed: 0, middle: null, zoom: 1, look: 0, dirty: true };
const layers = { field: { canvas: document.createElement("canvas") }, strips: { canvas: document.createElement("canvas") } };
const field = byId("field"), strips = byId("strips");
const dark = matchMedia("(prefers-color-scheme: dark)");
let style = {};

function restyle() {
  const css = getComputedStyle(document.documentElement);
  for (const name of ["ink", "soft", "line", "back", "panel", "pitch", "mark", "mark-edge", "post", "truth", "seen", "now"])
    style[name] = css.getPropertyValue(`--${name}`).trim();
  for (const run of runs) run.shade = dark.matches ? lighter(run.colour) : run.colour;
  document.querySelectorAll("#runs i").forEach((dot, i) => { dot.style.background = runs[i].shade; });
  relook();
}

function relook() {
  state.look += 1;
  state.dirty = true;
}

function lighter(colour) {
  const part = (k) => Math.round(0.68 * parseInt(colour.slice(k, k + 2), 16) + 0.32 * 255);
  return `rgb(${part(1)}, ${part(3)}, ${part(5)})`;
}

function seek(t) {
  state.t = Math.min(Math.max(t, 0), data.duration_s);
  state.dirty = true;
}

function play(on) {
  if (on && state.t >= data.duration_s) seek(0);
  state.playing = on;
  byId("play").textContent = on ? "Pause" : "Play";
}

// -- the field --------------------------------------------------------------------------------------------------------

function extend(box, x, y, r) {
  box[0] = Math.min(box[0], x - r); box[1] = Math.min(box[1], y - r);
  box[2] = Math.max(box[2], x + r); box[3] = Math.max(box[3], y + r);
}

/** What the map covers. */
function pitch() {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  if (!data.field) return box;
  for (const [x0, y0, x1, y1] of data.field.lines) { extend(box, x0, y0, 0); extend(box, x1, y1, 0); }
  for (const [x, y, r] of data.field.circles) extend(box, x, y, r);
  for (const [x, y] of data.field.landmarks) extend(box, x, y, 0);
  return box;
}

const PITCH = pitch();

/** What is worth seeing: field and truth, and of the estimates what does not lie far outside. */
function bounds() {
  const box = [...PITCH];
  const add = (x, y) => extend(box, x, y, 0);
  const walk = (path) => { for (let i = 0; i < path.t.length; i++) add(path.pose[3 * i], path.pose[3 * i + 1]); };
  if (truth) walk(truth);
  const core = [...box];
  runs.forEach((run) => walk(run.path));
  if (box[0] === Infinity) return [-1, -1, 1, 1];
  if (core[0] !== Infinity) {
    const astray = 0.25 * Math.max(core[2] - core[0], core[3] - core[1]);
    for (const k of [0, 1]) box[k] = Math.max(box[k], core[k] - astray);
    for (const k of [2, 3]) box[k] = Math.min(box[k], core[k] + astray);
  }
  const margin = 0.05 * Math.max(box[2] - box[0], box[3] - box[1], 1);
  return [box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin];
}

const BOUNDS = bounds();

function fit(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return pen;
}

/** A canvas ready to be drawn on, with what does not change from frame to frame on it already. */
function prepared(canvas, layer, key, draw) {
  const width = Math.max(1, canvas.clientWidth), height = Math.max(1, canvas.clientHeight);
  const whole = JSON.stringify([key, width, height, window.devicePixelRatio, state.look]);
  if (layer.key !== whole) {
    layer.key = whole;
    draw(fit(layer.canvas, width, height), width, height);
  }
  const pen = fit(canvas, width, height);
  pen.drawImage(layer.canvas, 0, 0, width, height);
  return { pen, width, height };
}

/** Pixels a metre and the pixel of the field's origin. */
function view(width, height) {
  const [x0, y0, x1, y1] = BOUNDS;
  const scale = state.zoom * Math.min(width / (x1 - x0), height / (y1 - y0));
  let middle = state.middle || [(x0 + x1) / 2, (y0 + y1) / 2];
  if (byId("follow").checked) {
    const now = anyNow();
    if (now) middle = now.pose;
  }
  return { scale, left: width / 2 - scale * middle[0], top: height / 2 + scale * middle[1], middle };
}

function anyNow() {
  const run = runs[state.followed];
  return (run && at(run.path, state.t)) || (truth && at(truth, state.t));
}

/** The runs that are shown, the followed one last and so on top. */
function shown() {
  return runs.filter((run) => run.shown).sort((a, b) => (a === runs[state.followed]) - (b === runs[state.followed]));
}

function drawField() {
  const size = { width: Math.max(1, field.clientWidth), height: Math.max(1, field.clientHeight) };
  const { scale, left, top } = view(size.width, size.height);
  const X = (x) => left + scale * x, Y = (y) => top - scale * y;
  const showTruth = byId("show-truth").checked && truth;
  const faint = Math.min(Math.max(60 / data.duration_s, 0.22), 0.5);
  const { pen } = prepared(field, layers.field, [scale, left, top, Boolean(showTruth)], (pen, width, height) => {
    pen.lineCap = pen.lineJoin = "round";
    if (data.field) drawMap(pen, X, Y, scale);
    drawScale(pen, width, height, scale);
    if (showTruth) drawPath(pen, truth, X, Y, style.truth, 2.2, faint + 0.05);
    for (const run of shown()) drawPath(pen, run.path, X, Y, run.shade, 1.2, faint);
  });
  pen.lineCap = pen.lineJoin = "round";
  if (showTruth) drawTrail(pen, truth, X, Y, style.truth, 4);
  for (const run of shown()) drawTrail(pen, run.path, X, Y, run.shade, 2.2);
  const followed = runs[state.followed];
  const eye = followed && followed.shown ? at(followed.path, state.t) : truth && at(truth, state.t);
  if (eye && seen && byId("show-seen").checked) drawSeen(pen, eye.pose, X, Y);
  const trueNow = showTruth && at(truth, state.t);
  if (trueNow) drawRobot(pen, trueNow.pose, X, Y, scale, style.truth, false);
  for (const run of shown()) {
    const now = at(run.path, state.t);
    if (!now) continue;
    if (now.covariance) drawEllipse(pen, now, X, Y, scale, run.shade);
    drawRobot(pen, now.pose, X, Y, scale, run.shade, true, run === followed);
  }
}

function drawMap(pen, X, Y, scale) {
  const [x0, y0, x1, y1] = PITCH;
  const border = 0.06 * Math.max(x1 - x0, y1 - y0, 1);
  pen.fillStyle = style.pitch;
  pen.fillRect(X(x0 - border), Y(y1 + border), scale * (x1 - x0 + 2 * border), scale * (y1 - y0 + 2 * border));
  const line = Math.max(1.6, scale * data.field.line_width_m);
  for (const [colour, wide] of [[style["mark-edge"], line + 1.4], [style.mark, line]]) {
    pen.strokeStyle = colour;
    pen.lineWidth = wide;
    pen.beginPath();
    for (const [x0, y0, x1, y1] of data.field.lines) { pen.moveTo(X(x0), Y(y0)); pen.lineTo(X(x1), Y(y1)); }
    for (const [x, y, r] of data.field.circles) { pen.moveTo(X(x + r), Y(y)); pen.arc(X(x), Y(y), scale * r, 0, 7); }
    pen.stroke();
  }
  const few = data.field.landmarks.length <= 40;
  pen.font = FONT;
  pen.textAlign = "left";
  for (const [x, y, diameter, label] of data.field.landmarks) {
    pen.fillStyle = style.post;
    pen.beginPath();
    pen.arc(X(x), Y(y), Math.max(3, (scale * diameter) / 2), 0, 7);
    pen.fill();
    if (few && label.length <= 3) {
      pen.fillStyle = style.soft;
      pen.fillText(label, X(x) + 6, Y(y) - 5);
    }
  }
}

function drawScale(pen, width, height, scale) {
  const metres = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100].find((m) => scale * m >= 48) || 200;
  const x = 14, y = height - 14;
  pen.strokeStyle = pen.fillStyle = style.soft;
  pen.lineWidth = 1.2;
  pen.beginPath();
  pen.moveTo(x, y - 4); pen.lineTo(x, y); pen.lineTo(x + scale * metres, y); pen.lineTo(x + scale * metres, y - 4);
  pen.stroke();
  pen.font = FONT;
  pen.textAlign = "left";
  pen.fillText(`${metres} m`, x + 5, y - 5);
}

function trace(pen, path, first, last, X, Y) {
  pen.beginPath();
  let px = NaN, py = NaN;
  for (let i = Math.max(0, first); i <= last; i++) {
    const x = X(path.pose[3 * i]), y = Y(path.pose[3 * i + 1]);
    if (i === Math.max(0, first) || path.t[i] - path.t[i - 1] > path.gap) pen.moveTo(x, y);
    else if (i < last && Math.abs(x - px) < 0.5 && Math.abs(y - py) < 0.5) continue; // below a pixel
    else pen.lineTo(x, y);
    px = x; py = y;
  }
}

function drawPath(pen, path, X, Y, colour, width, strength) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.globalAlpha = strength;
  trace(pen, path, 0, path.t.length - 1, X, Y);
  pen.stroke();
  pen.globalAlpha = 1;
}

/** The last seconds. */
function drawTrail(pen, path, X, Y, colour, width) {
  const now = at(path, state.t);
  if (!now) return;
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.globalAlpha = 0.85;
  trace(pen, path, before(path.t, state.t - TRAIL_S), before(path.t, state.t), X, Y);
  pen.lineTo(X(now.pose[0]), Y(now.pose[1]));
  pen.stroke();
  pen.globalAlpha = 1;
}

function drawRobot(pen, [x, y, heading], X, Y, scale, colour, filled, followed) {
  const r = Math.min(Math.max(0.14 * scale, 8), 26);
  pen.save();
  pen.translate(X(x), Y(y));
  pen.rotate(-heading);
  pen.beginPath();
  pen.moveTo(1.55 * r, 0); // a nose
  pen.lineTo(0.72 * r, -0.7 * r);
  pen.arc(0, 0, r, -0.77, 0.77, true);
  pen.closePath();
  pen.lineWidth = filled ? 1.6 : 2.2;
  if (filled) {
    pen.fillStyle = colour;
    pen.globalAlpha = followed ? 0.95 : 0.75;
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = style.back;
  } else pen.strokeStyle = colour;
  pen.stroke();
  pen.restore();
}

/** Half axes and direction of the 3 sigma ellipse of the position; null where the covariance is none. */
function ellipse([xx, xy, yy]) {
  const half = (xx - yy) / 2, root = Math.hypot(half, xy), middle = (xx + yy) / 2;
  if (!(middle - root > 0)) return null;
  return { a: 3 * Math.sqrt(middle + root), b: 3 * Math.sqrt(middle - root), angle: 0.5 * Math.atan2(2 * xy, xx - yy) };
}

function drawEllipse(pen, now, X, Y, scale, colour) {
  const shape = ellipse(now.covariance);
  if (!shape) return;
  pen.beginPath();
  pen.ellipse(X(now.pose[0]), Y(now.pose[1]), scale * shape.a, scale * shape.b, -shape.angle, 0, 7);
  pen.fillStyle = pen.strokeStyle = colour;
  pen.globalAlpha = scale * shape.a < 150 ? 0.16 : 0.05; // a large one is not to hide the rest
  pen.fill();
  pen.globalAlpha = 0.9;
  pen.lineWidth = 1.2;
  pen.stroke();
  pen.globalAlpha = 1;
}

function drawSeen(pen, [x, y, heading], X, Y) {
  const i = before(seen.t, state.t);
  if (i < 0 || state.t - seen.t[i] > SEEN_FOR_S) return;
  const c = Math.cos(heading), s = Math.sin(heading);
  const place = (k) => {
    const u = seen.segments[k], v = seen.segments[k + 1];
    return [X(x + c * u - s * v), Y(y + s * u + c * v)];
  };
  pen.strokeStyle = pen.fillStyle = style.seen;
  for (let k = i > 0 ? seen.ends[i - 1] : 0; k < seen.ends[i]; k++) {
    const from = place(4 * k), to = place(4 * k + 2), kind = seen.kinds[k];
    pen.lineWidth = kind === KINDS.line ? 3 : 1.1;
    pen.setLineDash(kind === KINDS.bearing ? [7, 5] : []);
    pen.beginPath();
    pen.moveTo(...from);
    pen.lineTo(...to);
    pen.stroke();
    if (kind !== KINDS.landmark) continue;
    pen.beginPath();
    pen.arc(to[0], to[1], 3.6, 0, 7);
    pen.fill();
  }
  pen.setLineDash([]);
}

// -- the strips -------------------------------------------------------------------------------------------------------

const LEFT = 64, RIGHT = 10, PANEL = 74, GAP = 17, FOOT = 17;
const scored = runs.filter((run) => run.errors);
const panels = PANELS.filter((panel) => scored.some((run) => run.errors.width > panel.column));

/** The run that a panel is made for: the followed one, if it can be. */
function leading(panel) {
  const has = (run) => run && run.shown && run.errors && run.errors.width > panel.column;
  return has(runs[state.followed]) ? runs[state.followed] : scored.find(has);
}

/** The largest value a panel shows. A start in the dark, and runs that are far worse, may leave it. */
function limit(panel, run) {
  if (!run) return panel.log ? 4 * data.nees_line : 1;
  const all = [];
  for (let i = panel.column; i < run.errors.rows.length; i += run.errors.width)
    if (isFinite(run.errors.rows[i])) all.push(panel.scale * run.errors.rows[i]);
  all.sort((a, b) => a - b);
  const most = all[all.length - 1] || 0, usual = all[Math.floor(0.99 * (all.length - 1))] || 0;
  if (panel.log) return Math.max(1.5 * most, 4 * data.nees_line);
  const error = Math.max(Math.min(most, 2.5 * usual), 1e-6);
  return 1.1 * Math.max(error, Math.min(usualBand(run, panel), 3 * error));
}

/** How high the 3 sigma band is most of the time. */
function usualBand(run, panel) {
  if (run.errors.width <= panel.sigma) return 0;
  const all = [];
  for (let i = panel.sigma; i < run.errors.rows.length; i += run.errors.width)
    if (isFinite(run.errors.rows[i])) all.push(3 * panel.scale * run.errors.rows[i]);
  all.sort((a, b) => a - b);
  return all[Math.floor(0.98 * (all.length - 1))] || 0;
}

const stripsHeight = () => (panels.length ? panels.length * (PANEL + GAP) + FOOT : 26);

function drawStrips() {
  const { pen, width } = prepared(strips, layers.strips, 0, drawPanels);
  pen.fillStyle = style.now;
  const x = LEFT + ((width - LEFT - RIGHT) * state.t) / (data.duration_s || 1);
  pen.fillRect(x - 0.75, panels.length ? GAP - 2 : 0, 1.5, panels.length ? stripsHeight() - FOOT - GAP + 4 : 12);
}

function drawPanels(pen, width) {
  const X = (t) => LEFT + ((width - LEFT - RIGHT) * t) / (data.duration_s || 1);
  pen.font = FONT;
  panels.forEach((panel, k) => {
    const leader = leading(panel);
    const top = GAP + k * (PANEL + GAP), bottom = top + PANEL, most = limit(panel, leader);
    const low = Math.log(0.02);
    const Y = panel.log
      ? (v) => bottom - (PANEL * (Math.log(Math.min(Math.max(v, 0.02), 1e30)) - low)) / (Math.log(most) - low)
      : (v) => bottom - (PANEL * v) / most;
    pen.fillStyle = style.panel;
    pen.fillRect(LEFT, top, width - LEFT - RIGHT, PANEL);
    pen.fillStyle = style.soft;
    pen.textAlign = "left";
    pen.fillText(panel.title + legend(panel, leader), LEFT, top - 5);
    pen.textAlign = "right";
    for (const v of ticks(panel, most)) {
      pen.fillStyle = style.line;
      pen.fillRect(LEFT, Y(v), width - LEFT - RIGHT, 0.6);
      pen.fillStyle = style.soft;
      pen.fillText(+v.toPrecision(2), LEFT - 6, Y(v) + 4);
    }
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, top, width - LEFT - RIGHT, PANEL);
    pen.clip();
    for (const run of shown())
      if (run.errors && run.errors.width > panel.column) drawCurve(pen, run, leader, panel, X, Y, bottom);
    if (panel.log) {
      pen.strokeStyle = style.ink;
      pen.lineWidth = 1;
      pen.setLineDash([6, 4]);
      pen.beginPath();
      pen.moveTo(LEFT, Y(data.nees_line));
      pen.lineTo(width, Y(data.nees_line));
      pen.stroke();
      pen.setLineDash([]);
    }
    pen.restore();
  });
  pen.fillStyle = style.soft;
  pen.textAlign = "center";
  const step = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 3600].find((s) => X(s) - X(0) > 70) || 7200;
  for (let t = 0; t <= data.duration_s; t += step) pen.fillText(short(t), Math.max(X(t), 20), stripsHeight() - 4);
}

function legend(panel, leader) {
  if (panel.log) return "   dashed: 99.73 % quantile";
  return leader && leader.errors.width > panel.sigma ? `   shaded: 3σ as claimed by ${leader.name}` : "";
}

function ticks(panel, most) {
  if (panel.log) return [0.1, 1, 10, 100, 1e3, 1e4, 1e6].filter((v) => v < most);
  const rough = most / 2, power = 10 ** Math.floor(Math.log10(rough));
  const step = [5, 2, 1].map((f) => f * power).find((s) => s <= rough);
  return [0, 1, 2, 3, 4].map((i) => i * step).filter((v) => v < most);
}

/** scale: the run whose band is drawn. */
function drawCurve(pen, run, scale, panel, X, Y, bottom) {
  const { t, rows, width } = run.errors;
  const gap = run.path.gap;
  const curve = (column, factor) => {
    pen.beginPath();
    let up = false;
    for (let i = 0; i < t.length; i++) {
      const v = factor * panel.scale * rows[width * i + column];
      if (isNaN(v)) { up = false; continue; }
      if (!up || t[i] - t[i - 1] > gap) pen.moveTo(X(t[i]), Y(v));
      else pen.lineTo(X(t[i]), Y(v));
      up = true;
    }
  };
  pen.strokeStyle = pen.fillStyle = run.shade;
  if (run === scale && panel.sigma !== null && width > panel.sigma) {
    pen.globalAlpha = 0.14;
    pen.beginPath();
    for (let i = 0; i + 1 < t.length; i++) {
      const a = 3 * panel.scale * rows[width * i + panel.sigma], b = 3 * panel.scale * rows[width * (i + 1) + panel.sigma];
      if (isNaN(a) || isNaN(b) || t[i + 1] - t[i] > gap) continue;
      pen.moveTo(X(t[i]), bottom);
      pen.lineTo(X(t[i]), Y(a));
      pen.lineTo(X(t[i + 1]), Y(b));
      pen.lineTo(X(t[i + 1]), bottom);
    }
    pen.fill();
    pen.globalAlpha = 1;
  }
  pen.lineWidth = 1.1;
  curve(panel.column, 1);
  pen.stroke();
}

// -- words ------------------------------------------------------------------------------------------------------------

const pad = (n, digits) => String(n).padStart(digits, "0");

function short(t) {
  const s = Math.round(t);
  return data.duration_s < 120 ? `${s} s` : `${Math.floor(s / 60)}:${pad(s % 60, 2)}`;
}

function clock(t) {
  const ms = Math.round(1000 * t), s = Math.floor(ms / 1000);
  return `${Math.floor(s / 60)}:${pad(s % 60, 2)}.${pad(ms % 1000, 3)}`;
}

const DEGREES = 180 / Math.PI;

function say() {
  byId("clock").textContent = `${clock(state.t)} / ${clock(data.duration_s).slice(0, -4)}`;
  byId("slider").value = data.duration_s ? state.t / data.duration_s : 0;
  const run = runs[state.followed];
  const now = run && at(run.path, state.t), true_ = truth && at(truth, state.t);
  const rows = [["", run ? run.name : "", truth ? "truth" : ""]];
  const value = (one, f) => (one ? f(one) : "–");
  rows.push(["x [m]", value(now, (n) => n.pose[0].toFixed(2)), value(true_, (n) => n.pose[0].toFixed(2))]);
  rows.push(["y [m]", value(now, (n) => n.pose[1].toFixed(2)), value(true_, (n) => n.pose[1].toFixed(2))]);
  rows.push(["heading [°]", value(now, (n) => (DEGREES * n.pose[2]).toFixed(1)), value(true_, (n) => (DEGREES * n.pose[2]).toFixed(1))]);
  if (now && now.covariance) {
    const shape = ellipse(now.covariance);
    rows.push(["3σ ellipse [m]", shape ? shape.a.toFixed(2) : "–", shape ? `× ${shape.b.toFixed(2)}` : ""]);
    rows.push(["3σ heading [°]", (3 * DEGREES * Math.sqrt(now.covariance[3])).toFixed(1), ""]);
  }
  if (now && true_) {
    const off = Math.hypot(now.pose[0] - true_.pose[0], now.pose[1] - true_.pose[1]);
    rows.push(["error", `${off.toFixed(3)} m`, `${Math.abs(DEGREES * turn(now.pose[2] - true_.pose[2])).toFixed(1)}°`]);
  }
  if (run && run.errors && run.errors.width > 2) {
    const i = before(run.errors.t, state.t);
    if (i >= 0) rows.push(["NEES, last", run.errors.rows[run.errors.width * i + 2].toPrecision(3), ""]);
  }
  const body = document.createElement("tbody");
  for (const cells of rows) {
    const row = body.insertRow();
    for (const text of cells) row.insertCell().textContent = text;
  }
  byId("readout").replaceChildren(body);
}

function introduce() {
  byId("title").textContent = data.log;
  const facts = [clock(data.duration_s).slice(0, -4)];
  if (data.field) facts.push(`field ${data.field.name}, ${data.field.landmarks.length} landmarks`);
  facts.push(truth ? `${data.truth.all.toLocaleString("en")} true poses` : "no truth");
  byId("facts").textContent = facts.join(" · ");
  const box = byId("runs");
  runs.forEach((run, i) => {
    const button = document.createElement("button");
    button.type = "button";
    button.title = `${i + 1}: follow; once more: hide or show`;
    const dot = document.createElement("i"), name = document.createElement("b"), words = document.createElement("small");
    name.textContent = run.name;
    words.textContent = run.summary;
    button.append(dot, name, words);
    button.addEventListener("click", () => choose(i));
    box.append(button);
  });
  const select = byId("speed");
  for (const speed of SPEEDS) select.add(new Option(`${speed} ×`, speed, speed === 1, speed === 1));
  if (!truth) byId("show-truth").parentElement.hidden = true;
  if (!seen) byId("show-seen").parentElement.hidden = true;
  if (data.field && data.field.symmetric && truth === null)
    byId("note").textContent = "The field looks the same from its other half: nothing here says which half is the right one.";
}

function choose(i) {
  if (!runs[i]) return;
  if (state.followed === i) runs[i].shown = !runs[i].shown;
  else { state.followed = i; runs[i].shown = true; }
  chosen();
}

function chosen() {
  byId("runs").querySelectorAll("button").forEach((button, i) => {
    button.setAttribute("aria-pressed", String(i === state.followed));
    button.classList.toggle("off", !runs[i].shown);
  });
  relook();
}

// -- what people do ---------------------------------------------------------------------------------------------------

function faster(steps) {
  const i = Math.min(Math.max(SPEEDS.indexOf(state.speed) + steps, 0), SPEEDS.length - 1);
  state.speed = SPEEDS[i];
  byId("speed").value = String(state.speed);
}

/** To the estimate before or after. */
function stepBy(count) {
  const path = runs[state.followed] ? runs[state.followed].path : truth;
  if (!path || !path.t.length) return;
  play(false);
  const i = Math.min(Math.max(before(path.t, state.t + 1e-9) + count, 0), path.t.length - 1);
  seek(path.t[i]);
}

function toggle(id) {
  if (byId(id).parentElement.hidden) return;
  byId(id).checked = !byId(id).checked;
  state.dirty = true;
}

const KEYS = {
  " ": () => play(!state.playing),
  ArrowLeft: (event) => seek(state.t - (event.shiftKey ? 10 : 1)),
  ArrowRight: (event) => seek(state.t + (event.shiftKey ? 10 : 1)),
  ",": () => stepBy(-1),
  ".": () => stepBy(1),
  "-": () => faster(-1),
  "+": () => faster(1),
  "=": () => faster(1),
  Home: () => seek(0),
  End: () => seek(data.duration_s),
  t: () => toggle("show-truth"),
  o: () => toggle("show-seen"),
  f: () => toggle("follow"),
  r: () => { state.zoom = 1; state.middle = null; byId("follow").checked = false; state.dirty = true; },
  "?": () => { byId("keys").hidden = !byId("keys").hidden; },
  Escape: () => { byId("keys").hidden = true; },
};

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.target.tagName === "SELECT" && key !== " ") return;
  if (key >= "1" && key <= "9") choose(Number(key) - 1);
  else if (KEYS[key]) KEYS[key](event);
  else return;
  event.preventDefault();
});
byId("play").addEventListener("click", () => play(!state.playing));
byId("play").addEventListener("keydown", (event) => { if (event.key === "Enter") event.stopPropagation(); });
byId("help").addEventListener("click", () => KEYS["?"]());
byId("slider").addEventListener("input", (event) => seek(event.target.value * data.duration_s));
byId("speed").addEventListener("change", (event) => { state.speed = Number(event.target.value); event.target.blur(); });
for (const id of ["show-truth", "show-seen", "follow"]) byId(id).addEventListener("change", () => { state.dirty = true; });

function dragging(canvas, move) {
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); move(event, true); });
  canvas.addEventListener("pointermove", (event) => { if (event.buttons) move(event, false); });
}

dragging(strips, (event) => {
  const share = (event.offsetX - LEFT) / (strips.clientWidth - LEFT - RIGHT);
  seek(share * data.duration_s);
});
dragging(field, (event, first) => {
  if (first) return;
  const { scale, middle } = view(field.clientWidth, field.clientHeight);
  byId("follow").checked = false;
  state.middle = [middle[0] - event.movementX / scale, middle[1] + event.movementY / scale];
  state.dirty = true;
});
field.addEventListener("wheel", (event) => {
  event.preventDefault();
  const was = view(field.clientWidth, field.clientHeight);
  const x = (event.offsetX - was.left) / was.scale, y = (was.top - event.offsetY) / was.scale;
  state.zoom = Math.min(Math.max(state.zoom * Math.exp(-0.0015 * event.deltaY), 0.3), 80);
  const shrink = was.scale / view(field.clientWidth, field.clientHeight).scale; // the point under the mouse stays
  state.middle = [x + shrink * (was.middle[0] - x), y + shrink * (was.middle[1] - y)];
  state.dirty = true;
}, { passive: false });
field.addEventListener("dblclick", () => KEYS.r());

// -- time -------------------------------------------------------------------------------------------------------------

let drawnAt = null;

function frame(now) {
  if (state.playing && drawnAt !== null) {
    seek(state.t + (state.speed * Math.min(now - drawnAt, 250)) / 1000);
    if (state.t >= data.duration_s) play(false);
  }
  drawnAt = now;
  if (state.dirty) {
    state.dirty = false;
    drawStrips();
    drawField();
    say();
  }
  requestAnimationFrame(frame);
}

strips.style.height = `${stripsHeight()}px`;
introduce();
chosen();
dark.addEventListener("change", restyle);
addEventListener("resize", () => { state.dirty = true; });
restyle();
const start = /[#&]t=([0-9.]+)/.exec(location.hash);
if (start) seek(Number(start[1]));
requestAnimationFrame(frame);
