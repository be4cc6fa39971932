"""Parameters of arm and servos from a fit, with intervals that contain errors of the model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import (
    Activity,
    Diagnostic,
    FloatArray,
    Log,
    Parameter,
    Place,
    Prediction,
    RigidModel,
)
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA
from strainwave.domain.arm.combinations import LINK_INERTIA
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET
from strainwave.domain.keys import JointNumber, Key
from strainwave.domain.results.distributions import CI95_STDS, chi_square_limit
from strainwave.domain.results.estimates import physical_range
from strainwave.identification.position_servo.candidates import LIMIT_UNREACHED
from strainwave.identification.position_servo.fit import ServoFit
from strainwave.identification.position_servo.loop import (
    DELAY,
    GEAR_DAMPING,
    GEAR_EFFECTS,
    KD,
    KP,
    LIMIT,
    MOTOR_SHARE,
    SCALE,
    STIFFNESS,
    VELOCITY_LAG,
    VISCOUS,
)
from strainwave.identification.position_servo.records import (
    ReferenceHold,
    Segment,
    common_period,
    segments_of,
    servo_record,
)
from strainwave.identification.position_servo.states import fitted_state
from strainwave.numerics.linalg import singular_values

DAMPING = "servo_damping"

_LEAST_DEVIATION = 0.002  # relative, of torques: as of the whole-arm fit, errors of any model
# [s] between a reading and its torque: a delay in the loop acts as negative damping kp * delay
_LOOP_TIMING = 5e-5
_LAG_ERROR = 0.2  # periods of a servo: filters and resolution of its velocity
# Relative errors of the effects of gears. The damping of contacts is not known and acts in the gap
# too: backlash of drawn gears comes out up to 27 % too small. Load friction is within 1 % in four
# of five drawn gears.
_EFFECT_ERRORS = dict(zip(GEAR_EFFECTS, (0.2, 0.05), strict=True))
_LOOSE = 1e-2  # weight of the prior share of kd where the data have to tell kd from friction
_MIN_SINGULAR_VALUE = 1e-9  # relative; unknowns without effect get infinite standard deviations
# relative half-width of kd and viscous friction, which differ in the held sample alone unless the
# output reaches its limit
_MAX_SPLIT_ERROR = 0.3
_MAX_EFFECT_MISFIT = 1.3  # beyond which an effect stands in for another
_UNIFORM_HALF_WIDTH = 0.475  # of the 95 % interval, over the width of a uniform distribution
_CONTRADICTED_LEVEL = 1e-3  # probability with which a correct gain seems contradicted
_MAX_CHECK_ERROR = 0.1  # rms, over the motion: errors below are accepted whatever their cause

_GEAR_UNITS = {STIFFNESS: "N m/rad", GEAR_DAMPING: "N m s/rad"}
_PER_GAIN = {
    "kg m^2": "s^2",
    "kg m": "s^2/m",
    "kg": "s^2/m^2",
    "N m s/rad": "s",
    "N m": "rad",
    "N m/rad": "1",
}
"""Units of values over the gain of a joint [N m/rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class _Quantity:
    """A combination of the unknowns."""

    key: Key
    value: float
    gradient: FloatArray  # (n_unknowns,)
    unit: str
    is_torque: bool = True  # and so in the unit of the gains


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """A reported parameter, its dependence on the unknowns, and why it has no value."""

    parameter: Parameter
    gradient: FloatArray  # (n_unknowns,)
    warning: Diagnostic | None = None


class _Covariance:
    """Covariances of the unknowns, with and without the prior share of kd."""

    def __init__(self, fit: ServoFit) -> None:
        self.total = self._with_priors(fit, 1.0)
        self.loose = self._with_priors(fit, _LOOSE)

    def variance(self, name: str, gradient: FloatArray) -> float:
        """Variance of a parameter, without errors of its own."""
        matrix = self.loose if name in (KD, VISCOUS) else self.total
        return float(gradient @ matrix @ gradient)

    def of(self, estimates: Sequence[_Estimate]) -> FloatArray:
        """Joint covariance of the parameters; NaN in rows and columns of those without a value.

        Without the prior share, kd and viscous friction have larger errors, which other parameters
        do not share. Each variance is that of its parameter: the rest is an error of its own.
        """
        gradients = np.array([each.gradient for each in estimates])
        is_split = np.array([each.parameter.name in (KD, VISCOUS) for each in estimates])
        scale = np.sqrt(np.diag(self.loose))
        scale[scale == 0.0] = 1.0
        squares, vectors = np.linalg.eigh((self.loose - self.total) / np.outer(scale, scale))
        excess = gradients * scale @ vectors * np.sqrt(np.maximum(squares, 0.0))
        excess[~is_split] = 0.0
        joint = gradients @ self.total @ gradients.T + excess @ excess.T
        stds = [each.parameter.std for each in estimates]
        variances = np.square([np.nan if std is None else std for std in stds])
        # the prior share can add to the dispersion of some direction between segments
        shrinkage = np.sqrt(variances / np.maximum(np.diag(joint), variances))
        joint *= np.outer(shrinkage, shrinkage)
        np.fill_diagonal(joint, variances)
        return np.asarray(joint)

    @staticmethod
    def _with_priors(fit: ServoFit, weight: float) -> FloatArray:
        """Dispersion between segments, errors of the model and of its clocks.

        Residuals beyond the resolution are errors of the model that segments share, so that the
        dispersion between segments is too small: deviations grow by the ratio of the variances.
        """
        priors = fit.prior_rows()
        is_share = [len(prior.weights) > 1 for prior in fit.priors]
        priors[is_share] *= weight
        table = np.vstack([*(rows.jacobian for rows in fit.rows), priors])
        scale = np.linalg.norm(table, axis=0)
        scale[scale == 0.0] = 1.0
        _, s, Vt = singular_values(table / scale)
        inverse = Vt.T / np.maximum(s, _MIN_SINGULAR_VALUE * s[0]) ** 2 @ Vt
        scores = np.array([rows.jacobian.T @ rows.residual for rows in fit.rows]) / scale
        n = len(scores)
        inner = n / max(n - 1, 1) * scores.T @ scores + (priors / scale).T @ (priors / scale)
        covariance = inverse @ inner @ inverse / np.outer(scale, scale)
        covariance = np.asarray(covariance * fit.misfit**4)
        covariance += fit.rival_rows().T @ fit.rival_rows()
        index = {key: k for k, unknown in enumerate(fit.unknowns) for key in unknown.keys}
        for i in fit.loop.numbers:
            timing = np.zeros(len(scale))
            if (DELAY, i) in index:
                timing[index[DELAY, i]] = _LOOP_TIMING
            damping = index.get((KD, i), index[VISCOUS, i])
            timing[damping] = -fit.values[KP, i] * _LOOP_TIMING
            covariance += np.outer(timing, timing)
            # other unknowns follow changes of what no law describes exactly
            errors = {
                (name, i): relative * fit.values.get((name, i), 0.0)
                for name, relative in _EFFECT_ERRORS.items()
            }
            for key, error in ({(VELOCITY_LAG, i): _LAG_ERROR} | errors).items():
                if key in index:
                    k = index[key]
                    change = inverse[:, k] / inverse[k, k] * scale[k] / scale * error
                    covariance += np.outer(change, change)
        return covariance


def _estimates(fit: ServoFit, covariance: _Covariance) -> Iterator[_Estimate]:
    scale = _scale(fit, covariance)
    for quantity in _quantities(fit):
        of_torque = quantity.is_torque
        scaled = _in_torques(quantity, scale, fit) if of_torque else quantity
        per = "kp" if of_torque and scale is None else None
        name, joint = quantity.key
        if name == VISCOUS and per is None:
            back_emf = fit.loop.servo.back_emf_damping(joint or 1) or 0.0
            scaled = replace(scaled, value=scaled.value - back_emf)
        variance = covariance.variance(name, scaled.gradient)
        if of_torque and not (name == KP and scale is None):
            variance += (_LEAST_DEVIATION * scaled.value) ** 2
        std = float(np.sqrt(variance))
        unit = scaled.unit if per is None else _PER_GAIN.get(scaled.unit, scaled.unit)
        variant = _why_not(fit, quantity, scaled.value, std, is_ratio=per is not None)
        if variant is not None:
            place = Place(joint=joint, parameter=name)
            warning = Diagnostic("servo-undetermined", place, variant, joint=joint or 1)
            null = Parameter(*quantity.key, None, None, unit, "rigid", per=per)
            yield _Estimate(null, scaled.gradient, warning)
            continue
        half = CI95_STDS * std
        if name == DELAY:
            std, half = _delay_error(fit, std)
        interval = (scaled.value - half, scaled.value + half)
        parameter = Parameter(*quantity.key, scaled.value, std, unit, "rigid", interval, per=per)
        yield _Estimate(parameter, scaled.gradient)


def _quantities(fit: ServoFit) -> Iterator[_Quantity]:
    index = {key: k for k, unknown in enumerate(fit.unknowns) for key in unknown.keys}
    loop, servo, values, n = fit.loop, fit.loop.servo, fit.values, len(fit.unknowns)

    def unit(*keys: Key) -> FloatArray:
        gradient = np.zeros(n)
        for key in keys:
            if key in index:
                gradient[index[key]] = 1.0
        return gradient

    for column in loop.arm.base.columns:
        yield _Quantity(column.key, values[column.key], unit(column.key), column.unit)
    for i in loop.numbers:
        viscous, kd = values[VISCOUS, i], values[KD, i]
        for name in (COULOMB, OFFSET):
            gradient = unit((name, i))
            yield _Quantity((name, i), values[name, i], gradient, unit_in(loop.arm, (name, i)))
        damping = "N m s/rad"
        both = unit((KD, i), (VISCOUS, i))
        yield _Quantity((DAMPING, i), kd + viscous, both, damping)
        yield _Quantity((VISCOUS, i), viscous, unit((VISCOUS, i)), damping)
        if (KD, i) in index:
            yield _Quantity((KD, i), kd, unit((KD, i)), damping)
        if servo.gain(i) is None:
            yield _Quantity((KP, i), values[KP, i], unit((KP, i)), "N m/rad")
        yield _Quantity((LIMIT, i), values[LIMIT, i], unit((LIMIT, i)), "N m")
        for name, size_unit in _GEAR_UNITS.items():
            if (name, i) in index:
                yield _Quantity((name, i), values[name, i], unit((name, i)), size_unit)
        if (MOTOR_SHARE, i) in index and not loop.has_stiff_gears:
            yield from _separate_inertias(fit, index, i)
        for name in GEAR_EFFECTS:
            if (name, i) in index:
                size = _Quantity((name, i), values[name, i], unit((name, i)), "1")
                yield replace(size, unit=unit_in(loop.arm, size.key), is_torque=False)
        if (DELAY, i) in index:
            yield _Quantity((DELAY, i), values[DELAY, i], unit((DELAY, i)), "s", is_torque=False)


def _separate_inertias(
    fit: ServoFit, index: Mapping[Key, int], joint: JointNumber
) -> Iterator[_Quantity]:
    """Inertias of motor and link, which an elastic gear separates."""
    loop, base = fit.loop, fit.loop.arm.base
    inputs = loop.prepare(fit.values, fit.segments[0].record)
    for key in ((MOTOR_INERTIA, joint), (LINK_INERTIA, joint)):
        if key not in base.links and key[0] != MOTOR_INERTIA:
            continue
        value, gradient = 0.0, np.zeros(len(fit.unknowns))
        for column in base.columns:
            weight = (loop.row(column.key, inputs) or {}).get(key, 0.0)
            value += weight * fit.values[column.key]
            gradient[index[column.key]] = weight
        share: Key = (MOTOR_SHARE, joint)
        gradient[index[share]] = (loop.row(share, inputs) or {}).get(key, 0.0)
        yield _Quantity(key, value, gradient, unit_in(loop.arm, key))


def _scale(fit: ServoFit, covariance: _Covariance) -> tuple[float, FloatArray] | None:
    """Gain of joint 1 [N m/rad] by which torques are divided, with its gradient; None: unknown.

    It is that of a known payload, or of a known torque limit that the output reaches.
    """
    servo, values, n = fit.loop.servo, fit.values, len(fit.unknowns)
    if servo.gain(1) is not None:
        return 1.0, np.zeros(n)
    index = {key: k for k, unknown in enumerate(fit.unknowns) for key in unknown.keys}
    scale, gradient = 0.0, np.zeros(n)
    limit = servo.torque_limit(1)
    if SCALE in index:
        scale, gradient[index[SCALE]] = values[SCALE], 1.0
    elif limit is not None and fit.saturated[0]:
        scale = limit / values[LIMIT, 1]
        gradient[index[LIMIT, 1]] = -scale / values[LIMIT, 1]
    std = float(np.sqrt(gradient @ covariance.total @ gradient))
    return (scale, gradient) if scale > CI95_STDS * std > 0.0 else None


def _in_torques(
    quantity: _Quantity, scale: tuple[float, FloatArray] | None, fit: ServoFit
) -> _Quantity:
    """The quantity with the scale; or, without one, over the gain of its own joint."""
    name, joint = quantity.key
    value, gradient = quantity.value, quantity.gradient
    if scale is not None:
        factor, of_factor = scale
        value, gradient = factor * value, factor * gradient + value * of_factor
    elif joint is not None and joint > 1 and name != KP:
        gain, of_gain = fit.values[KP, joint], np.zeros(len(gradient))
        for k, unknown in enumerate(fit.unknowns):
            of_gain[k] = float((KP, joint) in unknown.keys)
        value, gradient = value / gain, (gradient - value / gain * of_gain) / gain
    return _Quantity(quantity.key, value, np.asarray(gradient), quantity.unit)


def _effect(fit: ServoFit, quantity: _Quantity) -> float:
    """Change of the angles without the quantity, rms in standard deviations of a reading.

    Infinite for the gain that is the unit of the others.
    """
    if not quantity.gradient.any():
        return np.inf
    change = np.where(quantity.gradient != 0.0, fit.x, 0.0)
    squares = [float(np.sum((rows.jacobian @ change) ** 2)) for rows in fit.rows]
    return float(np.sqrt(sum(squares) / sum(len(rows.residual) for rows in fit.rows)))


def _why_not(
    fit: ServoFit, quantity: _Quantity, value: float, std: float, *, is_ratio: bool
) -> str | None:
    """Variant of the warning of a parameter that the data do not determine; None if they do."""
    name, joint = quantity.key
    servo, is_limited = fit.loop.servo, fit.saturated[(joint or 1) - 1]
    back_emf = servo.back_emf_damping(joint or 1)
    is_open = name in (KD, VISCOUS) and servo.damping_gain(joint or 1) is None
    reasons = {
        "scale": name == KP and is_ratio,
        "limit": name == LIMIT and not is_limited,
        # below the limit, only errors of the clocks tell kd from viscous friction
        "split": (is_open and not is_limited) or (name in (KD, VISCOUS) and fit.has_rival_effect),
        "back-emf": name == VISCOUS and back_emf != 0.0 and (back_emf is None or is_ratio),
        "effect": name in GEAR_EFFECTS
        and (fit.misfit > _MAX_EFFECT_MISFIT or fit.has_rival_effect),
    }
    for reason, holds in reasons.items():
        if holds:
            return reason
    # of friction, an interval that contains zero tells that there is nearly none
    half = CI95_STDS * std
    if name in (KD, VISCOUS):
        return "split" if half > _MAX_SPLIT_ERROR * abs(value) else None
    may_vanish = name in (COULOMB, DAMPING) or physical_range(name) == "any"
    # errors of no model are so small and so random that they leave what is below the resolution
    is_unseen = half >= abs(value) or _effect(fit, quantity) < 1.0
    return "motion" if is_unseen and not may_vanish else None


def _delay_error(fit: ServoFit, std: float) -> tuple[float, float]:
    """Standard deviation and half-width of the interval of the delay [s].

    Readings tell the delay of a held command up to the common period of log and servo.
    """
    half = CI95_STDS * std
    period = fit.loop.servo.period
    width = max(common_period(period, s.record.sample_time) for s in fit.segments)
    is_faster = all(s.record.sample_time <= 1.01 * period for s in fit.segments)
    if fit.loop.hold is not ReferenceHold.HELD and is_faster:
        # all readings of the servo meet samples of the log, held or not
        std, half = float(np.hypot(std, width / np.sqrt(3.0))), float(np.hypot(half, width))
    elif fit.loop.hold is ReferenceHold.HELD:
        std = float(np.hypot(std, width / np.sqrt(12.0)))
        half = float(np.hypot(half, _UNIFORM_HALF_WIDTH * width))
    return std, half


def _contradiction(fit: ServoFit, covariance: _Covariance) -> Iterator[Diagnostic]:
    """Warning of a known gain that known payloads exclude; the values are those with this gain."""
    gain = fit.loop.servo.gain(1)
    index = [k for k, unknown in enumerate(fit.unknowns) if unknown.keys == (SCALE,)]
    if gain is None or not index:
        return
    factor = fit.values[SCALE]
    std = float(np.hypot(np.sqrt(covariance.total[index[0], index[0]]), _LEAST_DEVIATION * factor))
    half = float(np.sqrt(chi_square_limit(_CONTRADICTED_LEVEL, 1))) * std
    if abs(factor - 1.0) > half:
        ends = {"low": gain * (factor - half), "high": gain * (factor + half)}
        place = Place(joint=1, parameter=KP)
        values = {"stated": gain, "value": gain * factor, "factor": factor} | ends
        yield Diagnostic("servo-gain-contradicted", place, **values)


def rigid_model(fit: ServoFit) -> RigidModel:
    """The result as that of the rigid step."""
    covariance = _Covariance(fit)
    estimates = list(_estimates(fit, covariance))
    parameters = tuple(each.parameter for each in estimates)
    warnings = tuple(each.warning for each in estimates if each.warning is not None)
    warnings += tuple(_contradiction(fit, covariance))
    table = np.vstack([rows.jacobian for rows in fit.rows])
    scale = np.linalg.norm(table, axis=0)
    s = np.linalg.svd(table[:, scale > 0.0] / scale[scale > 0.0], compute_uv=False)
    if fit.misfit > _WARNED_MISFIT:
        place = Place.in_records(*dict.fromkeys(s.record.name for s in fit.segments))
        warnings += (Diagnostic("servo-misfit", place, ratio=fit.misfit),)
    return RigidModel(
        parameters=parameters,
        solution=np.array([p.value if p.value is not None else np.nan for p in parameters]),
        covariance=covariance.of(estimates),
        condition_number=float(s[0] / s[-1]),
        fit_percent={p.experiment: p.fit_percent for p in predict(fit)},
        bandwidth_hz=0.5 / float(np.max([s.record.sample_time for s in fit.segments])),
        decimation=1,
        n_rows=len(table),
        status="determined"
        if all(p.value is not None for p in parameters)
        else "partly-determined",
        warnings=warnings,
    )


_WARNED_MISFIT = 2.0  # ratio of residuals to the resolution: four times its variance


def predict(fit: ServoFit) -> tuple[Prediction, ...]:
    """Measured and simulated angles of the fitted records."""
    records = {s.record.name: s.record for s in fit.segments}
    predictions = []
    for name, record in records.items():
        pairs = [
            (segment, state)
            for segment, state in zip(fit.segments, fit.states, strict=True)
            if segment.record is record
        ]
        predictions.append(_prediction(fit, name, pairs))
    return tuple(predictions)


def predict_check(fit: ServoFit, log: Log) -> Prediction:
    """Measured and simulated angles of a check record, from one initial state."""
    record = servo_record(log, fit.loop.arm)
    first = next(segments_of(record))
    segment = Segment(record, first.first, len(record.time))
    state = fitted_state(fit.loop, fit.values, segment)
    prediction = _prediction(fit, log.name, [(segment, state)])
    run = fit.loop.simulate(fit.loop.prepare(fit.values, record), segment, state)
    is_beyond = ~fit.saturated & (run.peak > 1.0 / LIMIT_UNREACHED)
    if is_beyond.any():  # it shows the unknown limit, not errors of the other values
        return replace(prediction, unexplained={})
    return prediction


def _prediction(
    fit: ServoFit, name: str, pairs: Sequence[tuple[Segment, FloatArray]]
) -> Prediction:
    loop = fit.loop
    inputs = loop.prepare(fit.values, pairs[0][0].record)
    simulated = [loop.simulate(inputs, segment, state).angle for segment, state in pairs]
    ratios = loop.arm.gear_ratios
    predicted = np.concatenate(simulated) / ratios
    measured = np.concatenate([segment.angle for segment, _ in pairs]) / ratios
    channels = tuple(f"theta_m{i}" for i in loop.numbers)
    error = np.sqrt(np.mean((predicted - measured) ** 2, axis=0))
    motion = np.std(measured, axis=0)
    fits = 100.0 * (1.0 - error / np.where(motion > 0.0, motion, np.inf))
    typical = np.median(fit.deviations, axis=0) / np.abs(ratios)
    return Prediction(
        experiment=name,
        time=np.concatenate([segment.time for segment, _ in pairs]),
        channels=channels,
        measured=measured,
        predicted=predicted,
        fit_percent=dict(zip(channels, fits.tolist(), strict=True)),
        unexplained={
            channel: float(error[k] / typical[k])
            for k, channel in enumerate(channels)
            if error[k] > _MAX_CHECK_ERROR * motion[k]
        },
    )


def activities(fit: ServoFit) -> tuple[Activity, ...]:
    """Root mean squares of torque [unit of the values], velocity and acceleration of the joints."""
    result = []
    for i in fit.loop.numbers:
        squares = []
        for record in {id(s.record): s.record for s in fit.segments}.values():
            angle, T = record.angle[:, i - 1], record.sample_time
            step = max(1, round(0.02 / T))
            velocity = (angle[step:] - angle[:-step]) / (step * T)
            acceleration = (velocity[step:] - velocity[:-step]) / (step * T)
            torque = fit.values[KP, i] * (record.reference[:, i - 1] - angle)
            squares.append([np.mean(x**2) for x in (torque, velocity, acceleration)])
        torque, velocity, acceleration = np.sqrt(np.mean(squares, axis=0)).tolist()
        ratio = abs(float(fit.loop.arm.gear_ratios[i - 1]))
        result.append(Activity(i, torque * ratio, velocity / ratio, acceleration / ratio))
    return tuple(result)
