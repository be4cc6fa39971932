"""Each kind of fault changes only the stated channel or key."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from benchmarks.families.drawing import FAULTS, LinkSensors, Sensors, VirtualArm

from benchmarks.families import Family, Recorded, draw, record
from strainwave.domain import FloatArray

BASE = Family(arms=1, sizes=(14,), sample_times=(1e-3,), springs=("linear",))
Pair = tuple[FloatArray, FloatArray]  # without and with the fault


def both(kind: str) -> tuple[VirtualArm, Recorded, Recorded]:
    clean, faulty = draw(BASE, 0), draw(replace(BASE, faults=(kind,)), 0)
    return clean, record(clean), record(faulty)


def changed(kind: str) -> dict[str, list[Pair]]:
    """Values of the changed channels of each record, without and with the fault."""
    _, clean, faulty = both(kind)
    pairs: dict[str, list[Pair]] = {}
    for name, channels in clean.data.items():
        for channel, values in channels.items():
            if not np.allclose(values, faulty.data[name][channel], rtol=1e-12, atol=1e-12):
                pairs.setdefault(channel, []).append((values, faulty.data[name][channel]))
    return pairs


def factor(pairs: list[Pair]) -> float:
    """Common factor between all values."""
    one, other = (np.concatenate(each) for each in zip(*pairs, strict=True))
    ratio = float(one @ other / (one @ one))
    assert np.allclose(other, ratio * one, rtol=1e-9, atol=1e-9 * float(np.abs(other).max()))
    return ratio


def test_all_kinds_are_covered() -> None:
    assert {*LOGS, *STUDY} == set(FAULTS)


def of_one(channels: dict[str, list[Pair]], name: str) -> list[Pair]:
    (channel,) = channels
    assert channel[:-1] == name
    return channels[channel]


def is_scaled(name: str, *factors: float) -> Callable[[dict[str, list[Pair]]], bool]:
    """Whether one channel of the name is multiplied by one of the factors."""
    return lambda channels: any(
        factor(of_one(channels, name)) == pytest.approx(each) for each in factors
    )


def is_swapped(channels: dict[str, list[Pair]]) -> bool:
    one, other = sorted(channels)
    pairs = zip(channels[one], channels[other], strict=True)
    return one[:-1] == other[:-1] and all(
        np.array_equal(a, d) and np.array_equal(b, c) for (a, b), (c, d) in pairs
    )


def is_late(channels: dict[str, list[Pair]]) -> bool:
    return set(channels) == {"a1", "a2"} and all(
        np.ptp(late) <= np.ptp(early) for early, late in channels["a1"]
    )


def is_clipped(channels: dict[str, list[Pair]]) -> bool:
    pairs = of_one(channels, "a")
    limit = max(float(np.abs(cut).max()) for _, cut in pairs)
    return all(np.array_equal(cut, np.clip(whole, -limit, limit)) for whole, cut in pairs)


def is_local(*names: str) -> Callable[[dict[str, list[Pair]]], bool]:
    """Whether one channel of one record changed."""
    return lambda channels: (
        len(channels) == 1
        and (next(iter(channels))[:-1] in names and len(next(iter(channels.values()))) == 1)
    )


ENCODER_COUNTS = float(draw(BASE, 0).rig.study.arm.joints[0].encoder_counts or 0.0)
LOGS: dict[str, Callable[[dict[str, list[Pair]]], bool]] = {
    "time-unit": lambda channels: round(factor(channels["t"])) in (1000, 1_000_000),
    "time-scale": lambda channels: 0.005 <= abs(factor(channels["t"]) - 1.0) <= 0.05,
    "angle-unit": is_scaled("theta_m", 180.0 / np.pi, ENCODER_COUNTS / (2.0 * np.pi), 0.5 / np.pi),
    "angle-sign": is_scaled("theta_m", -1.0),
    "accelerometer-unit": is_scaled("a", 1.0 / 9.80665),
    "accelerometer-sign": is_scaled("a", -1.0),
    "voltage-sign": is_scaled("u", -1.0),
    "swapped-joints": is_swapped,
    "late-sensors": is_late,
    "fast-clock": lambda channels: set(channels) == {"a1", "a2"},
    "clipped-sensor": is_clipped,
    "spikes": is_local("theta_m", "a"),
    "frozen": is_local("theta_m", "a"),
    "encoder-steps": is_local("theta_m"),
    "flat-tops": is_local("a"),
    "mains-hum": lambda channels: len(channels) == 1 and next(iter(channels))[0] == "a",
}
STUDY = {
    "gear-ratio": "gear_ratio",
    "geometry": "accelerometer_distance",
    "torque-constant": "torque_per_volt",
}


@pytest.mark.parametrize("kind", LOGS)
def test_faults_of_logs_change_the_stated_channels(kind: str) -> None:
    arm, _, faulty = both(kind)
    assert faulty.study == arm.rig.study
    assert faulty.classes["fault"] == kind
    assert faulty.classes["fault_size"]
    assert LOGS[kind](changed(kind))


@pytest.mark.parametrize("kind", STUDY)
def test_faults_of_the_study_change_one_key_of_one_joint(kind: str) -> None:
    arm, _, faulty = both(kind)
    assert not changed(kind)
    differs = [
        (one, other)
        for one, other in zip(arm.rig.study.arm.joints, faulty.study.arm.joints, strict=True)
        if one != other
    ]
    ((one, other),) = differs
    assert replace(one, **{STUDY[kind]: getattr(other, STUDY[kind])}) == other


def test_missing_sensors_have_no_faults() -> None:
    bare = Sensors(link=("none",))
    family = Family(arms=200, faults=1.0, sensors=bare)
    kinds = {draw(family, number).fault for number in range(200)}
    lacking = {"accelerometer-unit", "accelerometer-sign", "geometry", "clipped-sensor"}
    assert not kinds & (lacking | {"flat-tops", "late-sensors", "fast-clock", "mains-hum"})
    assert "swapped-joints" in kinds


def test_faulty_arms_can_be_recorded() -> None:
    link = get_args(LinkSensors)
    for kind in FAULTS:
        family = Family(arms=4, faults=(kind,), sensors=Sensors(link=link), gravity=0.5)
        for number in range(4):
            arm = draw(family, number)
            classes = record(arm).classes
            assert classes.get("fault", arm.fault) == arm.fault
