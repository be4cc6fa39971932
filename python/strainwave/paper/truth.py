"""What is true of a joint of the built-in arm, as a linear model can know it."""

from __future__ import annotations

import numpy as np

from strainwave.domain import ArmDescription, FloatArray
from strainwave.domain.parameters import Values
from strainwave.dynamics.simulation import Trajectory
from strainwave.dynamics.two_inertia import TwoInertia


def spring_torque(values: Values, joint: int, torsion: FloatArray) -> FloatArray:
    """The three-slope law of one gear.

    `torsion` (n_samples,) [rad]. Returns (n_samples,) [N m].
    """
    k1, k2, k3 = slopes(values, joint)
    t1, t2 = (values[f"gear_knee_t{i}", joint] for i in (1, 2))
    first = t1 / k1
    second = first + (t2 - t1) / k2
    size = np.abs(torsion)
    torque = (
        k1 * np.minimum(size, first)
        + k2 * np.clip(size - first, 0.0, second - first)
        + k3 * np.maximum(size - second, 0.0)
    )
    return np.asarray(np.sign(torsion) * torque)


def slopes(values: Values, joint: int) -> tuple[float, float, float]:
    """K1, K2, K3 of one gear.

    Returns [N m/rad].
    """
    return (
        values["gear_stiffness_k1", joint],
        values["gear_stiffness_k2", joint],
        values["gear_stiffness_k3", joint],
    )


def joint_with(values: Values, joint: int, stiffness: float, ratio: float) -> TwoInertia:
    """One joint of the arm on its own, with a linear spring.

    `stiffness` [N m/rad].
    """
    own = values["beta", None]
    if joint == 1:
        own += values["alpha", None] + 2.0 * values["gamma", None]
    return TwoInertia(
        motor_inertia=values["motor_inertia", joint],
        motor_viscous_friction=values["motor_viscous_friction", joint],
        link_inertia=own,
        link_viscous_friction=values["link_viscous_friction", joint],
        gear_stiffness=stiffness,
        gear_damping=values["gear_damping", joint],
        gear_ratio=ratio,
    )


def equivalent(
    arm: ArmDescription, values: Values, trajectory: Trajectory, joint: int
) -> TwoInertia:
    """The joint with the slope that fits its spring's torque over the whole run best.

    k = sum(T(delta) delta) / sum(delta^2), with the torsion delta of the run.

    `values`: With three slopes, or with one, which is then the answer. `joint`: From 1.
    """
    ratio = arm.joints[joint - 1].gear_ratio
    if ("gear_stiffness", joint) in values:
        return joint_with(values, joint, values["gear_stiffness", joint], ratio)
    column = joint - 1
    torsion = ratio * trajectory["motor_angle"][:, column] - trajectory["link_angle"][:, column]
    torque = spring_torque(values, joint, torsion)
    return joint_with(values, joint, float(torque @ torsion / (torsion @ torsion)), ratio)
