"""Figures by Matplotlib, as PNG and SVG, for notebooks and publications."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any

from strainwave.errors import import_optional
from strainwave.report import figures
from strainwave.report.figures import Area, Axis, Colour, Dash, Line, Mark, Markers, Panel, Upright

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FIGURE_WIDTH = 8.0  # [in]
_PANEL_HEIGHT = 2.2  # [in]
_MARGIN_HEIGHT = 1.1  # [in] of titles and legend
_HEAT_MAP_ROW_HEIGHT = 0.19  # [in]
_CATEGORY_LABEL_HEIGHT = 1.7  # [in] of vertical category names below the axis
_POINTS_PER_PIXEL = 0.75
_PNG_RESOLUTION = 150  # [1/in]
_GRID_COLOUR = "#d9dee5"
_FONT_SIZE = 8.0  # [pt]
_BAND_OPACITY = 0.18
_SYMBOLS = {"circle": "o", "circle-open": "o", "x": "x"}


def require_matplotlib() -> None:
    """Raise InvalidInput with the remedy if Matplotlib is not installed."""
    import_optional("matplotlib", "drawing figures", "matplotlib")


def draw(figure: figures.Figure) -> Figure:
    """A figure by Matplotlib; raises InvalidInput if Matplotlib is not installed."""
    require_matplotlib()
    from matplotlib.figure import Figure

    # category names instead of numbers on the horizontal axis, and names of rows need room
    categories = any(isinstance(m, Markers) and isinstance(m.x, tuple) for m in figure.marks)
    rows = max((len(m.names) for m in figure.marks if isinstance(m, figures.HeatMap)), default=0)
    height = _PANEL_HEIGHT * figure.height + _CATEGORY_LABEL_HEIGHT * categories
    if rows:
        height = _PANEL_HEIGHT + _HEAT_MAP_ROW_HEIGHT * rows
    canvas = Figure(figsize=(_FIGURE_WIDTH, _MARGIN_HEIGHT + height), layout="constrained")
    shares = [panel.height for panel in figure.panels]
    grid = canvas.add_gridspec(len(shares), 1, height_ratios=shares)
    axes: list[Axes] = []
    for k, panel in enumerate(figure.panels):
        axes.append(canvas.add_subplot(grid[k], sharex=axes[0] if axes else None))
        if figure.has_equal_scales:
            axes[k].set_aspect("equal", adjustable="datalim")
        for mark in panel.marks:
            _mark(canvas, axes[k], mark)
        _vertical(axes[k], panel)
    _horizontal(axes, figure.x, categories=categories)
    for line in figure.uprights:
        _upright(axes, line)
    _legend(canvas, axes, figure.legend)
    if figure.caption:
        canvas.suptitle(figure.caption, fontsize=_FONT_SIZE + 2.0, parse_math=False)
    return canvas


def images(figure: figures.Figure, *, resolution: int = _PNG_RESOLUTION) -> dict[str, bytes]:
    """The contents of a figure's files by ending, "svg" and "png"; `resolution` [1/in]."""
    canvas = draw(figure)
    import matplotlib as mpl

    files = {}
    # reproducible bytes, and text as text
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "strainwave"}):
        for ending, metadata in (("svg", {"Date": None}), ("png", {"Software": None})):
            file = BytesIO()
            canvas.savefig(file, format=ending, dpi=resolution, metadata=metadata)
            files[ending] = file.getvalue()
            canvas.set_layout_engine("none")  # the layout is final after the first file
    return files


def _mark(canvas: Figure, axes: Axes, mark: Mark) -> None:
    if isinstance(mark, Line | Markers):
        _points(axes, mark)
    elif isinstance(mark, Area):
        axes.fill_between(
            mark.x, mark.low, mark.high, color=mark.colour, alpha=_BAND_OPACITY, linewidth=0.0
        )
    elif isinstance(mark, figures.Bars):
        axes.bar(mark.x, mark.y, width=mark.width, color=mark.colour, label=mark.name)
    else:
        from matplotlib.colors import LinearSegmentedColormap

        scale = LinearSegmentedColormap.from_list("scale", mark.colours)
        image = axes.imshow(mark.values, cmap=scale, vmin=mark.low, vmax=mark.high, aspect="auto")
        axes.set_xticks(range(len(mark.names)), mark.names, rotation=90, fontsize=_FONT_SIZE)
        axes.set_yticks(range(len(mark.names)), mark.names, fontsize=_FONT_SIZE)
        canvas.colorbar(image, ax=axes)


def _points(axes: Axes, mark: Line | Markers) -> None:
    x: Any = list(mark.x) if isinstance(mark.x, tuple) else mark.x
    style: dict[str, Any] = {"label": mark.name, "color": mark.colour}
    if isinstance(mark, Line):
        style["linewidth"] = _POINTS_PER_PIXEL * mark.width
        style["linestyle"] = _dashes(mark.dash, mark.width)
    else:
        style |= {"linestyle": "none", "alpha": mark.opacity}
    if mark.size:
        style |= {"marker": "o", "markersize": _POINTS_PER_PIXEL * mark.size}
    if isinstance(mark, Markers):
        style["marker"] = _SYMBOLS[mark.symbol]
        style |= {"markerfacecolor": "none"} if mark.symbol == "circle-open" else {}
        for label, at_x, at_y in zip(mark.labels, x, mark.y, strict=False):
            axes.annotate(
                label,
                (at_x, at_y),
                xytext=(4.0, 4.0 if mark.is_above else -4.0),
                verticalalignment="bottom" if mark.is_above else "top",
                textcoords="offset points",
                fontsize=_FONT_SIZE,
                parse_math=False,
            )
    if mark.error is None:
        axes.plot(x, mark.y, **style)
    else:
        axes.errorbar(x, mark.y, yerr=mark.error, capsize=2.0, **style)


def _vertical(axes: Axes, panel: Panel) -> None:
    axes.set_ylabel(panel.axis.title, fontsize=_FONT_SIZE + 1.0, parse_math=False)
    if axes.images:
        return
    if panel.axis.log:
        axes.set_yscale("log")
    if panel.axis.range is not None:
        axes.set_ylim(*panel.axis.range)
    if panel.axis.step is not None:
        from matplotlib.ticker import MultipleLocator

        axes.yaxis.set_major_locator(MultipleLocator(panel.axis.step))
    axes.grid(color=_GRID_COLOUR, linewidth=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _horizontal(axes: list[Axes], axis: Axis, *, categories: bool) -> None:
    last = axes[-1]
    if axis.log:
        last.set_xscale("log")
        low, high = last.get_xlim()  # ticks outside would widen the range
        ticks = {
            value: text for value, text in figures.FREQUENCY_TICKS.items() if low <= value <= high
        }
        last.set_xticks(list(ticks), list(ticks.values()))
        last.minorticks_off()
    if axis.range is not None:
        last.set_xlim(*axis.range)
    for upper in axes[:-1]:
        upper.tick_params(labelbottom=False)
    if categories:
        last.tick_params(axis="x", labelrotation=90.0, labelsize=_FONT_SIZE)
    last.set_xlabel(axis.title, fontsize=_FONT_SIZE + 1.0, parse_math=False)


def _upright(axes: list[Axes], line: Upright) -> None:
    dashes = _dashes(line.dash, 1.0)
    for panel_axes in axes:
        panel_axes.axvline(
            line.x, color=Colour.RESIDUAL, linewidth=_POINTS_PER_PIXEL, linestyle=dashes, zorder=1
        )
    if line.text:
        axes[line.panel].annotate(
            line.text,
            (line.x, line.height),
            xycoords=("data", "axes fraction"),
            xytext=(-3.0 if line.before else 3.0, -2.0),
            textcoords="offset points",
            ha="right" if line.before else "left",
            va="top",
            fontsize=_FONT_SIZE - 1.0,
            parse_math=False,
        )


def _legend(canvas: Figure, axes: list[Axes], names: list[str]) -> None:
    handles: dict[str, Any] = {}
    for panel_axes in axes:
        for handle, name in zip(*panel_axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(name, handle)
    if not names:
        return
    box = canvas.legend(
        [handles[name] for name in names],
        names,
        loc="outside upper left",
        ncols=4,
        frameon=False,
        fontsize=_FONT_SIZE,
    )
    for text in box.get_texts():
        text.set_parse_math(False)


def _dashes(dash: Dash, width: float) -> Any:
    """Dash lengths in line widths, as Matplotlib expects."""
    return "-" if dash == figures.SOLID else (0, [length / max(width, 1.0) for length in dash])
