"""Starting values of gears for records that do not determine them.

Strain-wave gears are selected for their loads: anti-resonances are typically 8 to 60 Hz, higher for
small arms, and the motor contributes a fifth to two thirds of the joint's inertia.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from strainwave.domain import FloatArray, JointModel, RigidModel
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.motor_side.arms import Family, family_of

_ANTI_RESONANCES_HZ = (8.0, 12.0, 18.0, 27.0, 40.0, 60.0)  # anti-resonances
_MOTOR_SHARES = (0.25, 0.55)  # motor's share of the joint's inertia
_DAMPING_RATIO = 0.05  # damping ratio of the anti-resonance


def models_from_catalogue(model: RigidModel | None, arm: Arm) -> list[tuple[JointModel, ...]]:
    """Models of all joints with typical gears, as starting values for a whole-arm fit.

    The inertias come from `model`. Returns sets of one model per joint from the base, without
    estimated parameters.

    Raises `NotIdentifiable` if the rigid model is missing or lacks an inertia.
    """
    if model is None:
        raise NotIdentifiable(
            "without a rigid model and records that excite the gears, the whole-arm fit has no"
            ' start: add an experiment with use = "motion", or one with use = "frequency"'
        )
    family, candidates = family_of(model, arm), []
    shares = [
        _MOTOR_SHARES if np.isnan(known) else (known,) for known in family.known_share.tolist()
    ]
    for combination in product(*([_ANTI_RESONANCES_HZ] * family.n_joints), *shares):
        n = family.n_joints
        point = family.point(
            2.0 * np.pi * np.array(combination[:n]), np.array(combination[n:]), _DAMPING_RATIO
        )
        if family.proper(point):
            candidates.append(_models(family, point))
    if not candidates:
        raise NotIdentifiable(
            "the inertias of the rigid model belong to no arm: whatever part of joint 1's is the"
            " motor's, the links' inertia matrix is not positive definite"
        )
    return candidates


def _models(family: Family, point: FloatArray) -> tuple[JointModel, ...]:
    unknown = np.full((len(NAMES), len(NAMES)), np.nan)
    return tuple(
        JointModel(
            joint=i,
            experiments=(),
            method="catalogue",
            parameters=(),
            values=dict(zip(NAMES, joint.vector.tolist(), strict=True)),
            covariance=unknown,
            anti_resonance=None,
            resonance=None,
            band_hz=(0.0, np.inf),
            fit_percent={},
            status="partly-determined",
        )
        for i, joint in enumerate(family.joints(point), start=1)
    )
