// Files that are dropped on a page or chosen: what they are, and uploads that can be cancelled.
import { act, byId, getJson, make } from "./client.js";

const nameOf = (path) => path.slice(path.lastIndexOf("/") + 1);
const folderOf = (path) => path.slice(0, Math.max(0, path.lastIndexOf("/")));
const isHidden = (path) => path.split("/").some((part) => /^(\.|__|runs$|runs-)/.test(part)); // runs: results, no logs

async function filesIn(entry) {
  if (entry instanceof File) return [{ file: entry, path: entry.name }];
  if (entry.isFile) return [{ file: await new Promise((found, fail) => entry.file(found, fail)), path: entry.fullPath.slice(1) }];
  const reader = entry.createReader(), inside = [];
  for (let some; some?.length !== 0; inside.push(...some)) some = await new Promise((found, fail) => reader.readEntries(found, fail)); // 100 at most
  return (await Promise.all(inside.map(filesIn))).flat();
}

// The text of a study or data sheet whose values can be taken; undefined for other files.
async function valuesIn(file) {
  if (!/\.(toml|json)$/i.test(file.name) || file.size > 2 ** 20) return undefined;
  const text = await file.text();
  if (/\.toml$/i.test(file.name)) return text;
  try {
    const { arm, servo, joint } = JSON.parse(text);
    return arm?.constructor === Object || servo?.constructor === Object || Array.isArray(joint) ? text : undefined;
  } catch {
    return undefined; // JSON lines, or null
  }
}

// Sort { file, path } into uploads, the text with values, and files of other types.
async function sorted(entries) {
  const suffixes = byId("files").accept.split(","), visible = entries.filter(({ path }) => !isHidden(path));
  const bags = new Set(visible.filter(({ path }) => nameOf(path) === "metadata.yaml").map(({ path }) => folderOf(path)));
  const roots = new Set(visible.map(({ path }) => path.split("/")[0]));
  const dropped = { uploads: [], values: "", others: [], name: suggestedName([...roots]) };
  for (const { file, path } of visible) {
    const isBag = bags.has(folderOf(path)), text = isBag ? undefined : await valuesIn(file);
    if (text !== undefined) dropped.values ||= text;
    else if (!suffixes.some((one) => path.toLowerCase().endsWith(one)) || (!isBag && path.endsWith(".yaml"))) dropped.others.push(nameOf(path));
    else if (isBag) dropped.uploads.push({ file, name: nameOf(path), bag: folderOf(path) });
    else dropped.uploads.push({ file, name: roots.size === 1 && path.includes("/") ? path.slice(path.indexOf("/") + 1) : path, bag: "" });
  }
  return dropped;
}

// A name of what was dropped: that of the only folder or file, what several names begin with, or the day.
function suggestedName(roots) {
  if (roots.length === 1) return roots[0].replace(/(?<=.)\.[^.]*(\.gz|\.zst)?$/, "");
  const [first, ...others] = roots;
  let common = first ?? "";
  while (!others.every((one) => one.startsWith(common))) common = common.slice(0, -1);
  common = common.replace(/[\s_.-]*\d*$/, "");
  return common.length > 2 ? common : `logs ${new Date().toISOString().slice(0, 10)}`;
}

// Send one file; `row` shows the progress, and its button cancels.
function send(url, file, row, cancel) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest(), bar = make("progress", { max: file.size || 1, value: 0, "aria-label": `Upload of ${file.name}` });
    row.append(bar);
    cancel.addEventListener("click", () => request.abort());
    request.upload.addEventListener("progress", (event) => { bar.value = event.loaded; });
    request.addEventListener("load", () => (request.status === 200 ? resolve(request.response) : reject(new Error(request.response?.error ?? `the server answered ${request.status}`))));
    request.addEventListener("abort", () => reject(new Error("cancelled")));
    request.addEventListener("error", () => reject(new Error("the server does not answer, or the file has changed")));
    request.open("PUT", url);
    request.responseType = "json";
    request.send(file);
  });
}

// Upload one file after the other into a folder; returns the stored names, and notes on repaired ones.
export async function uploadAll({ uploads, others }, folder) {
  const list = byId("uploads"), stored = [], notes = [], bags = {};
  const note = (name, text) => { notes.push(`${name}: ${text}`); return `${name}: ${text}`; };
  const rows = uploads.toSorted((a, b) => a.name.localeCompare(b.name)).map(({ file, name, bag }) => {
    const cancel = make("button", { type: "button", "aria-label": `Cancel ${name}` }, "Cancel"), row = make("li", {}, `${name} (${(file.size / 2 ** 20).toFixed(1)} MiB) `, cancel);
    cancel.addEventListener("click", () => { row.dataset.cancelled = "true"; });
    return { file, name, bag, row, cancel };
  });
  list.replaceChildren(...rows.map(({ row }) => row), ...(others.length ? [make("li", { class: "faint" }, note("Left out", `${others.join(", ")}, which are no logs.`))] : []));
  for (const { file, name, bag, row, cancel } of rows) {
    try {
      if (row.dataset.cancelled) throw new Error("cancelled");
      if (bag && !bags[bag]) bags[bag] = (await getJson("/api/free-folder", { parent: folder, name: nameOf(bag) })).folder;
      const answer = await send(`/api/upload?${new URLSearchParams({ folder: bag ? bags[bag] : folder, name })}`, file, row, cancel);
      const kept = bag ? nameOf(bags[bag]) : answer.name;
      if (!stored.includes(kept)) stored.push(kept);
      row.textContent = !bag && kept !== name ? note(name, `stored as ${kept}.`) : `${name}: stored`;
    } catch (error) {
      row.textContent = note(name, error.message);
      row.className = "bad";
    }
  }
  return { stored, notes };
}

// Call `take` with what is dropped anywhere on the page, chosen, or pasted outside of a field.
export function onFiles(take) {
  const drop = byId("drop");
  const run = (gather) => act(drop, async () => take(await sorted(await gather())));
  const isFiles = (event) => event.dataTransfer?.types.includes("Files");
  document.addEventListener("dragover", (event) => { if (isFiles(event)) { event.preventDefault(); document.body.classList.add("over"); } });
  document.addEventListener("dragleave", (event) => { if (!event.relatedTarget) document.body.classList.remove("over"); });
  document.addEventListener("drop", (event) => {
    if (!isFiles(event)) return;
    event.preventDefault();
    document.body.classList.remove("over");
    const roots = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry?.() ?? item.getAsFile()); // before the first wait
    run(async () => (await Promise.all(roots.filter(Boolean).map(filesIn))).flat());
  });
  document.addEventListener("paste", (event) => {
    const text = event.clipboardData.getData("text");
    if (event.target.matches("input, textarea") || !text.includes("=") && !text.includes("{")) return;
    run(() => [{ file: new File([text], text.trimStart().startsWith("{") ? "pasted.json" : "pasted.toml"), path: "pasted" }]);
  });
  for (const input of [byId("files"), byId("directory")]) {
    const choose = () => run(() => [...input.files].map((file) => ({ file, path: file.webkitRelativePath || file.name })));
    input.addEventListener("change", choose);
    if (input.files.length) choose(); // chosen before this script ran
  }
}
