"""Low-frequency records: their bandwidth, and the rows that the torques are regressed on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from consistency_inputs import Input
from strainwave.domain import Correction, Experiment, Joint, Lag, Log, Prbs
from strainwave.domain.arm.kinds import single_joint
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.excitation import prbs
from strainwave.input_check import evidence, timing
from strainwave.input_check.evidence import collect_evidence
from strainwave.input_check.timing import estimate_clocks
from strainwave.input_check.torque_rows import regress_torques, spread_stretches
from strainwave.numerics.filters import apply_lags
from strainwave.signals.motor import motion_bands

SAMPLE_TIME = 1e-3  # [s]
TIME = SAMPLE_TIME * np.arange(6000)
NOISE = np.random.default_rng(0).standard_normal((len(TIME), 2))


@pytest.mark.parametrize("noise_std", [0.0, 1e-5, 1e-3])
def test_noise_of_the_angle_does_not_widen_the_band(noise_std: float) -> None:
    # at 1e-3 rad, noise has 99 % of the power of the velocity
    angle = 0.02 * np.sin(2.0 * np.pi * 1.5 * TIME)[:, None] + noise_std * NOISE[:, :1]
    assert max(motion_bands(angle, SAMPLE_TIME, slow=True)) == pytest.approx(3.0, rel=0.05)


def test_a_motor_at_standstill_does_not_determine_the_band(vertical_arm: Input) -> None:
    logs, study = vertical_arm
    first = logs[0]
    vibration = 1e-5 * np.sin(2.0 * np.pi * 200.0 * first.time)
    held = {**first.channels, "theta_m2": first.channels["theta_m2"][0] + vibration}
    changed = replace(first, channels=held)
    (still, *_) = collect_evidence([changed, *logs[1:]], study).records
    (moving, *_) = collect_evidence(logs, study).records
    assert still.bandwidth_hz <= 1.5 * moving.bandwidth_hz
    (alone, *_) = collect_evidence([changed], study).records  # no record in which it moves
    assert alone.bandwidth_hz <= 4.0 * moving.bandwidth_hz  # limited by the other motor


def test_the_evidence_of_a_long_record_is_bounded(
    horizontal_arm: Input, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs, study = horizontal_arm
    log = next(each for each in logs if each.name == "prbs-j1")
    half = log.cut(slice(len(log) // 2))
    (expected,) = collect_evidence([half], study).records
    monkeypatch.setattr(evidence, "_MAX_SAMPLES", len(half))
    monkeypatch.setattr(timing, "_BLOCK_LINES", 100)
    (bounded,) = collect_evidence([log], study).records
    for record in (bounded, expected):
        assert record.delays.keys() == {1}
    # the blocks of lines are added in another order
    np.testing.assert_allclose(
        bounded.delays[1].unexplained, expected.delays[1].unexplained, rtol=1e-6
    )
    np.testing.assert_array_equal(bounded.channels["theta_m1"], expected.channels["theta_m1"])
    monkeypatch.setattr(evidence, "_MAX_ROWS", 100)
    (short,) = collect_evidence([half], study).records
    assert len(short.inside) == 100 < len(expected.inside)


@pytest.mark.parametrize(("key", "size"), [("delay_s", 0.017), ("delay_s", -0.4), ("clock", 2e-3)])
def test_a_channel_is_shifted_between_its_rows(vertical_arm: Input, key: str, size: float) -> None:
    evidence = collect_evidence(*vertical_arm)
    record = evidence.records[0]
    time = record.sample_time * np.arange(len(record.inside))
    wave = 2.0 * np.pi * record.bandwidth_hz
    channels = {**record.channels, "theta_m1": np.sin(wave * time)}
    evidence = replace(evidence, records=(replace(record, channels=channels),))
    (shifted,) = evidence.corrected([Correction("log", "theta_m1", key, size)]).records
    later = time + size * (time if key == "clock" else 1.0)
    kept = record.inside & (later > time[4]) & (later < time[-4])
    np.testing.assert_allclose(
        shifted.channels["theta_m1"][kept], np.sin(wave * later[kept]), atol=1e-3
    )


@pytest.mark.parametrize("max_rows", [300, 500, 1000])
def test_stretches_are_spread_over_the_records(vertical_arm: Input, max_rows: int) -> None:
    records = collect_evidence(*vertical_arm).records
    whole = spread_stretches(records, 10**6)
    assert whole == [[slice(0, len(r.inside))] for r in records]
    for record, stretches in zip(records, spread_stretches(records, max_rows), strict=True):
        edges = [0, *(x for each in stretches for x in (each.start, each.stop)), len(record.inside)]
        gaps = np.diff(edges)
        assert np.all(gaps >= 0)
        assert abs(gaps[0] - gaps[-1]) <= 2  # the same distance from both ends, up to rounding


def test_a_share_of_the_rows_gives_the_same_inertias(
    vertical_arm: Input, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = list(regress_torques(collect_evidence(*vertical_arm)))
    monkeypatch.setattr("strainwave.input_check.torque_rows._MAX_ROWS", 400)
    part = list(regress_torques(collect_evidence(*vertical_arm)))
    assert [each.channel for each in part] == [each.channel for each in whole] == ["u1", "u2"]
    for (one, std), (other, other_std) in (
        (each.values["inertia"], another.values["inertia"])
        for each, another in zip(whole, part, strict=True)
    ):
        assert one != other  # other rows
        assert abs(one - other) < 4.0 * np.hypot(std, other_std) + 0.02 * abs(one)


def test_a_joint_whose_signals_do_not_change_is_regressed_once(vertical_arm: Input) -> None:
    evidence = collect_evidence(*vertical_arm)
    first, second = regress_torques(evidence)
    scaled = [
        replace(r, channels={**r.channels, "u2": 2.0 * r.channels["u2"]}) for r in evidence.records
    ]
    same, other = regress_torques(replace(evidence, records=tuple(scaled)))
    assert same is first
    assert other.values["inertia"][0] == pytest.approx(2.0 * second.values["inertia"][0])


@pytest.mark.parametrize("is_torque", [False, True])
@pytest.mark.parametrize("clock", [1e-3, 2e-3, 5.25e-3])
def test_the_jumps_of_a_prbs_show_its_clock_where_a_servo_acts(
    clock: float, is_torque: bool
) -> None:
    """The servo adds a slow motion, and noise in each of its periods; torques lag behind both."""
    T, test = 2.5e-4, Prbs(order=9, clock=clock, periods=2, amplitude=5.0)
    time = np.asarray(T * np.arange(round(2 * 511 * clock / T)), dtype=np.float64)
    switches = prbs(test)[np.minimum((time / clock + 1e-9).astype(int), 2 * 511 - 1)]
    servo = np.repeat(0.3 * np.random.default_rng(1).standard_normal(len(time)), 4)[: len(time)]
    voltage = switches + servo + 2.0 * np.sin(2.0 * np.pi * time)
    name = "torque1" if is_torque else "u1"
    command = apply_lags(voltage, [Lag(1, 1000.0)], T, held=True) if is_torque else voltage
    arm = Arm.of(single_joint(Joint(spring="linear", gear_ratio=0.01, torque_per_volt=0.1)))
    record = Experiment("prbs", "prbs", "frequency", ("servo",), joint=1, prbs=test)
    estimate, _ = estimate_clocks(Log(record, time, T, {name: command}), arm)
    assert estimate == pytest.approx(clock, rel=1e-3)
