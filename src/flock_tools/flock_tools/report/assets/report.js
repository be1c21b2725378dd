// SPDX-License-Identifier: Apache-2.0
// What the reader of the report does: the last part of the script.

const FRAME_EVERY = 50; // ms
let timer = null;

function options(select, names, first = 0) {
  select.replaceChildren(...names.map((name, k) => new Option(name, k + first)));
}

function drawAll() {
  drawFormation();
  drawCurves();
  drawProfile();
  drawEigenvalues();
}

/** Show a member of a run, and as far as it has come. */
function choose(which, member) {
  play(false);
  chosen.run = which;
  chosen.member = member;
  chosen.member = memberOf(run());
  element("run").value = which;
  options(element("member"), range(run().members).map((m) => `${m + 1}${run().member_names[m]}`));
  element("member").value = chosen.member;
  element("member-label").hidden = run().members === 1;
  const last = run().frame_time.shape[0] - 1;
  element("time").max = last;
  show(last);
  document.querySelectorAll(".pick").forEach((button) => {
    const here = Number(button.dataset.run) === which && Number(button.dataset.member) === chosen.member;
    button.closest("tr").setAttribute("aria-current", here);
  });
  drawAll();
}

function show(frame) {
  chosen.frame = Math.max(0, Math.min(frame, run().frame_time.shape[0] - 1));
  element("time").value = chosen.frame;
}

/** Stop at a frame and tell all of it. */
function stopAt(frame) {
  play(false);
  show(frame);
  drawFormation();
  TIMED.forEach((id) => element(`${id}-table`).closest("details").ontoggle());
}

/** Show the formation at a time. */
const seek = (time) => stopAt(nearest(values(run().frame_time), time));

function play(on) {
  clearInterval(timer);
  timer = null;
  element("play").textContent = on ? "Pause" : "Play";
  if (!on) return;
  if (chosen.frame === run().frame_time.shape[0] - 1) show(0);
  timer = setInterval(() => {
    show(chosen.frame + 1);
    drawFormation();
    if (chosen.frame === run().frame_time.shape[0] - 1) stopAt(chosen.frame);
  }, FRAME_EVERY);
}

/** Show the zoom of an axis in its fields and buttons. */
function zoomed(axis) {
  document.querySelectorAll(`[data-axis="${axis}"]`).forEach((button) => (button.hidden = !zooms[axis]));
  if (axis !== "time") return;
  const [from, to] = zooms.time || span();
  element("from").value = told(from);
  element("to").value = told(to);
  element("whole").disabled = !zooms.time;
  markTime();
}

const tabs = [...document.querySelectorAll("[role=tab]")];

/** Show the part of a tab, and hide the others; draw nothing. */
function lay(tab) {
  for (const each of tabs) {
    each.setAttribute("aria-selected", each === tab);
    each.tabIndex = each === tab ? 0 : -1;
    element(each.getAttribute("aria-controls")).hidden = each !== tab;
  }
  const part = tab.getAttribute("aria-controls"), pictured = part === "flight" || part === "theory";
  element("keys").hidden = !pictured;
  element("choice").hidden = !pictured || (part === "theory" && !several && run().members === 1);
  for (const id of ["bird-label", "zoom"]) element(id).hidden = part !== "flight" || (id === "bird-label" && run().birds === 1);
  element("legend-group").hidden = !several && (part !== "flight" || run().birds === 1);
}

function open(tab) {
  lay(tab);
  drawAll();
}

for (const tab of tabs) {
  tab.addEventListener("click", () => open(tab));
  tab.addEventListener("keydown", (event) => {
    const here = tabs.indexOf(tab), last = tabs.length - 1;
    const to = { ArrowLeft: here ? here - 1 : last, ArrowRight: here < last ? here + 1 : 0, Home: 0, End: last }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    open(tabs[to]);
    tabs[to].focus();
  });
}

/** Fill the legend: the runs of a comparison, or else the birds, or the wings of many birds. */
function fillLegend() {
  const legend = element("legend"), add = (...button) => legend.appendChild(document.createElement("li")).append(legendButton(...button));
  element("legend-name").textContent = several ? "Runs" : "Birds";
  if (several) {
    data.runs.forEach((each, r) => add(`run ${r}`, `${MARKS[r % MARKS.length]} ${each.label}`, { ...runStyle(r), colour: `var(--run-${r % RUNS})` }));
    return;
  }
  const items = new Map();
  range(run().birds).forEach((bird) => items.set(itemOf(bird), [...(items.get(itemOf(bird)) || []), bird]));
  for (const [item, birds] of items) {
    const named = birds.length > 1 ? `${item} (${birds[0] + 1} to ${birds[birds.length - 1] + 1})` : item;
    const listed = run().birds <= MOST_LISTED;
    add(item, listed ? String(birds[0] + 1) : named, wingStyle(birds[birds.length >> 1]), listed ? item : "");
  }
}

fillLegend();
options(element("run"), data.runs.map((each) => each.label));
element("run-label").hidden = !several;
options(element("bird"), ["all", ...range(run().birds).map((bird) => bird + 1)]);
element("bird").addEventListener("change", (event) => {
  chosen.bird = Number(event.target.value) ? Number(event.target.value) - 1 : null;
  drawCurves();
});
document.querySelectorAll("[data-item]").forEach((button) => button.addEventListener("click", () => toggle(button)));
markLegends();
element("run").addEventListener("change", (event) => choose(Number(event.target.value), chosen.member));
element("member").addEventListener("change", (event) => choose(chosen.run, Number(event.target.value)));
for (const [id, step] of [["before", -1], ["after", 1]]) {
  element(id).addEventListener("click", () => choose(chosen.run, (chosen.member + step + run().members) % run().members));
}
document.querySelectorAll(".pick").forEach((button) => {
  button.addEventListener("click", () => choose(Number(button.dataset.run), Number(button.dataset.member)));
});
element("time").addEventListener("input", (event) => {
  play(false);
  show(Number(event.target.value));
  drawFormation();
});
element("time").addEventListener("change", () => stopAt(chosen.frame));
element("play").addEventListener("click", () => (timer === null ? play(true) : stopAt(chosen.frame)));
for (const id of ["formation", ...TIMED, "profile", "residual", "eigenvalues"]) makeReadable(id);
for (const id of ["from", "to"]) {
  element(id).addEventListener("change", () => {
    const wide = [element("from"), element("to")].map((field) => Number(field.value));
    if (wide[0] < wide[1]) zoom("time", wide);
    zoomed("time");
  });
}
document.querySelectorAll("[data-axis]").forEach((button) => button.addEventListener("click", () => {
  zoom(button.dataset.axis, null);
  element(button.closest(".figure").querySelector("canvas").id).focus();
}));
element("whole").addEventListener("click", () => {
  zoom("time", null);
  element("from").focus();
});
document.addEventListener("keydown", (event) => {
  const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (by !== undefined && event.target === document.body) stopAt(chosen.frame + by);
});
window.addEventListener("resize", drawAll);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
window.addEventListener("beforeprint", () => {
  for (const tab of tabs) element(tab.getAttribute("aria-controls")).hidden = false;
  element("choice").hidden = element("legend-group").hidden = false;
  drawAll();
});
window.addEventListener("afterprint", () => open(tabs.find((tab) => tab.getAttribute("aria-selected") === "true")));
document.querySelector("[role=tablist]").hidden = false;
lay(tabs[0]);
choose(0, 0);
zoomed("time");
