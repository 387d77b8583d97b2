// Errors and NEES over time, and hypotheses below them.

const LEFT = 64, RIGHT = 10, PANEL = 74, GAP = 17, FOOT = 17, EVENTS = 15;
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

const stacked = panels.length + (unsure.length ? 1 : 0);
const stripsHeight = () => (stacked ? stacked * (PANEL + GAP) + (unsure.length ? EVENTS : 0) + FOOT : 26);

function drawStrips() {
  const { pen, width } = prepared(strips, layers.strips, 0, drawPanels);
  pen.fillStyle = style.now;
  const x = LEFT + ((width - LEFT - RIGHT) * state.t) / (data.duration_s || 1);
  pen.fillRect(x - 0.75, stacked ? GAP - 2 : 0, 1.5, stacked ? stripsHeight() - FOOT - GAP + 4 : 12);
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
  if (unsure.length) drawDoubts(pen, width, X);
  pen.fillStyle = style.soft;
  pen.textAlign = "center";
  const step = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 3600].find((s) => X(s) - X(0) > 70) || 7200;
  for (let t = 0; t <= data.duration_s; t += step) pen.fillText(short(t), Math.max(X(t), 20), stripsHeight() - 4);
}

function drawDoubts(pen, width, X) {
  const top = GAP + panels.length * (PANEL + GAP) + EVENTS, run = doubting();
  pen.fillStyle = style.panel;
  pen.fillRect(LEFT, top, width - LEFT - RIGHT, PANEL);
  pen.fillStyle = style.soft;
  pen.textAlign = "left";
  pen.fillText(`hypotheses${run ? ` of ${run.name}` : ""}   grey: lost; line: P(mirrored)`, LEFT, top - EVENTS - 5);
  pen.textAlign = "right";
  for (const v of [0, 0.5, 1]) pen.fillText(v, LEFT - 6, top + PANEL * (1 - v) + 4);
  if (!run) return;
  pen.save();
  pen.beginPath();
  pen.rect(LEFT - 4, top - EVENTS, width - LEFT - RIGHT + 8, PANEL + EVENTS);
  pen.clip();
  drawWeights(pen, run, X, top, PANEL, data.duration_s);
  drawEvents(pen, run, X, top, PANEL);
  pen.restore();
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
