"""What a link sensor that is not there would buy, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

from strainwave.domain import Identification, LinkSensor, SensorGain

_WORTH = 2.0 / 3.0  # of an interval that a sensor leaves
_NARROW = 0.05  # [%] half-width of an interval that nobody needs narrower
_NAMED = 2  # parameters in a sentence
_CALLED: dict[LinkSensor, str] = {
    "accelerometer": "an accelerometer",
    "link-encoder": "an encoder",
    "gyro": "a gyro",
}


def gain_sentences(found: Identification) -> list[str]:
    """One sentence for each kind of link sensor, on the link where it would buy most.

    Named are at most two parameters, those whose intervals would shrink by most points of
    per cent, and by a third at least.

    Parameters
    ----------
    found : Identification

    Returns
    -------
    list of str
        Empty where every link has a sensor, or none would buy anything.
    """
    return list(_sentences(found))


def _sentences(found: Identification) -> Iterator[str]:
    published = {
        (d.parameter.name, d.parameter.joint)
        for d in found.decisions
        if d.identified and d.parameter.stage == "tuned"
    }
    groups: dict[LinkSensor, dict[int, list[SensorGain]]] = {}
    for gain in found.tuned.sensor_gains if found.tuned else ():
        worth = gain.predicted_std < _WORTH * gain.std and gain.percent > _NARROW
        if worth and (gain.name, gain.joint) in published:
            groups.setdefault(gain.sensor, {}).setdefault(gain.link, []).append(gain)
    for sensor, by_link in groups.items():
        best = max(by_link.values(), key=lambda gains: max(map(_points, gains)))
        first, *others = sorted(best, key=_points, reverse=True)[:_NAMED]
        text = f"with {_CALLED[sensor]} on link {first.link} ({first.assumed}) the interval of "
        text += f"{first.label} would shrink {_shrinks(first)}"
        for other in others:
            text += f", that of {other.label} {_shrinks(other)}"
        yield text


def _points(gain: SensorGain) -> float:
    """[%] of the value."""
    return gain.percent - gain.predicted_percent


def _shrinks(gain: SensorGain) -> str:
    return f"from {gain.percent:.2g} to {gain.predicted_percent:.2g} %"
