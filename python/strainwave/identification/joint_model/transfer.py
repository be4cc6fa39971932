"""StateSpace, RigidModel -> JointModel: physical parameters from transfer functions, (15)-(18).

G11 of the paper, motor torque to motor velocity, is read off the state-space model: its lightly
damped zero pair gives b1, b2, its pole pair d1, d2. The slow lag of (17), which fast records hardly
show, is the rigid model's: (18) puts c_0 + c_1 s in its place. What follows is a closed form.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import (
    ComplexArray,
    ContinuousStateSpace,
    Decoupled,
    Diagnostic,
    FloatArray,
    JointModel,
    Mode,
    StateSpace,
)
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import (
    NAMES,
    TwoInertia,
    from_coefficients,
    jacobian,
    state_space,
)
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.estimates import parameters_of, status_of, warnings_of
from strainwave.identification.joint_model.grey_box import RigidKnowledge
from strainwave.identification.joint_model.linear import (
    band_around,
    band_of,
    modes_of,
    velocities,
    without_alternating,
)
from strainwave.numerics.filters import by_spectrum
from strainwave.statespace import nearest, poles_and_zeros, propagate, to_continuous

_IDENTIFIED = 1.0  # relative deviation beyond which even the sign is a guess
_SLOW = 0.1  # of the anti-resonance: (18) asks for c_0/c_1 far below
_HEAVIER = 0.1  # relative difference of c_1 to the model's own that is worth a word
_RECIPROCAL = 70.0  # per cent; noise leaves above 90 on good records
_LINES = 25  # at which G12 and G21 are compared


@dataclass(frozen=True, slots=True)
class _Pairs:
    """What is read off G11."""

    zero: complex
    pole: complex
    lag: tuple[float, float]  # c_0, c_1 of the model itself, where it rings

    @property
    def vector(self) -> FloatArray:
        """b1, b2, d1, d2, c_0, c_1, then frequency [Hz] and damping of zero and pole."""
        zero, pole = np.array(self.zero), np.array(self.pole)
        return _vector(zero, pole, np.array(self.lag))


def from_state_space(
    model: StateSpace,
    records: Decoupled | Sequence[Decoupled],
    arm: Arm,
    known: RigidKnowledge,
    others: Sequence[StateSpace] = (),
) -> JointModel:
    """Physical parameters from G11 of a state-space model, (17), (18).

    `model`: From `state_space_of`; of more than three states, the least damped pairs are taken.
    `records`: What it was estimated from.
    `known`: c_0 and c_1 for (18). Where they are not known, the model's own are taken, (17).
    `others`: Of the same records in other bands. A joint as in (1), (2) would give the same in
        each; how far they lie apart is counted as model error.

    Returns: Without deviations where the model has none. Impossible values are reported as they
    came, with status "implausible". `fit_percent` is how well these parameters explain the
    velocities in the band, and how well G12 = G21.

    Raises `NotIdentifiable`: the model has no oscillating pole and zero pair.
    """
    joint_records = (records,) if isinstance(records, Decoupled) else tuple(records)
    number, ratio = joint_records[0].joint, joint_records[0].gear_ratio
    names = tuple(record.experiment.name for record in joint_records)
    joint, where = arm.joints[number - 1], ", ".join(names)
    nominal = _pairs(model, None)
    vector, scatter = _propagated(model, nominal)
    if scatter is None:
        scatter = np.full((len(vector), len(vector)), np.nan)
    moves = [_pairs(other, nominal).vector - vector for other in others]
    if moves:
        scatter = scatter + np.mean([np.outer(move, move) for move in moves], axis=0)
    lag, sources = _with_rigid(vector[:6], scatter[:6, :6], known)
    found = from_coefficients(lag[:2], lag[2:4], lag[4:], ratio)
    J = jacobian(lambda q: from_coefficients(q[:2], q[2:4], q[4:], ratio).vector, lag)
    covariance = J @ sources @ J.T
    values = dict(zip(NAMES, found.vector.tolist(), strict=True))
    deviation = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    identified = tuple(
        not d > _IDENTIFIED * abs(v) for d, v in zip(deviation, found.vector, strict=True)
    )
    ring = np.sqrt(np.clip(np.diag(scatter)[6:], 0.0, None))
    modes = [_mode(nominal.zero, ring[:2]), _mode(nominal.pole, ring[2:])]
    band = band_around(modes[0].frequency_hz, modes[1].frequency_hz, joint_records)
    fit = _fit_percent(found, joint_records, band)
    reciprocity = _reciprocity(model, modes[0].frequency_hz, modes[1].frequency_hz)
    if reciprocity is not None:
        fit["reciprocity"] = reciprocity
    said = values, covariance, identified, joint, number
    warnings = (*warnings_of(*said, where), *_doubts(nominal, lag, reciprocity, where))
    return JointModel(
        joint=number,
        experiments=names,
        method="transfer-function",
        parameters=tuple(parameters_of(*said)),
        values=values,
        covariance=covariance,
        anti_resonance=modes[0],
        resonance=modes[1],
        band_hz=band,
        fit_percent=fit,
        status=status_of(warnings),
        warnings=warnings,
    )


def _vector(zero: ComplexArray, pole: ComplexArray, lag: FloatArray) -> FloatArray:
    """As `_Pairs.vector`, of zeros and poles (...,) and lags (2, ...): (..., 10)."""
    of = [x for r in (zero, pole) for x in (-2.0 * r.real / abs(r) ** 2, abs(r) ** -2.0)]
    rings = [x for r in (zero, pole) for x in (abs(r) / (2.0 * np.pi), -r.real / abs(r))]
    return np.stack([*of, *lag, *rings], axis=-1)


def _propagated(model: StateSpace, nominal: _Pairs) -> tuple[FloatArray, FloatArray | None]:
    """`_Pairs.vector` with its covariance."""

    def at_once(near: StateSpace) -> FloatArray:
        found = to_continuous(near)
        poles, zeros = poles_and_zeros(found, 0, 0)
        zero = nearest(np.array([nominal.zero]), zeros)[:, 0]
        pole = nearest(np.array([nominal.pole]), poles)[:, 0]
        return _vector(zero, pole, np.stack(_lag(found, zero, pole)))

    return propagate(without_alternating(model), at_once, stacked=True)


def _pairs(model: StateSpace, near: _Pairs | None) -> _Pairs:
    """The least damped pairs; of a model near another, those that moved least."""
    reduced = without_alternating(replace(model, covariance=None))
    found = modes_of(reduced)
    zeros, poles = ([m.value for m in ms if m.oscillates] for ms in (found.zeros, found.poles))
    if not zeros or not poles:
        raise NotIdentifiable(
            "the state-space model has no oscillating pair of poles and zeros: raise the amplitude "
            "or record for longer"
        )
    if near is None:
        zero, pole = (min(v, key=lambda r: abs(r.real / r)) for v in (zeros, poles))
    else:
        aim = near
        zero = min(zeros, key=lambda r: abs(r - aim.zero))
        pole = min(poles, key=lambda r: abs(r - aim.pole))
    lag = _lag(to_continuous(reduced), np.array([zero]), np.array([pole]))
    return _Pairs(zero, pole, (float(lag[0][0]), float(lag[1][0])))


def _lag(
    model: ContinuousStateSpace, zero: ComplexArray, pole: ComplexArray
) -> tuple[FloatArray, FloatArray]:
    """c_0 and c_1 with G11 = (1 + b1 s + b2 s^2)/((c_0 + c_1 s)(1 + d1 s + d2 s^2)) where it rings.

    One complex equation at the geometric mean of anti-resonance and resonance, a model each.
    """
    s = 1j * np.sqrt(abs(zero) * abs(pole))
    up, down = ((s - r) * (s - r.conjugate()) / abs(r) ** 2 for r in (zero, pole))
    lag = up / (down * _response(model, s)[:, 0, 0])
    return lag.real, lag.imag / abs(s)


def _response(model: ContinuousStateSpace, s: ComplexArray) -> ComplexArray:
    """(n, n_outputs, n_inputs); of n models each at its own s, or of one."""
    inner = s[:, None, None] * np.eye(model.A.shape[-1]) - model.A
    right = np.broadcast_to(model.B + 0j, (len(s), *model.B.shape[-2:]))
    return np.asarray(model.C @ np.linalg.solve(inner, right) + model.D)


def _s(f: FloatArray) -> ComplexArray:
    return np.asarray(2j * np.pi * f, dtype=np.complex128)


def _with_rigid(
    own: FloatArray, covariance: FloatArray, known: RigidKnowledge
) -> tuple[FloatArray, FloatArray]:
    """The modification (18): b1, b2, d1, d2, c_0, c_1 with the rigid model's lag."""
    vector, scatter = own.copy(), covariance.copy()
    for place, value in ((4, known.total_viscous_friction), (5, known.total_inertia)):
        if value is not None:
            vector[place] = value[0]
            scatter[place] = scatter[:, place] = 0.0
            scatter[place, place] = value[1] ** 2
    return vector, scatter


def _mode(value: complex, deviation: FloatArray) -> Mode:
    std = [float(d) if np.isfinite(d) else None for d in deviation]
    return Mode(value, abs(value) / (2.0 * np.pi), -value.real / abs(value), std[0], std[1])


def _fit_percent(
    joint: TwoInertia, records: Sequence[Decoupled], band: tuple[float, float]
) -> dict[str, float]:
    """How well the physical parameters explain both velocities from the inputs, in the band."""
    A, B, C = state_space(joint)
    B[:, records[0].inputs.shape[1] :] = 0.0
    physical = ContinuousStateSpace(A, B, C, np.zeros((2, 2)))
    pairs = [_seen_and_missed(physical, record, band) for record in records]
    miss = np.concatenate([missed for _, missed in pairs])
    size = np.linalg.norm(np.concatenate([y - y.mean(axis=0) for y, _ in pairs]), axis=0)
    fits = 100.0 * (1.0 - np.linalg.norm(miss, axis=0) / size)
    return dict(zip(("motor_velocity", "link_velocity"), fits.tolist(), strict=True))


def _seen_and_missed(
    physical: ContinuousStateSpace, record: Decoupled, band: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Both velocities of a record in the band, and what a model leaves of them."""
    n_in = record.inputs.shape[1]

    def modelled(f: FloatArray) -> ComplexArray:
        return np.asarray(band_of(f, band)[:, None, None] * _response(physical, _s(f)))

    def measured(f: FloatArray) -> ComplexArray:
        return np.asarray(band_of(f, band)[:, None, None] * velocities(f, record))

    reach = 3.0 / band[0]
    rows = np.flatnonzero(record.valid)
    edge = int(1.0 / (band[0] * record.sample_time))
    rows = rows[(rows >= rows[0] + edge) & (rows <= rows[-1] - edge)]
    inputs = np.zeros((len(record.inputs), 2))
    inputs[:, :n_in] = record.inputs
    y = by_spectrum(record.outputs, measured, record.sample_time, reach)[rows]
    return y, y - by_spectrum(inputs, modelled, record.sample_time, reach)[rows]


def _reciprocity(model: StateSpace, low_hz: float, high_hz: float) -> float | None:
    """Per cent of agreement of G12 and G21, which a passive joint has equal."""
    if min(len(model.C), model.B.shape[1]) < 2:
        return None
    f = np.geomspace(0.7 * low_hz, 1.3 * high_hz, _LINES)
    G = _response(to_continuous(without_alternating(replace(model, covariance=None))), _s(f))
    apart, mean = G[:, 0, 1] - G[:, 1, 0], 0.5 * (G[:, 0, 1] + G[:, 1, 0])
    return float(100.0 * (1.0 - np.linalg.norm(apart) / np.linalg.norm(mean)))


def _doubts(
    own: _Pairs, lag: FloatArray, reciprocity: float | None, where: str
) -> Iterator[Diagnostic]:
    """Where the method's own assumptions do not hold."""
    if reciprocity is not None and reciprocity < _RECIPROCAL:
        text = f"G12 and G21, equal in a joint, agree only to {reciprocity:.0f} %: check the gear"
        yield Diagnostic(
            "not-reciprocal", where, text + " ratio, torque_per_volt and the link sensor"
        )
    if abs(lag[4] / lag[5]) > _SLOW * abs(own.zero):
        text = "the joint's slow lag is not far below its anti-resonance, so that (18) is rough"
        yield Diagnostic("lag-not-slow", where, text)
    ratio = own.lag[1] / lag[5]
    if abs(ratio - 1.0) > _HEAVIER:
        text = f"the inertia at the joint's resonance is {ratio:.2f} times the rigid model's: see"
        yield Diagnostic(
            "inertia-mismatch", where, text + " what friction and torque_per_volt do to either"
        )
