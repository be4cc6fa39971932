// Page "By hand": sliders, simulated curves and Bode plot. One request at a time; the newest values win.
import { act, address, byId, make, onClick, postJson, showMessage, study } from "./client.js";
import { draw } from "./figures.js";

const api = (name) => `/api/${name}/${address(study)}`;
const STEPS = 1000; // of a slider
const MIN_WAIT = 2; // [ms]
let sliders = [], busy = false, again = false, latest = 0;

const setting = () => ({
  experiment: byId("record").value,
  start: byId("start").value,
  from: byId("from").value === "" ? null : Number(byId("from").value),
});
const values = () => sliders.map(({ name, joint, field }) => ({ name, joint, value: Number(field.value) }));

async function update() {
  if (busy) { again = true; return; }
  busy = true;
  try {
    do {
      again = false;
      const begin = performance.now();
      const chosen = setting();
      const answer = await postJson(api("by-hand"), {
        ...chosen, values: values(), channels: [byId("channel-a").value, byId("channel-b").value],
        joint: byId("joint") ? Number(byId("joint").value) : null,
      });
      byId("fits").replaceChildren(...Object.values(answer.fits).map((fit) => make("td", { class: "number" }, fit == null ? "rest" : `${fit.toFixed(1)} %`)));
      await draw(byId("time"), answer.time);
      byId("bode").hidden = !answer.bode;
      if (answer.bode) await draw(byId("bode"), answer.bode);
      byId("note").textContent = "";
      byId("note").dataset.record = chosen.experiment;
      byId("note").dataset.milliseconds = (performance.now() - begin).toFixed(0);
      byId("note").dataset.server = answer.milliseconds.toFixed(0);
      if (again) await new Promise((resolve) => setTimeout(resolve, MIN_WAIT));
    } while (again);
  } catch (error) {
    byId("note").textContent = error.message;
  } finally {
    busy = false;
  }
  if (again) await update();
}

const toSlider = (one, value) => one.is_log
  ? STEPS * Math.log(value / one.low) / Math.log(one.high / one.low)
  : STEPS * (value - one.low) / (one.high - one.low);
const toValue = (one, step) => one.is_log
  ? one.low * (one.high / one.low) ** (step / STEPS)
  : one.low + (one.high - one.low) * step / STEPS;

function sliderRow(one, index) {
  const id = `slider-${index}`;
  const range = make("input", { type: "range", id, min: 0, max: STEPS, step: 1 });
  const field = make("input", { type: "number", step: "any", "aria-label": `Value of ${one.label} [${one.unit}]` });
  const hold = make("input", { type: "checkbox", "aria-label": `Hold ${one.label} in a fit` });
  const row = make("div", { class: "slider", title: one.description },
    make("label", { for: id }, `${one.label} `, make("span", { class: "faint" }, one.unit)), range, field,
    make("span", { class: "hold" }, hold, " hold"));
  const show = (value) => {
    field.value = Number(value.toPrecision(6));
    range.value = toSlider(one, value);
    row.classList.toggle("changed", Number(field.value) !== Number(one.value.toPrecision(6)));
  };
  range.addEventListener("input", () => { show(toValue(one, Number(range.value))); update(); });
  field.addEventListener("change", () => { show(Number(field.value)); update(); });
  row.addEventListener("dblclick", () => { show(one.value); update(); });
  show(one.value);
  return { ...one, row, field, hold, show };
}

function showSliders() {
  const groups = new Map();
  for (const one of sliders) {
    const title = one.is_of_link ? `Link ${one.joint}` : one.joint ? `Joint ${one.joint}` : "Arm";
    groups.set(title, [...(groups.get(title) ?? []), one.row]);
  }
  byId("sliders").replaceChildren(...[...groups].map(([title, rows]) =>
    make("details", { open: !title.startsWith("Link") }, make("summary", {}, title), ...rows)));
}

async function begin() {
  byId("note").textContent = "Preparing the record ...";
  const request = ++latest;
  const answer = await postJson(api("by-hand-begin"), setting());
  if (request !== latest) return; // another record was chosen in the meantime
  sliders = answer.sliders.map(sliderRow);
  showSliders();
  byId("fit-heads").replaceChildren(...answer.channels.map((name) => make("th", { scope: "col", class: "number" }, `fit of ${name}`)));
  for (const [id, preferred] of [["channel-a", 0], ["channel-b", Math.min(1, answer.channels.length - 1)]]) {
    const before = byId(id).value;
    byId(id).replaceChildren(...answer.channels.map((name) => make("option", {}, name)));
    byId(id).value = answer.channels.includes(before) ? before : answer.channels[preferred];
  }
  await update();
}

async function fit() {
  const held = sliders.filter((one) => one.hold.checked).map((one) => one.label);
  const run = await postJson(api("by-hand-fit"), { values: values(), held });
  showMessage(`The run ${run.name} has started; see the page Estimate.`);
}

if (byId("record")) {
  for (const id of ["record", "start", "from"]) byId(id).addEventListener("change", () => act(byId(id), begin));
  for (const id of ["channel-a", "channel-b", "joint"]) byId(id)?.addEventListener("change", update);
  byId("reset").addEventListener("click", () => { sliders.forEach((one) => one.show(one.value)); update(); });
  onClick(byId("fit"), fit);
  onClick(byId("save"), async () => {
    const { file } = await postJson(api("by-hand-save"), { name: byId("name").value, values: values() });
    showMessage(`The values are in ${file}.`);
  });
  act(null, begin);
}
