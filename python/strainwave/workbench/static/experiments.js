// Page "Study": the experiments, logs that are added, and rig values of other studies.
import { act, address, byId, getJson, make, onClick, postJson, showMessage, study } from "./client.js";
import { showOverview } from "./overview.js";
import { save } from "./study.js";
import { onFiles, uploadAll } from "./upload.js";

const api = (name) => `/api/${name}/${address(study)}`;
let state, sources = { logs: [], studies: [] };

function cellControl(row, cell) {
  const [, index, key] = cell.place, attributes = { id: `experiment-${index}-${key}`, "aria-label": `${cell.title} of ${row.name}` };
  const logs = Object.fromEntries(sources.logs.map((name) => [name, ""])), choices = key === "file" ? logs : cell.choices;
  const options = Object.entries(cell.value in choices ? choices : { [cell.value]: "", ...choices });
  const control = cell.kind === "choice"
    ? make("select", attributes, ...options.map(([value, meaning]) => make("option", { value }, meaning ? `${value}: ${meaning}` : value)))
    : make("input", { ...attributes, class: cell.kind === "number" ? "short" : null });
  control.value = cell.value;
  control.addEventListener("change", () => act(control, () => save([{ ...cell, value: control.value }])));
  return control;
}

function freeName(name) {
  const names = state.experiments.map((row) => row.name);
  for (let k = 2; ; k += 1) if (!names.includes(`${name} (${k})`)) return `${name} (${k})`;
}

function rowOf(row, index) {
  const button = (text, changes, next) => {
    const one = make("button", { type: "button", id: `${text}-${index}`, "aria-label": `${text} ${row.name}` }, text);
    onClick(one, async () => { await save(changes()); byId(next)?.focus(); });
    return one;
  };
  const at = (k, ...key) => ({ place: ["experiment", k, ...key], kind: "text" });
  const duplicate = () => [{ ...at(index + 1), value: row.text }, { ...at(index + 1, "name"), value: freeName(row.name) }];
  return make("tr", {}, ...row.cells.map((cell) => make("td", {}, cellControl(row, cell))),
    make("td", {}, make("div", { class: "row" }, button("Duplicate", duplicate, `experiment-${index + 1}-name`), button("Remove", () => [{ ...at(index), value: "" }], `Remove-${Math.max(0, index - 1)}`))));
}

export function showExperiments(next) {
  state = next;
  const heads = state.experiments[0]?.cells.map((cell) => make("th", { scope: "col" }, cell.title)) ?? [];
  byId("experiment-heads").replaceChildren(...heads, make("th", { scope: "col" }, "actions"));
  byId("experiments").replaceChildren(...state.experiments.map(rowOf));
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
