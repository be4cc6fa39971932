"""Parameters of an arm for blocks of Simscape, as a script that makes a struct `arm`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from strainwave.domain import Joint, Parameter
from strainwave.domain.arm.link_sensors.link_space import attitude
from strainwave.domain.keys import JointNumber
from strainwave.export import completion, source
from strainwave.export.rigid_links import DELAY, held_parts, servo_law
from strainwave.export.source import Export, IdentifiedArm, numbers
from strainwave.io.templates import fill_text

Field = float | tuple[float, ...]
_DRIVE = ("torque_per_volt", "current_loop_hz")
_HELD = (*source.LINEAR, *completion.FRICTION, *_DRIVE, DELAY, source.ERRORS)
_BEYOND = 2.0  # the table of a spring ends at this multiple of its last knee


def to_simscape(arm: IdentifiedArm) -> Export:
    """MATLAB script with the fields of Simscape's blocks: inertia, friction, springs, servos.

    Raises `InvalidInput` if a parameter that the model needs is missing.
    """
    description, gravity = arm.study.arm, completion.effective_gravity(arm)
    losses = (*source.losses(arm, held_parts(arm, *_HELD)), source.CORRELATIONS)
    notes = (*arm.assumptions, *source.loss_note(losses))
    joints = []
    for number, joint in enumerate(description.joints, start=1):
        fields = dict(_fields(arm, number, joint))
        stds = {p.name: p.std for p in arm.parameters if _is_exported(p, number, fields)}
        name = description.joint_names[number - 1].replace("'", "''")
        joints.append((name, joint, attitude(joint.origin.rpy), fields, stds))
    text = fill_text(
        Path(__file__).with_name("arm_simscape.m.j2"),
        joints=list(zip(joints, completion.link_bodies(arm, gravity), strict=True)),
        gravity=completion.chain_of(arm, gravity).gravity or (0.0, 0.0, 0.0),
        coupling=description.coupling,
        notes=notes,
        numbers=numbers,
        sentence_of=source.sentence_of,
    )
    warnings = arm.assumed() + completion.gravity_warnings(arm)
    return Export(text.encode(), warnings, notes, losses)


def _is_exported(p: Parameter, number: JointNumber, fields: Mapping[str, Field]) -> bool:
    """Whether a field has the estimate of a parameter, and not a value that is projected."""
    return p.joint == number and p.std is not None and fields.get(p.name) == p.value


def _fields(arm: IdentifiedArm, number: JointNumber, joint: Joint) -> Iterator[tuple[str, Field]]:
    """Names and values of what acts at a joint; a piecewise linear spring has a table as well."""
    yield "gear_ratio", joint.gear_ratio
    yield "motor_inertia", completion.rotor_inertias(arm)[number - 1]
    for name in (*completion.FRICTION, "link_viscous_friction"):
        yield name, arm.values[name, number]
    if joint.elastic:
        for name in (*joint.law.names, "gear_damping"):
            yield name, arm.need(name, number)
        springs = joint.law.parallel_springs(partial(arm.need, joint=number))
        if springs is not None and len(springs) > 1:
            knees = np.array([slack for _, slack in springs[1:]])
            torsion = np.append(knees, _BEYOND * knees[-1])
            torsion = np.concatenate([-torsion[::-1], [0.0], torsion])
            values = {name: arm.need(name, number) for name in joint.law.names}
            yield "gear_torsion", tuple(torsion.tolist())
            yield "gear_torque", tuple(joint.law.torque(values, torsion).tolist())
    for name in _DRIVE:
        if isinstance(value := getattr(joint, name), float):
            yield name, value
    if (servo := servo_law(arm, number)) is not None:
        yield "servo_stiffness", servo.stiffness
        yield "servo_damping", servo.damping
        yield "servo_delay", servo.delay
        if servo.limit is not None:
            yield "torque_limit", servo.limit
