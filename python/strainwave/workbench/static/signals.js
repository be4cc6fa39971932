// Page "Signals": the visible range of records in the resolution of the screen, spectra, window, steps.
import { act, api, byId, getJson, make, onClick, postJson, showMessage } from "./client.js";
import { addCursor } from "./cursor.js";
import { draw } from "./figures.js";
import { showSteps } from "./steps.js";

const PANEL = [150, 360], FRAME = 60; // [px] range of the height of a panel, and height of the axis below
const DEBOUNCE = 120; // [ms]
const FIRST = ["u1", "torque1", "theta_m1", "a1", "theta_l1", "ax1"];
const CHOICES = ["panels", "units", "frequency", "magnitude", "before"];
const latest = {}; // request of each kind
let record, range, timer, chosen = null, draft = null, hasZoom = false;

const experiment = () => byId("record").value;
const checked = (kind) => [...document.querySelectorAll(`[data-${kind}]:checked`)].map((box) => box.value);
const overlaid = () => checked("overlay").filter((name) => name !== experiment());
// with several records, time counts from the start of each
const origin = () => overlaid().length ? record.start : 0;
const hasDraft = () => JSON.stringify(draft) !== JSON.stringify(record.steps);

// The address has the whole view, so that a link or Back restores it.
const view = () => [
  ...[experiment(), ...overlaid()].map((name) => ["record", name]),
  ...checked("channel").map((name) => ["channel", name]),
  ...CHOICES.map((id) => [id, byId(id).value]),
  ...(hasDraft() ? [["steps", JSON.stringify(draft)]] : []),
];
const span = () => range ? [["from", range[0]], ["to", range[1]]] : [];

function saveAddress(method) {
  if (!record) return; // it could not be read
  const text = `?${new URLSearchParams([...view(), ...span()])}`;
  if (text !== location.search) history[method](null, "", text);
}

function readAddress() {
  const query = new URLSearchParams(location.search), records = query.getAll("record");
  const names = [...byId("record").options].map((option) => option.value);
  byId("record").value = names.includes(records[0]) ? records[0] : names[0];
  for (const box of document.querySelectorAll("[data-overlay]")) box.checked = records.slice(1).includes(box.value);
  byId("overlays").open ||= records.length > 1;
  chosen = query.has("channel") ? query.getAll("channel") : null;
  for (const id of CHOICES) byId(id).value = query.get(id) ?? byId(id).options[0].value;
  range = query.has("from") && query.has("to") ? [Number(query.get("from")), Number(query.get("to"))] : null;
  try { draft = JSON.parse(query.get("steps")); } catch { draft = null; }
}

// Grey outside of the window, orange where a channel is marked, if its panel is its own.
function shapes({ data }) {
  const [start, stop] = record.window;
  const box = (x0, x1, yref, fillcolor, opacity) => ({
    type: "rect", xref: "x", yref, x0: x0 - origin(), x1: x1 - origin(), y0: 0, y1: 1, fillcolor, opacity, line: { width: 0 } });
  const axisOf = (channel) => byId("panels").value === "channel" && data.find((trace) => trace.name.startsWith(`${channel} [`))?.yaxis;
  return [
    ...(start == null ? [] : [box(record.start, start, "paper", "#888888", 0.25)]),
    ...(stop == null ? [] : [box(stop, record.stop, "paper", "#888888", 0.25)]),
    ...record.marks.filter((mark) => axisOf(mark.channel)).map((mark) => box(
      mark.start, Math.max(mark.stop, mark.start + record.sample_time), `${axisOf(mark.channel)} domain`, "#E69F00", 0.3)),
  ];
}

// The answer to a request, or null if a newer one of its kind is on its way.
async function newest(kind, query) {
  const mine = latest[kind] = (latest[kind] ?? 0) + 1;
  const answer = await getJson(api(kind), query);
  return mine === latest[kind] ? answer : null;
}

async function drawPanels(place, figure, layout) {
  const panels = Object.keys(figure.layout).filter((key) => key.startsWith("yaxis")).length;
  const fitting = 0.7 * window.innerHeight / Math.max(panels, 2);
  place.style.height = `${FRAME + panels * Math.min(Math.max(fitting, PANEL[0]), PANEL[1])}px`;
  await draw(place, figure, { layout: { showlegend: false, hovermode: "x unified", ...layout } });
}

async function drawTime() {
  if (!checked("channel").length) return;
  const points = ["points", 2 * Math.max(byId("time").clientWidth, 400)];
  const figure = await newest("signal-time", [...view(), ...span(), points]);
  if (!figure) return;
  await drawPanels(byId("time"), figure, { shapes: shapes(figure) });
  if (!hasZoom) byId("time").on("plotly_relayout", onRelayout);
  hasZoom = true;
  placeTimeCursor();
}

async function drawSpectra() {
  if (!checked("channel").length) return;
  const figures = await newest("signal-spectra", view());
  if (!figures) return;
  await drawPanels(byId("spectra"), figures.spectra);
  await draw(byId("coherence"), figures.coherence);
  placeFrequencyCursor();
}

function onRelayout(event) {
  const ends = event["xaxis.range"] ?? [event["xaxis.range[0]"], event["xaxis.range[1]"]];
  if (ends[0] === undefined && !event["xaxis.autorange"]) return;
  range = ends[0] === undefined ? null : ends.map((end) => Number(end.toFixed(6)));
  const [start, stop] = [record.start - origin(), record.stop - origin()];
  if (range && range[0] <= start + 1e-6 && range[1] >= stop - 1e-6) range = null; // the whole record
  clearTimeout(timer);
  timer = setTimeout(() => { saveAddress("replaceState"); act(null, drawTime); }, DEBOUNCE);
}

const redraw = () => Promise.all([drawTime(), drawSpectra()]);
const choose = () => { saveAddress("pushState"); return act(null, redraw); };

function channelBox(name) {
  const onchange = () => { chosen = checked("channel"); choose(); };
  const attributes = { type: "checkbox", "data-channel": true, value: name, checked: (chosen ?? FIRST).includes(name), onchange };
  return make("label", {}, make("input", attributes), ` ${name}`);
}

async function showRecord() {
  const answer = await newest("record", { record: experiment() });
  if (!answer) return;
  record = answer;
  draft ??= record.steps;
  byId("joint").hidden = true;
  byId("joint-text").textContent = "";
  byId("joint-checks").replaceChildren();
  byId("facts").textContent = `${record.files.join(", ")}: ${record.samples.toLocaleString()} samples, ${Number((1 / record.sample_time).toPrecision(6))} Hz, ${(record.stop - record.start).toFixed(2)} s`;
  byId("channels").replaceChildren(...record.channels.map(channelBox));
  if (!checked("channel").length) byId("channels").querySelector("input").checked = true;
  [byId("start").value, byId("stop").value] = record.window.map((end) => end ?? "");
  byId("sequences").replaceChildren(...record.sequences.map((text) => make("li", {}, text)));
  byId("no-marks").hidden = record.marks.length > 0;
  byId("marks").replaceChildren(...record.marks.map((mark) => make("tr", {},
    make("th", { scope: "row" }, mark.kind), make("td", {}, mark.channel),
    make("td", { class: "number" }, mark.start.toFixed(3)), make("td", { class: "number" }, mark.stop.toFixed(3)))));
  showDraft();
  await redraw();
}

function showDraft() {
  showSteps(draft, record, changeSteps);
  byId("write-steps").disabled = byId("undo-steps").disabled = !hasDraft();
}

// Show the record with other steps; the study file stays until they are written.
async function changeSteps(steps) {
  const before = draft;
  draft = steps;
  try {
    await redraw();
    saveAddress("pushState");
  } catch (error) {
    draft = before;
    throw error;
  } finally {
    showDraft();
  }
}

const note = (what) => showMessage(`${what} written to the study file. Check the study again before an estimate.`);

async function setWindow(start, stop) {
  await postJson(api("window"), { experiment: experiment(), start, stop });
  note("The window is");
  await showRecord();
}

const numberOf = (id) => byId(id).value === "" ? null : Number(byId(id).value);
onClick(byId("visible"), () => {
  const [start, stop] = range ?? [record.start - origin(), record.stop - origin()];
  return setWindow(start + origin(), stop + origin());
});
onClick(byId("use"), () => setWindow(numberOf("start"), numberOf("stop")));
onClick(byId("whole"), () => setWindow(null, null));
onClick(byId("write-steps"), async () => {
  await postJson(api("steps"), { experiment: experiment(), steps: draft });
  note("The steps are");
  draft = null;
  await showRecord();
  saveAddress("replaceState");
});
onClick(byId("undo-steps"), () => changeSteps(record.steps));
onClick(byId("compute"), async () => {
  byId("joint-text").textContent = "Computing ...";
  const shown = await getJson(api("joint-spectrum"), { experiment: experiment() })
    .catch((error) => ({ text: error.message, checks: [] }));
  byId("joint-text").textContent = shown.text;
  byId("joint-checks").replaceChildren(...shown.checks.map((check) =>
    make("li", { class: check.passed ? "" : "doubt" }, `${check.passed ? "passed" : "doubtful"}: ${check.message}`)));
  byId("joint").hidden = !shown.figure;
  if (shown.figure) await draw(byId("joint"), shown.figure);
});
byId("record").addEventListener("change", () => act(byId("record"), async () => {
  [range, draft] = [null, null];
  await showRecord();
  saveAddress("pushState");
}));
for (const box of document.querySelectorAll("[data-overlay]")) {
  box.addEventListener("change", () => { range = null; choose(); }); // the origin of time changes
}
for (const id of CHOICES) byId(id).addEventListener("change", choose);
window.addEventListener("popstate", () => { readAddress(); act(null, showRecord); });

const at = (name, unit) => (value) => value === null ? `Values at the cursor` : `Values at ${name} = ${value} ${unit}`;
const placeTimeCursor = addCursor(byId("time"), byId("time-values"), byId("time-at"), at("t", "s"));
const placeFrequencyCursor = addCursor(byId("spectra"), byId("spectra-values"), byId("spectra-at"), at("f", "Hz"));
readAddress();
await act(null, showRecord);
saveAddress("replaceState");
