"""True linear model of a joint of the built-in arm."""

from __future__ import annotations

import numpy as np

from strainwave.domain import ArmDescription, FloatArray
from strainwave.domain.gear_laws import gear_law
from strainwave.domain.keys import Values
from strainwave.dynamics.simulation import Trajectory
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, joint_of


def slopes(values: Values, joint: int) -> list[float]:
    """Slopes [N m/rad] of one gear, from the innermost."""
    return [values[name, joint] for name in gear_law("three-slope").slopes]


def joint_with(values: Values, joint: int, stiffness: float, ratio: float) -> TwoInertia:
    """One joint of the arm with a linear spring [N m/rad]."""
    link_inertia = values["beta", None]
    if joint == 1:
        link_inertia += values["alpha", None] + 2.0 * values["gamma", None]
    drive = {name: values[name, joint] for name in NAMES if (name, joint) in values}
    drive |= {"link_inertia": link_inertia, "gear_stiffness": stiffness}
    return joint_of(np.array([drive[name] for name in NAMES]), ratio)


def gear_torque(
    arm: ArmDescription, values: Values, trajectory: Trajectory, joint: int
) -> tuple[FloatArray, FloatArray]:
    """Torsion [rad] and torque [N m] (n_samples,) of a gear with three slopes."""
    column, law = joint - 1, gear_law("three-slope")
    ratio = arm.joints[column].gear_ratio
    torsion = ratio * trajectory["motor_angle"][:, column] - trajectory["link_angle"][:, column]
    return torsion, law.torque(law.of_joint(values, joint), torsion)


def equivalent(
    arm: ArmDescription, values: Values, trajectory: Trajectory, joint: int
) -> TwoInertia:
    """Joint with the equivalent stiffness, which fits the spring torque over the record best.

        k = sum(T(delta) delta) / sum(delta^2)

    delta is the torsion of the record. `values` have three slopes, or one stiffness, which is then
    k.
    """
    ratio = arm.joints[joint - 1].gear_ratio
    if ("gear_stiffness", joint) in values:
        return joint_with(values, joint, values["gear_stiffness", joint], ratio)
    torsion, torque = gear_torque(arm, values, trajectory, joint)
    return joint_with(values, joint, float(torque @ torsion / (torsion @ torsion)), ratio)
