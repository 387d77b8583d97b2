// The field from above.

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
  if (byId("show-hypotheses").checked) for (const run of shown()) if (run.hypotheses) drawArrows(pen, run, X, Y, scale);
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
