// Page "Files": downloads, exports, and what repeats a run; the address names the run.
import { act, api, byId, getJson, make, onClick, postJson } from "./client.js";
import { badge, copyText, ofRun, statusOf } from "./runs.js";

const kilobytes = (bytes) => (bytes / 1e3).toLocaleString("en", { minimumFractionDigits: 1, maximumFractionDigits: 1 });
let run; // shown

async function refresh(name = "") {
  const runs = await getJson(api("files"), { run: name });
  const kinds = [...new Set(runs.map((one) => one.kind))].sort();
  byId("run").replaceChildren(...kinds.map((kind) => make("optgroup", { label: kind },
    ...runs.filter((one) => one.kind === kind).map((one) => make("option", { value: one.name }, `${one.name}: ${statusOf(one)}`)))));
  run = runs.find((one) => one.name === name) ?? runs[0];
  byId("none").hidden = Boolean(run);
  byId("shown").hidden = !run;
  if (!run) return;
  byId("run").value = run.name;
  byId("state").replaceChildren(badge(run));
  byId("zip").href = ofRun("zip", run.name);
  const files = run.files ?? [];
  byId("files").replaceChildren(...files.map((file) => make("tr", {},
    make("th", { scope: "row" }, make("a", { href: ofRun("download", run.name, file.name) }, file.name)),
    make("td", { class: "number" }, kilobytes(file.size)))));
  byId("total").textContent = kilobytes(files.reduce((sum, file) => sum + file.size, 0));
  byId("lines").textContent = run.lines.join("\n");
  byId("script").textContent = run.script ?? "";
  byId("script-part").hidden = !run.script;
  byId("script-file").href = ofRun("script", run.name);
  byId("export").hidden = !run.has_result;
  byId("notes").replaceChildren();
}

onClick(byId("make"), async () => {
  const { file, messages } = await postJson(api("export"), { name: run.name, format: byId("format").value });
  await refresh(run.name);
  byId("notes").replaceChildren(
    make("li", {}, make("a", { href: ofRun("download", run.name, file) }, file)),
    ...messages.map((text) => make("li", {}, text)));
});
onClick(byId("copy"), () => copyText(run.script, "The script"));
onClick(byId("copy-lines"), () => copyText(run.lines.join("\n"), "The command line"));
const named = () => new URLSearchParams(window.location.search).get("run") ?? "";
byId("run").addEventListener("change", () => act(byId("run"), async () => {
  window.history.replaceState(null, "", `?${new URLSearchParams({ run: byId("run").value })}`);
  await refresh(named());
}));
act(null, () => refresh(named()));
