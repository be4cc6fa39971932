// Page "By hand": sliders, simulated curves and Bode plot. One request at a time; the newest values win.
import { act, api, byId, setOptions, head, make, number, onChange, onClick, postJson, showMessage } from "./client.js";
import { draw } from "./figures.js";

const STEPS = 1000; // of a slider
const MIN_WAIT = 2; // [ms]
let sliders = [], channels = [], busy = false, again = false, latest = 0;
let shownBode = ""; // as text: a figure that stays is not drawn again
const channelFields = [byId("channel-a"), byId("channel-b")];
let past = [], current = "", saved = {}; // values as text: before each change, now, and by file

const setting = () => ({
  experiment: byId("record").value,
  start: byId("start").value,
  from: byId("from").value === "" ? null : Number(byId("from").value),
});
const values = () => sliders.map((one) => ({ name: one.name, joint: one.joint, value: one.now() }));
const snapshot = () => JSON.stringify(sliders.map((one) => one.now()));

// Text of a number field: five digits, small and large numbers with an exponent.
function digits(value) {
  const rounded = Number(value.toPrecision(5)), size = Math.abs(rounded);
  return rounded && (size < 1e-3 || size >= 1e6) ? rounded.toExponential() : String(rounded);
}

function note(text, isError = false) {
  byId("note").textContent = text;
  byId("note").className = isError ? "bad" : "faint";
}

async function update() {
  if (busy) { again = true; return; }
  busy = true;
  try {
    do {
      again = false;
      const begin = performance.now();
      const chosen = setting();
      const answer = await postJson(api("by-hand"), {
        ...chosen, values: values(), channels: channelFields.map((field) => field.value),
        joint: Number(byId("joint").value),
      });
      const fits = Object.entries(answer.fits);
      byId("fit-heads").replaceChildren(...fits.map(([name]) => head(`fit of ${name}`, "number")));
      byId("fits").replaceChildren(...fits.map(([, fit]) => number(fit == null ? "rest" : `${fit.toFixed(1)} %`)));
      if (byId("bode").parentElement.hidden !== !answer.bode) { // the plots get other widths
        byId("bode").parentElement.hidden = !answer.bode;
        window.dispatchEvent(new Event("resize"));
      }
      await draw(byId("time"), answer.time);
      note("");
      byId("note").dataset.record = chosen.experiment;
      byId("note").dataset.milliseconds = (performance.now() - begin).toFixed(0);
      byId("note").dataset.server = answer.milliseconds.toFixed(0);
      const bode = JSON.stringify(answer.bode);
      if (answer.bode && bode !== shownBode && !again) { // after the curves: a dragged slider waits less
        await draw(byId("bode"), answer.bode);
        shownBode = bode;
      }
      if (again) await new Promise((resolve) => setTimeout(resolve, MIN_WAIT));
    } while (again);
  } catch (error) {
    note(error.message, true);
  } finally {
    busy = false;
  }
  if (again) await update();
}

// Say whether the values are those of the start or of a file.
function showState() {
  const file = Object.keys(saved).findLast((name) => saved[name] === snapshot());
  byId("state").textContent = file ? `The values are those of ${file}.` : "The values are changed and not saved.";
}

// Remember the values before the last change.
function commit() {
  if (snapshot() === current) return;
  past.push(current);
  current = snapshot();
  showState();
}

function undo() {
  if (!past.length) { showMessage("There is no change to undo."); return; }
  current = past.pop();
  JSON.parse(current).forEach((value, index) => sliders[index].show(value));
  showState();
  update();
}

const toSlider = (one, value) => one.is_log
  ? STEPS * Math.log(value / one.low) / Math.log(one.high / one.low)
  : STEPS * (value - one.low) / (one.high - one.low);
const toValue = (one, step) => one.is_log
  ? one.low * (one.high / one.low) ** (step / STEPS)
  : one.low + (one.high - one.low) * step / STEPS;

// Put a number back and say so if a field has none; returns whether it has one.
function isNumber(field, label, before) {
  if (field.value !== "" && Number.isFinite(Number(field.value))) return true;
  field.value = before;
  showMessage(`The field ${label} takes a number; ${before === "" ? "it stays empty" : `${before} stays`}.`, true);
  return false;
}

function sliderRow(one, index) {
  const id = `slider-${index}`;
  const range = make("input", { type: "range", id, min: 0, max: STEPS, step: 1 });
  const field = make("input", { type: "number", step: "any", "aria-label": `Value of ${one.label} [${one.unit}]` });
  const hold = make("input", { type: "checkbox", "aria-label": `Hold ${one.label} in a fit` });
  const row = make("div", { class: "slider", title: [one.symbol, one.description].filter(Boolean).join(": ") },
    make("label", { for: id }, `${one.label} `, one.reason ? make("span", { class: "chip", title: one.reason }, "not determined") : ""),
    range, field, make("span", { class: "unit faint" }, one.unit), make("label", { class: "hold" }, hold, " hold"));
  let now;
  const show = (value) => {
    now = value;
    field.value = digits(value);
    range.value = toSlider(one, value);
    row.classList.toggle("changed", value !== one.value);
  };
  range.addEventListener("input", () => { show(toValue(one, Number(range.value))); update(); });
  range.addEventListener("change", commit);
  field.addEventListener("change", () => {
    if (!isNumber(field, one.label, digits(now))) return;
    show(Number(field.value));
    commit();
    update();
  });
  row.addEventListener("dblclick", () => { show(one.value); commit(); update(); });
  show(one.value);
  return { ...one, row, hold, show, now: () => now };
}

// One sentence per reason for values that the data do not determine.
function reasons(group) {
  const labels = Map.groupBy(group.filter((one) => one.reason), (one) => one.reason);
  return [...labels].map(([reason, all]) =>
    make("p", { class: "hint" }, `Not determined by the data: ${all.map((one) => one.label).join(", ")}: ${reason}.`));
}

function showSliders() {
  const groups = Map.groupBy(sliders.filter((one) => !one.is_idle), (one) => one.group);
  byId("sliders").replaceChildren(...[...groups].map(([title, group]) => {
    const count = group.filter((one) => one.reason).length;
    const summary = make("summary", {}, title, make("span", { class: "faint" }, count ? ` ${count} of ${group.length} not determined` : ""));
    return make("details", { "data-group": title }, summary, ...group.map((one) => one.row), ...reasons(group));
  }));
  openJoint();
}

// The sliders and channels of the chosen joint; those of other joints are folded.
function openJoint() {
  const joint = byId("joint").value;
  const groups = [...byId("sliders").children];
  for (const group of groups) group.open = ["Arm", `Joint ${joint}`].includes(group.dataset.group);
  byId("sliders").prepend(...["Arm", "Joint", "Link", "Sensors"].flatMap((kind) =>
    groups.filter((group) => [kind, `${kind} ${joint}`].includes(group.dataset.group))));
  const own = channels.filter((name) => name.match(/\d+$/)[0] === joint);
  const preferred = [...own, ...channels.filter((name) => !own.includes(name))];
  channelFields.forEach((field, k) => { field.value = preferred[Math.min(k, preferred.length - 1)]; });
}

async function begin() {
  note("Preparing the record ...");
  const request = ++latest;
  const chosen = setting();
  const answer = await postJson(api("by-hand-begin"), chosen).catch((error) => { note(""); throw error; });
  if (request !== latest) return; // another record was chosen in the meantime
  sliders = answer.sliders.map(sliderRow);
  channels = answer.channels;
  for (const field of channelFields) setOptions(field, channels);
  showSliders();
  const [first, last] = answer.window.map((time) => Number(time.toFixed(3)));
  byId("window").textContent = `Shows ${first} s to ${last} s.`;
  past = [];
  current = snapshot();
  saved = { [chosen.start]: current };
  showState();
  await update();
}

async function fit() {
  const held = sliders.filter((one) => one.hold.checked).map((one) => one.label);
  const run = await postJson(api("by-hand-fit"), { values: values(), held });
  showMessage(`The run ${run.name} has started; see the page Estimate.`);
}

async function save() {
  const { file } = await postJson(api("by-hand-save"), { name: byId("name").value, values: values() });
  saved[file] = snapshot();
  showState();
  showMessage(`The values are in ${file}.`);
}

if (byId("record")) {
  const chooseRecord = () => {
    const { joint } = byId("record").selectedOptions[0].dataset;
    if (joint) byId("joint").value = joint;
    return begin();
  };
  let from = "";
  onChange(byId("record"), chooseRecord);
  onChange(byId("start"), begin);
  byId("from").addEventListener("change", () => {
    const isEmpty = byId("from").value === "" && !byId("from").validity.badInput;
    if (!isEmpty && !isNumber(byId("from"), "Window from", from)) return;
    from = byId("from").value;
    act(byId("from"), begin);
  });
  for (const field of channelFields) field.addEventListener("change", update);
  byId("joint").addEventListener("change", () => { openJoint(); update(); });
  byId("reset").addEventListener("click", () => { sliders.forEach((one) => one.show(one.value)); commit(); update(); });
  byId("undo").addEventListener("click", undo);
  byId("sliders").addEventListener("keydown", (event) => { // a number field has an undo of its own
    if ((event.ctrlKey || event.metaKey) && event.key === "z" && event.target.type !== "number") undo();
  });
  onClick(byId("fit"), fit);
  onClick(byId("save"), save);
  act(null, chooseRecord);
}
