"""Predict the torques or the motion of a record with a fitted model, and compare."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import (
    ArmModel,
    FloatArray,
    FrictionTerm,
    Log,
    Prediction,
    RigidModel,
    Signals,
    channel_parts,
)
from strainwave.domain.arm.parameter_table import COULOMB, family_of
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import band_prediction
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.closed_loop import build_prediction, observe
from strainwave.signals.recorded_input import driven_by_voltage

_MIN_PERIODS = 2.5
"""Minimum number of periods of the low-pass in a record; each edge takes one."""

_STIFFNESS_FACTOR = 1.2
"""Factor on the stiffness that validation should detect, to test the effect of the stiffness."""

MAX_ERROR_SHARE = 0.1
"""Maximum RMS error of a prediction, as a share of the channel's motion. Smaller errors are
accepted whatever their cause."""

MIN_MOTION_SHARE = 0.25
"""Minimum motion of a channel, as a share of its largest motion in a fitted record. At standstill,
friction determines any small motion."""

MAX_UNEXPLAINED_STDS = 3.0
"""Error above which a prediction is unexplained, in standard deviations of all known causes."""

FRICTION_VARIATION_SHARE = 0.05
"""Relative change of Coulomb friction between records of a good drive, due to temperature and
position."""

_N_DRAWS = 6  # samples of the parameters; their standard deviation is accurate to about a third


_TypicalMotion = tuple[float, float]
"""Largest standard deviations of a channel's signal and residual in the fitted records."""


def _unexplained_errors(
    prediction: Prediction,
    noise: FloatArray,
    usual: Mapping[str, _TypicalMotion],
    varied: Callable[[], Iterator[FloatArray]],
) -> Mapping[str, float]:
    """Channels that the model does not predict, with the ratio of error to explained error.

    A channel is listed under two conditions. Its error is a large share of its motion, and it
    exceeds the error explained by sensor noise (n_channels,), by the residuals of the fitted
    records, and by changes of friction and parameters. `varied` yields the changes of the
    prediction (n_samples, n_channels), each for one independent standard deviation. It is evaluated
    only if the other causes do not explain an error.
    """
    error = np.sqrt(np.mean((prediction.measured - prediction.predicted) ** 2, axis=0))
    typical = np.array([usual.get(name, (0.0, 0.0)) for name in prediction.channels])
    motion = np.maximum(
        np.std(prediction.measured, axis=0),
        MIN_MOTION_SHARE * typical[:, 0],
    )
    moves = np.isfinite([prediction.fit_percent[name] for name in prediction.channels])
    explained = noise**2 + typical[:, 1] ** 2
    is_large = moves & (error > MAX_ERROR_SHARE * motion)
    if not np.any(is_large & (error > MAX_UNEXPLAINED_STDS * np.sqrt(explained))):
        return {}
    for change in varied():
        explained = explained + np.mean(change**2, axis=0)
    ratio = np.divide(error, np.sqrt(explained), out=np.zeros_like(error), where=explained > 0.0)
    unexplained = np.flatnonzero(is_large & (ratio > MAX_UNEXPLAINED_STDS))
    return {prediction.channels[k]: float(ratio[k]) for k in unexplained}


def predict_rigid(
    model: RigidModel, signals: Signals, arm: Arm, fitted: Sequence[Prediction] = ()
) -> Prediction:
    """Predict the drive signals of a record from its measured motion with the rigid model.

    Channels are as logged, torques or voltages. `fit_percent` is the fit within the model's
    bandwidth, where a rigid model is valid, and NaN for a motor that does not move in most of the
    record. During stiction the model predicts an interval of torques, and the value nearest to
    the measured torque is returned.

    `signals` is from `signals.prepare_motor_signals`. With predictions of the fitted records in
    `fitted`, `unexplained` lists the channels that the model does not predict.

    Raises `NotIdentifiable` if the model has no identified parameter or the record is shorter than
    the filter.
    """
    if model.status == "not-identifiable":
        raise NotIdentifiable("a rigid model without a single known parameter predicts nothing")
    if len(signals.time) * signals.sample_time * model.bandwidth_hz < _MIN_PERIODS:
        raise NotIdentifiable(
            f"lasts {len(signals.time) * signals.sample_time:.3g} s, too short to be predicted"
            f" behind the rigid model's low-pass of {model.bandwidth_hz:.2g} Hz"
        )
    terms, band = model.friction_terms, model.bandwidth_hz
    prediction = predict_torques(model.solution, signals, arm, band, terms)
    if not fitted:
        return prediction

    def varied() -> Iterator[FloatArray]:
        coulomb = [k for k, p in enumerate(model.parameters) if p.name == COULOMB]
        covariance = np.nan_to_num(model.covariance, nan=0.0, posinf=0.0)
        every = range(len(covariance))
        for solution in _variations(model.solution, coulomb, every, covariance):
            other = predict_torques(solution, signals, arm, band, terms)
            yield other.predicted - prediction.predicted

    motions = np.max([np.std(each.measured, axis=0) for each in fitted], axis=0)
    errors = np.max([np.std(each.measured - each.predicted, axis=0) for each in fitted], axis=0)
    pairs = zip(motions.tolist(), errors.tolist(), strict=True)
    typical = dict(zip(prediction.channels, pairs, strict=True))
    unexplained = _unexplained_errors(prediction, np.zeros(len(typical)), typical, varied)
    return replace(prediction, unexplained=unexplained)


def predict_torques(
    solution: FloatArray,
    signals: Signals,
    arm: Arm,
    bandwidth_hz: float,
    friction_terms: Sequence[FrictionTerm] = (),
) -> Prediction:
    """Predict the drive signals of a record as in `predict_rigid`, with given values.

    `solution` (n_parameters,) has the order of `Arm.rigid_columns`; the low-pass of both sides has
    the bandwidth.
    """
    band = band_prediction(arm, solution, signals, bandwidth_hz, friction_terms)
    names = signals.torque_channel
    is_voltage = [channel_parts(name)[0] == "u" for name in names]
    per_channel = np.where(is_voltage, arm.torque_per_volt, 1.0)
    return Prediction(
        experiment=signals.experiment.name,
        time=band.time,
        channels=names,
        measured=band.measured / per_channel,
        predicted=band.predicted / per_channel,
        fit_percent=dict(zip(names, band.fit_percent.tolist(), strict=True)),
    )


def _variations(
    values: FloatArray, coulomb: Iterable[int], places: Sequence[int], covariance: FloatArray
) -> Iterator[FloatArray]:
    """Values with changed Coulomb friction, and with samples of the covariance at `places`."""
    for k in coulomb:
        changed = values.copy()
        changed[k] *= 1.0 + FRICTION_VARIATION_SHARE
        yield changed
    rng, mean = np.random.default_rng(0), np.zeros(len(places))
    for draw in rng.multivariate_normal(mean, covariance, _N_DRAWS, check_valid="ignore"):
        changed = values.copy()
        changed[list(places)] += draw / math.sqrt(_N_DRAWS)
        yield changed


def predict_elastic(model: ArmModel, log: Log, arm: Arm) -> Prediction:
    """Predict the motion of a record with the whole arm by a simulation with its servo.

    The channels are motor velocities and, with accelerometers, accelerations. The fit of a channel
    that does not clearly exceed its noise is NaN. `stiffness_effect` reports how
    far the record excites each elastic gear; `unexplained` lists the channels that the model
    does not predict. Raises `InvalidInput` if the log or the study lacks data that the simulation
    needs.
    """
    values, observed = dict(model.values), observe(log, arm)
    elastic = [n for n, joint in enumerate(arm.joints, start=1) if joint.elastic]
    motion, *stiffer = observed.simulate(arm, values, *(_stiffer(values, n) for n in elastic))
    prediction = build_prediction(observed, motion)
    pairs = zip(elastic, stiffer, strict=True)
    effects = {n: _stiffness_effects(prediction, changed) for n, changed in pairs}
    typical, noise = _typical_motion(model), observed.noise

    def varied() -> Iterator[FloatArray]:
        keys, parameters = list(values), [p for p in model.parameters if p.key in values]
        coulomb = [k for k, key in enumerate(keys) if key[0] == COULOMB]
        rows = [k for k, p in enumerate(model.parameters) if p.key in values]
        covariance = model.covariance[np.ix_(rows, rows)]
        places = [keys.index(p.key) for p in parameters]
        for other in _variations(np.array(list(values.values())), coulomb, places, covariance):
            try:
                changed = dict(zip(keys, other.tolist(), strict=True))
                (other_motion,) = observed.simulate(arm, changed)
                yield other_motion - motion
            except (InvalidInput, NumericalFailure):  # the values are physically impossible
                continue

    errors = _unexplained_errors(prediction, noise, typical, varied)
    # the same prediction with the recorded voltages instead of the servo
    driven, drive = driven_by_voltage(arm, log)
    by_voltage = replace(observed, drive=drive)
    is_servo_at_fault = bool(errors) and not _unexplained_errors(
        build_prediction(by_voltage, *by_voltage.simulate(driven, values)), noise, typical, varied
    )
    return replace(
        prediction,
        stiffness_effect=effects,
        unexplained=errors,
        is_servo_at_fault=is_servo_at_fault,
    )


def _typical_motion(model: ArmModel) -> Mapping[str, _TypicalMotion]:
    """Largest motion and residual of each channel in the fitted records."""
    typical: dict[str, _TypicalMotion] = {}
    for test in model.criticism.residuals if model.criticism else ():
        fit = model.fit_percent.get(test.experiment, {}).get(test.channel, math.nan)
        motion = test.deviation / (1.0 - 0.01 * fit) if fit < 100.0 else 0.0
        largest_motion, largest_error = typical.get(test.channel, (0.0, 0.0))
        typical[test.channel] = max(largest_motion, motion), max(largest_error, test.deviation)
    return typical


def _stiffer(values: Values, joint: int) -> Values:
    """Values with 20 % more stiffness of one gear."""
    return {
        (name, number): value
        * (_STIFFNESS_FACTOR if number == joint and family_of(name) == "stiffness" else 1.0)
        for (name, number), value in values.items()
    }


def _stiffness_effects(prediction: Prediction, stiffer: FloatArray) -> Mapping[str, float]:
    """Relative change of each channel with a fit for more stiffness of one gear.

    `stiffer` (n_rows, n_channels) is the motion with that stiffness. The change is relative to the
    standard deviation of the channel. If the motion is too slow to load the gear, any stiffness
    predicts it equally well, and the record does not validate the elastic model.
    """
    change = np.sqrt(np.mean((stiffer - prediction.predicted) ** 2, axis=0))
    relative = change / np.maximum(np.std(prediction.measured, axis=0), np.finfo(float).tiny)
    effects = zip(prediction.channels, relative.tolist(), strict=True)
    return {name: effect for name, effect in effects if np.isfinite(prediction.fit_percent[name])}
