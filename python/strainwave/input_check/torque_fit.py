"""Fit of one arm to the low-frequency torques of all joints: a test of axes, frames and gravity.

Behind rigid gears, the torques of all joints are linear in the same parameters of the links,

    tau_i = Y_i(q, dq, ddq) pi + m_Mi ddtheta_Mi + d_i dtheta_Mi + f_i sgn(dtheta_Mi) + o_i,

for any values of the parameters. A wrong axis, frame, ratio or gravity changes Y. The share of a
torque that the fit does not explain is then larger than with the correct chain.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import ArmDescription, Diagnostic, FloatArray, IntArray, Place
from strainwave.domain.arm.consistent_links import is_consistent, principal_moments
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.keys import JointNumber
from strainwave.domain.results.distributions import CI95_STDS, student_tail
from strainwave.input_check.evidence import Evidence, is_slow
from strainwave.input_check.torque_rows import (
    EFFORTS,
    MIN_SINGULAR_VALUE,
    ROW_STRIDE,
    arm_of_torques,
    inverse_root,
    torque_rows,
)
from strainwave.numerics.statistics import ROWS_PER_INDEPENDENT_ROW, jackknife_std, regress

# Iterations of the weights, which are the residuals of the joints.
_N_ITERATIONS = 3
N_LINK_PARAMETERS = 10
"""Standard parameters of a link of a chain, or of a load."""

# Rows of a stretch that is predicted by the links fitted to all others: 5 are independent.
_FOLD_ROWS = 6
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
    joint: IntArray  # (n_rows,) of each row, its place in `joints`
    fold: IntArray  # (n_rows,) stretch of each row, from 0; the stretches of a record are adjacent
    records: tuple[str, ...]  # record of each stretch
    joints: tuple[JointNumber, ...]  # with a torque
    total: FloatArray  # (n_joints,) sum of squares of the torque about its mean
    n_rows: FloatArray  # (n_joints,) independent rows beyond the joint's own parameters
    grams: FloatArray | None = None  # (n_joints, n_links, n_links) columns' columns; None: unknown
    parameters: FloatArray | None = None  # (n_base, n_links) of the arm per column; None: the same


@dataclass(frozen=True, slots=True)
class Gain:
    """How much better one explanation predicts held-out stretches than another."""

    by_joint: FloatArray  # (n_joints,) logarithms of the ratios of the unexplained variances
    mean: float  # the same, weighted by the independent rows
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
    def cost(self) -> float:
        """Half the mean logarithm of the unexplained shares."""
        return 0.5 * float(np.average(np.log(self.unexplained), weights=self.n_rows))

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
        mean = float(np.average(by_joint, weights=self.n_rows))
        return Gain(by_joint, mean, probability, float(self.n_rows.sum()))


@dataclass(frozen=True, slots=True)
class TorqueFit:
    """Fit of all torques with one set of link parameters."""

    links: FloatArray  # (n_base,) parameters of the links, of least norm
    basis: FloatArray  # (n_rows, n_excited) orthonormal, of the weighted columns
    weight: FloatArray  # (n_rows,) 1 / residual standard deviation of the row's joint
    residual: FloatArray  # (n_rows,) weighted
    unexplained: FloatArray  # (n_joints,) share of the variance of the torque
    n_rows: FloatArray  # (n_joints,) independent rows beyond the parameters

    @property
    def cost(self) -> float:
        """Negative log likelihood: sum of the logarithms of the unexplained shares."""
        return 0.5 * float(self.n_rows @ np.log(self.unexplained))

    @property
    def n_all(self) -> float:
        """Independent rows of all joints."""
        return float(self.n_rows.sum())

    def project(self, torques: FloatArray) -> FloatArray:
        """Weighted torques (n_rows, n) without the parts that the links explain."""
        weighted = self.weight[:, None] * torques
        return weighted - self.basis @ (self.basis.T @ weighted)


def recall_quality(evidence: Evidence) -> FitQuality | None:
    """Quality of the fit under a hypothesis, computed once; None without torques."""
    records = [r for r in evidence.records if is_slow(r.experiment)]
    joints = range(1, evidence.arm.n_joints + 1)
    names = [f"{kind}{i}" for kind in ("theta_m", *EFFORTS) for i in joints]
    sources = [r.channels[name] for r in records for name in names if name in r.channels]

    def compute() -> FitQuality | None:
        system = torque_system(evidence)
        return None if system is None else predict_stretches(system)

    setting = ("torque-fit", *(r.sample_time for r in records))
    return evidence.cache.recall(setting, (arm_of_torques(evidence), *sources), compute)


def friction_shares(evidence: Evidence) -> dict[int, tuple[float, float]]:
    """Share of friction in the torque of each joint, and its standard deviation.

    With the fitted links, velocity and direction explain the rest of a torque beyond the part that
    the acceleration of the motor explains.
    """
    system = torque_system(evidence)
    if system is None:
        return {}
    fit = fit_torques(system)
    squares = np.zeros((len(system.joints), 2))  # of friction and noise
    for each in torque_rows(evidence):
        own = each.torque - (each.of_links - each.of_links.mean(axis=0)) @ fit.links
        friction, noise = each.basis[:, 1:].T @ own, each.remainder(own)
        rows = max(len(own) * ROW_STRIDE / ROWS_PER_INDEPENDENT_ROW, 1.0)
        squares[system.joints.index(each.joint)] += friction @ friction, noise @ noise / rows
    shares = np.sqrt(squares / system.total[:, None]).tolist()
    return {i: (share, std) for i, (share, std) in zip(system.joints, shares, strict=True)}


def fit_torques(system: TorqueSystem) -> TorqueFit:
    """Least squares, weighted by the residuals of the joints.

    The normal equations of each joint are computed once; the weights only scale them. With scaled
    columns and singular values down to 1e-6 their rounding is 2e-4 of the weakest combinations, far
    less than the noise of the unexplained shares that the fits are compared by.
    """
    n_joints, variance, grams = len(system.joints), system.total / system.n_rows, system.grams
    blocks = [np.flatnonzero(system.joint == k) for k in range(n_joints)]
    if grams is None:
        grams = np.array([system.columns[rows].T @ system.columns[rows] for rows in blocks])
    products = np.array([system.columns[rows].T @ system.torque[rows] for rows in blocks])
    for _ in range(_N_ITERATIONS):
        weight = 1.0 / np.sqrt(variance)[system.joint]
        root = inverse_root(np.tensordot(1.0 / variance, grams, 1))
        links = root @ (root.T @ (products.T @ (1.0 / variance)))
        residual = system.torque - system.columns @ links
        squares = np.bincount(system.joint, residual**2, n_joints)
        n_rows = np.maximum(system.n_rows - root.shape[1] / n_joints, 1.0)
        shares = np.maximum(squares / system.total, _MIN_UNEXPLAINED)
        variance = shares * system.total / n_rows
    basis = (weight[:, None] * system.columns) @ root
    links = links if system.parameters is None else system.parameters @ links
    return TorqueFit(links, basis, weight, weight * residual, shares, n_rows)


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
    used = size > MIN_SINGULAR_VALUE * size.max()
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
    n_folds, n_joints = len(system.records), len(system.joints)
    n_fitted = 0 if fitted is None else len(fitted[0])
    squares, estimates = np.zeros((n_folds, n_joints)), np.zeros((n_folds, n_fitted))
    for k, record in enumerate(system.records):
        rows = system.fold == k
        block, target = columns[rows], torque[rows]
        kept = float(record not in without)
        left = gram - kept * block.T @ block, product - kept * block.T @ target
        links = np.linalg.solve(left[0] + np.diag(precision), left[1])
        estimates[k] = links[len(links) - n_fitted :]
        errors = (target - block @ links) / fit.weight[rows]
        squares[k] = np.bincount(system.joint[rows], errors**2, n_joints)
    counts = np.zeros((n_folds, n_joints))
    np.add.at(counts, (system.fold, system.joint), 1.0)
    rows = fit.n_rows * counts / counts.sum(axis=0)
    return FitQuality(squares / system.total, rows, jackknife_std(estimates, system.records))


def torque_system(
    evidence: Evidence, loaded: str = "", locked: Collection[str] = ()
) -> TorqueSystem | None:
    """Equations of the slow records; None if there are none, or no torque varies.

    The load on the last link in the record `loaded` has parameters of its own. In the records
    `locked` the motors wind up their gears; None if the torque of a joint is not that of a spring.
    """
    blocks, numbers, folds = [], [], []
    records: list[str] = []
    totals: dict[int, float] = {}
    n_rows: dict[int, float] = {}
    grams: dict[int, FloatArray] = {}
    wound: dict[int, FloatArray] = {}  # torques of spring and rotor at a locked output
    for each in torque_rows(evidence):
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
            grams[i] = grams.get(i, 0.0) + block.gram
        blocks.append(np.column_stack([columns, block.remainder(torque)]))
        numbers.append(np.full(len(torque), i))
        totals[i] = totals.get(i, 0.0) + float(torque @ torque)
        independent = len(torque) * ROW_STRIDE / ROWS_PER_INDEPENDENT_ROW
        n_rows[i] = n_rows.get(i, 0.0) + max(independent - block.basis.shape[1] - 1, 1.0)
    is_moving = any(r > _MAX_ROTOR_SHARE * max(k, 0.0) or k < 0.0 for k, r in wound.values())
    if not blocks or is_moving:
        return None
    equations, joints = np.concatenate(blocks), sorted(totals)
    columns, of_joints = equations[:, :-1], np.array([grams[i] for i in joints if grams])
    parameters = _standard_parameters(evidence, columns.shape[1])
    if parameters is not None:
        columns = columns @ parameters
        of_joints = parameters.T @ of_joints @ parameters if grams else of_joints
    return TorqueSystem(
        columns=columns,
        torque=equations[:, -1],
        joint=np.searchsorted(joints, np.concatenate(numbers)),
        fold=np.concatenate(folds),
        records=tuple(records),
        joints=tuple(joints),
        total=np.array([totals[i] for i in joints]),
        n_rows=np.array([n_rows[i] for i in joints]),
        grams=of_joints if grams else None,
        parameters=parameters,
    )


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
    for each in torque_rows(evidence):
        direction, load = np.sign(each.own[:, 2]), each.of_links @ links
        rest = each.torque - (load - load.mean())
        load = load + each.own[:, 0] * np.linalg.lstsq(each.own, rest)[0][0]
        laws = each.remainder(np.column_stack([each.own[:, 1], np.abs(load)]) * direction[:, None])
        columns = np.zeros((len(laws), n_joints, laws.shape[1]))
        columns[:, each.joint - 1] = laws
        parts.append(columns.reshape(len(laws), -1))
    columns = np.column_stack([system.columns, np.concatenate(parts)])
    return replace(system, columns=columns, grams=None, parameters=None)


# Factor of a mass within which a guess is accepted, in either direction.
_TOLERATED_FACTOR = 2.0
# Minimum share of the torques that the scaled links must explain.
_MIN_EXPLAINED = 0.5
# Norm of a link's torques over that of the largest below which the motion does not show its mass.
_MIN_TORQUE = 1e-6


def report_impossible_links(arm: ArmDescription) -> Iterator[Diagnostic]:
    """Yield a warning for each link whose inertial values in the URDF belong to no body.

    Links without values are guessed as well, but nothing in the file is wrong.
    """
    for number, prior in enumerate(arm.urdf.priors if arm.urdf else (), start=1):
        if any(prior) and not is_consistent(prior):
            yield Diagnostic(
                "urdf-inertia",
                Place(joint=number, key="urdf"),
                link=number,
                mass=prior[0],
                moments=tuple(principal_moments(prior).tolist()),
            )


def compare_urdf_masses(evidence: Evidence) -> Iterator[Diagnostic]:
    """Yield a warning for each link whose mass in the URDF the torques exclude.

    Each link keeps the shape of its mass in the URDF and gets one factor,

        tau = sum_i s_i Y_i(q, dq, ddq) pi_i + friction,

    by weighted least squares over all joints. A factor far from 1 means another mass. Such values
    are only a prior, so the input remains consistent.
    """
    urdf = evidence.study.arm.urdf
    system = torque_system(evidence) if urdf is not None else None
    if urdf is None or system is None:
        return
    priors = np.array(urdf.priors)
    if not priors.any():
        return  # the file has no inertial values
    per_link = system.columns.reshape(len(system.torque), len(priors), -1)
    torques = np.einsum("rlp,lp->rl", per_link, priors)
    sizes = np.linalg.norm(torques, axis=0)
    shown = np.flatnonzero(sizes > _MIN_TORQUE * sizes.max())
    scaled = replace(system, columns=torques[:, shown], grams=None)
    weight = fit_torques(scaled).weight
    fit = regress(weight * system.torque, weight[:, None] * scaled.columns)
    if fit is None or fit.explained < _MIN_EXPLAINED:
        return
    stds = np.sqrt(np.diag(fit.covariance))
    for link, scale, std in zip(shown.tolist(), fit.value, stds, strict=True):
        low, high = scale - CI95_STDS * std, scale + CI95_STDS * std
        if low > _TOLERATED_FACTOR or 0.0 < high < 1.0 / _TOLERATED_FACTOR:
            mass, place = float(priors[link, 0]), Place(joint=link + 1, key="urdf")
            limits = {"low": max(0.0, float(low) * mass), "high": float(high) * mass}
            yield Diagnostic("urdf-mass", place, link=link + 1, mass=mass, **limits)
