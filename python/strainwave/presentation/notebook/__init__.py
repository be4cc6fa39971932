"""How records show themselves: a small HTML table each, and a picture.

The pictures are the report's own figures, drawn by `strainwave.presentation.matplotlib_backend`.
`Log._repr_html_()`, `RigidModel.plot()` and their like end here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from strainwave.presentation.matplotlib_backend import draw
from strainwave.presentation.notebook.pictures import certainty, figure_of
from strainwave.presentation.notebook.tables import html_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["certainty", "picture_of", "table_of"]


def table_of(record: object) -> str:
    """A record as a small HTML table.

    Parameters
    ----------
    record : record of `strainwave.domain`

    Returns
    -------
    str
        HTML, its texts escaped.
    """
    return html_of(record)


def picture_of(record: object, **which: Any) -> Figure:
    """A record as a Matplotlib figure.

    Parameters
    ----------
    record : record of `strainwave.domain`
    **which
        Of a `Prediction` its `channel`, without it the one that fits worst; of a
        `FrequencyResponse` its `output` and `input`, from 0, and the `band_hz` to show; of a
        `JointModel` its `gear_ratio`, which it does not know, and the `measured` response to draw
        beside it.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InvalidInput
        Matplotlib is missing, or the record has no such part.
    """
    return draw(figure_of(record, **which))
