"use strict";
(() => {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const colours = () => {
    const style = getComputedStyle(document.documentElement);
    const value = (name) => style.getPropertyValue(name).trim();
    const axis = { gridcolor: value("--rule"), zerolinecolor: value("--rule"), color: value("--ink") };
    return { font: { color: value("--ink") }, axis };
  };
  const layout = (given) => {
    const { font, axis } = colours();
    return {
      ...given,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { ...font, family: "system-ui, sans-serif", size: 13 },
      margin: { l: 64, r: 12, t: 28, b: 48 },
      legend: { orientation: "h", y: 1.12, x: 0 },
      hovermode: "x unified",
      ...Object.fromEntries(["xaxis", "yaxis", "xaxis2", "yaxis2"].filter(
        (name) => name in given).map((name) => [name, { ...axis, ...given[name] }])),
    };
  };
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const draw = () => {
    for (const [id, figure] of Object.entries(figures)) {
      Plotly.react(id, figure.data, layout(figure.layout), { responsive: true, displaylogo: false });
    }
  };
  draw();
  dark.addEventListener("change", draw);
})();
