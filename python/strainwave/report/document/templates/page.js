"use strict";
(() => {
  const PAPER_WIDTH = 670; // [px] A4 and Letter between their margins
  // figure heights on paper [px] up to a number of panels: a third, a half or nearly a whole page
  const PAPER_HEIGHTS = [[1.2, 225], [3.2, 370], [5.9, 410], [Infinity, 800]];
  const DARK = { // replacement of each figure colour on a dark page
    "#0072B2": "#56A8E8", "#D55E00": "#FF8A3C", "#009E73": "#35C99B", "#CC79A7": "#E59CC4",
    "#56B4E9": "#8ACCF5", "#E69F00": "#F2BB4E", "#888888": "#A0A8B4", "#FFFFFF": "#14181E",
  };
  const BUTTONS = [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]];
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const narrow = window.matchMedia("(max-width: 40rem)");
  const touch = window.matchMedia("(pointer: coarse)");
  const waiting = new Set(Object.keys(figures));
  const element = (name) => document.getElementById(`figure-${name}`);
  const isUnfolded = (name) => !element(name).closest("details:not([open])");
  let printing = false;

  const isDark = () => !printing && dark.matches;
  const inks = () => isDark()
    ? { ink: "#e4e8ee", rule: "#333c48", paper: "#1c222b" }
    : { ink: "#1c2430", rule: "#d9dee5", paper: "#ffffff" };
  const rgba = (hex) => `rgba(${[1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)).join(",")},`;
  const BANDS = Object.fromEntries(Object.entries(DARK).map(([from, to]) => [rgba(from), rgba(to)]));
  const coloured = (figure) => !isDark() ? figure : JSON.parse(
    JSON.stringify(figure)
      .replace(/#[0-9A-Fa-f]{6}/g, (c) => DARK[c.toUpperCase()] ?? c)
      .replace(/rgba\(\d+,\d+,\d+,/g, (c) => BANDS[c] ?? c));

  // at beforeprint the page still has its size on the screen
  const paperSize = (name) => {
    const panels = Number(getComputedStyle(element(name)).getPropertyValue("--panels"));
    return { width: PAPER_WIDTH, height: PAPER_HEIGHTS.find(([most]) => panels <= most)[1] };
  };

  // on a phone a heat map has row names only, and its scale below
  const slim = ({ data, layout }) => ({
    data: data.map((one) => ({ ...one, colorbar: { orientation: "h", y: 0, yanchor: "top", thickness: 12 } })),
    layout: { ...layout, margin: { ...layout.margin, b: 40 }, xaxis: { ...layout.xaxis, showticklabels: false, ticks: "" } },
  });
  const sized = (figure) => narrow.matches && !printing && figure.data[0].type === "heatmap" ? slim(figure) : figure;

  const layoutOf = (given, name) => {
    const { ink, rule, paper } = inks();
    const size = printing ? 9 : narrow.matches ? 11 : 12;
    const axis = { gridcolor: rule, zerolinecolor: rule, linecolor: rule, automargin: !given.margin };
    const axes = Object.keys(given).filter((key) => /^[xy]axis\d*$/.test(key));
    const titled = (one) => ({ ...one, title: { standoff: 6, font: { size: Math.min(size, 11) }, ...one.title } });
    const layout = {
      ...given,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: ink, family: "system-ui, sans-serif", size },
      margin: { l: 56, r: 12, t: 12, b: 40, ...given.margin },
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1.01, yanchor: "bottom" },
      hovermode: "closest",
      modebar: { bgcolor: "rgba(0,0,0,0)", color: "#7d8794", activecolor: ink },
      hoverlabel: { bgcolor: paper, bordercolor: rule, font: { color: ink } },
      dragmode: touch.matches ? false : "zoom", // a finger scrolls the page
      ...Object.fromEntries(axes.map((key) => [key, { ...axis, ...titled(given[key]) }])),
    };
    return printing ? { ...layout, ...paperSize(name) } : layout;
  };

  const draw = (name) => {
    const { data, layout } = sized(coloured(figures[name]));
    const config = {
      responsive: !printing, displaylogo: false, displayModeBar: narrow.matches ? false : "hover",
      modeBarButtons: BUTTONS,
    };
    waiting.delete(name);
    Plotly.react(element(name), data, layoutOf(layout, name), config);
    document.documentElement.dataset.drawn = Object.keys(figures).length - waiting.size;
  };
  const drawn = () => Object.keys(figures).filter((name) => !waiting.has(name));

  // visible figures are drawn first, the others one by one, so that the page stays responsive;
  // folded figures are drawn when they are unfolded
  const visible = new IntersectionObserver((entries) => entries.forEach((entry) => {
    const name = entry.target.id.replace("figure-", "");
    if (entry.isIntersecting && waiting.has(name)) draw(name);
  }), { rootMargin: "400px" });
  for (const name of waiting) visible.observe(element(name));
  const drawNext = () => {
    const next = [...waiting].find(isUnfolded);
    if (next === undefined) return;
    draw(next);
    setTimeout(drawNext, 10);
  };
  setTimeout(drawNext, 50);
  document.addEventListener("toggle", (event) => {
    if (!event.target.open) return;
    for (const name of drawn()) if (event.target.contains(element(name))) Plotly.Plots.resize(element(name));
    drawNext();
  }, true);

  const redraw = () => drawn().filter(isUnfolded).forEach(draw);
  for (const query of [dark, narrow]) query.addEventListener("change", redraw);
  window.addEventListener("beforeprint", () => {
    printing = true;
    [...waiting].filter(isUnfolded).forEach(draw);
    redraw();
  });
  window.addEventListener("afterprint", () => { printing = false; redraw(); });

  // contents: mark the current section; a button folds or unfolds all sections
  const nav = document.querySelector("nav");
  const list = nav.querySelector("ol");
  const folds = [...document.querySelectorAll("section > details")];
  const markCurrent = () => {
    const above = folds.map((fold) => fold.parentElement)
      .filter((section) => section.getBoundingClientRect().top < window.innerHeight / 4);
    const current = nav.querySelector(`a[href="#${(above.at(-1) ?? folds[0].parentElement).id}"]`);
    if (current.hasAttribute("aria-current")) return;
    nav.querySelector("[aria-current]")?.removeAttribute("aria-current");
    current.setAttribute("aria-current", "true");
    list.scrollTo({ left: current.offsetLeft - list.clientWidth / 3 });
  };
  window.addEventListener("scroll", markCurrent, { passive: true });
  markCurrent();
  const button = document.createElement("button");
  const canFold = () => folds.some((fold) => fold.open);
  const nameButton = () => { button.textContent = canFold() ? "Fold all" : "Unfold all"; };
  button.type = "button";
  button.addEventListener("click", () => {
    const open = !canFold();
    folds.forEach((fold) => { fold.open = open; });
  });
  document.addEventListener("toggle", nameButton, true);
  nameButton();
  nav.append(button);

  // a link to a folded element unfolds it
  const reveal = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    const own = target.querySelector(":scope > details");
    if (own) own.open = true;
    for (let fold = target.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
    target.scrollIntoView();
  };
  window.addEventListener("hashchange", reveal);
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[href^='#']");
    if (link && link.hash === location.hash) reveal();
  });
  if (location.hash) reveal();
})();
