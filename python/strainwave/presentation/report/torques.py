"""Interaction torque of the other links compared with the motor torque: over time, and spectra."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Decoupled, FloatArray, Identification
from strainwave.numerics.spectra import cross_spectral_densities
from strainwave.presentation.figures import (
    FREQUENCY_AXIS,
    SHORT_DASH,
    SOLID,
    Axis,
    Colour,
    Figure,
    Line,
    Panel,
    decimate,
)

_NAMES = ("motor torque", "interaction torque at the motor")
_COLOURS = (Colour.MEASURED, Colour.MODEL)
_DASHES = (SOLID, SHORT_DASH)
_WELCH_SEGMENTS = 8  # of a record
_SHOWN_DURATION = 0.5  # [s] single oscillations stay visible
_BAND_MARGIN = 5.0  # highest frequency drawn over the band in which the motor moves


def interaction_records(identification: Identification) -> list[Decoupled]:
    """For each joint the full-amplitude record with the largest share of interaction torque."""
    largest: dict[int, Decoupled] = {}
    for record in identification.records:
        signals = record.signals
        if signals.inputs.shape[1] < 2 or signals.experiment.use != "frequency":
            continue
        other = largest.get(signals.joint)
        if other is None or interaction_share(signals) > interaction_share(other):
            largest[signals.joint] = signals
    return [largest[joint] for joint in sorted(largest)]


def interaction_share(record: Decoupled) -> float:
    """Standard deviation of the interaction torque over that of the motor torque."""
    motor, interaction = np.std(_at_motor(record), axis=0)
    return float(interaction / motor) if motor > 0.0 else 0.0


def time_figure(record: Decoupled) -> Figure:
    """The beginning of both torques."""
    is_shown = record.time <= record.time[0] + _SHOWN_DURATION
    torques = _at_motor(record)[is_shown]
    rows = decimate(torques)
    panel = Panel(Axis("torque [N m]"), _lines(record.time[is_shown][rows], torques[rows]))
    return Figure(Axis("time [s]"), (panel,))


def spectrum_figure(record: Decoupled) -> Figure:
    """Amplitude spectral densities of both torques."""
    torques = _at_motor(record)
    segment = min(len(torques), max(16, 2 * len(torques) // (_WELCH_SEGMENTS + 1)))
    frequency, density = cross_spectral_densities(torques, record.sample_time, segment)
    power = np.einsum("fii->fi", density).real
    end = _BAND_MARGIN * float(record.richness_hz.max(initial=0.0)) or np.inf
    is_shown = (frequency > 0.0) & (frequency <= end)
    lines = _lines(frequency[is_shown], np.sqrt(power[is_shown]))
    panel = Panel(Axis("torque [N m/sqrt(Hz)]", log=True), lines)
    return Figure(FREQUENCY_AXIS, (panel,))


def describe(record: Decoupled) -> str:
    """Caption of the figures."""
    return (
        f"Interaction torque of the other links and gravity on joint {record.joint} in"
        f" {record.experiment.name}: {100.0 * interaction_share(record):.2g} % of the motor torque"
        " (rms without mean, at the motor)."
    )


def _at_motor(record: Decoupled) -> FloatArray:
    """Motor torque, and interaction torque through the gear: (n_samples, 2) [N m]."""
    return np.asarray(record.inputs * np.array([1.0, record.gear_ratio]))


def _lines(x: FloatArray, torques: FloatArray) -> tuple[Line, ...]:
    styles = enumerate(zip(_NAMES, _COLOURS, _DASHES, strict=True))
    return tuple(Line(x, torques[:, k], name, colour, dash) for k, (name, colour, dash) in styles)
