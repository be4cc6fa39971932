"""Link motion from each kind of sensor, and detection of delays between channels."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from elastic_runs import SAMPLE, log_of, prbs_run, rig
from strainwave.domain import FloatArray, Fusion, Lag, LinkOptions, Log, Study
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Trajectory
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_log
from strainwave.io.study import read_study
from strainwave.numerics.filters import (
    Between,
    apply_lags,
    apply_lags_without_aliases,
    band_pass,
    band_passes,
    differentiate,
)
from strainwave.signals import link_motion as links
from strainwave.signals.delays import build_delay_warnings, list_removed_delays
from strainwave.signals.link_motion import bias_of, complement, fuse

INNER = slice(400, -400)  # samples without filter transients
SHARED = (Lag(2, 300.0),)  # low-pass of both accelerometers


@cache
def run_of(
    gravity: float | None = None, counts: float | None = 8192.0, joint: int = 1
) -> tuple[Study, Trajectory]:
    study = rig(gravity, counts=counts)
    return study, prbs_run(study, joint)


def shifted(log: Log, name: str, samples: int = 1) -> Log:
    channels = {
        k: np.roll(v, samples) if k.startswith(name) else v for k, v in log.channels.items()
    }
    return replace(log, channels=channels)


# --- filters ----------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2])
def test_lags_have_the_analytic_step_response(order: int) -> None:
    w, t = 2.0 * np.pi * 300.0, SAMPLE * np.arange(100)
    step = np.r_[0.0, np.ones(100)]
    cutoff = Lag(1 if order == 1 else 2, 300.0)
    response = apply_lags(step, [cutoff], SAMPLE, held=True)[1:]
    if order == 1:
        exact = 1.0 - np.exp(-w * t)
    else:
        d = w / np.sqrt(2.0)
        exact = 1.0 - np.exp(-d * t) * (np.cos(d * t) + np.sin(d * t))
    assert response == pytest.approx(exact, abs=1e-12)


def test_a_ramp_is_delayed_by_the_sum_of_the_lags() -> None:
    """The delay of a ramp is the sum of the delays of the low-pass filters."""
    t: FloatArray = SAMPLE * np.arange(4000, dtype=np.float64)
    ramp = apply_lags(t, [Lag(1, 1000.0), Lag(2, 300.0)], SAMPLE)
    late = 1.0 / (2.0 * np.pi * 1000.0) + np.sqrt(2.0) / (2.0 * np.pi * 300.0)
    assert ramp[-1] == pytest.approx(t[-1] - late, abs=1e-9)


def test_the_current_loop_lag_reproduces_the_simulated_torque() -> None:
    """The current-loop lag reproduces the simulated motor torque."""
    _, run = run_of(None, None)
    torque = apply_lags(0.08 * run["voltage"][:, 0], [Lag(1, 1000.0)], SAMPLE, held=True)
    # The simulated voltage is zero before the first sample; its transient is excluded.
    assert torque[40:] == pytest.approx(run["motor_torque"][40:, 0], abs=1e-9)


def test_a_lagged_angle_keeps_the_analytic_amplitude() -> None:
    """Band-limited interpolation at a tenth of the sampling rate.

    Linear interpolation attenuates the signal by (w T)^2 / 12 = 3.3 %.
    """
    T, lag = 1e-3, Lag(2, 300.0)
    t = T * np.arange(2000)
    ratio = 100.0 / lag.cutoff_hz
    response = 1.0 / (1.0 + np.sqrt(2.0) * 1j * ratio - ratio**2)
    exact = (response * np.exp(200j * np.pi * t)).imag
    linear = apply_lags(np.sin(200.0 * np.pi * t), [lag], T)
    filtered = apply_lags_without_aliases(np.sin(200.0 * np.pi * t), [lag], T, "smooth")
    inner = slice(200, -200)
    assert filtered[inner] == pytest.approx(exact[inner], abs=2e-4)
    assert np.abs(linear - exact)[inner].max() > 0.02


@pytest.mark.parametrize("between", ["smooth", "held", "straight"])
def test_a_ramp_is_delayed_by_the_lags_and_the_hold(between: Between) -> None:
    """The delay of a ramp is the sum of the lags, plus half a sample if it is held."""
    t: FloatArray = SAMPLE * np.arange(4000, dtype=np.float64)
    passed = apply_lags_without_aliases(t, [Lag(1, 1000.0), Lag(2, 300.0)], SAMPLE, between)
    late = 1.0 / (2.0 * np.pi * 1000.0) + np.sqrt(2.0) / (2.0 * np.pi * 300.0)
    late += 0.5 * SAMPLE if between == "held" else 0.0
    assert passed[2000] == pytest.approx(t[2000] - late, abs=1e-8)


def test_a_held_voltage_is_filtered_without_aliasing() -> None:
    """Reference: the same voltage at 16 times the sampling rate, whose aliasing is negligible."""
    T, oversampling, lags = 1e-3, 16, [Lag(1, 800.0)]
    rng = np.random.default_rng(3)
    voltage = rng.choice([-10.0, 10.0], 2000)
    fine = apply_lags(np.repeat(voltage, oversampling), lags, T / oversampling, held=True)
    exact = band_pass(fine, 20.0, 300.0, T / oversampling)[::oversampling]
    errors = []
    for torque in (
        apply_lags_without_aliases(voltage, lags, T, "held"),
        apply_lags(voltage, lags, T, held=True),
    ):
        error = (band_pass(torque, 20.0, 300.0, T) - exact)[200:-200]
        errors.append(error.std() / exact.std())
    assert errors[0] < 0.005
    assert errors[1] > 0.05


def test_band_passes_give_integrals_and_derivatives_of_several_signals() -> None:
    t = SAMPLE * np.arange(8000)
    w = 2.0 * np.pi * 20.0
    signals = np.column_stack([np.sin(w * t), np.cos(w * t)])
    wanted = [(0, 0), (0, -1), (0, -2), (1, 0), (1, 1)]
    passed = band_passes(signals, wanted, 5.0, 80.0, SAMPLE)
    for column, (k, integrals) in enumerate(wanted[::3]):
        alone = band_passes(signals[:, [k]], [(0, integrals)], 5.0, 80.0, SAMPLE)
        assert passed[:, [3 * column]] == pytest.approx(alone, abs=1e-12)
    sine, velocity, acceleration = passed[2400:-2400, :3].T
    gain = (1.0 + 0.25**8) ** -2.0
    assert sine == pytest.approx(gain * np.sin(w * t)[2400:-2400], abs=1e-4)
    assert velocity == pytest.approx(gain * w * np.cos(w * t)[2400:-2400], abs=1e-4 * w)
    assert acceleration == pytest.approx(-(w**2) * sine, abs=1e-4 * w**2)
    # error of the fourth-order differences of the integral: (w T)^4 / 30
    assert differentiate(passed[:, 4], SAMPLE)[9:-9] == pytest.approx(passed[9:-9, 3], abs=1e-5)


# --- fusion -----------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2])
def test_fusing_a_signal_with_its_derivative_returns_the_signal(order: int) -> None:
    t = SAMPLE * np.arange(8000)
    fusion = Fusion(0.2, 1 if order == 1 else 2)
    fused = fuse(30.0 * np.cos(30.0 * t), np.sin(30.0 * t) + 5.0, fusion, SAMPLE)
    # error of the trapezoidal rule: (w T)^2 / 12
    assert fused == pytest.approx(np.sin(30.0 * t) + 5.0, abs=2e-5)


@pytest.mark.parametrize(("order", "offset"), [(1, 0.2 * 0.5), (2, 0.2 * 0.5 * np.sqrt(2.0))])
def test_a_constant_bias_gives_a_constant_offset(order: int, offset: float) -> None:
    """A constant bias of the rate causes a constant offset of the fused signal."""
    fusion = Fusion(0.2, 1 if order == 1 else 2)
    fused = fuse(np.full(40000, 0.5), np.zeros(40000), fusion, SAMPLE)
    assert fused[-1] == pytest.approx(offset, rel=1e-3)


def test_the_complement_rolls_off_with_its_order() -> None:
    t = SAMPLE * np.arange(40000)
    w = 2.0 * np.pi * 15.0
    for order, gain in ((1, 1.0 / (w * 0.2)), (2, 1.0 / (w * 0.2) ** 2)):
        fusion = Fusion(0.2, 1 if order == 1 else 2)
        passed = complement(np.sin(w * t), fusion, SAMPLE)[20000:]
        assert np.sqrt(2.0) * passed.std() == pytest.approx(gain, rel=0.01)


def test_a_vibration_does_not_change_the_bias_estimate() -> None:
    """A vibration of the spring does not affect the bias estimate."""
    t = SAMPLE * np.arange(16000)
    w = 2.0 * np.pi * 13.0
    motor = 0.4 * np.sin(2.0 * t)
    link = 0.8 * np.cos(2.0 * t) + 20.0 * np.cos(w * t)
    assert bias_of(link + 0.37, motor, SAMPLE, 10) == pytest.approx(0.37, abs=1e-4)


# --- links ------------------------------------------------------------------------------------


@pytest.mark.parametrize("gravity", [None, 9.81])
def test_ideal_sensors_give_the_true_link_motion(gravity: float | None) -> None:
    """Without noise and quantization, the link motion equals the filtered simulation."""
    study, run = run_of(gravity, None)
    motion = links.prepare_link_signals(log_of(run), Arm.of(study.arm))
    assert motion.shared == SHARED
    assert motion.sources == ("accelerometer", "accelerometer")
    assert not any(motion.held)
    # The filter acts on q2 and dq1 before, not after, the products of (9): a second-order error.
    names: tuple[Quantity, ...] = ("link_acceleration", "link_velocity", "link_angle")
    for name in names:
        true_motion = apply_lags(run[name], SHARED, SAMPLE)[INNER]
        estimate = getattr(motion, name)[INNER]
        error = (estimate - true_motion).std(axis=0) / true_motion.std(axis=0)
        # Below its cutoff, the fusion omits the deflection of the angle and of the velocity.
        limit = dict(zip(names, (0.004, 0.01, 0.03), strict=True))[name]
        assert np.all(error < limit), (name, error)


def test_biases_are_subtracted_and_reported() -> None:
    """Accelerometer biases are subtracted and reported in the signals."""
    study, run = run_of()
    log = log_of(run)
    a1 = log.channels["a1"] + 0.12
    a2 = log.channels["a2"] - 0.20
    motion = links.prepare_link_signals(
        replace(log, channels={**log.channels, "a1": a1, "a2": a2}), Arm.of(study.arm)
    )
    plain = links.prepare_link_signals(log, Arm.of(study.arm))
    biases = [
        after.bias - before.bias for after, before in zip(motion.links, plain.links, strict=True)
    ]
    assert biases == pytest.approx([0.12 / 0.33, -0.20 / 0.27 - 0.0], abs=2e-3)
    assert motion.link_velocity == pytest.approx(plain.link_velocity, abs=5e-3)


def test_the_estimated_fusion_error_agrees_with_the_true_error() -> None:
    """The estimated fusion error agrees with the true error within a factor of 1.6."""
    study, run = run_of(None, None)
    truth = apply_lags(run["link_velocity"], SHARED, SAMPLE)
    errors = []
    for order, time_constant in ((1, 0.05), (1, 0.2), (2, 0.2)):
        options = LinkOptions(time_constant, 1 if order == 1 else 2)
        motion = links.prepare_link_signals(log_of(run), Arm.of(study.arm), options)
        error = (motion.link_velocity - truth)[INNER].std(axis=0)
        assert {link.fusion for link in motion.links} == {Fusion(time_constant, options.order)}
        # The error estimate uses the fused velocity in place of the true one.
        estimates = [link.fusion_error for link in motion.links]
        assert np.all(np.abs(np.log(estimates / error)) < np.log(1.6))
        errors.append(error)
    assert np.all(errors[0] > errors[1])
    assert np.all(errors[1] > errors[2])


def test_two_accelerometer_bandwidths_are_both_applied() -> None:
    study = rig(None, counts=None)
    slower = replace(study.arm.joints[1], accelerometer_hz=150.0)
    study = replace(study, arm=replace(study.arm, joints=(study.arm.joints[0], slower)))
    run = prbs_run(study)
    motion = links.prepare_link_signals(log_of(run), Arm.of(study.arm))
    assert motion.shared == (Lag(2, 300.0), Lag(2, 150.0))
    truth = apply_lags(run["link_acceleration"], motion.shared, SAMPLE)[INNER]
    error = (motion.link_acceleration[INNER] - truth).std(axis=0) / truth.std(axis=0)
    assert np.all(error < 0.02)


@pytest.mark.parametrize("channel", ["theta_l", "deflection", "gyro"])
def test_every_kind_of_link_sensor_gives_the_link_motion(channel: str) -> None:
    study, run = run_of(None, None)
    angle, velocity = run["link_angle"], run["link_velocity"]
    reading = {
        "theta_l": angle,
        "deflection": angle - 0.01 * run["encoder"],
        "gyro": np.cumsum(velocity, axis=1),
    }[channel]
    joints = tuple(replace(joint, gyro_hz=None) for joint in study.arm.joints)
    log = log_of(run)
    channels = {k: v for k, v in log.channels.items() if not k.startswith("a")}
    channels |= {f"{channel}{i + 1}": reading[:, i] for i in range(2)}
    options = LinkOptions(bandwidth_hz=200.0)
    motion = links.prepare_link_signals(
        replace(log, channels=channels),
        Arm.of(replace(study, arm=replace(study.arm, joints=joints)).arm),
        options,
    )
    assert set(motion.sources) == {"encoder" if channel == "theta_l" else channel}
    assert [link.fusion for link in motion.links] == [None, None]
    assert motion.bandwidth_hz == 200.0
    error = (motion.link_velocity - velocity)[INNER].std(axis=0) / velocity.std(axis=0)
    assert np.all(error < 0.01)


def test_without_a_link_sensor_the_motor_is_used_with_a_warning() -> None:
    study, run = run_of()
    log = log_of(run)
    channels = {k: v for k, v in log.channels.items() if not k.startswith("a")}
    motion = links.prepare_link_signals(replace(log, channels=channels), Arm.of(study.arm))
    assert motion.sources == ("motor", "motor")
    assert [w.code for w in motion.warnings] == ["no-link-sensor"] * 2
    assert motion.link_velocity == pytest.approx(0.01 * motion.motor_velocity)


# --- alignment --------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", [1, 2])
def test_aligned_channels_give_no_warning(joint: int) -> None:
    study, run = run_of(joint=joint)
    motion = links.prepare_link_signals(log_of(run, joint, seed=3), Arm.of(study.arm))
    assert not motion.warnings
    delays = [link.sensor_delay for link in motion.links]
    for delay in (*delays, motion.links[joint - 1].drive_delay):
        assert delay is not None
        assert abs(delay.value) < 0.3 * SAMPLE
    assert motion.links[2 - joint].drive_delay is None  # this joint is not excited


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("samples", [-4, 4])
def test_a_delay_is_estimated_and_reported(joint: int, samples: int) -> None:
    """A shift of one channel is estimated as a delay and reported, without correction."""
    study, run = run_of(joint=joint)
    log = log_of(run, joint, seed=3)
    reference = links.prepare_link_signals(log, Arm.of(study.arm))
    late = links.prepare_link_signals(shifted(log, f"a{joint}", samples), Arm.of(study.arm))
    assert "misaligned" in {w.code for w in late.warnings}
    delay, reference_delay = (x.links[joint - 1].sensor_delay for x in (late, reference))
    assert delay is not None
    assert reference_delay is not None
    reference_samples = reference_delay.value / SAMPLE
    # one linearized step of a nonlinear estimate
    assert delay.value / SAMPLE - reference_samples == pytest.approx(samples, rel=0.45)
    assert late.motor_velocity == pytest.approx(reference.motor_velocity)
    drive = links.prepare_link_signals(shifted(log, "u", -samples), Arm.of(study.arm))
    assert "misaligned" in {w.code for w in drive.warnings}
    drive_delay = drive.links[joint - 1].drive_delay
    assert drive_delay is not None
    assert drive_delay.value / SAMPLE == pytest.approx(samples, rel=0.35)


def test_delays_of_link_sensors_are_removed_in_all_records() -> None:
    """One delay per sensor, corrected in several iterations of the linear estimate."""
    pairs = [run_of(joint=joint) for joint in (1, 2)]
    study, logs = pairs[0][0], [log_of(run, j, seed=3) for j, (_, run) in enumerate(pairs, 1)]
    late = [shifted(shifted(log, "a1", 8), "a2", -4) for log in logs]
    reference, no_delays = links.compute_link_signals(logs, Arm.of(study.arm))
    corrected, delays = links.compute_link_signals(late, Arm.of(study.arm))
    assert [delay.value for delay in no_delays] == [0.0, 0.0]
    assert not list(build_delay_warnings(no_delays))
    for delay, samples in zip(delays, (8, -4), strict=True):
        assert delay.value == pytest.approx(samples * SAMPLE, abs=4.0 * delay.std)
        assert delay.std < 0.1e-3
    constants = list_removed_delays(corrected, delays)
    assert constants == {("accelerometer_delay", j): d.value for j, d in enumerate(delays, 1)}
    warnings = list(build_delay_warnings(delays))
    assert [(c.code, c.where) for c in warnings] == [("sensor-delay", f"joint {j}") for j in (1, 2)]
    for before, after in zip(reference, corrected, strict=True):
        assert not after.warnings
        assert after.removed_delay == delays
        for i in (0, 1):
            expected = before.link_acceleration[INNER, i]
            difference = after.link_acceleration[INNER, i] - expected
            assert np.std(difference) < 0.05 * np.std(expected)


def test_an_implausibly_long_delay_is_not_corrected() -> None:
    """A delay above `MAX_SENSOR_DELAY` is reported but not corrected."""
    study, run = run_of()
    log = log_of(run, 1, seed=3)
    (motion,), delays = links.compute_link_signals([shifted(log, "a", 24)], Arm.of(study.arm))
    assert [delay.value for delay in delays] == [0.0, 0.0]
    assert "misaligned" in {w.code for w in motion.warnings}
    assert not list(build_delay_warnings(delays))


@pytest.mark.parametrize("joint", [1, 2])
def test_a_nonlinear_spring_gives_a_delay_only_for_the_excited_joint(joint: int) -> None:
    study, run = run_of(joint=joint)
    joints = tuple(
        replace(joint_parameters, spring="three-slope") for joint_parameters in study.arm.joints
    )
    motion = links.prepare_link_signals(
        log_of(run, joint, seed=3),
        Arm.of(replace(study, arm=replace(study.arm, joints=joints)).arm),
    )
    delay = motion.links[joint - 1].sensor_delay
    assert delay is not None
    assert abs(delay.value) < 0.3 * SAMPLE
    assert motion.links[2 - joint].sensor_delay is None


def test_a_bandwidth_missing_from_the_study_is_reported_as_a_delay() -> None:
    study, run = run_of()
    joints = tuple(replace(joint, accelerometer_hz=None) for joint in study.arm.joints)
    motion = links.prepare_link_signals(
        log_of(run, seed=1), Arm.of(replace(study, arm=replace(study.arm, joints=joints)).arm)
    )
    delay = motion.links[0].sensor_delay
    assert delay is not None
    assert delay.value == pytest.approx(np.sqrt(2.0) / (2.0 * np.pi * 300.0), rel=0.15)
    assert any("accelerometer_hz" in w.message for w in motion.warnings)


def test_a_voltage_logged_below_its_clock_is_reported() -> None:
    study, run = run_of()
    log = log_of(run)
    coarse = {k: v[::8] for k, v in log.channels.items()}
    motion = links.prepare_link_signals(
        replace(log, time=log.time[::8], sample_time=8 * SAMPLE, channels=coarse), Arm.of(study.arm)
    )
    assert "sub-sampled" in {w.code for w in motion.warnings}


@pytest.mark.parametrize(
    ("arm", "record"),
    [
        ("scara-linear-5kg", "prbs-j1"),
        ("scara-strainwave-3kg", "prbs-j2"),
        ("vertical-linear-0kg", "prbs-j1"),
    ],
)
def test_lab_channels_are_aligned_unless_one_is_shifted(
    shared_data: Path, arm: str, record: str
) -> None:
    study = read_study(shared_data / "lab" / arm / "study.toml")
    (experiment,) = [e for e in study.experiments if e.name == record]
    log = read_log(study, experiment)
    assert not links.prepare_link_signals(log, Arm.of(study.arm)).warnings
    for name in ("a", "u"):
        codes = {
            w.code
            for w in links.prepare_link_signals(shifted(log, name, 2), Arm.of(study.arm)).warnings
        }
        assert codes == {"misaligned"}


# --- refusals ---------------------------------------------------------------------------------


def test_missing_parameters_and_short_records_are_refused() -> None:
    """Missing parameters and short records raise InvalidInput."""
    study, run = run_of()
    log = log_of(run)
    without_distance = tuple(
        replace(joint, accelerometer_distance=None) for joint in study.arm.joints
    )
    with pytest.raises(InvalidInput, match="accelerometer_distance"):
        links.prepare_link_signals(
            log, Arm.of(replace(study, arm=replace(study.arm, joints=without_distance)).arm)
        )
    without_torque_constant = tuple(
        replace(joint, torque_per_volt=None) for joint in study.arm.joints
    )
    with pytest.raises(InvalidInput, match="torque_per_volt"):
        links.prepare_link_signals(
            log, Arm.of(replace(study, arm=replace(study.arm, joints=without_torque_constant)).arm)
        )
    short: dict[str, FloatArray] = {k: v[:60] for k, v in log.channels.items()}
    with pytest.raises(InvalidInput, match="too few"):
        links.prepare_link_signals(
            replace(log, time=log.time[:60], channels=short), Arm.of(study.arm)
        )
