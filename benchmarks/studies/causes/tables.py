"""Tables by cause, for a terminal and in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.families.causes import NO_CAUSE
from benchmarks.studies.causes.evaluation import (
    OUTCOMES,
    SELECTIONS,
    error_percent,
    is_accurate,
    matters,
    naming_outcome,
    selection_outcome,
)

_NOT_NAMED = "nothing"
_FITS = ("plain", "with_effect", "auto")


@dataclass(frozen=True, slots=True)
class TextTable:
    """A title, headings, and rows of as many cells."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def on_screen(self) -> Table:
        """For a terminal."""
        table = Table(box=None, title=self.title)
        for name in self.head:
            table.add_column(name, overflow="fold")
        for row in self.rows:
            table.add_row(*row)
        return table

    def markdown(self) -> str:
        """For a page."""
        lines = [self.head, ("---",) * len(self.head), *self.rows]
        text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        return f"**{self.title}.**\n\n{text}\n"


def tables(results: Sequence[dict[str, Any]]) -> list[TextTable]:
    """All tables of some runs."""
    with_cause = [result for result in results if result["cause"] != NO_CAUSE]
    clean = [result for result in results if result["cause"] == NO_CAUSE]
    text_tables = []
    if with_cause:
        text_tables += [_naming(with_cause), _accuracy(with_cause), _confusion(with_cause)]
    if clean:
        text_tables.append(_false_alarms(clean))
    if any("auto" in result for result in results):
        text_tables.append(_selection(results))
    return text_tables


def _by_cause(
    results: Sequence[dict[str, Any]],
) -> Iterable[tuple[str, list[dict[str, Any]]]]:
    for cause in dict.fromkeys(result["cause"] for result in results):
        yield cause, [result for result in results if result["cause"] == cause]
    if len({result["cause"] for result in results}) > 1:
        yield "all", list(results)


def _naming(results: Sequence[dict[str, Any]]) -> TextTable:
    """Outcomes of runs whose cause matters, and right and wrong names of the others."""
    rows = []
    for cause, runs in _by_cause(results):
        n_fitted = sum(bool(r["plain"]["parameters"] and r["plain"].get("fit")) for r in runs)
        outcomes = [naming_outcome(result) for result in runs if matters(result)]
        others = [naming_outcome(result) for result in runs if not matters(result)]
        counts = [str(outcomes.count(outcome)) for outcome in OUTCOMES]
        sizes = (str(len(runs)), str(n_fitted), str(len(outcomes)))
        other_counts = (str(others.count(outcome)) for outcome in ("effect and joint", "another"))
        rows.append((cause, *sizes, *counts, *other_counts))
    head = ("cause", "runs", "fitted", "matter", *OUTCOMES, "others: right", "others: another")
    return TextTable("Named effect where the cause matters", head, tuple(rows))


def _accuracy(results: Sequence[dict[str, Any]]) -> TextTable:
    """Accurate parameters, largest errors and processor time, without and with the effect."""
    rows = []
    for cause, runs in _by_cause(results):
        cells = [cause]
        for fit in _FITS:
            fits = [result[fit] for result in runs if fit in result]
            parameters = [row for result in fits for row in result["parameters"]]
            accurate = [is_accurate(row) for row in parameters]
            identified = [flag for flag in accurate if flag is not None]
            share = f"{100.0 * np.mean(identified):.1f}" if identified else ""
            missing = f"{len(accurate) - len(identified)}" if accurate else ""
            seconds = f"{np.median([result['seconds'] for result in fits]):.1f}" if fits else ""
            cells += [share, missing, _largest_error(parameters), seconds]
        rows.append(tuple(cells))
    head = ["cause"]
    for fit in ("ignored", "in the study", "auto"):
        head += [f"accurate %, {fit}", "missing", "largest error %", "s"]
    return TextTable("Primary parameters", tuple(head), tuple(rows))


def _largest_error(parameters: Sequence[list[Any]]) -> str:
    """The inaccurate parameter with the largest error [%]."""
    wrong = [
        (abs(error_percent(row) or 0.0), row) for row in parameters if is_accurate(row) is False
    ]
    if not wrong:
        return ""
    error, row = max(wrong, key=lambda pair: pair[0])
    return f"{error:.3g} {row[0]} {row[1] or ''}".strip()


def _confusion(results: Sequence[dict[str, Any]]) -> TextTable:
    """Number of runs by cause and named effect, whether the cause matters or not."""
    pairs = [(result["cause"], _named(result)) for result in results]
    columns = [*sorted({effect for _, effect in pairs} - {_NOT_NAMED}), _NOT_NAMED]
    rows = []
    for cause in dict.fromkeys(name for name, _ in pairs):
        counts = [pairs.count((cause, column)) for column in columns]
        rows.append((cause, *(str(count) if count else "" for count in counts)))
    return TextTable("Named effect by cause", ("cause", *columns), tuple(rows))


def _named(result: dict[str, Any]) -> str:
    named = result["plain"]["named"]
    if named is not None:
        return str(named[0])
    return ", ".join(result["plain"].get("suspected", ())) or _NOT_NAMED


def _selection(results: Sequence[dict[str, Any]]) -> TextTable:
    """Effects included by fits with "auto"."""
    rows = []
    for cause, runs in _by_cause([result for result in results if "auto" in result]):
        outcomes = [selection_outcome(result) for result in runs]
        counts = [str(outcomes.count(selection)) for selection in SELECTIONS]
        rows.append((cause, str(len(runs)), *counts))
    return TextTable('Effects included by "auto"', ("cause", "runs", *SELECTIONS), tuple(rows))


def _false_alarms(clean: Sequence[dict[str, Any]]) -> TextTable:
    """Named effects of arms without a cause."""
    named = [_named(result) for result in clean]
    rows = [(name, str(named.count(name))) for name in dict.fromkeys(sorted(named))]
    accurate = [is_accurate(row) for result in clean for row in result["plain"]["parameters"]]
    identified = [flag for flag in accurate if flag is not None]
    if identified:
        rows.append(("accurate %", f"{100.0 * np.mean(identified):.1f} of {len(identified)}"))
    return TextTable(f"{len(clean)} arms without a cause", ("named", "arms"), tuple(rows))
