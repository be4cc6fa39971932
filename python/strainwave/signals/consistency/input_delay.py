"""Delay between a motor's logged command and its encoder, by the phase of its response.

Above the gears' resonances a motor responds to its torque like a free inertia. The links follow
through the springs, and their reaction falls with 1/s^2: with the motor angles of all joints,

    u exp(s D) = m s^2 theta + d s theta + f sgn(s theta) + sum_j (k_j0 + k_j1/s + ... ) theta_j

where D is the delay of the logged command and the sum is the springs' series in 1/s. The
coefficients are free, so that neither scales nor gains change D. Only records in which the
joint's command is independent of its encoder show D: a servo's output also contains the encoder's
noise, and would show the delay of the servo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import ComplexArray, Delay, FloatArray, Lag, Log
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import band_passes, noise_deviation, signal_band, unaliased
from strainwave.signals.channels import directions, torque_channel

LONGEST_DELAY = 0.024
"""[s] Delays are searched between both signs of this."""
_DELAY_STEP = 2e-4  # [s] of the search, refined by a parabola; 200 Hz turns by 0.25 rad
_BAND_SHARE = 0.5  # top of the band over the frequency at which the encoder meets its noise
_BAND_RATIOS = (2.0, 5.0)  # top over bottom; the wider one where resonances lie below
_SPRING_ORDERS = (0, 1, 2, 3, 4)  # of 1/s
_MIN_LINES = 60  # spectral lines of a regression with some 14 coefficients
_MIN_EXPLAINED = 0.95  # share of the command; healthy drawn arms with less were 8 ms off
_MIN_IMPROVEMENT = 2.0  # of the unexplained share; noise alone gave up to 1.7 on drawn arms
_PHASE_FLOOR = 0.03  # [rad] at the top of the band, left by friction and unmodelled lags


@dataclass(frozen=True, slots=True)
class DelayProfile:
    """Unexplained share of one record's command against its delay."""

    record: str
    unexplained: FloatArray  # (n_delays,) over `delays()`
    lines: int
    band_hz: float  # top
    sample_time: float  # [s] of the log


def delays() -> FloatArray:
    """The delays of a profile [s]."""
    count = round(LONGEST_DELAY / _DELAY_STEP)
    return np.asarray(_DELAY_STEP * np.arange(-count, count + 1), dtype=np.float64)


def delay_profile(log: Log, arm: Arm, i: int) -> DelayProfile | None:
    """The profile of joint i, from 0; None where the record does not show the delay."""
    T, n = log.sample_time, arm.n_joints
    angle = np.column_stack([log.channels[f"theta_m{k}"] for k in range(1, n + 1)])
    top = _BAND_SHARE * signal_band(angle[:, i], T)
    noise = np.array([noise_deviation(each) for each in angle.T])
    direction = directions(angle, noise, arm, T)[:, i]
    signals = np.column_stack([angle, direction, _command(log, arm, i)])
    found = [_profile(log, signals, i, (top / ratio, top)) for ratio in _BAND_RATIOS]
    known = [each for each in found if each is not None]
    return min(known, key=lambda each: float(each.unexplained.min()), default=None)


def pooled_delay(profiles: Sequence[DelayProfile]) -> Delay | None:
    """The delay of largest likelihood over several records; None where they do not show it."""
    clear = [p for p in profiles if p.unexplained.min() < 1.0 - _MIN_EXPLAINED]
    if not clear:
        return None
    cost = np.sum([p.lines * np.log(p.unexplained) for p in clear], axis=0)
    best, grid = int(np.argmin(cost)), delays()
    zero = len(grid) // 2
    lines = sum(p.lines for p in clear)
    if best in (0, len(grid) - 1) or cost[zero] - cost[best] < lines * np.log(_MIN_IMPROVEMENT):
        return None
    # near its minimum the unexplained share, not its logarithm, is a parabola
    share = np.sum([p.lines * p.unexplained / p.unexplained.min() for p in clear], axis=0)
    left, middle, right = (float(share[k]) for k in (best - 1, best, best + 1))
    vertex = 0.5 * (left - right) / (left - 2.0 * middle + right)
    floor = _PHASE_FLOOR / (2.0 * np.pi * max(p.band_hz for p in clear))
    return Delay(float(grid[best]) + vertex * _DELAY_STEP, floor)


def _command(log: Log, arm: Arm, i: int) -> FloatArray:
    """The motor's torque as the drive makes it of the log's command, but for its scale."""
    name, joint = torque_channel(log, i + 1), arm.joints[i]
    values = log.channels[name]
    if name == f"torque{i + 1}":
        return values
    loop = [Lag(1, joint.current_loop_hz)] if joint.current_loop_hz else []
    return unaliased(values, loop, log.sample_time, "held")


def _profile(
    log: Log, signals: FloatArray, i: int, band: tuple[float, float]
) -> DelayProfile | None:
    T, n = log.sample_time, signals.shape[1] - 2
    edge = int(np.ceil(1.5 / (band[0] * T)))  # of the band-pass, at either end
    if len(signals) < 4 * edge:
        return None
    springs = [(j, order) for j in range(n) for order in _SPRING_ORDERS]
    wanted = [(n + 1, 0), (i, -2), (i, -1), (n, 0), *springs]
    passed = band_passes(signals, wanted, *band, T)[edge:-edge]
    frequency = np.fft.rfftfreq(len(passed), T)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    if inside.sum() < _MIN_LINES:
        return None
    lines = np.fft.rfft(np.hanning(len(passed))[:, None] * passed, axis=0)[inside]
    columns = _stacked(lines[:, 1:])
    size = np.linalg.norm(columns, axis=0)
    total = float(np.sum(np.abs(lines[:, 0]) ** 2))
    if total == 0.0 or size.max() == 0.0:
        return None
    columns = columns[:, size > 0.0] / size[size > 0.0]
    basis, weight, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, weight > 1e-7 * weight[0]]
    turned = lines[:, :1] * np.exp(2j * np.pi * np.outer(frequency[inside], delays()))
    explained = np.sum((basis.T @ _stacked(turned)) ** 2, axis=0) / total
    unexplained = np.maximum(1.0 - explained, 1e-9)
    return DelayProfile(log.name, unexplained, int(inside.sum()), band[1], T)


def _stacked(lines: ComplexArray) -> FloatArray:
    return np.concatenate([lines.real, lines.imag])
