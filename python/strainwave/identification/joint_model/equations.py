"""Equations (S6), (S7) of one joint in one frequency band, with the values of the rigid model.

Where the motor may be in stiction, its friction torque is an additional unknown with a prior from
the measured velocity.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import Decoupled, FloatArray, IntArray, LinkSignals, RigidModel
from strainwave.domain.arm.combinations import is_uncoupled, total_inertia
from strainwave.domain.keys import Row
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import base_variations, interaction_torques
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, joint_of
from strainwave.identification.joint_model.stretches import Band
from strainwave.numerics import least_squares as ls
from strainwave.numerics.filters import apply_lags_without_aliases, band_pass, band_passes
from strainwave.numerics.linalg import Banded
from strainwave.numerics.parallel import raise_if_stopped
from strainwave.signals.standstill import free_friction, responses


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


Records = Sequence[tuple[LinkSignals, Decoupled]]
"""Records of one joint."""

COLUMNS = (*NAMES[:2], "motor_coulomb_friction", *NAMES[2:4], "compliance", "relaxation_time")
"""Unknowns of the regression: m_M, d_M, f, m_L, d_L, c = 1/k, t = d_G/k."""

_MOTOR, _MOTOR_VISCOUS, _COULOMB, _LINK, _LINK_VISCOUS, _COMPLIANCE, _RELAXATION = range(7)

_MECHANICAL = (_MOTOR, _MOTOR_VISCOUS, _LINK, _LINK_VISCOUS)
PHYSICAL_COLUMNS = (*_MECHANICAL, _COMPLIANCE, _RELAXATION, _COULOMB)
"""Unknowns in the order of `NAMES`, then the Coulomb friction."""

_MAX_ITERATIONS = 8  # maximum number of iterations of weights and linearisation in one band
_ROWS_PER_HZ = 4.0  # rows per second and per hertz of the upper edge, twice the Nyquist rate
_JACKKNIFE_BLOCKS = 20  # blocks of the jackknife over all records
_KNOTS_PER_PERIOD = 8.0  # knots of the free friction per period of the upper edge
# minimum relative standard deviation of values from the rigid model, which keeps weights finite
_MIN_RELATIVE_STD = 1e-6
# prior standard deviation of the stiction torque in units of f: uniform distribution in [-f, f]
_STICTION_STD = 0.58
# the same for friction that follows the sign of the measured velocity: a tenth
_SIGN_FRICTION_STD = 0.058


@dataclass(frozen=True, slots=True)
class FilteredColumns:
    """Filtered columns of one record at the selected rows."""

    ratio: float
    band: Band
    sample_time: float
    rows: IntArray
    torque: FloatArray  # (n_rows,) u + n tau
    tau: FloatArray  # (n_rows,)
    motor: FloatArray  # (n_rows, 3) dw_M, w_M, s
    link: FloatArray  # (n_rows, 2) dw_L, w_L
    torsion: FloatArray  # (n_rows, 2) delta, ddelta
    free: Banded  # (n_rows, n_free) shape functions of the free friction

    def passed(self, signal: FloatArray) -> FloatArray:
        """Filter a signal (n_samples,) of the record like the columns, and select the rows."""
        return band_pass(signal, *self.band, self.sample_time)[self.rows]


@dataclass(frozen=True, slots=True)
class WeightedEquations:
    """Equations in one band with the weights of their last solution."""

    pieces: tuple[FilteredColumns, ...]
    equations: ls.Equations
    known: RigidKnowledge  # values of the rigid model, part of the equations
    root: FloatArray  # (n_rows,) square roots of the weights
    x: FloatArray  # point of linearisation
    stiction_std: float = _STICTION_STD  # prior standard deviation of the free friction, in f

    @property
    def band(self) -> Band:
        """Filter band [Hz]."""
        return self.pieces[0].band

    def of_record(self, k: int) -> WeightedEquations:
        """The equations of record `k` alone, with the values of the rigid model."""
        pieces, known = self.pieces[k : k + 1], self.known.of_record(k)
        equations = _assemble(pieces, known, self.x, self.stiction_std)
        record_root = self.root[self.equations.group // 2 == k]
        root = np.ones_like(equations.target)
        root[: len(record_root)] = record_root
        return replace(self, pieces=pieces, equations=equations, known=known, root=root)

    def iterate(self, within: float) -> WeightedEquations:
        """Iterate weights and linearisation to convergence.

        Iteration stops when no unknown changes by more than `within` standard deviations.
        """
        equations, root, x = self.equations, self.root, self.x
        for _ in range(_MAX_ITERATIONS):
            raise_if_stopped()
            factor = ls.factorise(equations, root)
            has_converged = bool(np.all(np.abs(factor.value - x) <= within * factor.deviation))
            x = factor.value
            equations = _assemble(self.pieces, self.known, x, self.stiction_std)
            residual = ls.residual_of(equations, factor)
            root = ls.root_weights(equations, replace(factor, residual=residual))
            if has_converged:
                break
        return replace(self, equations=equations, root=root, x=x)

    def with_sign_friction(self) -> WeightedEquations:
        """The same equations with friction that follows the sign of the velocity everywhere.

        Within the resolution of the encoder a reversal lasts a few samples, in which the friction
        torque is an additional unknown. How well the data determine it, and its effect on the other
        estimates, depend on their noise.
        """
        equations = _assemble(self.pieces, self.known, self.x, _SIGN_FRICTION_STD)
        return replace(self, equations=equations, stiction_std=_SIGN_FRICTION_STD)

    def rigid_errors(self, factor: ls.Factor) -> FloatArray:
        """Changes of the unknowns for each error of the rigid model, one column per error."""
        known = self.known
        if not known.errors:
            return np.zeros((len(COLUMNS), 0))
        columns, of_priors = [], _prior_equations(known, self.pieces[0].ratio)[2]
        for error, prior in zip(known.errors, of_priors.T, strict=True):
            changes = []
            for p, tau in zip(self.pieces, error.tau, strict=True):
                tau_change = p.passed(tau)
                changes += [p.ratio * tau_change, self.x[_COMPLIANCE] * tau_change]
            columns.append(np.concatenate([*changes, prior]))
        return ls.moves(self.equations, factor, np.column_stack(columns))

    @property
    def physical(self) -> FloatArray:
        """Physical parameters in the order of `NAMES`, then the Coulomb friction."""
        return physical_values(self.x)

    @property
    def joint(self) -> TwoInertia:
        """The joint with the current values."""
        return joint_of(self.physical[:6], self.pieces[0].ratio)

    def fit_percent(self, factor: ls.Factor) -> dict[str, float]:
        """Fit of (S6), the torque, and of (S7), the torsion."""
        residual, group = ls.residual_of(self.equations, factor), self.equations.group
        torque = np.concatenate([p.torque for p in self.pieces])
        torsion = np.concatenate([p.torsion[:, 0] for p in self.pieces])
        fits = {}
        for parity, (name, side) in enumerate((("torque", torque), ("torsion", torsion))):
            rows = (group != ls.PRIOR_GROUP) & (group % 2 == parity)
            fits[name] = float(
                100.0 * (1.0 - np.linalg.norm(residual[rows]) / np.linalg.norm(side))
            )
        return fits


def _piece(signals: LinkSignals, decoupled: Decoupled, arm: Arm, band: Band) -> FilteredColumns:
    i, T = decoupled.joint - 1, signals.sample_time
    n = float(arm.gear_ratios[i])
    low, high = band
    edge = int(1.5 / (low * T))
    edge = min(edge, len(signals.time) // 4)
    rows = np.arange(edge, len(signals.time) - edge, max(1, int(1.0 / (_ROWS_PER_HZ * high * T))))

    torque = signals.motor_torque[:, i]
    columns = [
        apply_lags_without_aliases(torque, (), T, "held") if signals.held[i] else torque,
        decoupled.inputs[:, 1] if decoupled.inputs.shape[1] > 1 else np.zeros(len(torque)),
        signals.direction[:, i],
        signals.motor_angle[:, i],
        signals.link_acceleration[:, i],
    ]
    # (column, order of differentiation): derivatives of the motor angle, integrals of the link
    # acceleration
    orders = [(0, 0), (1, 0), (2, 0), (3, 0), (3, -1), (3, -2), (4, 0), (4, 1), (4, 2)]
    if signals.sources[i] in ("encoder", "deflection"):
        columns += [signals.link_velocity[:, i], signals.link_angle[:, i]]
        orders[-2:] = [(5, 0), (6, 0)]
    filtered = band_passes(np.column_stack(columns), orders, low, high, T)[rows]
    torque, tau, direction, motor_angle, motor_velocity, motor_acceleration = filtered[:, :6].T
    link_acceleration, link_velocity, link_angle = filtered[:, 6:].T
    half_length = int(2.0 / (low * T))  # the impulse response is below 1e-5 beyond it
    impulse = np.zeros(2 * half_length + 1)
    impulse[half_length] = 1.0
    kernel = band_pass(
        apply_lags_without_aliases(impulse, signals.shared, T, "straight"), low, high, T
    )
    shapes = free_friction(signals.sliding[:, i], max(2, int(1.0 / (_KNOTS_PER_PERIOD * high * T))))
    return FilteredColumns(
        ratio=n,
        band=band,
        sample_time=T,
        rows=rows,
        torque=torque + n * tau,
        tau=tau,
        motor=np.column_stack([motor_acceleration, motor_velocity, direction]),
        link=np.column_stack([link_acceleration, link_velocity]),
        torsion=np.column_stack([n * motor_angle - link_angle, n * motor_velocity - link_velocity]),
        free=responses(shapes, rows, kernel),
    )


def equations_in(
    records: Records,
    arm: Arm,
    known: RigidKnowledge,
    band: Band,
    near: WeightedEquations | None = None,
) -> WeightedEquations:
    """Assemble the equations in one band.

    `near` is the solution in another band. It gives the point of linearisation and the weights;
    without it, both are estimated from the data.
    """
    pieces = tuple(_piece(signals, joint, arm, band) for signals, joint in records)
    if near is None:
        x = _starting_values(pieces)
        equations = _assemble(pieces, known, x)
        root = ls.initial_weights(equations.target, equations.group)
        return WeightedEquations(pieces, equations, known, root, x)
    equations = _assemble(pieces, known, near.x)
    root = np.ones_like(equations.target)
    for group in range(2 * len(pieces)):
        typical_root = np.median(near.root[near.equations.group == group])
        root[equations.group == group] = typical_root
    return WeightedEquations(pieces, equations, known, root, near.x)


def _starting_values(pieces: Sequence[FilteredColumns]) -> FloatArray:
    """Starting values: inertias and friction from (S6), then compliance and damping from (S7)."""
    x = np.zeros(len(COLUMNS))
    motor = np.concatenate([np.hstack([p.motor, p.ratio * p.link[:, :1]]) for p in pieces])
    torque = np.concatenate([p.torque for p in pieces])
    x[[_MOTOR, _MOTOR_VISCOUS, _COULOMB, _LINK]] = np.linalg.lstsq(motor, torque)[0]
    gear_torque = np.concatenate([x[_LINK] * p.link[:, 0] - p.tau for p in pieces])
    torsion = np.concatenate([p.torsion for p in pieces])
    columns = np.column_stack([gear_torque, -torsion[:, 1]])
    x[[_COMPLIANCE, _RELAXATION]] = np.linalg.lstsq(columns, torsion[:, 0])[0]
    return x


def _assemble(
    pieces: Sequence[FilteredColumns],
    known: RigidKnowledge,
    x: FloatArray,
    stiction_std: float = _STICTION_STD,
) -> ls.Equations:
    """Equations (S6) and (S7) of all records around x, then those of the rigid model."""
    shared, local, target, group, block, free_friction_std = [], [], [], [], [], []
    total = sum(len(p.torque) for p in pieces)
    first_block = n_before = 0
    for number, p in enumerate(pieces):
        n_rows, n_free = len(p.torque), p.free.n_columns
        motor = np.zeros((n_rows, len(COLUMNS)))
        motor[:, [_MOTOR, _MOTOR_VISCOUS, _COULOMB]] = p.motor
        motor[:, [_LINK, _LINK_VISCOUS]] = p.ratio * p.link
        gear = np.zeros((n_rows, len(COLUMNS)))
        link_torque = p.link @ x[[_LINK, _LINK_VISCOUS]]
        gear[:, [_LINK, _LINK_VISCOUS]] = x[_COMPLIANCE] * p.link
        gear[:, _COMPLIANCE] = link_torque - p.tau
        gear[:, _RELAXATION] = -p.torsion[:, 1]
        local.append(ls.Local(n_before + np.arange(n_rows), p.free))
        n_before += 2 * n_rows
        n_blocks = max(2, round(_JACKKNIFE_BLOCKS * n_rows / total))
        block_index = first_block + np.arange(n_rows) * n_blocks // n_rows
        first_block += n_blocks
        shared += [motor, gear]
        target += [p.torque, p.torsion[:, 0] + x[_COMPLIANCE] * link_torque]
        group += [np.full(n_rows, 2 * number), np.full(n_rows, 2 * number + 1)]
        block += [block_index, block_index]
        free_friction_std += [max(stiction_std * abs(float(x[_COULOMB])), 1e-300)] * n_free
    prior_rows, prior_target, _ = _prior_equations(known, pieces[0].ratio)
    prior_group = np.full(len(prior_target), ls.PRIOR_GROUP)
    rows = np.concatenate([*shared, prior_rows])
    return ls.Equations(
        shared=rows,
        noise=np.zeros(len(COLUMNS)),
        common=np.zeros((len(rows), 0)),
        common_deviation=np.zeros(0),
        local=tuple(local),
        local_deviation=np.array(free_friction_std),
        target=np.concatenate([*target, prior_target]),
        group=np.concatenate([*group, prior_group]),
        block=np.concatenate([*block, prior_group]),
    )


def _prior_equations(known: RigidKnowledge, n: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows (n_values, n_unknowns) and right-hand sides (n_values,) for the rigid-step values.

    Third, the changes of the right-hand sides with the errors of the rigid model, (n_values,
    n_errors). All are divided by the standard deviations of the values.
    """
    rows, values, changes = [], [], []
    columns = (
        {_MOTOR: 1.0, _LINK: n * n},
        {_MOTOR_VISCOUS: 1.0, _LINK_VISCOUS: n * n},
        {_COULOMB: 1.0},
    )
    for k, (value, factors) in enumerate(zip(known.sums, columns, strict=True)):
        if value is None:
            continue
        row = np.zeros(len(COLUMNS))
        row[list(factors)] = list(factors.values())
        std = max(value[1], _MIN_RELATIVE_STD * abs(value[0]))
        rows.append(row / std)
        values.append(value[0] / std)
        changes.append([error.changes[k] / std for error in known.errors])
    changed = np.reshape(changes, (len(values), len(known.errors)))
    return np.reshape(rows, (-1, len(COLUMNS))), np.array(values), changed


def physical_values(x: FloatArray) -> FloatArray:
    """Physical parameters in the order of `NAMES`, then the Coulomb friction."""
    k = 1.0 / x[_COMPLIANCE]
    return np.concatenate([x[list(_MECHANICAL)], [k, k * x[_RELAXATION]], x[[_COULOMB]]])
