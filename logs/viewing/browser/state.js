// What is looked at, and how it is drawn: shared by all that draw.

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
