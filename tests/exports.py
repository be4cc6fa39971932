"""Results on disk for the tests of exports: an arm with known parameters and its study."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from serial_chains import parameters_of, random_body
from strainwave.domain import (
    ArmDescription,
    Experiment,
    Joint,
    JointLimits,
    Motion,
    Origin,
    PositionServo,
    Spring,
    Study,
)
from strainwave.domain.arm.description import UNKNOWN, Matrix, unit_of
from strainwave.domain.arm.kinds import change_arm_keys, single_joint
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS
from strainwave.domain.keys import Values
from strainwave.export import IdentifiedArm, read_arm
from strainwave.io.base_parameters import standard_name
from strainwave.io.study import write_study
from strainwave.virtual import scara

SERVO_UNITS = {
    **{"servo_kp": "N m/rad", "servo_kd": "N m s/rad", "servo_damping": "N m s/rad"},
    **{"servo_delay": "s", "torque_limit": "N m"},
}
MOTION = Experiment("motion", "motion.csv", "motion", ("servo",))


def two_links(folder: Path, spring: Spring = "linear", gravity: float | None = None) -> Study:
    """The built-in rig without a current loop."""
    study = scara.STIFF.study(folder, spring)
    joints = tuple(replace(joint, current_loop_hz=None) for joint in study.arm.joints)
    return replace(study, arm=change_arm_keys(study.arm.with_joints(joints), gravity=gravity))


def values_of(study: Study) -> Values:
    """Parameters of the rig; G2 differs by 2 % from the value of a rigid body."""
    values = scara.STIFF.parameters(5, study.arm.joints[0].spring)
    if study.arm.gravity is not None:
        values["gravity_torque_1", None] = 60.0
        first_moment = values["gamma", None] / scara.STIFF.link_length[0]
        values["gravity_torque_2", None] = 1.02 * study.arm.gravity_size * first_moment
    return values


def single(
    folder: Path,
    motion: Motion = "revolute",
    spring: Spring = "rigid",
    gravity: float | None = None,
) -> tuple[Study, Values]:
    """One joint, its torque logged."""
    joint = Joint(spring=spring, gear_ratio=0.1, motion=motion)
    arm = single_joint(joint, gravity=gravity)
    study = Study(arm=arm, experiments=(MOTION,), path=folder / "study.toml")
    values: Values = {
        ("motor_viscous_friction", 1): 0.002,
        ("link_viscous_friction", 1): 0.1,
        ("motor_coulomb_friction", 1): 0.0,
        ("friction_offset", 1): 0.003,
        ("motor_inertia", 1): 0.02,
        ("link_inertia", 1): 3.0,
    }
    if spring == "linear":
        values |= {("gear_stiffness", 1): 4000.0, ("gear_damping", 1): 2.0}
    if gravity is not None:
        values["gravity_torque_1", None] = 11.0
    return study, values


def document(study: Study, values: Values) -> dict[str, object]:
    """A result of an earlier version, which names its study; standard deviations of 1 %."""
    data = study.path.read_bytes()
    parameters = [
        {
            "name": name,
            "joint": joint,
            "value": value,
            "std": 0.01 * abs(value),
            "ci95": None,
            "unit": SERVO_UNITS.get(name)
            or ("kg m^2" if joint is None else unit_of(name, study.arm.joints[joint - 1])),
            "stage": "tuned",
        }
        for (name, joint), value in values.items()
        if study.arm.kind != "serial" or not name.startswith("link_") or "viscous" in name
    ]
    standard = {
        standard_name(key): value for key, value in values.items() if study.arm.kind == "serial"
    }
    named = {"path": str(study.path), "sha256": hashlib.sha256(data).hexdigest()}
    document: dict[str, object] = {"schema": "strainwave/result/1", "study": named}
    document["parameters"] = parameters
    return document | ({"standard_parameters": standard} if standard else {})


def write(study: Study, values: Values) -> Path:
    """Write the study file and a result.json beside it; return the path of the result."""
    write_study(study, study.path)
    path = study.path.parent / "result.json"
    path.write_text(json.dumps(document(study, values)))
    return path


def arm_of(study: Study, values: Values) -> IdentifiedArm:
    return read_arm(write(study, values))


CHAIN = (  # origin and axis of each joint
    (Origin((0.0, 0.0, 0.3)), (0.0, 0.0, 1.0)),
    (Origin((0.06, 0.02, 0.14), (-1.5, 0.2, 0.0)), (0.0, 0.6, 0.8)),
    (Origin((0.4, 0.0, -0.05), (0.0, 0.3, 0.1)), (0.1, 0.0, 1.0)),
)
Springs = tuple[Spring, Spring, Spring]
Motions = tuple[Motion, Motion, Motion]
MOTIONS: tuple[Motions, ...] = (("revolute",) * 3, ("revolute", "prismatic", "revolute"))
COUPLING = ((1.0, 0.0, 0.0), (0.3, 1.0, 0.0), (0.0, -0.6, 1.0))


def chain(
    folder: Path,
    springs: Springs = ("linear",) * 3,
    motions: Motions = MOTIONS[0],
    coupling: Matrix | None = None,
) -> tuple[Study, Values]:
    """Three joints of any directions under gravity, with boxes as links; without dry friction."""
    ratios = (0.01, -0.0125, 0.02)
    joints = tuple(
        Joint(spring, ratio, motion, torque_per_volt=0.1, origin=origin, axis=axis)
        for spring, motion, ratio, (origin, axis) in zip(
            springs, motions, ratios, CHAIN, strict=True
        )
    )
    arm = ArmDescription("serial", joints, (0.4, -0.7, -9.6), coupling)
    random = np.random.default_rng(5)
    values: Values = {}
    for i, joint in enumerate(joints, start=1):
        values |= {
            ("motor_inertia", i): 2e-4,
            ("motor_viscous_friction", i): 3e-4,
            ("link_viscous_friction", i): 0.4,
            ("motor_coulomb_friction", i): 0.0,
            ("friction_offset", i): 0.01,
        }
        if joint.elastic:
            values |= {("gear_stiffness", i): 2e4, ("gear_damping", i): 10.0}
        body = zip(LINK_PARAMETERS, parameters_of(random_body(random)), strict=True)
        values |= {(f"link_{name}", i): float(value) for name, value in body}
    experiment = replace(MOTION, control=("open",) * 3)
    return Study(arm=arm, experiments=(experiment,), path=folder / "study.toml"), values


def limited_chain(folder: Path, motions: Motions = MOTIONS[0]) -> tuple[Study, Values]:
    """A chain behind rigid gears with dry friction, and limits of the first two joints."""
    study, values = chain(folder, ("rigid",) * 3, motions)
    limits = JointLimits(-1.5, 2.0, 3.0, 80.0), JointLimits(0.1, 0.6), None
    joints = (replace(j, limits=each) for j, each in zip(study.arm.joints, limits, strict=True))
    values |= {("motor_coulomb_friction", i): 0.02 * i for i in (1, 2, 3)}
    values |= {("friction_offset", i): 0.0 for i in (1, 2, 3)}
    return replace(study, arm=study.arm.with_joints(joints)), values


SERVO_DAMPING = 0.03 - 0.5 * 0.002 * 4.8
"""Of the law in continuous time that is nearest to the servo, which holds its output for 2 ms."""


def position_servo(folder: Path, known_kp: bool = False) -> tuple[Study, Values]:
    """One joint behind a position servo; its gain is known from the study, or identified."""
    study, values = single(folder, gravity=9.81)
    joint = replace(study.arm.joints[0], gear_ratio=1.0)
    of_joint = {
        **{"motor_inertia": 0.0, "link_inertia": 0.003, "inertia": 0.003, "friction_offset": 0.0},
        **{"motor_viscous_friction": 0.01, "link_viscous_friction": 0.0, "servo_delay": 0.021},
        **{"motor_coulomb_friction": 0.024, "servo_kd": 0.03, "servo_damping": 0.04},
        "torque_limit": 0.75,
    }
    values |= {(name, 1): value for name, value in of_joint.items()}
    values["gravity_torque_1", None] = 0.2
    if not known_kp:
        values["servo_kp", 1] = 4.8
    servo = PositionServo("position", 0.002, (4.8 if known_kp else UNKNOWN,), (UNKNOWN,))
    arm = replace(study.arm.with_joints((joint,)), position_servo=servo)
    return replace(study, arm=arm), values
