"""Combination of channel delays into one delay per link sensor, and their warnings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from strainwave.domain import Delay, Diagnostic, LinkSignals, Place
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors import ConstantKind, LinkSensor
from strainwave.domain.link_sensors.accelerometer import Accelerometer
from strainwave.domain.link_sensors.gyro import Gyro
from strainwave.domain.link_sensors.link_encoder import LinkEncoder
from strainwave.domain.signals import LinkSource

_SENSORS: Mapping[LinkSource, type[LinkSensor]] = {
    "accelerometer": Accelerometer,
    "encoder": LinkEncoder,
    "gyro": Gyro,
}
_MIN_SIGNIFICANCE = 4.0  # standard deviations above which a delay is significant


def estimate_sensor_delays(records: Sequence[LinkSignals], n_joints: int) -> tuple[Delay, ...]:
    """Estimate the delay of each link sensor from all records; zero if it is not significant.

    The estimate is the weighted mean over the records. The errors of the regression model are
    common to all records, so the standard deviation of the mean is at least the smallest one of the
    records; it is larger if the records scatter more. Returns one delay per joint.
    """
    combined = []
    for i in range(n_joints):
        estimates = [d for record in records if (d := record.sensor_delay[i]) is not None]
        combined.append(_combine_delays(estimates))
    return tuple(combined)


def _combine_delays(delays: Sequence[Delay]) -> Delay:
    """Weighted mean of the delays of one sensor; its value is zero if it is not significant."""
    if not delays:
        return Delay(0.0, 0.0)
    value, std = (np.array(x) for x in zip(*((d.value, d.std) for d in delays), strict=True))
    weight = std**-2.0 / np.sum(std**-2.0)
    mean = float(weight @ value)
    scatter = float(np.sqrt(weight @ (value - mean) ** 2 / len(value)))
    combined_std = max(float(np.min(std)), scatter)
    is_significant = abs(mean) > _MIN_SIGNIFICANCE * combined_std
    return Delay(mean if is_significant else 0.0, combined_std)


def build_misalignment_warnings(
    delay: Delay | None, channel: str, place: Place
) -> Iterator[Diagnostic]:
    """Yield a warning if a channel is significantly delayed relative to the motor encoder."""
    if delay is None or abs(delay.value) < _MIN_SIGNIFICANCE * delay.std:
        return
    yield Diagnostic(
        "misaligned",
        place,
        channel=channel,
        delay=abs(delay.value),
        std=delay.std,
        side=_side(delay),
    )


def _side(delay: Delay) -> str:
    return "behind" if delay.value > 0.0 else "ahead of"


def list_removed_delays(
    records: Sequence[LinkSignals], delays: Sequence[Delay]
) -> dict[Key, float]:
    """Delays that were removed, keyed as in the whole-arm fit: (name, joint) -> delay [s]."""
    return {
        delay_constant.key(joint): delay.value
        for record in records
        for joint, (source, delay) in enumerate(zip(record.sources, delays, strict=True), start=1)
        if delay.value and source in _SENSORS
        if (delay_constant := _SENSORS[source].constant(ConstantKind.DELAY))
    }


def build_delay_warnings(delays: Sequence[Delay]) -> Iterator[Diagnostic]:
    """Yield a warning for each link sensor whose delay was removed; `delays` has one per joint."""
    for joint, delay in enumerate(delays, start=1):
        if not delay.value:
            continue
        half, size, side = CI95_STDS * delay.std, abs(delay.value), _side(delay)
        yield Diagnostic("sensor-delay", Place(joint=joint), delay=size, half=half, side=side)
