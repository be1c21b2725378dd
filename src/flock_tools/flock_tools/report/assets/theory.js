// SPDX-License-Identifier: Apache-2.0
// The pictures of the final spacings and the eigenvalues, beside theory.

const LEAST_OFF = 1e-12; // b; what is nearer to theory is drawn there

function drawProfile() {
  const gaps = range(run().birds - 1).map((k) => k + 1), head = run().leader - 1, member = memberOf(run());
  const towards = (list) => Array.from(list, (value, k) => (k >= head ? -value : value));
  const steady = towards(row(run().steady_spacing, member)), linear = towards(row(run().linear_spacing, member));
  const flown = data.runs.map((each) => towards(row(each.final_spacing, memberOf(each))));
  const common = { axis: "gap", place: "gap", unit: "b", whole: true, wide: [0.5, Math.max(gaps.length, 1) + 0.5] };
  const lines = [
    { x: gaps, y: steady, colour: css("--ink"), name: "exact steady state", item: "exact" },
    { x: gaps, y: linear, colour: css("--alarm"), dash: [2, 4], name: "linear law", item: "linear" },
    ...flown.map((y, r) => ({ x: gaps, y, mark: markOf(r), aside: r !== chosen.run, name: several ? data.runs[r].label : "flown", ...ofRun(r) })),
  ];
  chart("profile", { ...common, lines, empty: gaps.length ? "The last row of the bag has no finite spacings." : whyEmpty("spacing") });
  table("profile", () => [["gap", ...data.runs.map((each) => `flown: ${each.label}`), "exact", "linear law"],
    ...gaps.map((gap, k) => [gap, ...flown.map((y) => told(y[k])), told(steady[k]), told(linear[k])])]);
  const [exactly, linearly] = [row(run().off_exact, member), row(run().off_linear, member)];
  const farthest = (off, what) => {
    const most = bounds(off)[1];
    return Number.isFinite(most) ? `at most ${told(most, 2)} b from ${what}` : `no values of ${what}`;
  };
  const words = run().birds === 1 ? "A single bird has no spacings."
    : `Final spacings: ${farthest(exactly, "the exact steady state")}; ${farthest(linearly, "the linear law")}.`;
  say("profile", words);
  element("profile-words").textContent = words;
  drawResidual(gaps, words, common);
}

const markOf = (r) => r % MARKS.length;

/** Return colour and legend of the marks of a run. */
const ofRun = (r) => ({ colour: runStyle(r).colour, item: `run ${r}` });

/** Draw how far the final spacings of all runs are from their own steady states, and the chosen run's from the law. */
function drawResidual(gaps, words, common) {
  const least = (off) => Array.from(off, (value) => Math.max(value, LEAST_OFF));
  const exactly = data.runs.map((each) => row(each.off_exact, memberOf(each))), linearly = row(run().off_linear, memberOf(run()));
  const whose = (each) => (several ? `${each.label}, from the steady state` : "from the exact steady state");
  const lines = exactly.map((off, r) => ({ x: gaps, y: least(off), mark: markOf(r), name: whose(data.runs[r]), ...ofRun(r) }));
  lines.push({ x: gaps, y: least(linearly), mark: LAW, colour: css("--alarm"), name: "from the linear law", item: "linear" });
  const why = run().no_theory[memberOf(run())];
  chart("residual", { ...common, lines, log: true, empty: gaps.length ? `There is no theory to compare with. ${why}` : whyEmpty("spacing") });
  table("residual", () => [["gap", ...data.runs.map(whose), "from the linear law"],
    ...gaps.map((gap, k) => [gap, ...exactly.map((off) => told(off[k])), told(linearly[k])])]);
  say("residual", words);
}

function drawEigenvalues() {
  const parts = data.runs.map((each) => [row(each.eigen_real, memberOf(each)), row(each.eigen_imag, memberOf(each))]);
  const lines = parts.map(([x, y], r) => ({ x, y, mark: markOf(r), name: several ? `${data.runs[r].label}, imaginary part` : "imaginary part", ...ofRun(r) }));
  const why = `No eigenvalues are known. ${run().no_eigenvalues[memberOf(run())]}`;
  chart("eigenvalues", { lines, axis: "real", place: "real part", unit: "U_{min}/b", scatter: true, rules: [{ x: 0 }], empty: why });
  const [real, imaginary] = parts[chosen.run];
  table("eigenvalues", () => [["number", "real part", "imaginary part"],
    ...range(real.length).map((k) => [k + 1, told(real[k]), told(imaginary[k])])]);
  const known = real.length > 0 && Number.isFinite(real[0]);
  const words = known ? `${real.length} eigenvalue${real.length > 1 ? "s" : ""}; the largest real part is ${told(real[0], 4)}: ` +
    `disturbances ${real[0] < 0 ? "decay" : "do not decay"}.` : why;
  say("eigenvalues", words);
  element("eigenvalues-words").textContent = words;
}
