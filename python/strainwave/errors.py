"""Errors that end a run, one class per exit code, and the helpers that word them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import Any, TypeVar

T = TypeVar("T")


class StrainwaveError(Exception):
    """Base class of the errors that this package raises."""


class InvalidInput(StrainwaveError):  # noqa: N818 - named after the condition
    """The input is invalid (exit code 2).

    `problem` and `remedy` are clauses without a full stop. `where` names the file and, within it,
    the row, column or key.
    """

    def __init__(
        self, problem: str, *, where: str | None = None, remedy: str | None = None
    ) -> None:
        self.problem = problem
        self.where = where
        self.remedy = remedy
        super().__init__(str(self))

    def __str__(self) -> str:
        place = f"{self.where}: " if self.where else ""
        stop = "" if self.remedy and self.remedy.endswith(("?", ".")) else "."
        remedy = f" Remedy: {self.remedy}{stop}" if self.remedy else ""
        return f"{place}{self.problem}.{remedy}"

    def __reduce__(self) -> tuple[Any, ...]:
        state = {"problem": self.problem, "where": self.where, "remedy": self.remedy}
        return type(self), (self.problem,), state


class RecordTooShort(InvalidInput):
    """A record is shorter than the transients of a filter at its ends."""


class NotIdentifiable(StrainwaveError):  # noqa: N818
    """The data do not determine the model (exit code 3); `reason` is a clause without a stop."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class NumericalFailure(StrainwaveError):  # noqa: N818
    """A computation gives values that are not finite, or does not converge (exit code 3)."""


class Cancelled(StrainwaveError):  # noqa: N818
    """The caller cancelled the run."""

    def __init__(self) -> None:
        super().__init__("the run was cancelled; nothing was written")


def suggest_name(name: str, known: Iterable[str]) -> str:
    """Suggest the known name closest to a misspelled name: `; did you mean '...'?`, or ""."""
    spellings = {spelling.casefold(): spelling for spelling in known}
    matches = difflib.get_close_matches(name.casefold(), list(spellings), n=1, cutoff=0.6)
    return f"; did you mean '{spellings[matches[0]]}'?" if matches else ""


def entry_of(entries: Mapping[str, T], name: str, kind: str, where: str) -> T:
    """The entry with a name. Raises InvalidInput, which names the key `where`, if there is none."""
    if name not in entries:
        raise InvalidInput(
            f"there is no {kind} {name!r}", where=where, remedy=f"use one of {', '.join(entries)}"
        )
    return entries[name]


def import_optional(module: str, purpose: str, requirement: str, where: str | None = None) -> Any:
    """Import an optional package; raise `InvalidInput` with the pip command if it is missing."""
    try:
        return import_module(module)
    except ImportError as error:
        raise InvalidInput(
            f"{purpose} needs {module.partition('.')[0]}, which is not installed",
            where=where,
            remedy=f"pip install {requirement}",
        ) from error
