"""Estimate the physical parameters of one joint from its equations of motion.

If both sides of the gear are measured, (1) and (2) of one joint give two equations per sample:

    u + n tau = m_M dw_M + d_M w_M + f s + n (m_L dw_L + d_L w_L)                          (S6)
    delta = c (m_L dw_L + d_L w_L - tau) - t ddelta,     c = 1/k, t = d_G/k                (S7)

(S6) is linear in its parameters. (S7) relates the torsion to the torque through the gear and is
linearised around the current iterate. Both equations pass through one zero-phase band-pass around
the anti-resonance and the resonance, which removes sensor bias and drift below the band and sensor
noise above it. All signals have passed through the same sensor filters (`LinkSignals.shared`), so
these filters cancel in the equations. Where the motor may be in stiction, its friction torque is an
additional unknown with a prior from the measured velocity; the effect of that prior is added to the
covariance.

The quantities that the rigid model gives, c_1 = m_M + n^2 m_L, c_0 = d_M + n^2 d_L and the Coulomb
friction, are added as one equation each, weighted by the inverse of its standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from strainwave.domain import Decoupled, FloatArray, IntArray, LinkSignals
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import (
    NAMES,
    TwoInertia,
    anti_resonance,
    jacobian,
    joint_of,
    resonance,
)
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.linear import same_band
from strainwave.numerics import least_squares as ls
from strainwave.numerics.banded import Banded
from strainwave.numerics.filters import apply_lags_without_aliases, band_pass, band_passes
from strainwave.numerics.parallel import raise_if_stopped
from strainwave.signals.standstill import free_friction, responses

Columns = TypeVar("Columns", LinkSignals, Decoupled)

COLUMNS = (*NAMES[:2], "motor_coulomb_friction", *NAMES[2:4], "compliance", "relaxation_time")
"""Unknowns of the regression: m_M, d_M, f, m_L, d_L, c = 1/k, t = d_G/k."""

_MOTOR, _MOTOR_VISCOUS, _COULOMB, _LINK, _LINK_VISCOUS, _COMPLIANCE, _RELAXATION = range(7)

_ANTI_RESONANCE_TO_LOW_EDGE = 2.5  # ratio of the anti-resonance to the lower edge of the band
# ratio of the upper edge of the band to the resonance; the next structural resonance is higher
_HIGH_EDGE_TO_RESONANCE = 1.8
# initial band of the search: covers the resonances of strain-wave gears with links of about 1 m
FIRST_BAND_HZ = (3.0, 60.0)
_MIN_PERIODS = 6.0  # minimum number of periods of the lower edge in the shortest record
_MAX_BANDS = 6  # maximum number of bands in the search
_BAND_TOLERANCE = 0.05  # relative difference of the edges up to which two bands are the same
# number of samples used to search for the band; shorter records are used completely
_MAX_SEARCH_SAMPLES = 1 << 16
_BAND_CHANGE = 1.3  # factor on the band edges for the estimate of the model error
_MAX_ITERATIONS = 8  # maximum number of iterations of weights and linearisation in one band
# convergence tolerances in standard deviations: for the final estimate, and for the search for the
# band, whose edges need an accuracy of only a few percent
_TOLERANCE, _SEARCH_TOLERANCE = 0.05, 10.0
_MODEL_ERROR_TOLERANCE = 0.5  # the same tolerance for the fits that measure the model error
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


@dataclass(frozen=True, slots=True)
class GreyBoxFit:
    """Parameters of one joint with their covariance."""

    joint: TwoInertia
    coulomb_friction: float
    covariance: FloatArray  # (7, 7) in the order of `NAMES`, then the Coulomb friction
    determined: tuple[bool, ...]  # (7,) in the same order
    band_hz: tuple[float, float]
    torque_fit_percent: float  # of (S6)
    torsion_fit_percent: float  # of (S7)
    condition_number: float
    n_rows: int


@dataclass(frozen=True, slots=True)
class Solved:
    """Solved equations of one joint in its band and in two neighbouring bands."""

    records: tuple[tuple[LinkSignals, Decoupled], ...]
    arm: Arm
    known: RigidKnowledge
    band: tuple[float, float]
    in_band: _WeightedEquations
    # with friction that follows the sign of the velocity everywhere
    with_sign_friction: _WeightedEquations
    # in a narrower and a wider band; empty if the band is given
    in_other_bands: tuple[_WeightedEquations, ...]

    def fit(self) -> GreyBoxFit:
        """Estimates, with the model error added to the covariance.

        The model error consists of the changes of the estimates with the treatment of friction near
        zero velocity and with the band.
        """
        fit = _result(self.in_band, self.known, self.band)
        friction_change = _physical(self.with_sign_friction.x) - _physical(self.in_band.x)
        fit = replace(fit, covariance=fit.covariance + np.outer(friction_change, friction_change))
        if not self.in_other_bands:
            return fit
        changes = [_physical(other.x) - _physical(self.in_band.x) for other in self.in_other_bands]
        return replace(fit, covariance=fit.covariance + _model_error(changes))

    def of_record(self, k: int) -> Solved:
        """Fit record `k` alone, starting from the solution of all records in the same bands.

        If its resonances differ, the equations are solved in new bands.
        """
        record, known = self.records[k : k + 1], self.known.of_record(k)
        weighted = _iterate(self.in_band.of_record(k, known), known, _TOLERANCE)
        band = _band_around(_joint_of(weighted), record, self.band)
        if not same_band(self.band, band, _BAND_TOLERANCE):
            return solve(record, self.arm, known, search_from_hz=self.band)
        with_sign_friction = _iterate(
            self.with_sign_friction.of_record(k, known), known, _MODEL_ERROR_TOLERANCE
        )
        in_other_bands = [
            _iterate(each.of_record(k, known), known, _MODEL_ERROR_TOLERANCE)
            for each in self.in_other_bands
        ]
        return Solved(
            record, self.arm, known, self.band, weighted, with_sign_friction, tuple(in_other_bands)
        )


def solve(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    arm: Arm,
    known: RigidKnowledge,
    band_hz: tuple[float, float] | None = None,
    search_from_hz: tuple[float, float] = FIRST_BAND_HZ,
) -> Solved:
    """Estimate the physical parameters of one joint from one or several records.

    `band_hz` is the filter band; None derives it from the estimated resonances, and the search
    starts in `search_from_hz`. Raises `NotIdentifiable` if the link has no sensor.
    """
    for signals, joint in records:
        if signals.sources[joint.joint - 1] == "motor":
            raise NotIdentifiable(
                f"link {joint.joint} has no sensor in {signals.experiment.name}: the gear's "
                "torsion is not measured"
            )
    if band_hz:
        band, equations = band_hz, _equations(records, arm, known, band_hz)
    else:
        search_result = _search_band_in_middle(records, arm, known, search_from_hz)
        band, equations = search_result or _search_band(records, arm, known, search_from_hz)
    weighted = _iterate(equations, known, _TOLERANCE)
    with_sign_friction = _iterate(
        _with_sign_friction(weighted, known), known, _MODEL_ERROR_TOLERANCE
    )
    in_other_bands = []
    for low, high in () if band_hz else _other_bands(band):
        neighbouring = _equations(records, arm, known, _limit_band(low, high, records), weighted)
        in_other_bands.append(_iterate(neighbouring, known, _MODEL_ERROR_TOLERANCE))
    return Solved(
        tuple(records), arm, known, band, weighted, with_sign_friction, tuple(in_other_bands)
    )


def _search_band(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    arm: Arm,
    known: RigidKnowledge,
    search_from_hz: tuple[float, float],
) -> tuple[tuple[float, float], _WeightedEquations]:
    """Iterate the band around the resonances; return it with the equations in it."""
    band = _limit_band(*search_from_hz, records)
    equations = _equations(records, arm, known, band)
    for _ in range(_MAX_BANDS - 1):
        equations = _iterate(equations, known, _SEARCH_TOLERANCE)
        next_band = _band_around(_joint_of(equations), records, band)
        if same_band(band, next_band, _BAND_TOLERANCE):
            break
        band = next_band
        equations = _equations(records, arm, known, band, equations)
    return band, equations


def _search_band_in_middle(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    arm: Arm,
    known: RigidKnowledge,
    search_from_hz: tuple[float, float],
) -> tuple[tuple[float, float], _WeightedEquations] | None:
    """The same with a search in the middle of long records, confirmed by the complete records.

    None if no record is long, or if the complete records need another band: the middle of a sweep,
    for example, need not contain the resonances.
    """
    if all(len(signals.time) <= _MAX_SEARCH_SAMPLES for signals, _ in records):
        return None
    middle = [(_middle(signals), _middle(joint)) for signals, joint in records]
    band, middle_equations = _search_band(middle, arm, known, search_from_hz)
    equations = _iterate(
        _equations(records, arm, known, band, middle_equations), known, _SEARCH_TOLERANCE
    )
    confirmed_band = _band_around(_joint_of(equations), records, band)
    return (band, equations) if same_band(band, confirmed_band, _BAND_TOLERANCE) else None


def _middle(record: Columns) -> Columns:
    """The middle `_MAX_SEARCH_SAMPLES` samples of a record; a shorter record is unchanged."""
    n = len(record.time)
    if n <= _MAX_SEARCH_SAMPLES:
        return record
    start = (n - _MAX_SEARCH_SAMPLES) // 2
    columns = {f.name: getattr(record, f.name) for f in fields(record)}
    middle: dict[str, Any] = {
        name: column[start : start + _MAX_SEARCH_SAMPLES]
        for name, column in columns.items()
        if isinstance(column, np.ndarray) and len(column) == n
    }
    return replace(record, **middle)


def _other_bands(band: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]]:
    """A narrower band and a wider band."""
    low, high = band
    return (low * _BAND_CHANGE, high / _BAND_CHANGE), (low / _BAND_CHANGE, high * _BAND_CHANGE)


def _model_error(moves: Sequence[FloatArray]) -> FloatArray:
    """Covariance of the model error, from the changes of the estimates with the band.

    With an exact model, the estimates of all bands would agree within their standard deviations.
    """
    return np.asarray(np.mean([np.outer(move, move) for move in moves], axis=0))


@dataclass(frozen=True, slots=True)
class _Piece:
    """Filtered columns of one record at the selected rows."""

    ratio: float
    band: tuple[float, float]
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
class _WeightedEquations:
    """Equations in one band with the weights of their last solution."""

    pieces: tuple[_Piece, ...]
    equations: ls.Equations
    root: FloatArray  # (n_rows,) square roots of the weights
    x: FloatArray  # point of linearisation
    standing: float = _STICTION_STD  # prior standard deviation of the free friction, in f

    def of_record(self, k: int, known: RigidKnowledge) -> _WeightedEquations:
        """The equations of record `k` alone, with the values from the rigid step."""
        pieces = self.pieces[k : k + 1]
        equations = _assemble(pieces, known, self.x, self.standing)
        record_root = self.root[self.equations.group // 2 == k]
        root = np.ones_like(equations.target)
        root[: len(record_root)] = record_root
        return replace(self, pieces=pieces, equations=equations, root=root)


def _limit_band(
    low: float, high: float, records: Sequence[tuple[LinkSignals, Decoupled]]
) -> tuple[float, float]:
    """Limit the band to the frequencies that the records contain."""
    for signals, _ in records:
        low = max(low, _MIN_PERIODS / (len(signals.time) * signals.sample_time))
        high = min(high, 0.4 / signals.sample_time, 0.8 * (signals.bandwidth_hz or np.inf))
    return min(low, high / 2.0), high


def _band_around(
    p: TwoInertia,
    records: Sequence[tuple[LinkSignals, Decoupled]],
    otherwise: tuple[float, float],
) -> tuple[float, float]:
    if not np.all(p.vector[[0, 2, 4]] > 0.0):
        return otherwise
    low, high = anti_resonance(p).frequency_hz, resonance(p).frequency_hz
    return _limit_band(low / _ANTI_RESONANCE_TO_LOW_EDGE, high * _HIGH_EDGE_TO_RESONANCE, records)


def _piece(
    signals: LinkSignals, decoupled: Decoupled, arm: Arm, band: tuple[float, float]
) -> _Piece:
    i, T = decoupled.joint - 1, signals.sample_time
    n = arm.joints[i].gear_ratio
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
    return _Piece(
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


def _equations(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    arm: Arm,
    known: RigidKnowledge,
    band: tuple[float, float],
    near: _WeightedEquations | None = None,
) -> _WeightedEquations:
    """Assemble the equations in one band.

    `near` is the solution in another band. It gives the point of linearisation and the weights;
    without it, both are estimated from the data.
    """
    pieces = tuple(_piece(signals, joint, arm, band) for signals, joint in records)
    if near is None:
        x = _starting_values(pieces)
        equations = _assemble(pieces, known, x)
        root = ls.initial_weights(equations.target, equations.group)
        return _WeightedEquations(pieces, equations, root, x)
    equations = _assemble(pieces, known, near.x)
    root = np.ones_like(equations.target)
    for group in range(2 * len(pieces)):
        typical_root = np.median(near.root[near.equations.group == group])
        root[equations.group == group] = typical_root
    return _WeightedEquations(pieces, equations, root, near.x)


def _iterate(
    weighted: _WeightedEquations, known: RigidKnowledge, within: float
) -> _WeightedEquations:
    """Iterate weights and linearisation to convergence.

    Iteration stops when no unknown changes by more than `within` standard deviations.
    """
    pieces, equations, root, x = weighted.pieces, weighted.equations, weighted.root, weighted.x
    for _ in range(_MAX_ITERATIONS):
        raise_if_stopped()
        factor = ls.factorise(equations, root)
        has_converged = bool(np.all(np.abs(factor.value - x) <= within * factor.deviation))
        x = factor.value
        equations = _assemble(pieces, known, x, weighted.standing)
        root = ls.root_weights(equations, factor)
        if has_converged:
            break
    return _WeightedEquations(pieces, equations, root, x, weighted.standing)


def _with_sign_friction(own: _WeightedEquations, known: RigidKnowledge) -> _WeightedEquations:
    """The same equations with friction that follows the sign of the velocity everywhere.

    Within the resolution of the encoder a reversal lasts a few samples, in which the friction
    torque is an additional unknown. How well the data determine it, and its effect on the other
    estimates, depend on their noise.
    """
    return replace(
        own,
        equations=_assemble(own.pieces, known, own.x, _SIGN_FRICTION_STD),
        standing=_SIGN_FRICTION_STD,
    )


def _rigid_errors(
    weighted: _WeightedEquations, factor: ls.Factor, known: RigidKnowledge
) -> FloatArray:
    """Changes of the unknowns for each error of the rigid model, one column per error."""
    if not known.errors:
        return np.zeros((len(COLUMNS), 0))
    pieces, x = weighted.pieces, weighted.x
    columns = []
    for error in known.errors:
        changes = []
        for p, tau in zip(pieces, error.tau, strict=True):
            tau_change = p.passed(tau)
            changes += [p.ratio * tau_change, x[_COMPLIANCE] * tau_change]
        _, prior = _prior_equations(known, pieces[0].ratio)
        _, changed_prior = _prior_equations(known.add_error(error), pieces[0].ratio)
        columns.append(np.concatenate([*changes, changed_prior - prior]))
    return ls.moves(weighted.equations, factor, np.column_stack(columns))


def _starting_values(pieces: Sequence[_Piece]) -> FloatArray:
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
    pieces: Sequence[_Piece], known: RigidKnowledge, x: FloatArray, standing: float = _STICTION_STD
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
        free_friction_std += [max(standing * abs(float(x[_COULOMB])), 1e-300)] * n_free
    prior_rows, prior_values = _prior_equations(known, pieces[0].ratio)
    rows = np.concatenate([*shared, prior_rows])
    return ls.Equations(
        shared=rows,
        noise=np.zeros(len(COLUMNS)),
        common=np.zeros((len(rows), 0)),
        common_deviation=np.zeros(0),
        local=tuple(local),
        local_deviation=np.array(free_friction_std),
        target=np.concatenate([*target, prior_values]),
        group=np.concatenate([*group, np.full(len(prior_values), ls.PRIOR_GROUP)]),
        block=np.concatenate([*block, np.full(len(prior_values), ls.PRIOR_GROUP)]),
    )


def _prior_equations(known: RigidKnowledge, n: float) -> tuple[FloatArray, FloatArray]:
    """Rows and right-hand sides for the rigid-step values, divided by their standard deviations."""
    rows, values = [], []
    for value, columns in (
        (known.total_inertia, {_MOTOR: 1.0, _LINK: n * n}),
        (known.total_viscous_friction, {_MOTOR_VISCOUS: 1.0, _LINK_VISCOUS: n * n}),
        (known.coulomb_friction, {_COULOMB: 1.0}),
    ):
        if value is None:
            continue
        row = np.zeros(len(COLUMNS))
        for column, factor in columns.items():
            row[column] = factor
        std = max(value[1], _MIN_RELATIVE_STD * abs(value[0]))
        rows.append(row / std)
        values.append(value[0] / std)
    return np.reshape(rows, (-1, len(COLUMNS))), np.array(values)


def _joint_of(weighted: _WeightedEquations) -> TwoInertia:
    return joint_of(_physical(weighted.x)[:6], weighted.pieces[0].ratio)


def _physical(x: FloatArray) -> FloatArray:
    """Physical parameters in the order of `NAMES`, then the Coulomb friction."""
    k = 1.0 / x[_COMPLIANCE]
    gear = [k, k * x[_RELAXATION]]
    inertia_and_friction = x[[_MOTOR, _MOTOR_VISCOUS, _LINK, _LINK_VISCOUS]]
    return np.concatenate([inertia_and_friction, gear, x[[_COULOMB]]])


def _result(
    weighted: _WeightedEquations, known: RigidKnowledge, band: tuple[float, float]
) -> GreyBoxFit:
    equations, x = weighted.equations, weighted.x
    factor = ls.factorise(equations, weighted.root)
    covariance, _ = ls.jackknife(equations, factor)
    identified = ls.determined(equations, factor, covariance)
    # tau is computed from the rigid model; its error does not appear in the residuals
    errors = _rigid_errors(weighted, factor, known)
    covariance = covariance + errors @ errors.T
    J = jacobian(_physical, x)
    residual = ls.residual_of(equations, factor)
    fits = []
    for parity in (0, 1):
        rows = (equations.group != ls.PRIOR_GROUP) & (equations.group % 2 == parity)
        norm = _size(weighted.pieces, parity)
        fits.append(100.0 * (1.0 - np.linalg.norm(residual[rows]) / norm))
    order = [_MOTOR, _MOTOR_VISCOUS, _LINK, _LINK_VISCOUS, _COMPLIANCE, _RELAXATION, _COULOMB]
    return GreyBoxFit(
        joint=_joint_of(weighted),
        coulomb_friction=float(x[_COULOMB]),
        covariance=J @ covariance @ J.T,
        determined=tuple(bool(identified[k]) for k in order),
        band_hz=band,
        torque_fit_percent=float(fits[0]),
        torsion_fit_percent=float(fits[1]),
        condition_number=factor.condition_number,
        n_rows=int(np.count_nonzero(equations.group != ls.PRIOR_GROUP)),
    )


def _size(pieces: Sequence[_Piece], parity: int) -> float:
    signals = [p.torsion[:, 0] if parity else p.torque for p in pieces]
    return float(np.linalg.norm(np.concatenate(signals)))
