// The preprocessing steps of a record: a list in the order of application, and a form for one more.
import { act, button, byId, make } from "./client.js";

let steps, change;

const value = (entry) => Array.isArray(entry) ? entry.join(", ") : entry;
const describe = ({ kind, ...keys }) => `${kind}: ${Object.entries(keys).map(([key, entry]) => `${key} = ${value(entry)}`).join(", ")}`;

// Buttons act on the list, and keep the focus on the step, or on the form if it is gone.
function stepButton(text, label, focus, changed) {
  return button(text, { class: "quiet", "aria-label": label, title: label }, async () => {
    await change(changed());
    (byId("steps").children[focus]?.querySelector("button:not([disabled])") ?? byId("step-kind")).focus();
  });
}

function stepRow(step, k) {
  const without = () => steps.filter((_, other) => other !== k);
  const up = stepButton("↑", `Move step ${k + 1} up`, k - 1, () => without().toSpliced(k - 1, 0, step));
  up.disabled = k === 0;
  return make("li", {}, make("span", {}, describe(step)), up,
    stepButton("✕", `Remove step ${k + 1}`, k, without));
}

// Show the steps of a record; `changed(steps)` is called with each other list.
export function showSteps(given, record, changed) {
  [steps, change] = [given, changed];
  byId("steps").replaceChildren(...steps.map(stepRow));
  byId("no-steps").hidden = steps.length > 0;
  const names = byId("detrend-channels");
  if (names.dataset.of !== record.channels.join()) {
    names.replaceChildren(...record.detrendable.map((name) => make("option", {}, name)));
    names.dataset.of = record.channels.join();
  }
}

function entryOf(field) {
  if (field.multiple) return [...field.selectedOptions].map((option) => option.value);
  return field.dataset.kind === "text" ? field.value.trim() : Number(field.value);
}

const showKind = () => {
  for (const group of document.querySelectorAll("[data-step]")) group.hidden = group.dataset.step !== byId("step-kind").value;
};
byId("step-kind").addEventListener("change", showKind);
showKind();
byId("step-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const kind = byId("step-kind").value;
  const fields = [...document.querySelectorAll(`[data-step="${kind}"] [data-key]`)];
  const step = { kind, ...Object.fromEntries(fields.map((field) => [field.dataset.key, entryOf(field)])) };
  // logs are merged before the other steps
  const place = kind === "merge" ? steps.filter((each) => each.kind === "merge").length : steps.length;
  act(byId("add-step"), () => change(steps.toSpliced(place, 0, step)));
});
