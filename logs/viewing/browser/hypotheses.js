// Where the robot may be: arrows on the field, weights and P(mirrored) over time.

const ARROW_FROM = 0.01; // fainter ones nobody sees
const unsure = runs.filter((run) => run.hypotheses);

/** The run whose hypotheses are shown: the followed one, if it has some. */
function doubting() {
  const has = (run) => run && run.shown && run.hypotheses;
  return has(runs[state.followed]) ? runs[state.followed] : unsure.find(has);
}

/** Rows of the hypotheses at a time; null before the first. */
function rowsAt(several, t) {
  const i = before(several.t, t);
  return i < 0 ? null : { i, first: i ? several.ends[i - 1] : 0, end: several.ends[i] };
}

function drawArrows(pen, run, X, Y, scale) {
  const several = run.hypotheses, rows = rowsAt(several, state.t);
  if (!rows) return;
  const r = Math.min(Math.max(0.3 * scale, 16), 44);
  pen.strokeStyle = run.shade;
  pen.lineWidth = 2.4;
  for (let k = rows.first; k < rows.end; k++) {
    if (several.weight[k] < ARROW_FROM) continue;
    const [x, y, heading] = several.pose.subarray(3 * k, 3 * k + 3);
    pen.save();
    pen.translate(X(x), Y(y));
    pen.rotate(-heading);
    pen.globalAlpha = 0.15 + 0.75 * several.weight[k];
    pen.beginPath();
    pen.moveTo(-0.5 * r, 0); pen.lineTo(r, 0);
    pen.moveTo(0.6 * r, -0.3 * r); pen.lineTo(r, 0); pen.lineTo(0.6 * r, 0.3 * r);
    pen.stroke();
    pen.restore();
  }
  pen.globalAlpha = 1;
}

/** Weights from the bottom, the oldest first, lost on top; P(mirrored) as a line over them. */
function drawWeights(pen, run, X, top, height, end) {
  const { t, mirrored, lost, ends, weight, colour } = run.hypotheses;
  const Y = (v) => top + height * (1 - Math.min(Math.max(v, 0), 1));
  for (let i = 0; i < t.length; i++) {
    const left = Math.floor(X(t[i])), wide = Math.ceil(X(i + 1 < t.length ? t[i + 1] : end)) - left; // without seams
    let below = 0;
    for (let k = i ? ends[i - 1] : 0; k < ends[i]; k++) {
      pen.fillStyle = HYPOTHESES[colour[k]] || style.line;
      pen.fillRect(left, Y(below + weight[k]), wide, Y(below) - Y(below + weight[k]));
      below += weight[k];
    }
    pen.fillStyle = style.line;
    pen.fillRect(left, Y(1 - lost[i]), wide, Math.max(Y(below) - Y(1 - lost[i]), 0));
    pen.fillStyle = style.truth;
    pen.fillRect(left, Y(1), wide, Y(1 - lost[i]) - Y(1));
  }
  if (!mirrored.some((p) => p > 1e-6)) return;
  for (const [colour, width] of [[style.back, 4], [style.ink, 1.6]]) {
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.beginPath();
    for (let i = 0; i < t.length; i++) {
      pen.lineTo(X(t[i]), Y(mirrored[i]));
      pen.lineTo(i + 1 < t.length ? X(t[i + 1]) : X(end), Y(mirrored[i]));
    }
    pen.stroke();
  }
}

function drawEvents(pen, run, X, top, height) {
  for (const [t, kind] of run.hypotheses.events) {
    const [colour, rise, through] = MARKS[kind] || MARKS.start;
    pen.fillStyle = colour;
    pen.fillRect(X(t) - 0.75, top - rise - 3, 1.5, 4);
    if (!through) continue;
    pen.globalAlpha = 0.8;
    pen.fillRect(X(t) - 0.5, top, 1, height);
    pen.globalAlpha = 1;
    pen.beginPath();
    pen.arc(X(t), top - 4, 3.2, 0, 7);
    pen.fill();
  }
}

/** Rows for the table of numbers. */
function doubts(run) {
  const several = run.hypotheses, rows = rowsAt(several, state.t);
  if (!rows) return [];
  let best = 0;
  for (let k = rows.first; k < rows.end; k++) best = Math.max(best, several.weight[k]);
  const percent = (p) => `${(100 * p).toFixed(p > 0.999 || p < 0.01 ? 2 : 1)} %`;
  const out = [["likeliest", percent(best), `of ${rows.end - rows.first}`]];
  out.push(["P(mirrored), lost", percent(several.mirrored[rows.i]), percent(several.lost[rows.i])]);
  const last = several.events.filter(([t, kind]) => t <= state.t && MARKS[kind] && MARKS[kind][2]).pop();
  if (last) out.push([`last ${last[1]}`, clock(last[0]), ""]);
  return out;
}
