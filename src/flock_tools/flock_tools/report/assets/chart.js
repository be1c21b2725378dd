// SPDX-License-Identifier: Apache-2.0
// Charts: lines and marks in a frame with axes, zoomed along the horizontal axis. reading.js reads values from them.

const LEFT = 72, RIGHT = 20, TOP = 10, BOTTOM = 22; // px around a chart; the CSS of .cursor knows TOP and BOTTOM
const LAW = 4; // the mark of the linear law
const charts = {}; // by id: what `chart` was given, and `scales`
const zooms = { time: null, gap: null, real: null }; // by axis: [from, to], or null for all
const hidden = new Set(); // names of what the legends hide

/** Return the 2D context of a canvas, cleared, in CSS pixels, and its size. */
function canvasOf(canvas) {
  const scale = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  context.lineJoin = "round";
  return { context, width, height };
}

/** Return the child of a chart's frame with a class: its overlay, tip, cursor or sentence. */
const partOf = (id, name) => element(id).parentElement.querySelector(`.${name}`);

/**
 * Draw a chart. `lines` are {x, y, colour, dash, mark, name, item, step, aside}: `item` is what the legend calls the
 * line; `step` is the number of points per bucket, as in reading.js; `aside`: the vertical axis does not make room for it.
 * `axis` is a key of `zooms`; `wide` its whole range, where the lines do not tell; `whole`: it has whole numbers only.
 * `rules` are dotted lines at a value of x or y; `unit` that of y; `log`: y is logarithmic; `empty`: a sentence that
 * says why there may be no values.
 */
function chart(id, spec) {
  charts[id] = { rules: [], ...spec, id };
  draw(charts[id]);
}

const visible = (drawn) => drawn.lines.filter((line) => !hidden.has(line.item));

/** Return the whole range of the horizontal axis of a chart. */
function wholeRange(drawn) {
  if (drawn.wide) return drawn.wide;
  const each = drawn.lines.map((line) => line.x).concat(drawn.rules.map((rule) => [rule.x])).map((list) => bounds(list));
  return roomy(Math.min(...each.map((pair) => pair[0])), Math.max(...each.map((pair) => pair[1])));
}

/** Return [first, end) of the points of a line with ascending x that a range needs: one more on each side. */
function pointsIn({ x, mark }, [from, to]) {
  if (mark !== undefined || x.length < 3) return [0, x.length];
  const first = nearest(x, from), last = nearest(x, to);
  return [Math.max(0, first - 2), Math.min(x.length, last + 3)];
}

/** Return the range of the vertical axis for the points of `lines` between `from` and `to`. */
function tallRange(drawn, lines, [from, to], zoomed) {
  let low = Infinity, high = -Infinity;
  const reach = (list, first, end) => {
    const [least, most] = bounds(list, drawn.log, first, end);
    low = Math.min(low, least);
    high = Math.max(high, most);
  };
  for (const line of lines.some((each) => !each.aside) ? lines.filter((each) => !each.aside) : lines) {
    if (line.mark === undefined) reach(line.y, ...pointsIn(line, [from, to]));
    else line.y.forEach((_, k) => line.x[k] >= from && line.x[k] <= to && reach(line.y, k, k + 1));
  }
  if (!zoomed) for (const rule of drawn.rules) reach([rule.y]);
  return roomy(low, high, drawn.log);
}

function draw(drawn) {
  const { context, width, height } = canvasOf(element(drawn.id));
  if (!width) return; // its tab is closed
  const lines = visible(drawn), zoom = zooms[drawn.axis], wide = zoom || wholeRange(drawn);
  const [low, high] = tallRange(drawn, lines, wide, zoom !== null);
  const scaled = drawn.log ? Math.log10 : (value) => value, floor = scaled(low), tall = scaled(high) - floor;
  const across = (x) => LEFT + ((x - wide[0]) / (wide[1] - wide[0] || 1)) * (width - LEFT - RIGHT);
  const up = (y) => height - BOTTOM - ((scaled(y) - floor) / tall) * (height - TOP - BOTTOM);
  const back = (px) => wide[0] + ((px - LEFT) / (width - LEFT - RIGHT)) * (wide[1] - wide[0]);
  drawn.scales = { across, up, back, wide, width, height };
  drawAxes(context, drawn, [low, high]);
  context.save();
  context.beginPath();
  context.rect(LEFT - 5, TOP - 5, width - LEFT - RIGHT + 10, height - TOP - BOTTOM + 10);
  context.clip();
  let points = 0;
  for (const line of lines) points += drawLine(context, drawn, line);
  context.strokeStyle = css("--quiet");
  context.setLineDash([2, 3]);
  context.lineWidth = 1.4;
  for (const { x, y } of drawn.rules) {
    if (x !== undefined) stroke(context, [across(x), across(x)], [TOP, height - BOTTOM]);
    if (y !== undefined) stroke(context, [LEFT, width - RIGHT], [up(y), up(y)]);
  }
  context.restore();
  if (!points && !zoom) context.clearRect(0, 0, width, height); // axes without values would mislead
  tellEmpty(drawn, points, lines.length);
  clearReading(drawn);
}

function drawAxes(context, { scales: { across, up, wide, width, height }, log, whole }, [low, high]) {
  context.strokeStyle = css("--line");
  context.fillStyle = css("--quiet");
  context.textAlign = "right";
  context.textBaseline = "middle";
  const heights = ticks(low, high, 6, log);
  for (const y of heights) {
    stroke(context, [LEFT, width - RIGHT], [up(y), up(y)]);
    context.fillText(tickText(y, heights, log), LEFT - 6, up(y));
  }
  context.textAlign = "center";
  const places = ticks(wide[0], wide[1], width < 500 ? 4 : 8, false).filter((x) => !whole || Number.isInteger(x));
  for (const x of places) {
    const text = tickText(x, places), half = context.measureText(text).width / 2;
    context.fillText(text, Math.min(across(x), width - half), height - BOTTOM + 14);
  }
  context.strokeStyle = css("--control");
  stroke(context, [LEFT, LEFT, width - RIGHT], [TOP, height - BOTTOM, height - BOTTOM]);
}

/** Draw a line, or its marks; return the number of its points that are in the frame. */
function drawLine(context, { scales: { across, up, wide }, log }, line, thick = line.thick || 1.4) {
  const [first, end] = pointsIn(line, wide);
  let inside = 0;
  const xs = [], ys = [];
  for (let k = first; k < end; k++) {
    const y = log && !(line.y[k] > 0) ? NaN : line.y[k];
    xs.push(across(line.x[k]));
    ys.push(up(y));
    inside += Number.isFinite(y) && line.x[k] >= wide[0] && line.x[k] <= wide[1];
  }
  context.strokeStyle = line.colour;
  context.lineWidth = thick;
  context.setLineDash(line.dash || []);
  if (line.mark === undefined) stroke(context, xs, ys);
  if (line.mark !== undefined || end - first === 1) xs.forEach((x, k) => mark(context, line.mark || 0, x, ys[k]));
  return inside || (end - first > 1 && line.mark === undefined && Number(ys.some(Number.isFinite)));
}

/** Show a sentence in an empty chart that says why it is empty. */
function tellEmpty(drawn, points, lines) {
  const sentence = partOf(drawn.id, "empty");
  sentence.hidden = points > 0;
  if (points) return;
  if (!lines && drawn.lines.length) sentence.textContent = "The legend hides all curves: choose one there.";
  else if (zooms[drawn.axis]) sentence.textContent = "There are no values in this part of the axis: reset the zoom.";
  else sentence.textContent = drawn.empty;
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

/** Draw a mark: a circle, a square, a cross or a triangle for the runs, a plus sign for the linear law. */
function mark(context, shape, x, y) {
  if (!Number.isFinite(x) || !Number.isFinite(y)) return;
  context.setLineDash([]);
  context.beginPath();
  if (shape === 0) context.arc(x, y, 3.5, 0, 2 * Math.PI);
  if (shape === 1) context.rect(x - 3.5, y - 3.5, 7, 7);
  const moves = {
    2: [[-4, -4], [4, 4], null, [-4, 4], [4, -4]],
    3: [[0, -4.5], [4, 3.5], [-4, 3.5], [0, -4.5]],
    [LAW]: [[-5, 0], [5, 0], null, [0, -5], [0, 5]],
  };
  let down = false;
  for (const move of moves[shape] || []) {
    if (move) context[down ? "lineTo" : "moveTo"](x + move[0], y + move[1]);
    down = move !== null;
  }
  context.stroke();
}

/** Show `wide` of an axis in all charts that have it, or all of it if `wide` is null. */
function zoom(axis, wide) {
  const those = Object.values(charts).filter((drawn) => drawn.axis === axis);
  if (wide) {
    const [first, last] = wholeRange(those[0]), least = Math.max(1e-6 * (last - first), 1e-12);
    const from = Math.max(first, Math.min(...wide)), to = Math.min(last, Math.max(...wide));
    if (to - from < least) return;
    wide = from === first && to === last ? null : [from, to];
  }
  zooms[axis] = wide;
  those.forEach(draw);
  zoomed(axis);
}

/** Fill a table that stands beside a picture, if it is open: `rows` gives its head and its rows. */
function table(id, rows) {
  const place = element(`${id}-table`), details = place.closest("details");
  details.ontoggle = () => {
    if (!details.open) return;
    const [head, ...body] = rows();
    const line = (list, kinds) => {
      const made = document.createElement("tr");
      list.forEach((text, k) => {
        const [kind, scope] = kinds(k);
        const cell = made.appendChild(document.createElement(kind));
        cell.textContent = text;
        if (scope) cell.scope = scope;
      });
      return made;
    };
    const top = document.createElement("thead"), rest = document.createElement("tbody");
    top.append(line(head, () => ["th", "col"]));
    rest.append(...body.map((list) => line(list, (k) => (k === 0 ? ["th", "row"] : ["td"]))));
    place.replaceChildren(top, rest);
  };
  details.ontoggle();
}

const say = (id, words) => element(id).setAttribute("aria-label", words);
