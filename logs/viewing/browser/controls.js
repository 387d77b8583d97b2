// What people do, and time; the last part, it starts the player.

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
  h: () => toggle("show-hypotheses"),
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
for (const id of ["show-truth", "show-seen", "show-hypotheses", "follow"]) byId(id).addEventListener("change", () => { state.dirty = true; });

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
