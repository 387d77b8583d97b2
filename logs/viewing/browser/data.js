"use strict";
// What logs/viewing/page_data.py put into the page. All times are seconds since its origin.

const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16, 32, 64];
const TRAIL_S = 8;
const FONT = "11px system-ui, sans-serif";
const SEEN_FOR_S = 0.4; // how long what was seen stays in sight after its image
const BREAK_S = 2; // no curve is drawn over a longer gap that is ten usual steps too
const HYPOTHESES = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#7b61b5", "#c9bc2b"]; // the report's
const MARKS = { // how an event is marked: colour, height in its strip, and whether its line goes through the panel
  start: ["#57606a", 2, true], split: ["#0072b2", 10, false], merge: ["#b0b6bd", 6, false],
  decision: ["#009e73", 2, true], recovery: ["#d55e00", 2, true],
};
const KINDS = { landmark: 0, bearing: 1, line: 2 };
const PANELS = [
  { title: "position error [m]", column: 0, sigma: 3, scale: 1 },
  { title: "heading error [°]", column: 1, sigma: 4, scale: 180 / Math.PI },
  { title: "NEES", column: 2, sigma: null, scale: 1, log: true },
];

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

function several(packed) {
  const { t, mirrored, lost, ends, pose, weight, colour, events } = packed;
  const [times, half, nowhere, behind] = [t, mirrored, lost, ends].map(decode);
  return { t: times, mirrored: half, lost: nowhere, ends: behind, pose: decode(pose), weight: decode(weight), colour: decode(colour), events };
}

const truth = data.truth && trajectory(data.truth);
const runs = data.runs.map((run) => ({
  ...run,
  shown: true,
  path: trajectory(run.trajectory),
  hypotheses: run.hypotheses && several(run.hypotheses),
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
