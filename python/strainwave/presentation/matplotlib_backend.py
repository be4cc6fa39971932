"""Plotly dictionaries -> Matplotlib figures, PNG and SVG: for notebooks, papers and plain pages.

Only what this package's figures are made of is drawn: lines, points, error bars, filled outlines,
bars, heat maps; panels one above the other, logarithmic axes, upright lines and words. Anything
else is refused: a figure that lacks a part would mislead.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import TYPE_CHECKING, Any

from strainwave.errors import InvalidInput

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH, _PANEL, _AROUND = 8.0, 2.2, 1.1  # [in] of a figure, of a panel, of titles and legend
_ROW = 0.19  # [in] of a row of a heat map
_POINT = 0.75  # points in a pixel
_RESOLUTION = 150  # [1/in] of a PNG
_GRID = "#d9dee5"
_WORDS = 8.0  # points high


def require_matplotlib() -> None:
    """Refuse early, in words, where Matplotlib is not installed.

    Raises
    ------
    InvalidInput
        It is not.
    """
    try:
        import matplotlib.figure  # noqa: F401 - whether it is there is the question
    except ImportError:
        raise InvalidInput(
            "drawing figures needs Matplotlib, which is not installed",
            remedy="install it with: pip install 'strainwave[plot]'",
        ) from None


def draw(figure: Mapping[str, Any]) -> Figure:
    """One of this package's plotly dictionaries as a Matplotlib figure.

    Parameters
    ----------
    figure : dict
        `data` and `layout`; the title is `layout.meta`, the height `layout.height` in pixels.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InvalidInput
        Matplotlib is not installed, or the figure has a kind of trace that is not drawn here.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    layout = figure["layout"]
    names = [key for key in layout if key.startswith("yaxis")] or ["yaxis"]
    rows = max((len(t["y"]) for t in figure["data"] if t.get("type") == "heatmap"), default=0)
    panels = _AROUND + max(_PANEL * len(names), _PANEL + _ROW * rows if rows else 0.0)
    height = layout["height"] * _POINT / 72.0 if "height" in layout else panels
    drawn = Figure(figsize=(_WIDTH, height), layout="constrained")
    shares = [high - low for low, high in (_domain(layout, k) for k in range(len(names)))]
    grid = drawn.add_gridspec(len(names), 1, height_ratios=shares)
    axes: dict[str, Axes] = {}
    for k, name in enumerate(names):
        above = next(iter(axes.values()), None)
        axes[name.replace("axis", "")] = drawn.add_subplot(grid[k], sharex=above)
    for trace in figure["data"]:
        _trace(drawn, axes[trace.get("yaxis", "y")], trace)
    for name, own in zip(names, axes.values(), strict=True):
        _vertical(own, layout.get(name, {}))
    _horizontal(list(axes.values()), layout.get("xaxis", {}))
    _marks(list(axes.values()), layout)
    _legend(drawn, list(axes.values()), figure["data"])
    if layout.get("meta"):
        drawn.suptitle(str(layout["meta"]), fontsize=_WORDS + 2.0, parse_math=False)
    return drawn


def images(figure: Mapping[str, Any]) -> dict[str, bytes]:
    """A figure as files.

    Parameters
    ----------
    figure : dict

    Returns
    -------
    dict
        Ending, "svg" or "png", to contents.

    Raises
    ------
    InvalidInput
        As for `draw`.
    """
    drawn = draw(figure)
    import matplotlib as mpl

    found = {}
    # the same figure gives the same bytes, and words stay words
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "strainwave"}):
        for ending, metadata in (("svg", {"Date": None}), ("png", {"Software": None})):
            file = BytesIO()
            drawn.savefig(file, format=ending, dpi=_RESOLUTION, metadata=metadata)
            found[ending] = file.getvalue()
            drawn.set_layout_engine("none")  # the first file has settled it
    return found


def _trace(drawn: Figure, axes: Axes, trace: Mapping[str, Any]) -> None:
    kind = trace.get("type", "scatter")
    if kind == "scatter" and trace.get("fill") == "toself":
        axes.fill(_numbers(trace["x"]), _numbers(trace["y"]), color=_colour(trace["fillcolor"]))
    elif kind == "scatter":
        _scatter(axes, trace)
    elif kind == "bar":
        colour = _colour(trace["marker"]["color"])
        axes.bar(_numbers(trace["x"]), _numbers(trace["y"]), width=trace["width"], color=colour)
    elif kind == "heatmap":
        _heat_map(drawn, axes, trace)
    else:
        raise InvalidInput(f"a trace of the type '{kind}' is not drawn without a browser")


def _scatter(axes: Axes, trace: Mapping[str, Any]) -> None:
    """A line, points, or both, with error bars where there are any."""
    words = all(isinstance(value, str) for value in trace["x"])
    x: Any = list(trace["x"]) if words else _numbers(trace["x"])
    y = _numbers(trace["y"])
    look: dict[str, Any] = {"label": trace.get("name", "")}
    if "lines" in trace["mode"]:
        own = trace["line"]
        width = own.get("width", 2.0)
        look |= {"color": own["color"], "linewidth": _POINT * width}
        look["linestyle"] = _dashes(own.get("dash", "solid"), width)
    else:
        look |= {"linestyle": "none", "color": trace["marker"]["color"]}
    if "markers" in trace["mode"]:
        look |= {"marker": "o", "markersize": _POINT * trace["marker"].get("size", 6.0)}
    if "error_y" in trace:
        axes.errorbar(x, y, yerr=_numbers(trace["error_y"]["array"]), capsize=2.0, **look)
    else:
        axes.plot(x, y, **look)


def _heat_map(drawn: Figure, axes: Axes, trace: Mapping[str, Any]) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    colours = [(at, colour) for at, colour in trace["colorscale"]]
    scale = LinearSegmentedColormap.from_list("scale", colours)
    rows = [_numbers(row) for row in trace["z"]]
    image = axes.imshow(rows, cmap=scale, vmin=trace["zmin"], vmax=trace["zmax"], aspect="auto")
    axes.set_xticks(range(len(trace["x"])), trace["x"], rotation=90, fontsize=_WORDS)
    axes.set_yticks(range(len(trace["y"])), trace["y"], fontsize=_WORDS)
    drawn.colorbar(image, ax=axes)


def _vertical(axes: Axes, axis: Mapping[str, Any]) -> None:
    """Title, scale and range of a panel."""
    _named(axes.set_ylabel, axis)
    if axis.get("type") == "log":
        axes.set_yscale("log")
    if "range" in axis:
        axes.set_ylim(*axis["range"])
    if "dtick" in axis and not axes.images:
        from matplotlib.ticker import MultipleLocator

        axes.yaxis.set_major_locator(MultipleLocator(axis["dtick"]))
    if not axes.images:
        axes.grid(color=_GRID, linewidth=0.5)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)


def _horizontal(axes: list[Axes], axis: Mapping[str, Any]) -> None:
    if axis.get("type") == "log":
        axes[-1].set_xscale("log")
        if "tickvals" in axis:  # those within the range, which asking for all would widen
            low, high = axes[-1].get_xlim()
            shown = zip(axis["tickvals"], axis["ticktext"], strict=True)
            ticks = [(value, text) for value, text in shown if low <= value <= high]
            axes[-1].set_xticks([v for v, _ in ticks], [t for _, t in ticks])
            axes[-1].minorticks_off()
    if "range" in axis:
        axes[-1].set_xlim(*axis["range"])
    for upper in axes[:-1]:
        upper.tick_params(labelbottom=False)
    if "tickangle" in axis and not axes[-1].images:
        axes[-1].tick_params(axis="x", labelrotation=-axis["tickangle"], labelsize=_WORDS)
    _named(axes[-1].set_xlabel, axis)


def _named(setter: Any, axis: Mapping[str, Any]) -> None:
    setter(axis.get("title", {}).get("text", ""), fontsize=_WORDS + 1.0, parse_math=False)


def _marks(axes: list[Axes], layout: Mapping[str, Any]) -> None:
    """Upright lines through all panels, words at the top of the first."""
    logarithmic = layout.get("xaxis", {}).get("type") == "log"
    for shape in layout.get("shapes", ()):
        width = shape["line"]["width"]
        look = {"color": shape["line"]["color"], "linewidth": _POINT * width, "zorder": 1}
        for own in axes:
            own.axvline(shape["x0"], linestyle=_dashes(shape["line"]["dash"], width), **look)
    for word in layout.get("annotations", ()):
        panel, height = _within(word["y"], [_domain(layout, k) for k in range(len(axes))])
        axes[panel].annotate(
            word["text"],
            (10.0 ** word["x"] if logarithmic else word["x"], height),
            xycoords=("data", "axes fraction"),
            xytext=(-3.0 if word["xanchor"] == "right" else 3.0, -2.0),
            textcoords="offset points",
            ha=word["xanchor"],
            va=word["yanchor"],
            fontsize=_WORDS - 1.0,
            parse_math=False,
        )


def _domain(layout: Mapping[str, Any], panel: int) -> tuple[float, float]:
    low, high = layout.get(f"yaxis{panel + 1 if panel else ''}", {}).get("domain", (0.0, 1.0))
    return float(low), float(high)


def _within(height: float, domains: list[tuple[float, float]]) -> tuple[int, float]:
    """The panel that a height of the whole figure lies in, and how high in it."""
    for panel, (low, high) in enumerate(domains):
        if low <= height <= high:
            return panel, (height - low) / (high - low)
    return 0, 1.0


def _legend(drawn: Figure, axes: list[Axes], data: list[Mapping[str, Any]]) -> None:
    """One entry a name, above the figure, where there is more than one to tell apart."""
    wanted = [t["name"] for t in data if t.get("showlegend", True) and t.get("name")]
    handles: dict[str, Any] = {}
    for own in axes:
        for handle, name in zip(*own.get_legend_handles_labels(), strict=True):
            if name in wanted:
                handles.setdefault(name, handle)
    if len(handles) < 2:
        return
    box = drawn.legend(
        list(handles.values()),
        list(handles),
        loc="outside upper left",
        ncols=4,
        frameon=False,
        fontsize=_WORDS,
    )
    for text in box.get_texts():
        text.set_parse_math(False)


def _numbers(values: Any) -> list[float]:
    return [float("nan") if value is None else float(value) for value in values]


def _colour(css: str) -> str | tuple[float, ...]:
    """A colour of the style sheets' language, #rrggbb or rgba(r,g,b,a)."""
    if not css.startswith("rgba"):
        return css
    red, green, blue, opacity = (float(part) for part in css[5:-1].split(","))
    return red / 255.0, green / 255.0, blue / 255.0, opacity


def _dashes(dash: str, width: float) -> Any:
    """Plotly's dashes, in pixels, as Matplotlib's, in widths of the line."""
    if dash in ("solid", "dot", "dash"):
        return {"solid": "-", "dot": ":", "dash": "--"}[dash]
    lengths = [float(part.removesuffix("px")) for part in dash.split(",")]
    return 0, [length / max(width, 1.0) for length in lengths]
