// Page "Import logs": upload files one after the other, then draft the study file.
import { act, address, byId, getJson, make, postJson, uploadFile } from "./client.js";

const folder = () => byId("folder").value.trim();

async function showLogs() {
  if (!folder()) return;
  const { logs, urdfs } = await getJson("/api/logs", { folder: folder() });
  byId("logs").replaceChildren(...logs.map((name) => {
    const box = make("input", { type: "checkbox", id: `log-${name}`, value: name, checked: true });
    return make("label", { for: box.id }, box, ` ${name}`);
  }));
  byId("urdf").replaceChildren(make("option", { value: "" }, "none"), ...urdfs.map((name) => make("option", {}, name)));
  if (urdfs.length === 1) byId("urdf").value = urdfs[0];
  byId("chosen").hidden = logs.length === 0;
  byId("draft").disabled = logs.length === 0;
}

async function upload(files) {
  if (!byId("import").reportValidity()) return;
  for (const file of files) {
    const item = make("li", {}, `${file.name}: uploading ${(file.size / 2 ** 20).toFixed(1)} MiB ...`);
    byId("uploads").append(item);
    try {
      await uploadFile(`/api/upload/${address(folder())}/${encodeURIComponent(file.name)}`, file);
      item.textContent = `${file.name}: stored`;
    } catch (error) {
      item.textContent = `${file.name}: ${error.message}`;
      item.className = "bad";
    }
  }
  await showLogs();
}

const drop = byId("drop");
drop.addEventListener("dragover", (event) => { event.preventDefault(); drop.classList.add("over"); });
drop.addEventListener("dragleave", () => drop.classList.remove("over"));
drop.addEventListener("drop", (event) => {
  event.preventDefault();
  drop.classList.remove("over");
  act(drop, () => upload([...event.dataTransfer.files]));
});
byId("files").addEventListener("change", () => act(drop, () => upload([...byId("files").files])));
byId("folder").addEventListener("change", () => act(null, showLogs));
byId("import").addEventListener("submit", (event) => {
  event.preventDefault();
  act(byId("draft"), async () => {
    const logs = [...document.querySelectorAll("#logs input:checked")].map((box) => box.value);
    const draft = await postJson("/api/draft", { folder: folder(), logs, urdf: byId("urdf").value });
    byId("summary").textContent = `${draft.path}: ${draft.joints} joint(s), ${draft.experiments} record(s), `
      + `${draft.channels.length} channel(s) guessed (${draft.channels.join(", ")}); ${draft.n_todos} value(s) are missing. ${draft.limit}`;
    byId("warnings").replaceChildren(...draft.warnings.map((text) => make("li", {}, text)));
    byId("continue").href = `/study/${address(draft.path)}`;
    byId("result").hidden = false;
    byId("continue").focus();
  });
});

// what was entered before this script ran
if (byId("files").files.length) act(drop, () => upload([...byId("files").files]));
else act(null, showLogs);
