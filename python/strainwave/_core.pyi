"""The compiled core: the arm's equations, their integration, its servo and sensors."""

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

__all__ = ["GEAR_CORNER", "Arm"]

GEAR_CORNER: float
"""Half width [rad] over which the knees of a three-slope gear are rounded."""

@final
class Arm:
    """An arm with its known constants; parameters are flat lists in `parameter_names`' order."""

    def __new__(
        cls,
        kind: str,
        springs: Sequence[str],
        gear_ratio: Sequence[float],
        *,
        torque_per_volt: Sequence[float] | None = None,
        link_length: float = 0.0,
        gravity: float = 0.0,
        current_loop_hz: Sequence[float | None] | None = None,
        encoder_counts: Sequence[float | None] | None = None,
        accelerometer_distance: Sequence[float] | None = None,
        accelerometer_hz: Sequence[float | None] | None = None,
        gyro_hz: Sequence[float | None] | None = None,
        gear_corner: float = ...,
    ) -> Arm: ...
    @property
    def n_joints(self) -> int: ...
    @property
    def parameter_names(self) -> list[tuple[str, int | None]]: ...
    def simulate(
        self,
        parameters: NDArray[np.float64],
        voltage: NDArray[np.float64],
        *,
        motor_angle: Sequence[float],
        step: float,
        steps_per_tick: int,
        steps_per_sample: int,
        samples: int,
        record: Sequence[str],
        reference: NDArray[np.float64] | None = None,
        servo: tuple[Sequence[float], Sequence[float], float, Sequence[bool]] | None = None,
        steps_per_servo: int = 1,
        motor_velocity: Sequence[float] | None = None,
        link_angle: Sequence[float] | None = None,
        link_velocity: Sequence[float] | None = None,
        initial_voltage: Sequence[float] | None = None,
    ) -> dict[str, NDArray[np.float64]]:
        """Arms in one experiment, a row of `parameters` each: (n_arms, samples, n_joints) arrays.

        `servo` is (kp, ki, limit, active joints). Raises ValueError for sizes that do not fit and
        values no arm can have, FloatingPointError where a motion leaves the finite numbers.
        """
    def base_regressor(
        self,
        angle: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Link-side torques per inertial parameter: (n_samples, n_joints, n_base)."""
    def inverse_dynamics(
        self,
        parameters: NDArray[np.float64],
        angle: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Motor torques of a links' motion behind rigid gears, (5): (n_samples, n_joints)."""
