"""Interaction torques beside the motor's own: over time, and their spectra."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Decoupled, FloatArray, Identification
from strainwave.numerics.spectra import cross_spectral_densities
from strainwave.presentation.figures import (
    BRIEF,
    MEASURED,
    MODEL,
    SOLID,
    Axis,
    Figure,
    Line,
    Panel,
    thinned,
)

_NAMES = ("motor torque", "interaction torque, at the motor")
_COLOURS = (MEASURED, MODEL)
_DASHES = (SOLID, BRIEF)
_SEGMENTS = 8  # Welch segments in a record
_LONGEST = 0.5  # [s] shown over time: more would be a smear
_ROOM = 5.0  # times the band in which the motor moves, up to which spectra are drawn


def interacting(identification: Identification) -> list[Decoupled]:
    """Of each joint on which others act, the full-amplitude record in which they do so most.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    list of Decoupled
    """
    loudest: dict[int, Decoupled] = {}
    for record in identification.records:
        own = record.signals
        if own.inputs.shape[1] < 2 or own.experiment.use != "frequency":
            continue
        rival = loudest.get(own.joint)
        if rival is None or share(own) > share(rival):
            loudest[own.joint] = own
    return [loudest[joint] for joint in sorted(loudest)]


def share(record: Decoupled) -> float:
    """Size of the interaction torque, seen from the motor, over that of the motor's torque."""
    motor, other = np.std(_at_motor(record), axis=0)
    return float(other / motor) if motor > 0.0 else 0.0


def over_time(record: Decoupled) -> Figure:
    """The first seconds of both torques.

    Parameters
    ----------
    record : Decoupled

    Returns
    -------
    Figure
    """
    shown = record.time <= record.time[0] + _LONGEST
    torques = _at_motor(record)[shown]
    pick = thinned(torques)
    panel = Panel(Axis("torque [N m]"), _lines(record.time[shown][pick], torques[pick]))
    return Figure(Axis("time [s]"), (panel,))


def over_frequency(record: Decoupled) -> Figure:
    """Amplitude spectral densities of both torques.

    Parameters
    ----------
    record : Decoupled

    Returns
    -------
    Figure
    """
    torques = _at_motor(record)
    segment = min(len(torques), max(16, 2 * len(torques) // (_SEGMENTS + 1)))
    frequency, density = cross_spectral_densities(torques, record.sample_time, segment)
    power = np.einsum("fii->fi", density).real
    end = _ROOM * float(record.richness_hz.max(initial=0.0)) or np.inf
    shown = (frequency > 0.0) & (frequency <= end)
    panel = Panel(Axis("N m/sqrt(Hz)", log=True), _lines(frequency[shown], np.sqrt(power[shown])))
    return Figure(Axis("frequency [Hz]", log=True), (panel,))


def words(record: Decoupled) -> str:
    """What the figures show, for those who do not see them.

    Parameters
    ----------
    record : Decoupled

    Returns
    -------
    str
    """
    return (
        f"What the other links and gravity do to joint {record.joint} in {record.experiment.name},"
        f" seen from the motor: {100.0 * share(record):.2g} % of the motor's torque (rms, without"
        " its mean)."
    )


def _at_motor(record: Decoupled) -> FloatArray:
    """Both inputs, the link's through the gear: (n_samples, 2) [N m]."""
    return np.asarray(record.inputs * np.array([1.0, record.gear_ratio]))


def _lines(x: FloatArray, torques: FloatArray) -> tuple[Line, ...]:
    looks = enumerate(zip(_NAMES, _COLOURS, _DASHES, strict=True))
    return tuple(Line(x, torques[:, k], name, colour, dash) for k, (name, colour, dash) in looks)
