// Page "Compare": results side by side.
import { act, address, byId, getJson, make, onClick, postJson, study } from "./client.js";
import { draw } from "./figures.js";
import { follow } from "./run_events.js";

const api = (name) => `/api/${name}/${address(study)}`;
const LARGE = 3; // standard deviations
const SELECTS = ["joint", "record", "channel", "figure", "scale"]; // parts of the address
let paths = [], result;

// The address names the results and what is shown of them, for links and for the way back.
function keepAddress() {
  const query = new URLSearchParams(paths.map((path) => ["path", path]));
  for (const id of SELECTS) if (byId(id).value) query.set(id, byId(id).value);
  if (byId("only-changed").checked) query.set("changed", "1");
  if (`?${query}` !== location.search) history.pushState(null, "", `?${query}`);
}

async function followAddress() {
  const query = new URLSearchParams(location.search);
  const wanted = query.getAll("path");
  if (wanted.length < 2) return;
  for (const box of document.querySelectorAll("#results input")) box.checked = wanted.includes(box.value);
  enable();
  byId("only-changed").checked = query.has("changed");
  if (query.has("scale")) byId("scale").value = query.get("scale");
  await compare(wanted, query);
}

// Fill a select; keep the wanted choice if there is one.
function fill(id, options, wanted) {
  byId(id).replaceChildren(...options.map(([value, text]) => make("option", { value }, text)));
  if (options.some(([value]) => String(value) === wanted)) byId(id).value = wanted;
}

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

// A value with its decimal point in one column, and its standard deviation.
function estimate(text) {
  const [value, std] = text.split(" ± ");
  const [, whole, part] = value.match(/^([-+]?\d*)(.*)$/);
  return make("span", { class: "estimate" }, make("span", { class: "whole" }, whole), make("span", { class: "part" }, part),
    make("span", { class: "std" }, std ? `± ${std}` : ""));
}

const isChanged = (row) => row.cells.some((cell) =>
  cell.change == null ? cell.text !== row.cells[0].text : Math.abs(cell.change) > LARGE);

function showRows() {
  const rows = byId("only-changed").checked ? result.rows.filter(isChanged) : result.rows;
  byId("parameters").replaceChildren(...rows.map(parameterRow));
  const count = result.rows.length - rows.length;
  byId("hidden-rows").textContent = count ? `${count} of ${result.rows.length} rows are unchanged.` : "";
}

function parameterRow(row) {
  return make("tr", {}, make("th", { scope: "row" }, row.label), make("td", { class: "unit" }, row.unit), ...row.cells.map((cell) => {
    const change = cell.change == null ? [] : [make("div", { class: Math.abs(cell.change) > LARGE ? "change large" : "change" }, size(cell.change))];
    const title = cell.low == null ? null : `95 %: ${cell.low.toPrecision(5)} to ${cell.high.toPrecision(5)}`;
    return make("td", { class: "number", title }, estimate(cell.text), ...change);
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

async function compare(wanted, query = new URLSearchParams()) {
  result = await postJson(api("compare"), { paths: wanted });
  paths = wanted;
  byId("shown").hidden = false;
  showVerdict(result);
  byId("parameter-heads").replaceChildren(head("parameter"), head("unit"), ...result.names.map((name) => head(name, true)));
  showRows();
  byId("check-heads").replaceChildren(head("check record"), head("channel"), ...result.names.map((name) => head(`fit of ${name}`, true)));
  byId("checks").replaceChildren(...result.checks.map((row) => make("tr", {}, make("th", { scope: "row" }, row.record), make("td", {}, row.channel),
    ...row.fits.map((fit) => make("td", { class: "number" }, fit == null ? "" : `${fit.toFixed(1)} %`)))));
  const first = result.figures.find((one) => one.key.startsWith("correlation-") && one.title.includes("check"))
    ?? result.figures.find((one) => one.key.startsWith("check"));
  fill("joint", result.joints.map((joint) => [joint, joint]), query.get("joint"));
  fill("record", result.records.map((name) => [name, name]), query.get("record"));
  fill("channel", query.has("channel") ? [[query.get("channel"), query.get("channel")]] : []);
  fill("figure", result.figures.map((one) => [one.key, one.title]), query.get("figure") ?? first?.key);
  byId("no-joint").hidden = result.joints.length > 0;
  byId("joint").parentElement.hidden = !result.joints.length;
  byId("bode").closest(".grid").hidden = !result.joints.length;
  await showIntervals();
  if (result.records.length) await showRecord();
  if (result.joints.length) await showJoint();
  if (result.figures.length) await showFigure();
}

const showIntervals = () => draw(byId("intervals"), result.intervals[byId("scale").value]);

const badge = (isGood) => make("span", { class: `badge ${isGood ? "good" : "bad"}` }, isGood ? "passes" : "fails");

function testRow(row) {
  return make("tr", {}, make("th", { scope: "row" }, row.channel), make("td", {}, row.name), make("td", { class: "number" }, row.deviation),
    make("td", { class: "number" }, row.noise), make("td", {}, badge(row.is_white), make("span", { class: "hint" }, ` ${row.whiteness}`)),
    make("td", {}, badge(row.is_independent), make("span", { class: "hint" }, row.is_independent ? "" : ` ${row.input}`)));
}

async function showRecord() {
  const shown = await postJson(api("compare-record"), { paths, record: byId("record").value, channel: byId("channel").value });
  fill("channel", shown.channels.map((name) => [name, name]), shown.channel);
  byId("notes").textContent = shown.notes.join(" ");
  byId("tests").replaceChildren(...shown.tests.map(testRow));
  byId("difference").hidden = !shown.difference;
  if (shown.difference) await draw(byId("difference"), shown.difference);
}

async function showJoint() {
  const figures = await postJson(api("compare-joint"), { paths, joint: Number(byId("joint").value) });
  await draw(byId("bode-difference"), figures.difference);
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

onClick(byId("compare"), async () => { await compare(chosen()); keepAddress(); });
onClick(byId("save"), save);
const show = { joint: showJoint, record: showRecord, channel: showRecord, figure: showFigure, scale: showIntervals, "only-changed": showRows };
for (const [id, action] of Object.entries(show)) {
  byId(id).addEventListener("change", () => act(byId(id), async () => { await action(); keepAddress(); }));
}
window.addEventListener("popstate", () => act(byId("compare"), followAddress));
act(byId("compare"), async () => { await listResults(); await followAddress(); });
