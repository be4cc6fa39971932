// Page "Estimate": start runs, follow and cancel them, choose order and horizon.
import { act, address, byId, getJson, make, onClick, postJson, showMessage, study } from "./client.js";
import { draw } from "./figures.js";
import { follow, isActive } from "./run_events.js";

const api = (name) => `/api/${name}/${address(study)}`;
const WAITING = { waiting: "waiting for another run", running: "starting" };
const MARKS = { determined: "good", "partly-determined": "doubt", "not-determined": "bad", "inconsistent-input": "bad" };

function button(text, action, attributes = {}) {
  const element = make("button", { type: "button", ...attributes }, text);
  onClick(element, action);
  return element;
}

function showReport(name) {
  byId("report").hidden = false;
  byId("report-title").textContent = `Report of ${name}`;
  byId("report-frame").src = `/report/${address(study)}?run=${encodeURIComponent(name)}`;
  byId("report").scrollIntoView();
}

function progressCell(run) {
  const bar = make("progress", { max: "1", value: "0", "aria-label": `Progress of ${run.name}` });
  const text = make("span", { class: "faint" }, WAITING[run.state]);
  follow(run.name, (event) => {
    if (event.progress?.fraction != null) bar.value = event.progress.fraction;
    text.textContent = event.progress?.activity ?? WAITING[event.state] ?? event.state;
    const row = bar.closest("tr");
    if (!row || !isActive(event)) return;
    row.dataset.state = row.querySelector(".badge").textContent = event.state;
  }, () => act(null, refresh));
  return make("td", {}, bar, text);
}

function endCell(run) {
  const lines = run.lines.map((line) => make("code", {}, line));
  const messages = run.note ? [make("p", { class: "faint" }, run.note)] : [];
  if (run.state === "failed") {
    const log = make("p", { class: "bad", "data-log": run.name });
    getJson(api("run-log"), { name: run.name }).then((read) => { log.textContent = read.messages.join("\n"); });
    messages.push(log);
  }
  return make("td", {}, ...lines, ...messages);
}

function runRow(run) {
  const state = run.status ?? run.state;
  const mark = MARKS[run.status] ?? { failed: "bad", interrupted: "doubt", cancelled: "doubt" }[run.state] ?? "";
  const actions = make("div", { class: "row" });
  if (isActive(run)) {
    actions.append(button("Cancel", async () => { await postJson(api("cancel-run"), { name: run.name }); await refresh(); }));
  } else {
    if (run.status) actions.append(button("Report", () => showReport(run.name), { "aria-label": `Report of ${run.name}` }));
    actions.append(button("Delete", async () => {
      if (!window.confirm(`Delete the run ${run.name} and its files?`)) return;
      await postJson(api("remove-run"), { name: run.name });
      await refresh();
    }, { "aria-label": `Delete ${run.name}` }));
  }
  return make("tr", { "data-run": run.name, "data-state": run.state },
    make("th", { scope: "row" }, run.name),
    make("td", {}, make("span", { class: `badge ${mark}` }, state)),
    make("td", {}, run.created ? new Date(run.created).toLocaleString() : ""),
    isActive(run) ? progressCell(run) : endCell(run), make("td", {}, actions));
}

let isNamed = false; // whether the user has typed the name of the next run
byId("name").addEventListener("input", () => { isNamed = true; });

async function refresh() {
  const { gate, runs, name } = await getJson(api("estimate"));
  byId("gate").textContent = gate.reason;
  byId("gate").className = `callout ${{ consistent: "good", overridden: "doubt", suspected: "bad", invalid: "bad" }[gate.state] ?? ""}`;
  if (!gate.is_open) byId("gate").append(" ", make("a", { href: `/check/${address(study)}` }, "Open the page Check."));
  byId("start").disabled = !gate.is_open;
  if (!isNamed) byId("name").value = name;
  byId("none").hidden = runs.length > 0;
  byId("runs").replaceChildren(...runs.map(runRow));
}

byId("settings").addEventListener("submit", (event) => {
  event.preventDefault();
  act(byId("start"), async () => {
    const options = {};
    for (const field of document.querySelectorAll("[data-option]")) options[field.dataset.option] = field.value;
    if (byId("order").value) options["statespace.order"] = byId("order").value;
    if (byId("horizon").value) options["statespace.horizon"] = byId("horizon").value;
    const stages = new FormData(byId("settings")).get("stages");
    await postJson(api("estimate"), { name: byId("name").value, stages, options, figures: byId("figures").checked });
    isNamed = false;
    showMessage("The run has started.");
    await refresh();
  });
});

let orders = [];
async function showOrder() {
  const entry = orders[byId("order-record").selectedIndex];
  byId("order-text").textContent = `${entry.experiment}, joint ${entry.joint}: order ${entry.order}, horizon ${entry.horizon} samples`;
  byId("order-plot").hidden = false;
  await draw(byId("order-plot"), entry.figure);
}
onClick(byId("orders"), async () => {
  byId("order-text").textContent = "Computing the rigid and joint models ...";
  try {
    orders = await getJson(api("orders"));
  } catch (error) {
    byId("order-text").textContent = error.message;
    return;
  }
  byId("order-record").replaceChildren(...orders.map((one) => make("option", {}, one.experiment)));
  byId("order-record").disabled = false;
  await showOrder();
});
byId("order-record").addEventListener("change", () => act(null, showOrder));
// a click on a singular value selects the order
byId("order-plot").addEventListener("click", () => {
  const point = byId("order-plot")._hoverdata?.[0];
  if (point) byId("order").value = Math.min(Math.max(point.x, 2), 10);
});

act(null, refresh);
