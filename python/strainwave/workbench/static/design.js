// Page "Design": plan experiments and design servos through the command line.
import { act, api, byId, cell, setOptions, getJson, make, number, onChange, onClick, postJson, row, showMessage } from "./client.js";
import { draw } from "./figures.js";
import { isActive } from "./run_events.js";
import { badge, copyText, duration, ofRun, progressOf, removeRuns, showRows } from "./runs.js";

const PANEL = 160; // [px]
let shownRun = null;

async function refresh(open) {
  const designs = await getJson(api("designs"));
  byId("none").hidden = designs.length > 0;
  byId("table").hidden = designs.length === 0;
  showRows(byId("designs"), designs.map(designRow), byId("designs-title"));
  const wanted = designs.find((one) => one.name === open);
  if (wanted && !isActive(wanted)) await show(wanted);
}

function designRow(run) {
  const isRunning = isActive(run);
  const note = isRunning ? progressOf(run, () => act(null, () => refresh(run.name))) : run.state === "failed" ? run.messages.at(-1) : "";
  const button = (text, key, action) => {
    const element = make("button", { type: "button", "aria-label": `${text} ${run.name}`, "data-key": `${key} ${run.name}` }, text);
    onClick(element, action);
    return element;
  };
  const actions = isRunning ? [] : [
    button("Show", "open", () => show(run)),
    button("Copy the command line", "copy", () => copyText(run.lines.join("\n"), "The command line")),
    button("Delete", "delete", async () => { if (await removeRuns([run.name])) await refresh(); }),
  ];
  const shown = row(run.name, make("td", {}, badge(run)), cell(duration(run.seconds), "number seconds"),
    cell(note, isRunning ? null : "bad"), make("td", {}, make("div", { class: "row" }, ...actions)));
  Object.assign(shown.dataset, { run: run.name, state: run.state });
  return shown;
}

async function show(run) {
  shownRun = run.name;
  byId("shown").hidden = false;
  byId("shown-title").textContent = run.name;
  byId("messages").textContent = run.messages.join("\n");
  const link = (text, href) => make("a", { class: "button", href }, text);
  byId("files").replaceChildren(...run.files.map((file) => link(file, ofRun("download", run.name, file))),
    run.files.length ? link("all as .zip", ofRun("zip", run.name)) : "");
  const plans = run.files.filter((file) => file.startsWith("apply-") && file.endsWith(".csv"));
  byId("plan").hidden = plans.length === 0;
  byId("tuned").hidden = !run.files.includes("tune.html");
  if (run.files.includes("tune.html")) byId("tuned").src = ofRun("report", run.name, "tune.html");
  if (!plans.length) return;
  setOptions(byId("plan-file"), plans);
  await showPlan();
  const rows = await getJson(api("precision"), { run: run.name });
  byId("precision").replaceChildren(...rows.map(precisionRow));
}

function precisionRow({ name, joint, unit, value, ci95 }) {
  const share = ci95 && value ? (50 * (ci95[1] - ci95[0]) / Math.abs(value)).toPrecision(2) : "";
  return row(`${name} ${joint ?? ""}`, cell(unit, "unit"), number(Number(value.toPrecision(5))), number(share));
}

async function showPlan() {
  const figure = await getJson(api("plan"), { run: shownRun, file: byId("plan-file").value });
  byId("plan-plot").style.height = `${60 + PANEL * figure.data.length}px`;
  await draw(byId("plan-plot"), figure, { layout: { showlegend: false } });
}

for (const form of document.querySelectorAll("form[data-command]")) {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const kind = form.dataset.command;
    act(form.querySelector("button"), async () => {
      const options = Object.fromEntries([...form.querySelectorAll("[data-flag]")].map((field) => [field.dataset.flag, field.value]));
      const run = await postJson(api("design"), { kind, parameters: byId(`${kind}-parameters`).value, options });
      showMessage(`${run.name} has started.`);
      await refresh();
    });
  });
}
onChange(byId("plan-file"), showPlan);
act(null, () => refresh());
