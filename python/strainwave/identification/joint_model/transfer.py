"""Compute physical parameters from the transfer functions of a state-space model, (15)-(18).

The state-space model gives G11, the transfer function from motor torque to motor velocity. Its
lightly damped zero pair gives b1, b2; its pole pair gives d1, d2. Fast records contain little
information on the slow pole of (17), so (18) replaces it by c_0 + c_1 s from the rigid model. The
physical parameters then follow in closed form.
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
    Place,
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
from strainwave.identification.joint_model.equations import RigidKnowledge
from strainwave.identification.joint_model.joint_estimate import JointEstimate
from strainwave.identification.joint_model.linear import modes_of
from strainwave.identification.joint_model.stretches import band_around, band_of, velocities
from strainwave.numerics.filters import by_spectrum
from strainwave.statespace import (
    nearest,
    poles_and_zeros,
    propagate,
    remove_alternating_poles,
    to_continuous,
)

_MAX_RELATIVE_STD = 1.0  # relative standard deviation above which the sign is not determined
# maximum of c_0/c_1 relative to the anti-resonance, an assumption of (18)
_MAX_LAG_TO_ANTI_RESONANCE = 0.1
# relative difference of c_1 between the two models that causes a warning
_MAX_INERTIA_DIFFERENCE = 0.1
# [percent] minimum agreement of G12 and G21; good records give above 90
_MIN_RECIPROCITY_PERCENT = 70.0
_RECIPROCITY_LINES = 25  # number of frequencies at which G12 and G21 are compared


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Lightly damped pole and zero pair of G11, and its slow lag."""

    zero: complex
    pole: complex
    lag: tuple[float, float]  # c_0, c_1 of the state-space model near its resonance

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
    """Compute the physical parameters from G11 of a state-space model, (17), (18).

    `model` is a result of `state_space_of` for `records`; with more than three states, its least
    damped pole and zero pairs are used. `known` gives c_0 and c_1 for (18); a missing value is
    replaced by that of the model, (17). `others` are models of the same records in other bands: the
    scatter of their estimates is added to the covariance as model error.

    Without a covariance of the model, the standard deviations are None. Impossible values are
    reported as estimated, with status "implausible". `fit_percent` contains the fit of both
    velocities in the band and the agreement of G12 with G21.

    Raises `NotIdentifiable` if the model has no oscillating pole or zero pair.
    """
    joint_records = (records,) if isinstance(records, Decoupled) else tuple(records)
    number, ratio = joint_records[0].joint, joint_records[0].gear_ratio
    names = tuple(record.experiment.name for record in joint_records)
    nominal = _pairs(model, None)
    vector, pair_covariance = _pairs_with_covariance(model, nominal, others)
    coefficients, lag_covariance = vector[:6].copy(), pair_covariance[:6, :6].copy()
    # (18) has c_0 and c_1 of the rigid model
    for index, value in ((4, known.total_viscous_friction), (5, known.total_inertia)):
        if value is not None:
            coefficients[index] = value[0]
            lag_covariance[index] = lag_covariance[:, index] = 0.0
            lag_covariance[index, index] = value[1] ** 2
    two_inertia = from_coefficients(coefficients[:2], coefficients[2:4], coefficients[4:], ratio)
    J = jacobian(lambda q: from_coefficients(q[:2], q[2:4], q[4:], ratio).vector, coefficients)
    covariance = J @ lag_covariance @ J.T
    values = dict(zip(NAMES, two_inertia.vector.tolist(), strict=True))
    standard_deviations = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    identified = tuple(
        not std > _MAX_RELATIVE_STD * abs(value)
        for std, value in zip(standard_deviations, two_inertia.vector, strict=True)
    )
    mode_std = np.sqrt(np.clip(np.diag(pair_covariance)[6:], 0.0, None))
    modes = [_mode(nominal.zero, mode_std[:2]), _mode(nominal.pole, mode_std[2:])]
    band = band_around(modes[0].frequency_hz, modes[1].frequency_hz, joint_records)
    fit = _fit_percent(two_inertia, joint_records, band)
    reciprocity = _reciprocity(model, modes[0].frequency_hz, modes[1].frequency_hz)
    if reciprocity is not None:
        fit["reciprocity"] = reciprocity
    estimate = JointEstimate(
        arm.joints[number - 1],
        number,
        names,
        values,
        covariance,
        identified,
        joint_records[0].posture,
    )
    place = Place.in_records(*names)
    notes = _assumption_warnings(nominal, coefficients, reciprocity, place)
    return estimate.to_model("transfer-function", (modes[0], modes[1]), band, fit, notes)


def _vector(zero: ComplexArray, pole: ComplexArray, lag: FloatArray) -> FloatArray:
    """`_Pairs.vector` for zeros and poles (...,) and lags (2, ...), (..., 10)."""
    quadratic_coefficients = [
        x for r in (zero, pole) for x in (-2.0 * r.real / abs(r) ** 2, abs(r) ** -2.0)
    ]
    frequencies_and_dampings = [
        x for r in (zero, pole) for x in (abs(r) / (2.0 * np.pi), -r.real / abs(r))
    ]
    return np.stack([*quadratic_coefficients, *lag, *frequencies_and_dampings], axis=-1)


def _pairs_with_covariance(
    model: StateSpace, nominal: _Pairs, others: Sequence[StateSpace]
) -> tuple[FloatArray, FloatArray]:
    """`_Pairs.vector` with its covariance, model error included; NaN without a covariance."""

    def at_once(near: StateSpace) -> FloatArray:
        continuous = to_continuous(near)
        poles, zeros = poles_and_zeros(continuous, 0, 0)
        zero = nearest(np.array([nominal.zero]), zeros)[:, 0]
        pole = nearest(np.array([nominal.pole]), poles)[:, 0]
        return _vector(zero, pole, np.stack(_lag(continuous, zero, pole)))

    vector, covariance = propagate(remove_alternating_poles(model), at_once, stacked=True)
    if covariance is None:
        covariance = np.full((len(vector), len(vector)), np.nan)
    changes = [_pairs(other, nominal).vector - vector for other in others]
    if changes:
        covariance = covariance + np.mean([np.outer(move, move) for move in changes], axis=0)
    return vector, covariance


def _pairs(model: StateSpace, near: _Pairs | None) -> _Pairs:
    """The least damped pole and zero pair, or those nearest to the pairs of `near`."""
    reduced = remove_alternating_poles(replace(model, covariance=None))
    modes = modes_of(reduced)
    zeros, poles = ([m.value for m in each if m.oscillates] for each in (modes.zeros, modes.poles))
    if not zeros or not poles:
        raise NotIdentifiable(
            "the state-space model has no oscillating pair of poles and zeros: raise the amplitude "
            "or record for longer"
        )
    zero, pole = (min(roots, key=lambda r: abs(r.real / r)) for roots in (zeros, poles))
    if near is not None:
        zero = min(zeros, key=lambda r: abs(r - near.zero))
        pole = min(poles, key=lambda r: abs(r - near.pole))
    lag = _lag(to_continuous(reduced), np.array([zero]), np.array([pole]))
    return _Pairs(zero, pole, (float(lag[0][0]), float(lag[1][0])))


def _lag(
    model: ContinuousStateSpace, zero: ComplexArray, pole: ComplexArray
) -> tuple[FloatArray, FloatArray]:
    """c_0 and c_1 with G11 = (1 + b1 s + b2 s^2) / ((c_0 + c_1 s)(1 + d1 s + d2 s^2)).

    One complex equation per model, at the geometric mean of anti-resonance and resonance.
    """
    s = 1j * np.sqrt(abs(zero) * abs(pole))
    numerator, denominator = ((s - r) * (s - r.conjugate()) / abs(r) ** 2 for r in (zero, pole))
    lag = numerator / (denominator * _response(model, s)[:, 0, 0])
    return lag.real, lag.imag / abs(s)


def _response(model: ContinuousStateSpace, s: ComplexArray) -> ComplexArray:
    """Frequency response (n, n_outputs, n_inputs) of one model, or of n models at their own s."""
    inner = s[:, None, None] * np.eye(model.A.shape[-1]) - model.A
    right = np.broadcast_to(model.B + 0j, (len(s), *model.B.shape[-2:]))
    return np.asarray(model.C @ np.linalg.solve(inner, right) + model.D)


def _mode(value: complex, deviation: FloatArray) -> Mode:
    std = [float(d) if np.isfinite(d) else None for d in deviation]
    return Mode(value, abs(value) / (2.0 * np.pi), -value.real / abs(value), std[0], std[1])


def _fit_percent(
    joint: TwoInertia, records: Sequence[Decoupled], band: tuple[float, float]
) -> dict[str, float]:
    """Fit of the physical parameters to both velocities in the band, in percent."""
    physical = state_space(joint)
    physical.B[:, records[0].inputs.shape[1] :] = 0.0
    outputs_and_residuals = [_outputs_and_residuals(physical, record, band) for record in records]
    residuals = np.concatenate([residual for _, residual in outputs_and_residuals])
    norm = np.linalg.norm(
        np.concatenate([y - y.mean(axis=0) for y, _ in outputs_and_residuals]), axis=0
    )
    fits = 100.0 * (1.0 - np.linalg.norm(residuals, axis=0) / norm)
    return dict(zip(("motor_velocity", "link_velocity"), fits.tolist(), strict=True))


def _outputs_and_residuals(
    physical: ContinuousStateSpace, record: Decoupled, band: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Both velocities of a record in the band, and the residuals of a model."""
    n_in = record.inputs.shape[1]

    def modelled(f: FloatArray) -> ComplexArray:
        return np.asarray(
            band_of(f, band)[:, None, None] * _response(physical, 2j * np.pi * f.astype(complex))
        )

    def measured(f: FloatArray) -> ComplexArray:
        return np.asarray(band_of(f, band)[:, None, None] * velocities(f, record))

    filter_length = 3.0 / band[0]
    rows = np.flatnonzero(record.valid)
    edge = int(1.0 / (band[0] * record.sample_time))
    rows = rows[(rows >= rows[0] + edge) & (rows <= rows[-1] - edge)]
    inputs = np.zeros((len(record.inputs), 2))
    inputs[:, :n_in] = record.inputs
    y = by_spectrum(record.outputs, measured, record.sample_time, filter_length)[rows]
    return y, y - by_spectrum(inputs, modelled, record.sample_time, filter_length)[rows]


def _reciprocity(model: StateSpace, low_hz: float, high_hz: float) -> float | None:
    """Agreement of G12 and G21 in percent. The two are equal for a passive joint."""
    if min(len(model.C), model.B.shape[1]) < 2:
        return None
    f = np.geomspace(0.7 * low_hz, 1.3 * high_hz, _RECIPROCITY_LINES)
    continuous = to_continuous(remove_alternating_poles(replace(model, covariance=None)))
    G = _response(continuous, 2j * np.pi * f.astype(complex))
    difference, average = G[:, 0, 1] - G[:, 1, 0], 0.5 * (G[:, 0, 1] + G[:, 1, 0])
    return float(100.0 * (1.0 - np.linalg.norm(difference) / np.linalg.norm(average)))


def _assumption_warnings(
    pairs: _Pairs, lag: FloatArray, reciprocity: float | None, place: Place
) -> Iterator[Diagnostic]:
    """Warnings for assumptions of the method that the estimates violate."""
    if reciprocity is not None and reciprocity < _MIN_RECIPROCITY_PERCENT:
        yield Diagnostic("not-reciprocal", place, agreement=reciprocity)
    if abs(lag[4] / lag[5]) > _MAX_LAG_TO_ANTI_RESONANCE * abs(pairs.zero):
        yield Diagnostic("lag-not-slow", place)
    ratio = pairs.lag[1] / lag[5]
    if abs(ratio - 1.0) > _MAX_INERTIA_DIFFERENCE:
        yield Diagnostic("inertia-mismatch", place, ratio=float(ratio))
