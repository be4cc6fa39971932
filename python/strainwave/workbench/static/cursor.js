// A vertical line in a plot, and the values of all its curves there in a table, by mouse and keyboard.
import { make } from "./client.js";

// Index of the entry of an ascending list that is nearest to a value.
function nearest(list, value) {
  let low = 0, high = list.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (list[middle] < value) low = middle; else high = middle;
  }
  return Math.abs(list[low] - value) <= Math.abs(list[high] - value) ? low : high;
}

// Points of each curve; the segments of a record are traces of one name.
function curves(plot) {
  const byName = new Map();
  for (const { name, x, y, line } of plot.data ?? []) {
    const curve = byName.get(name) ?? { name, line, x: [], y: [] };
    byName.set(name, { ...curve, x: curve.x.concat(x), y: curve.y.concat(y) });
  }
  return [...byName.values()].filter((curve) => curve.x.length);
}

function row({ name, line, x, y }, at) {
  const swatch = make("span", { class: "swatch" });
  swatch.style.borderTopColor = line.color;
  const value = at === null ? null : y[nearest(x, at)];
  return make("tr", {}, make("th", { scope: "row" }, swatch, ` ${name}`),
    make("td", { class: "number" }, value == null ? "–" : String(Number(value.toPrecision(5)))));
}

// `rows` is the body of the table, `caption` gets the place of the cursor. Call the returned function after each draw.
export function addCursor(plot, rows, caption, describe) {
  const line = make("div", { class: "cursor", hidden: true });
  plot.parentElement.append(line);
  let at = null, shown = [], isAttached = false;

  function show(value) {
    if (value !== null && shown.length) at = shown[0].x[nearest(shown[0].x, value)];
    rows.replaceChildren(...shown.map((curve) => row(curve, at)));
    caption.textContent = at === null ? describe(null) : describe(Number(at.toPrecision(7)));
    const axis = plot._fullLayout?.xaxis, { t, b } = plot._fullLayout?.margin ?? {};
    const left = at === null || !axis ? NaN : axis.d2p(at);
    line.hidden = !(left >= 0 && left <= axis._length);
    if (line.hidden) return;
    [line.style.left, line.style.top] = [`${axis._offset + left}px`, `${t}px`];
    line.style.height = `${plot.clientHeight - t - b}px`;
  }

  plot.addEventListener("keydown", (event) => {
    const list = shown[0]?.x ?? [];
    const step = event.shiftKey ? Math.ceil(list.length / 20) : 1;
    const here = at === null ? list.length >> 1 : nearest(list, at);
    const to = { ArrowLeft: here - step, ArrowRight: here + step, Home: 0, End: list.length - 1 }[event.key];
    if (to === undefined || !list.length) return;
    event.preventDefault();
    show(list[Math.min(Math.max(to, 0), list.length - 1)]);
  });
  window.addEventListener("resize", () => requestAnimationFrame(() => show(at)));

  return () => {
    shown = curves(plot);
    if (!isAttached) plot.on("plotly_hover", (event) => show(event.points[0].x));
    isAttached = true;
    show(at);
  };
}
