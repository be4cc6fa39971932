"""RigidModel -> what it knows of one joint, and how far its errors reach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import FloatArray, LinkSignals, RigidModel
from strainwave.domain.combinations import is_uncoupled, total_inertia
from strainwave.domain.kinds import Row
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.interaction_torque import base_variations, interaction_torques
from strainwave.identification.joint_model.grey_box import RigidError, RigidKnowledge


def rigid_knowledge(
    model: RigidModel | None, arm: Arm, joint: int, records: Sequence[LinkSignals] = ()
) -> RigidKnowledge:
    """c_1, c_0 and f of one joint, each with its deviation, as the rigid model gives them.

    `joint`: From 1.
    `records`: In which the interaction torques come from the model.

    Returns: None for what it does not give.
    """
    if model is None:
        return RigidKnowledge(None, None, None)
    parts: tuple[Row, ...] = (
        total_inertia(arm, joint),
        {("total_viscous_friction", joint): 1.0},
        {("motor_coulomb_friction", joint): 1.0},
    )
    weights = [_weight(model, part) for part in parts]
    known = [_sum(model, weight) for weight in weights]
    errors = tuple(_errors(model, arm, joint, records, weights)) if records else ()
    return RigidKnowledge(known[0], known[1], known[2], errors)


def _weight(model: RigidModel, part: Row) -> FloatArray | None:
    """Of each parameter; None where one is not known."""
    weight = np.array([part.get((p.name, p.joint), 0.0) for p in model.parameters])
    identified = np.array([p.value is not None for p in model.parameters])
    if np.count_nonzero(weight) != len(part) or not identified[weight != 0.0].all():
        return None
    return weight


def _sum(model: RigidModel, weight: FloatArray | None) -> tuple[float, float] | None:
    """A weighted sum of rigid parameters and its deviation."""
    if weight is None:
        return None
    used = np.flatnonzero(weight)
    variance = weight[used] @ model.covariance[np.ix_(used, used)] @ weight[used]
    return float(weight @ model.solution), float(np.sqrt(variance))


def _errors(
    model: RigidModel,
    arm: Arm,
    joint: int,
    records: Sequence[LinkSignals],
    weights: Sequence[FloatArray | None],
) -> Iterator[RigidError]:
    """Directions in which tau is uncertain, with what else moves along with them on average."""
    if is_uncoupled(arm):
        return
    variations = base_variations(model, arm)
    used = np.flatnonzero(variations.any(axis=0))
    used = used[np.diag(model.covariance)[used] > 0.0]  # not NaN either
    size = np.sqrt(np.diag(model.covariance)[used])
    covariance = model.covariance[np.ix_(used, used)]
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    # what is known of the other parameters once these are: E[x | used]
    follows = np.nan_to_num(model.covariance[:, used]) @ np.linalg.pinv(covariance)
    for value, vector in zip(values, vectors.T, strict=True):
        if value <= 0.0:
            continue
        step = size * vector * np.sqrt(value)
        change = follows @ step
        change[used] = step
        base = variations @ change
        moves = [0.0 if weight is None else float(weight @ change) for weight in weights]
        tau = tuple(
            interaction_torques(arm, base, s.link_angle, s.link_velocity, s.link_acceleration)[
                :, joint - 1
            ]
            for s in records
        )
        yield RigidError(tau, *moves)
