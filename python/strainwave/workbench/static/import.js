// Pages "Import logs" and "Studies": store what is dropped, draft its study, and go there.
import { act, address, byId, getJson, make, onChange, postJson, setOptions, showMessage } from "./client.js";
import { onFiles, uploadAll } from "./upload.js";

const folder = () => byId("folder").value.trim();
const known = [...byId("folders").options].map((one) => one.value); // folders with logs
let values = "", notes = [];

async function showLogs() {
  const { logs, urdfs } = await getJson("/api/logs", { folder: folder() });
  byId("logs").replaceChildren(...logs.map((name) => {
    const box = make("input", { type: "checkbox", id: `log-${name}`, value: name, checked: true });
    return make("label", { for: box.id }, box, ` ${name}`);
  }));
  setOptions(byId("urdf"), [["", "none"], ...urdfs]);
  if (urdfs.length === 1) byId("urdf").value = urdfs[0];
  byId("chosen").hidden = logs.length === 0;
  return urdfs.length < 2;
}

async function draft() {
  showMessage("Reading the logs and drafting the study ...");
  const logs = [...document.querySelectorAll("#logs input:checked")].map((box) => box.value);
  const answer = await postJson("/api/draft", { folder: folder(), logs, urdf: byId("urdf").value, values });
  sessionStorage.setItem(`notes of ${answer.path}`, JSON.stringify([...notes, ...answer.notes]));
  location.assign(`/study/${address(answer.path)}`);
}

onFiles(async (dropped) => {
  byId("import").hidden = false;
  if (!dropped.uploads.length) throw new Error(dropped.others.length ? `No log is among these files: ${dropped.others.join(", ")}. Save tables as CSV, Parquet, MAT, HDF5, NumPy or JSON.` : "Values alone make no study: drop them with the logs.");
  const wanted = folder() || dropped.name;
  byId("folder").value = known.includes(wanted) ? wanted : (await getJson("/api/free-folder", { name: wanted })).folder;
  const { stored, notes: repairs } = await uploadAll(dropped, folder());
  [values, notes] = [dropped.values, folder() === wanted ? repairs : [`The folder is named ${folder()} instead of ${wanted}.`, ...repairs]];
  if (!stored.length) return;
  if (await showLogs()) await draft();
  else showMessage("Choose the URDF of the arm, then press Draft the study.");
});
onChange(byId("folder"), showLogs);
byId("import").addEventListener("submit", (event) => {
  event.preventDefault();
  act(byId("draft"), draft);
});
if (folder()) act(null, showLogs); // entered before this script ran
