"""What pages are made of: sections of tables, figures, sentences and facts, without any HTML.

The report's modules make these; the templates know how each looks.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from strainwave.presentation.figures import Figure

Mark = Literal["", "good", "doubt", "bad"]
Row = Sequence["str | Cell"]


@dataclass(frozen=True, slots=True)
class Span:
    """A part of a sentence."""

    text: str
    strong: bool = False
    kind: Literal["", "code"] = ""
    href: str = ""  # of an element of the page, "#warnings"
    tip: str = ""  # what a pointer over the link shows
    mark: Mark = ""


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Sentences."""

    kind: ClassVar[str] = "paragraph"
    spans: tuple[Span, ...]


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table that is not a plain word."""

    text: str
    kind: Literal["", "number", "text", "code", "symbol", "name"] = ""
    href: str = ""  # of an element of the page
    tip: str = ""  # what a pointer over the link shows
    key: str = ""  # of a row's first cell: the row's id
    mark: Mark = ""

    @property
    def classes(self) -> str:
        """What the style sheet knows it by."""
        return f"{self.kind} {self.mark}".strip()

    @property
    def plain(self) -> bool:
        """Whether it is its text and nothing else."""
        return not self.href and self.kind in ("", "number", "text")


@dataclass(frozen=True, slots=True)
class Group:
    """A row that names those below it."""

    title: str


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under heads; wide ones scroll sideways."""

    kind: ClassVar[str] = "table"
    label: str
    heads: tuple[Cell, ...]
    rows: tuple[tuple[Cell, ...] | Group, ...]  # the first cell is the row's head
    heading: bool = True  # whether the label is written; else only screen readers say it


@dataclass(frozen=True, slots=True)
class Facts:
    """Terms, and what is said of each."""

    kind: ClassVar[str] = "facts"
    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Plot:
    """A figure."""

    kind: ClassVar[str] = "plot"
    name: str  # of its files, before it is made fit for one
    label: str  # stands above
    figure: Figure
    words: str = ""  # what it shows, below; also for those who do not see it


@dataclass(frozen=True, slots=True)
class Fold:
    """Blocks under a line that unfolds them."""

    kind: ClassVar[str] = "fold"
    summary: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Callout:
    """Blocks that stand out of the page."""

    kind: ClassVar[str] = "callout"
    mark: Mark
    blocks: tuple[Block, ...]


Block = Paragraph | Table | Facts | Plot | Fold | Callout


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page that the contents list names."""

    key: str  # its element's id
    title: str
    blocks: tuple[Block, ...]  # none: the section is left out


def paragraph(*parts: str | Span) -> Paragraph:
    """Sentences of plain and other parts.

    Parameters
    ----------
    *parts : str or Span

    Returns
    -------
    Paragraph
    """
    return Paragraph(tuple(part if isinstance(part, Span) else Span(part) for part in parts))


def table(
    label: str,
    heads: Iterable[str | Cell],
    rows: Iterable[Row | Group],
    *,
    heading: bool = True,
) -> Iterator[Table]:
    """A table; none where there are no rows.

    Parameters
    ----------
    label : str
    heads : iterable of str or Cell
    rows : iterable of sequences of str or Cell, or Group
        The first cell of a row is its head.
    heading : bool
        Whether the label is written above the table; else only screen readers say it.

    Yields
    ------
    Table
    """
    found = tuple(row if isinstance(row, Group) else _cells(row) for row in rows)
    if found:
        yield Table(label, _cells(heads), found, heading)


def number(text: str) -> Cell:
    """A cell of a column of numbers."""
    return Cell(text, "number")


def prose(text: str) -> Cell:
    """A cell of sentences, which may take several lines."""
    return Cell(text, "text")


def plots_of(blocks: Iterable[Block]) -> Iterator[Plot]:
    """The figures among blocks, also those in others, in their order.

    Parameters
    ----------
    blocks : iterable of Block

    Yields
    ------
    Plot
    """
    for block in blocks:
        if isinstance(block, Plot):
            yield block
        elif isinstance(block, Fold | Callout):
            yield from plots_of(block.blocks)


def keyed(sections: Iterable[Section]) -> dict[str, Plot]:
    """Every figure by a name fit for a file and an element, one name for each.

    Parameters
    ----------
    sections : iterable of Section

    Returns
    -------
    dict
        Small letters, digits and dashes, to a figure.
    """
    found: dict[str, Plot] = {}
    for section in sections:
        for plot in plots_of(section.blocks):
            found[_free(slug(plot.name), found)] = plot
    return found


def slug(text: str) -> str:
    """A name fit for a file and an element.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
        Small letters and digits, joined by dashes; "figure" where there are none.
    """
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "figure"


def _cells(row: Iterable[str | Cell]) -> tuple[Cell, ...]:
    return tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in row)


def _free(key: str, taken: Iterable[str]) -> str:
    """The key, numbered where another figure has it."""
    candidate, k = key, 2
    while candidate in taken:
        candidate, k = f"{key}-{k}", k + 1
    return candidate
