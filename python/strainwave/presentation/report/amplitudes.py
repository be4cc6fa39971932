"""How a joint's response goes with the amplitude of its excitation: models of sweep records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Identification, RecordModel
from strainwave.presentation.figures import (
    DASHES,
    LINEAR,
    MEASURED,
    MODEL,
    RESIDUAL,
    Axis,
    Figure,
    Line,
    Panel,
    decibel,
)
from strainwave.statespace import frequency_response

WORDS = "State-space models of each record, within the band of their fit; see the resonances above."
"""What the figure shows, for those who do not see it."""

_POINTS = 200  # of one curve
_COLOURS = (MEASURED, LINEAR, MODEL, RESIDUAL)
_DASHES = DASHES[:3]  # of one turn of colours each
_NYQUIST = 0.98  # of half the sample rate, up to which a sampled model is drawn


def swept(identification: Identification) -> dict[int, list[RecordModel]]:
    """Records with a state-space model by joint, lowest amplitude first, where there is a sweep.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    dict
        Joint, from 1, to its records.
    """
    found: dict[int, list[RecordModel]] = {}
    for record in identification.records:
        if record.state_space is not None and record.signals.experiment.prbs is not None:
            found.setdefault(record.signals.joint, []).append(record)
    return {
        joint: sorted(records, key=_amplitude)
        for joint, records in found.items()
        if any(record.signals.experiment.use == "sweep" for record in records)
    }


def responses(records: Sequence[RecordModel]) -> Figure:
    """Motor torque to motor velocity by the models of several amplitudes: magnitude and phase.

    Parameters
    ----------
    records : sequence of RecordModel
        From `swept`.

    Returns
    -------
    Figure
    """
    magnitude, phase = [], []
    for k, record in enumerate(records):
        model, joint = record.state_space, record.joint_model
        if model is None or joint is None:
            continue
        top = min(joint.band_hz[1], _NYQUIST * 0.5 / model.sample_time)
        f: FloatArray = np.geomspace(joint.band_hz[0], top, _POINTS)
        G = frequency_response(replace(model, covariance=None), f).response[:, 0, 0]
        name = f"{_amplitude(record):g} V, {record.signals.experiment.name}"
        turn, place_in_turn = divmod(k, len(_COLOURS))
        colour, dash = _COLOURS[place_in_turn], _DASHES[turn % len(_DASHES)]
        magnitude.append(Line(f, decibel(np.abs(G)), name, colour, dash))
        phase.append(Line(f, np.rad2deg(np.angle(G)), name, colour, dash))
    panels = (
        Panel(Axis("magnitude [dB]"), tuple(magnitude)),
        Panel(Axis("phase [°]", step=90.0), tuple(phase)),
    )
    return Figure(Axis("frequency [Hz]", log=True), panels)


def _amplitude(record: RecordModel) -> float:
    prbs = record.signals.experiment.prbs
    return prbs.amplitude if prbs is not None else 0.0
