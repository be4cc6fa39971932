"""Singular values from which the order and the horizon of the state-space models are chosen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from strainwave import pipeline
from strainwave.domain import RecordModel
from strainwave.errors import NotIdentifiable
from strainwave.presentation.figures import DOTTED, Axis, Colour, Figure, Line, Panel, Upright
from strainwave.presentation.plotly_backend import plotly
from strainwave.workbench.signal_views import study_at

_MAX_SHOWN = 24  # singular values; those of the noise follow


def order_figures(path: Path) -> list[dict[str, Any]]:
    """Singular values of the subspace step of each record, with the order and horizon selected.

    Takes as long as the stages rigid and decoupled. Raises NotIdentifiable if no record excites a
    joint with link motion as second output.
    """
    study = study_at(path)
    options = replace(study.options.statespace, method="subspace")
    study = replace(study, options=replace(study.options, statespace=options))
    result = pipeline.identify(study, stages=("rigid", "decoupled"))
    shown = [_entry(record) for record in result.records if record.state_space is not None]
    if not shown:
        raise NotIdentifiable("no record excites a joint such that a state-space model exists")
    return shown


def _entry(record: RecordModel) -> dict[str, Any]:
    model = record.state_space
    assert model is not None
    values = np.asarray(model.singular_values, dtype=float)[:_MAX_SHOWN]
    index = np.arange(1.0, len(values) + 1.0)
    line = Line(index, values / values[0], "singular values", Colour.MEASURED, size=7.0)
    order = Upright(model.order + 0.5, f"order {model.order}", dash=DOTTED)
    axis = Axis("singular value / largest", log=True)
    figure = Figure(Axis("number", step=1.0), (Panel(axis, (line,)),), uprights=(order,))
    return {
        "experiment": record.signals.experiment.name,
        "joint": record.signals.joint,
        "order": model.order,
        "horizon": model.horizon,
        "figure": plotly(figure),
    }
