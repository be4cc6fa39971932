"""What lets a record display itself: a table in a notebook, a picture on request.

Notebooks ask the object itself, so the methods stand at the bottom, with the records. What they
display is made at the top, which registers itself here by a function that loads it; nothing is
loaded before a person looks. The module lies below the records, not among them: the package
registers at import, and importing records imports NumPy.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Display(Protocol):
    """What makes tables and pictures of records."""

    def table_of(self, record: object) -> str:
        """A record as a small HTML table, its texts escaped."""

    def picture_of(self, record: object, **which: Any) -> Figure:
        """A record, or the part of it that is asked for, as a Matplotlib figure."""


_loaders: list[Callable[[], Display]] = []


def register(load: Callable[[], Display]) -> None:
    """Say what displays records, in place of what did before.

    Parameters
    ----------
    load : callable
        Returns it; called when a record is looked at, and not before.
    """
    _loaders[:] = [load]


class Displayed:
    """Mixin of records that have a table and a picture."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        """The record as a small HTML table."""
        return _registered().table_of(self)

    def plot(self, **which: Any) -> Figure:
        """The record as a picture.

        Parameters
        ----------
        **which
            What to draw of it, where there is a choice; see `strainwave.presentation.notebook`.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        InvalidInput
            Matplotlib is missing, or the record has no such part.
        """
        return _registered().picture_of(self, **which)


def _registered() -> Display:
    (load,) = _loaders
    return load()
