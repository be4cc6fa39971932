"""Payload step: the ten standard parameters of a load on the last link of an identified arm.

The load adds Y_n phi to the torques of the arm, with its standard parameters phi in the last link's
frame and the ten columns Y_n of that link as part of a general chain:

    tau = Y(q, dq, ddq) pi + friction + Y_n phi

The equations are those of the rigid step, filtered and with the torsion of elastic gears. The arm's
parameters are unknowns with the identified values and their covariance as prior, so the intervals
of the load contain the errors of the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from strainwave.domain import BoolArray, FloatArray, FrictionTerm, Signals
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA, core_arm
from strainwave.domain.arm.combinations import FRICTION_COLUMNS
from strainwave.domain.arm.consistent_links import (
    INERTIA_ENTRIES,
    consistent_links,
    standard_parameters,
)
from strainwave.domain.arm.description import LinkPrior
from strainwave.domain.arm.gear_laws import GearLaw
from strainwave.domain.arm.kinds.base import MOTOR_SHARE
from strainwave.domain.keys import JointNumber, Key
from strainwave.domain.results.distributions import f_quantile, student_quantile
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import CORRECTIONS, corrected_signals
from strainwave.errors import NotIdentifiable
from strainwave.identification.rigid.equations import (
    JACKKNIFE_BLOCKS,
    Estimate,
    FurtherTerm,
    MotorShares,
    assemble,
    estimate_of,
    term_columns,
    twisted_links,
)
from strainwave.identification.rigid.filtered_record import FilteredRecord, n_compliances
from strainwave.identification.rigid.trial import Motion, excess_variance, prepare_all
from strainwave.numerics import least_squares as ls
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.motor import period_of

N_PARAMETERS = 10
"""Standard parameters of a body: mass, first moments, inertias about the frame's origin."""

_MAX_ITERATIONS = 12
_TOLERANCE = 0.02  # change in standard deviations for white errors, as in the rigid step
# friction of gears falls by a third from cold to warm: prior standard deviation over its values
_FRICTION_CHANGE = 0.3
UNKNOWN_STDS = 10.0  # prior standard deviation of an undetermined parameter, over its torque
_BANDWIDTH_RATIOS = (2.0**-0.5, 2.0**0.5)  # at which the change of the estimate shows model errors
_GUESSED_RADIUS = 0.05  # [m] radius of gyration of the load to which the consistent one is nearest
_MIN_WEIGHT = 1e-12  # of a direction of the covariance, which is singular to rounding below it
_MOVED_LEVEL = 1e-4  # probability of a change of this size by chance


@dataclass(frozen=True, slots=True)
class ArmPrior:
    """Identified parameters of an arm with their errors, in the order of `Arm.rigid_columns`."""

    solution: FloatArray  # (n_parameters,); zero if not determined
    covariance: FloatArray  # (n_parameters, n_parameters)
    is_determined: BoolArray  # (n_parameters,)
    compliance: FloatArray  # (n_joints,) [rad/(N m), m/N] of the gears, link side
    compliance_std: FloatArray  # (n_joints,); infinite: only the prior of the rigid step is known
    motor_shares: FloatArray  # (n_joints,) of inertias that rigid motion does not separate
    bandwidth_hz: float  # of the rigid model
    friction_terms: tuple[FrictionTerm, ...] = ()


@dataclass(frozen=True, slots=True)
class LoadFit:
    """Standard parameters of a load in the last link's frame, with their errors."""

    value: FloatArray  # (10,) unconstrained estimate
    covariance: FloatArray  # (10, 10)
    is_determined: BoolArray  # (10,)
    n_blocks: int  # of the jackknife
    shift: float  # squared distance of parts of the records over its limit; above 1: it moved

    @property
    def half_width(self) -> float:
        """Half-width of 95 % intervals in standard deviations."""
        return student_quantile(0.975, max(1, self.n_blocks - 1))

    @property
    def stds(self) -> FloatArray:
        """Standard deviations, (10,)."""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))

    @property
    def consistent(self) -> LinkPrior:
        """Standard parameters of a body that agree with the estimate within its errors.

        Parameters that are not determined are those of a compact body.
        """
        known = np.flatnonzero(self.is_determined)
        value, covariance = self.value[known], self.covariance[np.ix_(known, known)]
        mass = max(float(self.value[0]), 3.0 * float(self.stds[0]))
        if not self.is_determined[0]:
            mass = 1.0
        first = np.where(self.is_determined[1:4], self.value[1:4], 0.0)
        guess = standard_parameters(mass, first / mass, mass * _GUESSED_RADIUS**2 * np.eye(3))
        if not len(known):
            return guess
        scale = np.sqrt(np.diag(covariance))
        sizes, directions = np.linalg.eigh(covariance / np.outer(scale, scale))
        kept = sizes > _MIN_WEIGHT * sizes[-1]
        rows = np.zeros((int(kept.sum()), N_PARAMETERS))
        rows[:, known] = (directions[:, kept] / np.sqrt(sizes[kept])).T / scale
        return tuple(consistent_links([guess], rows, rows[:, known] @ value).tolist())

    @property
    def about_centre(self) -> tuple[FloatArray, FloatArray]:
        """Mass, centre of mass, and inertia xx, xy, xz, yy, yz, zz about it; their covariance."""
        changes = np.stack(
            [central_parameters(self.value, unit)[1] for unit in np.eye(N_PARAMETERS)]
        )
        values, _ = central_parameters(self.value, np.zeros(N_PARAMETERS))
        return values, changes.T @ self.covariance @ changes


def central_parameters(value: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mass, centre and inertia about it for standard parameters; their derivative along a change.

    I_c = I - (h.h E - h h')/m with the inertia I about the origin and the first moments h.
    """
    (m, *_), h, inertia = value, value[1:4], _inertia_matrix(value[4:])
    dm, dh = change[0], change[1:4]
    steiner = h @ h * np.eye(3) - np.outer(h, h)
    of_h = 2.0 * (h @ dh) * np.eye(3) - np.outer(h, dh) - np.outer(dh, h)
    centre, about = h / m, inertia - steiner / m
    d_centre = dh / m - h * dm / m**2
    d_about = _inertia_matrix(change[4:]) - of_h / m + steiner * dm / m**2
    upper = np.triu_indices(3)
    return (
        np.concatenate([[m], centre, about[upper]]),
        np.concatenate([[dm], d_centre, d_about[upper]]),
    )


def _inertia_matrix(entries: FloatArray) -> FloatArray:
    """Inertias in the order of standard parameters as a matrix (3, 3)."""
    matrix = np.zeros((3, 3))
    for entry, (row, column) in zip(entries, INERTIA_ENTRIES, strict=True):
        matrix[row, column] = matrix[column, row] = entry
    return matrix


def fit_load(signals: Sequence[Signals], arm: Arm, prior: ArmPrior) -> LoadFit:
    """Estimate the load of records of an identified arm.

    `signals` has one item per record, from `signals.prepare_motor_signals`. Raises NotIdentifiable
    if no motor slides, or if no sample is usable.
    """
    records = [
        (corrected, period_of(corrected))
        for corrected in (corrected_signals(s, arm, prior.friction_terms) for s in signals)
    ]

    def fit(records: Sequence[Motion], ratio: float, start: FloatArray | None) -> LoadFit:
        return _fit(prepare_all(arm, records, ratio * prior.bandwidth_hz), arm, prior, start)

    best = fit(records, 1.0, None)
    middle = len(records) // 2
    pairs = [[[_half(s, part) for s, _ in records] for part in (0, 1)]]
    pairs += [[records[:middle], records[middle:]]] if middle else []
    jobs: list[Callable[[], LoadFit | None]]
    jobs = [partial(fit, records, ratio, best.value) for ratio in _BANDWIDTH_RATIOS]
    jobs += [partial(_fit_if_it_moves, fit, part, best.value) for pair in pairs for part in pair]
    others = run_parallel(jobs)
    n = len(_BANDWIDTH_RATIOS)
    spread = [(each.value, np.diag(each.covariance)) for each in others[:n] if each]
    excess = excess_variance(best.value, spread)
    covariance = best.covariance + np.diag(np.where(best.is_determined, excess, 0.0))
    parts = [(a, b) for a, b in zip(others[n::2], others[n + 1 :: 2], strict=True) if a and b]
    shift = max((_shift(a, b, excess) for a, b in parts), default=0.0)
    return replace(best, covariance=covariance, shift=shift)


def _fit_if_it_moves(
    fit: Callable[[Sequence[Motion], float, FloatArray], LoadFit],
    records: Sequence[Motion],
    start: FloatArray,
) -> LoadFit | None:
    """The fit of a part of the records; None if nothing moves in it."""
    try:
        return fit(records, 1.0, start)
    except NotIdentifiable:
        return None


def _half(signals: Signals, part: int) -> Motion:
    """One half of a record."""
    middle = len(signals.time) // 2
    kept = slice(0, middle) if part == 0 else slice(middle, None)
    arrays = {
        f.name: getattr(signals, f.name)[kept]
        for f in fields(signals)
        if isinstance(value := getattr(signals, f.name), np.ndarray)
        and len(value) == len(signals.time)
    }
    half = replace(signals, **arrays)
    return half, period_of(half)


def _shift(first: LoadFit, second: LoadFit, excess: FloatArray) -> float:
    """Squared distance of mass and first moments of two fits over its limit.

    Hotelling's limit: the covariances are those of a few blocks. `excess` (10,) are variances of
    the model error.
    """
    at = np.flatnonzero((first.is_determined & second.is_determined)[:4])
    if not len(at):
        return 0.0
    change = (second.value - first.value)[at]
    covariance = first.covariance + second.covariance + 2.0 * np.diag(excess)
    distance = float(change @ np.linalg.solve(covariance[np.ix_(at, at)], change))
    degrees = max(first.n_blocks, second.n_blocks) - len(at)
    ratio = len(at) * (degrees + len(at) - 1) / degrees
    return distance / (ratio * f_quantile(1.0 - _MOVED_LEVEL, len(at), degrees))


def _fit(
    stretches: tuple[FilteredRecord, ...], arm: Arm, prior: ArmPrior, start: FloatArray | None
) -> LoadFit:
    """Iterate the load, the changes of the arm and the weights to convergence at one bandwidth.

    `start` (10,) is the load of a similar fit, from which fewer iterations converge.
    """
    shares = replace(MotorShares.usual(arm), inertia=prior.motor_shares)
    no_friction = tuple(
        np.zeros_like(s.motion[0] if s.stiction_shapes else s.torque[:0]) for s in stretches
    )
    estimate = Estimate(prior.solution, prior.compliance, no_friction, shares)
    value, root = np.zeros(N_PARAMETERS) if start is None else start, np.zeros(0)
    n = n_compliances(arm)
    for iteration in range(_MAX_ITERATIONS):
        system = _equations(arm, stretches, estimate, prior, value)
        equations = system.equations
        if not len(equations.target):
            raise NotIdentifiable("every sample is at an edge or in saturation; record for longer")
        if not len(root):
            root = ls.initial_weights(equations.target, equations.group)
        factor = ls.factorise(equations, root)
        change, value = factor.value - value, factor.value
        known = factor.deviation > 0.0
        has_settled = iteration > (1 if start is None else 0)
        if has_settled and np.all(np.abs(change[known]) <= _TOLERANCE * factor.deviation[known]):
            break
        free = estimate_of(arm, stretches, equations, factor, shares).stiction_torque
        shift = system.spread @ factor.common[n:]
        compliance = prior.compliance.copy()
        compliance[:n] += np.minimum(factor.common[:n], 3.0 * equations.common_deviation[:n])
        estimate = Estimate(prior.solution + shift, np.clip(compliance, 0.0, None), free, shares)
        root = ls.root_weights(equations, factor)
    covariance, _ = ls.jackknife(equations, factor)
    # a load of nothing has no torque: the limit is a share of the torque of arm and load
    whole = replace(equations, target=system.torque)
    return LoadFit(
        value=value,
        covariance=covariance,
        is_determined=ls.determined(whole, factor, covariance) & (factor.deviation > 0.0),
        n_blocks=len(np.unique(equations.block)),
        shift=0.0,
    )


@dataclass(frozen=True, slots=True)
class _System:
    """Equations of the load; the arm's errors are common nuisance parameters."""

    equations: ls.Equations
    spread: FloatArray  # (n_parameters, k) parameters per nuisance parameter of unit deviation
    torque: FloatArray  # (n_rows,) of arm and load


def _equations(
    arm: Arm,
    stretches: Sequence[FilteredRecord],
    estimate: Estimate,
    prior: ArmPrior,
    value: FloatArray,
) -> _System:
    of_arm = assemble(arm, stretches, estimate)
    spread = _spread(of_arm, prior, arm)
    n = n_compliances(arm)
    lags, stds = of_arm.common[:, :n], prior.compliance_std[:n]
    stds = np.where(np.isfinite(stds), stds, of_arm.common_deviation[:n])
    torques = [_load_torques(arm, s, estimate, record) for record, s in enumerate(stretches)]
    load = [_rows(s.filtered(x), s) for s, x in zip(stretches, torques, strict=True)]
    target = of_arm.target - of_arm.shared @ prior.solution - lags @ prior.compliance[:n]
    carried = [x @ value for x in torques]
    target -= _friction_of_terms(arm, stretches, estimate, prior.friction_terms, carried)
    equations = replace(
        of_arm,
        shared=np.concatenate(load),
        noise=np.zeros(N_PARAMETERS),
        common=np.concatenate([lags, of_arm.shared @ spread], axis=1),
        common_deviation=np.concatenate([stds, np.ones(spread.shape[1])]),
        target=target,
    )
    return _System(equations, spread, of_arm.target)


def _load_torques(arm: Arm, stretch: FilteredRecord, estimate: Estimate, record: int) -> FloatArray:
    """Motor torques per standard parameter of a body on the last link, (n_motion, n_joints, 10)."""
    links = twisted_links(arm, stretch, estimate, record)
    # programs of planar arms have fewer parameters
    chain = core_arm(replace(arm, kind="serial"), ["rigid"] * arm.n_joints)
    motion = (np.ascontiguousarray(x) for x in links)
    regressor = chain.base_regressor(*motion)[:, :, -N_PARAMETERS:]
    return np.asarray(arm.motors_of(np.swapaxes(regressor, 1, 2)).swapaxes(1, 2))


def _rows(filtered: FloatArray, stretch: FilteredRecord) -> FloatArray:
    """Values (n_rows, n_joints, ...) of one record in the order of the equations."""
    return np.asarray(filtered[stretch.row, stretch.joint])


def _friction_of_terms(
    arm: Arm,
    stretches: Sequence[FilteredRecord],
    estimate: Estimate,
    terms: Sequence[FrictionTerm],
    carried: Sequence[FloatArray],
) -> FloatArray | float:
    """Torques of the identified further terms of friction, (n_rows,).

    Other terms have corrected the signals. `carried` has the torques of the load,
    (n_motion, n_joints), which friction grows with.
    """
    known = [t for t in terms if t.size.value is not None and t.effect not in CORRECTIONS]
    further = [FurtherTerm(term.effect, (term.joint or 1) - 1, term.shape) for term in known]
    sizes = np.array([term.size.value for term in known])
    if not further:
        return 0.0
    return np.concatenate(
        [
            _rows(term_columns(further, arm, stretch, estimate, torques) @ sizes, stretch)
            for stretch, torques in zip(stretches, carried, strict=True)
        ]
    )


def _spread(equations: ls.Equations, prior: ArmPrior, arm: Arm) -> FloatArray:
    """Root of the prior covariance of the arm's parameters, (n_parameters, k).

    Friction may have changed since the identification. Parameters that are not determined have a
    standard deviation far above that of their torques.
    """
    scale = np.sqrt(np.diag(prior.covariance))
    unit = np.where(scale > 0.0, scale, 1.0)
    sizes, directions = np.linalg.eigh(_shrunk(prior.covariance / np.outer(unit, unit)))
    identified = unit[:, None] * directions * np.sqrt(np.clip(sizes, 0.0, None))
    stop = arm.n_body + FRICTION_COLUMNS * arm.n_joints
    friction = np.zeros_like(prior.solution)
    friction[arm.n_body : stop] = friction_changes(arm, prior.solution).ravel()
    torque = np.sqrt(np.mean(equations.target**2))
    size = np.sqrt(np.mean(equations.shared**2, axis=0))
    unknown = np.where(prior.is_determined | (size == 0.0), 0.0, UNKNOWN_STDS * torque)
    unknown /= np.where(size > 0.0, size, 1.0)
    columns = [identified, np.diag(friction), np.diag(unknown)]
    spread = np.concatenate(columns, axis=1)
    return np.asarray(spread[:, np.any(spread != 0.0, axis=0)])


def _shrunk(correlations: FloatArray) -> FloatArray:
    """Correlations of a jackknife, shrunk towards zero by the share that few blocks explain.

    J. Schafer, K. Strimmer, "A shrinkage approach to large-scale covariance matrix estimation",
    2005: lambda = sum var(r) / sum r^2, with var(r) = (1 - r^2)^2 / degrees of freedom. The
    covariance of 70 parameters from 20 blocks has directions without variance by chance, and the
    estimate of the load would rely on them.
    """
    off = ~np.eye(len(correlations), dtype=bool) & (correlations != 0.0)
    squares = correlations[off] ** 2
    if not len(squares):
        return correlations
    variances = (1.0 - squares) ** 2 / (JACKKNIFE_BLOCKS - 1)
    share = min(1.0, float(variances.sum() / squares.sum()))
    return np.where(np.eye(len(correlations), dtype=bool), 1.0, 1.0 - share) * correlations


def friction_changes(arm: Arm, solution: FloatArray) -> FloatArray:
    """Standard deviations of changes of joint friction since the identification, (n_joints, 3)."""
    of_joints = np.abs(arm.joint_friction(solution))
    of_joints[:, 2] += of_joints[:, 1]  # the offset changes by a share of the Coulomb friction
    return np.asarray(_FRICTION_CHANGE * of_joints)


def prior_of(
    arm: Arm,
    values: Mapping[Key, tuple[float, float]],
    labels: Sequence[str],
    covariance: FloatArray,
    bandwidth_hz: float,
    friction_terms: tuple[FrictionTerm, ...],
) -> ArmPrior:
    """The prior from values and standard deviations of a result, and its joint covariance."""
    columns = arm.rigid_columns
    n = len(columns)
    solution, stds, is_known = np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool)
    for k, column in enumerate(columns):
        if column.key in values:
            solution[k], stds[k] = values[column.key]
            is_known[k] = True
    at = {label: k for k, label in enumerate(labels)}
    joint = [at.get(column.label, -1) for column in columns]
    matrix = np.diag(stds**2)
    inside = [k for k in range(n) if joint[k] >= 0]
    rows = [joint[k] for k in inside]
    matrix[np.ix_(inside, inside)] = covariance[np.ix_(rows, rows)]
    compliance, compliance_std = np.zeros(arm.n_joints), np.zeros(arm.n_joints)
    for i, joint_of_arm in enumerate(arm.joints):
        if joint_of_arm.elastic:
            compliance[i], compliance_std[i] = _compliance(joint_of_arm.law, i + 1, values)
    return ArmPrior(
        solution,
        matrix,
        is_known,
        compliance,
        compliance_std,
        _motor_shares(arm, solution, values),
        bandwidth_hz,
        friction_terms,
    )


def _compliance(
    law: GearLaw, joint: JointNumber, values: Mapping[Key, tuple[float, float]]
) -> tuple[float, float]:
    """Compliance of a gear and its standard deviation, which contains the range of a curve.

    Infinite if the result has no stiffness.
    """
    stiffness = law.of_joint({key: value for key, (value, _) in values.items()}, joint)
    if any(parameter.name not in stiffness for parameter in law.parameters):
        return 0.0, np.inf
    low, high = law.stiffness_range(stiffness)
    slopes = [values[p.name, joint] for p in law.parameters if p.is_slope]
    relative = max(std / value for value, std in slopes)
    compliance, range_of_curve = 0.5 * (1.0 / low + 1.0 / high), 0.5 * (1.0 / low - 1.0 / high)
    return compliance, float(np.hypot(relative * compliance, range_of_curve))


def _motor_shares(
    arm: Arm, solution: FloatArray, values: Mapping[Key, tuple[float, float]]
) -> FloatArray:
    """Shares of the identified motor inertias in the base parameters that contain them."""
    shares = np.full(arm.n_joints, MOTOR_SHARE)
    for i, row in enumerate(arm.base.rows[:, len(arm.base.links) :].T):
        groups = np.flatnonzero(row)
        known = values.get((MOTOR_INERTIA, i + 1))
        if len(groups) and known and solution[groups[0]]:
            shares[i] = known[0] * row[groups[0]] / solution[groups[0]]
    return shares
