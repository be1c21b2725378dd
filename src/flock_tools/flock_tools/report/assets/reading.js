// SPDX-License-Identifier: Apache-2.0
// Reading of charts: values at the pointer or by arrow keys, zoom by dragging or by keys, legends that hide lines.

const MOST_READ = { wide: 7, narrow: 4 }; // values in a tip
const FAR = 30; // px; a mark farther from the pointer is not read
const DRAG = 6; // px; a shorter drag is a click

/** Return the text of the values of `line` at point `k`: of a bucket, the least and the largest. */
function valueAt(line, k, unit) {
  const step = line.step || 1, first = k - (k % step);
  const [low, high] = bounds(line.y, false, first, Math.min(first + step, line.y.length));
  if (!(low <= high)) return "no value";
  const least = shown(low), most = shown(high);
  return `${least === most ? least : `${least} to ${most}`} ${unit}`;
}

/** Return the text of the time (or gap) of a line at point `k`: of a bucket, its first and last. */
function placeAt(line, k) {
  const step = line.step || 1, first = k - (k % step), last = Math.min(first + step, line.x.length) - 1;
  const [from, to] = [shown(line.x[first]), shown(line.x[last])];
  return from === to ? from : `${from} to ${to}`;
}

/**
 * Return what a chart says at a pixel: {x, title, rows: [{line, x, y, text, near}], more}, or null for nothing. The rows
 * are the nearest lines; if there are several runs, those of the nearest bird in each run.
 */
function readingOf(drawn, px, py) {
  const { across, up, back, wide } = drawn.scales, x = back(px);
  const found = visible(drawn).map((line) => {
    const k = drawn.scatter ? nearestMark(drawn, line, px, py) : nearest(line.x, x);
    if (k < 0 || !Number.isFinite(line.y[k]) || line.x[k] < wide[0] || line.x[k] > wide[1]) return null;
    const [at, y] = [across(line.x[k]), up(line.y[k])];
    const beyond = !drawn.scatter && (x < line.x[0] || x > line.x[line.x.length - 1]) && Math.abs(at - px) > FAR;
    const off = drawn.scatter ? Math.hypot(at - px, y - py) : Math.abs(y - py);
    return beyond || !Number.isFinite(y) ? null : { line, k, x: at, y, off };
  }).filter(Boolean).sort((one, other) => one.off - other.off);
  if (!found.length || (drawn.scatter && found[0].off > FAR)) return null;
  const near = found[0], place = placeAt(near.line, near.k), most = MOST_READ[drawn.scales.width < 500 ? "narrow" : "wide"];
  const alike = several && near.line.bird !== undefined ? found.filter(({ line }) => line.bird === near.line.bird) : found;
  const rows = alike.slice(0, drawn.scatter ? 1 : most).sort((one, other) => one.y - other.y).map((each) => {
    const elsewhere = placeAt(each.line, each.k);
    const where = drawn.scatter || elsewhere === place ? "" : ` (at ${elsewhere})`;
    return { ...each, near: each === near, text: `${each.line.name}: ${valueAt(each.line, each.k, drawn.unit)}${where}` };
  });
  return { x: near.x, title: `${drawn.place} ${place}`, rows, more: drawn.scatter ? 0 : found.length - rows.length };
}

function nearestMark({ scales: { across, up } }, { x, y }, px, py) {
  let best = -1, least = Infinity;
  for (let k = 0; k < x.length; k++) {
    const off = Math.hypot(across(x[k]) - px, up(y[k]) - py);
    if (off < least) [best, least] = [k, off];
  }
  return best;
}

/** Show what a chart says at a pixel: the nearest line bold, the values in a tip. Return the reading. */
function readAt(drawn, px, py) {
  const { width, height } = drawn.scales, { context } = canvasOf(partOf(drawn.id, "over"));
  const reading = (drawn.read || readingOf)(drawn, px, py), tip = partOf(drawn.id, "tip");
  drawn.at = [px, py];
  tip.hidden = !reading;
  if (!reading) return null;
  context.strokeStyle = css("--quiet");
  context.lineWidth = 1;
  if (drawn.axis && !drawn.scatter) stroke(context, [reading.x, reading.x], [TOP, height - BOTTOM]);
  const title = document.createElement("b");
  write(title, reading.title);
  tip.replaceChildren(title);
  for (const each of reading.rows) {
    if (each.near && each.line.y && each.line.mark === undefined) {
      context.save();
      context.beginPath();
      context.rect(LEFT, TOP - 4, width - LEFT - RIGHT, height - TOP - BOTTOM + 8);
      context.clip();
      drawLine(context, drawn, { ...each.line, dash: [] }, 3);
      context.restore();
    }
    context.fillStyle = each.line.colour;
    context.beginPath();
    context.arc(each.x, each.y, each.near ? 5 : 3, 0, 2 * Math.PI);
    context.fill();
    const line = tip.appendChild(document.createElement("span"));
    line.appendChild(document.createElement("i")).style.background = each.line.colour;
    line.className = each.near ? "near" : "";
    write(line, each.text);
  }
  if (reading.more) tip.appendChild(document.createElement("span")).textContent = `and ${reading.more} more`;
  tip.style.left = reading.x < width / 2 ? `${reading.x + 12}px` : "auto";
  tip.style.right = reading.x < width / 2 ? "auto" : `${width - reading.x + 12}px`;
  return reading;
}

function clearReading(drawn) {
  drawn.at = null;
  partOf(drawn.id, "tip").hidden = true;
  canvasOf(partOf(drawn.id, "over"));
}

/** Mark the part of the axis between two pixels, which a drag chooses. */
function drawSelection({ id, scales: { height } }, from, to) {
  partOf(id, "tip").hidden = true;
  const { context } = canvasOf(partOf(id, "over"));
  context.globalAlpha = 0.25;
  context.fillStyle = css("--link");
  context.fillRect(Math.min(from, to), TOP, Math.abs(to - from), height - TOP - BOTTOM);
}

/** Say a reading to screen readers. */
function speak(reading) {
  const near = reading && reading.rows.find((each) => each.near);
  element("spoken").textContent = near ? `${reading.title}, ${near.text}`.replace(/_\{(.*?)\}/g, "_$1") : "";
}

/** Move the reading by `part` of the frame, or zoom about it; return whether `key` does something. */
function readByKey(drawn, key) {
  const { width, height, wide, back } = drawn.scales, middle = [(LEFT + width - RIGHT) / 2, height / 2];
  const [px, py] = drawn.at || middle, x = back(px);
  const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[key];
  const shrink = { "+": 0.5, "=": 0.5, "-": 2 }[key];
  if (move) {
    const inside = (value, least, most) => Math.min(Math.max(value, least), most);
    const to = [inside(px + (move[0] * (width - LEFT - RIGHT)) / 50, LEFT, width - RIGHT), inside(py + 8 * move[1], TOP, height - BOTTOM)];
    speak(readAt(drawn, ...to));
    drawn.at = to;
  } else if (shrink) {
    zoom(drawn.axis, wide.map((edge) => x + shrink * (edge - x)));
    drawn.at = [drawn.scales.across(x), py];
  } else if (key === "Escape" || key === "0") zoom(drawn.axis, null);
  else if (key === "Enter" && drawn.seek) drawn.seek(x);
  else return false;
  return true;
}

/** Let the reader read and zoom a chart with pointer and keys; `drawn` gives the chart as it is then. */
function makeReadable(id) {
  const canvas = element(id), drawn = () => charts[id];
  let from = null, dragged = false;
  canvas.addEventListener("pointerdown", (event) => {
    dragged = false;
    if (event.button || !drawn().axis) return;
    from = event.offsetX;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    dragged ||= from !== null && Math.abs(event.offsetX - from) > DRAG;
    if (dragged && from !== null) drawSelection(drawn(), from, event.offsetX);
    else readAt(drawn(), event.offsetX, event.offsetY);
  });
  canvas.addEventListener("pointerup", (event) => {
    if (dragged && from !== null) zoom(drawn().axis, [from, event.offsetX].map(drawn().scales.back));
    from = null;
  });
  for (const kind of ["pointercancel", "pointerleave", "blur"]) {
    canvas.addEventListener(kind, (event) => {
      if (event.pointerType === "touch" && kind === "pointerleave") return; // a tap shows the values until the next one
      from = null;
      clearReading(drawn());
    });
  }
  canvas.addEventListener("click", (event) => {
    if (dragged) return;
    drawn().seek?.(drawn().scales.back(event.offsetX));
    readAt(drawn(), event.offsetX, event.offsetY);
  });
  canvas.addEventListener("dblclick", () => drawn().axis && zoom(drawn().axis, null));
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !readByKey(drawn(), event.key)) return;
    event.preventDefault();
    event.stopPropagation();
  });
}

/** Make a button that shows and hides a line of the charts. */
function legendButton(item, name, { colour, dash }, label) {
  const button = document.createElement("button");
  button.type = "button";
  button.dataset.item = item;
  const line = button.appendChild(document.createElement("i")), kind = !dash.length ? "solid" : dash[0] > 2 ? "dashed" : "dotted";
  line.style.borderTop = `3px ${kind} ${colour}`;
  button.append(name);
  if (label) button.setAttribute("aria-label", label);
  return button;
}

/** Show or hide what a button of a legend stands for. */
function toggle(button) {
  const { item } = button.dataset;
  if (!hidden.delete(item)) hidden.add(item);
  markLegends();
  drawAll();
}

function markLegends() {
  document.querySelectorAll("[data-item]").forEach((each) => each.setAttribute("aria-pressed", !hidden.has(each.dataset.item)));
}
