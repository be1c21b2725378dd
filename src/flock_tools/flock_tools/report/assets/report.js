// SPDX-License-Identifier: Apache-2.0
// What the reader of the report does; follows chart.js and pictures.js in the same script.

const FRAME_EVERY = 50; // ms
let timer = null;

function options(select, names) {
  select.replaceChildren(...names.map((name, k) => new Option(name, k)));
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
  drawCurves();
}

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

const tabs = [...document.querySelectorAll("[role=tab]")];

/** Show the part of a tab, and hide the others. */
function open(tab) {
  for (const each of tabs) {
    each.setAttribute("aria-selected", each === tab);
    each.tabIndex = each === tab ? 0 : -1;
    element(each.getAttribute("aria-controls")).hidden = each !== tab;
  }
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

if (data.runs.length > 1) {
  data.runs.forEach((each, r) => {
    const item = element("legend").appendChild(document.createElement("li"));
    item.appendChild(document.createElement("i")).style.background = `var(--run-${r % RUNS})`;
    item.append(`${MARKS[r % MARKS.length]} ${each.name}`);
  });
}
options(element("run"), data.runs.map((each) => each.name));
element("run-label").hidden = element("legend").hidden = data.runs.length === 1;
element("choice").hidden = data.runs.length === 1 && data.runs[0].members === 1;
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
element("time").addEventListener("change", drawCurves);
element("play").addEventListener("click", () => (timer === null ? play(true) : stopAt(chosen.frame)));
for (const id of TIMED) {
  element(id).classList.add("seek");
  element(id).addEventListener("click", (event) => {
    const part = (event.offsetX - LEFT) / (event.target.clientWidth - LEFT - RIGHT);
    stopAt(nearest(values(run().frame_time), part * span()[1]));
  });
}
document.addEventListener("keydown", (event) => {
  const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (by !== undefined && event.target === document.body) stopAt(chosen.frame + by);
});
window.addEventListener("resize", drawAll);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
window.addEventListener("beforeprint", () => {
  for (const tab of tabs) element(tab.getAttribute("aria-controls")).hidden = false;
  drawAll();
});
window.addEventListener("afterprint", () => open(tabs.find((tab) => tab.getAttribute("aria-selected") === "true")));
document.querySelector("[role=tablist]").hidden = false;
choose(0, 0);
open(tabs[0]);
