// Of every page: help in a drawer, and keys that open pages.
import { act, byId } from "./client.js";

const isTyping = (element) => element.isContentEditable || element.matches("input, select, textarea");
const KEY_TIME = 1500; // [ms] between G and the letter of a page

async function openHelp() {
  const response = await fetch(byId("help").href);
  const topic = new DOMParser().parseFromString(await response.text(), "text/html").getElementById("topic");
  const drawer = document.createElement("dialog");
  const close = document.createElement("button");
  topic.className = "help";
  close.textContent = "Close";
  close.addEventListener("click", () => drawer.close());
  drawer.setAttribute("aria-label", "Help");
  drawer.append(close, topic);
  drawer.addEventListener("close", () => drawer.remove()); // the browser gives the focus back
  drawer.addEventListener("click", (event) => { if (event.target === drawer) drawer.close(); });
  document.body.append(drawer);
  drawer.showModal();
}

byId("help").addEventListener("click", (event) => {
  if (event.ctrlKey || event.metaKey || event.shiftKey) return; // in a tab of its own
  event.preventDefault();
  act(byId("help"), openHelp);
});

let goTime = -Infinity; // of the last G
document.addEventListener("keydown", (event) => {
  const hasModifier = event.ctrlKey || event.metaKey || event.altKey;
  if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) document.querySelector("main button.primary:not([disabled])")?.click();
  if (hasModifier || event.defaultPrevented || isTyping(event.target) || document.querySelector("dialog[open]")) return;
  const isGoing = event.timeStamp - goTime < KEY_TIME;
  goTime = event.key.toLowerCase() === "g" && !isGoing ? event.timeStamp : -Infinity;
  if (isGoing) document.querySelector(`header nav [data-letter="${CSS.escape(event.key.toUpperCase())}"]`)?.click();
  else if (event.key === "?") byId("help").click();
  else if (event.key === "/") {
    const filter = document.querySelector("main input[type='search']");
    if (filter) { event.preventDefault(); filter.focus(); }
  }
});

// A menu closes when the focus or a click goes elsewhere, or by Escape.
for (const name of ["click", "focusin"]) {
  document.addEventListener(name, (event) => {
    for (const menu of document.querySelectorAll("details.menu[open]")) if (!menu.contains(event.target)) menu.open = false;
  });
}
document.addEventListener("keydown", (event) => {
  const menu = event.key === "Escape" && document.activeElement?.closest("details.menu[open]");
  if (menu) { menu.open = false; menu.querySelector("summary").focus(); }
});

// The button of an explanation opens it: <button class="tip" aria-controls="ID" aria-expanded="false">?</button>
document.addEventListener("click", (event) => {
  const tip = event.target.closest?.("button.tip");
  const text = tip && byId(tip.getAttribute("aria-controls"));
  if (text) tip.setAttribute("aria-expanded", String(!(text.hidden = !text.hidden)));
});
