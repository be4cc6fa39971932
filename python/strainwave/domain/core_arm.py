"""The compiled arm of a description."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from strainwave._core import Arm as CoreArm
from strainwave.domain.arm import ArmDescription
from strainwave.domain.arrays import FloatArray


def core_arm(arm: ArmDescription, springs: Sequence[str], **constants: Any) -> CoreArm:
    """The equations of motion of an arm; `constants` are those of its electronics and sensors.

    Planar arms have compiled programs of their own, which are faster than those of a chain.
    """
    ratios = [joint.gear_ratio for joint in arm.joints]
    if not arm.has_planar_program:
        placed = [(j.motion, j.origin.xyz, j.origin.rpy, j.axis) for j in arm.joints]
        gravity = arm.gravity or (0.0, 0.0, 0.0)
        return CoreArm.serial_chain(
            placed, springs, ratios, gravity=gravity, transmission=arm.coupling, **constants
        )
    return CoreArm(
        arm.kind,
        springs,
        ratios,
        motion=arm.joints[0].motion,
        link_length=arm.joints[-1].origin.xyz[0],
        gravity=arm.gravity_size,
        **constants,
    )


def transmission(arm: ArmDescription) -> FloatArray:
    """C N: link angles per motor angle, (n_joints, n_joints)."""
    coupling = np.eye(arm.n_joints) if arm.coupling is None else np.array(arm.coupling)
    return np.asarray(coupling * np.array([joint.gear_ratio for joint in arm.joints]))
