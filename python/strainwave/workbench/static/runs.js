// What pages show of runs, and what their users do with them.
import { address, api, button, make, postJson, showMessage, study } from "./client.js";
import { follow, isActive } from "./run_events.js";

export const MARKS = {
  determined: "good", "partly-determined": "doubt", "not-determined": "bad", "inconsistent-input": "bad",
  failed: "bad", interrupted: "doubt", cancelled: "doubt",
};

const MAX_NAMED = 10; // in a question

export const statusOf = (run) => run.status ?? run.state;
export const badge = (run) => make("span", { class: `badge ${MARKS[statusOf(run)] ?? ""}` }, statusOf(run));
export const ofRun = (page, name, file) =>
  `/${page}/${address(study)}?${new URLSearchParams(file ? { run: name, file } : { run: name })}`;

export function duration(seconds) {
  if (seconds == null) return "";
  const two = (value) => String(value).padStart(2, "0");
  if (seconds < 60) return `${seconds} s`;
  const minutes = Math.floor(seconds / 60);
  return minutes < 60 ? `${minutes} min ${two(seconds % 60)} s` : `${Math.floor(minutes / 60)} h ${two(minutes % 60)} min`;
}

export function activity(run) {
  if (run.state === "waiting") return run.ahead ? `waiting for ${run.ahead + 1} other runs` : "waiting for another run";
  return run.progress?.activity ?? (run.state === "running" ? "starting" : run.state);
}

// The progress of an active run, with a button that cancels it.
export function progressOf(run, onEnd) {
  const bar = make("progress", { max: "1", value: "0", "aria-label": `Progress of ${run.name}` });
  const text = make("span", { class: "faint" }, activity(run));
  const cancel = button("Cancel", { "data-key": `cancel ${run.name}`, "aria-label": `Cancel ${run.name}` },
    () => postJson(api("cancel-run"), { name: run.name }));
  const place = make("div", { class: "row progress" }, bar, text, cancel);
  follow(run.name, (event) => {
    if (event.progress?.fraction != null) bar.value = event.progress.fraction;
    text.textContent = activity(event);
    const row = place.closest("tr");
    if (!row || !isActive(event)) return;
    row.dataset.state = event.state;
    row.querySelector(".badge").replaceWith(badge(event));
    row.querySelector(".seconds").textContent = duration(event.seconds);
  }, onEnd);
  return place;
}

// Replace the rows of a table; a control with the same `data-key` as the focused one gets the focus.
export function showRows(body, rows, otherwise) {
  const active = document.activeElement;
  const key = body.contains(active) ? active.dataset.key : undefined;
  body.replaceChildren(...rows);
  if (key === undefined) return;
  const find = (name) => body.querySelector(`[data-key="${CSS.escape(name)}"]`);
  (find(key) ?? find(key.replace(/^cancel /, "open ")) ?? otherwise).focus({ preventScroll: true });
}

// Ask once, and delete runs; returns whether they were to be deleted.
export async function removeRuns(names) {
  const [what, whose] = names.length === 1 ? ["the run", "its"] : [`${names.length} runs`, "their"];
  if (!window.confirm(`Delete ${what} with ${whose} files: ${names.slice(0, MAX_NAMED).join(", ")}${names.length > MAX_NAMED ? ", ..." : ""}?`)) return false;
  await postJson(api("remove-runs"), { names });
  return true;
}

export async function copyText(text, what) {
  if (navigator.clipboard) {
    await navigator.clipboard.writeText(text);
  } else { // not on this machine, and not encrypted
    const focus = document.activeElement;
    const area = make("textarea", { readonly: true }, text);
    document.body.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
    focus.focus();
  }
  showMessage(`${what} is in the clipboard.`);
}
