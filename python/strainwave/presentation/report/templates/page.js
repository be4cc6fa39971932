"use strict";
(() => {
  const PAPER_WIDTH = 670; // pixels that A4 and Letter hold between their margins
  // heights of figures on paper: with their titles a third, a half or nearly the whole of a page,
  // so that pages fill up
  const PAPER_HEIGHTS = [[1.2, 225], [5.9, 410], [Infinity, 800]]; // up to so many panels: pixels
  const DARK = { // of each colour of the figures, one that stands out of a dark page
    "#0072B2": "#56A8E8", "#D55E00": "#FF8A3C", "#009E73": "#35C99B", "#CC79A7": "#E59CC4",
    "#888888": "#A0A8B4", "#FFFFFF": "#14181E",
  };
  // none that sends a figure away
  const BUTTONS = [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]];
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const narrow = window.matchMedia("(max-width: 40rem)");
  const finger = window.matchMedia("(pointer: coarse)");
  const waiting = new Set(Object.keys(figures));
  const place = (name) => document.getElementById(`figure-${name}`);
  const unfolded = (name) => !place(name).closest("details:not([open])");
  let printing = false;

  const inks = () => printing || !dark.matches
    ? { ink: "#1c2430", rule: "#d9dee5", paper: "#ffffff" }
    : { ink: "#e4e8ee", rule: "#333c48", paper: "#1c222b" };
  const coloured = (figure) => printing || !dark.matches ? figure : JSON.parse(
    JSON.stringify(figure).replace(/#[0-9A-Fa-f]{6}/g, (c) => DARK[c.toUpperCase()] ?? c));

  // at beforeprint the page still has its screen's size
  const onPaper = (name) => {
    const panels = Number(getComputedStyle(place(name)).getPropertyValue("--panels"));
    return { width: PAPER_WIDTH, height: PAPER_HEIGHTS.find(([most]) => panels <= most)[1] };
  };

  // on a phone a heat map has its names at the left only, and its scale below
  const slim = ({ data, layout }) => ({
    data: data.map((one) => ({ ...one, colorbar: { orientation: "h", y: 0, yanchor: "top", thickness: 12 } })),
    layout: { ...layout, margin: { ...layout.margin, b: 40 }, xaxis: { ...layout.xaxis, showticklabels: false, ticks: "" } },
  });
  const sized = (figure) => narrow.matches && !printing && figure.data[0].type === "heatmap" ? slim(figure) : figure;

  const framed = (given, name) => {
    const { ink, rule, paper } = inks();
    const size = printing ? 9 : narrow.matches ? 11 : 12;
    const axis = { gridcolor: rule, zerolinecolor: rule, linecolor: rule, automargin: !given.margin };
    const axes = Object.keys(given).filter((name) => /^[xy]axis\d*$/.test(name));
    const titled = (own) => ({ ...own, title: { standoff: 6, font: { size: Math.min(size, 11) }, ...own.title } });
    const layout = {
      ...given,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: ink, family: "system-ui, sans-serif", size },
      margin: { l: 56, r: 12, t: 12, b: 40, ...given.margin },
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1.01, yanchor: "bottom" },
      hovermode: "closest",
      modebar: { bgcolor: "rgba(0,0,0,0)", color: "#7d8794", activecolor: ink },
      hoverlabel: { bgcolor: paper, bordercolor: rule, font: { color: ink } },
      dragmode: finger.matches ? false : "zoom", // a finger scrolls the page
      ...Object.fromEntries(axes.map((name) => [name, { ...axis, ...titled(given[name]) }])),
    };
    return printing ? { ...layout, ...onPaper(name) } : layout;
  };

  const draw = (name) => {
    const { data, layout } = sized(coloured(figures[name]));
    const how = {
      responsive: !printing, displaylogo: false, displayModeBar: narrow.matches ? false : "hover",
      modeBarButtons: BUTTONS,
    };
    waiting.delete(name);
    Plotly.react(place(name), data, framed(layout, name), how);
    document.documentElement.dataset.drawn = Object.keys(figures).length - waiting.size;
  };
  const drawn = () => Object.keys(figures).filter((name) => !waiting.has(name));

  // what is seen comes first; the rest follows one by one, so that the page answers meanwhile;
  // what is folded away is drawn when it is unfolded
  const seen = new IntersectionObserver((entries) => entries.forEach((entry) => {
    const name = entry.target.id.replace("figure-", "");
    if (entry.isIntersecting && waiting.has(name)) draw(name);
  }), { rootMargin: "400px" });
  for (const name of waiting) seen.observe(place(name));
  const rest = () => {
    const next = [...waiting].find(unfolded);
    if (next === undefined) return;
    draw(next);
    setTimeout(rest, 10);
  };
  setTimeout(rest, 50);
  document.addEventListener("toggle", (event) => {
    if (!event.target.open) return;
    for (const name of drawn()) if (event.target.contains(place(name))) Plotly.Plots.resize(place(name));
    rest();
  }, true);

  const again = () => drawn().filter(unfolded).forEach(draw);
  for (const query of [dark, narrow]) query.addEventListener("change", again);
  window.addEventListener("beforeprint", () => {
    printing = true;
    [...waiting].filter(unfolded).forEach(draw);
    again();
  });
  window.addEventListener("afterprint", () => { printing = false; again(); });

  // contents: where the reader is, and all sections folded or unfolded at once
  const nav = document.querySelector("nav");
  const list = nav.querySelector("ol");
  const folds = [...document.querySelectorAll("section > details")];
  const here = () => {
    const above = folds.map((fold) => fold.parentElement)
      .filter((section) => section.getBoundingClientRect().top < window.innerHeight / 4);
    const now = nav.querySelector(`a[href="#${(above.at(-1) ?? folds[0].parentElement).id}"]`);
    if (now.hasAttribute("aria-current")) return;
    nav.querySelector("[aria-current]")?.removeAttribute("aria-current");
    now.setAttribute("aria-current", "true");
    list.scrollTo({ left: now.offsetLeft - list.clientWidth / 3 });
  };
  window.addEventListener("scroll", here, { passive: true });
  here();
  const button = document.createElement("button");
  const foldable = () => folds.some((fold) => fold.open);
  const named = () => { button.textContent = foldable() ? "Fold all" : "Unfold all"; };
  button.type = "button";
  button.addEventListener("click", () => {
    const open = !foldable();
    folds.forEach((fold) => { fold.open = open; });
  });
  document.addEventListener("toggle", named, true);
  named();
  nav.append(button);

  // a link into what is folded unfolds it
  const reveal = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    for (const fold of [target?.querySelector(":scope > details"), target?.closest("details")]) {
      if (fold) fold.open = true;
    }
    target?.scrollIntoView();
  };
  window.addEventListener("hashchange", reveal);
  nav.addEventListener("click", (event) => {
    if (event.target.hash === location.hash) reveal();
  });
  if (location.hash) reveal();
})();
