"""Results on disk for the tests of exports: an arm with known parameters and its study."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

from strainwave.domain import Experiment, Joint, Motion, Spring, Study
from strainwave.domain.keys import Values
from strainwave.domain.kinds import change_arm_keys, single_joint
from strainwave.domain.units import unit_of
from strainwave.export import IdentifiedArm, read_arm
from strainwave.io.study import write_study
from strainwave.virtual import scara

MOTION = Experiment("motion", "motion.csv", "motion", ("servo",))


def two_links(folder: Path, spring: Spring = "linear", gravity: float | None = None) -> Study:
    """The built-in rig without a current loop."""
    study = scara.study(folder, spring)
    joints = tuple(replace(joint, current_loop_hz=None) for joint in study.arm.joints)
    return replace(study, arm=change_arm_keys(study.arm.with_joints(joints), gravity=gravity))


def values_of(study: Study) -> Values:
    """Parameters of the rig; G2 differs by 2 % from the value of a rigid body."""
    values = scara.parameters(5, study.arm.joints[0].spring)
    if study.arm.gravity is not None:
        values["gravity_torque_1", None] = 60.0
        first_moment = values["gamma", None] / scara.LINK_LENGTH[0]
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
            "unit": "kg m^2" if joint is None else unit_of(name, study.arm.joints[joint - 1]),
            "stage": "tuned",
        }
        for (name, joint), value in values.items()
    ]
    named = {"path": str(study.path), "sha256": hashlib.sha256(data).hexdigest()}
    return {"schema": "strainwave/result/1", "study": named, "parameters": parameters}


def write(study: Study, values: Values) -> Path:
    """Write the study file and a result.json beside it; return the path of the result."""
    write_study(study, study.path)
    path = study.path.parent / "result.json"
    path.write_text(json.dumps(document(study, values)))
    return path


def arm_of(study: Study, values: Values) -> IdentifiedArm:
    return read_arm(write(study, values))
