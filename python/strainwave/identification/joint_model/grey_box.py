"""LinkSignals, Decoupled -> JointModel: physical parameters straight from the equations of motion.

With both sides of the gear measured, (1) and (2) of one joint are two equations per sample,

    u + n tau = m_M dw_M + d_M w_M + f s + n (m_L dw_L + d_L w_L)                          (S6)
    delta = c (m_L dw_L + d_L w_L - tau) - t ddelta,     c = 1/k, t = d_G/k                (S7)

(S6) is linear in its parameters; (S7) is linearised around the last ones, and says of the torsion
what the torque through the gear makes of it. Both pass one zero-phase band-pass around the
anti-resonance and the resonance, which keeps out bias and drift of the sensors below and their
noise above. Every signal has the sensors' own filters behind it (`LinkSignals.shared`), so those
drop out of the equations. Friction where the motor may stand is an unknown of its own, about what
the velocity shows there; what hangs on that joins the covariance.

What the rigid model knows, c_1 = m_M + n^2 m_L, c_0 = d_M + n^2 d_L and the Coulomb friction, joins
as one more equation each, weighted by its deviation.
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
from strainwave.numerics.filters import band_pass, band_passes, unaliased
from strainwave.numerics.parallel import stop_if_asked
from strainwave.signals.standstill import free_friction, responses

Seen = TypeVar("Seen", LinkSignals, Decoupled)

COLUMNS = (*NAMES[:2], "motor_coulomb_friction", *NAMES[2:4], "compliance", "relaxation_time")
"""Unknowns: m_M, d_M, f, m_L, d_L, c = 1/k, t = d_G/k."""

_MOTOR, _MOTOR_VISCOUS, _COULOMB, _LINK, _LINK_VISCOUS, _COMPLIANCE, _RELAXATION = range(7)

_BELOW = 2.5  # anti-resonance over the band's lower edge
_ABOVE = 1.8  # the band's upper edge over the resonance: half-way to what next bends
FIRST_BAND_HZ = (3.0, 60.0)  # where strain-wave gears and links of metres ring; then adapted
_SLOWEST = 6.0  # periods of the lower edge in the shortest record, at least
_BANDS = 6  # rounds in which the band may move
_SAME_BAND = 0.05
# samples of a record in which its band is looked for; records as long as this are searched whole
_SEARCHED = 1 << 16
_OTHER_BAND = 1.3  # factor by which band edges are moved to see the residuals out
_ROUNDS = 8  # of weights and linearisation at one band, at most
# of a deviation, by which a round still moves the unknowns: in an answer, and where all that is
# looked for is the next band, whose edges need no more than percents
_SETTLED, _COARSELY = 0.05, 10.0
_NEARLY = 0.5  # the same where the answer serves to see how much the band matters
_ROWS_PER_HZ = 4.0
_BLOCKS = 20
_KNOTS = 8.0  # of free friction, in periods of the upper edge
_SUREST = 1e-6  # relative deviation of what the rigid model gives, at least: weights stay finite
_STANDING = 0.58  # deviation of a torque anywhere in [-f, f], in f
# the same where the velocity's sign is taken at its word, to see what hangs on that: a tenth
_TAKEN = 0.058


@dataclass(frozen=True, slots=True)
class RigidError:
    """What one standard deviation along one direction of the rigid model's scatter changes."""

    tau: tuple[FloatArray, ...]  # one per record, (n_samples,) [N m] at the link
    total_inertia: float  # [kg m^2]
    total_viscous_friction: float  # [N m s/rad]
    coulomb_friction: float  # [N m]


@dataclass(frozen=True, slots=True)
class RigidKnowledge:
    """What the rigid step knows of one joint, with deviations; None: nothing."""

    total_inertia: tuple[float, float] | None  # c_1 [kg m^2]
    total_viscous_friction: tuple[float, float] | None  # c_0 [N m s/rad]
    coulomb_friction: tuple[float, float] | None  # f [N m]
    errors: tuple[RigidError, ...] = ()  # directions in which tau is uncertain

    def moved(self, error: RigidError) -> RigidKnowledge:
        """The same with one error in it."""
        return RigidKnowledge(
            _moved(self.total_inertia, error.total_inertia),
            _moved(self.total_viscous_friction, error.total_viscous_friction),
            _moved(self.coulomb_friction, error.coulomb_friction),
        )

    def of_record(self, k: int) -> RigidKnowledge:
        """The same for one of the records alone."""
        errors = tuple(replace(error, tau=(error.tau[k],)) for error in self.errors)
        return replace(self, errors=errors)


def _moved(known: tuple[float, float] | None, change: float) -> tuple[float, float] | None:
    return known and (known[0] + change, known[1])


@dataclass(frozen=True, slots=True)
class GreyBoxFit:
    """One joint's parameters with their covariance."""

    joint: TwoInertia
    coulomb_friction: float
    covariance: FloatArray  # (7, 7) of the six of `NAMES`, then the Coulomb friction
    determined: tuple[bool, ...]  # (7,)
    band_hz: tuple[float, float]
    torque_fit_percent: float  # of (S6)
    torsion_fit_percent: float  # of (S7)
    condition_number: float
    n_rows: int


@dataclass(frozen=True, slots=True)
class Solved:
    """One joint's equations in a band, solved, and in those beside it."""

    records: tuple[tuple[LinkSignals, Decoupled], ...]
    arm: Arm
    known: RigidKnowledge
    band: tuple[float, float]
    own: _Weighted
    as_it_shows: _Weighted  # with friction as the velocity shows it, also where that is in doubt
    beside: tuple[_Weighted, ...]  # in a narrower band and a wider one; none where it was given

    def fit(self) -> GreyBoxFit:
        """What the solutions say."""
        found = _result(self.own, self.known, self.band)
        doubt = _physical(self.as_it_shows.x) - _physical(self.own.x)
        found = replace(found, covariance=found.covariance + np.outer(doubt, doubt))
        if not self.beside:
            return found
        moves = [_physical(other.x) - _physical(self.own.x) for other in self.beside]
        return replace(found, covariance=found.covariance + _model_error(moves))

    def of_record(self, k: int) -> Solved:
        """One of the records alone, which starts from what all say in the same bands.

        Returns: In bands of its own where its resonance is elsewhere.
        """
        record, known = self.records[k : k + 1], self.known.of_record(k)
        own = _settled(self.own.of_record(k, known), known, _SETTLED)
        better = _band_around(_joint_of(own), record, self.band)
        if not same_band(self.band, better, _SAME_BAND):
            return solve(record, self.arm, known, search_from_hz=self.band)
        shown = _settled(self.as_it_shows.of_record(k, known), known, _NEARLY)
        beside = [_settled(each.of_record(k, known), known, _NEARLY) for each in self.beside]
        return Solved(record, self.arm, known, self.band, own, shown, tuple(beside))


def solve(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    arm: Arm,
    known: RigidKnowledge,
    band_hz: tuple[float, float] | None = None,
    search_from_hz: tuple[float, float] = FIRST_BAND_HZ,
) -> Solved:
    """Solve one joint's equations for its physical parameters, from one or several records.

    `records`: Of one joint.
    `band_hz`: Of the equations' filter; None: from the resonances found.
    `search_from_hz`: Band in which they are first looked for.

    Raises `NotIdentifiable`: the link has no sensor.
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
        part = _found_in_part(records, arm, known, search_from_hz)
        band, equations = part or _found(records, arm, known, search_from_hz)
    own = _settled(equations, known, _SETTLED)
    shown = _settled(_as_it_shows(own, known), known, _NEARLY)
    beside = []
    for low, high in () if band_hz else _other_bands(band):
        other = _equations(records, arm, known, _possible(low, high, records), own)
        beside.append(_settled(other, known, _NEARLY))
    return Solved(tuple(records), arm, known, band, own, shown, tuple(beside))


def _found(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    arm: Arm,
    known: RigidKnowledge,
    search_from_hz: tuple[float, float],
) -> tuple[tuple[float, float], _Weighted]:
    """The band around the resonances, round by round, and the equations in it."""
    band = _possible(*search_from_hz, records)
    equations = _equations(records, arm, known, band)
    for _ in range(_BANDS - 1):
        equations = _settled(equations, known, _COARSELY)
        better = _band_around(_joint_of(equations), records, band)
        if same_band(band, better, _SAME_BAND):
            break
        band = better
        equations = _equations(records, arm, known, band, equations)
    return band, equations


def _found_in_part(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    arm: Arm,
    known: RigidKnowledge,
    search_from_hz: tuple[float, float],
) -> tuple[tuple[float, float], _Weighted] | None:
    """The same with the band from the middle of long records, which all of them must confirm.

    None where no record is long, or where the whole of them asks for another band: a sweep's
    middle, say, need not ring.
    """
    if all(len(signals.time) <= _SEARCHED for signals, _ in records):
        return None
    middle = [(_middle(signals), _middle(joint)) for signals, joint in records]
    band, near = _found(middle, arm, known, search_from_hz)
    equations = _settled(_equations(records, arm, known, band, near), known, _COARSELY)
    better = _band_around(_joint_of(equations), records, band)
    return (band, equations) if same_band(band, better, _SAME_BAND) else None


def _middle(seen: Seen) -> Seen:
    """The `_SEARCHED` samples in the middle of a record; all, where there are no more."""
    n = len(seen.time)
    if n <= _SEARCHED:
        return seen
    start = (n - _SEARCHED) // 2
    columns = {f.name: getattr(seen, f.name) for f in fields(seen)}
    cut: dict[str, Any] = {
        name: column[start : start + _SEARCHED]
        for name, column in columns.items()
        if isinstance(column, np.ndarray) and len(column) == n
    }
    return replace(seen, **cut)


def _other_bands(band: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]]:
    """A narrower one and a wider one."""
    low, high = band
    return (low * _OTHER_BAND, high / _OTHER_BAND), (low / _OTHER_BAND, high * _OTHER_BAND)


def _model_error(moves: Sequence[FloatArray]) -> FloatArray:
    """Covariance from what the equations leave out, as it shows in how the band changes the answer.

    Were the model exact, each band would give the same within its deviations.
    """
    return np.asarray(np.mean([np.outer(move, move) for move in moves], axis=0))


@dataclass(frozen=True, slots=True)
class _Piece:
    """One record's filtered columns, at the rows kept."""

    ratio: float
    band: tuple[float, float]
    sample_time: float
    rows: IntArray
    torque: FloatArray  # (n_rows,) u + n tau
    tau: FloatArray  # (n_rows,)
    motor: FloatArray  # (n_rows, 3) dw_M, w_M, s
    link: FloatArray  # (n_rows, 2) dw_L, w_L
    torsion: FloatArray  # (n_rows, 2) delta, ddelta
    free: Banded  # (n_rows, n_free) shapes of free friction

    def passed(self, signal: FloatArray) -> FloatArray:
        """A signal of the record, (n_samples,), as its columns are."""
        return band_pass(signal, *self.band, self.sample_time)[self.rows]


@dataclass(frozen=True, slots=True)
class _Weighted:
    """Equations in one band, with the weights that their last solution gives."""

    pieces: tuple[_Piece, ...]
    equations: ls.Equations
    root: FloatArray  # (n_rows,) square roots of the weights
    x: FloatArray  # around which they are linear
    standing: float = _STANDING  # deviation of free friction about what the velocity shows, in f

    def of_record(self, k: int, known: RigidKnowledge) -> _Weighted:
        """The equations of one record alone, with what is known of it."""
        pieces = self.pieces[k : k + 1]
        equations = _assemble(pieces, known, self.x, self.standing)
        own = self.root[self.equations.group // 2 == k]
        root = np.ones_like(equations.target)
        root[: len(own)] = own
        return replace(self, pieces=pieces, equations=equations, root=root)


def _possible(
    low: float, high: float, records: Sequence[tuple[LinkSignals, Decoupled]]
) -> tuple[float, float]:
    """The band cut to what the records hold."""
    for signals, _ in records:
        low = max(low, _SLOWEST / (len(signals.time) * signals.sample_time))
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
    return _possible(low / _BELOW, high * _ABOVE, records)


def _piece(
    signals: LinkSignals, decoupled: Decoupled, arm: Arm, band: tuple[float, float]
) -> _Piece:
    i, T = decoupled.joint - 1, signals.sample_time
    n = arm.joints[i].gear_ratio
    low, high = band
    reach = int(1.5 / (low * T))
    reach = min(reach, len(signals.time) // 4)
    rows = np.arange(reach, len(signals.time) - reach, max(1, int(1.0 / (_ROWS_PER_HZ * high * T))))

    torque = signals.motor_torque[:, i]
    columns = [
        unaliased(torque, (), T, "held") if signals.held[i] else torque,
        decoupled.inputs[:, 1] if decoupled.inputs.shape[1] > 1 else np.zeros(len(torque)),
        signals.direction[:, i],
        signals.motor_angle[:, i],
        signals.link_acceleration[:, i],
    ]
    # of the motor's angle its derivatives, of the link's acceleration its integrals
    wanted = [(0, 0), (1, 0), (2, 0), (3, 0), (3, -1), (3, -2), (4, 0), (4, 1), (4, 2)]
    if signals.sources[i] in ("encoder", "deflection"):
        columns += [signals.link_velocity[:, i], signals.link_angle[:, i]]
        wanted[-2:] = [(5, 0), (6, 0)]
    passed = band_passes(np.column_stack(columns), wanted, low, high, T)[rows]
    torque, tau, slid, motor_angle, motor_velocity, motor_acceleration = passed[:, :6].T
    link_acceleration, link_velocity, link_angle = passed[:, 6:].T
    around = int(2.0 / (low * T))  # the band-pass's answer has then fallen below 1e-5
    impulse = np.zeros(2 * around + 1)
    impulse[around] = 1.0
    kernel = band_pass(unaliased(impulse, signals.shared, T, "straight"), low, high, T)
    shapes = free_friction(signals.sliding[:, i], max(2, int(1.0 / (_KNOTS * high * T))))
    return _Piece(
        ratio=n,
        band=band,
        sample_time=T,
        rows=rows,
        torque=torque + n * tau,
        tau=tau,
        motor=np.column_stack([motor_acceleration, motor_velocity, slid]),
        link=np.column_stack([link_acceleration, link_velocity]),
        torsion=np.column_stack([n * motor_angle - link_angle, n * motor_velocity - link_velocity]),
        free=responses(shapes, rows, kernel),
    )


def _equations(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    arm: Arm,
    known: RigidKnowledge,
    band: tuple[float, float],
    near: _Weighted | None = None,
) -> _Weighted:
    """In one band: around the solution in another, where there is one, and weighted as there."""
    pieces = tuple(_piece(signals, joint, arm, band) for signals, joint in records)
    if near is None:
        x = _start(pieces)
        equations = _assemble(pieces, known, x)
        root = ls.first_weights(equations.target, equations.group)
        return _Weighted(pieces, equations, root, x)
    equations = _assemble(pieces, known, near.x)
    root = np.ones_like(equations.target)
    for group in range(2 * len(pieces)):
        usual = np.median(near.root[near.equations.group == group])
        root[equations.group == group] = usual
    return _Weighted(pieces, equations, root, near.x)


def _settled(weighted: _Weighted, known: RigidKnowledge, within: float) -> _Weighted:
    """Weights and linearisation in turn, until a round moves no unknown by `within` deviations."""
    pieces, equations, root, x = weighted.pieces, weighted.equations, weighted.root, weighted.x
    for _ in range(_ROUNDS):
        stop_if_asked()
        factor = ls.factorise(equations, root)
        settled = bool(np.all(np.abs(factor.value - x) <= within * factor.deviation))
        x = factor.value
        equations = _assemble(pieces, known, x, weighted.standing)
        root = ls.root_weights(equations, factor)
        if settled:
            break
    return _Weighted(pieces, equations, root, x, weighted.standing)


def _as_it_shows(own: _Weighted, known: RigidKnowledge) -> _Weighted:
    """The same equations with friction that follows the velocity's sign where that is in doubt.

    A reversal takes a few samples within an encoder's counts, where friction is one more unknown.
    What the data say of it depends on their noise, and so does what it takes from the others.
    """
    return replace(own, equations=_assemble(own.pieces, known, own.x, _TAKEN), standing=_TAKEN)


def _rigid_errors(weighted: _Weighted, factor: ls.Factor, known: RigidKnowledge) -> FloatArray:
    """Columns: how far each of the rigid model's errors moves the unknowns."""
    if not known.errors:
        return np.zeros((len(COLUMNS), 0))
    pieces, x = weighted.pieces, weighted.x
    columns = []
    for error in known.errors:
        change = []
        for p, tau in zip(pieces, error.tau, strict=True):
            more = p.passed(tau)
            change += [p.ratio * more, x[_COMPLIANCE] * more]
        _, before = _knowledge(known, pieces[0].ratio)
        _, after = _knowledge(known.moved(error), pieces[0].ratio)
        columns.append(np.concatenate([*change, after - before]))
    return ls.moves(weighted.equations, factor, np.column_stack(columns))


def _start(pieces: Sequence[_Piece]) -> FloatArray:
    """(S6) alone gives the inertias; the torsion per torque, the compliance."""
    x = np.zeros(len(COLUMNS))
    motor = np.concatenate([np.hstack([p.motor, p.ratio * p.link[:, :1]]) for p in pieces])
    torque = np.concatenate([p.torque for p in pieces])
    x[[_MOTOR, _MOTOR_VISCOUS, _COULOMB, _LINK]] = np.linalg.lstsq(motor, torque)[0]
    through = np.concatenate([x[_LINK] * p.link[:, 0] - p.tau for p in pieces])
    torsion = np.concatenate([p.torsion for p in pieces])
    columns = np.column_stack([through, -torsion[:, 1]])
    x[[_COMPLIANCE, _RELAXATION]] = np.linalg.lstsq(columns, torsion[:, 0])[0]
    return x


def _assemble(
    pieces: Sequence[_Piece], known: RigidKnowledge, x: FloatArray, standing: float = _STANDING
) -> ls.Equations:
    """(S6) and (S7) of all records around x, then what the rigid model knows."""
    shared, local, target, group, block, deviation = [], [], [], [], [], []
    total = sum(len(p.torque) for p in pieces)
    first_block = at = 0
    for number, p in enumerate(pieces):
        n_rows, n_free = len(p.torque), p.free.n_columns
        motor = np.zeros((n_rows, len(COLUMNS)))
        motor[:, [_MOTOR, _MOTOR_VISCOUS, _COULOMB]] = p.motor
        motor[:, [_LINK, _LINK_VISCOUS]] = p.ratio * p.link
        gear = np.zeros((n_rows, len(COLUMNS)))
        own = p.link @ x[[_LINK, _LINK_VISCOUS]]
        gear[:, [_LINK, _LINK_VISCOUS]] = x[_COMPLIANCE] * p.link
        gear[:, _COMPLIANCE] = own - p.tau
        gear[:, _RELAXATION] = -p.torsion[:, 1]
        local.append(ls.Local(at + np.arange(n_rows), p.free))
        at += 2 * n_rows
        n_blocks = max(2, round(_BLOCKS * n_rows / total))
        label = first_block + np.arange(n_rows) * n_blocks // n_rows
        first_block += n_blocks
        shared += [motor, gear]
        target += [p.torque, p.torsion[:, 0] + x[_COMPLIANCE] * own]
        group += [np.full(n_rows, 2 * number), np.full(n_rows, 2 * number + 1)]
        block += [label, label]
        deviation += [max(standing * abs(float(x[_COULOMB])), 1e-300)] * n_free
    beforehand, values = _knowledge(known, pieces[0].ratio)
    rows = np.concatenate([*shared, beforehand])
    return ls.Equations(
        shared=rows,
        noise=np.zeros(len(COLUMNS)),
        common=np.zeros((len(rows), 0)),
        common_deviation=np.zeros(0),
        local=tuple(local),
        local_deviation=np.array(deviation),
        target=np.concatenate([*target, values]),
        group=np.concatenate([*group, np.full(len(values), ls.KNOWN)]),
        block=np.concatenate([*block, np.full(len(values), ls.KNOWN)]),
    )


def _knowledge(known: RigidKnowledge, n: float) -> tuple[FloatArray, FloatArray]:
    """Rows and right sides, each divided by its deviation."""
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
        deviation = max(value[1], _SUREST * abs(value[0]))
        rows.append(row / deviation)
        values.append(value[0] / deviation)
    return np.reshape(rows, (-1, len(COLUMNS))), np.array(values)


def _joint_of(weighted: _Weighted) -> TwoInertia:
    return joint_of(_physical(weighted.x)[:6], weighted.pieces[0].ratio)


def _physical(x: FloatArray) -> FloatArray:
    """The six of `NAMES`, then the Coulomb friction."""
    k = 1.0 / x[_COMPLIANCE]
    gear = [k, k * x[_RELAXATION]]
    first = x[[_MOTOR, _MOTOR_VISCOUS, _LINK, _LINK_VISCOUS]]
    return np.concatenate([first, gear, x[[_COULOMB]]])


def _result(weighted: _Weighted, known: RigidKnowledge, band: tuple[float, float]) -> GreyBoxFit:
    equations, x = weighted.equations, weighted.x
    factor = ls.factorise(equations, weighted.root)
    covariance, _ = ls.jackknife(equations, factor)
    identified = ls.determined(equations, factor, covariance)
    # tau came from the rigid model, whose errors no row of the data shows
    errors = _rigid_errors(weighted, factor, known)
    covariance = covariance + errors @ errors.T
    J = jacobian(_physical, x)
    residual = ls.residual_of(equations, factor)
    fits = []
    for parity in (0, 1):
        rows = (equations.group != ls.KNOWN) & (equations.group % 2 == parity)
        size = _size(weighted.pieces, parity)
        fits.append(100.0 * (1.0 - np.linalg.norm(residual[rows]) / size))
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
        n_rows=int(np.count_nonzero(equations.group != ls.KNOWN)),
    )


def _size(pieces: Sequence[_Piece], parity: int) -> float:
    signals = [p.torsion[:, 0] if parity else p.torque for p in pieces]
    return float(np.linalg.norm(np.concatenate(signals)))
