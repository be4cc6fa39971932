"""Simulation of records: low-pass, compared channels and initial state."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib import import_module

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.domain import FloatArray, Log, Study
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import MAX_TIME_STEP, Arm
from strainwave.dynamics.simulation import simulate
from strainwave.errors import InvalidInput
from strainwave.identification.whole_arm.records.dataset import (
    INITIAL_STATES,
    Dataset,
    low_pass_kernels,
)
from strainwave.identification.whole_arm.records.preparation import (
    dataset_of,
    select_usable_records,
)
from strainwave.signals.channels import resolutions_of
from tuning_runs import beginning, later, rig_logs, shaken, simulated, truth

T = 2.5e-4
CUTOFF = 80.0
KERNELS = [(80.0, 2.5e-4), (37.0, 2.5e-4), (200.0, 1e-3), (11.0, 1e-3), (240.0, 1e-3)]


@given(
    cutoff=st.floats(20.0, 150.0),
    sample_time=st.sampled_from([2.5e-4, 5e-4, 1e-3]),
    ahead=st.floats(-0.5, 0.5),
)
def test_velocities_of_advanced_rows(cutoff: float, sample_time: float, ahead: float) -> None:
    """Whatever the advance, a motor at rest far from zero has no velocity and a ramp its own."""
    kernels = low_pass_kernels(cutoff, sample_time, ahead)
    t = sample_time * np.arange(float(len(kernels.slope) + 8 * kernels.step))
    assert kernels.rows(np.full(len(t), 300.0), slope=True) == pytest.approx(0.0, abs=1e-9)
    ramp = np.asarray(300.0 + 7.0 * t)
    assert kernels.rows(ramp, slope=True) == pytest.approx(7.0, rel=1e-9)
    assert kernels.rows(np.full(len(t), 300.0), slope=False) == pytest.approx(300.0)


@pytest.mark.parametrize(("cutoff", "sample_time"), KERNELS)
def test_a_ramp_has_its_slope_and_a_constant_its_value(cutoff: float, sample_time: float) -> None:
    kernels = low_pass_kernels(cutoff, sample_time)
    n = 5 * len(kernels.smooth)
    ramp: FloatArray = 3.0 - 7.0 * sample_time * np.arange(n, dtype=np.float64)
    np.testing.assert_allclose(kernels.rows(ramp, slope=True), -7.0, rtol=1e-11)
    np.testing.assert_allclose(kernels.rows(np.full(n, 2.5), slope=False), 2.5, rtol=1e-13)
    slope_of_constant = kernels.rows(np.full(n, 2.5), slope=True)
    assert np.max(np.abs(slope_of_constant)) * sample_time < 1e-13


@pytest.mark.parametrize(("cutoff", "sample_time"), KERNELS)
def test_rows_are_a_convolution(cutoff: float, sample_time: float) -> None:
    kernels = low_pass_kernels(cutoff, sample_time)
    rng = np.random.default_rng(0)
    # the last block is incomplete
    x = rng.normal(size=(5 * len(kernels.smooth) + kernels.step // 2, 2, 3))
    for rate, taps in [(False, kernels.smooth), (True, kernels.slope)]:
        rows = kernels.rows(x, slope=rate)
        for i in range(2):
            for j in range(3):
                convolution = np.correlate(x[:, i, j], taps, "valid")[:: kernels.step]
                # the incomplete last block gives no row
                assert 0 <= len(convolution) - len(rows) <= 1
                expected = convolution[: len(rows)]
                scale = np.max(np.abs(taps))
                np.testing.assert_allclose(rows[:, i, j], expected, atol=1e-12 * scale)


def response(taps: FloatArray, hz: FloatArray, sample_time: float) -> FloatArray:
    """Complex frequency response (n_hz,) of a kernel around its centre."""
    time = sample_time * (np.arange(len(taps)) - 0.5 * (len(taps) - 1))
    return np.asarray(np.exp(2j * np.pi * hz[:, None] * time) @ taps)


@pytest.mark.parametrize(("cutoff", "sample_time"), KERNELS)
def test_the_low_pass_is_flat_and_ends(cutoff: float, sample_time: float) -> None:
    kernels = low_pass_kernels(cutoff, sample_time)
    low = cutoff * np.linspace(0.0, 0.3, 20)
    gain = response(kernels.smooth, low, sample_time)
    # with 1.5 periods of the cut-off on each side, the transition band is about 0.6 of the cut-off
    np.testing.assert_allclose(gain, 1.0, atol=0.005)
    limit = 0.5 / sample_time
    high = np.linspace(1.7 * cutoff, limit, 200)
    if 1.7 * cutoff < limit:
        assert np.max(np.abs(response(kernels.smooth, high, sample_time))) < 10 ** (-45.0 / 20.0)
    # decimation causes no aliases in the band
    assert 1.0 / (kernels.step * sample_time) >= 4.0 * cutoff * (1.0 - 1e-9)


def test_a_low_sine_comes_through_in_its_phase() -> None:
    kernels = low_pass_kernels(CUTOFF, T)
    time = T * np.arange(4000)
    omega = 2.0 * np.pi * 0.25 * CUTOFF
    reach = len(kernels.smooth)
    smooth = kernels.rows(np.sin(omega * time), slope=False)
    middle = 0.5 * (reach - 1) * T + kernels.step * T * np.arange(len(smooth))
    # ripple of the window at a quarter of the cut-off
    np.testing.assert_allclose(smooth, np.sin(omega * middle), atol=0.005)
    # the slope kernel weights the ends of the window, and is exact for a ramp
    rate = kernels.rows(np.sin(omega * time), slope=True)
    np.testing.assert_allclose(rate, omega * np.cos(omega * middle), atol=0.025 * omega)


@cache
def ideal() -> tuple[Study, Values, tuple[Log, ...]]:
    """Records without noise and encoder counts, and the true values."""
    return shaken(noisy=False, counts=False)


def off_by(motor: float, link: float) -> FloatArray:
    """Integration error of each channel with a longer step, relative to its standard deviation."""
    return np.array([motor, motor, link, link])


# a function of the package hides the module of the same name
MODULE = import_module("strainwave.identification.whole_arm.records.preparation")
# step of the records, and longer step of fits, which affects accelerations most
STEPS = [(MAX_TIME_STEP, off_by(1e-8, 1e-8)), (MODULE._STEP, off_by(3e-5, 2e-3))]


@pytest.mark.parametrize(("step", "off"), STEPS)
def test_the_true_arm_repeats_its_record(
    monkeypatch: pytest.MonkeyPatch, step: float, off: FloatArray
) -> None:
    monkeypatch.setattr(MODULE, "_STEP", step)
    study, values, logs = ideal()
    for log in logs:
        dataset = dataset_of(log, Arm.of(study.arm), CUTOFF)
        assert not dataset.begins_in_motion
        assert dataset.initial_states == ()
        assert len(dataset.start()) == 0
        difference = simulated(dataset, values, dataset.start()) - dataset.measured
        assert np.all(np.abs(difference) < off * np.std(dataset.measured, axis=0))


def test_a_mode_too_fast_for_the_step_of_the_record_shortens_the_step() -> None:
    study, values, logs = ideal()
    stiff = dict(values)
    for joint in (1, 2):
        stiff["gear_stiffness", joint] *= 3e3
        stiff["gear_damping", joint] = 1e-3
    dataset = dataset_of(logs[0], Arm.of(study.arm), CUTOFF)
    exact = replace(dataset, max_time_step=2e-5)
    long = replace(dataset, max_time_step=1e-3)
    rows, exact_rows = (simulated(each, stiff, dataset.start()) for each in (long, exact))
    assert np.abs(rows - exact_rows)[:, :2].max() < 0.05 * np.abs(exact_rows[:, :2]).max()
    columns, exact_columns = (
        each.linearise(stiff, dataset.start(), [("motor_inertia", 1)])[1] for each in (long, exact)
    )
    assert np.abs(columns).max() < 2.0 * np.abs(exact_columns).max()


def test_a_servoed_record_is_driven_by_its_voltages() -> None:
    """The recorded voltages drive the simulation; the servo has no influence."""
    study, logs = rig_logs()
    values = truth()[1]
    log = next(r for r in logs if r.name == "step-j1")
    dataset = dataset_of(log, Arm.of(study.arm), CUTOFF)
    assert dataset.drive.servo == (False, False)
    np.testing.assert_array_equal(dataset.drive.voltage[:, 0], log.channels["u1"])
    open_channels = {name: x for name, x in log.channels.items() if not name.startswith("ref")}
    without_servo = dataset_of(
        replace(log, channels=open_channels),
        Arm.of(replace(study, arm=replace(study.arm, servo=None)).arm),
        CUTOFF,
    )
    rows = simulated(without_servo, values, without_servo.start())
    np.testing.assert_array_equal(rows, simulated(dataset, values, dataset.start()))
    # the error consists of encoder counts, accelerometer bias and noise
    error = rows - dataset.measured
    assert np.max(np.abs(np.std(error, axis=0) / dataset.noise - 1.0)) < 0.5


def test_noise_is_the_filtered_sensor_noise() -> None:
    study, _, (log, *_) = ideal()
    rng = np.random.default_rng(1)
    sizes = {"theta_m1": 1e-3, "theta_m2": 2e-3, "a1": 0.05, "a2": 0.02}
    channels = dict(log.channels)
    for name, size in sizes.items():
        channels[name] = log.channels[name] + rng.normal(0.0, size, len(log))
    clean, noisy = (
        dataset_of(record, Arm.of(study.arm), CUTOFF)
        for record in (log, replace(log, channels=channels))
    )
    assert [channel.channel for channel in noisy.channels] == list(sizes)
    noise_std = np.std(noisy.measured - clean.measured, axis=0)
    # 320 rows, of which four overlap
    np.testing.assert_allclose(noisy.noise, noise_std, rtol=0.3)


def test_the_noise_estimate_excludes_the_simulated_motion() -> None:
    """At the PRBS clock rate, fast motion resembles noise until the model explains it."""
    study, values, (log, *_) = ideal()
    rng = np.random.default_rng(2)
    channels = {name: x[::4] for name, x in log.channels.items()}
    sizes = {"theta_m1": 1e-6, "theta_m2": 1e-6, "a1": 2e-3, "a2": 2e-3}
    for name, size in sizes.items():
        channels[name] = channels[name] + rng.normal(0.0, size, len(channels[name]))
    slow = replace(log, sample_time=4.0 * log.sample_time, time=log.time[::4], channels=channels)
    dataset = dataset_of(slow, Arm.of(study.arm), CUTOFF)
    kernels = [dataset.kernels.taps(slope=channel.reads_angle) for channel in dataset.channels]
    true = np.array([s * np.linalg.norm(k) for s, k in zip(sizes.values(), kernels, strict=True)])
    assert np.all(dataset.noise > 3.0 * true)
    np.testing.assert_allclose(
        dataset.correct_step_error(values, dataset.start()).noise, true, rtol=0.2
    )  # about 500 samples


def test_counts_are_noise() -> None:
    study, _, (log, *_) = shaken()
    channels = {**log.channels, "theta_m2": np.zeros(len(log))}
    dataset = dataset_of(replace(log, channels=channels), Arm.of(study.arm), CUTOFF)
    step = 2.0 * np.pi / 8192
    norm = np.linalg.norm(dataset.kernels.slope)
    assert dataset.noise[1] == pytest.approx(step / np.sqrt(12.0) * norm)
    assert all(joint.encoder_counts is None for joint in dataset.arm.joints)


def named(log: Log, study: Study) -> list[tuple[str, str, bool, bool]]:
    channels = dataset_of(log, Arm.of(study.arm), CUTOFF).channels
    return [(c.channel, c.quantities[0], c.reads_angle, c.sensor.has_bias) for c in channels]


def test_what_is_compared() -> None:
    study, _, (log, *_) = ideal()
    motors = [(f"theta_m{i}", "motor_angle", True, False) for i in (1, 2)]
    accelerometers = [(f"a{i}", "accelerometer", False, True) for i in (1, 2)]
    assert {"a1", "gyro1", "theta_m1"} <= set(log.channels)
    assert named(log, study) == motors + accelerometers
    # an accelerometer of unknown position is compared as IMU axis, in addition to the gyro
    first, second = study.arm.joints
    unknown_position = replace(
        study, arm=replace(study.arm, joints=(replace(first, accelerometer_distance=None), second))
    )
    anywhere = ("a1", "specific_force_x", False, True)
    gyro = ("gyro1", "gyro", False, True)
    assert named(log, unknown_position) == [*motors, gyro, anywhere, accelerometers[1]]
    # a link encoder precedes a gyro
    angle = {**log.channels, "theta_l1": 0.01 * log.channels["theta_m1"]}
    del angle["a1"]
    linked = replace(log, channels=angle)
    assert named(linked, study) == [
        *motors,
        ("theta_l1", "link_angle", True, False),
        accelerometers[1],
    ]
    motor_channels = {name: x for name, x in log.channels.items() if name[0] in "ut"}
    assert named(replace(log, channels=motor_channels), study) == motors


@pytest.mark.parametrize(("step", "off"), STEPS)
def test_every_channel_is_simulated_as_it_is_measured(
    monkeypatch: pytest.MonkeyPatch, step: float, off: FloatArray
) -> None:
    """Gyro, link angle, accelerometer and encoder of the true arm agree with the record."""
    monkeypatch.setattr(MODULE, "_STEP", step)
    study, values, (log, *_) = ideal()
    angle = 0.01 * log.channels["theta_m2"]
    drive = dataset_of(log, Arm.of(study.arm), CUTOFF).drive
    run = simulate(
        Arm.of(study.arm), values, drive, sample_time=T, samples=len(log), record=["link_angle"]
    )
    channels = {**log.channels, "theta_l2": np.ascontiguousarray(run["link_angle"][:, 1])}
    assert np.max(np.abs(channels["theta_l2"] - angle)) > 1e-4  # torsion of the loaded gear
    for name in ("a1", "a2"):
        del channels[name]
    dataset = dataset_of(replace(log, channels=channels), Arm.of(study.arm), CUTOFF)
    assert [channel.channel for channel in dataset.channels][2:] == ["gyro1", "theta_l2"]
    rows = simulated(dataset, values, dataset.start())
    assert np.all(np.abs(rows - dataset.measured) < off * np.std(dataset.measured, axis=0))


def test_a_record_that_begins_in_motion() -> None:
    study, values, (log, *_) = ideal()
    cut = later(log, 400)
    dataset = dataset_of(cut, Arm.of(study.arm), CUTOFF)
    assert dataset.begins_in_motion
    assert dataset.initial_states == tuple((name, i) for name in INITIAL_STATES for i in (1, 2))
    initial_state = beginning(study, values, log, 400)
    error = simulated(dataset, values, initial_state) - dataset.measured
    # the initial motor torque is unknown; it decays with the time constant of the electronics, 0.16
    # ms
    scale = np.std(dataset.measured, axis=0)
    assert np.max(np.abs(error) / scale) < 0.06
    guess = dataset.start()
    np.testing.assert_allclose(guess[2:4], initial_state[2:4], atol=5e-3)
    # from standstill, the simulated motion differs
    from_rest = replace(dataset, begins_in_motion=False)
    assert (
        np.max(np.abs(simulated(from_rest, values, np.zeros(0)) - dataset.measured) / scale) > 0.1
    )


@pytest.mark.parametrize("spring", ["linear", "three-slope"])
def test_derivatives_are_those_of_the_rows(spring: str) -> None:
    study, values, (log, *_) = shaken(spring, noisy=False, counts=False)
    record = dataset_of(later(log, 400), Arm.of(study.arm), CUTOFF)
    local = record.start()
    directions = [("beta", None), ("motor_inertia", 1), ("motor_coulomb_friction", 1)]
    directions += [("gear_damping", 2)]
    if spring == "linear":
        directions.append(("gear_stiffness", 1))
    else:
        directions += [("gear_stiffness_k2", 1), ("gear_knee_t1", 1), ("gear_knee_t2", 2)]
    rows, tangent = record.linearise(values, local, directions)
    np.testing.assert_allclose(rows, simulated(record, values, local), rtol=1e-9, atol=1e-9)
    assert tangent.shape == (*rows.shape, len(directions) + len(local))
    for k, key in enumerate(directions, start=len(local)):
        h = 1e-5 * values[key]
        up, down = (simulated(record, {**values, key: values[key] + s}, local) for s in (h, -h))
        expected = (up - down) / (2.0 * h)
        size = np.max(np.abs(expected), axis=0)
        # detects a missing stick-slip event; cancellation limits differences to 1e-5
        assert np.all(np.abs(tangent[..., k] - expected) < 2e-4 * np.max(size)), key
    for k in range(len(local)):
        step = 1e-6 * np.eye(len(local))[k]
        expected = simulated(record, values, local + step) - simulated(record, values, local - step)
        expected /= 2e-6
        derivative = tangent[..., k]
        assert np.max(np.abs(derivative - expected)) < 2e-4 * np.max(np.abs(expected)), (
            record.initial_states[k]
        )


@pytest.mark.parametrize("spring", ["linear", "three-slope"])
def test_a_record_from_rest_is_classified_as_at_rest(spring: str) -> None:
    """A motor at standstill accelerates gradually, whatever the voltage and the noise."""
    for amplitude in (3.0, 10.0):
        study, _, logs = shaken(spring, amplitude)
        for log in logs:
            assert not dataset_of(log, Arm.of(study.arm), CUTOFF).begins_in_motion
    study, logs = rig_logs()
    assert not any(
        dataset_of(log, Arm.of(study.arm), CUTOFF).begins_in_motion
        for log in logs
        if log.sample_time == T
    )


@pytest.mark.parametrize(("joint", "first"), [(1, 300), (1, 900), (2, 300), (2, 900)])
def test_a_record_cut_in_motion_is_classified_as_moving(joint: int, first: int) -> None:
    study, _, logs = shaken()
    assert dataset_of(later(logs[joint - 1], first), Arm.of(study.arm), CUTOFF).begins_in_motion


def test_records_that_cannot_be_gone_through_again() -> None:
    study, logs = rig_logs()
    log = next(r for r in logs if r.name == "step-j1")
    without_encoder = {name: x for name, x in log.channels.items() if name != "theta_m2"}
    with pytest.raises(InvalidInput, match="the log has no channel theta_m2"):
        dataset_of(replace(log, channels=without_encoder), Arm.of(study.arm), CUTOFF)
    without_voltage = {name: x for name, x in log.channels.items() if name != "u2"}
    with pytest.raises(InvalidInput, match="neither torque2 nor u2"):
        dataset_of(replace(log, channels=without_voltage), Arm.of(study.arm), CUTOFF)
    short = {name: x[:200] for name, x in log.channels.items()}
    with pytest.raises(InvalidInput, match="record at least"):
        dataset_of(replace(log, time=log.time[:200], channels=short), Arm.of(study.arm), CUTOFF)


def test_usable_records() -> None:
    study, logs = rig_logs()
    uses = {log.name: log.experiment.use for log in logs}
    assert {"check", "tuning"} <= set(uses.values())
    without_encoder = [
        replace(log, channels={k: x for k, x in log.channels.items() if k != "theta_m1"})
        if log.name == "step-j2"
        else log
        for log in logs
    ]
    assert [log.name for log in select_usable_records(logs, Arm.of(study.arm))] == [
        "step-j1",
        "step-j2",
    ]
    assert [log.name for log in select_usable_records(without_encoder, Arm.of(study.arm))] == [
        "step-j1"
    ]
    _, _, shakes = shaken()
    assert len(select_usable_records(shakes, Arm.of(study.arm))) == 2
    sweep_records = [
        replace(log, experiment=replace(log.experiment, use="sweep")) for log in shakes
    ]
    assert len(select_usable_records(sweep_records, Arm.of(study.arm))) == 2
    motion_records = [
        replace(log, experiment=replace(log.experiment, use="motion")) for log in shakes
    ]
    assert select_usable_records(motion_records, Arm.of(study.arm)) == []


def test_a_silent_sensor_has_the_resolution_of_its_other_records() -> None:
    study, _, (first, second) = shaken()
    step = 0.25
    rounded = replace(
        first, channels={**first.channels, "a1": step * np.round(first.channels["a1"] / step)}
    )
    silent = replace(second, channels={**second.channels, "a1": np.full(len(second), step)})
    resolutions = resolutions_of([rounded, silent])
    assert resolutions["a1"] == pytest.approx(step)
    arm = Arm.of(study.arm)
    alone, known = (dataset_of(silent, arm, CUTOFF, resolutions=one) for one in (None, resolutions))
    at = known.channel_names.index("a1")
    gain = np.linalg.norm(known.kernels.taps(slope=False))
    assert alone.noise[at] < 1e-9
    assert known.noise[at] == pytest.approx(step / np.sqrt(12.0) * gain)


def test_steps_that_resolve_a_fast_mode_give_the_derivatives_by_its_damping() -> None:
    """A gear 400 times stiffer moves a mode far above the cut-off, where long steps damp it."""
    study, values, (log, *_) = ideal()
    dataset = dataset_of(log, Arm.of(study.arm), CUTOFF)
    assert dataset.resolve_modes(values) is dataset
    damping = "gear_damping", 2
    stiff = {**values, ("gear_stiffness", 2): 400.0 * values["gear_stiffness", 2]}
    exact = replace(dataset, max_time_step=dataset.max_time_step / 16.0)

    def error(record: Dataset) -> float:
        start = record.start()
        slopes = [one.linearise(stiff, start, [damping])[1] for one in (record, exact)]
        return float(np.linalg.norm(slopes[0] - slopes[1]) / np.linalg.norm(slopes[1]))

    assert error(dataset.resolve_modes(stiff)) < 0.4
    assert error(dataset) > 0.8
