// Page "Study": the table of experiments.
import { byId, make } from "./client.js";
import { fieldControl } from "./study.js";

export function showExperiments(state) {
  const heads = state.experiments[0]?.cells.map((cell) => make("th", { scope: "col" }, cell.title)) ?? [];
  byId("experiment-heads").replaceChildren(...heads);
  byId("experiments").replaceChildren(...state.experiments.map((row, index) => make("tr", {}, ...row.cells.map((cell) =>
    make("td", {}, fieldControl(`experiment-${index}-${cell.place[2]}`, cell,
      { "aria-label": `${cell.title} of ${row.name}`, class: cell.kind === "number" ? "short" : null }))))));
}
