"""What is made of the channels' delays: one for each link sensor, and what to say of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Delay, Diagnostic, LinkSignals

_CERTAIN = 4.0  # deviations of a delay that are not by chance


def late_sensors(records: Sequence[LinkSignals], n_joints: int) -> tuple[Delay, ...]:
    """How late each link's sensor surely is, all records together; zero where none is sure.

    A weighted mean. What is wrong with each record's relation is alike in all of them, so that the
    mean is no better known than the best of them; where they scatter by more, that counts.

    Parameters
    ----------
    records : sequence of LinkSignals
    n_joints : int

    Returns
    -------
    tuple of Delay
        One per joint.
    """
    found = []
    for i in range(n_joints):
        own = [d for record in records if (d := record.sensor_delay[i]) is not None]
        found.append(_together(own))
    return tuple(found)


def _together(delays: Sequence[Delay]) -> Delay:
    if not delays:
        return Delay(0.0, 0.0)
    value, std = (np.array(x) for x in zip(*((d.value, d.std) for d in delays), strict=True))
    weight = std**-2.0 / np.sum(std**-2.0)
    mean = float(weight @ value)
    scatter = float(np.sqrt(weight @ (value - mean) ** 2 / len(value)))
    deviation = max(float(np.min(std)), scatter)
    sure = abs(mean) > _CERTAIN * deviation
    return Delay(mean if sure else 0.0, deviation)


def misaligned(delay: Delay | None, what: str, where: str) -> Iterator[Diagnostic]:
    """That a channel lies beside the encoder, and surely so.

    Parameters
    ----------
    delay : Delay or None
    what : str
        Of the channel.
    where : str
        The record.

    Yields
    ------
    Diagnostic
    """
    if delay is None or abs(delay.value) < _CERTAIN * delay.std:
        return
    side = "behind" if delay.value > 0.0 else "ahead of"
    text = f"{what} is {1e3 * abs(delay.value):.3g} +- {1e3 * delay.std:.2g} ms {side} the motor"
    text += (
        " encoder, and was not shifted. Check the time stamps of the logger, and the bandwidths in"
    )
    text += " the study (accelerometer_hz, gyro_hz, current_loop_hz)"
    yield Diagnostic("misaligned", where, text)


def constants_of(
    records: Sequence[LinkSignals], delays: Sequence[Delay]
) -> dict[tuple[str, int | None], float]:
    """The delays that were taken off, as the whole-arm fit names them: (name, joint) -> [s].

    Parameters
    ----------
    records : sequence of LinkSignals
    delays : sequence of Delay
        One per joint.

    Returns
    -------
    dict
    """
    names = {"accelerometer": "accelerometer_delay", "encoder": "link_encoder_delay"}
    names["gyro"] = "gyro_delay"
    return {
        (names[source], joint): delay.value
        for record in records
        for joint, (source, delay) in enumerate(zip(record.sources, delays, strict=True), start=1)
        if delay.value and source in names
    }


def corrected(delays: Sequence[Delay]) -> Iterator[Diagnostic]:
    """That link sensors are late, and that their delays were taken off.

    Parameters
    ----------
    delays : sequence of Delay
        One per joint, as taken off.

    Yields
    ------
    Diagnostic
    """
    for joint, delay in enumerate(delays, start=1):
        if not delay.value:
            continue
        side = "behind" if delay.value > 0.0 else "ahead of"
        text = (
            f"the link sensor is {1e3 * abs(delay.value):.3g} ± {1.96e3 * delay.std:.2g} ms {side}"
        )
        text += (
            " the motor encoder; its channel was shifted by that. Likely causes: its bandwidth is"
        )
        text += " missing from the study, latency of its converter or bus, time stamps"
        yield Diagnostic("sensor-delay", f"joint {joint}", text)
