"""How late one channel is against another, to a fraction of a sample.

Neither a spring's phase nor a sensor's scale must pass for a delay. Both relations here therefore
hold exactly for an arm with elastic joints, with a delay beside unknown coefficients.
"""

from __future__ import annotations

import numpy as np

from strainwave.domain import Delay, FloatArray, LinkSignals
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate, low_pass

_LOWEST = 2.0  # [Hz] below, friction and drift rule
_SMOOTH_HZ = 100.0  # third differences above are noise
_SHARE = 0.9  # of the link's power that lies in the band
_REACH = 1.1  # band over the frequency below which that share lies
_DRIVE_REACH = 0.5  # band over the encoder's
_FEW_LINES = 12
_MOST_STANDING = 0.2  # of the record, above which stiction passes for a delay
_KNEES = (0.25, 0.7, 2.0)  # widths, in deviations of the torque, of the bent springs
# [rad] at the top of the band: what D_L and bent springs make of the first relation, and what dry
# friction and a lag of the link's sensor make of the other. Clean arms showed up to twice as much.
_SENSOR_PHASE, _DRIVE_PHASE = 0.015, 0.05
_HANN_CORRELATION = 1.5  # a Hann window spreads one line over this many independent ones


def sensor_delay(signals: LinkSignals, arm: Arm, i: int) -> Delay | None:
    """How late a link's acceleration is against its motor's encoder.

    The spring gives n ddtheta_M - ddtheta_L = (1/k) T'' - (d_G/k^2) T''' + ..., with the link
    torques T linear in the base parameters; a delay D of the link's sensor adds D times the slope
    of its share of ddtheta_L, and a scale 1 + e of it takes e times that share away. All
    coefficients are found at once by least squares over the spectral lines in which the link moves.
    A spring with a curve adds nonlinear functions of T. They do where this joint was excited; a
    neighbour's torque bends otherwise, and would pass for half a sample. D_L makes D too large by
    d_L / k.

    Parameters
    ----------
    signals : LinkSignals
    arm : Arm
    i : int
        Joint, from 0.

    Returns
    -------
    Delay or None
        None where the link has no sensor of its own, the record has too few lines, or a spring
        with a curve was wound by another joint's excitation alone.
    """
    law, excited = arm.joints[i].law, signals.experiment.joint
    if signals.sources[i] in ("motor", "deflection") or not law.elastic:
        return None
    if law.is_curved and excited not in (None, i + 1):
        return None
    T = signals.sample_time
    n = arm.gear_ratios[i]
    motor = n * differentiate(signals.motor_velocity[:, i], T)
    cutoff = min(_SMOOTH_HZ, 0.1 / T)
    link = low_pass(signals.link_acceleration, cutoff, T)
    torque = _torque_columns(signals, arm, link)[:, i]
    target = low_pass(motor, cutoff, T) - link[:, i]
    band = (_LOWEST, _REACH * _top(link[:, i], T))
    shares = _shares(signals, arm, link, i)
    columns = [_slope(shares, T, 1), shares, _slope(torque, T, 2), _slope(torque, T, 3)]
    found = _regress(target, np.column_stack(columns), T, band, 1.0)
    if found is not None and law.is_curved:
        wound = torque @ found[0][2 * shares.shape[1] :][: torque.shape[1]]
        wound = wound - wound.mean()
        bent = np.column_stack([np.tanh(wound / (k * (wound.std() + 1e-300))) for k in _KNEES])
        columns += [_slope(bent, T, 2), _slope(bent, T, 3)]
        found = _regress(target, np.column_stack(columns), T, band, 1.0)
    return None if found is None else _delay(found[0][0], found[1][0], _SENSOR_PHASE, band)


def drive_delay(signals: LinkSignals, arm: Arm, i: int, band_hz: float) -> Delay | None:
    """How late a motor answers the torque in the log.

    m_M ddtheta_M = (u - D u') - n T - d_M dtheta_M - f sgn(dtheta_M), a regression of the motor's
    acceleration. Only where this joint was excited: a servo's voltage follows the encoder's noise.

    Parameters
    ----------
    signals : LinkSignals
    arm : Arm
    i : int
        Joint, from 0.
    band_hz : float [Hz]
        Up to which the encoder is above its noise.

    Returns
    -------
    Delay or None
        None where the joint was not excited, the motor often stands, or lines are too few.
    """
    experiment = signals.experiment
    if experiment.use not in ("frequency", "sweep") or experiment.joint not in (None, i + 1):
        return None
    if np.mean(np.abs(signals.direction[:, i]) < 0.5) > _MOST_STANDING:
        return None
    T = signals.sample_time
    u = signals.motor_torque[:, i]
    torque = _torque_columns(signals, arm, signals.link_acceleration)[:, i]
    friction = np.column_stack([signals.motor_velocity[:, i], signals.direction[:, i]])
    columns = np.column_stack([differentiate(u, T), u, friction, torque])
    motor = differentiate(signals.motor_velocity[:, i], T)
    band = (_LOWEST, _DRIVE_REACH * band_hz)
    found = _regress(motor, columns, T, band, 0.0)
    if found is None or found[0][1] == 0.0:
        return None
    value, std = found
    return _delay(-value[0] / value[1], std[0] / value[1], _DRIVE_PHASE, band)


def _delay(value: float, std: float, phase: float, band: tuple[float, float]) -> Delay:
    """With a deviation for what the relation itself leaves out."""
    return Delay(float(value), float(np.hypot(std, phase / (2.0 * np.pi * band[1]))))


def _shares(signals: LinkSignals, arm: Arm, link: FloatArray, i: int) -> FloatArray:
    """What each sensor gives to a relative acceleration: this link's own, then the base's.

    A gyro and an accelerometer of link 2 read the motion of link 1 as well, which (9) takes off.
    """
    own = link[:, i]
    if i == 0 or signals.sources[i] not in ("accelerometer", "gyro"):
        return own[:, None]
    reach: FloatArray = np.ones(len(link))
    joint = arm.joints[i]
    if signals.sources[i] == "accelerometer" and joint.accelerometer_distance:
        lever = (arm.link_length or 0.0) / joint.accelerometer_distance
        reach = 1.0 + lever * np.cos(signals.link_angle[:, 1])
    base = reach * link[:, 0]
    if signals.sources[0] == "motor":
        return (own + base)[:, None]
    return np.column_stack([own + base, -base])


def _torque_columns(signals: LinkSignals, arm: Arm, acceleration: FloatArray) -> FloatArray:
    """Link torques per base parameter, without gravity's: (n_samples, n_joints, n_base)."""
    columns = arm.base_regressor(signals.link_angle, signals.link_velocity, acceleration)
    inertial = [k for k, (name, _) in enumerate(arm.base_names) if not name.startswith("gravity")]
    return columns[:, :, inertial]


def _slope(signal: FloatArray, sample_time: float, order: int) -> FloatArray:
    for _ in range(order):
        signal = differentiate(signal, sample_time)
    return signal


def _top(acceleration: FloatArray, sample_time: float) -> float:
    """Frequency below which most of a link's velocity lies [Hz]."""
    power = np.abs(np.fft.rfft(np.hanning(len(acceleration)) * acceleration)) ** 2
    frequency = np.fft.rfftfreq(len(acceleration), sample_time)
    moved = frequency > _LOWEST
    share = np.cumsum(power[moved] / frequency[moved] ** 2)
    return float(frequency[moved][np.searchsorted(share, _SHARE * share[-1])])


def _regress(
    target: FloatArray, columns: FloatArray, T: float, band: tuple[float, float], roll: float
) -> tuple[FloatArray, FloatArray] | None:
    """Real coefficients over the spectral lines of a band, each line over frequency^roll.

    Returns
    -------
    value, std : (n_columns,)
        With the deviations of a heteroscedastic residual.
    """
    frequency = np.fft.rfftfreq(len(target), T)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    if inside.sum() < columns.shape[1] + _FEW_LINES:
        return None
    window = np.hanning(len(target))[:, None]
    lines = np.fft.rfft(window * np.column_stack([target, columns]), axis=0)[inside]
    lines /= frequency[inside, None] ** roll
    stacked = np.concatenate([lines.real, lines.imag])
    scale = np.linalg.norm(stacked, axis=0)
    scale[scale == 0.0] = np.inf
    scaled = stacked / scale
    inverse = np.linalg.pinv(scaled[:, 1:], rcond=1e-5)
    value = inverse @ scaled[:, 0]
    residual = scaled[:, 0] - scaled[:, 1:] @ value
    deviation = np.sqrt(((inverse * residual) ** 2).sum(axis=1)) * _HANN_CORRELATION
    factor = scale[0] / scale[1:]
    return value * factor, deviation * factor
