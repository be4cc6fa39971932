// Page "Compare": results side by side.
import { act, address, byId, getJson, make, onClick, postJson, study } from "./client.js";
import { draw } from "./figures.js";
import { follow } from "./run_events.js";

const api = (name) => `/api/${name}/${address(study)}`;
const LARGE = 3; // standard deviations
let paths = [];

const chosen = () => [...document.querySelectorAll("#results input:checked")].map((box) => box.value);
const enable = () => { byId("compare").disabled = byId("save").disabled = chosen().length < 2; };

async function listResults() {
  const results = await getJson(api("results"));
  byId("results").replaceChildren(...results.map((one, index) => {
    const box = make("input", { type: "checkbox", id: `result-${index}`, value: one.path });
    box.checked = one.own && index < 2;
    box.addEventListener("change", enable);
    return make("label", { for: box.id, title: one.path }, box, ` ${one.name}`, make("span", { class: "hint" }, one.path));
  }), ...(results.length ? [] : [make("p", { class: "faint" }, "No result yet: start a run on the page Estimate.")]));
  enable();
}

const head = (text, isNumber) => make("th", { scope: "col", class: isNumber ? "number" : null }, text);
const size = (value) => `${value > 0 ? "+" : ""}${value.toFixed(1)} σ`;

function parameterRow(row) {
  return make("tr", {}, make("th", { scope: "row" }, row.label), make("td", { class: "unit" }, row.unit), ...row.cells.map((cell) => {
    const change = cell.change == null ? [] : [make("div", { class: Math.abs(cell.change) > LARGE ? "change large" : "change" }, size(cell.change))];
    const title = cell.low == null ? null : `95 %: ${cell.low.toPrecision(5)} to ${cell.high.toPrecision(5)}`;
    return make("td", { class: "number", title }, cell.text, ...change);
  }));
}

function showVerdict({ test, note }) {
  if (!test) {
    byId("verdict").textContent = note;
    byId("verdict").className = "callout doubt";
    return;
  }
  const changed = test.pairs.flatMap((pair) => pair.parameters.filter((one) => one.verdict === "differs")
    .map((one) => `${one.name}${one.joint ? ` ${one.joint}` : ""} (${pair.first} and ${pair.second}, p = ${one.adjusted_p.toPrecision(2)})`));
  const joint = test.pairs.filter((pair) => pair.joint_test)
    .map((pair) => `Joint test of ${pair.first} and ${pair.second}: p = ${pair.joint_test.p.toPrecision(2)}`);
  const text = test.differs ? `The results differ. Changed: ${changed.join("; ") || "all parameters together"}.` : "The results agree.";
  byId("verdict").textContent = `${text} ${joint.length ? `${joint.join("; ")}.` : ""}`;
  byId("verdict").className = `callout ${test.differs ? "bad" : "good"}`;
  byId("verdict").dataset.differs = test.differs;
}

async function compare() {
  paths = chosen();
  const result = await postJson(api("compare"), { paths });
  byId("shown").hidden = false;
  showVerdict(result);
  byId("parameter-heads").replaceChildren(head("parameter"), head("unit"), ...result.names.map((name) => head(name, true)));
  byId("parameters").replaceChildren(...result.rows.map(parameterRow));
  byId("joint").replaceChildren(...result.joints.map((joint) => make("option", {}, joint)));
  byId("no-joint").hidden = result.joints.length > 0;
  byId("check-heads").replaceChildren(head("check record"), head("channel"), ...result.names.map((name) => head(`fit of ${name}`, true)));
  byId("checks").replaceChildren(...result.checks.map((row) => make("tr", {}, make("th", { scope: "row" }, row.record), make("td", {}, row.channel),
    ...row.fits.map((fit) => make("td", { class: "number" }, fit == null ? "" : `${fit.toFixed(1)} %`)))));
  byId("figure").replaceChildren(...result.figures.map((one) => make("option", { value: one.key }, one.title)));
  const first = result.figures.find((one) => one.key.startsWith("correlation-") && one.title.includes("check"))
    ?? result.figures.find((one) => one.key.startsWith("check"));
  if (first) byId("figure").value = first.key;
  await draw(byId("intervals"), result.intervals);
  if (result.joints.length) await showJoint();
  if (result.figures.length) await showFigure();
}

async function showJoint() {
  const figures = await postJson(api("compare-joint"), { paths, joint: Number(byId("joint").value) });
  for (const name of ["bode", "step", "poles"]) await draw(byId(name), figures[name]);
}

async function showFigure() {
  const shown = await postJson(api("compare-figure"), { paths, key: byId("figure").value });
  const places = shown.map((one) => make("div", { class: "plot", role: "group", "aria-label": `${byId("figure").selectedOptions[0].text} of ${one.name}` }));
  byId("figures").replaceChildren(...shown.map((one, index) => make("figure", {}, make("figcaption", {}, one.name),
    one.figure ? places[index] : make("p", { class: "faint" }, "The report has no such figure."))));
  for (const [index, one] of shown.entries()) if (one.figure) await draw(places[index], one.figure);
}

async function save() {
  const run = await postJson(api("save-comparison"), { paths: chosen() });
  await new Promise((resolve) => follow(run.name, () => {}, resolve));
  const link = (file) => make("a", { href: `/download/${address(study)}?run=${run.name}&file=${file}` }, file);
  byId("saved").replaceChildren(`${run.name}: `, link("comparison.html"), ", ", link("comparison.json"));
}

onClick(byId("compare"), compare);
onClick(byId("save"), save);
byId("joint").addEventListener("change", () => act(byId("joint"), showJoint));
byId("figure").addEventListener("change", () => act(byId("figure"), showFigure));
act(null, listResults);
