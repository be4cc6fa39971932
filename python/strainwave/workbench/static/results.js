// The table of results: sort, filter, choose columns, tick runs to compare, tag, copy or delete, read reports.
import { act, address, api, button, byId, getJson, make, onClick, postJson, showMessage, study } from "./client.js";
import { isActive } from "./run_events.js";
import { badge, copyText, duration, ofRun, progressOf, removeRuns, showRows, statusOf } from "./runs.js";

const STORED = `columns of ${study}`;
const MAX_CHIPS = 2; // in a row
const KINDS = { estimates: ["identify", "virtual"], designs: ["excite", "tune"], comparisons: ["compare"] };
const ticked = new Set(); // names of runs
let table = { runs: [], columns: [], units: {} };
let chosen = JSON.parse(localStorage.getItem(STORED) ?? "[]"); // columns; none: those of the server
let sorting = { key: "created", isDescending: true };

const query = (values) => `?${new URLSearchParams(values)}`;
const faint = (text) => make("span", { class: "faint" }, text);

// columns: key, title, value to sort by, cell; `isResult`: of finished runs only
function columns() {
  const number = true;
  const parameters = table.columns.map((label) => ({
    key: `parameter ${label}`, title: label, unit: table.units[label], number, isResult: true,
    value: (run) => run.cells[label]?.value, cell: (run) => parameterCell(run.cells[label]),
  }));
  const fits = ["worst", "mean"].map((key) => ({
    key, title: `${key} fit`, unit: "%", number, isResult: true,
    value: (run) => run[key], cell: (run) => make("td", { class: "number" }, run[key] == null ? "" : run[key].toFixed(1)),
  }));
  return [
    { key: "name", title: "run", value: (run) => run.name, cell: nameCell },
    { key: "status", title: "status", value: statusOf, cell: (run) => make("td", {}, badge(run)) },
    ...fits, ...parameters,
    { key: "created", title: "started", value: (run) => run.created, cell: (run) => make("td", { class: "time" }, shortTime(run.created)) },
    { key: "seconds", title: "duration", number, value: (run) => run.seconds, cell: (run) => make("td", { class: "number seconds" }, duration(run.seconds)) },
    { key: "options", title: "not the default", value: (run) => chipTexts(run).join(), cell: (run) => make("td", {}, optionChips(run)) },
    { key: "tags", title: "tags", value: (run) => run.tags.join(), cell: (run) => make("td", {}, tagChips(run)) },
  ];
}

const clock = new Intl.DateTimeFormat([], { month: "short", day: "numeric", hour: "2-digit", minute: "2-digit", hourCycle: "h23" });
const shortTime = (text) => (Number.isNaN(Date.parse(text)) ? "" : clock.format(Date.parse(text)));
const { compare } = new Intl.Collator([], { numeric: true });

function nameCell(run) {
  const onclick = (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return; // a new tab or window
    event.preventDefault();
    openReport(run.name);
  };
  const attributes = { href: query({ run: run.name }), "data-key": `open ${run.name}`, title: run.note || null, onclick };
  return make("th", { scope: "row" }, make("a", attributes, run.name));
}

function parameterCell(cell) {
  if (!cell) return make("td");
  if (cell.low == null) return make("td", { class: "number" }, cell.text);
  const title = `95 %: ${cell.low.toPrecision(6)} to ${cell.high.toPrecision(6)}`;
  return make("td", { class: "number", title }, cell.text, faint(` ± ${cell.half}`));
}

const changedStages = (run) => (run.stages && run.stages !== byId("settings").elements.stages[0].value ? [`stages ${run.stages}`] : []);
const equations = (values) => Object.entries(values).map(([name, value]) => `${name} = ${value}`);
const chipTexts = (run) => [...changedStages(run), ...equations(run.options), ...equations(run.rig)];

function optionChips(run) {
  const rig = equations(run.rig), texts = chipTexts(run), more = texts.slice(MAX_CHIPS);
  const chip = (text) => (rig.includes(text)
    ? make("span", { class: "chip doubt", title: `${text}: the study had another value in the run before` }, text)
    : make("span", { class: "chip", title: text }, text));
  const chips = texts.slice(0, MAX_CHIPS).map(chip);
  if (more.length) chips.push(make("span", { class: "chip", title: more.join("\n") }, `+${more.length}`));
  return make("div", { class: "chips" }, ...chips);
}

const tagChips = (run) => make("div", { class: "chips" }, ...run.tags.map((tag) =>
  button(tag, { class: "chip", "data-key": `tag ${tag} ${run.name}`, "aria-label": `Filter by the tag ${tag}` }, () => { byId("tagged").value = tag; show(); })));

// A cell with a box that ticks runs.
const tickCell = (what, key, runs, onChange) => make("td", {}, make("input", {
  type: "checkbox", "aria-label": `Tick ${what}`, "data-key": `tick ${key}`,
  checked: runs.length > 0 && runs.every((run) => ticked.has(run.name)),
  onchange: ({ target }) => {
    for (const run of runs) ticked[target.checked ? "add" : "delete"](run.name);
    onChange();
  },
}));

function row(run, all) {
  const results = all.filter((one) => one.isResult).length;
  const note = isActive(run) ? progressOf(run, () => act(null, refresh)) : run.message;
  const cells = all.flatMap((one) => {
    if (!note || !one.isResult) return [one.cell(run)];
    return one.key === "worst" ? [make("td", { colspan: results, class: isActive(run) ? null : "bad" }, note)] : [];
  });
  return make("tr", { "data-run": run.name, "data-state": run.state }, tickCell(run.name, run.name, [run], showTicked), ...cells);
}

function head(column) {
  const isSorted = sorting.key === column.key;
  const label = button(column.title, { class: "link", "data-key": `sort ${column.key}` }, () => {
    sorting = { key: column.key, isDescending: isSorted ? !sorting.isDescending : Boolean(column.number) };
    show();
  });
  const unit = column.unit ? [make("br"), `[${column.unit}]`] : [];
  const order = sorting.isDescending ? "descending" : "ascending";
  return make("th", { scope: "col", class: column.number ? "number" : null, "aria-sort": isSorted ? order : null }, label, ...unit);
}

function filtered() {
  const [kind, state, tag] = ["kind", "state", "tagged"].map((id) => byId(id).value);
  const words = byId("find").value.toLowerCase().split(/\s+/);
  return table.runs.filter((run) => {
    const text = [run.name, run.note, run.message, ...run.tags, ...chipTexts(run)].join(" ").toLowerCase();
    return (!kind || KINDS[kind].includes(run.kind)) && (!state || statusOf(run) === state)
      && (!tag || run.tags.includes(tag)) && words.every((word) => text.includes(word));
  });
}

function sorted(runs, column) {
  const sign = sorting.isDescending ? -1 : 1;
  return [...runs].sort((a, b) => {
    const [x, y] = [column.value(a), column.value(b)];
    if (x == null || y == null) return (x == null) - (y == null); // always last
    return sign * (typeof x === "number" ? x - y : compare(x, y));
  });
}

function show() {
  const all = columns();
  const runs = sorted(filtered(), all.find((one) => one.key === sorting.key) ?? all[0]);
  showRows(byId("heads"), [tickCell("all runs shown", "all", runs, show), ...all.map(head)], byId("table"));
  showRows(byId("runs"), runs.map((run) => row(run, all)), byId("table"));
  const more = table.total > table.runs.length ? `, the ${table.runs.length} newest of ${table.total}` : "";
  const reading = table.pending ? `; ${table.pending} results are being read` : "";
  byId("count").textContent = `${runs.length} of ${table.runs.length} runs${more}${reading}`;
  byId("none").hidden = table.runs.length > 0;
  byId("table").hidden = table.runs.length === 0;
  showTicked();
}

const choose = (select, values) => {
  const { value } = select;
  select.replaceChildren(select.options[0], ...[...new Set(values)].sort().map((one) => make("option", {}, one)));
  select.value = [...select.options].some((one) => one.value === value) ? value : "";
};

function showColumns() {
  byId("columns").replaceChildren(...Object.entries(table.units).map(([label, unit]) => {
    const onchange = ({ target }) => {
      chosen = [...byId("columns").querySelectorAll("input:checked")].map((one) => one.value);
      localStorage.setItem(STORED, JSON.stringify(chosen));
      act(target, refresh);
    };
    const box = make("input", { type: "checkbox", value: label, checked: table.columns.includes(label), onchange });
    return make("label", {}, box, ` ${label} `, faint(unit));
  }));
}

const tickedRuns = () => filtered().filter((run) => ticked.has(run.name));

function showTicked() {
  const runs = tickedRuns();
  const hidden = ticked.size - runs.length;
  const paths = runs.filter((run) => run.path).map((run) => ["path", run.path]).reverse(); // the oldest first
  byId("ticked").textContent = `${runs.length} ticked${hidden ? `, ${hidden} hidden` : ""}`;
  if (paths.length > 1) byId("compare").href = `/compare/${address(study)}${query(paths)}`;
  else byId("compare").removeAttribute("href");
}

// What an action applies to; its button stays enabled, since a disabled one loses the focus.
function required(most = Infinity) {
  const runs = tickedRuns();
  if (!runs.length || runs.length > most) throw new Error(most === 1 ? "Tick one run." : "Tick the runs first.");
  return runs;
}

let latest = 0;
// Read the table until all results are in it; returns the last answer.
export async function refresh() {
  const request = ++latest;
  let answer;
  do {
    answer = await getJson(api("estimate"), chosen.map((label) => ["column", label]));
    if (request !== latest) return answer; // a later one shows the table
    const isNew = Object.keys(answer.units).join() !== Object.keys(table.units).join();
    table = answer;
    for (const name of ticked) if (!table.runs.some((run) => run.name === name)) ticked.delete(name);
    choose(byId("state"), table.runs.map(statusOf));
    choose(byId("tagged"), table.runs.flatMap((run) => run.tags));
    byId("tags").replaceChildren(...[...byId("tagged").options].slice(1).map((one) => make("option", { value: one.value })));
    if (isNew) showColumns();
    show();
  } while (answer.pending);
  return answer;
}

// Fill the form with the options of a run; those that the study has already stay empty.
function useOptions(run) {
  for (const field of document.querySelectorAll("[data-option]")) {
    const kept = run.path && field.dataset.study ? field.dataset.default : ""; // the study has changed since
    const text = run.options[field.dataset.option] ?? kept;
    field.value = text === field.dataset.study ? "" : text.startsWith('"') ? JSON.parse(text) : text;
    field.dispatchEvent(new Event("input", { bubbles: true }));
  }
  const { stages } = byId("settings").elements;
  if ([...stages].some((one) => one.value === run.stages)) stages.value = run.stages;
  showMessage(`The form has the options of ${run.name}.`);
}

async function changeTicked(change) {
  try {
    await change(required().map((run) => run.name));
  } finally {
    await refresh();
    if (shownRun && !table.runs.some((run) => run.name === shownRun.name)) closeReport();
  }
}
const tagAs = (is_set) => changeTicked(async (names) => {
  const tag = byId("tag").value.trim();
  if (!tag) { byId("tag").focus(); throw new Error("Enter a tag."); }
  await postJson(api("tag-runs"), { names, tag, is_set });
});

function openReport(name) {
  window.history.pushState({ isOpened: true }, "", query({ run: name }));
  act(null, showReport);
}

function closeReport() {
  if (window.history.state?.isOpened) { window.history.back(); return; }
  window.history.replaceState(null, "", window.location.pathname);
  act(null, showReport);
}

let shownRun; // whose report is shown
export async function showReport() {
  const name = new URLSearchParams(window.location.search).get("run");
  const run = table.runs.find((one) => one.name === name);
  const before = shownRun;
  shownRun = run;
  byId("report").hidden = !run;
  if (!run) {
    if (before) document.querySelector(`[data-key="${CSS.escape(`open ${before.name}`)}"]`)?.focus();
    if (name) throw new Error(`There is no run ${name}.`);
    return;
  }
  byId("report-title").textContent = `${run.report ? "Report" : "Messages"} of ${run.name}`;
  for (const id of ["report-frame", "report-tab"]) byId(id).hidden = !run.report;
  byId("report-log").hidden = Boolean(run.report);
  byId("report-files").href = ofRun("files", run.name);
  byId("report-title").focus();
  byId("report").scrollIntoView();
  if (run.report) {
    const frame = byId("report-frame").cloneNode(); // a new one has no history of its own, which Back would follow
    frame.src = byId("report-tab").href = ofRun("report", run.name, run.report);
    byId("report-frame").replaceWith(frame);
  } else byId("report-log").textContent = run.note || (await getJson(api("run-log"), { name })).messages.join("\n");
}

for (const id of ["find", "kind", "state", "tagged"]) byId(id).addEventListener("input", show);
onClick(byId("add-tag"), () => tagAs(true));
onClick(byId("remove-tag"), () => tagAs(false));
onClick(byId("delete"), () => changeTicked(removeRuns));
onClick(byId("copy"), async () => copyText(required().flatMap((run) => run.lines).join("\n"), "The command line"));
onClick(byId("use"), async () => useOptions(required(1)[0]));
byId("report-use").addEventListener("click", () => useOptions(shownRun));
byId("tag").addEventListener("keydown", (event) => { if (event.key === "Enter") byId("add-tag").click(); });
byId("report-close").addEventListener("click", closeReport);
byId("report").addEventListener("keydown", (event) => { if (event.key === "Escape") closeReport(); });
window.addEventListener("popstate", () => act(null, showReport));
