"""Identified arms with known values for the tests of servo designs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, Parameter, Study
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.keys import Values
from strainwave.export import IdentifiedArm
from strainwave.tune.closed_loop import SampledPlants
from strainwave.tune.observer import Observer
from strainwave.virtual import scara

REL_STD = 0.03
"""Relative standard deviation of every parameter."""


def identified(study: Study, values: Values) -> IdentifiedArm:
    """A result with these values, known to `REL_STD`."""
    parameters = tuple(
        Parameter(name, joint, value, REL_STD * abs(value), "", "tuned", None)
        for (name, joint), value in values.items()
    )
    return IdentifiedArm(study, parameters, "result.json")


def rig(encoder_counts: int | None = None, disks: int = 3) -> IdentifiedArm:
    """The built-in rig with linear gears."""
    study = scara.STIFF.study(Path("nowhere"), "linear")
    joints = tuple(replace(each, encoder_counts=encoder_counts) for each in study.arm.joints)
    study = replace(study, arm=study.arm.with_joints(joints))
    return identified(study, scara.STIFF.parameters(disks, "linear"))


def vertical_rig() -> IdentifiedArm:
    """The rig in a vertical plane: it stands upright at (pi / 2, 0)."""
    study = scara.STIFF.study(Path("nowhere"), "linear")
    study = replace(study, arm=change_arm_keys(study.arm, gravity=9.81))
    values = scara.STIFF.parameters(1, "linear")
    moment = values["gamma", None] / scara.STIFF.link_length[0]
    values |= {("gravity_torque_1", None): 31.0, ("gravity_torque_2", None): 9.81 * moment}
    return identified(study, values)


def correct(
    observer: Observer, x: FloatArray, readings: FloatArray, interaction: float
) -> FloatArray:
    """Estimate (n,) of a Kalman filter from its prediction and the readings."""
    expected = observer.C @ x + observer.D * interaction
    return np.asarray(x + observer.L @ (readings - expected))


def predict(
    observer: Observer, estimate: FloatArray, voltage: float, interaction: float
) -> FloatArray:
    """Prediction (n,) for the next period."""
    return np.asarray(observer.A @ estimate + observer.B @ (voltage, interaction))


def state_at_rest(observer: Observer, motor_angle: float, link_angle: float) -> FloatArray:
    """State (n,) at rest without known torques."""
    x = np.zeros(len(observer.A))
    x[[0, 2]] = motor_angle, link_angle
    return x


def exact_responses(sampled: SampledPlants, z: ComplexArray) -> ComplexArray:
    """C (z - A)^-1 B of all plants, (n_plants, n_omega, n_joints, n_joints)."""
    system = z[:, None, None] * np.eye(sampled.A.shape[1]) - sampled.A[:, None]
    inputs = np.broadcast_to(sampled.B[:, None], (*system.shape[:3], sampled.B.shape[2]))
    return np.asarray(sampled.motors @ np.linalg.solve(system, inputs.astype(complex)))


def loops_of(responses: ComplexArray, controllers: ComplexArray) -> ComplexArray:
    """Loops (n_joints, n_plants, n_omega) of responses, each with the other loops closed.

    With all loops closed, y = T u with T = (1 + P C)^-1 P; opening a loop removes T_ii C_i.
    """
    by_input = controllers.T[:, None, :]
    closed = np.linalg.solve(np.eye(len(controllers)) + responses * by_input, responses)
    own = np.diagonal(closed, axis1=2, axis2=3) * controllers.T
    return np.moveaxis(own / (1.0 - own), 2, 0)
