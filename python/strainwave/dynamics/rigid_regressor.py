"""The rigid arm's torques, linear in its parameters: (5)-(7), (S2), (S3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray, Study
from strainwave.dynamics.simulation import build_arm

FRICTION_COLUMNS = 3
"""Viscous, Coulomb, offset: the last columns of each joint."""


@dataclass(frozen=True, slots=True)
class Column:
    """What one unknown is: its name, joint and unit."""

    name: str
    joint: int | None
    unit: str

    def __str__(self) -> str:
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


def columns_of(study: Study) -> tuple[Column, ...]:
    """The rigid model's unknowns: those of the body first, then friction joint by joint.

    Parameters
    ----------
    study : Study

    Returns
    -------
    tuple of Column
    """
    found = _body(study)
    for number, joint in enumerate(study.arm.joints, start=1):
        revolute = joint.motion == "revolute"
        alone = study.arm.kind == "single-joint" and joint.spring == "rigid"
        viscous = "motor_viscous_friction" if alone else "total_viscous_friction"
        found += [
            Column(viscous, number, "N m s/rad" if revolute else "N s/m"),
            Column("motor_coulomb_friction", number, "N m" if revolute else "N"),
            Column("friction_offset", number, "N m" if revolute else "N"),
        ]
    return tuple(found)


def n_body(study: Study) -> int:
    """Unknowns that are not friction."""
    return len(_body(study))


def _body(study: Study) -> list[Column]:
    if study.arm.kind == "single-joint":
        revolute = study.arm.joints[0].motion == "revolute"
        body = [Column("inertia", 1, "kg m^2" if revolute else "kg")]
        if study.arm.gravity is not None:
            body.append(Column("gravity_torque_1", None, "N m" if revolute else "N"))
        return body
    body = [
        Column("rigid_inertia", 1, "kg m^2"),
        Column("motor_inertia", 2, "kg m^2"),
        Column("beta", None, "kg m^2"),
        Column("gamma", None, "kg m^2"),
    ]
    if study.arm.gravity is not None:
        body += [Column(f"gravity_torque_{i}", None, "N m") for i in (1, 2)]
    return body


def gear_ratios(study: Study) -> FloatArray:
    """n, link turns per motor turn: (n_joints,)."""
    return np.array([joint.gear_ratio for joint in study.arm.joints])


def body_regressor(
    study: Study, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Motor torques per inertial and gravity parameter, friction left out: (S2), (S3).

    The core's link-side regressor, brought to the motors: alpha and joint 1's motor are one
    parameter, and the motor of joint 2 has a column of its own.

    Parameters
    ----------
    study : Study
    angle, velocity, acceleration : (n_samples, n_joints) [rad, rad/s, rad/s^2]
        Of the links; the second relative to the first.

    Returns
    -------
    (n_samples, n_joints, n_body)
        Columns as in `columns_of`.
    """
    n = gear_ratios(study)
    arm = build_arm(study)
    names = [name for name, _ in arm.parameter_names]
    phi = arm.base_regressor(*(np.ascontiguousarray(x) for x in (angle, velocity, acceleration)))
    phi = n[:, None] * phi
    if study.arm.n_joints == 1:
        phi[:, 0, 0] = acceleration[:, 0] / n[0]  # the inertia is the motor's side's
        return phi[:, :, : n_body(study)]
    motor = np.zeros((*angle.shape, 1))
    motor[:, 1, 0] = acceleration[:, 1] / n[1]
    base = [names.index(name) for name in ("alpha", "beta", "gamma")]
    base += [names.index(f"gravity_torque_{i}") for i in (1, 2) if study.arm.gravity is not None]
    return np.concatenate([phi[:, :, base[:1]], motor, phi[:, :, base[1:]]], axis=2)
