"""Linear state-space models: each joint alone as two inertias and a spring, and the whole arm.

The whole arm is at zero link angles and at rest. With the coordinates p = (theta_M, q), motor
angles of the elastic joints and all link angles, (1) and (2) are

    M ddp + D dp + K p = P tau_M

with deviations p and tau_M from equilibrium: M has the motor inertias and M(q), K the gears and the
slope of gravity dg/dq, and P transmits torques to motors behind rigid gears.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from strainwave.domain import (
    ArmDescription,
    ComplexArray,
    Diagnostic,
    FloatArray,
    Place,
    Study,
)
from strainwave.domain.arm.assumed_values import assume_missing
from strainwave.domain.arm.base_parameters import link_inertia, transmission
from strainwave.domain.keys import JointNumber, Key, Values, label_of
from strainwave.dynamics import two_inertia
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, joint_of
from strainwave.errors import InvalidInput
from strainwave.export.source import LINEAR, Export, IdentifiedArm, loss_note, losses
from strainwave.identification.closed_loop import restrict_to_values
from strainwave.identification.joint_model.agreement import motor_response
from strainwave.io.joint_covariance import JointCovariance

SIGNALS = {
    "states": ("torsion", "motor_velocity", "link_velocity"),
    "inputs": ("motor_torque", "interaction_torque"),
    "outputs": ("motor_velocity", "link_acceleration"),
}
"""Names of the signals of a joint's model."""
_TRIAL_RANGE = (100.0, 10.0)  # factors below and above the resonance
_N_TRIAL_FREQUENCIES = 160
_SCHEMA = "strainwave/state-space/1"


@dataclass(frozen=True, slots=True, eq=False)
class Coordinates:
    """Motor angles and torsions as linear functions of the coordinates."""

    elastic: tuple[int, ...]  # joints, from 1, whose motors come first
    motor_angles: FloatArray  # theta_M, (n_joints, n_elastic + n_joints)
    torsions: FloatArray  # C N theta_M - q of the elastic joints, (n_elastic, n_elastic + n_joints)

    def has_own_motor(self, joint: JointNumber) -> bool:
        """Whether the motor of a rigid joint turns with this joint's link only."""
        others = np.delete(self.motor_angles[joint - 1], len(self.elastic) + joint - 1)
        return not others.any()


def coordinates_of(arm: ArmDescription) -> Coordinates:
    """Coordinates of an arm; a transmission couples only rigid or only elastic joints."""
    ratios, is_rigid = transmission(arm), [not joint.elastic for joint in arm.joints]
    elastic = np.flatnonzero(np.logical_not(is_rigid))
    behind_rigid_gears = np.where(is_rigid, np.linalg.inv(ratios).T, 0.0).T
    motors = np.hstack([np.eye(arm.n_joints)[:, elastic], behind_rigid_gears])
    links = np.eye(arm.n_joints, motors.shape[1], k=len(elastic))
    torsions = (ratios @ motors - links)[elastic]
    return Coordinates(tuple((elastic + 1).tolist()), motors, torsions)


@dataclass(frozen=True, slots=True, eq=False)
class LinearArm:
    """dx/dt = A x + B u, y = C x + D u with the named states, inputs and outputs.

    Names end with the number of the joint: angles and velocities of the elastic joints' motors and
    of the links, motor torques, motor velocities and link accelerations.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

    @property
    def matrices(self) -> dict[str, FloatArray]:
        """The matrices by name."""
        return {"A": self.A, "B": self.B, "C": self.C, "D": self.D}


def linear_arm(arm: IdentifiedArm) -> LinearArm:
    """All joints, coupled by links, gravity and transmission; Coulomb friction is neglected.

    Raises `InvalidInput` if a parameter is missing or not physical.
    """
    n, coordinates = arm.study.arm.n_joints, coordinates_of(arm.study.arm)
    motors, torsions = coordinates.motor_angles, coordinates.torsions
    numbers, size = range(1, n + 1), motors.shape[1]
    links = np.eye(n, size, k=size - n)
    inertia, gravity = _links_at_rest(arm)

    def combine(of_motors: list[float], of_gears: list[float], of_links: FloatArray) -> FloatArray:
        """Quadratic form of motors, torsions and links over the coordinates."""
        form = motors.T @ np.diag(of_motors) @ motors + torsions.T @ np.diag(of_gears) @ torsions
        return np.asarray(form + links.T @ of_links @ links)

    def of_motors(name: str) -> list[float]:
        return [arm.need(name, number) for number in numbers]

    def of_gears(name: str | None = None) -> list[float]:
        laws = ((number, arm.joint(number).law) for number in coordinates.elastic)
        return [arm.need(name or law.linearised_by, number) for number, law in laws]

    none = [0.0] * len(coordinates.elastic)
    M = combine(of_motors("motor_inertia"), none, inertia)
    viscous = np.diag(of_motors("link_viscous_friction"))
    damping = combine(of_motors("motor_viscous_friction"), of_gears("gear_damping"), viscous)
    K = combine([0.0] * n, of_gears(), gravity)
    acceleration = np.linalg.solve(M, np.hstack([-K, -damping, motors.T]))
    A = np.vstack([np.eye(size, 2 * size, k=size), acceleration[:, : 2 * size]])
    B = np.vstack([np.zeros((size, n)), acceleration[:, 2 * size :]])
    velocities = np.hstack([np.zeros_like(motors), motors])
    of_elastic = [f"motor_{{}}_{number}" for number in coordinates.elastic]
    names = [*of_elastic, *(f"link_{{}}_{number}" for number in numbers)]
    return LinearArm(
        states=tuple(name.format(kind) for kind in ("angle", "velocity") for name in names),
        inputs=tuple(f"motor_torque_{number}" for number in numbers),
        outputs=tuple(
            f"{kind}_{number}" for kind in ("motor_velocity", "link_acceleration")
            for number in numbers
        ),
        A=A,
        B=B,
        C=np.vstack([velocities, A[-n:]]),
        D=np.vstack([np.zeros((n, n)), B[-n:]]),
    )  # fmt: skip


def _links_at_rest(arm: IdentifiedArm) -> tuple[FloatArray, FloatArray]:
    """M(0) and the slope of gravity dg/dq at zero link angles, both (n_joints, n_joints)."""
    dynamics = Arm.of(arm.study.arm)
    effective = dynamics.base.effective
    base = np.array([arm.need(*key) if key in effective else 0.0 for key in dynamics.base_names])
    # gravity torques are sinusoids of each angle and linear in each displacement, so that these
    # steps give the exact slope
    is_prismatic = [joint.motion == "prismatic" for joint in dynamics.joints]
    steps = np.diag(np.where(is_prismatic, 1.0, 0.5 * np.pi))
    rest = np.zeros_like(steps)
    ahead, behind = (dynamics.link_torques(base, sign * steps, rest, rest) for sign in (1.0, -1.0))
    return dynamics.inertia_matrix(base, np.zeros(len(steps))), 0.5 * (ahead - behind).T


class Matrices(NamedTuple):
    """dx/dt = A x + B u, y = C x + D u of one joint, whose signals are `SIGNALS`."""

    A: FloatArray  # (3, 3)
    B: FloatArray  # (3, 2)
    C: FloatArray  # (2, 3)
    D: FloatArray  # (2, 2)


def state_space(arm: IdentifiedArm, joint: int) -> Matrices:
    """Minimal form of (11), (12) for one decoupled joint, numbered from 1.

    States: torsion delta = n theta_M - theta_L [rad], motor and link velocity [rad/s]. Inputs:
    motor torque minus Coulomb friction, interaction torque at the link (13) [N m]. Outputs: motor
    velocity [rad/s], link acceleration [rad/s^2]. The link has its inertia at q2 = 0, the gear the
    stiffness of `GearLaw.linearised_by`; gravity is neglected. Raises `InvalidInput` if there is no
    such joint, its gear is rigid, the transmission couples joints, or a parameter is missing or not
    physical.
    """
    model = two_inertia.state_space(joint_model(arm, joint))
    # the link acceleration is the derivative of the third state
    return Matrices(
        model.A, model.B, np.vstack([model.C[0], model.A[2]]), np.vstack([np.zeros(2), model.B[2]])
    )


def joint_model(arm: IdentifiedArm, joint: int) -> TwoInertia:
    """The six parameters and the gear ratio of one joint; errors as for `state_space`."""
    drive = arm.joint(joint)
    if not drive.elastic:
        raise InvalidInput(
            f"joint {joint} has a rigid gear, so it is not a model of two inertias and a spring",
            where=str(arm.study.path),
            remedy="export to mjcf, urdf, json or c",
        )
    if arm.study.arm.is_coupled:
        raise InvalidInput(
            f"the transmission couples joint {joint} with others, so it has no model of its own",
            where=str(arm.study.path),
            remedy="use the model of the whole arm",
        )
    values = [
        sum(weight * arm.need(*key) for key, weight in row.items())
        for row in _parameter_rows(arm, joint)
    ]
    return joint_of(np.array(values), drive.gear_ratio)


def trial_response(study: Study, values: Values, joint: int) -> tuple[FloatArray, ComplexArray]:
    """Frequencies [Hz] around the modes of one joint, and its response with trial values.

    The response is that of motor velocity to motor torque; errors as for `state_space`.
    """
    arm = restrict_to_values(Arm.of(study.arm), values)
    completion = assume_missing(values, arm).values
    source = IdentifiedArm(replace(study, arm=arm), (), "trial values", completion=completion)
    model = joint_model(source, joint)
    high = two_inertia.resonance(model).frequency_hz
    f = np.geomspace(high / _TRIAL_RANGE[0], high * _TRIAL_RANGE[1], _N_TRIAL_FREQUENCIES)
    return f, motor_response(model.vector, model.gear_ratio, f)


def _parameter_rows(arm: IdentifiedArm, joint: int) -> list[dict[Key, float]]:
    """The six parameters of `joint_model` as linear combinations of those of the arm.

    The link inertia follows from (3) if it is not a parameter.
    """
    rows: list[dict[Key, float]] = [{(name, joint): 1.0} for name in NAMES]
    rows[NAMES.index("gear_stiffness")] = {(arm.joint(joint).law.linearised_by, joint): 1.0}
    if ("link_inertia", joint) not in arm.values:
        rows[NAMES.index("link_inertia")] = dict(link_inertia(arm.study.arm, joint))
    return rows


def joint_model_covariance(
    arm: IdentifiedArm, joint: int, covariance: JointCovariance | None
) -> FloatArray | None:
    """Covariance of the six parameters of `joint_model`, (6, 6).

    Parameters outside the joint covariance enter with their standard deviations, uncorrelated. None
    if a parameter has neither.
    """
    keys = _parameter_rows(arm, joint)
    std = {p.label: p.std for p in arm.parameters}
    known = () if covariance is None else covariance.names
    rows: dict[str, FloatArray] = {}
    for k, row in enumerate(keys):
        for (name, number), weight in row.items():
            label = label_of(name, number)
            if label not in known and std.get(label) is None:
                return None
            rows.setdefault(label, np.zeros(len(keys)))[k] += weight
    labels = list(rows)
    matrix = np.diag([(std.get(label) or 0.0) ** 2 for label in labels])
    if covariance is not None:
        at = [k for k, label in enumerate(labels) if label in known]
        of = [known.index(labels[k]) for k in at]
        matrix[np.ix_(at, at)] = covariance.matrix[np.ix_(of, of)]
    J = np.column_stack([rows[label] for label in labels])
    return np.asarray(J @ matrix @ J.T)


def models_of(arm: IdentifiedArm) -> tuple[dict[int, Matrices], LinearArm]:
    """Models of elastic joints without coupled motors, by number, and of the whole arm.

    Raises `InvalidInput` as `state_space`.
    """
    is_coupled, joints = arm.study.arm.is_coupled, enumerate(arm.study.arm.joints, start=1)
    numbers = [number for number, joint in joints if joint.elastic and not is_coupled]
    return {number: state_space(arm, number) for number in numbers}, linear_arm(arm)


def linearised(arm: IdentifiedArm) -> tuple[Diagnostic, ...]:
    """Warnings of every linear model of a joint: assumptions, and the stiffness of curved gears."""
    warnings = arm.assumed()
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        if joint.law.is_curved:
            note = joint.law.linearised_note
            warnings += (Diagnostic("linearised", Place(joint=number), note=note),)
    return warnings


def to_state_space(arm: IdentifiedArm) -> Export:
    """The matrices of all joints and of the whole arm as JSON; errors as for `models_of`."""
    joints, whole_arm = models_of(arm)
    missing = losses(arm, LINEAR)
    notes = (*arm.assumptions, *loss_note(missing))
    document = {
        "schema": _SCHEMA,
        **SIGNALS,
        "joints": [{"joint": n, **model._asdict()} for n, model in joints.items()],
        "whole_arm": {name: getattr(whole_arm, name) for name in SIGNALS} | whole_arm.matrices,
        "notes": notes,
    }
    text = json.dumps(document, indent=2, default=np.ndarray.tolist)
    return Export((text + "\n").encode(), linearised(arm), notes, missing)
