"""Time in any form, pauses, held samples and missing values: the channels must not change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.domain import (
    ArmDescription,
    Channel,
    Experiment,
    FloatArray,
    IntArray,
    Joint,
    Log,
    Origin,
    Study,
)
from strainwave.domain.arm.combinations import has_posture_free
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_logs
from strainwave.io.logs.clock_text import time_of
from strainwave.io.logs.updates import find_updates
from strainwave.io.study import read_study, write_study

Columns = dict[str, FloatArray]
JOINT = Joint(spring="rigid", gear_ratio=1.0)
STUDY = Study(
    arm=ArmDescription(kind="single-joint", joints=(JOINT,)),
    experiments=(Experiment("run", "run.csv", "motion", ("servo",)),),
)
MEASURED = ("theta_m1", "omega_m1", "torque1")


def columns(samples: int = 1000, period: float = 0.001, noise: float = 1e-4) -> Columns:
    """Channels of a moving joint with noise."""
    t = period * np.arange(samples)
    rng = np.random.default_rng(3)
    values = {
        "theta_m1": np.sin(9.0 * t),
        "omega_m1": 9.0 * np.cos(9.0 * t),
        "torque1": np.cos(7.0 * t + 1.0),
    }
    return {"t": t} | {n: v + noise * rng.standard_normal(samples) for n, v in values.items()}


def read(data: Columns, study: Study = STUDY) -> tuple[Log, ...]:
    return read_logs(study, data={"run": data})


def rows(data: Columns, selection: IntArray) -> Columns:
    return {name: values[selection] for name, values in data.items()}


def codes(log: Log) -> list[str]:
    return [warning.code for warning in log.warnings]


# --- time -------------------------------------------------------------------------------------


@given(
    bits=st.sampled_from([8, 16, 24, 32]),
    ticks=st.integers(1, 25),
    start=st.integers(0, 2**32 - 1),
    jitter=st.integers(0, 1),
)
def test_a_counter_is_continued_at_its_overflow(
    bits: int, ticks: int, start: int, jitter: int
) -> None:
    rng = np.random.default_rng(start)
    counts = start % 2**bits + np.cumsum(3 * ticks + jitter * rng.integers(-ticks, ticks + 1, 500))
    time = time_of({"c": counts % 2.0**bits}, {}, Channel("c", scale=1e-6))
    np.testing.assert_allclose(time - time[0], 1e-6 * (counts - counts[0]), atol=1e-12)


@given(start=st.floats(0.0, 86400.0), unit=st.sampled_from([1e-3, 1e-6, 1e-9]))
def test_two_columns_give_the_time_of_one(start: float, unit: float) -> None:
    time = start + 0.001 * np.arange(3000)
    whole = np.floor(time)
    fraction = np.minimum(np.round((time - whole) / unit), np.round(1.0 / unit) - 1.0)
    channel = Channel("s", second_column="f")
    stamps = time_of({"s": whole + 1.7e9, "f": fraction}, {}, channel)
    np.testing.assert_allclose(stamps, time - time[0], atol=1.1 * unit)
    days = 86400.0 * np.floor(time / 86400.0)
    for date in (days, np.zeros(len(time))):  # the date of each row, or of the first row
        clock = time_of({"s": date, "f": time - days}, {"s": "date", "f": "time"}, channel)
        np.testing.assert_allclose(clock, time - time[0], atol=1e-9)


def test_a_sampling_rate_replaces_time_stamps(tmp_path: Path) -> None:
    data = columns()
    expected = read(data)[0]
    del data["t"]
    study = replace(STUDY, sample_rate=1000.0)
    (log,) = read(data, study)
    np.testing.assert_allclose(log.time, expected.time, atol=1e-12)
    with pytest.raises(InvalidInput, match="no column 't'"):
        read(data)
    (tmp_path / "run.csv").write_text("x")
    for each in (study, replace(STUDY, channels={"t": Channel("s", second_column="ns")})):
        write_study(each, tmp_path / "study.toml")
        again = read_study(tmp_path / "study.toml")
        assert (again.channels, again.sample_rate) == (each.channels, each.sample_rate)
    text = (tmp_path / "study.toml").read_text()
    text = text.replace("[channels.t]", "[channels]\nsample_rate = 1000.0\n\n[channels.t]")
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(InvalidInput, match="both t and sample_rate"):
        read_study(tmp_path / "study.toml")


# --- segments ---------------------------------------------------------------------------------


@given(
    lengths=st.lists(st.integers(50, 200), min_size=1, max_size=5),
    pauses=st.lists(st.floats(0.02, 5.0), min_size=5, max_size=5),
    restart=st.booleans(),
)
def test_pauses_split_a_record_and_lose_no_row(
    lengths: list[int], pauses: list[float], restart: bool
) -> None:
    data = columns(sum(lengths))
    bounds = np.cumsum([0, *lengths])
    for start, pause in zip(bounds[1:-1], pauses, strict=False):
        data["t"][start:] += -data["t"][start] if restart else pause
    logs = read(data)
    assert [len(log) for log in logs] == lengths
    several = len(lengths) > 1
    assert codes(logs[0]) == ["split"] * several
    assert [log.name for log in logs] == (
        [f"run/{k}" for k in range(1, len(lengths) + 1)] if several else ["run"]
    )
    joined = np.concatenate([log.channels["theta_m1"] for log in logs])
    np.testing.assert_array_equal(joined, data["theta_m1"])


@given(rows_repeated=st.sets(st.integers(1, 999), min_size=1, max_size=40))
def test_repeated_rows_are_dropped(rows_repeated: set[int]) -> None:
    data = columns()
    order = np.sort([*range(1000), *rows_repeated])
    (log,) = read(rows(data, order))
    assert codes(log) == ["repeated-stamps"]
    for name in MEASURED:
        np.testing.assert_array_equal(log.channels[name], data[name])


def test_a_segment_at_rest_and_a_short_one_are_left_out() -> None:
    data = columns()
    keep = np.r_[0:300, 350:380, 500:1000]
    data = rows(data, keep)
    data["theta_m1"][:300] = 1.0
    (log,) = read(data)
    assert log.name == "run"
    assert len(log) == 500
    assert "30 row(s) are left out" in log.warnings[0].message


# --- held samples -----------------------------------------------------------------------------


@given(
    shortest=st.integers(2, 12),
    spread=st.integers(0, 8),
    seed=st.integers(0, 100),
    count=st.sampled_from([0.0, 1e-3]),
)
def test_held_samples_are_reduced_to_the_updates(
    shortest: int, spread: int, seed: int, count: float
) -> None:
    data = columns(4000)
    if count:
        data["theta_m1"] = count * np.round(data["theta_m1"] / count)
    runs = np.random.default_rng(seed).integers(shortest, shortest + spread + 1, 4000)
    updates = np.cumsum(np.r_[0, runs])
    updates = updates[updates < 4000]
    held = rows(data, updates[np.searchsorted(updates, np.arange(4000), side="right") - 1])
    (log,) = read(held | {"t": data["t"]})
    assert codes(log)[0] == "held-samples"
    if spread == 0:
        for name in MEASURED:
            np.testing.assert_array_equal(log.channels[name], data[name][updates])


@pytest.mark.parametrize("name", ["theta_m1", "torque1"])
def test_a_held_channel_among_faster_ones_is_interpolated(name: str) -> None:
    data = columns(2000, noise=1e-9)
    held = data | {name: data[name][np.arange(2000) // 10 * 10]}
    (log,) = read(held)
    (warning, _) = log.warnings
    assert name in warning.message
    assert "every 10 rows" in warning.message
    for each in MEASURED:
        expected = np.interp(log.time, data["t"], data[each])
        # cubics between samples every 10 ms of a motion at 9 rad/s: error below the squared step
        np.testing.assert_allclose(log.channels[each], expected, atol=9.0 * 0.09**2 / 8)


TIME: FloatArray = 0.001 * np.arange(4000, dtype=np.float64)
NOT_HELD: dict[str, Callable[[np.random.Generator], FloatArray]] = {
    "slow encoder": lambda rng: np.round(20.0 * np.sin(2.0 * TIME)),
    "slow encoder with noise": lambda rng: np.round(
        20.0 * np.sin(2.0 * TIME) + 0.2 * rng.standard_normal(4000)
    ),
    "encoder at rest": lambda rng: np.where(TIME > 3.0, np.sin(9.0 * TIME), 0.0),
    "two levels": lambda rng: np.repeat(rng.choice([-1.0, 1.0], 500), 8),
    "dead band": lambda rng: np.maximum(np.sin(9.0 * TIME) - 0.9, 0.0),
    "frozen stretch": lambda rng: np.where(np.abs(TIME - 2.0) < 1.0, 0.5, np.sin(9.0 * TIME)),
    "coarse current": lambda rng: np.round(5.0 * np.sin(9.0 * TIME)),
    "constant": lambda rng: np.ones(4000),
}


@pytest.mark.parametrize("signal", NOT_HELD)
def test_resting_and_quantised_signals_are_not_held(signal: str) -> None:
    assert find_updates(NOT_HELD[signal](np.random.default_rng(0))) is None


# --- missing values ---------------------------------------------------------------------------


@given(empty=st.sets(st.integers(5, 994), min_size=1, max_size=20), name=st.sampled_from(MEASURED))
def test_single_missing_values_are_interpolated_and_masked(empty: set[int], name: str) -> None:
    data = columns(noise=0.0)
    values = data[name].copy()
    values[sorted(empty)] = np.nan
    (log,) = read(data | {name: values})
    assert codes(log) == ["missing-values"]
    assert set(np.flatnonzero(log.masked[name])) == empty
    np.testing.assert_allclose(log.channels[name], data[name], atol=0.02)


def test_late_columns_narrow_the_record_and_long_holes_split_it() -> None:
    data = columns(2000)
    torque = data["torque1"].copy()
    torque[:100] = torque[900:1000] = torque[-50:] = np.nan
    logs = read(data | {"torque1": torque})
    assert [len(log) for log in logs] == [800, 950]
    assert codes(logs[0]) == ["missing-values", "split"]
    with pytest.raises(InvalidInput, match="'torque1' has no values"):
        read(data | {"torque1": np.full(2000, np.nan)})


# --- velocity only ----------------------------------------------------------------------------


def chain(
    *motions: Literal["revolute", "prismatic"],
    gravity: tuple[float, float, float] | None,
    rpy: float = 0.0,
) -> Study:
    joints = tuple(
        replace(JOINT, motion=motion, origin=Origin(rpy=(rpy, 0.0, 0.0))) for motion in motions
    )
    arm = ArmDescription(kind="serial", joints=joints, gravity=gravity)
    return replace(STUDY, arm=arm)


def test_a_velocity_is_integrated_where_the_posture_does_not_matter() -> None:
    data = columns(noise=0.0)
    del data["theta_m1"]
    down = (0.0, 0.0, -9.81)
    for study in (STUDY, chain("revolute", gravity=down), chain("prismatic", gravity=down)):
        (log,) = read(data, study)
        assert codes(log) == ["integrated-velocity"]
        np.testing.assert_allclose(log.channels["theta_m1"], np.sin(9.0 * log.time), atol=1e-4)
    for study in (
        replace(STUDY, arm=replace(STUDY.arm, gravity=(0.0, -9.81, 0.0))),
        chain("revolute", gravity=down, rpy=1.57),
    ):
        with pytest.raises(InvalidInput, match=r"motor 1 logs its velocity .* but no angle"):
            read(data, study)


def test_the_posture_of_later_joints_matters_unless_all_slide() -> None:
    free = chain("prismatic", "prismatic", gravity=(0.0, 0.0, -9.81)).arm
    assert has_posture_free(free, 1)
    assert has_posture_free(free, 2)
    arm = chain("revolute", "revolute", gravity=None).arm
    assert has_posture_free(arm, 1)
    assert not has_posture_free(arm, 2)
