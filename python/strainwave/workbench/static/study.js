// Page "Study": the form and the text show the same file; every change is saved at once.
import { act, api, button, byId, getJson, make, onChange, onClick, postJson, setOptions, showMessage, study } from "./client.js";
import { showExperiments } from "./experiments.js";
import { draw } from "./figures.js";
import { fieldControl, focusField, idOf, keep, showGroups, showMissing, showValue } from "./study_form.js";

const STORED = `strainwave history of ${study}`;
const MAX_STEPS = 50; // of changes that can be undone
const SCALE_TOLERANCE = 1e-4; // relative; scales such as 0.0174533 have few digits
const history = { past: [], future: [] }; // texts of the file before and after the changes of this session
let state, drawnArm, editedJoint, previewed;
let saving = Promise.resolve();

const text = byId("text");
const isTyped = () => state !== undefined && text.value !== state.text;
const mayDropText = () => !isTyped() || window.confirm("Drop the text that is not saved?");

// Write the file, one change after the other; `confirm` gets the text before.
function write(bodyOf, confirm) {
  const written = saving.then(async () => {
    const before = state.text, typed = text.value;
    state = await postJson(api("study"), { sha256: state.sha256, ...bodyOf() });
    confirm(before);
    sessionStorage.setItem(STORED, JSON.stringify({ sha256: state.sha256, ...history }));
    if (text.value === typed) text.value = state.text;
    await show();
  });
  saving = written.catch(() => {});
  return written;
}

// Save changes of keys, or those of a function, which sees earlier ones; in the text as typed so far.
export function save(changes, confirm = () => {}) {
  return write(() => ({ changes: typeof changes === "function" ? changes() : changes, ...(isTyped() ? { text: text.value } : {}) }), (before) => {
    if (before !== state.text) Object.assign(history, { past: [...history.past, before].slice(-MAX_STEPS), future: [] });
    confirm();
  });
}

// Undo or redo: the last text of one list replaces the present one, which goes to the other list.
async function step(from, to) {
  if (!history[from].length || !mayDropText()) return undefined;
  return write(() => ({ text: history[from].at(-1) }), (before) => { history[from].pop(); history[to].push(before); });
}
const undo = () => step("past", "future");
const redo = () => step("future", "past");

const columnsOfRecord = () => state.columns[byId("preview-record").value] ?? [];
const channelPlace = (row, key) => ["channels", row.channel, key];

function buildChannel(row) {
  const menu = (attributes, changeTo) => {
    const select = make("select", attributes);
    onChange(select, () => save([changeTo(select.value)]));
    return select;
  };
  const column = menu({ id: idOf(["channels", row.channel]), "aria-label": `Column of ${row.channel}` },
    (value) => ({ place: value ? channelPlace(row, "column") : ["channels", row.channel], kind: "text", value }));
  const unit = menu({ class: "column-unit", "aria-label": `Unit of the column of ${row.channel}` },
    (factor) => ({ place: channelPlace(row, "scale"), kind: "number", value: String(Number(tr.row.scale) < 0 ? -factor : factor) }));
  const number = (key, fallback) =>
    fieldControl(channelEntry(row, key), { "aria-label": `${key} of ${row.channel}`, "data-default": fallback });
  const look = button("Show", { "aria-label": `Preview ${row.channel}` }, () => { previewed = row.channel; return preview(); });
  const cells = [column, unit, number("scale", "1"), number("offset", "0"), row.unit, look, make("details", { class: "reason" }, make("summary"))];
  const tr = make("tr", {}, make("th", { scope: "row" }, row.channel), ...cells.map((one) => make("td", { class: one === row.unit && "unit" }, one)));
  return tr;
}

const channelEntry = (row, key) => ({ place: channelPlace(row, key), kind: "number", value: row[key], unit: row.unit });

function updateChannel(tr, row) {
  tr.row = row;
  const columns = columnsOfRecord(), [column, unit, ...numbers] = tr.querySelectorAll("select, input");
  const names = row.column && !columns.includes(row.column) ? [row.column, ...columns] : columns;
  setOptions(column, [["", columns.includes(row.channel) ? `${row.channel} (same name)` : "none"], ...names]);
  column.value = row.column;
  const scale = Math.abs(Number(row.scale || 1));
  const units = row.units.length ? row.units : [{ name: row.unit, factor: 1 }];
  const known = units.find(({ factor }) => Math.abs(scale / factor - 1) < SCALE_TOLERANCE);
  setOptions(unit, [...units.map(({ name, factor }) => [String(factor), name]), ...(known ? [] : [[String(scale), "other"]])]);
  unit.value = String(known?.factor ?? scale);
  for (const one of [unit, ...numbers]) one.disabled = !row.column;
  numbers.forEach((control, k) => showValue(control, channelEntry(row, ["scale", "offset"][k])));
  tr.lastChild.firstChild.hidden = !row.reason;
  tr.querySelector("summary").textContent = row.reason;
}

function showChannels() {
  const columns = columnsOfRecord();
  const used = state.channels.filter((row) => byId("all-channels").checked || row.column || columns.includes(row.channel)
    || state.missing.some(({ place }) => place[1] === row.channel));
  keep(byId("channels"), used, (row) => row.channel, buildChannel, updateChannel);
}

async function preview() {
  const row = state.channels.find((one) => one.channel === previewed), place = byId("preview");
  place.hidden = !row;
  if (!row) return;
  const query = { experiment: byId("preview-record").value, channel: row.channel, column: row.column || row.channel, scale: row.scale, offset: row.offset };
  await draw(place, await getJson(api("preview"), query), { layout: { showlegend: false } });
}

// Draw the arm, with a ring around the joint that is edited; its marks are the links, then the axes.
async function showArm() {
  byId("no-arm").hidden = Boolean(state.arm);
  byId("arm-figure").hidden = !state.arm;
  const key = JSON.stringify([state.arm, editedJoint]);
  if (!state.arm || key === drawnArm) return;
  drawnArm = key;
  byId("arm-caption").textContent = state.caption;
  const axis = state.arm.data[1 + editedJoint]; // of no joint if none is edited
  const mean = (ends) => [(ends[0] + ends[1]) / 2];
  const ring = axis ? [{ type: "scatter", mode: "markers", x: mean(axis.x), y: mean(axis.y), name: `joint ${editedJoint + 1}`, showlegend: false, hoverinfo: "skip",
    marker: { size: 24, color: "#D55E00", symbol: "circle-open", line: { width: 3 } } }] : [];
  await draw(byId("arm"), { ...state.arm, data: [...state.arm.data, ...ring] });
  byId("arm").dataset.joint = axis ? String(editedJoint + 1) : "";
}

// Show a line of the text, and select it.
function goToLine(line) {
  byId("file").open = true;
  const lines = text.value.split("\n"), start = lines.slice(0, line - 1).reduce((sum, one) => sum + one.length + 1, 0);
  text.focus();
  text.setSelectionRange(start, start + (lines[line - 1]?.length ?? 0));
  text.scrollTop = (line - 4) * (text.scrollHeight / lines.length);
}

const lineIn = (message) => Number(/\bline (\d+)/.exec(message ?? "")?.[1] ?? 0);

// Focus the field of a place, or of the channel if it has no column; or a line of the text that lacks the value.
function goTo(place) {
  if (place[0] === "channels" && !byId(idOf(place.slice(0, 2)))) {
    byId("all-channels").checked = true;
    showChannels();
  }
  const control = [place, place.slice(0, -1)].map((one) => byId(idOf(one))).find((one) => one && !one.disabled);
  if (control) return focusField(control);
  const lines = text.value.split("\n"), key = String(place.at(-1));
  const line = 1 + lines.findIndex((one) => one.split("#")[0].includes("TODO") && one.includes(key));
  return line && goToLine(line);
}

// From a field to the next missing one, in the order of the page.
function goToNext(event) {
  if (event.key !== "Enter" || event.ctrlKey || event.metaKey || !event.target.matches("input[id^=field-]")) return;
  const others = state.missing.filter(({ place }) => byId(idOf(place)) && idOf(place) !== event.target.id);
  const isBelow = ({ place }) => event.target.compareDocumentPosition(byId(idOf(place))) & Node.DOCUMENT_POSITION_FOLLOWING;
  const next = others.find(isBelow) ?? others[0];
  if (!next) return; // the browser reports the change
  event.preventDefault();
  goTo(next.place);
}

function showState() {
  const { missing, error } = state, count = missing.length, line = count ? 0 : lineIn(error);
  byId("state").className = `callout ${count ? "doubt" : error ? "bad" : "good"}`;
  byId("state").dataset.state = error ? "error" : "valid";
  const complete = error ?? "The study is complete and has no errors.";
  byId("state-text").textContent = count ? `${count} ${count === 1 ? "value is" : "values are"} missing. Enter goes from a field to the next missing one.` : complete;
  byId("to-line").hidden = !line;
  byId("to-line").textContent = `Show line ${line}`;
  showMissing(missing, goTo);
}

async function show() {
  const focus = document.activeElement?.id;
  setOptions(byId("preview-record"), state.experiments.map((row) => row.name));
  showGroups(state.groups);
  showChannels();
  showExperiments(state);
  showState();
  for (const [id, list] of [["undo", history.past], ["redo", history.future]]) byId(id).setAttribute("aria-disabled", String(!list.length));
  if (focus && document.activeElement?.id !== focus) byId(focus)?.focus({ preventScroll: true });
  await Promise.all([showArm(), previewed && preview()]);
}

async function load() {
  state = await getJson(api("study"));
  text.value = state.text;
  const stored = JSON.parse(sessionStorage.getItem(STORED) ?? "{}");
  if (stored.sha256 === state.sha256) Object.assign(history, { past: stored.past, future: stored.future });
  await show();
}

onClick(byId("save"), async () => {
  try {
    await save([]);
    showMessage("study.toml is saved.");
  } catch (error) {
    if (lineIn(error.message)) goToLine(lineIn(error.message));
    throw error;
  }
});
onClick(byId("reload"), () => mayDropText() && load());
onClick(byId("undo"), undo);
onClick(byId("redo"), redo);
byId("to-line").addEventListener("click", () => goToLine(lineIn(state.error)));
document.addEventListener("keydown", (event) => {
  goToNext(event);
  if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || event.target.matches("input:not([type=checkbox]), textarea")) return;
  event.preventDefault();
  act(null, event.shiftKey ? redo : undo);
});
document.addEventListener("selectionchange", () => {
  if (document.activeElement === text) byId("cursor").textContent = `Line ${text.value.slice(0, text.selectionStart).split("\n").length}`;
});
byId("rig").addEventListener("focusin", (event) => {
  editedJoint = Number(/^field-joint-(\d+)-/.exec(event.target.id)?.[1] ?? NaN);
  act(null, showArm);
});
window.addEventListener("beforeunload", (event) => { if (isTyped()) event.preventDefault(); });
byId("preview-record").addEventListener("change", showChannels);
byId("all-channels").addEventListener("change", showChannels);
act(null, async () => {
  await load();
  if (location.hash.startsWith("#field-")) goTo(location.hash.slice("#field-".length).split("-"));
});
