"""Predicted benefit of link sensors that the rig does not have."""

from __future__ import annotations

from collections.abc import Iterator

from strainwave.domain import Identification, SensorGain
from strainwave.domain.link_sensors import all_types

_MAX_INTERVAL_RATIO = 2.0 / 3.0  # a sensor is worth a word if it shrinks an interval by a third
_MIN_HALF_WIDTH_PERCENT = 0.05  # narrower intervals need no sensor
_MAX_PARAMETERS = 2  # named for each sensor


def gain_sentences(identification: Identification) -> list[str]:
    """One clause for each kind of sensor, on the link where it helps most.

    Each names at most two parameters, those whose intervals shrink most in percent of the value.
    The list is empty if every link has a sensor or no sensor would help.
    """
    return list(_sentences(identification))


def _sentences(identification: Identification) -> Iterator[str]:
    published = {
        (d.parameter.name, d.parameter.joint)
        for d in identification.decisions
        if d.identified and d.parameter.stage == "tuned"
    }
    groups: dict[str, dict[int, list[SensorGain]]] = {}
    for gain in identification.whole_arm.sensor_gains if identification.whole_arm else ():
        helps = gain.predicted_std < _MAX_INTERVAL_RATIO * gain.std
        helps = helps and gain.percent > _MIN_HALF_WIDTH_PERCENT
        if helps and gain.key in published:
            groups.setdefault(gain.sensor, {}).setdefault(gain.link, []).append(gain)
    nouns = {kind.name.replace("_", "-"): kind.suggested_as for kind in all_types()}
    for sensor, by_link in groups.items():
        best = max(by_link.values(), key=lambda gains: max(map(_improvement, gains)))
        first, *others = sorted(best, key=_improvement, reverse=True)[:_MAX_PARAMETERS]
        text = f"{nouns[sensor]} on link {first.link} ({first.assumed}) would shrink the 95 %"
        text += f" half-width of {first.label} {_change(first)}"
        for other in others:
            text += f", and of {other.label} {_change(other)}"
        yield text


def _improvement(gain: SensorGain) -> float:
    """Reduction of the half-width [% of the value]."""
    return gain.percent - gain.predicted_percent


def _change(gain: SensorGain) -> str:
    return f"from {gain.percent:.2g} to {gain.predicted_percent:.2g} %"
