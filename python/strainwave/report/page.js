"use strict";
(() => {
  const PAPER_WIDTH = 670; // pixels that A4 and Letter hold between their margins
  const DARK = { // of each colour of the figures, one that stands out of a dark page
    "#0072B2": "#56A8E8", "#D55E00": "#FF8A3C", "#009E73": "#35C99B", "#CC79A7": "#E59CC4",
    "#888888": "#A0A8B4", "#FFFFFF": "#14181E",
  };
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const narrow = window.matchMedia("(max-width: 40rem)");
  const finger = window.matchMedia("(pointer: coarse)");
  const waiting = new Set(Object.keys(figures));
  let printing = false;

  const inks = () => printing || !dark.matches
    ? { ink: "#1c2430", rule: "#d9dee5", paper: "#ffffff" }
    : { ink: "#e4e8ee", rule: "#333c48", paper: "#1c222b" };
  const coloured = (figure) => printing || !dark.matches ? figure : JSON.parse(
    JSON.stringify(figure).replace(/#[0-9A-Fa-f]{6}/g, (c) => DARK[c.toUpperCase()] ?? c));

  const framed = (given) => {
    const { ink, rule, paper } = inks();
    const axis = { gridcolor: rule, zerolinecolor: rule, linecolor: rule, automargin: true };
    const axes = Object.keys(given).filter((name) => /^[xy]axis\d*$/.test(name));
    const titled = (own) => ({ ...own, title: { standoff: 6, ...own.title } });
    const layout = {
      ...given,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: ink, family: "system-ui, sans-serif", size: narrow.matches ? 11 : 12 },
      margin: { l: 56, r: 12, t: 12, b: 40 },
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1.01, yanchor: "bottom" },
      hovermode: "closest",
      hoverlabel: { bgcolor: paper, bordercolor: rule, font: { color: ink } },
      dragmode: finger.matches ? false : "zoom", // a finger scrolls the page
      ...Object.fromEntries(axes.map((name) => [name, { ...axis, ...titled(given[name]) }])),
    };
    return printing ? { ...layout, width: PAPER_WIDTH } : layout;
  };

  const draw = (id) => {
    const { data, layout } = coloured(figures[id]);
    const how = { responsive: !printing, displaylogo: false, displayModeBar: narrow.matches ? false : "hover" };
    waiting.delete(id);
    Plotly.react(id, data, framed(layout), how);
    document.documentElement.dataset.drawn = Object.keys(figures).length - waiting.size;
  };
  const drawn = () => Object.keys(figures).filter((id) => !waiting.has(id));
  const drawWaiting = () => [...waiting].forEach(draw);

  // what is seen comes first; the rest follows one by one, so that the page answers meanwhile
  const seen = new IntersectionObserver((entries) => entries.forEach((entry) => {
    if (entry.isIntersecting && waiting.has(entry.target.id)) draw(entry.target.id);
  }), { rootMargin: "400px" });
  for (const id of waiting) seen.observe(document.getElementById(id));
  const rest = () => {
    const [next] = waiting;
    if (next === undefined) return;
    draw(next);
    setTimeout(rest, 10);
  };
  setTimeout(rest, 50);

  const again = () => drawn().forEach(draw);
  for (const query of [dark, narrow]) query.addEventListener("change", again);
  window.addEventListener("beforeprint", () => { printing = true; drawWaiting(); again(); });
  window.addEventListener("afterprint", () => { printing = false; again(); });
})();
