"""Motor-side signals: zero-phase filters, drive delays, stiction and saturation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.domain import FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.numerics import filters
from strainwave.numerics.filters import apply_lags, differentiate, low_pass, noise_std, signal_band
from strainwave.signals import motor as signals
from strainwave.signals.drive_law import DriveLaw
from strainwave.signals.prepared_record import prepare_record
from strainwave.signals.standstill import free_friction, responses, sliding_direction
from strainwave.virtual import scara
from virtual_arms import CLOCK, DRIVE, motion_log, rigid_drive

TIME: FloatArray = CLOCK * np.arange(8000, dtype=np.float64)
INNER = slice(1000, -1000)  # samples without filter transients


def log_of(channels: dict[str, FloatArray]) -> Log:
    n = len(next(iter(channels.values())))
    return Log(DRIVE, TIME[:n], CLOCK, channels)


# --- filters ----------------------------------------------------------------------------------


@pytest.mark.parametrize("relative", [0.2, 0.5, 1.0, 2.0])
def test_the_low_pass_has_zero_phase_and_the_analytic_gain(relative: float) -> None:
    cutoff = 10.0
    w = 2.0 * np.pi * relative * cutoff
    passed = low_pass(np.sin(w * TIME), cutoff, CLOCK)[INNER]
    gain = 1.0 / (1.0 + relative**8)
    # The bilinear transform changes frequencies by (pi f T)^2 / 3 and the gain by 8 times this.
    assert passed == pytest.approx(gain * np.sin(w * TIME)[INNER], abs=0.02)
    quadrature = np.mean(passed * np.cos(w * TIME)[INNER])
    assert abs(quadrature) < 1e-3 * max(gain, 1e-2)


def test_a_cutoff_beyond_nyquist_passes_everything() -> None:
    noise = np.random.default_rng(0).normal(size=100)
    np.testing.assert_array_equal(low_pass(noise, 500.0, CLOCK), noise)


def test_numerical_derivatives_are_of_fourth_order() -> None:
    errors = []
    for T in (0.02, 0.01):
        t = T * np.arange(200)
        errors.append(np.abs(differentiate(np.sin(3.0 * t), T) - 3.0 * np.cos(3.0 * t))[5:-5].max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.2)


def test_encoder_noise_and_band_are_estimated() -> None:
    rng = np.random.default_rng(0)
    angle = 50.0 * np.sin(2.0 * np.pi * 1.0 * TIME) + rng.normal(0.0, 1e-3, TIME.shape)
    assert noise_std(angle) == pytest.approx(1e-3, rel=0.1)
    assert 1.0 <= signal_band(angle, CLOCK) <= 10.0
    quieter = angle - rng.normal(0.0, 1e-3, TIME.shape) * 0.0
    wide = (
        quieter + 0.1 * np.sin(2.0 * np.pi * 40.0 * TIME) + 0.1 * np.sin(2.0 * np.pi * 20.0 * TIME)
    )
    assert signal_band(wide, CLOCK) >= signal_band(angle, CLOCK)


# --- drive ------------------------------------------------------------------------------------


def test_held_voltages_are_delayed_by_half_a_sample_and_the_lag() -> None:
    """The torque is delayed by half a sample and the lag of the current loop."""
    joint = replace(rigid_drive().arm.joints[0], torque_per_volt=2.0, current_loop_hz=200.0)
    w = 2.0 * np.pi * 5.0
    torque = DriveLaw.of(joint).torque(np.sin(w * TIME), CLOCK)
    late = 0.5 * CLOCK + 1.0 / (2.0 * np.pi * 200.0)
    # To second order in frequency, the lag is a delay; its gain error is (w tau)^2 / 2 = 3e-4.
    assert torque[INNER] == pytest.approx(2.0 * np.sin(w * (TIME - late))[INNER], abs=2e-3)


def test_a_constant_voltage_is_a_constant_torque() -> None:
    joint = replace(rigid_drive().arm.joints[0], torque_per_volt=0.1, current_loop_hz=300.0)
    assert DriveLaw.of(joint).torque(np.full(50, 3.0), CLOCK) == pytest.approx(0.3)


def test_a_voltage_needs_its_torque_constant() -> None:
    log = log_of({"theta_m1": np.sin(TIME), "u1": np.sin(TIME)})
    with pytest.raises(InvalidInput, match="torque_per_volt"):
        signals.prepare_motor_signals(log, Arm.of(rigid_drive().arm))


def test_the_inverse_of_the_drive_gives_the_held_voltages() -> None:
    law = DriveLaw(0.1, 300.0)
    voltage = np.random.default_rng(0).normal(size=200)
    torque = apply_lags(law.command(voltage), law.current_loop, CLOCK, held=True)
    np.testing.assert_allclose(law.voltage(torque, CLOCK)[1:-1], voltage[1:-1], atol=1e-12)


def test_a_record_is_prepared_once_for_each_arm() -> None:
    log = log_of({"theta_m1": TIME, "u1": np.sin(TIME)})
    arm = Arm.of(rigid_drive().arm)
    record = prepare_record(log, arm)
    assert prepare_record(log, Arm.of(rigid_drive().arm)) is record
    assert prepare_record(log, arm.with_joint(1, torque_per_volt=2.0)) is not record
    assert prepare_record(replace(log), arm) is not record


# --- motion -----------------------------------------------------------------------------------


def test_signals_follow_a_known_motion() -> None:
    w = 2.0 * np.pi * 1.0
    angle = np.round(30.0 * np.sin(w * TIME) / 1e-3) * 1e-3
    motion = signals.prepare_motor_signals(
        log_of({"theta_m1": angle, "torque1": np.cos(w * TIME)}), Arm.of(rigid_drive().arm)
    )
    assert motion.motor_velocity[INNER, 0] == pytest.approx(
        30.0 * w * np.cos(w * TIME)[INNER], abs=0.3
    )
    peak = 30.0 * w**2
    acceleration_error = motion.motor_acceleration[INNER, 0] + peak * np.sin(w * TIME)[INNER]
    assert np.sqrt(np.mean(acceleration_error**2)) < 0.01 * peak
    assert not motion.valid[0, 0]
    assert motion.valid[4000, 0]
    assert motion.torque_channel == ("torque1",)


def test_the_bandwidth_option_changes_the_outcome() -> None:
    log = log_of({"theta_m1": np.sin(9.0 * TIME), "torque1": np.cos(9.0 * TIME)})
    study = rigid_drive()
    results = [
        signals.prepare_motor_signals(log, Arm.of(study.arm), signals.SignalOptions(bandwidth_hz=f))
        for f in (2.0, 20.0)
    ]
    assert [s.bandwidth_hz for s in results] == [2.0, 20.0]
    assert np.std(results[0].motor_velocity) < np.std(results[1].motor_velocity)


@pytest.mark.parametrize("missing", ["theta_m1", "torque1"])
def test_the_error_states_the_missing_channel(missing: str) -> None:
    channels = {"theta_m1": np.sin(TIME), "torque1": np.cos(TIME)}
    del channels[missing]
    with pytest.raises(InvalidInput, match=missing):
        signals.prepare_motor_signals(log_of(channels), Arm.of(rigid_drive().arm))


def test_a_record_shorter_than_its_filter_is_refused() -> None:
    short = {"theta_m1": np.sin(TIME[:60]), "torque1": np.cos(TIME[:60])}
    with pytest.raises(InvalidInput, match="too few"):
        signals.prepare_motor_signals(
            log_of(short), Arm.of(rigid_drive().arm), signals.SignalOptions(bandwidth_hz=1.0)
        )


# --- stiction ---------------------------------------------------------------------------------


def test_directions_are_certain_only_while_the_motor_slides() -> None:
    count = 1e-3
    angle = np.concatenate(
        [np.linspace(0.0, 1.0, 1000), np.full(500, 1.0), np.linspace(1.0, 0.0, 1000)]
    )
    direction = sliding_direction(np.floor(angle / count) * count, 1.5 * count, 20)
    assert np.all(direction[20:980] == 1.0)
    assert np.all(direction[1000:1500] == 0.0)
    assert np.all(direction[1520:-20] == -1.0)


def test_a_stop_without_reversal_is_detected() -> None:
    angle = np.concatenate([np.linspace(0, 1, 500), np.ones(200), np.linspace(1, 2, 500)])
    direction = sliding_direction(angle, 3e-3, 20)
    assert np.all(direction[510:690] == 0.0)
    assert np.all(direction[5:490] == 1.0)
    assert np.all(direction[710:-5] == 1.0)


def test_an_encoder_at_standstill_has_no_direction() -> None:
    assert not np.any(sliding_direction(np.zeros(100), 1e-3, 20))


def test_creep_within_stiction_counts_as_standstill() -> None:
    """A position without quantisation shows the creep of a regularised friction, not sliding."""
    time = np.arange(3000) * 1e-3
    speed = np.select([time < 1.0, time < 2.0], [10.0, 1e-5], 10.0)
    angle = np.cumsum(speed) * 1e-3
    direction = sliding_direction(angle, resolution=1e-12, standing=20)
    creeps = (time > 1.02) & (time < 1.98)
    assert (direction[creeps] == 0.0).all()
    assert (direction[(time > 0.02) & (time < 0.98)] == 1.0).all()


def test_responses_are_the_shapes_through_the_filter() -> None:
    """Constant shapes and triangles, also at the ends of the record, at a subset of rows."""
    rng = np.random.default_rng(4)
    kernel = rng.normal(size=41)
    direction = np.ones(300)
    for uncertain in (slice(0, 3), slice(40, 41), slice(90, 150), slice(200, 207), slice(296, 300)):
        direction[uncertain] = 0.0
    shapes = free_friction(direction, 10)
    assert min(shapes.stop - shapes.first) == 1
    assert {bool(slope) for slope in shapes.slope} == {False, True}
    rows = np.arange(5, 300, 7)
    each = zip(*shapes, responses(shapes, rows, kernel).dense().T, strict=True)
    for first, stop, centre, slope, response in each:
        padded = np.zeros(300)
        padded[first:stop] = 1.0 - slope * np.abs(np.arange(first, stop) - centre)
        # rounding of sums of 41 numbers of order one
        assert response == pytest.approx(np.convolve(padded, kernel, mode="same")[rows], abs=1e-12)


@pytest.mark.parametrize("kept", [slice(None), slice(7, None, 13)])
@pytest.mark.parametrize("cutoff", [2.0, 40.0, 450.0])
def test_filtering_in_blocks_equals_filtering_the_whole_signal(cutoff: float, kept: slice) -> None:
    """Filtering in blocks gives the same result as filtering the whole signal."""
    signal = np.cumsum(np.random.default_rng(5).normal(size=(300_000, 2)), axis=0)
    reference = signal if cutoff >= 450.0 else filters._passed(signal, cutoff * 1e-3, 1)
    filtered = low_pass(signal, cutoff, 1e-3, kept=kept)
    assert filtered.shape == reference[kept].shape
    # The transients at both ends differ; they are below rounding after 14 periods.
    edge = int(14.0 / (cutoff * 1e-3))
    index = np.arange(len(signal))[kept]
    inside = (index >= edge) & (index < len(signal) - edge)
    error = np.abs(filtered - reference[kept])[inside].max()
    assert error < 1e-11 * np.abs(signal).max()


@given(st.lists(st.sampled_from([-1.0, 0.0, 1.0]), min_size=1, max_size=200), st.integers(2, 40))
def test_friction_shapes_sum_to_one_at_uncertain_directions(
    directions: list[float], spacing: int
) -> None:
    """The shapes sum to one at uncertain directions and to zero elsewhere."""
    direction = np.array(directions)
    total = np.zeros(len(direction))
    for first, stop, centre, slope in zip(*free_friction(direction, spacing), strict=True):
        total[first:stop] += 1.0 - slope * np.abs(np.arange(first, stop) - centre)
    assert total == pytest.approx((direction == 0.0).astype(float))


def test_certain_directions_agree_with_the_simulated_velocity() -> None:
    """Certain directions agree with the sign of the velocity of a simulated arm."""
    study = scara.STIFF.study(Path("nowhere"), "linear")
    motion = signals.prepare_motor_signals(
        motion_log(study, scara.STIFF.parameters(5, "linear"), 0), Arm.of(study.arm)
    )
    certain = motion.direction != 0.0
    assert 0.7 < certain.mean() < 0.999
    moving = np.abs(motion.motor_velocity) > 5.0
    agree = motion.direction[moving & certain] == np.sign(motion.motor_velocity[moving & certain])
    assert agree.all()


# --- saturation -------------------------------------------------------------------------------


def test_samples_at_the_servo_limit_are_excluded_with_a_warning() -> None:
    study = scara.STIFF.study(Path("nowhere"), "linear")
    log = motion_log(study, scara.STIFF.parameters(0, "linear"), 0, duration=4.0)
    voltage = log.channels["u1"].copy()
    voltage[2000:2300] = 10.0
    limited = replace(log, channels={**log.channels, "u1": voltage})
    motion = signals.prepare_motor_signals(limited, Arm.of(study.arm))
    assert not motion.valid[2000:2300, 0].any()
    assert motion.valid[2000:2300, 1].all()
    assert [w.code for w in motion.warnings] == ["saturated"]


def test_flat_tops_are_saturation_only_under_servo_control() -> None:
    torque = np.clip(2.0 * np.sin(9.0 * TIME), -1.5, 1.5)
    motion = signals.prepare_motor_signals(
        log_of({"theta_m1": np.sin(9.0 * TIME), "torque1": torque}), Arm.of(rigid_drive().arm)
    )
    assert [w.code for w in motion.warnings] == ["saturated"]
    idle = log_of({"theta_m1": np.sin(9.0 * TIME), "torque1": np.zeros_like(TIME)})
    assert not signals.prepare_motor_signals(idle, Arm.of(rigid_drive().arm)).warnings


def test_an_open_loop_voltage_at_its_extremes_is_not_saturation() -> None:
    experiment = replace(DRIVE, control=("open",))
    square = np.sign(np.sin(9.0 * TIME + 0.1))
    log = log_of({"theta_m1": np.sin(9.0 * TIME), "torque1": square})
    assert not signals.prepare_motor_signals(
        replace(log, experiment=experiment), Arm.of(rigid_drive().arm)
    ).warnings


def test_a_motor_that_only_deflects_stands() -> None:
    """A travel far below that in other records does not overcome the friction."""
    arm = Arm.of(rigid_drive().arm)
    swing = np.sin(2.0 * TIME)
    records = [
        signals.prepare_motor_signals(log_of({"theta_m1": size * swing, "torque1": swing}), arm)
        for size in (1.0, 0.5, 1e-3)
    ]
    moving, slow, standing = signals.mark_standstill(records)
    assert moving is records[0]
    assert slow is records[1]
    assert records[2].direction.any()
    assert not standing.direction.any()
