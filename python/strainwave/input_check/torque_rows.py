"""Low-frequency rows of the torques of all joints, and of what moves them.

At low frequency the torques satisfy the equations of rigid joints, (5) to (7), for any stiffness of
the gears. Rows near reversals and at rest are omitted: there, Coulomb friction has any value
between its two.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np

from strainwave.domain import BoolArray, FloatArray, IntArray, channel_parts
from strainwave.domain.keys import JointIndex, JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import JointMotion
from strainwave.input_check.evidence import Evidence, PredictedSignal, SlowRecord, is_slow
from strainwave.input_check.sensors import recall_motion
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.numerics.statistics import ROWS_PER_INDEPENDENT_ROW, long_run_std
from strainwave.signals.drive_law import DriveLaw

Array = TypeVar("Array", FloatArray, BoolArray)

# Every row in `ROW_STRIDE` is used; 5 of 20 rows per period of the bandwidth frequency remain.
ROW_STRIDE = 4
# The same for the low-pass of the columns.
_FILTER_STRIDE = 2
# Rows of all records that are used; more do not change which of two geometries is likelier.
_MAX_ROWS = 2400
# Rows of a stretch of a long record: ten periods of the bandwidth frequency.
_STRETCH_ROWS = 200
# Minimum magnitude of the mean sign of the motor velocity for a row to count as sliding.
_MIN_MEAN_DIRECTION = 0.8
# Minimum number of sliding rows. With fewer, the regression uses all rows.
_MIN_SLIDING_ROWS = 60
# Relative singular value below which a combination of parameters is not excited.
MIN_SINGULAR_VALUE = 1e-6
# Torsion moves links by some milliradians, so the torques of a rigid arm are wrong by this share.
_MODEL_ERROR_SHARE = 1e-3
# Rows between two postures at which inertias are evaluated, for their mean.
_POSTURE_STRIDE = 16


EFFORTS = ("torque", "u", "tau_l")
"""Kinds of channels of the effort of a joint, of which the first present one is compared."""


def implied_density(evidence: Evidence) -> float | None:
    """Mass at the reach of an arm that its largest torque implies, over the reach cubed [kg/m^3].

    None without logged torques, of planar arms, whose distant masses have no length in the study,
    and with prismatic joints.
    """
    arm = evidence.arm
    lengths = [float(np.linalg.norm(joint.origin.xyz)) for joint in arm.joints[1:]]
    is_sliding = any(joint.motion == "prismatic" for joint in arm.joints)
    if not sum(lengths) or is_sliding or arm.has_planar_program:
        return None
    reach, masses = sum(lengths), []
    for record in evidence.records:
        motion = recall_motion(record, evidence)
        for i, joint in enumerate(arm.joints):
            name = effort_channel(record.channels, i + 1)
            if is_slow(record.experiment) and name and channel_parts(name)[0] != "u":
                torque = np.ptp(compute_motor_torque(record, arm, i)[record.inside])
                fastest = float(np.abs(motion.acceleration[record.inside, i]).max())
                size = reach * np.hypot(arm.gravity_size or 0.0, reach * fastest)
                masses.append(0.5 * float(torque) / abs(joint.gear_ratio) / max(size, 1e-300))
    return float(max(masses)) / reach**3 if masses else None


def spread_stretches(records: Sequence[SlowRecord], max_rows: int) -> list[list[slice]]:
    """Stretches of rows of each record, spread evenly over it; one at least per record.

    Whole records if these have no more than `max_rows`.
    """
    n_rows = [len(record.inside) for record in records]
    if sum(n_rows) <= max_rows:
        return [[slice(0, n)] for n in n_rows]
    stretches: list[list[slice]] = []
    for n in n_rows:  # stretches in the centres of equal parts
        count = max(1, int(max_rows / sum(n_rows) * n / _STRETCH_ROWS))
        length = min(_STRETCH_ROWS, n)
        starts = [int((k + 0.5) * n / count - 0.5 * length) for k in range(count)]
        stretches.append([slice(start, start + length) for start in starts])
    return stretches


def compute_motor_torque(record: SlowRecord, arm: Arm, i: JointIndex) -> FloatArray:
    """Motor torque of joint i, (n_rows,) [N m].

    Returns the logged torque, torque_per_volt times the voltage (with a scale of 1 if the study
    gives no torque_per_volt), or the reading of a sensor behind the gear.
    """
    name = effort_channel(record.channels, i + 1) or ""
    kind = channel_parts(name)[0]
    if kind == "torque":
        return record.channels[name]
    if kind == "tau_l":
        return arm.joints[i].gear_ratio * record.channels[name]
    return DriveLaw.of(arm.joints[i]).command(record.channels[name])


def effort_channel(channels: Collection[str], joint: JointNumber) -> str | None:
    """Channel of the effort of a joint: of its motor, or of a sensor behind the gear."""
    names = (f"{kind}{joint}" for kind in EFFORTS)
    return next((name for name in names if name in channels), None)


def arm_of_torques(evidence: Evidence) -> Arm:
    """The arm whose torques are logged: without gravity if the drivers subtract it."""
    arm = evidence.arm
    meanings = {each.meaning for each in evidence.study.channels.values()}
    if "without-gravity" not in meanings:
        return arm
    return evidence.cache.recall("without gravity", (arm,), lambda: replace(arm, gravity=None))


@dataclass(frozen=True)
class TorqueRows:
    """Rows of one joint in one record."""

    record: SlowRecord
    joint: JointNumber
    torque: FloatArray  # (n_rows,) [N m] about its mean
    at: IntArray  # (n_rows,) numbers of the rows in the record, of `n_rows`
    n_rows: int
    angle: FloatArray  # (n_rows,) [rad] of the motor
    own: FloatArray  # (n_rows, n) acceleration, rate and direction of the motor
    basis: FloatArray  # (n_rows, n) of what its own motor and friction explain
    of_links: FloatArray  # (n_rows, n) torques of the links at the motor

    @cached_property
    def columns(self) -> FloatArray:
        """Torques of the links without the part that the motor and friction explain."""
        return self.remainder(self.of_links)

    @cached_property
    def gram(self) -> FloatArray:
        """Normal matrix of the columns, (n, n)."""
        return np.asarray(self.columns.T @ self.columns)

    def wound_up(self) -> tuple[TorqueRows, FloatArray]:
        """The block of a locked link, with the spring of its gear; torques of spring and rotor.

        These are lengths (2,) of the least squares; zero if the rows do not determine them.
        """
        spring = self.remainder(self.angle)
        columns = np.column_stack([self.angle - self.angle.mean(), self.own])
        size = np.linalg.norm(columns, axis=0) + np.finfo(float).tiny
        parts = np.linalg.lstsq(columns / size, self.torque)[0][:2]
        n_rows = len(spring) * ROW_STRIDE / ROWS_PER_INDEPENDENT_ROW
        basis = np.column_stack([self.basis, spring / max(float(np.linalg.norm(spring)), 1e-300)])
        block = replace(self, basis=basis, of_links=np.zeros_like(self.of_links))
        return block, parts * (n_rows > columns.shape[1])

    def remainder(self, torques: FloatArray) -> FloatArray:
        """Torques (n_rows,) or (n_rows, n) without that part, about their mean."""
        centred = torques - torques.mean(axis=0)
        return np.asarray(centred - self.basis @ (self.basis.T @ centred))


def torque_rows(
    evidence: Evidence,
    links: FloatArray | None = None,
    records: Sequence[SlowRecord] | None = None,
    only: JointIndex | None = None,
) -> Iterator[TorqueRows]:
    """Rows of each joint, or one, in each slow record, or others, with torques of the links.

    The torques are those of given `links`, (n_base,), in one column, or have one column for each
    parameter. The latter are computed once for each motion; hypotheses about the torques share
    them.
    """
    arm = arm_of_torques(evidence)
    if records is None:
        records = [r for r in evidence.records if is_slow(r.experiment)]
    for record, stretches in zip(records, spread_stretches(records, _MAX_ROWS), strict=True):
        motion = recall_motion(record, evidence)
        compute = partial(_motor_torques, record, stretches, motion, arm, links)
        setting = ("rows", record.sample_time, *(each.start for each in stretches))
        angles = [record.channels[f"theta_m{i + 1}"] for i in range(arm.n_joints)]
        is_shared = links is None and evidence.cache.is_stated(evidence.arm)
        of_motors = evidence.cache.recall(setting, (arm, *angles), compute, is_kept=is_shared)
        for i in range(arm.n_joints) if only is None else (only,):
            effort = effort_channel(record.channels, i + 1)
            if effort is None:
                continue
            torque = record.channels[effort]
            make = partial(_block, evidence, record, i, stretches, of_motors)
            is_kept = is_shared and evidence.cache.is_stated(torque, *angles)
            sources = arm, torque, *angles
            block = evidence.cache.recall((i, *setting), sources, make, is_kept=is_kept)
            if block is not None:
                yield block


def _block(
    evidence: Evidence,
    record: SlowRecord,
    i: JointIndex,
    stretches: Sequence[slice],
    of_motors: FloatArray,
) -> TorqueRows | None:
    """Rows of joint i in a record; None if the motor or its torque does not vary."""
    motion = _recall_basis(evidence, record, i, stretches)
    if motion is None:
        return None
    rows, own, basis = motion
    torque = _strided(compute_motor_torque(record, evidence.arm, i), stretches)[rows]
    if not np.ptp(torque) > 0.0:
        return None
    angle = _strided(record.channels[f"theta_m{i + 1}"], stretches)[rows]
    at, centred = np.flatnonzero(rows), torque - torque.mean()
    return TorqueRows(record, i + 1, centred, at, len(rows), angle, own, basis, of_motors[rows, i])


def _motor_torques(
    record: SlowRecord,
    stretches: Sequence[slice],
    motion: JointMotion,
    arm: Arm,
    links: FloatArray | None,
) -> FloatArray:
    """Torques of the links at the motors in the used rows of a record, (n_rows, n_joints, n)."""
    parts = []
    for each in stretches:
        whole = motion.angle, motion.velocity, motion.acceleration
        states = tuple(x[each][::_FILTER_STRIDE] for x in whole)
        if links is None:
            of_links = arm.base_regressor(*states)
        else:
            of_links = arm.link_torques(links, *states)[:, :, None]
        of_motors = np.swapaxes(arm.motors_of(np.swapaxes(of_links, 1, 2)), 1, 2)
        # The torques of a smooth motion have harmonics, which the filter removed from the log.
        flat, T = of_motors.reshape(len(of_motors), -1), record.sample_time * _FILTER_STRIDE
        flat = low_pass(flat, record.bandwidth_hz, T)[:: ROW_STRIDE // _FILTER_STRIDE]
        parts.append(flat.reshape(-1, *of_motors.shape[1:]))
    return np.concatenate(parts)


def _recall_basis(
    evidence: Evidence, record: SlowRecord, i: JointIndex, stretches: Sequence[slice]
) -> tuple[BoolArray, FloatArray, FloatArray] | None:
    """Sliding rows of joint i, what its motor and friction explain, and a basis of it.

    All inner rows if the sliding ones are too few. None if the motor does not move.
    """
    angle, T = record.channels[f"theta_m{i + 1}"], record.sample_time

    def compute() -> tuple[BoolArray, FloatArray, FloatArray] | None:
        sliding = record.inside & (np.abs(record.direction[:, i]) > _MIN_MEAN_DIRECTION)
        sliding = sliding if sliding.sum() > _MIN_SLIDING_ROWS else record.inside
        edge = int(np.ceil(1.0 / (record.bandwidth_hz * T)))
        exact = np.zeros(len(sliding), dtype=bool)  # rows without end effects of the filter
        for each in stretches:
            exact[each.start + edge : each.stop - edge] = True
        rows = _strided(sliding & exact, stretches)
        if not record.moves[i] or not rows.any():
            return None
        rate = differentiate(angle, T)
        columns = [differentiate(rate, T), rate, record.direction[:, i]]
        own = _strided(np.column_stack(columns), stretches)[rows]
        own = own - own.mean(axis=0)
        norms = np.linalg.norm(own, axis=0)
        varying = norms > MIN_SINGULAR_VALUE * np.sqrt(len(own)) * np.array([0.0, 0.0, 1.0])
        if not varying[:2].all():
            return None
        return rows, own, np.linalg.qr(own[:, varying] / norms[varying])[0]

    setting = ("own", i, T, *(each.start for each in stretches))
    return evidence.cache.recall(setting, (angle,), compute)


def _strided(signal: Array, stretches: Sequence[slice]) -> Array:
    """Every row in `ROW_STRIDE` of the stretches of a signal."""
    return np.concatenate([signal[each][::ROW_STRIDE] for each in stretches])


def regress_torques(evidence: Evidence) -> Iterator[PredictedSignal]:
    """Regress the torque of each joint with an effort, each with links of its own.

    The inertia, motor side, is that of the joint's own acceleration [kg m^2].
    Uses all slow records; if there are none, those that excite the joint.
    """
    slow = [r for r in evidence.records if is_slow(r.experiment)]
    used = slow or list(evidence.records)
    for i in range(evidence.arm.n_joints):
        chosen = [r for r in used if slow or r.experiment.joint in (None, i + 1)]
        efforts = [r.channels.get(effort_channel(r.channels, i + 1) or "") for r in chosen]
        angles = [
            r.channels[f"theta_m{j}"] for r in chosen for j in range(1, evidence.arm.n_joints + 1)
        ]
        setting = ("inertia", i, *((r.sample_time, r.bandwidth_hz) for r in chosen))
        sources = (arm_of_torques(evidence), *efforts, *angles)
        compute = partial(_regress_torque, evidence, chosen, i)
        estimate = evidence.cache.recall(setting, sources, compute)
        if estimate is not None:
            yield estimate


def _regress_torque(
    evidence: Evidence, records: Sequence[SlowRecord], i: JointIndex
) -> PredictedSignal | None:
    """Regress the torque of joint i over records, with one constant per record.

    A spring to ground opposes the acceleration of an oscillation, as a wrong sign does. An inertia
    is therefore negative only if it is so with a spring.
    """
    arm = arm_of_torques(evidence)
    unit = arm.links_of(np.eye(arm.n_joints)[i])
    targets, blocks, weights = [], [], []
    for block in torque_rows(evidence, None, records, i):
        targets.append(block.torque)
        columns = np.column_stack([block.own, block.of_links, block.angle])
        blocks.append(columns - columns.mean(axis=0))
        q = recall_motion(block.record, evidence).angle[::_POSTURE_STRIDE]
        rest = np.zeros_like(q)
        links = arm.base_regressor(q, rest, rest + unit) - arm.base_regressor(q, rest, rest)
        weights.append(arm.motors_of(np.swapaxes(links, 1, 2)).mean(axis=0)[:, i])
    if not targets:
        return None
    target, columns = np.concatenate(targets), np.concatenate(blocks)
    weight = np.r_[1.0, 0.0, 0.0, np.mean(weights, axis=0)]
    estimates, rows_per_independent = [], ROWS_PER_INDEPENDENT_ROW / ROW_STRIDE
    for used in (columns[:, :-1], columns):
        root = inverse_root(used.T @ used)
        basis, of_weight = used @ root, np.r_[weight, 0.0][: used.shape[1]] @ root
        value, total = basis.T @ target, float(target @ target)
        n_free = len(target) - rows_per_independent * basis.shape[1]
        if n_free <= 0.0:  # a short record does not determine the links
            continue
        residual = target - basis @ value
        squares, least = float(residual @ residual), _MODEL_ERROR_SHARE**2 * total
        variance = rows_per_independent * max(squares / n_free, least / len(target))
        long_run = long_run_std((basis @ of_weight)[:, None], residual, ROW_STRIDE)
        std = max(float(np.sqrt(variance) * np.linalg.norm(of_weight)), float(long_run[0]))
        inertia, explained = float(of_weight @ value), 1.0 - squares / total
        name = effort_channel(evidence.channels, i + 1) or ""
        estimates.append(PredictedSignal(name, explained, {"inertia": (inertia, std)}))
        if inertia >= 0.0:
            break
    return estimates[-1] if estimates else None


def inverse_root(gram: FloatArray) -> FloatArray:
    """L of the pseudoinverse L L' of the normal matrix, (n_links, n_excited).

    Its columns are scaled to the length one, in which the pseudoinverse has the least norm.
    """
    size = np.sqrt(np.diag(gram))
    used = size > MIN_SINGULAR_VALUE * size.max()
    values, vectors = np.linalg.eigh(gram[np.ix_(used, used)] / np.outer(size[used], size[used]))
    excited = values > MIN_SINGULAR_VALUE**2 * values.max(initial=0.0)
    root = np.zeros((len(size), int(excited.sum())))
    root[used] = vectors[:, excited] / np.sqrt(values[excited]) / size[used, None]
    return root
