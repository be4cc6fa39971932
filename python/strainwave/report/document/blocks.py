"""The parts of a page as data: sections with tables, figures, paragraphs and facts, without HTML.

The modules of the report make these records; the templates define how each looks. A document is one
self-contained HTML file, filled from the templates of this package.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args
from unicodedata import lookup

from strainwave.io.templates import template_environment
from strainwave.report.figures import Figure
from strainwave.report.plotly_backend import plotly

if TYPE_CHECKING:
    from jinja2 import Environment, Template
    from markupsafe import Markup

Mark = Literal["", "good", "doubt", "bad"]
Row = Sequence["str | Cell"]
FigureKind = Literal[
    "parameters",
    "arm",
    "bode",
    "amplitude",
    "sweep",
    "motor",
    "poles",
    "gear",
    "check",
    "tuning",
    "fitted",
    "residuals",
    "correlation",
    "interaction",
    "correlations",
    "record",
]
"""Kinds of figures of an identification; "parameters" is not in the report."""
FIGURE_KINDS: tuple[FigureKind, ...] = get_args(FigureKind)


@dataclass(frozen=True, slots=True)
class FigureName:
    """Which figure of an identification: its kind, and what it shows."""

    kind: FigureKind
    joint: int | None = None
    experiment: str | None = None
    part: str | None = None  # of a pair ("slope", "torsion"), or a channel

    def includes(self, other: FigureName) -> bool:
        """Whether the other figure has all that this name states."""
        pairs = (
            (self.joint, other.joint),
            (self.experiment, other.experiment),
            (self.part, other.part),
        )
        return self.kind == other.kind and all(mine in (None, its) for mine, its in pairs)

    def __str__(self) -> str:
        joint = None if self.joint is None else f"joint {self.joint}"
        return " ".join(filter(None, (self.kind, joint, self.experiment, self.part)))


@dataclass(frozen=True, slots=True)
class Span:
    """A part of a sentence."""

    text: str
    strong: bool = False
    kind: Literal["", "code", "badge"] = ""
    href: str = ""  # "#id" of an element of the page
    tip: str = ""  # shown when the pointer is over the link
    mark: Mark = ""


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Sentences."""

    kind: ClassVar[str] = "paragraph"
    spans: tuple[Span, ...]


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table."""

    text: str
    kind: Literal["", "number", "text", "code", "symbol", "name"] = ""
    href: str = ""  # "#id" of an element of the page
    tip: str = ""  # shown when the pointer is over the link
    key: str = ""  # of the first cell of a row: the id of the row
    mark: Mark = ""

    @property
    def classes(self) -> str:
        """Classes in the style sheet."""
        return f"{self.kind} {self.mark}".strip()

    @property
    def plain(self) -> bool:
        """Whether the cell needs no markup inside."""
        return not self.href and self.kind in ("", "number", "text")


@dataclass(frozen=True, slots=True)
class RowGroup:
    """A row that titles the rows below it."""

    title: str


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under column heads; a wide table scrolls sideways."""

    kind: ClassVar[str] = "table"
    label: str
    heads: tuple[Cell, ...]
    rows: tuple[tuple[Cell, ...] | RowGroup, ...]  # the first cell is the head of the row
    heading: bool = True  # whether the label is visible; screen readers always read it


@dataclass(frozen=True, slots=True)
class Facts:
    """Terms and their values."""

    kind: ClassVar[str] = "facts"
    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Plot:
    """A figure with its title and caption."""

    kind: ClassVar[str] = "plot"
    name: FigureName | str  # of its files, before `slug`
    label: str  # title above the figure
    figure: Figure
    words: str = ""  # caption below the figure, also read by screen readers


@dataclass(frozen=True, slots=True)
class Fold:
    """Blocks that are hidden until the reader unfolds them."""

    kind: ClassVar[str] = "fold"
    summary: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Callout:
    """Highlighted blocks."""

    kind: ClassVar[str] = "callout"
    mark: Mark
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Columns:
    """Blocks side by side, or one below the other on a narrow screen."""

    kind: ClassVar[str] = "columns"
    blocks: tuple[Block, ...]


Block = Paragraph | Table | Facts | Plot | Fold | Callout | Columns


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page with an entry in the contents."""

    key: str  # id of its element
    title: str
    blocks: tuple[Block, ...]  # a section without blocks is omitted


def paragraph(*parts: str | Span) -> Paragraph:
    """A paragraph of plain and formatted parts."""
    return Paragraph(tuple(part if isinstance(part, Span) else Span(part) for part in parts))


def table(
    label: str, heads: Iterable[str | Cell], rows: Iterable[Row | RowGroup], *, heading: bool = True
) -> Iterator[Table]:
    """Yield a table, or no block if there are no rows. The first cell of a row is its head."""
    cells = tuple(row if isinstance(row, RowGroup) else _cells(row) for row in rows)
    if cells:
        yield Table(label, _cells(heads), cells, heading)


def number(text: str) -> Cell:
    """A cell of a numeric column."""
    return Cell(text, "number")


def prose(text: str) -> Cell:
    """A cell of text that may wrap."""
    return Cell(text, "text")


def two_digits(value: float) -> str:
    """A positive number with two significant digits, or all digits before the point."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:#.2g}"


def plots_of(blocks: Iterable[Block]) -> Iterator[Plot]:
    """The figures in blocks and in nested blocks, in order."""
    for block in blocks:
        if isinstance(block, Plot):
            yield block
        elif isinstance(block, Fold | Callout | Columns):
            yield from plots_of(block.blocks)


def keyed(sections: Iterable[Section]) -> dict[str, Plot]:
    """Every figure under a unique key that is valid as a file name and as an element's id."""
    plots: dict[str, Plot] = {}
    for section in sections:
        for plot in plots_of(section.blocks):
            name = slug(str(plot.name))
            numbered = (f"{name}-{k}" for k in count(2))
            plots[next(key for key in chain([name], numbered) if key not in plots)] = plot
    return plots


def slug(text: str) -> str:
    """Text as lower-case letters and digits joined by dashes; "figure" if the result is empty."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "figure"


def _cells(row: Iterable[str | Cell]) -> tuple[Cell, ...]:
    return tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in row)


_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
"""Content security policy: the page loads nothing and evaluates only its own scripts."""


def document(
    title: str, subtitle: str, sections: Sequence[Section], *, before: Sequence[Block] = ()
) -> str:
    """A complete page that needs no network. `before` precedes the contents and has no figures."""
    from markupsafe import Markup

    filled = [section for section in sections if section.blocks]
    plots = keyed(filled)
    keys = {id(plot): key for key, plot in plots.items()}
    return fill_template(
        "document/page",
        policy=_POLICY,
        title=title,
        subtitle=subtitle,
        before=before,
        sections=filled,
        key_of=lambda plot: keys[id(plot)],
        style=Markup(read_template("document/page.css")),
        figures=Markup(_figure_element(plots)),
        scripts=[Markup(script) for script in page_scripts()] if plots else [],
    )


_FIGURES_START = '<script type="application/json" id="figures">'
_FIGURES_END = "</script>"
_MAX_PAGE_BYTES = 64 << 20  # of a page whose figures are read


def _figure_element(plots: Mapping[str, Plot]) -> str:
    """The element with all figures of a page, which the script of the page draws."""
    from pydantic_core import to_json  # in a quarter of the time of the standard encoder

    figures = {key: plotly(plot.figure) | {"title": plot.label} for key, plot in plots.items()}
    # `<` is escaped because it could end the element
    figure_json = to_json(figures, inf_nan_mode="null").decode().replace("<", "\\u003c")
    return f"{_FIGURES_START}{figure_json}{_FIGURES_END}"


def read_figures(page: Path) -> dict[str, dict[str, Any]]:
    """`title`, `data` and `layout` of the figures that `document` wrote into a page, by key.

    Empty if the file is missing, damaged or no page. Pages of earlier versions have no titles.
    """
    try:
        is_small = page.stat().st_size <= _MAX_PAGE_BYTES
        text = page.read_text(encoding="utf-8") if is_small else ""
        # no other text of a page has the start of the element: each `<` of it is escaped
        figure_json = text.partition(_FIGURES_START)[2].partition(_FIGURES_END)[0]
        figures: object = json.loads(figure_json or "{}")
    except (OSError, ValueError):
        return {}
    if not isinstance(figures, dict):
        return {}
    return {
        key: {"title": key} | figure
        for key, figure in figures.items()
        if isinstance(figure, dict) and isinstance(figure.get("data"), list)
    }


def page_scripts() -> list[str]:
    """The scripts of a page with figures."""
    return [plotly_script().read_bytes().decode(), read_template("document/page.js")]


def plotly_script() -> Path:
    """Plotly's script. Importing the Python package takes longer than filling the page."""
    spec = find_spec("plotly")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("plotly")
    return Path(spec.origin).parent / "package_data" / "plotly.min.js"


_REPORT = Path(__file__).parent.parent
_GREEK = {
    name: lookup(f"GREEK SMALL LETTER {name.upper()}")
    for name in ("alpha", "beta", "gamma", "delta", "tau")
}


def load_page() -> None:
    """Compile the templates of a page, as the first page would."""
    for template in ("document/page", "document/blocks"):
        _load_template(template)


def fill_template(template: str, **values: Any) -> str:
    """The HTML of a template; every text is escaped, and a missing value is an error."""
    return _load_template(template).render(**values)


def _load_template(template: str) -> Template:
    """A compiled template of this package, named without its ending: "document/page"."""
    return _environment().get_template(f"{template}.html.j2")


def read_template(name: str) -> str:
    """The text of a template file, named with its ending: "document/page.css"."""
    folder, _, file = name.partition("/")
    return (_REPORT / folder / "templates" / file).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    environment = template_environment(read_template, autoescape=True)
    environment.filters |= {"typeset": typeset, "breakable": breakable}
    return environment


def breakable(name: str) -> Markup:
    """A name that may break after each underscore."""
    from markupsafe import Markup, escape

    return escape(name).replace("_", Markup("_<wbr>"))


def typeset(symbol: str) -> Markup:
    """A symbol of docs/notation.md as mathematics: `m_M` with an index, `alpha` in Greek."""
    from markupsafe import Markup

    stem, _, index = symbol.partition("_")
    if not index:
        stem = symbol.rstrip("0123456789")
        index = symbol.removeprefix(stem)
    return Markup("{}<sub>{}</sub>" if index else "{}").format(_GREEK.get(stem, stem), index)
