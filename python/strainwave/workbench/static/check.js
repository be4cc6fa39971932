// Page "Check": relations as a table, the signal of each beside it, remedies.
import { act, address, byId, getJson, make, onClick, postJson, study } from "./client.js";
import { draw } from "./figures.js";

const api = (name) => `/api/${name}/${address(study)}`;
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

const evidence = (one) => make("li", {}, `${one.text} (${one.where.join(", ")}): ${one.measured}, expected ${one.expected}`);
// "joint-0-gear_ratio" as people read it
const fieldTitle = (id) => id.split("-").map((part) => (/^\d+$/.test(part) ? Number(part) + 1 : part)).join(" ");

function relationRow(relation) {
  const hasSignal = relation.places.some((place) => place.channel);
  const name = hasSignal
    ? make("button", { type: "button", class: "link" }, relation.text)
    : relation.text;
  if (hasSignal) onClick(name, () => showSignal(relation.places));
  const verdict = relation.consistent ? "consistent" : "contradiction";
  return make("tr", {},
    make("th", { scope: "row" }, name), make("td", {}, relation.where.join(", ")),
    make("td", { class: "number" }, relation.measured), make("td", { class: "number" }, relation.expected),
    make("td", { class: relation.consistent ? "good" : "bad" }, verdict));
}

function suspicionBox(suspicion, index) {
  const box = make("section", {},
    make("h2", { class: "bad" }, `${suspicion.code}: ${suspicion.where}`),
    make("p", {}, suspicion.message), make("ul", { "aria-label": "Evidence" }, ...suspicion.evidence.map(evidence)),
    make("p", {}, make("strong", {}, "Remedy: "), suspicion.remedy));
  const controls = make("div", { class: "row" });
  if (suspicion.lines.length) {
    const button = make("button", { type: "button", class: "remedy" }, "Apply the remedy");
    onClick(button, async () => show(await postJson(api("apply-remedy"), { index })));
    controls.append(button, make("code", {}, suspicion.lines.join("; ")));
  }
  const look = make("button", { type: "button" }, "Show the signal");
  onClick(look, () => showSignal(suspicion.places));
  if (suspicion.places.some((place) => place.channel)) controls.append(look);
  controls.append(...suspicion.fields.map((id) =>
    make("a", { class: "button", href: `/study/${address(study)}#field-${id}` }, `Study: ${fieldTitle(id)}`)));
  box.append(controls);
  return box;
}

function show(gate) {
  const { document: check } = gate;
  byId("state").textContent = gate.reason;
  byId("state").className = `callout ${MARKS[gate.state]}`;
  byId("state").dataset.state = gate.state;
  byId("go").hidden = !gate.is_open;
  byId("override").hidden = gate.state !== "suspected";
  byId("suspected").replaceChildren(...(check?.suspected ?? []).map(suspicionBox));
  const [bad, good] = [false, true].map((isGood) => (check?.relations ?? []).filter((one) => one.consistent === isGood));
  byId("contradictions").replaceChildren(...bad.map(relationRow));
  byId("contradicting").hidden = !bad.length;
  byId("relations").replaceChildren(...good.map(relationRow));
  byId("passed").hidden = !good.length;
  byId("passed-count").textContent = `${good.length} relations agree`;
  const warnings = (check?.warnings ?? []).map((one) => make("li", {}, make("strong", {}, `${one.where}: `), one.message));
  byId("warnings").replaceChildren(...(warnings.length || !check ? warnings : [make("li", { class: "faint" }, "none")]));
  const first = check?.suspected.length ? check.suspected[0].places : check?.relations.find((one) => one.places.some((p) => p.channel))?.places;
  if (first) act(null, () => showSignal(first));
}

onClick(byId("check"), async () => show(await postJson(api("check"))));
onClick(byId("override"), async () => show(await postJson(api("override-check"))));
act(byId("check"), async () => show(await getJson(api("check"))));
