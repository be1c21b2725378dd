// SPDX-License-Identifier: Apache-2.0
// The curves against time: every quantity of every bird, of one run or of several.

const FLOCK = ["speed_std", "mean_drag_reduction"]; // quantities of a flock; the others are of each bird
const TIMED = ["speed", "spacing", "drag_reduction", ...FLOCK];
const UNITS = { speed: "U_{min}", spacing: "b", drag_reduction: "%", speed_std: "U_{min}", mean_drag_reduction: "%" };
const MARKS = "\u25cf\u25a0\u2715\u25b2"; // of the first, second, ... run
const MOST_NAMED = 45; // birds that are outlined and numbered
const MOST_LISTED = 21; // birds that each have a button in the legend

const span = () => [0, Math.max(...data.runs.map((each) => each.t_final)) || 1];

/** Return the time, in b/U_min, of the frame that is shown. */
const now = () => values(run().frame_time)[chosen.frame];

/** Return the frame of a run that is nearest to the time that is shown. */
const frameOf = (each) => (each === run() ? chosen.frame : nearest(values(each.frame_time), now()));

/** Return the name in the legend of a bird (an index) of the chosen run: its own, or that of its wing. */
function itemOf(bird) {
  if (run().birds <= MOST_LISTED) return `bird ${bird + 1}`;
  return ["left wing", "leader", "right wing"][Math.sign(bird - run().leader + 1) + 1];
}

/** Return the bird (an index) whose spacing is gap `k`: the one behind it. */
const behind = (each, k) => (k < each.leader - 1 ? k : k + 1);

const scaled = new Map();

/** Return a series of a run for the eye: in percent, and spacings positive towards the leader. */
function seriesFor(each, name, k) {
  const id = name.replace("frame_", ""), member = memberOf(each), key = `${data.runs.indexOf(each)} ${member} ${name} ${k}`;
  if (!scaled.has(key)) {
    const factor = (UNITS[id] === "%" ? 100 : 1) * (id === "spacing" && k >= each.leader - 1 ? -1 : 1);
    const list = series(each[name], member, k);
    scaled.set(key, factor === 1 ? list : list.map((value) => factor * value));
  }
  return scaled.get(key);
}

/** Return the curves of a quantity; those of the chosen run are the last, so they are on top. */
function timedLines(id) {
  const ofFlock = FLOCK.includes(id), order = range(data.runs.length).filter((r) => r !== chosen.run);
  return [...order, chosen.run].flatMap((r) => range(data.runs[r][id].shape[1]).map((k) => {
    const each = data.runs[r], bird = id === "spacing" ? behind(each, k) : k;
    const words = [several ? each.label : "", ofFlock ? "" : `bird ${bird + 1}`].filter(Boolean).join(", ");
    return {
      x: values(each.time), y: seriesFor(each, id, k), step: each.width > 1 ? 2 : 1, each, k, bird, thick: several && !ofFlock ? 1 : 1.4,
      name: words || "flock", item: several ? `run ${r}` : ofFlock ? undefined : itemOf(bird),
      ...(several || ofFlock ? runStyle(r) : wingStyle(bird)),
    };
  }).filter((line) => ofFlock || chosen.bird === null || line.bird === chosen.bird));
}

/**
 * Return the cells that tell of a line: at the start, now, least and largest. A curve may be decimated to extremes;
 * values at a time are those of frames. A run without a frame at the time that is shown tells of its nearest one.
 */
function cellsOf({ y, each, k }, id) {
  const frames = seriesFor(each, `frame_${id}`, k), frame = frameOf(each), time = values(each.frame_time)[frame];
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

/** Return why the chart of a quantity may have no curve. */
function whyEmpty(id) {
  const one = run().birds === 1;
  if (id === "spacing" && one) return "A single bird has no spacings.";
  if (id === "spacing" && chosen.bird === run().leader - 1) return `Bird ${chosen.bird + 1} leads: no bird is ahead of it.`;
  if (id === "speed_std" && one) return "A single bird has no spread of speeds.";
  if (id === "speed_std" && run().rows === 1) return "The bag has only the start, where all speeds are equal: their spread is 0, and a logarithmic axis has no 0.";
  if (id === "speed_std") return "All speeds are equal in all recorded rows: their spread is 0, and a logarithmic axis has no 0.";
  return "The bag has no finite values of this quantity.";
}

function drawTimed(id) {
  const lines = timedLines(id), first = FLOCK.includes(id) ? (several ? "run" : "flock") : several ? "run, bird" : "bird";
  const rules = id === "speed_std" ? [{ y: data.stable_below }] : [];
  chart(id, { lines, rules, log: id === "speed_std", unit: UNITS[id], axis: "time", place: "t =", wide: span(), empty: whyEmpty(id), seek });
  table(id, () => [
    [first, "at the start", `at t = ${told(now(), 7)}`, "least", "largest"],
    ...[...lines].sort((a, b) => a.each === b.each ? 0 : data.runs.indexOf(a.each) - data.runs.indexOf(b.each))
      .map((line) => [line.name, ...cellsOf(line, id)]),
  ]);
  const each = lines.map((line) => bounds(line.y));
  const low = Math.min(...each.map((pair) => pair[0])), high = Math.max(...each.map((pair) => pair[1]));
  const curves = lines.length === 1 ? "A curve" : `${lines.length} curves`;
  say(id, low <= high ? `${curves} against time, between ${told(low, 4)} and ${told(high, 4)}; the table below has the numbers.`
    : charts[id].empty);
}

/** Mark the time that is shown in the curves, and update their tables that are open. */
function markTime() {
  for (const id of TIMED) {
    const { scales } = charts[id] || {}, cursor = partOf(id, "cursor");
    cursor.style.display = scales && now() >= scales.wide[0] && now() <= scales.wide[1] ? "block" : "none";
    if (scales) cursor.style.left = `${scales.across(now())}px`;
  }
}

function drawCurves() {
  TIMED.forEach(drawTimed);
  markTime();
}
