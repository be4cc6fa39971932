// Page "Study": the experiments, logs that are added, and rig values of other studies.
import { act, address, byId, getJson, make, onClick, postJson, showMessage, study } from "./client.js";
import { showOverview } from "./overview.js";
import { save } from "./study.js";
import { fieldControl, idOf, keep, showValue } from "./study_form.js";
import { onFiles, uploadAll } from "./upload.js";

const api = (name) => `/api/${name}/${address(study)}`;
let state, sources = { logs: [], studies: [] };

const nameOf = (row) => row.cells[0].value;
const entryOf = (cell) => ({ ...cell, choices: cell.place[2] === "file" ? sources.logs : Object.keys(cell.choices) });

function buildCell(cell) {
  const control = fieldControl(idOf(cell.place), entryOf(cell), { class: cell.kind === "number" ? "short" : null });
  if (cell.kind === "choice") control.options[0].remove(); // there is no default
  return make("td", {}, control);
}

function freeName(name) {
  const names = state.experiments.map(nameOf);
  for (let k = 2; ; k += 1) if (!names.includes(`${name} (${k})`)) return `${name} (${k})`;
}

function buildRow(row) {
  const index = row.cells[0].place[1], at = (k, ...key) => ({ place: ["experiment", k, ...key], kind: "text" });
  const button = (text, changes) => {
    const one = make("button", { type: "button" }, text);
    onClick(one, () => save(changes()));
    return one;
  };
  const tr = make("tr", {}, ...row.cells.map((cell) => buildCell(cell)), make("td", {}, make("div", { class: "row" },
    button("Duplicate", () => [{ ...at(index + 1), value: tr.row.text }, { ...at(index + 1, "name"), value: freeName(nameOf(tr.row)) }]),
    button("Remove", () => [{ ...at(index), value: "" }]))));
  return tr;
}

function updateRow(tr, row) {
  tr.row = row;
  for (const [k, control] of tr.querySelectorAll("input, select").entries()) {
    const entry = entryOf(row.cells[k]);
    if (entry.kind === "choice") for (const one of entry.choices) if (![...control.options].some(({ value }) => value === one)) control.add(new Option(one));
    showValue(control, entry);
    for (const one of control.options ?? []) {
      const { value } = one, meaning = row.cells[k].choices[value];
      one.setAttribute("value", value); // without, the text is the value
      one.text = meaning ? `${value}: ${meaning}` : value;
    }
    control.setAttribute("aria-label", `${entry.title} of ${nameOf(row)}`);
  }
  for (const button of tr.querySelectorAll("button")) button.setAttribute("aria-label", `${button.textContent} ${nameOf(row)}`);
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
  byId("log").replaceChildren(...sources.logs.map((name) => make("option", {}, name)));
  byId("lender").replaceChildren(...sources.studies.map((name) => make("option", {}, name)));
  for (const id of ["log", "add"]) byId(id).disabled = sources.logs.length === 0;
  for (const id of ["lender", "take"]) byId(id).disabled = sources.studies.length === 0;
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
