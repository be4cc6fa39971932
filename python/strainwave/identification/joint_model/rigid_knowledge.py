"""Values of one joint from the `RigidModel`, with the errors that they cause elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, LinkSignals, RigidModel
from strainwave.domain.combinations import is_uncoupled, total_inertia
from strainwave.domain.keys import Row
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.interaction_torque import base_variations, interaction_torques


@dataclass(frozen=True, slots=True)
class RigidError:
    """Changes for one standard deviation along one eigenvector of the rigid model's covariance."""

    tau: tuple[FloatArray, ...]  # one per record, (n_samples,) [N m] at the link
    total_inertia: float  # [kg m^2]
    total_viscous_friction: float  # [N m s/rad]
    coulomb_friction: float  # [N m]


@dataclass(frozen=True, slots=True)
class RigidKnowledge:
    """Values from the rigid step for one joint, as (value, standard deviation), or None."""

    total_inertia: tuple[float, float] | None  # c_1 [kg m^2]
    total_viscous_friction: tuple[float, float] | None  # c_0 [N m s/rad]
    coulomb_friction: tuple[float, float] | None  # f [N m]
    errors: tuple[RigidError, ...] = ()  # independent error directions of tau

    def add_error(self, error: RigidError) -> RigidKnowledge:
        """The values changed by one error."""
        return RigidKnowledge(
            _add_change(self.total_inertia, error.total_inertia),
            _add_change(self.total_viscous_friction, error.total_viscous_friction),
            _add_change(self.coulomb_friction, error.coulomb_friction),
        )

    def of_record(self, k: int) -> RigidKnowledge:
        """The values and errors for record `k` alone."""
        errors = tuple(replace(error, tau=(error.tau[k],)) for error in self.errors)
        return replace(self, errors=errors)


def _add_change(known: tuple[float, float] | None, change: float) -> tuple[float, float] | None:
    return known and (known[0] + change, known[1])


def rigid_knowledge(
    model: RigidModel | None,
    arm: Arm,
    joint: int,
    records: Sequence[LinkSignals] = (),
    posture: Sequence[float] = (),
) -> RigidKnowledge:
    """c_1, c_0 and Coulomb friction of one joint from the rigid model, with standard deviations.

    `joint` counts from 1. `posture` are the link angles [rad] of m_L; empty: all are zero. The
    interaction torques of `records` come from the model; its errors in them are part of the result.
    A value that the model does not give is None.
    """
    if model is None:
        return RigidKnowledge(None, None, None)
    angles = np.array(posture or np.zeros(arm.n_joints))
    parts: tuple[Row, ...] = (
        total_inertia(arm, joint, angles),
        {("total_viscous_friction", joint): 1.0},
        {("motor_coulomb_friction", joint): 1.0},
    )
    weights = [_weight(model, part) for part in parts]
    known = [_sum(model, weight) for weight in weights]
    errors: tuple[RigidError, ...] = ()
    if records and not is_uncoupled(arm):
        errors = tuple(_errors(model, arm, joint, angles, records, weights))
    return RigidKnowledge(known[0], known[1], known[2], errors)


def _weight(model: RigidModel, part: Row) -> FloatArray | None:
    """Weight of each rigid parameter in a sum; None if one of them is unknown."""
    weight = np.array([part.get(p.key, 0.0) for p in model.parameters])
    identified = np.array([p.value is not None for p in model.parameters])
    if np.count_nonzero(weight) != len(part) or not identified[weight != 0.0].all():
        return None
    return weight


def _sum(model: RigidModel, weight: FloatArray | None) -> tuple[float, float] | None:
    """Weighted sum of rigid parameters and its standard deviation."""
    if weight is None:
        return None
    used = np.flatnonzero(weight)
    variance = weight[used] @ model.covariance[np.ix_(used, used)] @ weight[used]
    return float(weight @ model.solution), float(np.sqrt(variance))


def _errors(
    model: RigidModel,
    arm: Arm,
    joint: int,
    posture: FloatArray,
    records: Sequence[LinkSignals],
    weights: Sequence[FloatArray | None],
) -> Iterator[RigidError]:
    """Independent error directions of tau, with the expected changes of the other parameters."""
    variations = base_variations(model, arm)
    motions = [(each.link_angle, each.link_velocity, each.link_acceleration) for each in records]
    postures = np.tile(posture, (arm.n_joints, 1))
    used = np.flatnonzero(variations.any(axis=0))
    used = used[np.diag(model.covariance)[used] > 0.0]  # excludes NaN
    scale = np.sqrt(np.diag(model.covariance)[used])
    covariance = model.covariance[np.ix_(used, used)]
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    # regression of the other parameters on the used ones: E[x | used]
    regression = np.nan_to_num(model.covariance[:, used]) @ np.linalg.pinv(covariance)
    for value, vector in zip(values, vectors.T, strict=True):
        if value <= 0.0:
            continue
        step = scale * vector * np.sqrt(value)
        change = regression @ step
        change[used] = step
        base = variations @ change
        changes = [0.0 if weight is None else float(weight @ change) for weight in weights]
        tau = tuple(
            interaction_torques(arm, base, *motion, postures)[:, joint - 1] for motion in motions
        )
        yield RigidError(tau, *changes)
