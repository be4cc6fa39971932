"""Linear equations in the parameters of the rigid model, filtered and decimated.

Both sides of the equation of motion pass through the same low-pass filter. During sliding, friction
is viscous * dq + Coulomb * sgn(dq) + offset; where the motor may be in stiction, the Coulomb torque
is a separate unknown. Elastic joints are modelled to first order: the torsion is the gear torque
times the compliance, (1) and (2).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray
from strainwave.domain.arm.combinations import FRICTION_COLUMNS
from strainwave.domain.arm.kinds.base import MOTOR_SHARE
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import (
    DELAY,
    SPRING,
    TORSION,
    ZERO,
    body_regressor,
    friction_per_size,
    gear_load,
)
from strainwave.errors import NotIdentifiable
from strainwave.identification.rigid.filtered_record import FilteredRecord, n_compliances
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.numerics.least_squares import Equations, Factor, Local

JACKKNIFE_BLOCKS = 20
"""Blocks of the jackknife over all records."""

# prior standard deviation of the stiction torque in units of f: uniform distribution in [-f, f]
_STICTION_STD = 0.58
_LOAD_FRICTION_STD = 0.5  # prior standard deviation of the load friction; gears have 0.03 to 0.3
# prior standard deviations of sizes [rad, m], [s] that have no relation to the torque
_KNOWN_STDS = {"load-friction": _LOAD_FRICTION_STD, ZERO: 1.0, DELAY: 0.05}
_TORSION_STD = 0.01  # [rad, m] of a gear at its largest torque
_ANGLE_STEP = 1e-5  # [rad, m] largest change of an angle, for a derivative
_LOG_SHAPE_STD = 0.7  # prior standard deviation of a shape's logarithm: a factor of two
_SHAPE_STEP = 1e-3  # of a shape's logarithm, for its derivative
_COMPLIANCE_STD = 0.25  # prior standard deviation of (bandwidth / anti-resonance)^2
_MIN_INERTIA = 1e-30  # [kg m^2] lower bound of a link inertia, which avoids division by zero


@dataclass(frozen=True, slots=True)
class MotorShares:
    """Shares of the motors in sums with the links that rigid motion does not separate.

    The compliance compensates for the error of inertias. The viscous frictions of motor and link
    act on velocities that differ by the rate of the torsion.
    """

    inertia: float | FloatArray = MOTOR_SHARE  # of all motors, or (n_joints,)
    viscous_friction: float = MOTOR_SHARE

    @staticmethod
    def usual(arm: Arm) -> MotorShares:
        """The usual shares; the equations of planar arms have all viscous friction at the motor."""
        return MotorShares() if arm.base.has_groups else MotorShares(viscous_friction=1.0)


@dataclass(frozen=True, slots=True)
class Estimate:
    """Parameters and compliances around which the equations are linearised."""

    solution: FloatArray  # (n_parameters,)
    compliance: FloatArray  # (n_joints,) [rad/(N m)] link side, at least 0
    # per record (n_motion, n_joints) free friction [N m], or empty
    stiction_torque: tuple[FloatArray, ...]
    shares: MotorShares


def convert_estimate(
    estimate: Estimate, before: Sequence[FilteredRecord], after: Sequence[FilteredRecord]
) -> Estimate:
    """Convert an estimate at one bandwidth to a starting value at another.

    `before` and `after` are the same records at the two bandwidths. The free friction is
    interpolated to the motion's samples at the other bandwidth.
    """
    stiction_torque = []
    for friction, old, new in zip(estimate.stiction_torque, before, after, strict=True):
        old_samples, target_samples = old.motion_samples(), new.motion_samples()
        columns = [
            np.interp(target_samples, old_samples, column) for column in friction.T if len(column)
        ]
        stiction_torque.append(np.column_stack(columns) if columns else friction)
    return replace(estimate, stiction_torque=tuple(stiction_torque))


ALL_JOINTS = -1
"""Joint of a term that is common to all joints."""


@dataclass(frozen=True, slots=True)
class FurtherTerm:
    """A term of a joint in addition to inertia, viscous and Coulomb friction, and offset."""

    effect: str
    joint: int  # from 0, or `ALL_JOINTS`
    shape: float = 1.0
    size: float | None = None  # around which the shape is estimated; None: the shape is given
    corrected: float = 0.0  # part of the size by which the signals are corrected

    @property
    def key(self) -> tuple[str, int]:
        """Effect and joint."""
        return self.effect, self.joint


def term_stds(
    terms: Sequence[FurtherTerm], arm: Arm, stretches: Sequence[FilteredRecord]
) -> FloatArray:
    """Prior standard deviations of the sizes, then of the estimated shapes' logarithms.

    They correspond to the largest torque of the joint, or to a known size.
    """
    of_links = [np.max(np.abs(arm.joints_of(s.torque)), axis=0) for s in stretches]
    at_link = np.max(of_links, axis=0)
    torque = np.max([np.max(np.abs(s.torque), axis=0) for s in stretches], axis=0)
    speed, angle = (
        np.max([np.max(np.abs(s.motion[k]), axis=0) for s in stretches], axis=0) for k in (1, 0)
    )
    tiny = np.finfo(float).tiny

    def deviation(c: FurtherTerm) -> float:
        per_unit = {
            "direction-friction": speed[c.joint],
            "load-speed-friction": speed[c.joint] * torque[c.joint] / _LOAD_FRICTION_STD,
            SPRING: angle[c.joint],
        }.get(c.effect, 1.0)
        if c.effect == TORSION:
            return float(_TORSION_STD / max(at_link[c.joint], tiny))
        known = _KNOWN_STDS.get(c.effect)
        return known if known is not None else float(torque[c.joint] / max(per_unit, tiny))

    sizes = [deviation(c) for c in terms]
    return np.array([*sizes, *(_LOG_SHAPE_STD for c in terms if c.size is not None)])


def term_columns(
    terms: Sequence[FurtherTerm],
    arm: Arm,
    stretch: FilteredRecord,
    linearised_at: Estimate,
    carried: FloatArray | float = 0.0,
) -> FloatArray:
    """Regressors in the order of `term_stds`, (n_rows, n_joints, n_columns).

    The load is that of the gears by the estimate, without friction, plus the motor torques
    `carried` (n_motion, n_joints) of a further body.
    """
    q, dq, ddq = stretch.links
    solution, payload = linearised_at.solution, stretch.signals.experiment.payload
    share = linearised_at.shares.inertia
    load = gear_load(arm, solution, (q, dq, ddq), payload, share) + carried
    base = arm.links_of_rigid() @ solution[: arm.n_body] + arm.payload_vector(payload)
    velocity, direction = stretch.motion[1], stretch.drive[1]
    interval = stretch.motion_step * stretch.signals.sample_time

    def motor_torque() -> FloatArray:
        viscous, coulomb, _ = arm.joint_friction(solution).T
        rotors = arm.motors_of_rigid(share) @ solution[: arm.n_body]
        body = load + rotors * stretch.motion[2]
        return np.asarray(body + viscous * velocity + coulomb * direction)

    def torque_per_shift(*shift: FloatArray) -> FloatArray:
        """Motor torques per shift of the links: an angle and its derivatives."""
        step = _ANGLE_STEP / max(float(np.max(np.abs(shift[0]))), np.finfo(float).tiny)
        ahead, behind = (
            arm.link_torques(base, *(x + h * dx for x, dx in zip((q, dq, ddq), shift, strict=True)))
            for h in (step, -step)
        )
        return arm.motors_of((ahead - behind) / (2.0 * step))

    def regressor(c: FurtherTerm, factor: float = 1.0) -> FloatArray:
        """Torques of all joints per size, or those of the joint alone."""
        i, unit = c.joint, np.eye(arm.n_joints)[c.joint]
        if c.effect == SPRING:
            return arm.motors_of(q * unit)
        if c.effect == ZERO:
            return torque_per_shift(np.ones_like(q) * unit, 0.0 * dq, 0.0 * ddq)
        if c.effect == DELAY:
            return -differentiate(motor_torque(), interval)
        if c.effect == TORSION:
            twist = arm.joints_of(motor_torque()) * unit
            rate = differentiate(twist, interval)
            return -torque_per_shift(twist, rate, differentiate(rate, interval))
        law = friction_per_size(c.effect, factor * c.shape, velocity[:, i], load[:, i])
        return np.asarray(law * direction[:, i])

    step = np.exp(_SHAPE_STEP)
    parts = [(c, regressor(c)) for c in terms]
    for c in terms:
        if c.size is not None:
            change = regressor(c, step) - regressor(c, 1.0 / step)
            parts.append((c, c.size / (2.0 * _SHAPE_STEP) * change))
    columns = np.zeros((len(stretch.rows), arm.n_joints, len(parts)))
    at = [
        (k, joints)
        for k, (c, part) in enumerate(parts)
        for joints in (range(arm.n_joints) if part.ndim == 2 else [c.joint])
    ]
    if at:
        flat = [part if part.ndim == 2 else part[:, None] for _, part in parts]
        filtered = stretch.filtered(np.concatenate(flat, axis=1))
        for column, (k, joint) in zip(filtered.T, at, strict=True):
            columns[:, joint, k] = column
    return columns


def assemble(
    arm: Arm,
    stretches: Sequence[FilteredRecord],
    linearised_at: Estimate | None,
    terms: Sequence[FurtherTerm] = (),
    previous: Equations | None = None,
) -> Equations:
    """Assemble the equations of all records and joints.

    Nuisance parameters are the compliances of elastic joints, common to all rows, and the free
    friction of each record and joint. Blocks are equal intervals of time, about 20 in all, and
    equal parts of the period of a repeated motion; all joints share them. Records have blocks in
    proportion to the time in which joints slide. The offset of a joint that slides in one direction
    only is zero, because it acts as Coulomb friction.

    Without `linearised_at`, the joints are rigid, the prior of the free friction is the size of the
    torque, and there are no `terms`, whose unknowns are common to all rows. `previous` are
    equations of the same records around another estimate, whose constant parts are reused.
    """
    offset_share = slides_both_ways(stretches)
    parts = [
        _joint_by_joint(arm, stretch, linearised_at, record, terms, offset_share)
        for record, stretch in enumerate(stretches)
    ]
    common_std = np.zeros(0)
    if linearised_at is not None and n_compliances(arm):  # anti-resonances exceed the bandwidth
        w = 2.0 * np.pi * max(s.bandwidth_hz for s in stretches)
        inertia = np.abs(arm.link_inertias(_base(arm, linearised_at)))
        common_std = _COMPLIANCE_STD / (np.maximum(inertia, _MIN_INERTIA) * w**2)
    if linearised_at is not None and terms:
        common_std = np.concatenate([common_std, term_stds(terms, arm, stretches)])
    shared, common, target, local_std = (np.concatenate(x) for x in zip(*parts, strict=True))
    if previous is None:
        previous = _constant_parts(arm, stretches)
    return replace(
        previous,
        shared=shared,
        common=common,
        common_deviation=common_std,
        local_deviation=local_std,
        target=target,
    )


def _constant_parts(arm: Arm, stretches: Sequence[FilteredRecord]) -> Equations:
    """Equations of all records without the entries that depend on the estimate."""
    local = list[Local]()
    blocks, first_row, first_block = [], 0, 0
    for stretch, count in zip(stretches, blocks_of(stretches), strict=True):
        ends = first_row + np.searchsorted(stretch.joint, np.arange(arm.n_joints + 1))
        rows = (np.arange(*pair) for pair in itertools.pairwise(ends.tolist()))
        local += map(Local, rows, stretch.free)
        blocks.append(first_block + stretch.blocks(count)[stretch.row])
        first_row, first_block = int(ends[-1]), first_block + count
    return Equations(
        shared=np.zeros((0, 0)),
        noise=np.sqrt(np.mean([s.noise**2 for s in stretches], axis=0)),
        common=np.zeros((0, 0)),
        common_deviation=np.zeros(0),
        local=tuple(local),
        local_deviation=np.zeros(0),
        target=np.zeros(0),
        group=np.concatenate([s.joint for s in stretches]),
        block=np.concatenate(blocks),
        repetition=np.concatenate([s.repetition[s.row] for s in stretches]),
    )


def _joint_by_joint(
    arm: Arm,
    stretch: FilteredRecord,
    linearised_at: Estimate | None,
    record: int,
    terms: Sequence[FurtherTerm],
    offset_share: BoolArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Columns of the parameters and common unknowns, target, and local deviations of one record.

    `offset_share` (n_joints,) is whether joints have an offset.
    """
    body = _body_equations(arm, stretch, linearised_at, record)
    common = body.lags
    if terms and linearised_at is not None:
        of_terms = term_columns(terms, arm, stretch, linearised_at)
        common = np.concatenate([common, of_terms], axis=2)
    at = stretch.row, stretch.joint
    n_body, n_shared = arm.n_body, arm.n_shared
    X = np.zeros((len(stretch.row), len(arm.rigid_columns)))
    X[:, :n_body] = body.regressor[at]
    friction = stretch.friction[at]
    friction[:, 0] -= body.own_lag[at]
    friction[:, 2] *= offset_share[stretch.joint]
    columns = n_body + FRICTION_COLUMNS * stretch.joint[:, None] + np.arange(FRICTION_COLUMNS)
    X[np.arange(len(X))[:, None], columns] = friction
    if n_shared:
        shared = arm.shared_friction_regressor(stretch.friction[:, :, 0]) - body.shared_lag
        X[:, -n_shared:] = shared[at]
    if linearised_at is not None:
        coulomb = arm.joint_friction(linearised_at.solution)[:, 1]
    else:  # a record at an edge throughout has no rows
        n_rows, n_joints = stretch.torque.shape
        coulomb = np.std(stretch.torque, axis=0) if n_rows else np.zeros(n_joints)
    stds = np.maximum(_STICTION_STD * np.abs(coulomb), 1e-300)
    of_local = np.repeat(stds, [free.n_columns for free in stretch.free])
    return X, common[at], body.torque[at], of_local


def blocks_of(stretches: Sequence[FilteredRecord]) -> list[int]:
    """Number of blocks of each record, in proportion to the time in which joints slide."""
    total = sum(s.sliding_time for s in stretches)
    if total == 0.0:
        raise NotIdentifiable("no motor slides in any record; record a faster motion")
    return [max(2, round(JACKKNIFE_BLOCKS * s.sliding_time / total)) for s in stretches]


def slides_both_ways(stretches: Sequence[FilteredRecord]) -> BoolArray:
    """Joints, (n_joints,), that slide in both directions in any of the records."""
    return np.asarray(np.all(np.any([s.slides for s in stretches], axis=0), axis=0))


def estimate_of(
    arm: Arm,
    stretches: Sequence[FilteredRecord],
    equations: Equations,
    factor: Factor,
    shares: MotorShares,
) -> Estimate:
    """Estimate from a solution, around which the next equations are linearised.

    Compliances are limited to between zero and three standard deviations of their prior. Above that
    the first-order model is not valid.
    """
    compliance = np.zeros(arm.n_joints)
    n = n_compliances(arm)
    if n and len(factor.common):
        upper_bound = 3.0 * equations.common_deviation[:n]
        compliance = np.clip(factor.common[:n], 0.0, upper_bound) * arm.is_elastic
    stiction_torque, start = [], 0
    for stretch in stretches:
        friction = np.zeros_like(
            stretch.motion[0] if stretch.stiction_shapes else stretch.torque[:0]
        )
        for i, (near, shapes) in enumerate(stretch.stiction_shapes):
            friction[near, i] = shapes @ factor.local[start : start + shapes.n_columns]
            start += shapes.n_columns
        stiction_torque.append(friction)
    return Estimate(factor.value, compliance, tuple(stiction_torque), shares)


def mix_estimates(one: Estimate, other: Estimate, share: float) -> Estimate:
    """Mean of two estimates of the same records, with a share of the other and its motor shares."""
    rest = 1.0 - share
    pairs = zip(one.stiction_torque, other.stiction_torque, strict=True)
    return Estimate(
        rest * one.solution + share * other.solution,
        rest * one.compliance + share * other.compliance,
        tuple(rest * a + share * b for a, b in pairs),
        other.shares,
    )


def anti_resonances(arm: Arm, estimate: Estimate) -> FloatArray:
    """Anti-resonance of each link on its gear, sqrt(1 / (c M_ii)) / 2 pi, (n_joints,) [Hz].

    Infinite if the gear is rigid.
    """
    inertia = np.maximum(arm.link_inertias(_base(arm, estimate)), 1e-300)
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / (2.0 * np.pi * np.sqrt(estimate.compliance * inertia)))


@dataclass(frozen=True, slots=True)
class _BodyEquations:
    """Equations of motion of the links in one record, low-passed."""

    regressor: FloatArray  # (n_rows, n_joints, n_body)
    lags: FloatArray  # (n_rows, n_joints, n_elastic) per compliance
    torque: FloatArray  # (n_rows, n_joints) right-hand side
    # velocities by which the viscous friction of the links differs from that behind rigid gears:
    own_lag: FloatArray  # (n_rows, n_joints) per total viscous friction
    shared_lag: FloatArray  # (n_rows, n_joints, n_shared) per friction of links that motors share


def _body_equations(
    arm: Arm, stretch: FilteredRecord, linearised_at: Estimate | None, record: int
) -> _BodyEquations:
    links: Sequence[FloatArray] = stretch.links
    if linearised_at is None or not n_compliances(arm):
        phi = stretch.body
        if not phi.size:
            phi = stretch.filtered(body_regressor(arm, links, stretch.torsion))
        torque = stretch.torque - _payload_torque(arm, stretch, links)
        shape = len(phi), arm.n_joints
        lags, shared_lag = np.zeros((*shape, 0)), np.zeros((*shape, arm.n_shared))
        return _BodyEquations(phi, lags, torque, np.zeros(shape), shared_lag)
    gears = _gear_torques(arm, stretch, linearised_at, record)
    c, angle = linearised_at.compliance, links[0]
    torsion = c * gears
    links = [q - twist for q, twist in zip(links, torsion, strict=True)]
    n, n_body = arm.n_joints, arm.n_body
    # one filter for all columns: the last is the velocity of the torsion
    columns = np.empty((len(angle), n, n_body + n + 1))
    columns[:, :, :n_body] = body_regressor(arm, links, [*torsion], linearised_at.shares.inertia)
    # motor torque per compliance, -N C^T M_j(q) ddT_j, for the symmetric M: by gear, then by motor
    base = _base(arm, linearised_at) + arm.payload_vector(stretch.signals.experiment.payload)
    torques = np.swapaxes(arm.motors_of(arm.inertia_matrices(base, angle)), 1, 2)
    lags = np.multiply(torques, -gears[2][:, None], out=columns[:, :, n_body:-1])
    viscous = arm.transmission * _link_viscous_friction(arm, linearised_at)[:, None]
    if viscous.any():
        lags -= gears[1][:, None] * viscous.T
    columns[:, :, -1] = torsion[1]
    columns = stretch.filtered(columns)
    phi, lags, lag_velocity = columns[:, :, :n_body], columns[:, :, n_body:-1], columns[:, :, -1]
    torque = stretch.torque - _payload_torque(arm, stretch, links)
    own_lag = lag_velocity * (1.0 - _motor_shares(arm, linearised_at)) / arm.gear_ratios
    at_links = list(arm.shared_links)
    shared_lag = lag_velocity[:, None, at_links] * arm.transmission[at_links].T
    return _BodyEquations(phi, lags, torque + lags @ c, own_lag, shared_lag)


def twisted_links(
    arm: Arm, stretch: FilteredRecord, linearised_at: Estimate, record: int
) -> list[FloatArray]:
    """Motion of the links behind twisted gears, as `FilteredRecord.motion`."""
    links = stretch.links
    if not n_compliances(arm):
        return list(links)
    gears = _gear_torques(arm, stretch, linearised_at, record)
    return list(np.subtract(links, linearised_at.compliance * gears))


def _gear_torques(
    arm: Arm, stretch: FilteredRecord, linearised_at: Estimate, record: int
) -> FloatArray:
    """Torque through each elastic gear, link side, and its first two derivatives.

    Shape (3, n_motion, n_joints), zero for rigid gears.
    """
    gear = _gear_torque(arm, stretch, linearised_at, linearised_at.stiction_torque[record])
    gear *= arm.is_elastic
    interval = stretch.motion_step * stretch.signals.sample_time
    rate = differentiate(gear, interval)
    return np.stack([gear, rate, differentiate(rate, interval)])


def _motor_shares(arm: Arm, linearised_at: Estimate) -> FloatArray:
    """Motors' shares of the total viscous friction without that of shared links: (n_joints,)."""
    shares = np.full(arm.n_joints, linearised_at.shares.viscous_friction)
    shares[list(arm.shared_links)] = 1.0
    return shares


def _link_viscous_friction(arm: Arm, linearised_at: Estimate) -> FloatArray:
    """Viscous friction of the links, link side: (n_joints,)."""
    total = arm.joint_friction(linearised_at.solution)[:, 0]
    friction = (1.0 - _motor_shares(arm, linearised_at)) * total / arm.gear_ratios**2
    at = list(arm.shared_links)
    friction[at] = linearised_at.solution[len(linearised_at.solution) - len(at) :]
    return np.asarray(friction)


def _payload_torque(
    arm: Arm, stretch: FilteredRecord, links: Sequence[FloatArray]
) -> FloatArray | float:
    """Motor torques that move the known payload of a record, filtered: (n_rows, n_joints)."""
    payload = stretch.signals.experiment.payload
    return 0.0 if payload is None else stretch.filtered(arm.payload_torques(payload, *links))


def _gear_torque(
    arm: Arm, stretch: FilteredRecord, linearised_at: Estimate, stiction_torque: FloatArray
) -> FloatArray:
    """Torque through each gear, link side: motor torque minus friction and motor inertia.

    Low-passed at twice the bandwidth of the equations, because it is differentiated twice.
    """
    (_, velocity, acceleration), (torque, direction) = stretch.motion, stretch.drive
    solution = linearised_at.solution
    viscous, coulomb, offset = arm.joint_friction(solution).T
    viscous = viscous - _link_viscous_friction(arm, linearised_at) * arm.gear_ratios**2
    friction = viscous * velocity + coulomb * direction + offset + stiction_torque
    inertia = arm.motors_of_rigid(linearised_at.shares.inertia) @ solution[: arm.n_body]
    net = torque - friction - inertia * acceleration
    T, step = stretch.signals.sample_time, stretch.motion_step
    return low_pass(arm.joints_of(net), 2.0 * stretch.bandwidth_hz, T, decimated=step)


def _base(arm: Arm, linearised_at: Estimate) -> FloatArray:
    """Base parameters of the links, (n_base,)."""
    return np.asarray(
        arm.links_of_rigid(linearised_at.shares.inertia) @ linearised_at.solution[: arm.n_body]
    )
