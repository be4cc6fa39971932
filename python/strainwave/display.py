"""Tables and figures of records in notebooks.

A notebook calls methods of the record itself, and the records are the lowest layer. The functions
that make tables and figures belong to the highest layer, `strainwave.report`, which the
package registers here as a loader. Nothing is imported until a record is displayed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Display(Protocol):
    """Makes tables and figures of records."""

    def table_of(self, record: object) -> str:
        """A record as an HTML table with escaped text."""

    def picture_of(self, record: object, **which: Any) -> Figure:
        """A record, or the selected part of it, as a Matplotlib figure."""


_loaders: list[Callable[[], Display]] = []


def register(load: Callable[[], Display]) -> None:
    """Set the function that imports the display; it is called when a record is displayed."""
    _loaders[:] = [load]


class Displayed:
    """Mixin for records that have a table and a figure."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return _display().table_of(self)

    def plot(self, **which: Any) -> Figure:
        """Plot the record.

        `which` selects a part of the record; see `strainwave.report.notebook`. Raises
        `InvalidInput` if Matplotlib is missing or the record has no such part.
        """
        return _display().picture_of(self, **which)


def _display() -> Display:
    (load,) = _loaders
    return load()
