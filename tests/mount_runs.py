"""Records of virtual arms with an accelerometer on a resonant mount, simulated by SciPy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lsim

from strainwave.domain import FloatArray
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Trajectory, simulate

_OVERSAMPLING = 10  # of the motion, which lsim interpolates linearly


@dataclass(frozen=True, slots=True)
class OnMount:
    """Simulator with one accelerometer on a mount."""

    joint: int
    frequency: float  # [Hz]
    damping: float

    def __call__(
        self,
        arm: Arm,
        values: Values,
        drive: Drive,
        /,
        *,
        sample_time: float,
        samples: int,
        record: Sequence[Quantity],
    ) -> Trajectory:
        """Motion of the arm with the reading of the accelerometer on its mount."""
        fine = simulate(
            arm,
            values,
            drive,
            sample_time=sample_time / _OVERSAMPLING,
            samples=_OVERSAMPLING * samples,
            record=record,
        )
        read: dict[Quantity, FloatArray] = {name: fine[name].copy() for name in record}
        if "accelerometer" in read:
            w, at = 2.0 * np.pi * self.frequency, self.joint - 1
            felt = read["accelerometer"][:, at]
            system = ([w**2], [1.0, 2.0 * self.damping * w, w**2])
            rung = lsim(system, felt - felt[0], fine.time)[1]
            read["accelerometer"][:, at] = rung + felt[0]
        coarse = {name: samples[::_OVERSAMPLING] for name, samples in read.items()}
        return replace(fine, time=fine.time[::_OVERSAMPLING], quantities=coarse)
