// Page "Study": the form. Controls stay the same elements while their values change.
import { act, byId, make, onClick } from "./client.js";
import { save } from "./study.js";

const NUMBER = /[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?/gi;
const DIGITS = 12; // of a value in another unit: more are rounding
const STORED = "strainwave units"; // chosen units by key, in the browser's storage
const chosenUnits = JSON.parse(localStorage.getItem(STORED) ?? "{}");
const shown = new WeakMap(); // control -> its entry, and the text of the file that it shows
const opened = new Set(); // titles of groups that show their optional rows

export const idOf = (place) => `field-${place.join("-")}`;

// Make the children of an element those of the entries, in order; each keeps its element by its key.
export function keep(parent, entries, keyOf, build, update) {
  const keys = new Set(entries.map(keyOf)), old = new Map();
  for (const child of [...parent.children]) {
    if (keys.has(child.dataset.key)) old.set(child.dataset.key, child);
    else child.remove();
  }
  entries.forEach((entry, index) => {
    const key = keyOf(entry), child = old.get(key) ?? build(entry);
    child.dataset.key = key;
    if (parent.children[index] !== child) parent.insertBefore(child, parent.children[index] ?? null);
    update(child, entry);
  });
}

const unitOf = (entry) => (entry.units ?? []).find((one) => one.name === chosenUnits[entry.unitKey]) ?? { name: "", factor: 1, power: 1 };

function inUnit(value, { factor, power }) {
  if (factor === 1 && power === 1) return value;
  return value.replace(NUMBER, (number) => String(Number(((Number(number) / factor) ** power).toPrecision(DIGITS))));
}

// Show the value of the file, unless the user has typed another one that is not saved.
export function showValue(control, entry) {
  const isTyped = shown.has(control) && control.value !== shown.get(control).text;
  const text = inUnit(entry.value, unitOf(entry));
  if (control instanceof HTMLSelectElement && ![...control.options].some((one) => one.value === text)) control.prepend(make("option", { value: text }, text));
  if (!isTyped) control.value = text;
  shown.set(control, { entry, text });
  if (!isTyped) control.setAttribute("aria-invalid", String(isImplausible(entry)));
}

function isImplausible({ value, range }) {
  const size = Math.abs(Number(value));
  return range != null && value !== "" && !Number.isNaN(size) && (size < range[0] || size > range[1]);
}

// A control of one key: `entry` has its place, kind, choices, value and title.
export function fieldControl(id, entry, attributes = {}) {
  const control = entry.kind === "choice"
    ? make("select", { id, ...attributes }, make("option", { value: "" }, "default"), ...entry.choices.map((one) => make("option", {}, one)))
    : make("input", { id, autocomplete: "off", ...attributes });
  showValue(control, entry);
  control.addEventListener("change", () => act(control, () => saveField(control)));
  return control;
}

// Save one key; the focus stays where the user moved it.
async function saveField(control) {
  const { entry } = shown.get(control), typed = control.value, unit = unitOf(entry);
  const change = { place: entry.place, kind: entry.kind, value: typed, is_list: entry.is_list, unit: entry.unit ?? "", chosen: unit.name };
  try {
    await save([change], () => { if (control.value === typed) shown.get(control).text = typed; });
  } catch (error) {
    control.setAttribute("aria-invalid", "true");
    throw new Error(`${control.getAttribute("aria-label")}: ${error.message}`);
  }
}

const entryOf = (row, field) => ({ ...field, kind: row.key.kind, choices: row.choices, units: row.units, range: row.key.range, unit: row.key.unit.split(",")[0], unitKey: `${field.place[0]}.${row.key.key}` });

function unitMenu(row, update) {
  if (row.units.length < 2) return make("span", {}, row.key.unit.split(",")[0]);
  const key = entryOf(row, row.fields[0]).unitKey;
  const menu = make("select", { "aria-label": `Unit of ${row.key.title}` }, ...row.units.map(({ name }) => make("option", {}, name)));
  menu.value = chosenUnits[key] ?? row.units[0].name;
  menu.addEventListener("change", () => {
    chosenUnits[key] = menu.value;
    localStorage.setItem(STORED, JSON.stringify(chosenUnits));
    update();
  });
  return menu;
}

function explanationOf(row, columns) {
  const { range, unit } = row.key, text = row.key.default.replaceAll("`", "");
  const reasons = row.fields.map((field, k) => field.reason && `${columns.length > 1 ? `${columns[k]}: ` : ""}${field.reason}`);
  return [
    `${row.meaning}.`, range == null ? "" : `Plausible: ${range[0]} to ${range[1]} ${unit}.`, text && `Without a value: ${text}.`,
    `Key: ${row.key.key}.`, ...new Set(reasons),
  ].filter(Boolean).map((line) => make("div", {}, line));
}

// The changes that give all joints the values of joint 1.
const copies = (rows) => rows.flatMap(({ key, fields: [first, ...others] }) => first.value === "" ? []
  : others.filter(({ value }) => value !== first.value).map(({ place }) => ({ place, kind: key.kind, value: first.value })));

function copyButton(label, text, rows) {
  const button = make("button", { type: "button", class: "quiet", "aria-label": label, title: label }, text);
  onClick(button, () => save(() => copies(rows())));
  return button;
}

function buildRow(row, group) {
  if (!row.key) return make("tbody", {}, make("tr", {}, make("th", { scope: "rowgroup", class: "section", colspan: group.columns.length + 3 }, row.section)));
  const { title, key } = row.key, explanation = make("tr", { class: "explanation", id: `about-${row.fields[0].place[0]}-${key}`, hidden: true }, make("td", { colspan: group.columns.length + 3 }));
  const body = make("tbody");
  const update = () => updateRow(body, body.row, body.group);
  body.append(
    make("tr", {}, make("th", { scope: "row" }, title, make("button", { type: "button", class: "tip", "aria-label": `About ${title}`, "aria-expanded": "false", "aria-controls": explanation.id }, "?")), make("td", { class: "unit" }, unitMenu(row, update)),
      ...row.fields.map((field, k) => make("td", {}, fieldControl(idOf(field.place), entryOf(row, field), { "aria-label": group.columns.length > 1 ? `${title} of ${group.columns[k].toLowerCase()}` : title }))),
      ...(group.columns.length > 1 ? [make("td", {}, copyButton(`Copy ${title} of joint 1 to all joints`, "copy", () => [body.row]))] : [])),
    explanation);
  return body;
}

const isOptional = (row) => row.fields.every((field) => field.value === "" && !field.is_missing);

function updateRow(body, row, group) {
  Object.assign(body, { row, group }); // for the buttons of the row
  const rows = row.key ? [row] : group.rows.filter((one) => one.section === row.section);
  body.hidden = !opened.has(group.title) && rows.every(isOptional) && !body.contains(document.activeElement);
  if (!row.key) return;
  for (const field of row.fields) {
    const control = byId(idOf(field.place)) ?? body.querySelector(`[id="${idOf(field.place)}"]`);
    showValue(control, entryOf(row, field));
    control.title = [`${row.meaning}${row.key.unit && ` [${row.key.unit}]`}`, field.reason].filter(Boolean).join("\n");
  }
  body.querySelector(".explanation > td").replaceChildren(...explanationOf(row, group.columns));
}

function buildGroup(group) {
  const more = make("button", { type: "button", class: "quiet more" });
  more.addEventListener("click", () => {
    if (!opened.delete(group.title)) opened.add(group.title);
    updateGroup(section, section.group);
  });
  const heads = group.columns.length > 1
    ? [make("thead", { "data-key": "heads" }, make("tr", {}, make("td"), make("th", { scope: "col" }, "unit"), ...group.columns.map((title) => make("th", { scope: "col" }, title)),
      make("td", {}, copyButton("Copy all values of joint 1 except its placement to all joints", "copy all", () => section.group.rows.filter((row) => row.key.group !== "placement")))))]
    : [];
  const section = make("section", { class: "group" }, make("h3", {}, group.title),
    make("div", { class: "wide", role: "region", "aria-label": group.title, tabindex: "0" }, make("table", {}, ...heads)), more);
  return section;
}

function updateGroup(section, group) {
  section.group = group;
  const sections = [...new Set(group.rows.map((row) => row.section))];
  const entries = sections.flatMap((name) => [...(name ? [{ section: name }] : []), ...group.rows.filter((row) => row.section === name)]);
  const table = section.querySelector("table"), count = group.rows.filter(isOptional).length, isOpen = opened.has(group.title);
  const heads = table.tHead ? [table.tHead] : [];
  keep(table, [...heads, ...entries], (one) => one === table.tHead ? "heads" : one.key?.key ?? one.section,
    (row) => buildRow(row, group), (body, row) => { if (row !== table.tHead) updateRow(body, row, group); });
  const more = section.querySelector(".more");
  more.hidden = count === 0;
  more.setAttribute("aria-expanded", String(isOpen));
  more.textContent = isOpen ? "Hide empty optional rows" : `Show ${count} optional ${count === 1 ? "row" : "rows"}`;
}

export const showGroups = (groups) =>
  keep(byId("rig"), groups, (group) => `${group.title} ${group.columns.length}`, buildGroup, updateGroup);

// The list of missing values; each leads to its field.
export function showMissing(missing, goTo) {
  keep(byId("missing-list"), missing, (one) => idOf(one.place), (one) => {
    const button = make("button", { type: "button", class: "link" }, one.title);
    button.addEventListener("click", () => goTo(one));
    return make("li", { title: one.hint }, button, " ", make("span", { class: "hint" }, one.hint));
  }, () => {});
  const wanted = new Set(missing.map((one) => idOf(one.place)));
  for (const control of document.querySelectorAll("[id^=field-]")) {
    control.classList.toggle("missing", wanted.has(control.id));
    if (control instanceof HTMLInputElement) control.placeholder = wanted.has(control.id) ? "missing" : control.dataset.default ?? "";
  }
}
