// Page "Study": the form and the text show the same file; every change is saved at once.
import { act, address, byId, getJson, make, onClick, postJson, showMessage, study } from "./client.js";
import { showExperiments } from "./experiments.js";
import { draw } from "./figures.js";

const api = (name) => `/api/${name}/${address(study)}`;
let state;

let saving = Promise.resolve();

const isTyped = () => state !== undefined && byId("text").value !== state.text;

// Save the changes one after the other; a change of the form applies to the text as typed so far.
export function save(changes) {
  const saved = saving.then(async () => {
    const text = isTyped() ? { text: byId("text").value } : {};
    state = await postJson(api("study"), { sha256: state.sha256, changes, ...text });
    await show();
  });
  saving = saved.catch(() => {});
  return saved;
}

// Save one key; the focus stays where the user moved it.
const saveField = (control, entry) => act(control, () => save([{ ...entry, value: control.value }]));

export function fieldControl(id, entry, attributes = {}) {
  const { kind, choices, value } = entry;
  const control = kind === "choice"
    ? make("select", { id, ...attributes }, ...(choices.includes(value) ? [] : [make("option", { value }, value || "default")]), ...choices.map((one) => make("option", {}, one)))
    : make("input", { id, ...attributes });
  control.value = value;
  control.addEventListener("change", () => saveField(control, entry));
  return control;
}

function isImplausible(field) {
  const size = Math.abs(Number(field.value));
  return field.value !== "" && !Number.isNaN(size) && field.key.range != null && (size < field.key.range[0] || size > field.key.range[1]);
}

function rigField(field) {
  const id = `field-${field.place.join("-")}`;
  const range = field.key.range == null ? "" : ` Plausible: ${field.key.range[0]} to ${field.key.range[1]}.`;
  const entry = { place: field.place, kind: field.key.kind, choices: field.choices, value: field.value };
  const control = fieldControl(id, entry, { "aria-describedby": `${id}-hint`, "aria-invalid": isImplausible(field) ? "true" : null });
  return make("div", { class: field.is_todo ? "rig-field todo" : "rig-field" },
    make("label", { for: id }, field.key.title), control, make("span", { class: "unit" }, field.key.unit),
    make("p", { class: "hint", id: `${id}-hint` }, (field.is_todo ? "Missing. " : "") + `${field.meaning}.${range}`,
      ...(field.reason ? [make("span", { class: "reason" }, ` In the file: ${field.reason}`)] : [])));
}

function channelRow(row) {
  const columns = state.columns[byId("preview-record").value] ?? [];
  const place = (key) => ["channels", row.channel, key];
  const id = (key) => `channel-${row.channel}-${key}`;
  const names = row.column && !columns.includes(row.column) ? [row.column, ...columns] : columns;
  const select = make("select", { id: id("column"), "aria-label": `Column of ${row.channel}` },
    make("option", { value: "" }, columns.includes(row.channel) ? `${row.channel} (same name)` : "none"),
    ...names.map((name) => make("option", {}, name)));
  select.value = row.column;
  select.addEventListener("change", () => act(select, () => save(select.value
    ? [{ place: place("column"), kind: "text", value: select.value }]
    : [{ place: ["channels", row.channel], kind: "text", value: "" }])));
  const number = (key, fallback) => fieldControl(id(key), { place: place(key), kind: "number", choices: [], value: row[key] },
    { "aria-label": `${key} of ${row.channel}`, placeholder: fallback, disabled: !row.column });
  const look = make("button", { type: "button", "aria-label": `Preview ${row.channel}` }, "Show");
  onClick(look, () => preview(row));
  return make("tr", {}, make("th", { scope: "row" }, row.channel), make("td", {}, row.unit),
    make("td", {}, select, ...(row.reason ? [make("span", { class: "hint reason" }, row.reason)] : [])), make("td", {}, number("scale", "1")), make("td", {}, number("offset", "0")), make("td", {}, look));
}

async function preview(row) {
  const place = byId("preview");
  place.hidden = false;
  const query = { experiment: byId("preview-record").value, channel: row.channel, column: row.column || row.channel, scale: row.scale, offset: row.offset };
  await draw(place, await getJson(api("preview"), query), { layout: { showlegend: false } });
}

function showChannels() {
  const columns = state.columns?.[byId("preview-record").value] ?? [];
  const used = state.channels.filter((row) => byId("all-channels").checked || row.column || columns.includes(row.channel));
  byId("channels").replaceChildren(...used.map(channelRow));
}

async function show() {
  const focus = document.activeElement?.id;
  byId("state").textContent = state.error ?? "The study is complete and has no errors.";
  byId("state").className = `callout ${state.error ? (state.todos ? "doubt" : "bad") : "good"}`;
  byId("state").dataset.state = state.error ? "error" : "valid";
  byId("text").value = state.text;
  byId("rig").replaceChildren(...state.groups.map((group) =>
    make("fieldset", {}, make("legend", {}, group.title), ...group.fields.map(rigField))));
  const record = byId("preview-record").value;
  byId("preview-record").replaceChildren(...state.experiments.map((row) => make("option", {}, row.name)));
  if (state.experiments.some((row) => row.name === record)) byId("preview-record").value = record;
  showChannels();
  showExperiments(state);
  if (focus) byId(focus)?.focus({ preventScroll: true });
  byId("arm").hidden = !state.arm;
  byId("no-arm").hidden = Boolean(state.arm);
  if (state.arm) await draw(byId("arm"), state.arm);
}

onClick(byId("save"), async () => {
  await save([]);
  showMessage("study.toml is saved.");
});
onClick(byId("reload"), async () => {
  if (isTyped() && !window.confirm("Drop the text that is not saved?")) return;
  state = await getJson(api("study"));
  await show();
});
window.addEventListener("beforeunload", (event) => { if (isTyped()) event.preventDefault(); });
byId("preview-record").addEventListener("change", showChannels);
byId("all-channels").addEventListener("change", showChannels);
act(null, async () => { state = await getJson(api("study")); await show(); });
