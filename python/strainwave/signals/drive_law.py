"""Law from the voltage commands of a drive to the torque of its motor, and its inverse.

The drive holds each command u until the next time stamp. Its current loop is a first-order lag of
the motor torque x,

    tau_c dx/dt = e u - x,    tau_c = 1 / (2 pi current_loop_hz).

e is `torque_per_volt` [N m/V]. Without `current_loop_hz` the lag is omitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from strainwave.domain import FloatArray, Joint, Lag
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
        held value is the mean of both torques.
        """
        following = np.append(torque[1:], torque[-1])
        if self.current_loop_hz is None:
            return np.asarray(0.5 * (torque + following) / self.torque_per_volt)
        decay = np.exp(-2.0 * np.pi * self.current_loop_hz * sample_time)
        return np.asarray((following - decay * torque) / (1.0 - decay) / self.torque_per_volt)
