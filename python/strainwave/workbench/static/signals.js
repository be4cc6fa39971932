// Page "Signals": the visible range of a record in the resolution of the screen, spectra, windows.
import { act, address, byId, getJson, make, onClick, postJson, showMessage, study } from "./client.js";
import { draw } from "./figures.js";

const api = (name) => `/api/${name}/${address(study)}`;
const PANEL = 150; // [px] height of a panel
const DEBOUNCE = 120; // [ms]
const FIRST = ["u1", "torque1", "theta_m1", "a1", "theta_l1", "ax1"];
let record, range, latest = 0, timer, chosen = null;

const experiment = () => byId("record").value;
const channels = () => [...document.querySelectorAll("[data-channel]:checked")].map((box) => box.dataset.channel);

function outside() {
  const [start, stop] = record.window;
  const grey = (x0, x1) => ({ type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: "#888888", opacity: 0.25, line: { width: 0 } });
  return [
    ...(start == null ? [] : [grey(record.start, start)]),
    ...(stop == null ? [] : [grey(stop, record.stop)]),
  ];
}

function marked() {
  const names = channels();
  return record.marks.filter((mark) => names.includes(mark.channel)).map((mark) => ({
    type: "rect", xref: "x", yref: `y${names.indexOf(mark.channel) + 1} domain`.replace("y1 ", "y "),
    x0: mark.start, x1: Math.max(mark.stop, mark.start + record.sample_time), y0: 0, y1: 1,
    fillcolor: "#E69F00", opacity: 0.3, line: { width: 0 },
  }));
}

async function drawTime() {
  const place = byId("time"), names = channels();
  if (!names.length) return;
  const request = ++latest;
  const query = { experiment: experiment(), channels: names.join(","), points: 2 * Math.max(place.clientWidth, 400) };
  if (range) [query.from, query.to] = range;
  const figure = await getJson(api("signal-time"), query);
  if (request !== latest) return; // a newer range is on its way
  place.style.height = `${60 + PANEL * names.length}px`;
  await draw(place, figure, { layout: { shapes: [...outside(), ...marked()], showlegend: false } });
}

function onRelayout(event) {
  const keys = Object.keys(event);
  if (keys.some((key) => key.startsWith("xaxis.range"))) {
    range = [event["xaxis.range[0]"] ?? event["xaxis.range"][0], event["xaxis.range[1]"] ?? event["xaxis.range"][1]];
  } else if (event["xaxis.autorange"]) {
    range = null;
  } else {
    return;
  }
  clearTimeout(timer);
  timer = setTimeout(() => act(null, drawTime), DEBOUNCE);
}

async function drawSpectra() {
  const names = channels();
  if (!names.length) return;
  const { spectra, coherence } = await getJson(api("signal-spectra"), { experiment: experiment(), channels: names.join(",") });
  byId("spectra").style.height = `${60 + PANEL * names.length}px`;
  await draw(byId("spectra"), spectra, { layout: { showlegend: false } });
  await draw(byId("coherence"), coherence);
}

function channelBox(name) {
  const box = make("input", { type: "checkbox", "data-channel": name, id: `channel-${name}` });
  box.checked = chosen ? chosen.has(name) : FIRST.includes(name);
  box.addEventListener("change", () => { chosen = new Set(channels()); act(null, redraw); });
  return make("label", { for: box.id }, box, ` ${name}`);
}

const redraw = async () => { await drawTime(); await drawSpectra(); };

async function showRecord() {
  record = await getJson(api("record"), { experiment: experiment() });
  range = null;
  byId("joint").hidden = true;
  byId("joint-text").textContent = "";
  byId("joint-checks").replaceChildren();
  byId("facts").textContent = `${record.file}: ${record.samples.toLocaleString()} samples, ${(1 / record.sample_time).toPrecision(6) * 1} Hz, ${(record.stop - record.start).toFixed(2)} s`;
  byId("channels").replaceChildren(...record.channels.map(channelBox));
  if (!channels().length) { byId("channels").querySelector("input").checked = true; }
  [byId("start").value, byId("stop").value] = record.window.map((end) => end ?? "");
  byId("sequences").replaceChildren(...record.sequences.map((text) => make("li", {}, text)));
  byId("no-marks").hidden = record.marks.length > 0;
  byId("marks").replaceChildren(...record.marks.map((mark) => make("tr", {},
    make("th", { scope: "row" }, mark.kind), make("td", {}, mark.channel),
    make("td", { class: "number" }, mark.start.toFixed(3)), make("td", { class: "number" }, mark.stop.toFixed(3)))));
  await redraw();
}

async function setWindow(start, stop) {
  await postJson(api("window"), { experiment: experiment(), start, stop });
  showMessage("The window is written to the study file. Check the study again before an estimate.");
  const kept = range;
  await showRecord();
  range = kept;
  await drawTime();
}

const numberOf = (id) => byId(id).value === "" ? null : Number(byId(id).value);
onClick(byId("use"), () => setWindow(numberOf("start"), numberOf("stop")));
onClick(byId("whole"), () => setWindow(null, null));
byId("visible").addEventListener("click", () => {
  const [start, stop] = range ?? [record.start, record.stop];
  [byId("start").value, byId("stop").value] = [start.toFixed(4), stop.toFixed(4)];
});
onClick(byId("compute"), async () => {
  byId("joint-text").textContent = "Computing ...";
  try {
    const shown = await getJson(api("joint-spectrum"), { experiment: experiment() });
    byId("joint").hidden = false;
    byId("joint-text").textContent = shown.text;
    byId("joint-checks").replaceChildren(...shown.checks.map((check) =>
      make("li", { class: check.passed ? "" : "doubt" }, `${check.passed ? "passed" : "doubtful"}: ${check.message}`)));
    await draw(byId("joint"), shown.figure);
  } catch (error) {
    byId("joint-text").textContent = error.message;
  }
});
byId("record").addEventListener("change", () => act(byId("record"), showRecord));

await act(null, showRecord);
byId("time").on?.("plotly_relayout", onRelayout);
