"""Load on an identified arm from one sample at a time.

Motor angles and torques pass causal low-passes in the core, both the same, so that acceleration
needs no sensor and no delay has to be known. Blocks of time keep triangular factors of the
equations in the friction of the joints and the load phi. The parameters of the bodies keep their
identified values; with their errors, Cov = P, and the information N of the equations,

    Cov phi = jackknife over blocks + N^-1 C P C' N^-1

where C are the products of the equations with those of the arm. The friction of each joint is
unknown, with the identified values as prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from strainwave import _core
from strainwave.domain import BoolArray, FloatArray, FrictionTerm, Joint, RigidModel
from strainwave.domain.arm.base_parameters import core_arm
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import CORRECTIONS, DELAY, TORSION, ZERO
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification.payload import (
    N_PARAMETERS,
    UNKNOWN_STDS,
    ArmPrior,
    LoadFit,
    friction_changes,
)
from strainwave.numerics.least_squares import MAX_STD_SHARE_OF_TORQUE
from strainwave.numerics.linalg import singular_values

DEFAULT_WINDOW = 10.0
"""[s] of motion that the estimate uses: enough for all parameters, and old loads are forgotten."""

_BLOCKS = 20  # of the window, as in the jackknife of records
_MIN_BLOCKS = 4  # of an estimate: fewer give no useful interval
_ROWS_PER_CUTOFF = 4.0  # rows per period of the bandwidth, as for records
# The equations are nonlinear in the motion, which keeps a higher bandwidth, as in records.
_MOTION_BANDWIDTHS = 8.0
_MAX_POLE_SHARE = 0.1  # of the sampling rate: largest frequency of the low-pass of the motion
# Of the rms velocity of the identified motion, below which the direction of friction is uncertain:
# of 0.001 to 0.1, the largest has the smallest errors.
_SLOW_SHARE = 0.1
_MIN_ERROR_SHARE = 1e-3  # smallest error of the torques of a joint over their rms value
_MIN_DIRECTION = 0.1  # component of a direction from which a parameter belongs to it
_MIN_SINGULAR_VALUE = 1e-8  # of a direction that the equations determine beyond rounding errors


@dataclass(frozen=True, slots=True)
class _Solution:
    """Least squares in friction and load."""

    value: FloatArray  # (n,)
    inverse: FloatArray  # (n, n) N^-1 within the resolved directions
    is_resolved: BoolArray  # (n,)


class LoadStream:
    """Estimates the load of an arm from samples of motor angles and torques.

    `sample_time` [s] is the period of the samples, `window` [s] the time of motion that counts.
    Samples in which a joint may stick do not count for it. Raises InvalidInput if the samples are
    too slow for the bandwidth of the arm's model.
    """

    def __init__(
        self,
        arm: Arm,
        prior: ArmPrior,
        model: RigidModel,
        *,
        sample_time: float,
        window: float = DEFAULT_WINDOW,
    ) -> None:
        per_row = int(1.0 / (_ROWS_PER_CUTOFF * prior.bandwidth_hz * sample_time))
        if per_row < 1:
            raise InvalidInput(
                f"a sample every {sample_time:g} s does not resolve the bandwidth of the arm's "
                f"model, {prior.bandwidth_hz:.3g} Hz",
                where="sample_time",
                remedy=f"sample every {0.25 / prior.bandwidth_hz:.2g} s or faster",
            )
        self.arm, self.prior = arm, prior
        n = arm.n_body
        body = np.vstack(
            [
                arm.links_of_rigid(prior.motor_shares),
                arm.motors_of_rigid(prior.motor_shares),
                np.zeros((arm.n_shared, n)),
            ]
        )
        self._map = np.zeros((len(body), len(prior.solution)))
        self._map[:, :n] = body
        if arm.n_shared:
            self._map[-arm.n_shared :, -arm.n_shared :] = np.eye(arm.n_shared)
        raw = self._map @ prior.solution
        n_links = len(arm.base_names)
        self._levels = levels = _levels(arm, prior, model)
        self._rows_per_block = max(1, round(window / (per_row * sample_time) / _BLOCKS))
        zero, delay, compliance = _corrections(arm, prior)
        self._core = _core.LoadStream(
            arm.core,
            chain=None
            if len(arm.base_names) == N_PARAMETERS * arm.n_joints
            else core_arm(replace(arm, kind="serial"), ["rigid"] * arm.n_joints),
            sample_time=sample_time,
            bandwidth_hz=prior.bandwidth_hz,
            motion_poles_hz=min(
                _MOTION_BANDWIDTHS * prior.bandwidth_hz, _MAX_POLE_SHARE / sample_time
            ),
            samples_per_row=per_row,
            rows_per_block=self._rows_per_block,
            blocks=_BLOCKS,
            transmission=np.array(arm.transmission),
            inverse=np.asarray(np.linalg.inv(arm.transmission), dtype=np.float64),
            links=raw[:n_links].tolist(),
            motor_inertia=raw[n_links : n_links + arm.n_joints].tolist(),
            friction=np.ascontiguousarray(arm.joint_friction(prior.solution)),
            shared=list(zip(arm.shared_links, raw[n_links + arm.n_joints :].tolist(), strict=True)),
            terms=_laws(prior.friction_terms),
            compliance=compliance.tolist(),
            zero=arm.motor_accelerations(zero).tolist(),
            per_command=arm.torque_per_volt.tolist(),
            decay=[_decay(joint, sample_time) for joint in arm.joints],
            delay=(delay / sample_time).tolist(),
            slow=levels.slow.tolist(),
            weight=(1.0 / levels.errors).tolist(),
        )

    def update(self, angle: ArrayLike, torque: ArrayLike) -> None:
        """Add one sample.

        `angle` (n_joints,) [rad] are the motor angles and `torque` (n_joints,) the motor torques
        [N m], or voltages [V], of the study's channels, or the torques of joint sensors if the arm
        was identified from them. Raises ValueError if there is not one of each per joint.
        """
        torque = np.asarray(torque, dtype=np.float64)
        if self.arm.joints[0].torque_at_link:
            torque = self.arm.motors_of(torque)
        self._core.update(np.asarray(angle, dtype=np.float64), torque)

    def reset(self) -> None:
        """Forget all samples, for example after a gap or a change of the load."""
        self._core.reset()

    def fit(self) -> LoadFit:
        """The load of the window. Raises NotIdentifiable if the motion was too short."""
        factors, products = self._core.equations()
        if len(factors) < _MIN_BLOCKS:
            raise NotIdentifiable(
                f"{len(factors)} of {_BLOCKS} blocks of the window have samples in motion; an "
                f"estimate needs {_MIN_BLOCKS}"
            )
        return self._fit(factors, products)

    def _fit(self, factors: FloatArray, products: FloatArray) -> LoadFit:
        """Estimate and covariance of some blocks."""
        n, stds = factors.shape[2] - 1, self._levels.friction_stds
        friction = self.arm.joint_friction(self.prior.solution).ravel()
        scale = np.linalg.norm(factors[:, :, :n], axis=(0, 1))
        scale[: len(stds)] = np.hypot(scale[: len(stds)], 1.0 / stds)
        scale[scale == 0.0] = 1.0
        prior_rows = np.zeros((len(stds), n + 1))
        prior_rows[:, : len(stds)] = np.diag(1.0 / stds)
        prior_rows[:, -1] = friction / stds
        scaled = np.append(1.0 / scale, 1.0)
        blocks, prior_rows = factors * scaled, prior_rows * scaled
        every = _solve(np.concatenate([*blocks, prior_rows]), len(stds))
        count, without = len(blocks), []
        for b in range(count):
            others = [*blocks[:b], *blocks[b + 1 :], prior_rows]
            without.append(_solve(np.concatenate(others), len(stds)).value - every.value)
        shifts = np.array(without)
        covariance = (count - 1) / count * shifts.T @ shifts
        covariance += self._covariance_of_arm(every.inverse, products.sum(axis=0), scale)
        value, covariance = every.value / scale, covariance / np.outer(scale, scale)
        at = slice(len(stds), n)
        # over the torques of the arm's motion, as for records
        torque = np.sqrt(count * self._rows_per_block) * self._levels.relative_torque
        share = np.sqrt(np.diag(covariance)) * scale / torque
        return LoadFit(
            value=value[at],
            covariance=covariance[at, at],
            is_determined=(every.is_resolved & (share < MAX_STD_SHARE_OF_TORQUE))[at],
            n_blocks=count,
            shift=0.0,
        )

    def _covariance_of_arm(
        self, inverse: FloatArray, products: FloatArray, scale: FloatArray
    ) -> FloatArray:
        """Covariance of the scaled estimate due to the identified parameters of the arm."""
        arm, prior, stds = self.arm, self.prior, self._levels.friction_stds
        effect = -(products / scale[:, None]) @ self._map
        at = slice(arm.n_body, arm.n_body + len(stds))
        weights = np.diag(1.0 / stds**2) / scale[: len(stds)]
        effect[: len(stds), at] += weights
        of_parameters = prior.covariance + np.diag(self._levels.unknown_variances)
        changes = np.zeros((len(scale), len(stds)))
        changes[: len(stds)] = weights * friction_changes(arm, prior.solution).ravel()
        total = effect @ of_parameters @ effect.T + changes @ changes.T
        return np.asarray(inverse @ total @ inverse)


def _solve(rows: FloatArray, n_friction: int) -> _Solution:
    """Least squares of rows (n_rows, n + 1), within the directions of the load that they resolve.

    Friction comes first and has a prior, so that all of it is resolved.
    """
    n = rows.shape[1] - 1
    _, R = np.linalg.qr(rows)
    U, s, Vt = singular_values(R[n_friction:n, n_friction:n])
    kept = s > _MIN_SINGULAR_VALUE * s[0]
    basis = np.eye(n, n_friction + int(kept.sum()))
    basis[n_friction:, n_friction:] = Vt[kept].T
    triangle = R[:n, :n] @ basis
    triangle = np.vstack([triangle[:n_friction], (U.T @ triangle[n_friction:])[kept]])
    right = np.concatenate([R[:n_friction, -1], (U.T @ R[n_friction:n, -1])[kept]])
    root = basis @ np.linalg.inv(triangle)
    is_resolved = np.ones(n, dtype=bool)
    is_resolved[n_friction:] = np.all(np.abs(Vt[~kept]) < _MIN_DIRECTION, axis=0)
    return _Solution(root @ right, root @ root.T, is_resolved)


@dataclass(frozen=True, slots=True)
class _Levels:
    """Sizes of torques and speeds of the identified motion."""

    errors: FloatArray  # (n_joints,) [N m] of the model
    relative_torque: float  # of all joints over these errors
    slow: FloatArray  # (n_joints,) [rad/s] below which a motor may stick
    friction_stds: FloatArray  # (3 n_joints,) of the prior of friction
    unknown_variances: FloatArray  # (n_parameters,) of parameters that are not determined


def _levels(arm: Arm, prior: ArmPrior, model: RigidModel) -> _Levels:
    """Sizes from the samples of the motion in the model."""
    angle, velocity, acceleration = model.motion
    regressor = arm.rigid_regressor(*(arm.links_of(x) for x in (angle, velocity, acceleration)))
    viscous, coulomb, offset = arm.joint_friction(prior.solution).T
    friction = viscous * velocity + coulomb * np.sign(velocity) + offset
    torque = np.sqrt(np.mean((regressor @ prior.solution[: arm.n_body] + friction) ** 2, axis=0))
    shares = np.array([model.torque_errors.get(i + 1, 0.0) for i in range(arm.n_joints)])
    speed = np.sqrt(np.mean(velocity**2, axis=0))
    with np.errstate(divide="ignore"):
        sizes = np.sqrt(np.mean(regressor**2, axis=(0, 1)))
        unknown = np.where(sizes > 0.0, UNKNOWN_STDS * np.sqrt(np.mean(torque**2)) / sizes, 0.0)
        unknown_friction = np.column_stack([torque / speed, torque, torque])
    n, stop = arm.n_body, arm.n_body + unknown_friction.size
    variances = np.zeros(len(prior.solution))
    variances[:n] = np.where(prior.is_determined[:n], 0.0, unknown**2)
    friction_stds = np.hypot(
        friction_changes(arm, prior.solution).ravel(), np.sqrt(np.diag(prior.covariance)[n:stop])
    )
    is_known = prior.is_determined[n:stop] & (friction_stds > 0.0)
    errors = np.maximum(shares, _MIN_ERROR_SHARE) * torque
    return _Levels(
        errors=errors,
        relative_torque=float(np.linalg.norm(torque / errors)),
        slow=np.where(speed > 0.0, _SLOW_SHARE * speed, np.inf),
        friction_stds=np.where(is_known, friction_stds, UNKNOWN_STDS * unknown_friction.ravel()),
        unknown_variances=variances,
    )


def _decay(joint: Joint, sample_time: float) -> float:
    """Decay of a current loop over a sample; zero for torques and drives without one."""
    if joint.torque_per_volt is None or not joint.current_loop_hz:
        return 0.0
    return float(np.exp(-2.0 * np.pi * joint.current_loop_hz * sample_time))


def _corrections(arm: Arm, prior: ArmPrior) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Encoder zeros of the links, delays [s] of the torques, compliances: each (n_joints,)."""
    zero, delay, compliance = (
        np.zeros(arm.n_joints),
        np.zeros(arm.n_joints),
        prior.compliance.copy(),
    )
    for effect, values in ((ZERO, zero), (DELAY, delay), (TORSION, compliance)):
        for term in prior.friction_terms:
            if term.effect == effect:
                at = slice(None) if term.joint is None else term.joint - 1
                values[at] += term.size.value or 0.0
    return zero, delay, compliance


def _laws(terms: Sequence[FrictionTerm]) -> list[tuple[str, int, float, float]]:
    """Further friction and springs as the core has them."""
    return [
        (term.effect, term.joint - 1, term.shape, term.size.value)
        for term in terms
        if term.effect not in CORRECTIONS and term.joint is not None and term.size.value is not None
    ]
