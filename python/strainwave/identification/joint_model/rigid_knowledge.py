"""Values of one joint from the `RigidModel`, with the errors that they cause elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, LinkSignals, RigidModel
from strainwave.domain.arm.combinations import is_uncoupled, total_inertia
from strainwave.domain.keys import Row
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.interaction_torque import base_variations, interaction_torques


@dataclass(frozen=True, slots=True)
class RigidError:
    """Changes for one standard deviation along one eigenvector of the rigid model's covariance."""

    tau: tuple[FloatArray, ...]  # one per record, (n_samples,) [N m] at the link
    # of total inertia [kg m^2], total viscous friction [N m s/rad] and Coulomb friction [N m]
    changes: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class RigidKnowledge:
    """Values from the rigid step for one joint, as (value, standard deviation), or None."""

    total_inertia: tuple[float, float] | None  # c_1 [kg m^2]
    total_viscous_friction: tuple[float, float] | None  # c_0 [N m s/rad]
    coulomb_friction: tuple[float, float] | None  # f [N m]
    errors: tuple[RigidError, ...] = ()  # independent error directions of tau

    @property
    def sums(self) -> tuple[tuple[float, float] | None, ...]:
        """Total inertia, total viscous friction and Coulomb friction."""
        return self.total_inertia, self.total_viscous_friction, self.coulomb_friction

    def of_record(self, k: int) -> RigidKnowledge:
        """The values and errors for record `k` alone."""
        errors = tuple(replace(error, tau=(error.tau[k],)) for error in self.errors)
        return replace(self, errors=errors)


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
    names = [p.key for p in model.parameters]
    identified = np.array([p.value is not None for p in model.parameters])
    weights: list[FloatArray | None] = []
    known: list[tuple[float, float] | None] = []
    for part in parts:
        weight = np.array([part.get(key, 0.0) for key in names])
        used = np.flatnonzero(weight)
        if len(used) != len(part) or not identified[used].all():
            weights.append(None)
            known.append(None)
            continue
        variance = weight[used] @ model.covariance[np.ix_(used, used)] @ weight[used]
        weights.append(weight)
        known.append((float(weight @ model.solution), float(np.sqrt(variance))))
    errors: Iterable[RigidError] = ()
    if records and not is_uncoupled(arm):
        errors = _errors(model, arm, joint, angles, records, weights)
    inertia, viscous, coulomb = known
    return RigidKnowledge(inertia, viscous, coulomb, tuple(errors))


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
        inertia, viscous, coulomb = (0.0 if w is None else float(w @ change) for w in weights)
        tau = tuple(
            interaction_torques(arm, base, *motion, postures)[:, joint - 1] for motion in motions
        )
        yield RigidError(tau, (inertia, viscous, coulomb))
