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
    return CoreArm(
        [(j.motion, j.origin.xyz, j.origin.rpy, j.axis) for j in arm.joints],
        springs,
        [joint.gear_ratio for joint in arm.joints],
        program=arm.kind if arm.has_planar_program else "serial",
        gravity=arm.gravity or (0.0, 0.0, 0.0),
        transmission=arm.coupling,
        **constants,
    )


def transmission(arm: ArmDescription) -> FloatArray:
    """C N: link angles per motor angle, (n_joints, n_joints)."""
    coupling = np.eye(arm.n_joints) if arm.coupling is None else np.array(arm.coupling)
    return np.asarray(coupling * np.array([joint.gear_ratio for joint in arm.joints]))
