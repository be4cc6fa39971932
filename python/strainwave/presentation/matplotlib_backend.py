"""Figures -> Matplotlib, PNG and SVG: for notebooks, papers and plain pages."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any

from strainwave.errors import InvalidInput
from strainwave.presentation.figures import (
    RESIDUAL,
    SOLID,
    TICKS,
    Axis,
    Band,
    Bars,
    Dash,
    HeatMap,
    Line,
    Mark,
    Markers,
    Panel,
    Upright,
)
from strainwave.presentation.figures import Figure as Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH, _PANEL, _AROUND = 8.0, 2.2, 1.1  # [in] of a figure, of a panel, of titles and legend
_ROW = 0.19  # [in] of a row of a heat map
_NAMES = 1.7  # [in] of names that stand upright below
_POINT = 0.75  # points in a pixel
_RESOLUTION = 150  # [1/in] of a PNG
_GRID = "#d9dee5"
_WORDS = 8.0  # points high
_OPACITY = 0.18  # of a band


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


def draw(figure: Record) -> Figure:
    """A figure by Matplotlib.

    Parameters
    ----------
    figure : strainwave.presentation.figures.Figure

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InvalidInput
        Matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(_WIDTH, _height(figure)), layout="constrained")
    shares = [panel.height for panel in figure.panels]
    grid = drawn.add_gridspec(len(shares), 1, height_ratios=shares)
    axes: list[Axes] = []
    for k, panel in enumerate(figure.panels):
        axes.append(drawn.add_subplot(grid[k], sharex=axes[0] if axes else None))
        for mark in panel.marks:
            _mark(drawn, axes[k], mark)
        _vertical(axes[k], panel)
    _horizontal(axes, figure.x, named=_along_names(figure))
    for one in figure.uprights:
        _upright(axes, one)
    _legend(drawn, axes, figure.legend)
    if figure.caption:
        drawn.suptitle(figure.caption, fontsize=_WORDS + 2.0, parse_math=False)
    return drawn


def images(figure: Record) -> dict[str, bytes]:
    """A figure as files.

    Parameters
    ----------
    figure : Figure

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


def _height(figure: Record) -> float:
    """[in], with room for names."""
    rows = max((len(m.names) for m in figure.marks if isinstance(m, HeatMap)), default=0)
    if rows:
        return _AROUND + _PANEL + _ROW * rows
    return _AROUND + _PANEL * figure.height + (_NAMES if _along_names(figure) else 0.0)


def _along_names(figure: Record) -> bool:
    """Whether the horizontal axis has names in place of numbers."""
    return any(isinstance(m, Markers) and isinstance(m.x, tuple) for m in figure.marks)


def _mark(drawn: Figure, axes: Axes, mark: Mark) -> None:
    if isinstance(mark, Line | Markers):
        _points(axes, mark)
    elif isinstance(mark, Band):
        axes.fill_between(
            mark.x, mark.low, mark.high, color=mark.colour, alpha=_OPACITY, linewidth=0.0
        )
    elif isinstance(mark, Bars):
        axes.bar(mark.x, mark.y, width=mark.width, color=mark.colour, label=mark.name)
    else:
        _heat_map(drawn, axes, mark)


def _points(axes: Axes, mark: Line | Markers) -> None:
    """A line, points, or both, with error bars where there are any."""
    x: Any = list(mark.x) if isinstance(mark.x, tuple) else mark.x
    look: dict[str, Any] = {"label": mark.name, "color": mark.colour}
    if isinstance(mark, Line):
        look["linewidth"] = _POINT * mark.width
        look["linestyle"] = _dashes(mark.dash, mark.width)
    else:
        look |= {"linestyle": "none", "alpha": mark.opacity}
    if mark.size:
        look |= {"marker": "o", "markersize": _POINT * mark.size}
    if mark.error is None:
        axes.plot(x, mark.y, **look)
    else:
        axes.errorbar(x, mark.y, yerr=mark.error, capsize=2.0, **look)


def _heat_map(drawn: Figure, axes: Axes, mark: HeatMap) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    scale = LinearSegmentedColormap.from_list("scale", mark.colours)
    image = axes.imshow(mark.values, cmap=scale, vmin=mark.low, vmax=mark.high, aspect="auto")
    axes.set_xticks(range(len(mark.names)), mark.names, rotation=90, fontsize=_WORDS)
    axes.set_yticks(range(len(mark.names)), mark.names, fontsize=_WORDS)
    drawn.colorbar(image, ax=axes)


def _vertical(axes: Axes, panel: Panel) -> None:
    """Title, scale and range of a panel."""
    _named(axes.set_ylabel, panel.axis)
    if axes.images:
        return
    if panel.axis.log:
        axes.set_yscale("log")
    if panel.axis.range is not None:
        axes.set_ylim(*panel.axis.range)
    if panel.axis.step is not None:
        from matplotlib.ticker import MultipleLocator

        axes.yaxis.set_major_locator(MultipleLocator(panel.axis.step))
    axes.grid(color=_GRID, linewidth=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _horizontal(axes: list[Axes], axis: Axis, *, named: bool) -> None:
    last = axes[-1]
    if axis.log:
        last.set_xscale("log")
        low, high = last.get_xlim()  # ticks within it: asking for all would widen the range
        ticks = {value: text for value, text in TICKS.items() if low <= value <= high}
        last.set_xticks(list(ticks), list(ticks.values()))
        last.minorticks_off()
    if axis.range is not None:
        last.set_xlim(*axis.range)
    for upper in axes[:-1]:
        upper.tick_params(labelbottom=False)
    if named:
        last.tick_params(axis="x", labelrotation=90.0, labelsize=_WORDS)
    _named(last.set_xlabel, axis)


def _named(setter: Any, axis: Axis) -> None:
    setter(axis.title, fontsize=_WORDS + 1.0, parse_math=False)


def _upright(axes: list[Axes], one: Upright) -> None:
    """A line through all panels, with words in one of them."""
    dashes = _dashes(one.dash, 1.0)
    for own in axes:
        own.axvline(one.x, color=RESIDUAL, linewidth=_POINT, linestyle=dashes, zorder=1)
    if one.text:
        axes[one.panel].annotate(
            one.text,
            (one.x, one.height),
            xycoords=("data", "axes fraction"),
            xytext=(-3.0 if one.before else 3.0, -2.0),
            textcoords="offset points",
            ha="right" if one.before else "left",
            va="top",
            fontsize=_WORDS - 1.0,
            parse_math=False,
        )


def _legend(drawn: Figure, axes: list[Axes], names: list[str]) -> None:
    """One entry per name, above the figure."""
    handles: dict[str, Any] = {}
    for own in axes:
        for handle, name in zip(*own.get_legend_handles_labels(), strict=True):
            handles.setdefault(name, handle)
    if not names:
        return
    box = drawn.legend(
        [handles[name] for name in names],
        names,
        loc="outside upper left",
        ncols=4,
        frameon=False,
        fontsize=_WORDS,
    )
    for text in box.get_texts():
        text.set_parse_math(False)


def _dashes(dash: Dash, width: float) -> Any:
    """Dashes in pixels as Matplotlib's, in widths of the line."""
    return "-" if dash == SOLID else (0, [length / max(width, 1.0) for length in dash])
