"""Linear state-space models: each joint alone as two inertias and a spring, and the whole arm."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Place
from strainwave.domain.arm.base_parameters import link_inertia
from strainwave.domain.keys import Key, label_of
from strainwave.dynamics import two_inertia
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, joint_of
from strainwave.errors import InvalidInput
from strainwave.export.linear_arm import LinearArm, linear_arm
from strainwave.export.omissions import LINEAR, omission_note
from strainwave.export.source import Export, IdentifiedArm
from strainwave.io.joint_covariance import JointCovariance

STATES = ("torsion", "motor_velocity", "link_velocity")
INPUTS = ("motor_torque", "interaction_torque")
OUTPUTS = ("motor_velocity", "link_acceleration")
_SCHEMA = "strainwave/state-space/1"


class Matrices(NamedTuple):
    """dx/dt = A x + B u, y = C x + D u with `STATES`, `INPUTS` and `OUTPUTS`."""

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
    notes = (*arm.assumptions, *omission_note(arm, LINEAR))
    document = {
        "schema": _SCHEMA,
        "states": STATES,
        "inputs": INPUTS,
        "outputs": OUTPUTS,
        "joints": [{"joint": n, **model._asdict()} for n, model in joints.items()],
        "whole_arm": {
            **{name: getattr(whole_arm, name) for name in ("states", "inputs", "outputs")},
            **whole_arm.matrices,
        },
        "notes": notes,
    }
    text = json.dumps(document, indent=2, default=np.ndarray.tolist)
    return Export((text + "\n").encode(), linearised(arm), notes)
