// Page "Study": the experiments, logs that are added, and rig values of other studies.
import { act, api, button, byId, getJson, make, onClick, postJson, setOptions, showMessage, study } from "./client.js";
import { showOverview } from "./overview.js";
import { save } from "./study.js";
import { fieldControl, keep, showValue } from "./study_form.js";
import { onFiles, uploadAll } from "./upload.js";

let state, sources = { logs: [], studies: [] };

const entryOf = (cell) => (cell.place[2] === "file" ? { ...cell, choices: sources.logs } : cell);

function freeName(name) {
  const names = state.experiments.map((row) => row.name);
  for (let k = 2; ; k += 1) if (!names.includes(`${name} (${k})`)) return `${name} (${k})`;
}

function buildRow(row) {
  const index = row.cells[0].place[1], at = (k, ...key) => ({ place: ["experiment", k, ...key], kind: "text" });
  const duplicate = () => save([{ ...at(index + 1), value: tr.row.text }, { ...at(index + 1, "name"), value: freeName(tr.row.name) }]);
  const remove = () => save([{ ...at(index), value: "" }]);
  const cells = row.cells.map((cell) => fieldControl(entryOf(cell), { class: cell.kind === "number" && "short" }));
  const actions = make("div", { class: "row" }, button("Duplicate", {}, duplicate), button("Remove", {}, remove));
  const tr = make("tr", {}, ...[...cells, actions].map((one) => make("td", {}, one)));
  return tr;
}

function updateRow(tr, row) {
  tr.row = row;
  for (const [k, control] of tr.querySelectorAll("input, select").entries()) {
    showValue(control, entryOf(row.cells[k]));
    control.setAttribute("aria-label", `${row.cells[k].title} of ${row.name}`);
  }
  for (const one of tr.querySelectorAll("button")) one.setAttribute("aria-label", `${one.textContent} ${row.name}`);
}

export function showExperiments(next) {
  state = next;
  const heads = state.experiments[0]?.cells.map((cell) => make("th", { scope: "col" }, cell.title)) ?? [];
  byId("experiment-heads").replaceChildren(...heads, make("th", { scope: "col" }, "actions"));
  keep(byId("experiments"), state.experiments, (row) => String(row.cells[0].place[1]), buildRow, updateRow);
  act(null, () => showOverview(state));
}

async function listSources() {
  sources = await getJson(api("experiments"));
  for (const [list, action, names] of [["log", "add", sources.logs], ["lender", "take", sources.studies]]) {
    setOptions(byId(list), names);
    byId(list).disabled = byId(action).disabled = names.length === 0;
  }
  if (state) showExperiments(state);
}

async function addLogs(logs, repairs = []) {
  const { changes, notes } = await postJson(api("experiments"), { logs });
  await save(changes);
  showMessage([`Added: ${notes.join(", ")}.`, ...repairs].join(" "));
}

async function takeValues(source) {
  const { changes } = await postJson(api("rig-values"), source);
  if (changes.length) await save(changes);
  const names = changes.map(({ place: [table, index, key] }) => (key === undefined ? index : `${key} of ${table} ${index + 1}`));
  showMessage(changes.length ? `${changes.length} values are taken: ${names.join(", ")}.` : "All these values are in the study already.");
}

onFiles(async (dropped) => {
  if (dropped.values) await takeValues({ values: dropped.values });
  const { stored, notes } = await uploadAll(dropped, study.slice(0, Math.max(0, study.lastIndexOf("/"))));
  await listSources();
  const logs = stored.filter((name) => sources.logs.includes(name)); // no URDF
  if (logs.length) await addLogs(logs, notes);
});
onClick(byId("add"), () => addLogs([byId("log").value]));
onClick(byId("take"), () => takeValues({ study: byId("lender").value }));
act(null, listSources);
