// Page "Study": the form. Controls stay the same elements while their values change.
import { button, byId, make, onChange, setOptions } from "./client.js";
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
  if (entry.kind === "choice") setOptions(control, entry.choices.some((one) => [one].flat()[0] === text) ? entry.choices : [text, ...entry.choices]);
  shown.set(control, { entry, text });
  if (isTyped) return;
  control.value = text;
  control.setAttribute("aria-invalid", String(isImplausible(entry)));
}

function isImplausible({ value, range }) {
  const size = Math.abs(Number(value));
  return range != null && value !== "" && !Number.isNaN(size) && (size < range[0] || size > range[1]);
}

// A control of one key: `entry` has its place, kind, choices and value.
export function fieldControl(entry, attributes = {}) {
  const control = make(entry.kind === "choice" ? "select" : "input", { id: idOf(entry.place), autocomplete: "off", ...attributes });
  showValue(control, entry);
  onChange(control, () => saveField(control));
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

const entryOf = ({ key, choices, units }, field) => ({
  ...field, kind: key.kind, choices: [["", "default"], ...choices], units, range: key.range,
  unit: key.unit.split(",")[0], unitKey: `${field.place[0]}.${key.key}`,
});

function unitMenu(row, update) {
  const entry = entryOf(row, row.fields[0]);
  if (row.units.length < 2) return entry.unit;
  const menu = make("select", { "aria-label": `Unit of ${row.key.title}` });
  setOptions(menu, row.units.map(({ name }) => name));
  menu.value = unitOf(entry).name || row.units[0].name;
  onChange(menu, () => {
    chosenUnits[entry.unitKey] = menu.value;
    localStorage.setItem(STORED, JSON.stringify(chosenUnits));
    update();
  });
  return menu;
}

function explanationOf({ key, meaning, fields }) {
  const reasons = fields.map((field, k) => field.reason && (fields.length > 1 ? `Joint ${k + 1}: ${field.reason}` : field.reason));
  const without = key.default === "required" ? "The study needs a value." : key.default && `Without a value: ${key.default.replaceAll("`", "")}.`;
  return [`${meaning.slice(0, 1).toUpperCase()}${meaning.slice(1)}.`, key.range == null ? "" : `Plausible: ${key.range[0]} to ${key.range[1]} ${key.unit}.`,
    without, `Key in the file: ${key.key}.`, ...new Set(reasons)].filter(Boolean).map((line) => make("div", {}, line));
}

// A button that copies the values of joint 1 to all joints, as one change.
function copyButton(label, text, rowsOf) {
  const changes = () => rowsOf().flatMap(({ key, fields: [first, ...others] }) => others
    .filter(({ value }) => first.value !== "" && value !== first.value)
    .map(({ place }) => ({ place, kind: key.kind, value: first.value })));
  return button(text, { class: "quiet", "aria-label": label, title: label }, () => save(changes));
}

function buildRow(row, count) {
  if (!row.key) return make("tbody", {}, make("tr", {}, make("th", { scope: "rowgroup", class: "section", colspan: count + 3 }, row.section)));
  const { title, key } = row.key, about = `about-${row.fields[0].place[0]}-${key}`;
  const body = make("tbody"), isCopied = count > 1 && row.key.kind !== "text"; // a text is the name of one joint
  const control = (field, k) => fieldControl(entryOf(row, field), { "aria-label": count > 1 ? `${title} of joint ${k + 1}` : title, "aria-describedby": about });
  body.append(
    make("tr", {}, make("th", { scope: "row" }, title, make("button", { type: "button", class: "tip", "aria-label": `About ${title}`, "aria-expanded": "false", "aria-controls": about }, "?")),
      make("td", { class: "unit" }, unitMenu(row, () => updateRow(body, body.row, false))), ...row.fields.map((field, k) => make("td", {}, control(field, k))),
      ...(isCopied ? [make("td", {}, copyButton(`Copy ${title} of joint 1 to all joints`, "copy", () => [body.row]))] : [])),
    make("tr", { class: "explanation", id: about, hidden: true }, make("td", { colspan: count + 3 })));
  return body;
}

const isOptional = (row) => row.fields.every((field) => field.value === "" && !field.is_missing);

function updateRow(body, row, isHidden) {
  body.row = row;
  body.hidden = isHidden && !body.contains(document.activeElement);
  if (!row.key) return;
  for (const field of row.fields) {
    const control = body.querySelector(`[id="${idOf(field.place)}"]`);
    showValue(control, entryOf(row, field));
    control.title = [`${row.meaning}${row.key.unit && ` [${row.key.unit}]`}`, field.reason].filter(Boolean).join("\n");
  }
  body.querySelector(".explanation > td").replaceChildren(...explanationOf(row));
}

function buildGroup({ title, rows: [{ fields }] }) {
  const more = button("", { class: "quiet more" }, () => {
    if (!opened.delete(title)) opened.add(title);
    updateGroup(section, section.group);
  });
  const all = () => section.group.rows.filter((row) => row.key.group !== "placement");
  const heads = fields.length > 1 ? [make("thead", { "data-key": "heads" }, make("tr", {}, make("td"), make("th", { scope: "col" }, "unit"),
    ...fields.map((_, k) => make("th", { scope: "col" }, `Joint ${k + 1}`)), make("td", {}, copyButton("Copy all values of joint 1 except its placement to all joints", "copy all", all))))] : [];
  const section = make("section", { class: "group" }, make("h3", {}, title),
    make("div", { class: "wide", role: "region", "aria-label": `Table: ${title}`, tabindex: "0" }, make("table", {}, ...heads)), more);
  return section;
}

function updateGroup(section, group) {
  section.group = group;
  const { title, rows } = group, isOpen = opened.has(title), table = section.querySelector("table"), count = rows.filter(isOptional).length;
  const entries = [...new Set(rows.map((row) => row.section))].flatMap((name) => {
    const inside = rows.filter((row) => row.section === name);
    return [...(name ? [{ section: name, isHidden: inside.every(isOptional) }] : []), ...inside.map((row) => ({ ...row, isHidden: isOptional(row) }))];
  });
  keep(table, [...(table.tHead ? [{ section: "heads" }] : []), ...entries], (row) => row.key ? `${row.key.key} ${row.key.unit}` : row.section,
    (row) => buildRow(row, rows[0].fields.length), (body, row) => { if (body !== table.tHead) updateRow(body, row, row.isHidden && !isOpen); });
  const more = section.querySelector(".more");
  more.hidden = count === 0;
  more.setAttribute("aria-expanded", String(isOpen));
  more.textContent = isOpen ? "Hide empty optional rows" : `Show ${count} optional ${count === 1 ? "row" : "rows"}`;
}

// Focus a field, also one of a row that is hidden.
export function focusField(control) {
  const section = control.closest(".group");
  if (section && control.closest("[hidden]")) {
    opened.add(section.group.title);
    updateGroup(section, section.group);
  }
  control.scrollIntoView({ block: "center" });
  control.focus({ preventScroll: true });
}

export const showGroups = (groups) =>
  keep(byId("rig"), groups, ({ title, rows }) => `${title} ${rows[0].fields.length}`, buildGroup, updateGroup);

// The list of missing values; each leads to its field, whose label is its title.
export function showMissing(missing, goTo) {
  const wanted = new Set(missing.map((one) => idOf(one.place)));
  keep(byId("missing-list"), missing, (one) => idOf(one.place), (one) => {
    const label = byId(idOf(one.place))?.getAttribute("aria-label") ?? one.place.join(" ");
    return make("li", { title: one.hint }, button(label, { class: "link" }, () => goTo(one.place)), " ", make("span", { class: "hint" }, one.hint));
  }, () => {});
  for (const control of document.querySelectorAll("[id^=field-]")) {
    control.classList.toggle("missing", wanted.has(control.id));
    if (control instanceof HTMLInputElement) control.placeholder = wanted.has(control.id) ? "missing" : control.dataset.default ?? "";
  }
}
