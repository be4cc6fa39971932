// Page "Check": relations as a table, the signal of each beside it, remedies.
import { act, address, api, byId, cell, getJson, make, number, onClick, postJson, row, study } from "./client.js";
import { draw } from "./figures.js";

const MARKS = { consistent: "good", overridden: "doubt", suspected: "bad", invalid: "bad", unchecked: "" };

// the signals of all places of a relation, one after the other with each choice
const shown = new Map();
async function showSignal(places) {
  const withSignal = places.filter((one) => one.channel);
  if (!withSignal.length) return;
  const next = ((shown.get(places) ?? -1) + 1) % withSignal.length;
  shown.set(places, next);
  const place = withSignal[next];
  const experiment = place.experiments[0] ?? "";
  const figure = await getJson(api("check-signal"), { channel: place.channel, experiment });
  byId("signal-text").textContent = `${place.channel}${experiment ? ` of ${experiment}` : ""}`;
  await draw(byId("signal"), figure);
}

const evidenceItem = (one) => make("li", {}, `${one.text} (${one.where.join(", ")}): ${one.measured}, expected ${one.expected}`);
// "joint-0-gear_ratio" as people read it
const fieldTitle = (id) => id.split("-").map((part) => (/^\d+$/.test(part) ? Number(part) + 1 : part)).join(" ");

function relationRow({ places, text, where, measured, expected, consistent }) {
  const hasSignal = places.some((place) => place.channel);
  const name = hasSignal ? make("button", { type: "button", class: "link" }, text) : text;
  if (hasSignal) onClick(name, () => showSignal(places));
  return row(name, where.join(", "), number(measured), number(expected),
    consistent ? cell("consistent", "good") : cell("contradiction", "bad"));
}

function suspicionBox({ code, where, message, remedy, lines, places, fields, evidence }, index) {
  const controls = make("div", { class: "row" });
  const addButton = (text, kind, action) => {
    const button = make("button", { type: "button", class: kind }, text);
    onClick(button, action);
    controls.append(button);
  };
  if (lines.length) {
    addButton("Apply the remedy", "remedy", async () => show(await postJson(api("apply-remedy"), { index })));
    controls.append(make("code", {}, lines.join("; ")));
  }
  if (places.some((place) => place.channel)) addButton("Show the signal", null, () => showSignal(places));
  controls.append(...fields.map((id) =>
    make("a", { class: "button", href: `/study/${address(study)}#field-${id}` }, `Study: ${fieldTitle(id)}`)));
  return make("section", {}, make("h2", { class: "bad" }, `${code}: ${where}`),
    make("p", {}, message), make("ul", { "aria-label": "Evidence" }, ...evidence.map(evidenceItem)),
    make("p", {}, make("strong", {}, "Remedy: "), remedy), controls);
}

function showRelations(relations, rows, section) {
  byId(rows).replaceChildren(...relations.map(relationRow));
  byId(section).hidden = !relations.length;
}

function show(gate) {
  const { suspected = [], relations = [], warnings = [] } = gate.document ?? {};
  byId("state").textContent = gate.reason;
  byId("state").className = `callout ${MARKS[gate.state]}`;
  byId("state").dataset.state = gate.state;
  byId("go").hidden = !gate.is_open;
  byId("override").hidden = gate.state !== "suspected";
  byId("suspected").replaceChildren(...suspected.map(suspicionBox));
  const good = relations.filter((one) => one.consistent);
  showRelations(relations.filter((one) => !one.consistent), "contradictions", "contradicting");
  showRelations(good, "relations", "passed");
  byId("passed-count").textContent = `${good.length} relations agree`;
  byId("warnings").replaceChildren(...warnings.map((one) => make("li", {}, make("strong", {}, `${one.where}: `), one.message)),
    gate.document && !warnings.length ? make("li", { class: "faint" }, "none") : "");
  const first = suspected[0] ?? relations.find((one) => one.places.some((place) => place.channel));
  if (first) act(null, () => showSignal(first.places));
}

onClick(byId("check"), async () => show(await postJson(api("check"))));
onClick(byId("override"), async () => show(await postJson(api("override-check"))));
act(byId("check"), async () => show(await getJson(api("check"))));
