// SPDX-License-Identifier: Apache-2.0
// The pictures of the report; follows chart.js in the same script.

const TIMED = ["speed", "spacing", "drag_reduction", "speed_std", "mean_drag_reduction"];
const MARKS = "\u25cf\u25a0\u2715\u25b2"; // of the first, second, ... run
const MOST_NAMED = 45; // birds that are outlined and numbered
const LEAST_OFF = 1e-12; // b; what is nearer to theory is drawn there

const span = () => [0, Math.max(...data.runs.map((each) => each.t_final)) || 1];

/** Return the index of what is nearest to `value` in the ascending `list`. */
function nearest(list, value) {
  let low = 0, high = list.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (list[middle] <= value) low = middle;
    else high = middle;
  }
  return high < 0 || value - list[low] <= list[high] - value ? low : high;
}

/** Return the time, in b/U_min, of the frame that is shown. */
const now = () => values(run().frame_time)[chosen.frame];

/** Return the frame of a run that is nearest to the time that is shown. */
const frameOf = (each) => (each === run() ? chosen.frame : nearest(values(each.frame_time), now()));

/**
 * Return the cells that tell of a line: at the start, now, least and largest. A curve may be decimated to extremes;
 * values at a time are those of frames. A run without a frame at the time that is shown tells of its nearest one.
 */
function cellsOf({ y, frames, each }) {
  const frame = frameOf(each), time = values(each.frame_time)[frame];
  const here = cell(frames[frame]) + (time === now() ? "" : ` (at t = ${told(time, 7)})`);
  const known = [...y, ...frames].filter((value) => !Number.isNaN(value));
  const [least, largest] = known.length ? [Math.min, Math.max].map((most) => known.reduce((a, b) => most(a, b))) : [NaN, NaN];
  return [cell(frames[0]), here, cell(least), cell(largest)];
}

/** Return a value as text; the numbers of this page end at 3.4e38, those of a flock that diverges do not. */
function cell(value) {
  if (Number.isFinite(value) || Number.isNaN(value)) return told(value);
  return value > 0 ? "above 3.4e38" : "below -3.4e38";
}

const cellsHead = () => ["at the start", `at t = ${told(now(), 7)}`, "least", "largest"];

/** Return the curves of a quantity of every bird (or gap) of the chosen run. */
function birdLines(id, factor) {
  const array = run()[id], count = array.shape[1], time = values(run().time), head = run().leader - 1;
  const towardsLeader = (k) => factor * (id === "spacing" && k >= head ? -1 : 1);
  const scaled = (from, k) => series(from, memberOf(run()), k).map((value) => towardsLeader(k) * value);
  return range(count).map((k) => ({
    x: time, y: scaled(array, k), frames: scaled(run()[`frame_${id}`], k), each: run(), ...wingStyle(k, count),
  }));
}

/** Return the curves of a quantity of all runs. */
function runLines(id, factor) {
  return data.runs.map((each, r) => {
    const scaled = (array) => series(array, memberOf(each), 0).map((value) => factor * value);
    return { x: values(each.time), y: scaled(each[id]), frames: scaled(each[`frame_${id}`]), each, ...runStyle(r) };
  });
}

/** Draw lines against time, and put them into words and a table whose rows are named `names`. */
function drawTimed(id, lines, what, names, more = {}) {
  chart(id, { lines, what: "time (b/U_min)", wide: span(), ...more });
  table(id, [what, ...cellsHead()], lines.map((line, k) => [names(k), ...cellsOf(line)]));
  const each = lines.map((line) => bounds(line.y));
  const low = Math.min(...each.map((pair) => pair[0])), high = Math.max(...each.map((pair) => pair[1]));
  const curves = lines.length === 1 ? "A curve" : `${lines.length} curves`;
  say(id, `${curves} against time, between ${told(low, 4)} and ${told(high, 4)}; the table below has the numbers.`);
}

function drawCurves() {
  const runName = (r) => data.runs[r].name;
  drawTimed("speed", birdLines("speed", 1), "bird", (k) => k + 1);
  drawTimed("spacing", birdLines("spacing", 1), "birds", (k) => `${k + 1} to ${k + 2}`);
  drawTimed("drag_reduction", birdLines("drag_reduction", 100), "bird", (k) => k + 1);
  drawTimed("speed_std", runLines("speed_std", 1), "run", runName, { log: true, rules: [{ y: data.stable_below }] });
  drawTimed("mean_drag_reduction", runLines("mean_drag_reduction", 100), "run", runName);
}

function drawProfile() {
  const gaps = range(run().birds - 1).map((k) => k + 1), head = run().leader - 1, member = memberOf(run());
  const towards = (list) => Array.from(list, (value, k) => (k >= head ? -value : value));
  const steady = towards(row(run().steady_spacing, member)), linear = towards(row(run().linear_spacing, member));
  const flown = data.runs.map((each) => towards(row(each.final_spacing, memberOf(each))));
  const lines = [{ x: gaps, y: steady, colour: css("--ink") }, { x: gaps, y: linear, colour: css("--alarm"), dash: [2, 4] }];
  lines.push(...flown.map((y, r) => ({ x: gaps, y, colour: runStyle(r).colour, mark: r })));
  chart("profile", { lines, what: "gap i, between birds i and i + 1", whole: true, tall: extent([steady, linear, flown[chosen.run]]) });
  table("profile", ["gap", ...data.runs.map((each) => `flown: ${each.name}`), "exact", "linear law"],
    gaps.map((gap, k) => [gap, ...flown.map((y) => told(y[k])), told(steady[k]), told(linear[k])]));
  const [exactly, linearly] = [row(run().off_exact, member), row(run().off_linear, member)];
  const farthest = (off, what) => {
    const most = bounds(off)[1];
    return Number.isFinite(most) ? `at most ${told(most, 2)} b from ${what}` : `no values of ${what}`;
  };
  const words = run().birds === 1 ? "A single bird has no spacings."
    : `Final spacings: ${farthest(exactly, "the exact steady state")}; ${farthest(linearly, "the linear law")}.`;
  say("profile", words);
  element("profile-words").textContent = words;
  const shown = (off) => Array.from(off, (value) => Math.max(value, LEAST_OFF));
  chart("residual", {
    lines: [{ x: gaps, y: shown(exactly), colour: runStyle(chosen.run).colour, mark: 0 },
      { x: gaps, y: shown(linearly), colour: css("--alarm"), mark: 2 }],
    log: true, what: "gap i, between birds i and i + 1", whole: true,
  });
  table("residual", ["gap", "from the exact steady state", "from the linear law"],
    gaps.map((gap, k) => [gap, told(exactly[k]), told(linearly[k])]));
  say("residual", words);
}

function drawEigenvalues() {
  const parts = data.runs.map((each) => [row(each.eigen_real, memberOf(each)), row(each.eigen_imag, memberOf(each))]);
  const lines = parts.map(([x, y], r) => ({ x, y, colour: runStyle(r).colour, mark: r }));
  chart("eigenvalues", { lines, what: "real part; imaginary part upwards", rules: [{ x: 0 }] });
  const [real, imaginary] = parts[chosen.run];
  table("eigenvalues", ["number", "real part", "imaginary part"],
    range(real.length).map((k) => [k + 1, told(real[k]), told(imaginary[k])]));
  const known = real.length > 0 && Number.isFinite(real[0]);
  const words = known ? `${real.length} eigenvalues; the largest real part is ${told(real[0], 4)}: ` +
    `disturbances ${real[0] < 0 ? "decay" : "do not decay"}.` : "No eigenvalues of a steady state are known.";
  say("eigenvalues", words);
  element("eigenvalues-words").textContent = words;
}

/**
 * Return where the birds are at a frame: along the flight from the leader, or from the bird in the middle if that is
 * far from the leader. `from` is the number of the bird at the origin.
 */
function formationOf(each, frame) {
  const count = each.birds, member = memberOf(each);
  const at = (array, k) => series(array, member, k)[frame];
  const along = range(count).map((i) => at(each.frame_position, i));
  const start = range(count).map((i) => series(each.frame_position, member, i)[0]);
  const known = along.filter(Number.isFinite).sort((a, b) => a - b);
  const middle = known.length ? known[known.length >> 1] : 0;
  const depth = bounds(start)[1] - bounds(start)[0] + 1.5;
  const origin = Math.abs(middle) > depth ? middle : 0;
  const from = Math.max(0, Number.isFinite(along[each.leader - 1]) && origin === 0 ? each.leader - 1 : along.indexOf(origin)) + 1;
  const saved = range(count).map((i) => 100 * at(each.frame_drag_reduction, i));
  const across = row(each.lateral, member), ratio = row(each.span_ratio, member);
  return { along: along.map((x) => x - origin), across, ratio, start, depth, saved, from };
}

/** Return [lowest, highest] along the flight that the picture of the chosen member has room for, at all times. */
function roomAlong(each, depth) {
  const member = memberOf(each);
  const ways = range(each.birds).map((i) => bounds(series(each.frame_position, member, i)));
  const low = Math.min(...ways.map((way) => way[0])), high = Math.max(...ways.map((way) => way[1]));
  return [Math.max(low, -1.25 * depth) - 1, Math.min(high, 0.25 * depth) + 1];
}

/** Draw the birds of `scene`, and let `paint` fill or outline each. `place` gives its pixel. */
function drawBirds(context, scene, place, scale, paint) {
  scene.along.forEach((along, i) => {
    if (!Number.isFinite(along)) return;
    const [x, y] = place(scene.across[i], along), size = scale * scene.ratio[i];
    context.beginPath();
    for (const [aside, ahead] of data.outline) context.lineTo(x + size * aside, y - 1.4 * size * ahead);
    context.closePath();
    paint(i, x, y);
  });
}

function drawFormation() {
  const each = run(), scene = formationOf(each, chosen.frame), { context, width, height } = canvasOf("formation");
  const half = Math.max(2, ...Array.from(scene.across, (y, i) => Math.abs(y) + scene.ratio[i])) + 0.3;
  const [low, high] = roomAlong(each, scene.depth);
  const margin = 34, scale = Math.min((width - margin) / (2 * half), height / (high - low));
  const middle = margin + (width - margin) / 2;
  const place = (across, along) => [middle + scale * across, height / 2 + scale * ((low + high) / 2 - along)];
  const best = Math.max(1, 100 * bounds(values(each.frame_drag_reduction))[1]); // %
  drawScale(context, place, [low, high], width, height, margin);
  context.lineWidth = 1;
  context.strokeStyle = css("--line");
  scene.along.forEach((along, i) => {
    const [x, from] = place(scene.across[i], scene.start[i]);
    stroke(context, [x, x], [from, place(0, along)[1]]);
  });
  context.strokeStyle = css("--control");
  drawBirds(context, { ...scene, along: scene.start }, place, scale, () => context.stroke());
  data.runs.forEach((other, r) => {
    if (r === chosen.run) return;
    context.strokeStyle = runStyle(r).colour;
    drawBirds(context, formationOf(other, frameOf(other)), place, scale, () => context.stroke());
  });
  const few = each.birds <= MOST_NAMED;
  context.strokeStyle = css("--ink");
  context.textAlign = "center";
  context.textBaseline = "top";
  drawBirds(context, scene, place, scale, (i, x, y) => {
    context.fillStyle = ramp(scene.saved[i] / best);
    context.fill();
    if (!few) return;
    context.stroke();
    context.fillStyle = css("--quiet");
    if (scale > 11) context.fillText(i + 1, x, y + 0.35 * scale * scene.ratio[i] + 2);
  });
  tellFormation(scene, [low, high], best);
}

/** Draw how far behind the leader is where. */
function drawScale(context, place, [low, high], width, height, margin) {
  context.fillStyle = css("--quiet");
  context.strokeStyle = css("--line");
  context.textAlign = "right";
  context.textBaseline = "middle";
  context.lineWidth = 1;
  for (const along of ticks(low, high, 6, false)) {
    const y = place(0, along)[1];
    if (y < 8 || y > height - 8) continue;
    context.fillText(told(along, 3), margin - 8, y);
    context.setLineDash([1, 5]);
    stroke(context, [margin, width], [y, y]);
  }
  context.setLineDash([]);
  context.textAlign = "left";
  context.fillText("b", 2, 8);
}

/** Put the formation that is shown into words and a table, and mark its time in the curves. */
function tellFormation(scene, [low, high], best) {
  const birds = run().birds, time = `t = ${told(now(), 7)}`;
  const away = range(birds).filter((i) => !(scene.along[i] >= low && scene.along[i] <= high));
  const places = away.slice(0, 8).map((i) => `${i + 1} at ${told(scene.along[i], 4)} b`).join(", ");
  const outside = away.length ? `Not in the picture: bird ${places}${away.length > 8 ? ", ..." : ""}.` : "";
  const lost = Number.isFinite(series(run().frame_position, memberOf(run()), run().leader - 1)[chosen.frame])
    ? "is far from the others" : "has no position";
  const origin = scene.from === run().leader ? ""
    : `The leader, bird ${run().leader}, ${lost}: positions are from bird ${scene.from}. `;
  element("away").textContent = origin + outside;
  element("now").textContent = time;
  element("time").setAttribute("aria-valuetext", time);
  element("best").textContent = `${told(best, 3)} % saved`;
  const ends = bounds(scene.along);
  say("formation", `${birds} birds from above at ${time}; the first and the last bird are ` +
    `${told(ends[1] - ends[0], 4)} b apart along the flight.`);
  table("formation", ["bird", "lateral (b)", "along the flight (b)", "drag saved (%)"],
    range(birds).map((i) => [i + 1, told(scene.across[i], 5), told(scene.along[i], 5), told(scene.saved[i], 4)]));
  for (const id of TIMED) {
    const canvas = element(id), cursor = canvas.nextElementSibling;
    cursor.style.display = "block";
    cursor.style.left = `${LEFT + (now() / span()[1]) * (canvas.clientWidth - LEFT - RIGHT)}px`;
  }
}

function drawAll() {
  drawFormation();
  drawCurves();
  drawProfile();
  drawEigenvalues();
}
