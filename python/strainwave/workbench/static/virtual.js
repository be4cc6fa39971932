// Page "Virtual arm": set, record, identify, and compare with the truth.
import { act, address, byId, getJson, make, onClick, postJson } from "./client.js";
import { follow } from "./run_events.js";

const MARKS = { determined: "good", "partly-determined": "doubt" };
const STEPS = 2; // commands of a run: simulate, identify
let running = null;

const digits = (value) => (value == null ? "" : Number(value.toPrecision(5)).toString());

for (const slider of document.querySelectorAll("[data-setting]")) {
  slider.addEventListener("input", () => { byId(`${slider.id}-value`).textContent = slider.value; });
}

function setting() {
  const body = { spring: byId("spring").value };
  for (const slider of document.querySelectorAll("[data-setting]")) body[slider.id] = Number(slider.value);
  for (const box of document.querySelectorAll("[data-sensor]")) body[box.id] = box.checked;
  return body;
}

function row(one) {
  const isInside = one.ci95 && one.ci95[0] <= one.true && one.true <= one.ci95[1];
  const inside = one.ci95 ? (isInside ? "yes" : "no") : "";
  const number = (text) => make("td", { class: "number" }, text);
  return make("tr", {}, make("th", { scope: "row" }, one.label), make("td", { class: "unit" }, one.unit), number(digits(one.true)),
    number(one.value == null ? "not identified" : digits(one.value)),
    number(one.ci95 ? `${digits(one.ci95[0])} to ${digits(one.ci95[1])}` : ""),
    number(one.percent == null ? "" : one.percent.toFixed(3)), number(one.stds == null ? "" : one.stds.toFixed(1)),
    make("td", { class: isInside ? "good" : "doubt" }, inside));
}

async function showResult(study) {
  const { rows, status, run } = await getJson(`/api/virtual/${address(study)}`);
  const known = rows.filter((one) => one.ci95);
  const inside = known.filter((one) => one.ci95[0] <= one.true && one.true <= one.ci95[1]).length;
  byId("verdict").textContent = `${status}: ${inside} of ${known.length} intervals contain the true value.`;
  byId("verdict").className = `callout ${MARKS[status] ?? "bad"}`;
  byId("verdict").dataset.status = status;
  byId("rows").replaceChildren(...rows.map(row));
  byId("open-report").href = `/report/${address(study)}?run=${run}`;
  for (const name of ["signals", "design"]) byId(`open-${name}`).href = `/${name}/${address(study)}`;
  byId("open-hand").href = `/by-hand/${address(study)}`;
  byId("result").hidden = false;
}

async function start() {
  byId("result").hidden = byId("empty").hidden = true;
  const run = await postJson("/api/virtual", setting());
  running = run;
  byId("running").hidden = byId("cancel").hidden = false;
  byId("bar").value = 0;
  await new Promise((resolve) => follow(run.name, (event) => {
    const isIdentifying = event.progress?.fraction != null;
    byId("activity").textContent = event.progress?.activity ?? event.state;
    if (isIdentifying) byId("bar").value = (1 + event.progress.fraction) / STEPS;
  }, async (event) => {
    byId("cancel").hidden = true;
    byId("activity").textContent = event.state === "done" ? `in ${run.study.replace("/study.toml", "")}` : `${event.state}: ${event.messages.at(-1) ?? ""}`;
    byId("bar").value = 1;
    if (event.state === "done") await act(null, () => showResult(run.study));
    resolve();
  }, run.study));
}

byId("rig").addEventListener("submit", (event) => { event.preventDefault(); act(byId("run"), start); });
onClick(byId("cancel"), () => postJson(`/api/cancel-run/${address(running.study)}`, { name: running.name }));
