// Page "Estimate": the form of a run, and order and horizon; results.js has the table of results.
import { act, address, api, byId, getJson, make, onClick, postJson, showMessage, study } from "./client.js";
import { draw } from "./figures.js";
import { refresh, showReport } from "./results.js";

const fields = [...document.querySelectorAll("[data-option]")];
let isNamed = false; // whether the user has typed the name of the next run

async function update() {
  const { gate, name } = await refresh();
  byId("gate").textContent = gate.reason;
  byId("gate").className = gate.is_open ? `badge ${gate.state === "consistent" ? "good" : "doubt"}` : `callout ${gate.state === "unchecked" ? "" : "bad"}`;
  if (!gate.is_open) byId("gate").append(" ", make("a", { href: `/check/${address(study)}` }, "Open the page Check."));
  byId("start").disabled = !gate.is_open;
  if (!isNamed) byId("name").value = name;
}

function clearFault(field) {
  field.removeAttribute("aria-invalid");
  byId(`fault-${field.id}`).textContent = "";
}

function markChanged(field) {
  field.closest(".field").classList.toggle("changed", field.value !== "");
  clearFault(field);
  const changed = fields.filter((one) => one.value !== "").length;
  byId("changed").textContent = changed ? `${changed} changed` : "";
}

// Show why the run was refused at its field.
function refuse(error) {
  const field = error.where === "name" ? byId("name") : byId(`option-${error.where}`);
  if (!field) throw error;
  for (const closed of [byId("options"), field.closest("details")]) if (field.dataset.option) closed.open = true;
  field.setAttribute("aria-invalid", "true");
  byId(`fault-${field.id}`).textContent = error.message;
  field.focus();
}

byId("settings").addEventListener("submit", (event) => {
  event.preventDefault();
  act(byId("start"), async () => {
    const options = Object.fromEntries(fields.map((field) => [field.dataset.option, field.value]));
    for (const id of ["order", "horizon"]) if (byId(id).value) options[`statespace.${id}`] = byId(id).value;
    const { value: stages } = byId("settings").elements.stages;
    try {
      const run = await postJson(api("estimate"), { name: byId("name").value, stages, options, figures: byId("figures").checked });
      showMessage(`${run.name} has started.`);
    } catch (error) { refuse(error); return; }
    isNamed = false;
    await update();
  });
});
byId("name").addEventListener("input", () => {
  isNamed = true;
  clearFault(byId("name"));
});
for (const field of fields) field.addEventListener("input", () => markChanged(field));
byId("reset").addEventListener("click", () => { for (const field of fields) { field.value = ""; markChanged(field); } });

let orders = [];
async function showOrder() {
  const entry = orders[byId("order-record").selectedIndex];
  byId("order-text").textContent = `${entry.experiment}, joint ${entry.joint}: order ${entry.order}, horizon ${entry.horizon} samples`;
  byId("order-plot").hidden = false;
  await draw(byId("order-plot"), entry.figure);
}
onClick(byId("orders"), async () => {
  byId("order-text").textContent = "Computing the rigid and joint models ...";
  try {
    orders = await getJson(api("orders"));
  } catch (error) {
    byId("order-text").textContent = error.message;
    return;
  }
  byId("order-record").replaceChildren(...orders.map((one) => make("option", {}, one.experiment)));
  byId("order-record").disabled = false;
  await showOrder();
});
byId("order-record").addEventListener("change", () => act(null, showOrder));
// a click on a singular value selects the order
byId("order-plot").addEventListener("click", () => {
  const point = byId("order-plot")._hoverdata?.[0];
  if (point) byId("order").value = Math.min(Math.max(point.x, 2), 10);
});

act(null, async () => { await update(); await showReport(); });
