// SPDX-License-Identifier: Apache-2.0
// The pictures of the report, and what its reader does; follows chart.js in the same script.

// The pictures ----------------------------------------------------------------------------------------------

/** Draw a quantity of every bird (or gap) of the chosen run against time. */
function drawBirds(id, factor, name) {
  const array = run()[id], count = array.shape[1], time = values(run().time), head = run().leader - 1;
  const towardsLeader = (k) => factor * (id === "spacing" && k >= head ? -1 : 1);
  const lines = range(count).map((k) => ({
    x: time, y: series(array, memberOf(run()), k).map((value) => towardsLeader(k) * value), ...wingStyle(k, count),
  }));
  chart(id, { lines, what: "time (b/U_min)", wide: span() });
  const rows = lines.map((line, k) => [name(k), told(line.y[0]), ...bounds(line.y).map((value) => told(value))]);
  table(id, [id === "spacing" ? "birds" : "bird", "at the start", "least", "largest"], rows);
  const each = lines.map((line) => bounds(line.y));
  const low = Math.min(...each.map((pair) => pair[0])), high = Math.max(...each.map((pair) => pair[1]));
  say(id, `${count} curves against time, between ${told(low, 4)} and ${told(high, 4)}; the table below has their numbers.`);
}

/** Draw a quantity of all runs against time. `log`: without the start, where a spread is only rounding. */
function drawRuns(id, factor, log, rules) {
  const lines = data.runs.map((each, r) => {
    const time = values(each.time);
    const y = series(each[id], memberOf(each), 0).map((value, k) => (log && time[k] <= 0 ? NaN : factor * value));
    return { x: time, y, ...runStyle(r) };
  });
  chart(id, { lines, log, rules, what: "time (b/U_min)", wide: span() });
  table(id, ["run", "at the start", "least", "largest"],
    lines.map((line, r) => [data.runs[r].name, told(line.y[0]), ...bounds(line.y).map((value) => told(value))]));
  const what = lines.length === 1 ? "A curve" : `Curves of ${lines.length} runs`;
  say(id, `${what} against time; the table below has the numbers.`);
}

const span = () => [0, Math.max(...data.runs.map((each) => each.t_final)) || 1];

function drawProfile() {
  const gaps = range(run().birds - 1).map((k) => k + 1), head = run().leader - 1;
  const towards = (list) => Array.from(list, (value, k) => (k >= head ? -value : value));
  const member = memberOf(run());
  const steady = towards(row(run().steady_spacing, member)), linear = towards(row(run().linear_spacing, member));
  const flown = data.runs.map((each) => towards(row(each.final_spacing, memberOf(each))));
  const lines = flown.map((y, r) => ({ x: gaps, y, colour: runStyle(r).colour, mark: r }));
  lines.push({ x: gaps, y: steady, colour: css("--ink") }, { x: gaps, y: linear, colour: css("--alarm"), dash: [2, 4] });
  chart("profile", { lines, what: "gap i, between birds i and i + 1" });
  table("profile", ["gap", ...data.runs.map((each) => `flown: ${each.name}`), "exact", "linear law"],
    gaps.map((gap, k) => [gap, ...flown.map((y) => told(y[k])), told(steady[k]), told(linear[k])]));
  const off = Math.max(...flown[chosen.run].map((value, k) => Math.abs(value - steady[k])));
  say("profile", `Spacings of ${gaps.length} gaps as flown and in theory. ` +
    `The largest distance of the chosen run from the exact state is ${told(off, 3)} b.`);
}

function drawEigenvalues() {
  const parts = data.runs.map((each) => [row(each.eigen_real, memberOf(each)), row(each.eigen_imag, memberOf(each))]);
  const lines = parts.map(([x, y], r) => ({ x, y, colour: runStyle(r).colour, mark: r }));
  chart("eigenvalues", { lines, what: "real part; imaginary part upwards", rules: [{ x: 0 }] });
  const [real, imaginary] = parts[chosen.run];
  table("eigenvalues", ["real part", "imaginary part"], range(real.length).map((k) => [told(real[k]), told(imaginary[k])]));
  say("eigenvalues", `${real.length} eigenvalues; the largest real part is ${told(real.length ? real[0] : NaN, 4)}.`);
}

/** Return where the birds are at a frame: along the flight from the leader, or from the middle if it has left. */
function formationOf(each, frame) {
  const count = each.birds, member = memberOf(each);
  const at = (array, k) => series(array, member, k)[frame];
  const along = range(count).map((i) => at(each.frame_position, i));
  const start = range(count).map((i) => series(each.frame_position, member, i)[0]);
  const known = along.filter(Number.isFinite).sort((a, b) => a - b);
  const middle = known.length ? known[known.length >> 1] : 0;
  const depth = bounds(start)[1] - bounds(start)[0] + 3;
  const origin = Math.abs(middle) > depth ? middle : 0;
  const saved = range(count).map((i) => 100 * at(each.frame_drag_reduction, i));
  const across = row(each.lateral, member), ratio = row(each.span_ratio, member);
  return { along: along.map((x) => x - origin), across, ratio, start, depth, saved };
}

function drawFormation() {
  const each = run(), scene = formationOf(each, chosen.frame), { context, width, height } = canvasOf("formation");
  const half = Math.max(5, ...Array.from(scene.across, (y, i) => Math.abs(y) + scene.ratio[i])) + 0.5;
  const bottom = -scene.depth, top = 3;
  const scale = Math.min(width / (2 * half), height / (top - bottom));
  const bird = (across, along, ratio) => {
    context.beginPath();
    for (const [x, y] of OUTLINE) {
      context.lineTo(width / 2 + scale * (across + ratio * x), scale * (top - along - 1.4 * ratio * y));
    }
    context.closePath();
  };
  const best = Math.max(1e-9, bounds(values(each.frame_drag_reduction))[1]) * 100;
  const time = values(each.frame_time)[chosen.frame];
  const draw = (scenery, paint) => scenery.along.forEach((x, i) => {
    if (!Number.isFinite(x)) return;
    bird(scenery.across[i], x, scenery.ratio[i]);
    paint(i);
  });
  context.lineWidth = 1;
  context.strokeStyle = css("--line");
  draw({ ...scene, along: scene.start }, () => context.stroke());
  data.runs.forEach((other, r) => {
    if (r === chosen.run) return;
    const times = values(other.frame_time);
    const nearest = times.reduce((best, t, k) => (Math.abs(t - time) < Math.abs(times[best] - time) ? k : best), 0);
    context.strokeStyle = runStyle(r).colour;
    draw(formationOf(other, nearest), () => context.stroke());
  });
  context.strokeStyle = css("--ink");
  draw(scene, (i) => {
    context.fillStyle = ramp(scene.saved[i] / best);
    context.fill();
    if (each.birds <= 45) context.stroke();
  });
  const away = range(each.birds).filter((i) => !(scene.along[i] >= bottom && scene.along[i] <= top));
  const places = away.slice(0, 8).map((i) => `${i + 1} at ${told(scene.along[i], 4)} b`).join(", ");
  element("away").textContent = away.length ? `Not in the picture: bird ${places}${away.length > 8 ? ", ..." : ""}` : "";
  element("now").textContent = `t = ${told(time, 5)}`;
  element("time").setAttribute("aria-valuetext", `t = ${told(time, 5)}`);
  const depth = bounds(scene.along);
  say("formation", `${each.birds} birds from above at t = ${told(time, 5)}; ` +
    `from the first to the last they are ${told(depth[1] - depth[0], 4)} b apart along the flight.`);
  if (timer === null) table("formation", ["bird", "lateral (b)", "along the flight (b)", "drag saved (%)"],
    range(each.birds).map((i) => [i + 1, told(scene.across[i], 5), told(scene.along[i], 5), told(scene.saved[i], 4)]));
  document.querySelectorAll(".cursor").forEach((cursor) => {
    const canvas = cursor.previousElementSibling;
    if (!["speed", "spacing", "drag_reduction", "speed_std", "mean_drag_reduction"].includes(canvas.id)) return;
    cursor.style.display = "block";
    cursor.style.left = `${LEFT + (time / span()[1]) * (canvas.clientWidth - LEFT - RIGHT)}px`;
  });
}

function drawAll() {
  drawFormation();
  drawBirds("speed", 1, (k) => k + 1);
  drawBirds("spacing", 1, (k) => `${k + 1} to ${k + 2}`);
  drawBirds("drag_reduction", 100, (k) => k + 1);
  drawRuns("speed_std", 1, true, [{ y: data.stable_below }]);
  drawRuns("mean_drag_reduction", 100, false, []);
  drawProfile();
  drawEigenvalues();
}

// What the reader does --------------------------------------------------------------------------------------

function options(select, names) {
  select.replaceChildren(...names.map((name, k) => new Option(name, k)));
}

function chooseRun(which) {
  chosen.run = which;
  const names = range(run().members).map((m) => `${m + 1}${run().member_names[m]}`);
  chosen.member = memberOf(run());
  options(element("member"), names);
  element("member").value = chosen.member;
  element("time").max = run().frame_time.shape[0] - 1;
  show(run().frame_time.shape[0] - 1);
  drawAll();
}

function show(frame) {
  chosen.frame = Math.max(0, Math.min(frame, run().frame_time.shape[0] - 1));
  element("time").value = chosen.frame;
}

let timer = null;

function play(on) {
  clearInterval(timer);
  timer = null;
  element("play").textContent = on ? "Pause" : "Play";
  if (!on) {
    drawFormation();
    return;
  }
  if (chosen.frame === run().frame_time.shape[0] - 1) show(0);
  timer = setInterval(() => {
    show(chosen.frame + 1);
    drawFormation();
    if (chosen.frame === run().frame_time.shape[0] - 1) play(false);
  }, 50);
}

if (data.runs.length > 1) {
  data.runs.forEach((each, r) => {
    const name = element("legend").appendChild(document.createElement("span"));
    name.style.borderColor = runStyle(r).colour;
    name.textContent = `${"\u25cf\u25a0\u2715\u25b2"[r % 4]} ${each.name}`;
  });
}
options(element("run"), data.runs.map((each) => each.name));
element("run").addEventListener("change", (event) => { play(false); chooseRun(Number(event.target.value)); });
element("member").addEventListener("change", (event) => { chosen.member = Number(event.target.value); drawAll(); });
element("time").addEventListener("input", (event) => { play(false); show(Number(event.target.value)); drawFormation(); });
element("play").addEventListener("click", () => play(timer === null));
document.addEventListener("keydown", (event) => {
  const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (by === undefined || event.target !== document.body) return;
  play(false);
  show(chosen.frame + by);
  drawFormation();
});
window.addEventListener("resize", drawAll);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
chooseRun(0);
