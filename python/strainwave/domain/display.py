"""What lets a record show itself: a table in a notebook, a picture on request.

Notebooks ask the object itself, so the methods stand at the bottom, with the records; what they
show is made at the top, in `strainwave.presentation.notebook`, which is found by name when a
person looks.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_VIEWS = "strainwave.presentation.notebook"


class Shown:
    """Mixin of records that have a table and a picture."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        """The record as a small HTML table."""
        return str(import_module(_VIEWS).table_of(self))

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
        figure: Figure = import_module(_VIEWS).picture_of(self, **which)
        return figure
