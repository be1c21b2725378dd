// SPDX-License-Identifier: Apache-2.0
// The flock from above, at the time that is shown.

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

const rooms = new Map();

/** Return [lowest, highest] along the flight that the picture of the chosen member has room for, at all times. */
function roomAlong(each, depth) {
  const member = memberOf(each), key = `${chosen.run} ${member}`;
  if (!rooms.has(key)) {
    const ways = range(each.birds).map((i) => bounds(series(each.frame_position, member, i)));
    rooms.set(key, [Math.min(...ways.map((way) => way[0])), Math.max(...ways.map((way) => way[1]))]);
  }
  const [low, high] = rooms.get(key);
  return [Math.max(low, -1.25 * depth) - 1, Math.min(high, 0.25 * depth) + 1];
}

let most = null;

/** Return the drag saved, in percent, at the end of the colour scale: the largest of all runs, members and times. */
function mostSaved() {
  most ??= Math.max(1, ...data.runs.map((each) => 100 * bounds(values(each.frame_drag_reduction))[1]));
  return most;
}

/** Draw the birds of `scene`, and let `paint` fill or outline each. `place` gives its pixel, `least` its least size. */
function drawBirds(context, scene, place, scale, paint, least = 1) {
  scene.along.forEach((along, i) => {
    if (!Number.isFinite(along)) return;
    const [x, y] = place(scene.across[i], along), size = Math.max(least, scale * scene.ratio[i]);
    context.beginPath();
    for (const [aside, ahead] of data.outline) context.lineTo(x + size * aside, y - 1.4 * size * ahead);
    context.closePath();
    paint(i, x, y);
  });
}

function drawFormation() {
  const each = run(), scene = formationOf(each, chosen.frame), { context, width, height } = canvasOf(element("formation"));
  if (!width) return; // its tab is closed
  const half = Math.max(2, ...Array.from(scene.across, (y, i) => Math.abs(y) + scene.ratio[i])) + 0.3;
  const [low, high] = roomAlong(each, scene.depth);
  const margin = 56, scale = Math.min((width - margin) / (2 * half), height / (high - low));
  const middle = margin + (width - margin) / 2;
  const place = (across, along) => [middle + scale * across, height / 2 + scale * ((low + high) / 2 - along)];
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
    if (r === chosen.run || hidden.has(`run ${r}`)) return;
    context.strokeStyle = runStyle(r).colour;
    drawBirds(context, formationOf(other, frameOf(other)), place, scale, () => context.stroke());
  });
  const few = each.birds <= MOST_NAMED, birds = [];
  context.strokeStyle = css("--ink");
  context.textAlign = "center";
  context.textBaseline = "top";
  drawBirds(context, scene, place, scale, (i, x, y) => {
    const colour = colourOf(SAVED, scene.saved[i] / mostSaved());
    birds.push({ i, x, y, colour });
    context.fillStyle = colour;
    context.fill();
    if (!few) return;
    context.stroke();
    context.fillStyle = css("--quiet");
    if (scale > 11) context.fillText(i + 1, x, y + 0.35 * scale * scene.ratio[i] + 2);
  }, 3);
  charts.formation = { id: "formation", scales: { width, height }, read: (_, x, y) => readBird(scene, birds, x, y) };
  clearReading(charts.formation);
  tellFormation(scene, [low, high]);
}

/** Return what is to be told of the bird at a pixel; null if none is near. */
function readBird(scene, birds, px, py) {
  const off = (bird) => Math.hypot(bird.x - px, bird.y - py);
  const bird = birds.reduce((best, each) => (best && off(best) <= off(each) ? best : each), null);
  if (!bird || off(bird) > FAR) return null;
  const { i, x, y, colour } = bird;
  const texts = [`saves ${shown(scene.saved[i], 4)} % drag`, `${shown(scene.along[i], 5)} b along the flight`];
  return { x, title: `bird ${i + 1}`, rows: texts.map((text, k) => ({ line: { colour }, x, y, text, near: k === 0 })), more: 0 };
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
    context.fillText(`${shown(along, 3)} b`, margin - 8, y);
    context.setLineDash([1, 5]);
    stroke(context, [margin, width], [y, y]);
  }
  context.setLineDash([]);
}

/** Put the formation that is shown into words and a table, and mark its time in the curves. */
function tellFormation(scene, [low, high]) {
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
  element("best").textContent = `${shown(mostSaved(), 3)} % saved`;
  const ends = bounds(scene.along);
  say("formation", `${birds} bird${birds > 1 ? "s" : ""} from above at ${time}; the first and the last bird are ` +
    `${told(ends[1] - ends[0], 4)} b apart along the flight.`);
  table("formation", () => [["bird", "lateral (b)", "along the flight (b)", "drag saved (%)"],
    ...range(birds).map((i) => [i + 1, told(scene.across[i], 5), told(scene.along[i], 5), told(scene.saved[i], 4)])]);
  if (charts.speed) markTime();
}
