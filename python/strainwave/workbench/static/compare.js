// Page "Compare": results side by side.
import { act, api, byId, cell, setOptions, getJson, head, make, number, onChange, onClick, postJson, row } from "./client.js";
import { draw } from "./figures.js";
import { follow } from "./run_events.js";
import { ofRun } from "./runs.js";

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

const chosen = () => [...document.querySelectorAll("#results input:checked")].map((box) => box.value);
const enable = () => { byId("compare").disabled = byId("save").disabled = chosen().length < 2; };

async function listResults() {
  const results = await getJson(api("results"));
  byId("results").replaceChildren(...results.map((one, index) => {
    const box = make("input", { type: "checkbox", id: `result-${index}`, value: one.path, onchange: enable });
    box.checked = one.own && index < 2;
    return make("label", { for: box.id, title: one.path }, box, ` ${one.name}`, make("span", { class: "hint" }, one.path));
  }), ...(results.length ? [] : [make("p", { class: "faint" }, "No result yet: start a run on the page Estimate.")]));
  enable();
}

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

function parameterRow({ label, unit, cells }) {
  return row(label, cell(unit, "unit"), ...cells.map(({ text, low, high, change }) => {
    const title = low == null ? null : `95 %: ${low.toPrecision(5)} to ${high.toPrecision(5)}`;
    const kind = Math.abs(change) > LARGE ? "change large" : "change";
    return make("td", { class: "number", title }, estimate(text), change == null ? "" : make("div", { class: kind }, size(change)));
  }));
}

function showVerdict({ test, note }) {
  byId("verdict").textContent = test ? verdict(test) : note;
  byId("verdict").className = `callout ${!test ? "doubt" : test.differs ? "bad" : "good"}`;
  if (test) byId("verdict").dataset.differs = test.differs;
}

function verdict({ pairs, differs }) {
  const changed = pairs.flatMap((pair) => pair.parameters.filter((one) => one.verdict === "differs")
    .map((one) => `${one.name}${one.joint ? ` ${one.joint}` : ""} (${pair.first} and ${pair.second}, p = ${one.adjusted_p.toPrecision(2)})`));
  const joint = pairs.filter((pair) => pair.joint_test)
    .map((pair) => `Joint test of ${pair.first} and ${pair.second}: p = ${pair.joint_test.p.toPrecision(2)}`);
  const text = differs ? `The results differ. Changed: ${changed.join("; ") || "all parameters together"}.` : "The results agree.";
  return `${text} ${joint.length ? `${joint.join("; ")}.` : ""}`;
}

async function compare(wanted, query = new URLSearchParams()) {
  result = await postJson(api("compare"), { paths: wanted });
  paths = wanted;
  byId("shown").hidden = false;
  showVerdict(result);
  byId("parameter-heads").replaceChildren(head("parameter"), head("unit"), ...result.names.map((name) => head(name, "number")));
  showRows();
  byId("check-heads").replaceChildren(head("check record"), head("channel"), ...result.names.map((name) => head(`fit of ${name}`, "number")));
  byId("checks").replaceChildren(...result.checks.map(({ record, channel, fits }) =>
    row(record, channel, ...fits.map((fit) => number(fit == null ? "" : `${fit.toFixed(1)} %`)))));
  const first = result.figures.find((one) => one.key.startsWith("correlation-") && one.title.includes("check"))
    ?? result.figures.find((one) => one.key.startsWith("check"));
  setOptions(byId("joint"), result.joints, query.get("joint"));
  setOptions(byId("record"), result.records, query.get("record"));
  setOptions(byId("channel"), query.getAll("channel"));
  setOptions(byId("figure"), result.figures.map((one) => [one.key, one.title]), query.get("figure") ?? first?.key);
  byId("no-joint").hidden = result.joints.length > 0;
  byId("joint").parentElement.hidden = !result.joints.length;
  byId("bode").closest(".grid").hidden = !result.joints.length;
  await showIntervals();
  if (result.records.length) await showRecord();
  if (result.joints.length) await showJoint();
  if (result.figures.length) await showFigure();
}

const showIntervals = () => draw(byId("intervals"), result.intervals[byId("scale").value]);

const verdictCell = (isGood, text) => make("td", {},
  make("span", { class: `badge ${isGood ? "good" : "bad"}` }, isGood ? "passes" : "fails"), make("span", { class: "hint" }, ` ${text}`));

const testRow = (test) => row(test.channel, test.name, number(test.deviation), number(test.noise),
  verdictCell(test.is_white, test.whiteness), verdictCell(test.is_independent, test.is_independent ? "" : test.input));

async function showRecord() {
  const shown = await postJson(api("compare-record"), { paths, record: byId("record").value, channel: byId("channel").value });
  setOptions(byId("channel"), shown.channels, shown.channel);
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
  const kind = byId("figure").selectedOptions[0].text;
  const places = shown.map(({ name, figure }) => figure
    ? make("div", { class: "plot", role: "group", "aria-label": `${kind} of ${name}` })
    : make("p", { class: "faint" }, "The report has no such figure."));
  byId("figures").replaceChildren(...shown.map(({ name }, k) => make("figure", {}, make("figcaption", {}, name), places[k])));
  for (const [k, { figure }] of shown.entries()) if (figure) await draw(places[k], figure);
}

async function save() {
  const run = await postJson(api("save-comparison"), { paths: chosen() });
  await new Promise((resolve) => follow(run.name, () => {}, resolve));
  const link = (file) => make("a", { href: ofRun("download", run.name, file) }, file);
  byId("saved").replaceChildren(`${run.name}: `, link("comparison.html"), ", ", link("comparison.json"));
}

onClick(byId("compare"), async () => { await compare(chosen()); keepAddress(); });
onClick(byId("save"), save);
const show = { joint: showJoint, record: showRecord, channel: showRecord, figure: showFigure, scale: showIntervals, "only-changed": showRows };
for (const [id, action] of Object.entries(show)) onChange(byId(id), async () => { await action(); keepAddress(); });
window.addEventListener("popstate", () => act(byId("compare"), followAddress));
act(byId("compare"), async () => { await listResults(); await followAddress(); });
