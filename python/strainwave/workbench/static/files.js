// Page "Files": downloads, exports, and what repeats a run.
import { act, address, byId, getJson, make, onClick, postJson, showMessage, study } from "./client.js";

const api = (name) => `/api/${name}/${address(study)}`;
const of = (run, file) => `${address(study)}?run=${encodeURIComponent(run)}&file=${encodeURIComponent(file)}`;
let runs = [];

const size = (bytes) => bytes < 1e6 ? `${(bytes / 1e3).toFixed(1)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
const current = () => runs[byId("run").selectedIndex];

function show() {
  const run = current();
  byId("none").hidden = Boolean(run);
  if (!run) return;
  byId("state").textContent = run.state;
  byId("zip").href = `/zip/${address(study)}?run=${encodeURIComponent(run.name)}`;
  byId("files").replaceChildren(...run.files.map((file) => make("tr", {},
    make("th", { scope: "row" }, make("a", { href: `/download/${of(run.name, file.name)}` }, file.name)),
    make("td", { class: "number" }, size(file.size)))));
  byId("lines").textContent = run.lines.join("\n");
  byId("script").textContent = run.script;
  byId("script-part").hidden = !run.script;
  byId("script-file").href = `/script/${address(study)}?run=${encodeURIComponent(run.name)}`;
  byId("export").hidden = !run.has_result;
  byId("notes").replaceChildren();
}

async function refresh() {
  const name = current()?.name;
  runs = await getJson(api("files"));
  byId("run").replaceChildren(...runs.map((run) => make("option", {}, run.name)));
  const index = runs.findIndex((run) => run.name === name);
  if (index > 0) byId("run").selectedIndex = index;
  show();
}

onClick(byId("make"), async () => {
  const { file, messages } = await postJson(api("export"), { name: current().name, format: byId("format").value });
  await refresh();
  byId("notes").replaceChildren(
    make("li", {}, make("a", { href: `/download/${of(current().name, file)}` }, file)),
    ...messages.map((text) => make("li", {}, text)));
});
onClick(byId("copy"), async () => {
  await navigator.clipboard.writeText(byId("script").textContent);
  showMessage("The script is in the clipboard.");
});
byId("run").addEventListener("change", show);
act(null, refresh);
