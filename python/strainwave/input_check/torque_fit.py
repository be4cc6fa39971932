"""Fit of one arm to the low-frequency torques of all joints: a test of axes, frames and gravity.

Behind rigid gears, the torques of all joints are linear in the same parameters of the links,

    tau_i = Y_i(q, dq, ddq) pi + m_Mi ddtheta_Mi + d_i dtheta_Mi + f_i sgn(dtheta_Mi) + o_i,

for any values of the parameters. A wrong axis, frame, ratio or gravity changes Y. The share of a
torque that the fit does not explain is then larger than with the correct chain.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np

from strainwave.domain import BoolArray, FloatArray, IntArray
from strainwave.domain.distributions import student_tail
from strainwave.domain.kinds import kind_of
from strainwave.dynamics.arm import Arm
from strainwave.input_check.evidence import Evidence, SlowRecord, is_slow
from strainwave.input_check.motors import (
    compute_motor_torque,
    effort_channel,
    motor_signals,
    sliding_rows,
    spread_stretches,
)
from strainwave.input_check.sensors import recall_motion
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.numerics.regression import ROWS_PER_INDEPENDENT_ROW, long_run_std
from strainwave.signals.link_readings import JointMotion

Array = TypeVar("Array", FloatArray, BoolArray)

# Every row in `_ROW_STRIDE` is used; 5 of 20 rows per period of the bandwidth frequency remain.
_ROW_STRIDE = 4
# The same for the low-pass of the columns.
_FILTER_STRIDE = 2
# Rows of all records that are used; more do not change which of two geometries is likelier.
_MAX_ROWS = 2400
# Relative singular value below which a combination of parameters is not excited.
_MIN_SINGULAR_VALUE = 1e-6
# Iterations of the weights, which are the residuals of the joints.
_N_ITERATIONS = 3
N_LINK_PARAMETERS = 10
"""Standard parameters of a link of a chain, or of a load."""

# Rows of a stretch that is predicted by the links fitted to all others: 5 are independent.
_FOLD_ROWS = 6
# Torsion moves links by some milliradians, so the torques of a rigid arm are wrong by this share.
_MODEL_ERROR_SHARE = 1e-3
# Rows between two postures at which inertias are evaluated, for their mean.
_POSTURE_STRIDE = 16
# Largest torque of a rotor over that of its gear at a locked output: motors resonate on their gears
# at three times the frequency of a slow motion at least.
_MAX_ROTOR_SHARE = 0.1
# Smallest unexplained share, so that noise-free torques can be compared.
_MIN_UNEXPLAINED = 1e-9


@dataclass(frozen=True, slots=True)
class TorqueSystem:
    """Equations of all joints without the parts that a joint's own motor and friction explain."""

    columns: FloatArray  # (n_rows, n_links) torque per parameter of the links
    torque: FloatArray  # (n_rows,) [N m] at the motors
    joint: FloatArray  # (n_rows,) of each row, from 1
    fold: IntArray  # (n_rows,) stretch of each row, from 0; the stretches of a record are adjacent
    records: tuple[str, ...]  # record of each stretch
    total: Mapping[int, float]  # joint -> sum of squares of the torque about its mean
    n_rows: Mapping[int, float]  # joint -> independent rows beyond its own parameters
    grams: Mapping[int, FloatArray] = field(default_factory=dict)  # joint -> columns' columns
    parameters: FloatArray | None = None  # (n_base, n_links) of the arm per column; None: the same


@dataclass(frozen=True, slots=True)
class Gain:
    """How much better one explanation predicts held-out stretches than another."""

    by_joint: FloatArray  # (n_joints,) logarithms of the ratios of the unexplained variances
    mean: float  # the same, weighted by the independent rows
    log_likelihood: float  # difference of the log likelihoods of independent rows
    probability: float  # of stretches that gain as much on average if none gains (Student's t)
    n_rows: float  # independent rows of all joints


@dataclass(frozen=True, slots=True)
class FitQuality:
    """How well one arm, fitted to the other stretches, predicts the torques of each stretch."""

    shares: FloatArray  # (n_folds, n_joints) squared prediction errors over the squared torques
    rows: FloatArray  # (n_folds, n_joints) independent rows beyond the parameters
    coordinate_std: FloatArray  # (n,) of the fitted coordinates of the arm

    @property
    def unexplained(self) -> FloatArray:
        """Share of each torque (n_joints,) that is not predicted."""
        return np.asarray(np.maximum(self.shares.sum(axis=0), _MIN_UNEXPLAINED))

    @property
    def n_rows(self) -> FloatArray:
        """Independent rows of each joint beyond the parameters, (n_joints,)."""
        return np.asarray(self.rows.sum(axis=0))

    @property
    def weights(self) -> FloatArray:
        """Shares of the independent rows of each joint, (n_joints,)."""
        return np.asarray(self.n_rows / self.n_rows.sum())

    @property
    def cost(self) -> float:
        """Half the mean logarithm of the unexplained shares."""
        return float(0.5 * self.weights @ np.log(self.unexplained))

    def gain(self, other: FitQuality) -> Gain:
        """Gain of this fit over another of the same stretches and joints.

        The test of Vuong (1989): the mean of the differences of the log likelihoods of stretches
        over its standard error, which the stretches themselves give.
        """
        by_joint = np.log(other.unexplained / self.unexplained)
        probability = 1.0
        if self.shares.shape == other.shares.shape and len(self.shares) > 1:
            # negative log likelihoods (n_folds, n_joints), with one variance for each joint
            costs = [
                0.5 * (q.rows * np.log(q.unexplained) + q.n_rows * q.shares / q.unexplained)
                for q in (other, self)
            ]
            of_folds, n_folds = (costs[0] - costs[1]).sum(axis=1), len(self.shares)
            std = max(float(of_folds.std(ddof=1)), 1e-300) / np.sqrt(n_folds)
            t = float(of_folds.mean() / std)
            probability = 0.5 * student_tail(t, n_folds - 1) if t > 0.0 else 1.0
        mean, n = float(self.weights @ by_joint), float(self.n_rows.sum())
        return Gain(by_joint, mean, 0.5 * n * mean, probability, n)


@dataclass(frozen=True, slots=True)
class TorqueFit:
    """Fit of all torques with one set of link parameters."""

    links: FloatArray  # (n_base,) parameters of the links, of least norm
    basis: FloatArray  # (n_rows, n_excited) orthonormal, of the weighted columns
    weight: FloatArray  # (n_rows,) 1 / residual standard deviation of the row's joint
    residual: FloatArray  # (n_rows,) weighted
    unexplained: Mapping[int, float]  # joint -> share of the variance of its torque
    n_rows: Mapping[int, float]  # joint -> independent rows beyond the parameters

    @property
    def cost(self) -> float:
        """Negative log likelihood: sum of the logarithms of the unexplained shares."""
        return sum(0.5 * self.n_rows[i] * float(np.log(u)) for i, u in self.unexplained.items())

    @property
    def n_all(self) -> float:
        """Independent rows of all joints."""
        return sum(self.n_rows.values())

    def project(self, torques: FloatArray) -> FloatArray:
        """Weighted torques (n_rows, n) without the parts that the links explain."""
        weighted = self.weight[:, None] * torques
        return weighted - self.basis @ (self.basis.T @ weighted)


def recall_quality(evidence: Evidence) -> FitQuality | None:
    """Quality of the fit under a hypothesis, computed once; None without torques."""
    records = [r for r in evidence.records if is_slow(r.experiment)]
    sources = [x for r in records for x in motor_signals(r, evidence.arm)]

    def compute() -> FitQuality | None:
        system = torque_system(evidence)
        return None if system is None else predict_stretches(system)

    setting = ("torque-fit", *(r.sample_time for r in records))
    return evidence.memory.recall(setting, (arm_of_torques(evidence), *sources), compute)


def friction_shares(evidence: Evidence) -> dict[int, tuple[float, float]]:
    """Share of friction in the torque of each joint, and its standard deviation.

    With the fitted links, velocity and direction explain the rest of a torque beyond the part that
    the acceleration of the motor explains.
    """
    system = torque_system(evidence)
    if system is None:
        return {}
    fit = fit_torques(system)
    friction, noise = dict.fromkeys(system.total, 0.0), dict.fromkeys(system.total, 0.0)
    for each in _blocks(evidence, Arm.base_regressor, "regressor"):
        own = each.torque - (each.of_links - each.of_links.mean(axis=0)) @ fit.links
        friction[each.joint] += float(np.sum((each.basis[:, 1:].T @ own) ** 2))
        rows = max(len(own) * _ROW_STRIDE / ROWS_PER_INDEPENDENT_ROW, 1.0)
        noise[each.joint] += float(np.sum(each.remainder(own) ** 2)) / rows
    return {
        i: (float(np.sqrt(friction[i] / total)), float(np.sqrt(noise[i] / total)))
        for i, total in system.total.items()
    }


def fit_torques(system: TorqueSystem) -> TorqueFit:
    """Least squares, weighted by the residuals of the joints.

    The normal equations of each joint are computed once; the weights only scale them. With scaled
    columns and singular values down to 1e-6 their rounding is 2e-4 of the weakest combinations, far
    less than the noise of the unexplained shares that the fits are compared by.
    """
    std = {i: float(np.sqrt(total / system.n_rows[i])) for i, total in system.total.items()}
    of_joint = {i: system.joint == i for i in std}
    equations = {}
    for i, rows in of_joint.items():
        block = system.columns[rows]
        gram = system.grams[i] if i in system.grams else block.T @ block
        equations[i] = gram, block.T @ system.torque[rows]
    for _ in range(_N_ITERATIONS):
        weight = np.zeros(len(system.torque))
        for i, rows in of_joint.items():
            weight[rows] = 1.0 / std[i]
        gram, product = (
            np.sum([parts[k] / std[i] ** 2 for i, parts in equations.items()], axis=0)
            for k in (0, 1)
        )
        root = _inverse_root(gram)
        links = root @ (root.T @ product)
        residual = weight * (system.torque - system.columns @ links)
        n_shared = root.shape[1] / len(std)
        n_rows = {i: max(n - n_shared, 1.0) for i, n in system.n_rows.items()}
        shares = {
            i: max(
                float(np.sum((std[i] * residual[rows]) ** 2)) / system.total[i], _MIN_UNEXPLAINED
            )
            for i, rows in of_joint.items()
        }
        std = {i: float(np.sqrt(shares[i] * system.total[i] / n_rows[i])) for i in std}
    basis = (weight[:, None] * system.columns) @ root
    links = links if system.parameters is None else system.parameters @ links
    return TorqueFit(links, basis, weight, residual, shares, n_rows)


def predict_stretches(
    system: TorqueSystem,
    without: Collection[str] = (),
    fitted: tuple[FloatArray, FloatArray] | None = None,
) -> FitQuality:
    """Prediction of the torques of each stretch by the links fitted to all others.

    The records `without` are not fitted. `fitted` are coordinates of the arm, (n,), in prior
    standard deviations, and the derivatives of the torques by them, (n_rows, n): the coordinates
    are fitted to the other stretches as well.

    The prior of a parameter of the links is that its torque is below the norm of all torques, so
    that combinations that one stretch alone excites are not extrapolated.
    """
    fit = fit_torques(system)
    columns, torque = fit.weight[:, None] * system.columns, fit.weight * system.torque
    size = np.linalg.norm(columns, axis=0)
    used = size > _MIN_SINGULAR_VALUE * size.max()
    columns = columns[:, used] / size[used]
    precision = np.full(columns.shape[1], 1.0 / max(float(torque @ torque), 1e-300))
    expected = np.zeros(columns.shape[1])
    if fitted is not None:
        at, slope = fitted
        columns = np.column_stack([columns, fit.weight[:, None] * slope])
        precision, expected = np.r_[precision, np.ones(len(at))], np.r_[expected, -at]
    excluded = np.isin(np.array(system.records)[system.fold], list(without))
    gram = columns[~excluded].T @ columns[~excluded]
    product = columns[~excluded].T @ torque[~excluded]
    product = product + precision * expected
    joints = sorted(system.total)
    squares = np.zeros((len(system.records), len(joints)))
    n_fitted = 0 if fitted is None else len(fitted[0])
    estimates = np.zeros((len(system.records), n_fitted))
    for k in range(len(system.records)):
        rows = system.fold == k
        block, target = columns[rows], torque[rows]
        kept = float(system.records[k] not in without)
        left = gram - kept * block.T @ block, product - kept * block.T @ target
        links = np.linalg.solve(left[0] + np.diag(precision), left[1])
        estimates[k] = links[len(links) - n_fitted :]
        errors = (target - block @ links) / fit.weight[rows]
        for j, joint in enumerate(joints):
            squares[k, j] = float(np.sum(errors[system.joint[rows] == joint] ** 2))
    shares = squares / np.array([system.total[joint] for joint in joints])
    n_rows = np.array([fit.n_rows[joint] for joint in joints])
    counts = np.array(
        [np.bincount(system.fold[system.joint == j], minlength=len(squares)) for j in joints]
    )
    rows = n_rows * (counts / counts.sum(axis=1, keepdims=True)).T
    return FitQuality(shares, rows, _jackknife(estimates, system.records))


def _jackknife(estimates: FloatArray, records: Sequence[str]) -> FloatArray:
    """Standard deviations (n,) of estimates (n_folds, n), each without one stretch.

    The jackknife (Efron and Stein, 1981) over stretches, or over records if these differ more:
    errors of the model do not average out within a record. The effect of a record is the sum of
    those of its stretches, to first order.
    """
    effects, names = estimates - estimates.mean(axis=0), np.array(records)
    of_records = np.array([effects[names == name].sum(axis=0) for name in dict.fromkeys(records)])
    variances = [(len(x) - 1) / len(x) * np.sum(x**2, axis=0) for x in (effects, of_records)]
    return np.asarray(np.sqrt(np.max(variances, axis=0)))


def _inverse_root(gram: FloatArray) -> FloatArray:
    """L of the pseudoinverse L L' of the normal matrix, (n_links, n_excited).

    Its columns are scaled to the length one, in which the pseudoinverse has the least norm.
    """
    size = np.sqrt(np.diag(gram))
    used = size > _MIN_SINGULAR_VALUE * size.max()
    values, vectors = np.linalg.eigh(gram[np.ix_(used, used)] / np.outer(size[used], size[used]))
    excited = values > _MIN_SINGULAR_VALUE**2 * values.max(initial=0.0)
    root = np.zeros((len(size), int(excited.sum())))
    root[used] = vectors[:, excited] / np.sqrt(values[excited]) / size[used, None]
    return root


def torque_system(
    evidence: Evidence, loaded: str = "", locked: Collection[str] = ()
) -> TorqueSystem | None:
    """Equations of the slow records; None if there are none, or no torque varies.

    The load on the last link in the record `loaded` has parameters of its own. In the records
    `locked` the motors wind up their gears; None if the torque of a joint is not that of a spring.
    """
    blocks, joints, folds = [], [], []
    records: list[str] = []
    totals: dict[int, float] = {}
    n_rows: dict[int, float] = {}
    grams: dict[int, FloatArray] = {}
    wound: dict[int, FloatArray] = {}  # torques of spring and rotor at a locked output
    for each in _blocks(evidence, Arm.base_regressor, "regressor"):
        name = each.record.experiment.name
        block, i = each, each.joint
        if name in locked:
            block, parts = each.wound_up()
            wound[i] = wound.get(i, np.zeros(2)) + parts
        torque, columns = block.torque, block.columns
        n_folds = max(2, block.n_rows // _FOLD_ROWS)
        if name not in records:
            records += [name] * n_folds
        folds.append(records.index(name) + block.at * n_folds // block.n_rows)
        if loaded:
            of_load = columns[:, -N_LINK_PARAMETERS:] * (name == loaded)
            columns = np.column_stack([columns, of_load])
        else:
            grams[i] = grams[i] + block.gram if i in grams else block.gram
        blocks.append(np.column_stack([columns, block.remainder(torque)]))
        joints.append(np.full(len(torque), i))
        totals[i] = totals.get(i, 0.0) + float(torque @ torque)
        independent = len(torque) * _ROW_STRIDE / ROWS_PER_INDEPENDENT_ROW
        n_rows[i] = n_rows.get(i, 0.0) + max(independent - block.basis.shape[1] - 1, 1.0)
    is_moving = any(r > _MAX_ROTOR_SHARE * max(k, 0.0) or k < 0.0 for k, r in wound.values())
    if not blocks or is_moving:
        return None
    equations, joint = np.concatenate(blocks), np.concatenate(joints)
    columns, torques, fold = equations[:, :-1], equations[:, -1], np.concatenate(folds)
    parameters = _standard_parameters(evidence, columns.shape[1])
    if parameters is not None:
        columns = columns @ parameters
        grams = {i: parameters.T @ gram @ parameters for i, gram in grams.items()}
    names = tuple(records)
    return TorqueSystem(columns, torques, joint, fold, names, totals, n_rows, grams, parameters)


def _standard_parameters(evidence: Evidence, n: int) -> FloatArray | None:
    """Parameters of the arm, and of a load, per standard parameter of the links, (n, n_standard).

    Behind the axes of a plane, gravity and inertia act on the same first moments. None without
    gravity, or for chains, which have the standard parameters.
    """
    arm = evidence.study.arm
    rows = kind_of(arm).standard_rows(arm)
    if not rows or not arm.gravity:
        return None
    standard = [*dict.fromkeys(key for row in rows.values() for key in row)]
    of_links = [[rows[key].get(s, 0.0) for s in standard] for key in evidence.arm.base_names]
    return np.asarray(np.kron(np.eye(n // len(of_links)), of_links), dtype=np.float64)


def with_friction_laws(evidence: Evidence, system: TorqueSystem, links: FloatArray) -> TorqueSystem:
    """The equations with friction that depends on the direction and on the load of each joint.

    The load is the torque of given links and of the motor's acceleration, which torques do not
    separate. The first columns are those of the links.
    """
    parts, n_joints = [], evidence.arm.n_joints
    for each in _blocks(evidence, Arm.base_regressor, "regressor"):
        direction, load = np.sign(each.own[:, 2]), each.of_links @ links
        rest = each.torque - (load - load.mean())
        load = load + each.own[:, 0] * np.linalg.lstsq(each.own, rest)[0][0]
        laws = each.remainder(np.column_stack([each.own[:, 1], np.abs(load)]) * direction[:, None])
        columns = np.zeros((len(laws), n_joints, laws.shape[1]))
        columns[:, each.joint - 1] = laws
        parts.append(columns.reshape(len(laws), -1))
    columns = np.column_stack([system.columns, np.concatenate(parts)])
    return replace(system, columns=columns, grams={}, parameters=None)


def unexplained_torques(evidence: Evidence, links: FloatArray) -> FloatArray:
    """Torques that given links leave, in the rows of `torque_system`."""

    def torques_of(
        arm: Arm, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        return arm.link_torques(links, angle, velocity, acceleration)[:, :, None]

    return np.concatenate(
        [
            block.remainder(block.torque - block.of_links[:, 0])
            for block in _blocks(evidence, torques_of, None)
        ]
    )


def arm_of_torques(evidence: Evidence) -> Arm:
    """The arm whose torques are logged: without gravity if the drivers subtract it."""
    arm = evidence.arm
    meanings = {each.meaning for each in evidence.study.channels.values()}
    if "without-gravity" not in meanings:
        return arm
    return evidence.memory.recall("without gravity", (arm,), lambda: replace(arm, gravity=None))


@dataclass(frozen=True, slots=True)
class TorqueRegression:
    """Regression of the torque of one joint on its own motion and that of the links."""

    joint: int  # from 1
    inertia: float  # [kg m^2] motor side, of the joint's own acceleration
    inertia_std: float
    explained: float  # share of the variance of the torque


def regress_torques(evidence: Evidence) -> Iterator[TorqueRegression]:
    """Regress the torque of each joint with an effort, each with links of its own.

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
        estimate = evidence.memory.recall(setting, sources, compute)
        if estimate is not None:
            yield estimate


def _regress_torque(
    evidence: Evidence, records: Sequence[SlowRecord], i: int
) -> TorqueRegression | None:
    """Regress the torque of joint i (from 0) over records, with one constant per record.

    A spring to ground opposes the acceleration of an oscillation, as a wrong sign does. An inertia
    is therefore negative only if it is so with a spring.
    """
    arm = arm_of_torques(evidence)
    unit = arm.links_of(np.eye(arm.n_joints)[i])
    targets, blocks, weights = [], [], []
    for block in _blocks(evidence, Arm.base_regressor, "regressor", records, i):
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
    estimates, rows_per_independent = [], ROWS_PER_INDEPENDENT_ROW / _ROW_STRIDE
    for used in (columns[:, :-1], columns):
        root = _inverse_root(used.T @ used)
        basis, of_weight = used @ root, np.r_[weight, 0.0][: used.shape[1]] @ root
        value, total = basis.T @ target, float(target @ target)
        n_free = len(target) - rows_per_independent * basis.shape[1]
        if n_free <= 0.0:  # a short record does not determine the links
            continue
        residual = target - basis @ value
        squares, least = float(residual @ residual), _MODEL_ERROR_SHARE**2 * total
        variance = rows_per_independent * max(squares / n_free, least / len(target))
        long_run = long_run_std((basis @ of_weight)[:, None], residual, _ROW_STRIDE)
        std = max(float(np.sqrt(variance) * np.linalg.norm(of_weight)), float(long_run[0]))
        inertia, explained = float(of_weight @ value), 1.0 - squares / total
        estimates.append(TorqueRegression(i + 1, inertia, std, explained))
        if inertia >= 0.0:
            break
    return estimates[-1] if estimates else None


@dataclass(frozen=True)
class _Block:
    """Rows of one joint in one record."""

    record: SlowRecord
    joint: int  # from 1
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

    def wound_up(self) -> tuple[_Block, FloatArray]:
        """The block of a locked link, with the spring of its gear; torques of spring and rotor.

        These are lengths (2,) of the least squares; zero if the rows do not determine them.
        """
        spring = self.remainder(self.angle)
        columns = np.column_stack([self.angle - self.angle.mean(), self.own])
        size = np.linalg.norm(columns, axis=0) + np.finfo(float).tiny
        parts = np.linalg.lstsq(columns / size, self.torque)[0][:2]
        n_rows = len(spring) * _ROW_STRIDE / ROWS_PER_INDEPENDENT_ROW
        basis = np.column_stack([self.basis, spring / max(float(np.linalg.norm(spring)), 1e-300)])
        block = replace(self, basis=basis, of_links=np.zeros_like(self.of_links))
        return block, parts * (n_rows > columns.shape[1])

    def remainder(self, torques: FloatArray) -> FloatArray:
        """Torques (n_rows,) or (n_rows, n) without that part, about their mean."""
        centred = torques - torques.mean(axis=0)
        return np.asarray(centred - self.basis @ (self.basis.T @ centred))


def _blocks(
    evidence: Evidence,
    torques_of: Callable[[Arm, FloatArray, FloatArray, FloatArray], FloatArray],
    name: str | None,
    records: Sequence[SlowRecord] | None = None,
    only: int | None = None,
) -> Iterator[_Block]:
    """Rows of each joint, or one, in each slow record, or others, with torques of the links.

    `torques_of` returns torques at the links, (n_samples, n_joints, n), of a motion. Under `name`
    they are computed once for each motion; hypotheses about the torques share them.
    """
    arm = arm_of_torques(evidence)
    if records is None:
        records = [r for r in evidence.records if is_slow(r.experiment)]
    for record, stretches in zip(records, spread_stretches(records, _MAX_ROWS), strict=True):
        motion = recall_motion(record, evidence)
        compute = partial(_motor_torques, record, stretches, motion, arm, torques_of)
        setting = (name, record.sample_time, *(each.start for each in stretches))
        angles = [record.channels[f"theta_m{i + 1}"] for i in range(arm.n_joints)]
        is_stated = name is not None and evidence.memory.is_stated(evidence.arm, *angles)
        if name and evidence.memory.is_stated(evidence.arm):
            of_motors = evidence.memory.recall(setting, (arm, *angles), compute)
        else:
            of_motors = compute()
        for i in range(arm.n_joints) if only is None else (only,):
            effort = effort_channel(record.channels, i + 1)
            if effort is None:
                continue
            torque = record.channels[effort]
            make = partial(_block, evidence, record, i, stretches, of_motors)
            if is_stated and evidence.memory.is_stated(torque):
                block = evidence.memory.recall((i, *setting), (arm, torque, *angles), make)
            else:
                block = make()
            if block is not None:
                yield block


def _block(
    evidence: Evidence,
    record: SlowRecord,
    i: int,
    stretches: Sequence[slice],
    of_motors: FloatArray,
) -> _Block | None:
    """Rows of joint i, from 0, in a record; None if the motor or its torque does not vary."""
    rows, own, basis = _recall_basis(evidence, record, i, stretches)
    torque = _strided(compute_motor_torque(record, evidence.arm, i), stretches)[rows]
    if own is None or not np.ptp(torque) > 0.0:
        return None
    angle = _strided(record.channels[f"theta_m{i + 1}"], stretches)[rows]
    at, centred = np.flatnonzero(rows), torque - torque.mean()
    return _Block(record, i + 1, centred, at, len(rows), angle, own, basis, of_motors[rows, i])


def _motor_torques(
    record: SlowRecord,
    stretches: Sequence[slice],
    motion: JointMotion,
    arm: Arm,
    torques_of: Callable[[Arm, FloatArray, FloatArray, FloatArray], FloatArray],
) -> FloatArray:
    """Torques of the links at the motors in the used rows of a record, (n_rows, n_joints, n)."""
    states = motion.angle, motion.velocity, motion.acceleration
    parts = []
    for each in stretches:
        of_links = torques_of(arm, *(x[each][::_FILTER_STRIDE] for x in states))
        of_motors = np.swapaxes(arm.motors_of(np.swapaxes(of_links, 1, 2)), 1, 2)
        # The torques of a smooth motion have harmonics, which the filter removed from the log.
        flat, T = of_motors.reshape(len(of_motors), -1), record.sample_time * _FILTER_STRIDE
        flat = low_pass(flat, record.bandwidth_hz, T)[:: _ROW_STRIDE // _FILTER_STRIDE]
        parts.append(flat.reshape(-1, *of_motors.shape[1:]))
    return np.concatenate(parts)


def _recall_basis(
    evidence: Evidence, record: SlowRecord, i: int, stretches: Sequence[slice]
) -> tuple[BoolArray, FloatArray | None, FloatArray]:
    """Sliding rows of joint i, from 0, what its motor and friction explain, and a basis of it.

    None if the motor does not move.
    """
    angle, T = record.channels[f"theta_m{i + 1}"], record.sample_time

    def compute() -> tuple[BoolArray, FloatArray | None, FloatArray]:
        sliding = sliding_rows(record, i)
        edge = int(np.ceil(1.0 / (record.bandwidth_hz * T)))
        exact = np.zeros(len(sliding), dtype=bool)  # rows without end effects of the filter
        for each in stretches:
            exact[each.start + edge : each.stop - edge] = True
        rows = _strided(sliding & exact, stretches)
        if not rows.any():
            return rows, None, np.zeros((0, 0))
        rate = differentiate(angle, T)
        columns = [differentiate(rate, T), rate, record.direction[:, i]]
        own = _strided(np.column_stack(columns), stretches)[rows]
        own = own - own.mean(axis=0)
        norms = np.linalg.norm(own, axis=0)
        varying = norms > _MIN_SINGULAR_VALUE * np.sqrt(len(own)) * np.array([0.0, 0.0, 1.0])
        if not varying[:2].all():
            return rows, None, np.zeros((0, 0))
        return rows, own, np.linalg.qr(own[:, varying] / norms[varying])[0]

    setting = ("own", i, T, *(each.start for each in stretches))
    return evidence.memory.recall(setting, (angle,), compute)


def _strided(signal: Array, stretches: Sequence[slice]) -> Array:
    """Every row in `_ROW_STRIDE` of the stretches of a signal."""
    return np.concatenate([signal[each][::_ROW_STRIDE] for each in stretches])
