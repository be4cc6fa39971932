// Page "Study": every signal of a record at once, also while values are missing.
import { act, api, byId, getJson, make, onClick, setOptions, study } from "./client.js";

const SVG = "http://www.w3.org/2000/svg";
const NOTES = `notes of ${study}`; // of an import in this tab
const details = byId("overview"), record = byId("overview-record");
let state, shown;

function line({ points, is_reversed: isReversed, low, high, unit, column }) {
  const svg = document.createElementNS(SVG, "svg"), polyline = document.createElementNS(SVG, "polyline");
  const attributes = { viewBox: "0 -4 240 108", preserveAspectRatio: "none", role: "img", "aria-label": `${column}: ${range(low, high, unit)}` };
  for (const [key, value] of Object.entries(attributes)) svg.setAttribute(key, value);
  polyline.setAttribute("points", points);
  if (isReversed) polyline.setAttribute("transform", "translate(0 100) scale(1 -1)");
  svg.append(polyline);
  return svg;
}

const digits = (value) => String(Number(value.toPrecision(4)));
const range = (low, high, unit) => (low == null ? "no numbers" : low === high ? `constant ${digits(low)} ${unit}` : `${digits(low)} to ${digits(high)} ${unit}`);

const tile = (row) => make("figure", { class: row.channel ? "signal" : "signal unused" },
  make("figcaption", {}, ...(row.channel ? [make("b", {}, row.channel), " "] : []), ...(row.column === row.channel ? [] : [make("span", {}, row.column)]), make("span", { class: "range" }, range(row.low, row.high, row.unit))), line(row));

async function show() {
  const key = JSON.stringify([record.value, state.channels, state.experiments.map((row) => row.cells[1].value)]);
  if (!details.open || !record.value || key === shown) return;
  shown = key;
  const { file, seconds, rows } = await getJson(api("overview"), { experiment: record.value });
  if (key !== shown) return; // another record is chosen meanwhile
  const mapped = rows.filter((row) => row.channel).length;
  byId("overview-facts").textContent = `${file}: ${Math.max(...rows.map((row) => row.samples)).toLocaleString("en")} samples${seconds == null ? "" : `, ${digits(seconds)} s`}; `
    + `${mapped} of ${rows.length} columns are channels${mapped < rows.length ? ", the others follow in grey" : ""}.`;
  byId("signals").replaceChildren(...rows.map(tile));
}

// Show the records of the state of the page; open after an import, and while the study is not complete.
export function showOverview(next) {
  if (state === undefined) details.open = Boolean(next.error) || NOTES in sessionStorage;
  state = next;
  setOptions(record, state.experiments.map((row) => row.name));
  return show();
}

for (const event of ["change", "toggle"]) for (const element of [record, details]) element.addEventListener(event, () => state && act(null, show));

// what the import found
const notes = JSON.parse(sessionStorage.getItem(NOTES) ?? "[]");
byId("import-notes").hidden = notes.length === 0;
byId("import-notes").querySelector("ul").replaceChildren(...notes.map((text) => make("li", {}, text)));
onClick(byId("dismiss"), () => { sessionStorage.removeItem(NOTES); byId("import-notes").remove(); });
