"""The columns of a log file, read on demand."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput, suggest_name

Clock = Literal["datetime", "date", "time"]
"""Type of a column of time stamps: seconds since 1970 UTC, or since midnight for "time"."""
MAX_MAGNITUDE = 1e60
"""Largest valid magnitude in any unit; sums of squares of smaller numbers do not overflow."""
MAX_UNPACKED_BYTES = 1 << 31
"""[bytes] Largest unpacked size of a compressed log: 20 channels for 3 h at 1 kHz."""
_MAX_NAMES = 20  # names in a message


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of a file by name, read on demand.

    `read` maps names to arrays (n_samples,), with NaN for a missing value; `row_name` maps the
    index of a sample, from 0, to its location for messages.
    """

    path: Path  # or name of a table in memory, for messages
    names: Sequence[str]
    read: Callable[[Sequence[str]], dict[str, FloatArray]]
    row_name: Callable[[int], str] = lambda row: f"row {row + 1}"
    units: Mapping[str, str] = field(default_factory=dict)  # from a row of units: name -> unit
    clocks: Mapping[str, Clock] = field(default_factory=dict)  # columns of time stamps
    omitted: Mapping[str, str] = field(default_factory=dict)  # unusable column -> its content
    assumptions: Sequence[str] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader assumed, and the columns that it leaves out."""
        by_content: dict[str, list[str]] = {}
        for name, content in self.omitted.items():
            by_content.setdefault(content, []).append(name)
        return (
            *self.assumptions,
            *(f"left out, because of {what}: {_list(names)}" for what, names in by_content.items()),
        )

    def missing_column_error(
        self, column: str, what: str, used: Collection[str] = ()
    ) -> InvalidInput:
        """The error for a missing column; `what` states its purpose, `used` are other channels'."""
        if column in self.omitted:
            return InvalidInput(
                f"the column '{column}', {what}, is not usable: {self.omitted[column]}",
                where=str(self.path),
                remedy="store one number per sample, or map another column in [channels]",
            )
        available = _list(self.names)
        available += suggest_name(column, [name for name in self.names if name not in used])
        return InvalidInput(
            f"there is no column '{column}', {what}",
            where=str(self.path),
            remedy=f"map it in [channels] of the study; the file has: {available}",
        )


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:_MAX_NAMES]) + (", ..." if len(names) > _MAX_NAMES else "")


def damaged(
    kind: str, error: Exception, path: Path, remedy: str = "write it again"
) -> InvalidInput:
    """The error for a file that its reader rejects."""
    cause = (str(error) or type(error).__name__).partition("\n")[0][:100]
    return InvalidInput(f"is not {kind}, or is damaged ({cause})", where=str(path), remedy=remedy)


def check_unpacked_size(size: float, path: Path) -> None:
    """Raise InvalidInput if a log of this unpacked size [bytes] exceeds the limit."""
    if size > MAX_UNPACKED_BYTES:
        raise InvalidInput(
            f"unpacks to more than {MAX_UNPACKED_BYTES >> 20} MiB, the limit of a log",
            where=str(path),
            remedy="split the log, or store fewer columns",
        )


def find_invalid_value(values: FloatArray) -> int | None:
    """Return the index of the first NaN, infinity or value of at least LARGEST, or None."""
    is_valid = np.abs(values) < MAX_MAGNITUDE
    return None if is_valid.all() else int(np.argmin(is_valid))
