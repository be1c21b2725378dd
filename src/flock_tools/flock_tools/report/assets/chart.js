// SPDX-License-Identifier: Apache-2.0
// Numbers, colours and charts of the report: plain JavaScript, no library.
// All numbers are in the element with the id "data"; pictures.js and report.js follow in the same script.
"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const LEFT = 60, RIGHT = 24, TOP = 10, BOTTOM = 40; // px around a chart; the cursor's CSS knows them
const RUNS = 6; // colours, in report.css
const DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3]];
const RAMP = [[59, 111, 212], [181, 70, 143], [230, 134, 42]]; // as in report.css; on light and dark
const chosen = { run: 0, member: 0, frame: 0 };

// Numbers ---------------------------------------------------------------------------------------------------

const decoded = new Map();

/** Return the values of `array`: base64 of little-endian 32-bit floats, decoded once. */
function values(array) {
  if (!decoded.has(array)) {
    const text = atob(array.values);
    const view = new DataView(new ArrayBuffer(text.length));
    for (let k = 0; k < text.length; k++) view.setUint8(k, text.charCodeAt(k));
    const numbers = new Float32Array(text.length / 4);
    for (let k = 0; k < numbers.length; k++) numbers[k] = view.getFloat32(4 * k, true);
    decoded.set(array, numbers);
  }
  return decoded.get(array);
}

/** Return one series (a bird, a gap) of a member, of an array of shape [members, series, points]. */
function series(array, member, which) {
  const [, count, points] = array.shape;
  const first = (member * count + which) * points;
  return values(array).subarray(first, first + points);
}

/** Return all numbers of a member, of an array of shape [members, count]. */
function row(array, member) {
  return values(array).subarray(member * array.shape[1], (member + 1) * array.shape[1]);
}

/** Return the member of `run` that is looked at: the one chosen, or the first where it has fewer. */
const memberOf = (run) => (chosen.member < run.members ? chosen.member : 0);
const run = () => data.runs[chosen.run];
const range = (count) => Array.from({ length: count }, (_, k) => k);

function told(value, digits = 6) {
  if (!Number.isFinite(value)) return "none";
  return value === 0 ? "0" : String(Number(value.toPrecision(digits)));
}

/** Return least and largest of what is finite in `list`; infinities of nothing. */
function bounds(list) {
  let low = Infinity, high = -Infinity;
  for (const value of list) {
    if (!Number.isFinite(value)) continue;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

/** Return the bounds of all `lists`, with some room; [0, 1] of nothing. `log`: of what is above 0. */
function extent(lists, log = false) {
  const each = lists.map((list) => bounds(log ? list.map((value) => (value > 0 ? value : NaN)) : list));
  const low = Math.min(...each.map((pair) => pair[0])), high = Math.max(...each.map((pair) => pair[1]));
  if (!(low <= high)) return log ? [0.1, 1] : [0, 1];
  if (log) return [low / 1.5, high * 1.5];
  const room = 0.05 * (high - low) || 0.05 * Math.abs(high) || 0.5;
  return [low - room, high + room];
}

/** Return round values between `low` and `high`, some `most` of them. */
function ticks(low, high, most, log) {
  if (log) {
    const first = Math.ceil(Math.log10(low)), last = Math.floor(Math.log10(high));
    const step = Math.max(1, Math.ceil((last - first + 1) / most));
    if (last - first < 2) {
      return range(last - first + 3).flatMap((k) => [1, 2, 5].map((factor) => factor * 10 ** (first - 1 + k)))
        .filter((value) => low <= value && value <= high);
    }
    return range(Math.max(0, Math.floor((last - first) / step) + 1)).map((k) => 10 ** (first + k * step));
  }
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= raw * 0.999);
  const first = Math.ceil(low / step);
  return range(Math.max(0, Math.floor(high / step) - first + 1)).map((k) => (first + k) * step);
}

// Colours ---------------------------------------------------------------------------------------------------

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function ramp(part) {
  const place = Math.min(Math.max(Number.isFinite(part) ? part : 0, 0), 1) * (RAMP.length - 1);
  const k = Math.min(Math.floor(place), RAMP.length - 2);
  return `rgb(${RAMP[k].map((from, c) => Math.round(from + (place - k) * (RAMP[k + 1][c] - from))).join(",")})`;
}

/** Return how the line of bird or gap `k` (from 0, of `count`) is drawn: colour by distance from the tail. */
function wingStyle(k, count) {
  const head = run().leader - 1;
  const fromTail = k <= head - (count < run().birds ? 1 : 0) ? k : count - 1 - k;
  return { colour: ramp(fromTail / Math.max(1, head)), dash: fromTail === k ? [] : [4, 4] };
}

const runStyle = (r) => ({ colour: css(`--run-${r % RUNS}`), dash: DASHES[r % DASHES.length] });

// Charts ----------------------------------------------------------------------------------------------------

/** Return the 2D context of a canvas, cleared, in CSS pixels, and its size. */
function canvasOf(id) {
  const canvas = element(id), scale = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  context.lineJoin = "round";
  return { context, width, height };
}

/**
 * Draw lines, or marks, in a frame with axes. A line is {x, y, colour, dash, mark}; `rules` are dotted lines at
 * a value of x or y; `what` says below what is across; `whole`: that is whole numbers.
 * `wide`, `tall`: what the frame is to show, where not all.
 */
function chart(id, { lines, log = false, what, wide = null, tall = null, whole = false, rules = [] }) {
  const { context, width, height } = canvasOf(id);
  const [left, right] = wide || extent(lines.map((line) => line.x).concat(rules.map((rule) => [rule.x])));
  const [low, high] = tall || extent(lines.map((line) => line.y).concat(rules.map((rule) => [rule.y])), log);
  const scaled = log ? Math.log10 : (value) => value;
  const across = (x) => LEFT + ((x - left) / (right - left || 1)) * (width - LEFT - RIGHT);
  const up = (y) => height - BOTTOM - ((scaled(y) - scaled(low)) / (scaled(high) - scaled(low))) * (height - TOP - BOTTOM);

  context.strokeStyle = css("--line");
  context.fillStyle = css("--quiet");
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const y of ticks(low, high, 6, log)) {
    stroke(context, [LEFT, width - RIGHT], [up(y), up(y)]);
    context.fillText(told(y, 4), LEFT - 6, up(y));
  }
  context.textAlign = "center";
  for (const x of ticks(left, right, width < 500 ? 4 : 8, false).filter((x) => !whole || Number.isInteger(x))) {
    context.fillText(told(x, 4), across(x), height - BOTTOM + 14);
  }
  context.fillText(what, (LEFT + width - RIGHT) / 2, height - 8);
  context.strokeStyle = css("--control");
  stroke(context, [LEFT, LEFT, width - RIGHT], [TOP, height - BOTTOM, height - BOTTOM]);
  context.save();
  context.beginPath();
  context.rect(LEFT, TOP - 4, width - LEFT - RIGHT + 4, height - TOP - BOTTOM + 8);
  context.clip();
  for (const line of lines) {
    context.strokeStyle = context.fillStyle = line.colour;
    context.lineWidth = 1.4;
    context.setLineDash(line.dash || []);
    const places = range(line.y.length).filter((k) => !log || !(line.y[k] <= 0));
    if (line.mark === undefined) stroke(context, places.map((k) => across(line.x[k])), places.map((k) => up(line.y[k])));
    else for (const k of places) mark(context, line.mark, across(line.x[k]), up(line.y[k]));
  }
  context.strokeStyle = css("--quiet");
  context.setLineDash([2, 3]);
  for (const { x, y } of rules) {
    if (x !== undefined) stroke(context, [across(x), across(x)], [TOP, height - BOTTOM]);
    if (y !== undefined) stroke(context, [LEFT, width - RIGHT], [up(y), up(y)]);
  }
  context.restore();
}

/** Draw a line through points in pixels; what is not finite is left open. */
function stroke(context, xs, ys) {
  let down = false;
  context.beginPath();
  for (let k = 0; k < xs.length; k++) {
    const known = Number.isFinite(xs[k]) && Number.isFinite(ys[k]);
    if (known && down) context.lineTo(xs[k], ys[k]);
    else if (known) context.moveTo(xs[k], ys[k]);
    down = known;
  }
  context.stroke();
}

/** Draw the mark of run `shape`: a circle, a square, a cross or a triangle. */
function mark(context, shape, x, y) {
  if (!Number.isFinite(x) || !Number.isFinite(y)) return;
  context.setLineDash([]);
  context.beginPath();
  if (shape % 4 === 0) context.arc(x, y, 3.5, 0, 2 * Math.PI);
  if (shape % 4 === 1) context.rect(x - 3.5, y - 3.5, 7, 7);
  const moves = { 2: [[-4, -4], [4, 4], null, [-4, 4], [4, -4]], 3: [[0, -4.5], [4, 3.5], [-4, 3.5], [0, -4.5]] };
  let down = false;
  for (const move of moves[shape % 4] || []) {
    if (move) context[down ? "lineTo" : "moveTo"](x + move[0], y + move[1]);
    down = move !== null;
  }
  context.stroke();
}

/** Put rows of cells into the table beside a picture, with text in them and never markup. */
function table(id, head, rows) {
  const cells = (list, kinds) => {
    const line = document.createElement("tr");
    list.forEach((text, k) => {
      const [kind, scope] = kinds(k);
      const cell = line.appendChild(document.createElement(kind));
      cell.textContent = text;
      if (scope) cell.scope = scope;
    });
    return line;
  };
  const top = document.createElement("thead"), body = document.createElement("tbody");
  top.append(cells(head, () => ["th", "col"]));
  body.append(...rows.map((list) => cells(list, (k) => (k === 0 ? ["th", "row"] : ["td"]))));
  element(`${id}-table`).replaceChildren(top, body);
}

const say = (id, words) => element(id).setAttribute("aria-label", words);
