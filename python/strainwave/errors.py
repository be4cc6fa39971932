"""The ways a run can end without an answer.

Each maps to one exit code of the command line; see `strainwave.cli`.
"""

from __future__ import annotations


class StrainwaveError(Exception):
    """Base of every error this package raises on purpose."""


class InvalidInput(StrainwaveError):  # noqa: N818 - the name says what is wrong, not that something is
    """The caller's input is at fault (exit code 2).

    Parameters
    ----------
    problem : str
        What is wrong, in one clause without a full stop.
    where : str, optional
        The file, and within it the row, column or key, as a person would look for it.
    remedy : str, optional
        What to do about it, in one clause without a full stop.
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
        remedy = f" Remedy: {self.remedy}." if self.remedy else ""
        return f"{place}{self.problem}.{remedy}"


class NotIdentifiable(StrainwaveError):  # noqa: N818
    """The data cannot answer the question (exit code 3).

    Parameters
    ----------
    reason : str
        Why, in one sentence without a full stop.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class NumericalFailure(StrainwaveError):  # noqa: N818
    """A computation left the finite numbers or did not converge where it must (exit code 3)."""


class Cancelled(StrainwaveError):  # noqa: N818
    """A run ended without an answer because its caller asked for the end."""

    def __init__(self) -> None:
        super().__init__("the run was cancelled; nothing was written")
