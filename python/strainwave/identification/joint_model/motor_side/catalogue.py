"""Starting values of gears for records that do not determine them.

Strain-wave gears are selected for their loads: anti-resonances are typically 8 to 60 Hz, higher for
small arms, and the motor contributes a fifth to two thirds of the joint's inertia.
"""

from __future__ import annotations

import numpy as np

from strainwave.domain import JointModel, RigidModel
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES, TwoInertia
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.motor_side.arms import NO_ARM, family_of

_ANTI_RESONANCES_HZ = (8.0, 12.0, 18.0, 27.0, 40.0, 60.0)  # anti-resonances
_MOTOR_SHARES = (0.25, 0.55)  # motor's share of the joint's inertia
_DAMPING_RATIO = 0.05  # damping ratio of the anti-resonance


def models_from_catalogue(model: RigidModel | None, arm: Arm) -> list[tuple[JointModel, ...]]:
    """Models of all joints with typical gears, as starting values for a whole-arm fit.

    The inertias come from `model`. Returns sets of one model per joint from the base, without
    estimated parameters. The joints of a set are alike; joints of several sets can be combined.

    Raises `NotIdentifiable` if the rigid model is missing or lacks an inertia.
    """
    if model is None:
        raise NotIdentifiable(
            "without a rigid model and records that excite the gears, the whole-arm fit has no"
            ' start: add an experiment with use = "motion", or one with use = "frequency"'
        )
    family, candidates = family_of(model, arm), []
    known = family.known_share
    shares = [np.where(np.isnan(known), share, known) for share in _MOTOR_SHARES]
    if not np.isnan(known).any():
        shares = [known]
    models: dict[tuple[int, float, float], JointModel] = {}
    for ring in 2.0 * np.pi * np.array(_ANTI_RESONANCES_HZ):
        for share in shares:
            point = family.point(np.full(family.n_joints, ring), share, _DAMPING_RATIO)
            if family.least_inertia(point) > 0.0:
                keys = [(i, ring, own) for i, own in enumerate(share.tolist(), start=1)]
                for key, joint in zip(keys, family.joints(point), strict=True):
                    models.setdefault(key, _model(key[0], joint))
                candidates.append(tuple(models[key] for key in keys))
    if not candidates:
        raise NotIdentifiable(NO_ARM)
    return candidates


def _model(number: int, joint: TwoInertia) -> JointModel:
    return JointModel(
        joint=number,
        experiments=(),
        method="catalogue",
        parameters=(),
        values=dict(zip(NAMES, joint.vector.tolist(), strict=True)),
        covariance=np.full((len(NAMES), len(NAMES)), np.nan),
        anti_resonance=None,
        resonance=None,
        band_hz=(0.0, np.inf),
        fit_percent={},
        status="partly-determined",
    )
