// SPDX-License-Identifier: Apache-2.0
// Numbers, texts and colours of the report. All scripts of the page are one script, in the order of html.py.
"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const RUNS = 6; // colours, in report.css
const DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3]];
const SAVED = [[59, 111, 212], [181, 70, 143], [230, 134, 42]]; // drag saved; both ramps are also in report.css
const WING = [[0, 140, 126], [160, 128, 16], [200, 46, 88]]; // from tail to leader
const SUPERSCRIPTS = "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079";

/** What the reader has chosen. `bird` is an index, or null for all birds; `frame` is a frame of the chosen run. */
const chosen = { run: 0, member: 0, frame: 0, bird: null };

const decoded = new Map();

/** Return the values of `array`: base64 of little-endian 32-bit floats, decoded once. */
function values(array) {
  if (!decoded.has(array)) {
    const text = atob(array.values), view = new DataView(new ArrayBuffer(text.length));
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

/** Return the chosen member of `run`, or its first member if it has fewer. */
const memberOf = (run) => (chosen.member < run.members ? chosen.member : 0);
const run = () => data.runs[chosen.run];
const range = (count) => Array.from({ length: count }, (_, k) => k);
const several = data.runs.length > 1;

/** Return a number as text that programs can read. */
function told(value, digits = 6) {
  if (!Number.isFinite(value)) return "none";
  return value === 0 ? "0" : String(Number(value.toPrecision(digits)));
}

/** Return a number as text for people, with a power of ten where it is small or large (1.2 × 10⁻⁵), or `always`. */
function shown(value, digits = 7, always = false) {
  if (!Number.isFinite(value)) return "no value";
  if (value === 0 || (!always && Math.abs(value) >= 1e-3 && Math.abs(value) < 1e6)) return told(value, digits).replace("-", "\u2212");
  const [factor, power] = value.toExponential(digits - 1).split("e");
  const raised = power.replace("+", "").replace("-", "\u207b").replace(/\d/g, (digit) => SUPERSCRIPTS[digit]);
  const front = String(Number(factor)).replace("-", "\u2212");
  return front === "1" ? `10${raised}` : `${front} \u00d7 10${raised}`;
}

/** Put `text` at the end of `parent`; "_{min}" in it becomes a subscript. It is never markup. */
function write(parent, text) {
  text.split(/_\{(.*?)\}/).forEach((part, k) => {
    if (k % 2) parent.appendChild(document.createElement("sub")).textContent = part;
    else parent.append(part);
  });
}

/** Return least and largest of the finite values in `list`; infinities if there are none. `log`: of those above 0. */
function bounds(list, log = false, first = 0, end = list.length) {
  let low = Infinity, high = -Infinity;
  for (let k = first; k < end; k++) {
    const value = list[k];
    if (!Number.isFinite(value) || (log && value <= 0)) continue;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

/** Return the range of an axis for values between `low` and `high`, with some room. */
function roomy(low, high, log = false) {
  if (!(low <= high)) return log ? [0.1, 1] : [0, 1];
  if (log) return [low / 1.5, high * 1.5];
  const least = 4e-7 * Math.max(Math.abs(low), Math.abs(high)); // the resolution of 32-bit floats
  const room = high - low > least ? 0.05 * (high - low) : 0.05 * Math.abs(high) || 0.5;
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

/** Return the text of a tick: all `places` of an axis have powers of ten, or none, and digits that tell them apart. */
function tickText(place, places, log = false) {
  const most = Math.max(...places.map(Math.abs)), step = Math.abs(places[1] - places[0]) || most;
  const digits = log ? 1 : Math.min(8, Math.max(2, Math.ceil(Math.log10(most / step)) + 1));
  const plain = log ? Math.min(...places) >= 1e-3 && most < 1e4 : most >= 1e-3 && most < 1e6;
  if (Math.abs(place) < 1e-9 * most) return "0";
  return plain ? told(place, digits).replace("-", "\u2212") : shown(place, digits, true);
}

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

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Return the colour at `part`, from 0 to 1, of a ramp. */
function colourOf(ramp, part) {
  const place = Math.min(Math.max(Number.isFinite(part) ? part : 0, 0), 1) * (ramp.length - 1);
  const k = Math.min(Math.floor(place), ramp.length - 2);
  return `rgb(${ramp[k].map((from, c) => Math.round(from + (place - k) * (ramp[k + 1][c] - from))).join(",")})`;
}

/** Return how the line of a bird (an index) is drawn: its colour is its distance from the tail. */
function wingStyle(bird) {
  const head = run().leader - 1, right = bird > head;
  const fromTail = right ? run().birds - 1 - bird : bird;
  return { colour: colourOf(WING, fromTail / Math.max(1, head)), dash: right ? [4, 4] : [] };
}

const runStyle = (r) => ({ colour: css(`--run-${r % RUNS}`), dash: DASHES[r % DASHES.length] });
