"""The report's figures drawn by Matplotlib: for notebooks, papers and pages without scripts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from strainwave.errors import InvalidInput

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 7.0  # [inch]
_HEIGHT, _TALL = 320.0, 460.0  # [pixels] where a figure does not say
_DENSITY = 100.0  # pixels of a plotly layout that make an inch
_DASHES = {"solid": "-", "dot": ":", "dash": "--"}


def draw(figure: Mapping[str, Any]) -> Figure:
    """A plotly dictionary of the report as a Matplotlib figure.

    Parameters
    ----------
    figure : mapping
        `data` and `layout`: lines, markers, bands and error bars on one or two axes.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InvalidInput
        Matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure as Canvas
    except ImportError:
        raise InvalidInput(
            "drawing needs Matplotlib, which is not installed",
            remedy="install it with: pip install 'strainwave[plot]'",
        ) from None
    layout = figure["layout"]
    tall = "yaxis2" in layout
    height = layout.get("height", _TALL if tall else _HEIGHT) / _DENSITY
    drawn = Canvas(figsize=(_WIDTH, height), layout="constrained")
    upper: Axes = drawn.add_subplot(211 if tall else 111)
    axes = {"y": upper}
    if tall:
        axes["y2"] = drawn.add_subplot(212, sharex=upper)
        upper.tick_params(labelbottom=False)
    for trace in figure["data"]:
        _trace(axes[trace.get("yaxis", "y")], trace)
    for name, ax in axes.items():
        _dress(ax, layout, "yaxis" + name.removeprefix("y"), bottom=ax is list(axes.values())[-1])
    if layout.get("meta"):
        drawn.suptitle(str(layout["meta"]), fontsize="medium")
    return drawn


def _trace(ax: Axes, trace: Mapping[str, Any]) -> None:
    line, marker = trace.get("line", {}), trace.get("marker", {})
    if trace.get("fill") == "toself":
        colour, alpha = _see_through(trace["fillcolor"])
        ax.fill(trace["x"], trace["y"], color=colour, alpha=alpha, linewidth=0.0)
        return
    mode = trace.get("mode", "lines")
    dash = line.get("dash", "solid")
    style: dict[str, Any] = {
        "linestyle": _DASHES.get(dash, "--") if "lines" in mode else "none",
        "linewidth": line.get("width", 1.5),
        "marker": "o" if "markers" in mode else "",
        "markersize": marker.get("size", 6) * 0.6,
        "color": line.get("color") or marker.get("color"),
        "label": trace["name"] if trace.get("showlegend", True) else None,
    }
    y = [float("nan") if value is None else value for value in trace["y"]]
    if "error_y" in trace:
        ax.errorbar(trace["x"], y, yerr=trace["error_y"]["array"], capsize=3, **style)
    else:
        ax.plot(trace["x"], y, **style)


def _see_through(colour: str) -> tuple[tuple[float, float, float], float]:
    """`rgba(0,114,178,0.18)` as Matplotlib takes it."""
    red, green, blue, alpha = (float(part) for part in colour[5:-1].split(","))
    return (red / 255.0, green / 255.0, blue / 255.0), alpha


def _dress(ax: Axes, layout: Mapping[str, Any], key: str, *, bottom: bool) -> None:
    for shape in layout.get("shapes", ()):
        ax.axvline(shape["x0"], color=shape["line"]["color"], linestyle=":", linewidth=1.0)
    x, y = layout.get("xaxis", {}), layout.get(key, {})
    if x.get("type") == "log":
        ax.set_xscale("log")
    if y.get("type") == "log":
        ax.set_yscale("log")
    if bottom:
        ax.set_xlabel(x.get("title", {}).get("text", ""))
        ax.tick_params(axis="x", labelrotation=-x.get("tickangle", 0))
    ax.set_ylabel(y.get("title", {}).get("text", ""))
    ax.grid(visible=True, alpha=0.3)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        ax.legend(fontsize="small", frameon=False)
