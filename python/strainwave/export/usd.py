"""The rigid part of an arm as an articulation of UsdPhysics, with the PhysX attributes of joints.

Angles of USD are in degrees, also those in units of drives, friction and speed limits. The frames
of a joint have z along its axis.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.arm.description import Vector
from strainwave.domain.arm.link_sensors.link_space import attitude, axes_about
from strainwave.export import completion, source
from strainwave.export.read_back_links import by_usd, inertia_of
from strainwave.export.rigid_links import STICTION, RigidLink, held_parts, lost_shapes, rigid_links
from strainwave.export.source import Export, IdentifiedArm, numbers
from strainwave.io.templates import fill_text

_DEGREE = math.pi / 180.0  # [rad]


def to_usd(arm: IdentifiedArm) -> Export:
    """USD text of the arm with rotors as armature of the joints.

    Servos are drives. `physxJoint` and `physxJointAxis` hold armature, friction and speed limits.
    """
    links, notes = rigid_links(arm, has_rotors=True)
    losses = source.losses(arm, held_parts(arm, "gravity", STICTION)) + lost_shapes(arm)
    notes = (*notes, *source.loss_note(losses))
    prims = _prim_names([link.name for link in links])
    renamed = [
        f"{link.name} is {p}" for link, p in zip(links, prims, strict=True) if p != link.name
    ]
    if renamed:
        notes += (f"names of joints that USD does not allow: {', '.join(renamed)}",)
    text = fill_text(
        Path(__file__).with_name("arm.usda.j2"),
        links=list(zip(links, prims, _placements(links), strict=True)),
        gravity=arm.study.arm.gravity or (0.0, 0.0, 0.0),
        documentation=json.dumps("\n".join(map(source.sentence_of, notes)), ensure_ascii=False),
        angle_units=lambda link: 1.0 if link.joint.motion == "prismatic" else _DEGREE,
        axes=lambda joint: _quaternion(axes_about(joint.axis).T),
        attitude=lambda joint: _quaternion(attitude(joint.origin.rpy) @ axes_about(joint.axis).T),
        principal=_principal,
        tuple_of=_tuple,
    )
    check = partial(by_usd, links=dict(zip(prims, links, strict=True)))
    warnings = arm.assumed() + completion.gravity_warnings(arm)
    return Export(text.encode(), warnings, notes, losses, check)


def _placements(links: Sequence[RigidLink]) -> list[tuple[FloatArray, FloatArray]]:
    """Position and quaternion of the frame of each link in the base at zero angles."""
    turn, position, placements = np.eye(3), np.zeros(3), []
    for link in links:
        position = position + turn @ link.joint.origin.xyz
        turn = turn @ attitude(link.joint.origin.rpy)
        placements.append((position, _quaternion(turn)))
    return placements


def _principal(link: RigidLink) -> tuple[FloatArray, FloatArray]:
    """Principal moments of inertia of a link, and the quaternion of its principal axes."""
    moments, axes = np.linalg.eigh(inertia_of(link))
    axes[:, 2] *= np.linalg.det(axes)  # right-handed
    return moments, _quaternion(axes)


def _quaternion(matrix: FloatArray) -> FloatArray:
    """Quaternion of a rotation matrix, the real part first."""
    from scipy.spatial.transform import Rotation  # takes a third of a second

    return np.roll(np.asarray(Rotation.from_matrix(matrix).as_quat()), 1)


def _prim_names(names: Sequence[str]) -> list[str]:
    """Different identifiers for names of joints."""
    prims: list[str] = []
    for name in names:
        prim = re.sub(r"\W|^(?=\d)", "_", name, flags=re.ASCII)
        prims.append(prim if prim not in prims else f"{prim}_{len(prims) + 1}")
    return prims


def _tuple(values: Vector | FloatArray) -> str:
    return f"({', '.join(map(numbers, values))})"
