"""Law from the voltage commands of a drive to the torque of its motor, and its inverse.

The drive holds each command u until the next time stamp. Its current loop is a first-order lag of
the motor torque x,

    tau_c dx/dt = e u - x,    tau_c = 1 / (2 pi current_loop_hz).

e is `torque_per_volt` [N m/V]. Without `current_loop_hz` the lag is omitted.

Torques sampled faster than a servo commands -> the held commands behind them.

A drive samples its torque at a time of its own, d after the time stamp. Between the ticks of the
servo the command is constant, so with the current loop's time constant tau_c a torque sampled s
after a tick is

    x = (1 - exp(-s / tau_c)) u_j + exp(-s / tau_c) u_(j-1).

Each tick has at least two samples, which determine d and the commands by least squares. Without d,
the commands of [`DriveLaw.voltage`] would begin up to a sample early, and spread over two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from strainwave.domain import FloatArray, IntArray, Joint, Lag
from strainwave.numerics.filters import apply_lags, apply_lags_without_aliases


@dataclass(frozen=True, slots=True)
class DriveLaw:
    """Law of one joint's drive. Signals are (n_samples,)."""

    torque_per_volt: float  # e [N m/V]; 1 if commands are torques
    current_loop_hz: float | None

    @classmethod
    def of(cls, joint: Joint) -> Self:
        """Law of a joint; without `torque_per_volt`, commands are torques."""
        return cls(joint.torque_per_command, joint.current_loop_hz)

    @property
    def current_loop(self) -> tuple[Lag, ...]:
        """Low-pass of the current loop, if there is one."""
        return (Lag(1, self.current_loop_hz),) if self.current_loop_hz else ()

    def command(self, voltage: FloatArray) -> FloatArray:
        """Commanded torque e u, constant between time stamps."""
        return self.torque_per_volt * voltage

    def torque(self, voltage: FloatArray, sample_time: float) -> FloatArray:
        """Motor torque at the time stamps.

        The mean over one sampling period centred on a time stamp is the mean of the commands before
        and after it, which is a delay of half a sample. The lag is solved exactly for an input that
        is linear between time stamps.
        """
        before = np.r_[voltage[:1], voltage[:-1]]
        return apply_lags(self.command(0.5 * (voltage + before)), self.current_loop, sample_time)

    def torque_without_aliases(
        self, voltage: FloatArray, sample_time: float, lags: Sequence[Lag] = ()
    ) -> FloatArray:
        """Motor torque behind low-passes, without aliases of components above Nyquist."""
        passed = [*self.current_loop, *lags]
        return apply_lags_without_aliases(self.command(voltage), passed, sample_time, "held")

    def voltage(self, torque: FloatArray, sample_time: float) -> FloatArray:
        """Held commands that produce motor torques at the time stamps.

        With a = exp(-T / tau_c), e u_k = (x_(k+1) - a x_k) / (1 - a). Without a current loop, the
        torque is smooth between samples: `smooth_commands`.
        """
        if self.current_loop_hz is None:
            return smooth_commands(torque) / self.torque_per_volt
        following = np.append(torque[1:], torque[-1])
        decay = np.exp(-2.0 * np.pi * self.current_loop_hz * sample_time)
        return np.asarray((following - decay * torque) / (1.0 - decay) / self.torque_per_volt)

    def hold_change(self, torque: FloatArray) -> FloatArray:
        """Change of `voltage` if each torque is a command, held until the next sample.

        Zero with a current loop, which lets no torque jump.
        """
        if self.current_loop_hz is not None:
            return np.zeros(len(torque))
        return (torque - smooth_commands(torque)) / self.torque_per_volt


def smooth_commands(torque: FloatArray) -> FloatArray:
    """Held torques that move an inertia as a smooth torque does which passes through the samples.

    At the samples, the angle of an inertia under held torques is (z + 1) / (z - 1)^2 T^2 / 2 of
    them. The filter divides this by -1 / w^2, half a sample ahead: with x = w T / 2 its gain is
    sin^2 x / (x^2 cos x), up to x^8. Straight lines between samples lose (w T)^2 / 6.
    """
    reach = len(_SMOOTH_TAPS)
    around = np.pad(torque, (reach - 1, reach), mode="edge")
    return np.convolve(around, (*_SMOOTH_TAPS[::-1], *_SMOOTH_TAPS), mode="valid")


# of the samples on one side of the middle of a period; those of the other side are equal
_SMOOTH_TAPS = (4861.0 / 7560.0, -201.0 / 1120.0, 1237.0 / 30240.0, -67.0 / 15120.0)

_OFFSETS_PER_PERIOD = 40  # of the grid for d; the misfit is smooth between its points
# maximum misfit relative to the changes from sample to sample; smooth torques fit any offset
_MAX_MISFIT_SHARE = 0.1
_TICK_ROUNDING = 1e-9  # ticks by which a sample at a tick may seem early
_MIN_WEIGHT = 1e-12  # of the diagonal, for ticks without samples


@dataclass(frozen=True, slots=True)
class _ServoTicks:
    """Samples of a torque, the ticks of the servo, and the lag between command and torque."""

    sample_time: float  # [s]
    period: float  # [s]
    lag: float  # tau_c [s]

    def commands(self, torque: FloatArray, offset: float) -> tuple[FloatArray, FloatArray]:
        """Commands at the ticks, from the one before the record, and the misfit of the samples."""
        from scipy.linalg.lapack import dptsv

        time = self.sample_time * np.arange(len(torque)) + offset
        tick = np.floor(time / self.period + _TICK_ROUNDING).astype(int)
        new = -np.expm1(-(time - tick * self.period) / self.lag)
        at = tick - tick[0] + 1
        old = 1.0 - new

        def sums(by: IntArray, weight: FloatArray) -> FloatArray:
            return np.asarray(np.bincount(by, weight, minlength=at[-1] + 1), dtype=np.float64)

        diagonal = sums(at, new**2) + sums(at - 1, old**2) + _MIN_WEIGHT
        right = sums(at, new * torque) + sums(at - 1, old * torque)
        # tridiagonal and well conditioned: the last sample of a tick is nearly its command
        commands = dptsv(diagonal, sums(at, new * old)[1:], right)[2]
        return commands, torque - (new * commands[at] + old * commands[at - 1])

    def held(self, torque: FloatArray, offset: float) -> FloatArray:
        """Command in the period after each sample; ticks are at the nearest time stamps."""
        commands, _ = self.commands(torque, offset)
        first = np.floor(offset / self.period + _TICK_ROUNDING)
        whole = round(offset / self.sample_time)
        middle = (np.arange(len(torque)) + whole + 0.5) * self.sample_time
        at = np.floor(middle / self.period).astype(int) - int(first) + 1
        return np.asarray(commands[np.clip(at, 0, len(commands) - 1)])


def held_commands(
    torques: Sequence[FloatArray], sample_time: float, period: float, current_loops: Sequence[float]
) -> list[FloatArray] | None:
    """Commands [N m] in the period after each sample, one array per torque.

    `period` [s] is that of the servo, a multiple of `sample_time`; `current_loops` are bandwidths
    [Hz]. Returns None if the torques do not show when they were sampled, or are not those of held
    commands.
    """
    from scipy.optimize import minimize_scalar

    clocks = [_ServoTicks(sample_time, period, 1.0 / (2.0 * np.pi * hz)) for hz in current_loops]
    grid = period * (np.arange(_OFFSETS_PER_PERIOD) / _OFFSETS_PER_PERIOD - 0.5)
    pairs = list(zip(clocks, torques, strict=True))
    misfits = np.array([[np.std(c.commands(x, d)[1]) for d in grid] for c, x in pairs])
    changes = np.array([np.std(np.diff(torque)) for torque in torques])
    decisive = int(np.argmin(misfits.min(axis=1) / np.maximum(changes, 1e-300)))
    clock, torque = pairs[decisive]
    if misfits[decisive].min() >= _MAX_MISFIT_SHARE * changes[decisive]:
        return None
    near, step = grid[np.argmin(misfits[decisive])], grid[1] - grid[0]
    offset = minimize_scalar(
        lambda d: float(np.std(clock.commands(torque, d)[1])),
        bounds=(near - step, near + step),
        method="bounded",
    ).x
    return [clock.held(torque, offset) for clock, torque in pairs]
