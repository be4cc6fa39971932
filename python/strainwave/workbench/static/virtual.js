// Page "Virtual arm": set, record, identify, and compare with the truth.
import { act, address, byId, cell, getJson, number, onClick, postJson, row } from "./client.js";
import { follow } from "./run_events.js";
import { MARKS, activity, duration } from "./runs.js";

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

const isInside = ({ ci95, true: truth }) => Boolean(ci95) && ci95[0] <= truth && truth <= ci95[1];

const estimateRow = (one) => row(one.label, cell(one.unit, "unit"), number(digits(one.true)),
  number(one.value == null ? "not identified" : digits(one.value)),
  number(one.ci95 ? one.ci95.map(digits).join(" to ") : ""),
  number(one.percent?.toFixed(3) ?? ""), number(one.stds?.toFixed(1) ?? ""),
  cell(one.ci95 ? (isInside(one) ? "yes" : "no") : "", isInside(one) ? "good" : "doubt"));

async function showResult(study) {
  const { rows, status, run } = await getJson(`/api/virtual/${address(study)}`);
  const known = rows.filter((one) => one.ci95);
  byId("verdict").textContent = `${status}: ${known.filter(isInside).length} of ${known.length} intervals contain the true value.`;
  byId("verdict").className = `callout ${MARKS[status] ?? "bad"}`;
  byId("verdict").dataset.status = status;
  byId("rows").replaceChildren(...rows.map(estimateRow));
  byId("open-report").href = `/report/${address(study)}?run=${run}`;
  for (const page of ["signals", "design", "by-hand"]) byId(`open-${page}`).href = `/${page}/${address(study)}`;
  byId("result").hidden = false;
}

async function start() {
  byId("result").hidden = byId("empty").hidden = true;
  const run = await postJson("/api/virtual", setting());
  running = run;
  byId("running").hidden = byId("cancel").hidden = false;
  byId("bar").value = 0;
  const end = await new Promise((resolve) => follow(run.name, (event) => {
    byId("activity").textContent = `${activity(event)}, ${duration(event.seconds)}`;
    if (event.progress?.fraction != null) byId("bar").value = (1 + event.progress.fraction) / STEPS; // of the second command
  }, resolve, run.study));
  byId("cancel").hidden = true;
  byId("bar").value = 1;
  const isDone = end.state === "done";
  byId("activity").textContent = isDone ? `in ${run.study.replace("/study.toml", "")}` : `${end.state}: ${end.messages?.at(-1) ?? end.note}`;
  if (isDone) await showResult(run.study);
}

byId("rig").addEventListener("submit", (event) => { event.preventDefault(); act(byId("run"), start); });
onClick(byId("cancel"), () => postJson(`/api/cancel-run/${address(running.study)}`, { name: running.name }));
