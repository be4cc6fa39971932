// Figures of the server (`data` and `layout`) in the colours of the page. Needs /plotly.js.

const DARK = { // replacement of each figure colour on a dark page
  "#0072B2": "#56A8E8", "#D55E00": "#FF8A3C", "#009E73": "#35C99B", "#CC79A7": "#E59CC4",
  "#56B4E9": "#8ACCF5", "#E69F00": "#F2BB4E", "#888888": "#A0A8B4", "#FFFFFF": "#161B22",
};
const BUTTONS = [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]];
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const drawn = new Map(); // element -> [figure, options]

const rgba = (hex) => `rgba(${[1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)).join(",")},`;
const BANDS = Object.fromEntries(Object.entries(DARK).map(([from, to]) => [rgba(from), rgba(to)]));
const coloured = (figure) => !dark.matches ? figure : JSON.parse(
  JSON.stringify(figure)
    .replace(/#[0-9A-Fa-f]{6}/g, (c) => DARK[c.toUpperCase()] ?? c)
    .replace(/rgba\(\d+,\d+,\d+,/g, (c) => BANDS[c] ?? c));

function themed(given, options) {
  const roles = getComputedStyle(document.documentElement); // workbench.css names the colours
  const [ink, faint, rule, paper] = ["--ink", "--faint", "--rule", "--paper"].map((name) => roles.getPropertyValue(name));
  const axis = { gridcolor: rule, zerolinecolor: rule, linecolor: rule, automargin: !given.margin };
  const axes = Object.keys(given).filter((key) => /^[xy]axis\d*$/.test(key));
  const titled = (one) => ({ ...one, title: { standoff: 6, font: { size: 11 }, ...one.title }, tickfont: { size: 11, color: faint } });
  return {
    ...given,
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: ink, family: "system-ui, sans-serif", size: 12 },
    margin: { l: 56, r: 12, t: 24, b: 40, ...given.margin },
    legend: { orientation: "h", x: 0, xanchor: "left", y: 1.01, yanchor: "bottom", ...given.legend },
    hovermode: given.hovermode ?? "closest",
    modebar: { bgcolor: "rgba(0,0,0,0)", color: faint, activecolor: ink },
    hoverlabel: { bgcolor: paper, bordercolor: rule, font: { color: ink } },
    ...Object.fromEntries(axes.map((key) => [key, { ...axis, ...titled(given[key]) }])),
    ...options.layout,
  };
}

// Draw or update a figure; returns Plotly's promise. `options.layout` overrides the layout.
export function draw(element, figure, options = {}) {
  drawn.set(element, [figure, options]);
  const { data, layout } = coloured(figure);
  const config = {
    responsive: true, displaylogo: false, displayModeBar: "hover", modeBarButtons: BUTTONS,
    plotGlPixelRatio: 1, ...options.config,
  };
  return window.Plotly.react(element, data, themed(layout, options), config)
    .then(() => { element.dataset.drawn = "true"; });
}

dark.addEventListener("change", () => {
  for (const [element, [figure, options]] of drawn) if (element.isConnected) draw(element, figure, options);
});
