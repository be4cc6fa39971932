// Requests to the workbench, and messages to the user.

export const study = document.body.dataset.study ?? "";
export const address = (path) => path.split("/").map(encodeURIComponent).join("/");
export const api = (name) => `/api/${name}/${address(study)}`; // of the study
export const byId = (id) => document.getElementById(id);

async function request(path, options) {
  const response = await fetch(path, options);
  const value = await response.json().catch(() => ({ error: `the server answered ${response.status}` }));
  if (!response.ok) throw Object.assign(new Error(value.error), { where: value.where }); // a field
  return value;
}

export const getJson = (path, query = {}) => {
  const text = new URLSearchParams(query).toString();
  return request(text ? `${path}?${text}` : path);
};

export const postJson = (path, body = {}) =>
  request(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) });

// Show a message at the bottom; errors stay until the next message.
let timer;
export function showMessage(text, isError = false) {
  const place = byId("message");
  place.textContent = text;
  place.className = isError ? "bad" : "";
  place.hidden = !text;
  clearTimeout(timer);
  if (text && !isError) timer = setTimeout(() => { place.hidden = true; }, 6000);
}

// Run an asynchronous action of a control: busy while it runs, its error as a message.
// A button that is busy ignores further clicks; it keeps the focus, which a disabled one would lose.
export async function act(control, action) {
  const isBusy = control?.getAttribute("aria-busy") === "true";
  if (isBusy && control instanceof HTMLButtonElement) return undefined;
  if (control) control.setAttribute("aria-busy", "true");
  try {
    return await action();
  } catch (error) {
    showMessage(error.message, true);
    return undefined;
  } finally {
    control?.removeAttribute("aria-busy");
  }
}

export const onClick = (element, action) => element.addEventListener("click", () => act(element, action));
export const onChange = (element, action) => element.addEventListener("change", () => act(element, action));

// Make an element: make("td", { class: "number" }, "12.3", child, ...)
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value != null) element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}

// A button that runs an asynchronous action.
export function button(text, attributes, action) {
  const element = make("button", { type: "button", ...attributes }, text);
  onClick(element, action);
  return element;
}

// Cells of a table; a row has its head and texts, numbers or cells.
export const head = (text, kind) => make("th", { scope: "col", class: kind }, text);
export const cell = (text, kind) => make("td", { class: kind }, text);
export const number = (text) => cell(text, "number");
export const row = (title, ...cells) => make("tr", {}, make("th", { scope: "row" }, title),
  ...cells.map((one) => one instanceof Element ? one : cell(one)));

// Make the options of a list those of `entries`, each a text, or a value and its text; the choice stays if it can.
export function setOptions(select, entries, wanted = select.value) {
  const key = JSON.stringify(entries);
  if (select.dataset.options !== key) {
    select.dataset.options = key;
    select.replaceChildren(...entries.map((entry) => {
      const [value, text = value] = [entry].flat();
      return make("option", { value }, text);
    }));
  }
  if ([...select.options].some((one) => one.value === String(wanted))) select.value = wanted;
}
