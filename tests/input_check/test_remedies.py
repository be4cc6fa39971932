"""Applying the remedy of each simulated fault makes the input consistent."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from consistency_inputs import Input
from strainwave.domain import Correction, Lag, Log
from strainwave.domain.messages import text_of
from strainwave.domain.results.consistency import apply_corrections, steps_of
from strainwave.input_check import check_consistency
from strainwave.io.logs import read_logs
from strainwave.numerics.filters import apply_lags

Columns = dict[str, Any]
Fault = Callable[[Input], Input]
KINDS = ("u", "theta_m", "a", "gyro", "ref")


def altered(given: Input, change: Callable[[Log, Columns], None]) -> Input:
    logs, study = given
    after = []
    for log in logs:
        columns = dict(log.channels)
        change(log, columns)
        after.append(replace(log, channels=columns))
    return tuple(after), study


def scaled(**factors: float) -> Fault:
    def change(_: Log, columns: Columns) -> None:
        for name, factor in factors.items():
            if name in columns:
                columns[name] = factor * columns[name]

    return lambda given: altered(given, change)


def exchanged(*kinds: str) -> Fault:
    def change(_: Log, columns: Columns) -> None:
        for kind in kinds:
            first, second = f"{kind}1", f"{kind}2"
            if first in columns:
                columns[first], columns[second] = columns[second], columns[first]

    return lambda given: altered(given, change)


def delayed(seconds: float, *names: str) -> Fault:
    def change(log: Log, columns: Columns) -> None:
        for name in names:
            columns[name] = np.interp(log.time - seconds, log.time, columns[name])

    return lambda given: altered(given, change)


def high_passed(hz: float, *names: str) -> Fault:
    def change(log: Log, columns: Columns) -> None:
        for name in names:
            slow = apply_lags(columns[name], [Lag(1, hz)], log.sample_time)
            columns[name] = columns[name] - slow

    return lambda given: altered(given, change)


def clipped(share: float, name: str) -> Fault:
    def fault(given: Input) -> Input:
        top = share * max(float(np.abs(log.channels[name]).max()) for log in given[0])

        def change(_: Log, columns: Columns) -> None:
            columns[name] = np.clip(columns[name], -top, top)

        return altered(given, change)

    return fault


def timed(factor: float) -> Fault:
    return lambda given: (
        tuple(
            replace(log, time=factor * log.time, sample_time=factor * log.sample_time)
            for log in given[0]
        ),
        given[1],
    )


def keyed(*corrections: Correction) -> Fault:
    def fault(given: Input) -> Input:
        study = apply_corrections(given[1], corrections)
        by_name = {each.name: each for each in study.experiments}
        return tuple(replace(log, experiment=by_name[log.name]) for log in given[0]), study

    return fault


def relative(joint: int, key: str, factor: float) -> Fault:
    def fault(given: Input) -> Input:
        value = getattr(given[1].arm.joints[joint - 1], key)
        return keyed(Correction("joint", str(joint), key, factor * value))(given)

    return fault


EVERYWHERE: dict[str, tuple[Fault, tuple[str, ...]]] = {
    "degrees": (scaled(theta_m1=57.29578, theta_m2=57.29578), ("wrong-unit",)),
    "degrees of one": (scaled(theta_m1=57.29578), ("wrong-unit",)),
    "counts": (scaled(theta_m1=1303.797294, theta_m2=1303.797294), ("wrong-unit",)),
    "a factor of four": (scaled(theta_m2=4.0), ("wrong-unit",)),
    "a quarter": (scaled(theta_m1=0.25, theta_m2=0.25), ("wrong-unit",)),
    "all exchanged": (exchanged(*KINDS), ("swapped-channels",)),
    "all but gyros exchanged": (exchanged("u", "theta_m", "a", "ref"), ("swapped-channels",)),
    "angles exchanged": (exchanged("theta_m"), ("swapped-channels",)),
    "g": (scaled(a1=1.0 / 9.80665), ("wrong-unit",)),
    "sign": (scaled(theta_m2=-1.0), ("wrong-sign",)),
    "sign of a": (scaled(a2=-1.0), ("wrong-sign",)),
    "ms": (timed(1e3), ("wrong-unit",)),
    "gear ratio": (relative(2, "gear_ratio", 0.5), ("wrong-gear-ratio",)),
    "distance": (relative(1, "accelerometer_distance", 2.0), ("wrong-geometry",)),
    "length": (keyed(Correction("arm", "", "link_length", 0.5)), ("wrong-geometry",)),
    "late sensors": (delayed(0.02, "a1", "a2", "gyro1", "gyro2"), ("misaligned",)),
    "high-pass": (high_passed(0.5, "a1", "a2"), ("ac-coupled",)),
    "clipped": (clipped(0.6, "a2"), ("clipped",)),
}
HORIZONTAL: dict[str, tuple[Fault, tuple[str, ...]]] = {
    "gravity": (keyed(Correction("arm", "", "gravity", 9.81)), ("wrong-geometry",)),
    "millivolts": (scaled(u1=1e3), ("wrong-unit",)),
    "amplitude": (
        keyed(Correction("experiment", "prbs-j1", "prbs.amplitude", 1e4)),
        ("wrong-unit",),
    ),
    "joint": (keyed(Correction("experiment", "prbs-j1", "joint", 2)), ("swapped-channels",)),
    "voltages exchanged": (exchanged("u"), ("swapped-channels",)),
    "1.5 ms": (delayed(1.5e-3, "u1", "u2"), ("misaligned",)),
    "3 ms of one": (delayed(3e-3, "u1"), ("misaligned",)),
    "10 ms": (delayed(1e-2, "u1", "u2"), ("misaligned",)),
    "1.5 ms early": (delayed(-1.5e-3, "u1", "u2"), ("misaligned",)),
}
VERTICAL: dict[str, tuple[Fault, tuple[str, ...]]] = {
    "no gravity": (keyed(Correction("arm", "", "gravity", None)), ("wrong-geometry",)),
}


def apply_remedy(given: Input, corrections: Sequence[Correction]) -> Input:
    """Apply corrections to the logs and the study, and read the input again."""
    logs, study = given
    data = {}
    for log in logs:
        columns = {"t": log.time, **log.channels}
        for each in corrections:
            if each.table != "log" or each.entry not in columns:
                continue
            if each.key == "delay_s":
                at = log.time + each.number
                columns[each.entry] = np.interp(at, log.time, columns[each.entry])
            elif each.key == "clock":
                at = log.time + each.number * (log.time - log.time[0])
                columns[each.entry] = np.interp(at, log.time, columns[each.entry])
            else:
                del columns[each.entry]
        data[log.name] = columns
    after = apply_corrections(study, corrections)
    return read_logs(after, data=data), after


def assert_remedied(given: Input, codes: tuple[str, ...]) -> None:
    suspected = check_consistency(*given).suspected
    assert tuple(dict.fromkeys(each.code for each in suspected)) == codes, suspected
    assert all(each.corrections for each in suspected)
    for each in suspected:
        steps = [text_of(step) for step in steps_of(given[1], each.corrections)]
        assert "; ".join(steps)[1:] in each.remedy or each.code == "clipped"
    corrections = [one for each in suspected for one in each.corrections]
    assert check_consistency(*apply_remedy(given, corrections)).suspected == ()


@pytest.mark.parametrize("fault", EVERYWHERE)
def test_applying_the_remedy_makes_the_input_consistent(vertical_arm: Input, fault: str) -> None:
    change, codes = EVERYWHERE[fault]
    assert_remedied(change(vertical_arm), codes)


@pytest.mark.parametrize("fault", HORIZONTAL)
def test_applying_the_remedy_of_a_test_signal_makes_the_input_consistent(
    horizontal_arm: Input, fault: str
) -> None:
    change, codes = HORIZONTAL[fault]
    assert_remedied(change(horizontal_arm), codes)


@pytest.mark.parametrize("fault", VERTICAL)
def test_applying_the_remedy_of_gravity_makes_the_input_consistent(
    vertical_arm: Input, fault: str
) -> None:
    change, codes = VERTICAL[fault]
    assert_remedied(change(vertical_arm), codes)


def test_a_prbs_alone_does_not_tell_its_clock_from_time_stamps(horizontal_arm: Input) -> None:
    both = check_consistency(*timed(0.99)(horizontal_arm)).suspected
    assert [each.code for each in both] == ["wrong-prbs-clock", "clock-drift"]
    assert [each.corrections for each in both] == [(), ()]


def test_the_delay_of_a_command_is_estimated_within_0_1_ms(horizontal_arm: Input) -> None:
    for delay in (1.5e-3, 3e-3, 1e-2):
        (suspicion,) = check_consistency(*delayed(delay, "u1")(horizontal_arm)).suspected
        assert suspicion.delay_s == pytest.approx(delay, abs=1e-4)
        assert suspicion.where == "u1"


def test_link_sensors_tell_a_late_encoder_from_an_early_command(horizontal_arm: Input) -> None:
    (suspicion,) = check_consistency(*delayed(2e-2, "theta_m1")(horizontal_arm)).suspected
    assert suspicion.where == "theta_m1"
    assert suspicion.delay_s == pytest.approx(2e-2, abs=1e-4)
    assert "20 ms later than the response to the command u1" in suspicion.message


def test_a_delay_below_one_sample_gives_no_suspicion(horizontal_arm: Input) -> None:
    assert check_consistency(*delayed(1e-3, "u1", "u2")(horizontal_arm)).suspected == ()


def test_several_faults_give_experiments_that_isolate_the_likely_causes(arm: Input) -> None:
    noise = np.random.default_rng(7)

    def change(_: Log, columns: Columns) -> None:
        for name in ("a1", "a2", "gyro1", "gyro2"):
            slow = apply_lags(noise.standard_normal(len(columns[name])), [Lag(1, 1.0)] * 3, 2.5e-4)
            columns[name] = slow * (np.std(columns[name]) / np.std(slow))

    suspected = check_consistency(*altered(arm, change)).suspected
    assert suspected
    assert all(not each.corrections or each.code != "wrong-gear-ratio" for each in suspected)
    assert any("(1)" in each.remedy and "(2)" in each.remedy for each in suspected)
