"""HTML tables and figures of records in notebooks.

`Log._repr_html_()`, `RigidModel.plot()` and similar methods call this package. The figures are
those of the report, drawn by Matplotlib.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from strainwave.presentation.matplotlib_backend import draw
from strainwave.presentation.notebook.pictures import certainty, figure_of
from strainwave.presentation.notebook.tables import table_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["certainty", "picture_of", "table_of"]


def picture_of(record: object, **which: Any) -> Figure:
    """A record of `strainwave.domain` as a Matplotlib figure.

    Options: of a `Prediction` its `channel` (default: the one with the lowest fit); of a
    `FrequencyResponse` its `output` and `input`, from 0, and `band_hz`; of a `JointModel` its
    `gear_ratio`, and the `measured` response to compare. Raises InvalidInput if Matplotlib is
    missing or the record has no such part.
    """
    return draw(figure_of(record, **which))
