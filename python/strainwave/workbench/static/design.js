// Page "Design": plan experiments and design servos through the command line.
import { act, address, byId, getJson, make, onClick, postJson, showMessage, study } from "./client.js";
import { draw } from "./figures.js";
import { isActive } from "./run_events.js";
import { badge, copyText, duration, ofRun, progressOf, removeRuns, showRows } from "./runs.js";

const api = (name) => `/api/${name}/${address(study)}`;
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
  const note = isActive(run) ? progressOf(run, () => act(null, () => refresh(run.name))) : run.state === "failed" ? run.messages.at(-1) : "";
  const button = (text, action) => {
    const element = make("button", { type: "button", "aria-label": `${text} ${run.name}`, "data-key": `${text === "Show" ? "open" : text} ${run.name}` }, text);
    onClick(element, action);
    return element;
  };
  const actions = isActive(run) ? [] : [
    button("Show", () => show(run)),
    button("Copy the command line", () => copyText(run.lines.join("\n"), "The command line")),
    button("Delete", async () => { if (await removeRuns([run.name])) await refresh(); }),
  ];
  return make("tr", { "data-run": run.name, "data-state": run.state },
    make("th", { scope: "row" }, run.name), make("td", {}, badge(run)), make("td", { class: "number seconds" }, duration(run.seconds)),
    make("td", { class: isActive(run) ? null : "bad" }, note), make("td", {}, make("div", { class: "row" }, ...actions)));
}

async function show(run) {
  shownRun = run.name;
  byId("shown").hidden = false;
  byId("shown-title").textContent = run.name;
  byId("messages").textContent = run.messages.join("\n");
  byId("files").replaceChildren(...run.files.map((file) => make("a", { class: "button", href: ofRun("download", run.name, file) }, file)),
    ...(run.files.length ? [make("a", { class: "button", href: ofRun("zip", run.name) }, "all as .zip")] : []));
  const plans = run.files.filter((file) => file.startsWith("apply-") && file.endsWith(".csv"));
  byId("plan").hidden = plans.length === 0;
  byId("tuned").hidden = !run.files.includes("tune.html");
  if (run.files.includes("tune.html")) byId("tuned").src = ofRun("report", run.name, "tune.html");
  if (!plans.length) return;
  byId("plan-file").replaceChildren(...plans.map((file) => make("option", {}, file)));
  await showPlan();
  const rows = await getJson(api("precision"), { run: run.name });
  byId("precision").replaceChildren(...rows.map((one) => make("tr", {}, make("th", { scope: "row" }, `${one.name} ${one.joint ?? ""}`), make("td", { class: "unit" }, one.unit),
    make("td", { class: "number" }, Number(one.value.toPrecision(5)).toString()),
    make("td", { class: "number" }, one.ci95 && one.value ? (50 * (one.ci95[1] - one.ci95[0]) / Math.abs(one.value)).toPrecision(2) : ""))));
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
      const options = {};
      for (const field of form.querySelectorAll("[data-flag]")) options[field.dataset.flag] = field.value;
      const run = await postJson(api("design"), { kind, parameters: byId(`${kind}-parameters`).value, options });
      showMessage(`${run.name} has started.`);
      await refresh();
    });
  });
}
byId("plan-file").addEventListener("change", () => act(byId("plan-file"), showPlan));
act(null, () => refresh());
