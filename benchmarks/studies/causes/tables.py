"""What was found, counted cause by cause: as tables on a screen and in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.studies.causes.judged import (
    SELECTIONS,
    VERDICTS,
    error_percent,
    is_sound,
    matters,
    taken_up,
    verdict_on,
)
from strainwave.virtual.families.causes import NOTHING

_UNNAMED = "nothing"
_FITS = ("plain", "with_it", "auto")


@dataclass(frozen=True, slots=True)
class Counted:
    """A table: a title, headings, and rows of as many cells."""

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


def tables(found: Sequence[dict[str, Any]]) -> list[Counted]:
    """All there are of some runs."""
    ailing = [one for one in found if one["cause"] != NOTHING]
    clean = [one for one in found if one["cause"] == NOTHING]
    made = []
    if ailing:
        made += [_named(ailing), _mended(ailing), _confused(ailing)]
    if clean:
        made.append(_alarms(clean))
    if any("auto" in one for one in found):
        made.append(_selected(found))
    return made


def _by_cause(found: Sequence[dict[str, Any]]) -> Iterable[tuple[str, list[dict[str, Any]]]]:
    for cause in dict.fromkeys(one["cause"] for one in found):
        yield cause, [one for one in found if one["cause"] == cause]
    if len({one["cause"] for one in found}) > 1:
        yield "all", list(found)


def _named(found: Sequence[dict[str, Any]]) -> Counted:
    """Of the runs whose cause matters, what is named; and of the others, what is named wrongly."""
    rows = []
    for cause, runs in _by_cause(found):
        fitted = [one for one in runs if one["plain"]["parameters"] and one["plain"].get("fit")]
        mattering = [one for one in runs if matters(one)]
        said = [verdict_on(one) for one in mattering]
        others = [verdict_on(one) for one in runs if not matters(one)]
        counts = [str(said.count(verdict)) for verdict in VERDICTS]
        sizes = (str(len(each)) for each in (runs, fitted, mattering))
        rest = (str(others.count(verdict)) for verdict in ("effect and joint", "another"))
        rows.append((cause, *sizes, *counts, *rest))
    head = ("cause", "runs", "fitted", "matter", *VERDICTS, "else: right", "else: another")
    return Counted("What is named where it matters", head, tuple(rows))


def _mended(found: Sequence[dict[str, Any]]) -> Counted:
    """Sound parameters, largest errors and seconds of a core, without and with the cause."""
    rows = []
    for cause, runs in _by_cause(found):
        cells = [cause]
        for fit in _FITS:
            tried = [one[fit] for one in runs if fit in one]
            parameters = [row for one in tried for row in one["parameters"]]
            sound = [is_sound(row) for row in parameters]
            given = [each for each in sound if each is not None]
            share = f"{100.0 * np.mean(given):.1f}" if given else ""
            missing = f"{len(sound) - len(given)}" if sound else ""
            seconds = f"{np.median([one['seconds'] for one in tried]):.1f}" if tried else ""
            cells += [share, missing, _largest(parameters), seconds]
        rows.append(tuple(cells))
    head = ["cause"]
    for fit in ("ignored", "named", "auto"):
        head += [f"sound %, {fit}", "missing", "largest wrong %", "s"]
    return Counted("Primary parameters", tuple(head), tuple(rows))


def _largest(parameters: Sequence[list[Any]]) -> str:
    """Error of the parameter that is furthest off among those that are not sound."""
    wrong = [(abs(error_percent(row) or 0.0), row) for row in parameters if is_sound(row) is False]
    if not wrong:
        return ""
    error, row = max(wrong, key=lambda each: each[0])
    return f"{error:.3g} {row[0]} {row[1] or ''}".strip()


def _confused(found: Sequence[dict[str, Any]]) -> Counted:
    """How often each cause is taken for which, whether it matters or not."""
    taken = [(one["cause"], _taken_for(one)) for one in found]
    columns = [*sorted({effect for _, effect in taken} - {_UNNAMED}), _UNNAMED]
    rows = []
    for cause in dict.fromkeys(name for name, _ in taken):
        counts = [taken.count((cause, column)) for column in columns]
        rows.append((cause, *(str(count) if count else "" for count in counts)))
    return Counted("What each cause is taken for", ("cause", *columns), tuple(rows))


def _taken_for(one: dict[str, Any]) -> str:
    named = one["plain"]["named"]
    if named is not None:
        return str(named[0])
    return ", ".join(one["plain"].get("suspected", ())) or _UNNAMED


def _selected(found: Sequence[dict[str, Any]]) -> Counted:
    """What fits that select effects take up."""
    rows = []
    for cause, runs in _by_cause([one for one in found if "auto" in one]):
        chosen = [taken_up(one) for one in runs]
        counts = [str(chosen.count(selection)) for selection in SELECTIONS]
        rows.append((cause, str(len(runs)), *counts))
    return Counted("What a fit takes up by itself", ("cause", "runs", *SELECTIONS), tuple(rows))


def _alarms(clean: Sequence[dict[str, Any]]) -> Counted:
    """What is named on arms that have no cause."""
    named = [_taken_for(one) for one in clean]
    rows = [(name, str(named.count(name))) for name in dict.fromkeys(sorted(named))]
    sound = [is_sound(row) for one in clean for row in one["plain"]["parameters"]]
    given = [each for each in sound if each is not None]
    if given:
        rows.append(("sound %", f"{100.0 * np.mean(given):.1f} of {len(given)}"))
    return Counted(f"{len(clean)} arms without a cause", ("named", "arms"), tuple(rows))
