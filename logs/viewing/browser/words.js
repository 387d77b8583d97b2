// Everything that is said in words: title, runs, numbers.

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
  if (run && run.hypotheses) rows.push(...doubts(run));
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
  if (!unsure.length) byId("show-hypotheses").parentElement.hidden = true;
  if (data.field && data.field.symmetric && truth === null && !unsure.length)
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
