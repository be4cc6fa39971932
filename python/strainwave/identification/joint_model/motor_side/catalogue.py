"""Gears to start from where no record shows them: those that such arms have.

Strain-wave gears are chosen to match their loads: anti-resonances lie between 8 and 60 Hz, of small
arms the higher ones, and a motor's inertia is a fifth to two thirds of its joint's.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from strainwave.domain import FloatArray, JointModel, RigidModel
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.motor_side.arms import Family, family_of

_RINGS_HZ = (8.0, 12.0, 18.0, 27.0, 40.0, 60.0)
_SHARES = (0.25, 0.55)
_DAMPING = 0.05  # ratio of the anti-resonance


def models_from_catalogue(model: RigidModel | None, arm: Arm) -> list[tuple[JointModel, ...]]:
    """Models of all joints with ordinary gears, for records to choose from.

    `model`: From which the inertias are.

    Returns: Each with one model per joint from the base, without parameters: nothing of them is
    known.

    Raises `NotIdentifiable`: the rigid model is missing, or lacks an inertia.
    """
    if model is None:
        raise NotIdentifiable(
            "without a rigid model and records that excite the gears, the whole-arm fit has no"
            ' start: add an experiment with use = "motion", or one with use = "frequency"'
        )
    family, found = family_of(model, arm), []
    shares = [_SHARES if np.isnan(known) else (known,) for known in family.known_share.tolist()]
    for own in product(*([_RINGS_HZ] * family.n_joints), *shares):
        n = family.n_joints
        point = family.point(2.0 * np.pi * np.array(own[:n]), np.array(own[n:]), _DAMPING)
        if family.proper(point):
            found.append(_models(family, point))
    if not found:
        raise NotIdentifiable(
            "the inertias of the rigid model belong to no arm: whatever part of joint 1's is the"
            " motor's, the links' inertia matrix is not positive definite"
        )
    return found


def _models(family: Family, point: FloatArray) -> tuple[JointModel, ...]:
    nothing = np.full((len(NAMES), len(NAMES)), np.nan)
    return tuple(
        JointModel(
            joint=i,
            experiments=(),
            method="catalogue",
            parameters=(),
            values=dict(zip(NAMES, joint.vector.tolist(), strict=True)),
            covariance=nothing,
            anti_resonance=None,
            resonance=None,
            band_hz=(0.0, np.inf),
            fit_percent={},
            status="partly-determined",
        )
        for i, joint in enumerate(family.joints(point), start=1)
    )
