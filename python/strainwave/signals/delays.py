"""Delays between channels with sub-sample resolution, and their combination per link sensor.

The regressions hold exactly for an arm with elastic joints. A delay is estimated together with the
unknown coefficients, so that the phase of a spring or the scale of a sensor does not bias it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from strainwave.domain import Delay, Diagnostic, FloatArray, LinkSignals, Place
from strainwave.domain.arm.link_sensors import ConstantKind, LinkSensor
from strainwave.domain.arm.link_sensors.single_axis import Accelerometer, Gyro, LinkEncoder
from strainwave.domain.keys import Key
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.domain.results.signals import LinkSource
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.signals.link_readings import LinkReading

_SENSORS: Mapping[LinkSource, type[LinkSensor]] = {
    "accelerometer": Accelerometer,
    "encoder": LinkEncoder,
    "gyro": Gyro,
}
_SIDES = ("ahead of", "behind")  # of a sensor with a negative and a positive delay
_MIN_SIGNIFICANCE = 4.0  # standard deviations above which a delay is significant


def estimate_sensor_delays(records: Sequence[LinkSignals], n_joints: int) -> tuple[Delay, ...]:
    """Estimate the delay of each link sensor from all records; zero if it is not significant.

    The estimate is the weighted mean over the records. The errors of the regression model are
    common to all records, so the standard deviation of the mean is at least the smallest one of the
    records; it is larger if the records scatter more. Returns one delay per joint.
    """
    combined = [Delay(0.0, 0.0)] * n_joints
    for i in range(n_joints):
        delays = [d for record in records if (d := record.links[i].sensor_delay) is not None]
        if delays:
            value, std = np.array([d.value for d in delays]), np.array([d.std for d in delays])
            weight = std**-2.0 / np.sum(std**-2.0)
            mean = float(weight @ value)
            scatter = float(np.sqrt(weight @ (value - mean) ** 2 / len(value)))
            combined_std = max(float(np.min(std)), scatter)
            is_significant = abs(mean) > _MIN_SIGNIFICANCE * combined_std
            combined[i] = Delay(mean if is_significant else 0.0, combined_std)
    return tuple(combined)


def build_misalignment_warnings(
    delay: Delay | None, channel: str, place: Place
) -> Iterator[Diagnostic]:
    """Yield a warning if a channel is significantly delayed relative to the motor encoder."""
    if delay is None or abs(delay.value) < _MIN_SIGNIFICANCE * delay.std:
        return
    size, std, side = abs(delay.value), delay.std, _SIDES[delay.value > 0.0]
    yield Diagnostic("misaligned", place, channel=channel, delay=size, std=std, side=side)


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
        half, size = CI95_STDS * delay.std, abs(delay.value)
        side = _SIDES[delay.value > 0.0]
        yield Diagnostic("sensor-delay", Place(joint=joint), delay=size, half=half, side=side)


_MIN_FREQUENCY_HZ = 2.0  # [Hz] lower band edge; friction and drift dominate below it
_MAX_CUTOFF_HZ = 100.0  # [Hz] largest low-pass cutoff; third differences above it are noise
_BAND_POWER_SHARE = 0.9  # share of the power of the link velocity that defines its band
# upper band edge over the frequency below which `_BAND_POWER_SHARE` of the power lies
_BAND_MARGIN = 1.1
_DRIVE_BAND_RATIO = 0.5  # upper band edge of the drive relative to the band of the encoder
_MIN_EXTRA_LINES = 12  # minimum number of spectral lines minus the number of coefficients
_MAX_STANDSTILL_SHARE = 0.2  # maximum share of a record at standstill; stiction resembles a delay
_TANH_WIDTHS = (0.25, 0.7, 2.0)  # widths of the tanh terms, in standard deviations of the torque
# [rad] phase error at the upper band edge, one standard deviation. Sensor: due to D_L and nonlinear
# springs. Drive: due to Coulomb friction and the lag of the link sensor. Arms without delay
# showed phase errors of up to twice these values.
_SENSOR_PHASE_ERROR, _DRIVE_PHASE_ERROR = 0.015, 0.05
_HANN_STD_FACTOR = 1.5  # factor on standard deviations: a Hann window correlates adjacent lines


def estimate_sensor_delay(signals: LinkSignals, arm: Arm, reading: LinkReading) -> Delay | None:
    """Estimate the delay of a link acceleration relative to the motor encoder of joint i (from 0).

    The spring gives

        n ddtheta_M - ddtheta_L = (1/k) T'' - (d_G/k^2) T''' + ...,

    with the link torques T linear in the base parameters. A delay D of the link sensor adds D times
    the derivative of its contribution to ddtheta_L. A scale 1 + e subtracts e times that
    contribution. Least squares over the spectral lines in which the link moves estimates all
    coefficients at once. D_L increases D by d_L / k.

    For a nonlinear spring, the regression includes nonlinear functions of T. They are accurate only
    if this joint is excited; with another joint excited, the delay would be biased by half a
    sample.

    Returns None if the link has no sensor, if the record has too few spectral lines, or if the
    spring is nonlinear and only another joint is excited.
    """
    i = reading.joint - 1
    law, excited = arm.joints[i].law, signals.experiment.joint
    if reading.source in ("motor", "deflection") or not law.elastic:
        return None
    if law.is_curved and excited not in (None, i + 1):
        return None
    T = signals.sample_time
    motor_acceleration = arm.links_of(differentiate(signals.motor_velocity, T))[:, i]
    cutoff = min(_MAX_CUTOFF_HZ, 0.1 / T)
    link_acceleration = low_pass(signals.link_acceleration, cutoff, T)
    torque = _torque_columns(signals, arm, link_acceleration)[:, i]
    target = low_pass(motor_acceleration, cutoff, T) - link_acceleration[:, i]
    band = (_MIN_FREQUENCY_HZ, _BAND_MARGIN * _upper_frequency(link_acceleration[:, i], T))
    contributions = _sensor_contributions(signals, arm, link_acceleration, reading)
    columns = [
        _differentiate_repeatedly(contributions, T, 1),
        contributions,
        _differentiate_repeatedly(torque, T, 2),
        _differentiate_repeatedly(torque, T, 3),
    ]
    estimate = _fit_spectral_lines(target, np.column_stack(columns), T, band, 1.0)
    if estimate is not None and law.is_curved:
        spring_torque = torque @ estimate[0][2 * contributions.shape[1] :][: torque.shape[1]]
        spring_torque = spring_torque - spring_torque.mean()
        nonlinear = np.column_stack(
            [np.tanh(spring_torque / (k * (spring_torque.std() + 1e-300))) for k in _TANH_WIDTHS]
        )
        columns += [
            _differentiate_repeatedly(nonlinear, T, 2),
            _differentiate_repeatedly(nonlinear, T, 3),
        ]
        estimate = _fit_spectral_lines(target, np.column_stack(columns), T, band, 1.0)
    if estimate is None:
        return None
    return _delay_with_model_error(estimate[0][0], estimate[1][0], _SENSOR_PHASE_ERROR, band)


def estimate_drive_delay(signals: LinkSignals, arm: Arm, i: int, band_hz: float) -> Delay | None:
    """Estimate the delay of the response of motor i (from 0) to the torque in the log.

    The regression of the motor acceleration is

        m_M ddtheta_M = (u - D u') - n T - d_M dtheta_M - f sgn(dtheta_M).

    It requires that this joint is excited, because the voltage of a servo follows the encoder
    noise. `band_hz` is the frequency up to which the encoder signal exceeds its noise. Returns None
    if the joint is not excited, if the motor is often at standstill, or if there are too few
    spectral lines.
    """
    experiment = signals.experiment
    if experiment.use not in ("frequency", "sweep") or experiment.joint not in (None, i + 1):
        return None
    if np.mean(np.abs(signals.direction[:, i]) < 0.5) > _MAX_STANDSTILL_SHARE:
        return None
    T = signals.sample_time
    u = signals.motor_torque[:, i]
    torque = _torque_columns(signals, arm, signals.link_acceleration)[:, i]
    friction = np.column_stack([signals.motor_velocity[:, i], signals.direction[:, i]])
    columns = np.column_stack([differentiate(u, T), u, friction, torque])
    motor_acceleration = differentiate(signals.motor_velocity[:, i], T)
    band = (_MIN_FREQUENCY_HZ, _DRIVE_BAND_RATIO * band_hz)
    estimate = _fit_spectral_lines(motor_acceleration, columns, T, band, 0.0)
    if estimate is None or estimate[0][1] == 0.0:
        return None
    (slope, gain, *_), std = estimate
    return _delay_with_model_error(-slope / gain, std[0] / gain, _DRIVE_PHASE_ERROR, band)


def _delay_with_model_error(
    value: float, std: float, phase: float, band: tuple[float, float]
) -> Delay:
    """Delay whose standard deviation includes the phase error of the regression model."""
    return Delay(float(value), float(np.hypot(std, phase / (2.0 * np.pi * band[1]))))


def _sensor_contributions(
    signals: LinkSignals, arm: Arm, link: FloatArray, reading: LinkReading
) -> FloatArray:
    """Contribution of each sensor to a relative acceleration: of this link, then of those before.

    A gyro or accelerometer also measures the motion of the links before, which (9) subtracts.
    """
    i = reading.joint - 1
    relative = link[:, i]
    if i == 0 or reading.source not in ("accelerometer", "gyro"):
        return relative[:, None]
    before = reading.preceding_gains(arm, signals.link_angle) * link[:, :i] / reading.gain
    is_measured = np.array(signals.sources[:i]) != "motor"
    return np.column_stack([relative + before.sum(axis=1), -before[:, is_measured]])


def _torque_columns(signals: LinkSignals, arm: Arm, acceleration: FloatArray) -> FloatArray:
    """Link torques per base parameter without gravity: (n_samples, n_joints, n_base)."""
    angle, rest = signals.link_angle, np.zeros_like(signals.link_angle)
    columns = arm.base_regressor(angle, signals.link_velocity, acceleration)
    columns = columns - arm.base_regressor(angle, rest, rest)
    return columns[:, :, np.any(columns, axis=(0, 1))]


def _differentiate_repeatedly(signal: FloatArray, sample_time: float, order: int) -> FloatArray:
    for _ in range(order):
        signal = differentiate(signal, sample_time)
    return signal


def _upper_frequency(acceleration: FloatArray, sample_time: float) -> float:
    """Frequency [Hz] below which `_BAND_POWER_SHARE` of the power of a link velocity lies."""
    power = np.abs(np.fft.rfft(np.hanning(len(acceleration)) * acceleration)) ** 2
    frequency = np.fft.rfftfreq(len(acceleration), sample_time)
    above = frequency > _MIN_FREQUENCY_HZ
    cumulative = np.cumsum(power[above] / frequency[above] ** 2)
    return float(frequency[above][np.searchsorted(cumulative, _BAND_POWER_SHARE * cumulative[-1])])


def _fit_spectral_lines(
    target: FloatArray, columns: FloatArray, T: float, band: tuple[float, float], roll: float
) -> tuple[FloatArray, FloatArray] | None:
    """Estimate real coefficients over the spectral lines of a band, with weight frequency^-roll.

    Returns estimates and standard deviations, each (n_columns,). The standard deviations allow for
    a heteroscedastic residual. Returns None if the band has too few lines.
    """
    frequency = np.fft.rfftfreq(len(target), T)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    if inside.sum() < columns.shape[1] + _MIN_EXTRA_LINES:
        return None
    window = np.hanning(len(target))[:, None]
    lines = np.fft.rfft(window * np.column_stack([target, columns]), axis=0)[inside]
    lines /= frequency[inside, None] ** roll
    stacked = np.concatenate([lines.real, lines.imag])
    scale = np.linalg.norm(stacked, axis=0)
    scale[scale == 0.0] = np.inf
    scaled = stacked / scale
    inverse = np.linalg.pinv(scaled[:, 1:], rcond=1e-5)
    estimate = inverse @ scaled[:, 0]
    residual = scaled[:, 0] - scaled[:, 1:] @ estimate
    std = np.sqrt(((inverse * residual) ** 2).sum(axis=1)) * _HANN_STD_FACTOR
    factor = scale[0] / scale[1:]
    return estimate * factor, std * factor
