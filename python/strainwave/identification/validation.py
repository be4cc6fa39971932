"""Model and a record -> Prediction: what its torques, or its motion, should have been."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import ArmModel, Diagnostic, FloatArray, Log, Prediction, RigidModel, Signals
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import band_predictions
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.closed_loop import Observed, as_known, observe, prediction_of
from strainwave.identification.whole_arm.parametrisation import COULOMB
from strainwave.signals.recorded_input import driven_by_voltage

_MIN_PERIODS = 2.5
"""Periods of the low-pass in a record: its edges take one at either end."""

_STIFFER = 1.2
"""Stiffness for the question whether a record shows any: an error that validation should see."""

MAX_ERROR = 0.1
"""Share of a channel's motion that a prediction may be wrong by whatever explains it: less matters
to no use of the model."""

MIN_MOTION = 0.25
"""Share of its largest motion in a fitted record that a channel counts as moving at least: at
standstill friction decides over any small motion."""

MAX_UNEXPLAINED = 3.0
"""Standard deviations of all that explains a prediction's error, beyond which none of it does."""

FRICTION_VARIATION = 0.05
"""Share by which a good drive's Coulomb friction differs between records, by temperature and
position."""

_N_DRAWS = 6  # of the parameters by their covariance: their spread to a third of itself


@dataclass(frozen=True, slots=True)
class _Usual:
    """What fitted records show of one channel."""

    motion: float  # the largest standard deviation of its signal
    error: float  # and of its residuals


def _unexplained(
    prediction: Prediction,
    noise: FloatArray,
    usual: Mapping[str, _Usual],
    varied: Callable[[], Iterator[FloatArray]],
) -> Mapping[str, float]:
    """Errors of channels that are not predicted, over what explains them.

    Two conditions: the error is a large share of the channel's motion, and it is beyond the
    sensor's noise, (n_channels,), the residuals of fitted records and what friction and the
    parameters' covariance make of the prediction. `varied` yields changes of it, each of which is
    one independent standard deviation, (n_samples, n_channels); it is asked only if the rest does
    not explain an error.
    """
    error = np.sqrt(np.mean((prediction.measured - prediction.predicted) ** 2, axis=0))
    nothing = _Usual(0.0, 0.0)
    known = [usual.get(name, nothing) for name in prediction.channels]
    motion = np.maximum(
        np.std(prediction.measured, axis=0), MIN_MOTION * np.array([each.motion for each in known])
    )
    moves = np.isfinite([prediction.fit_percent[name] for name in prediction.channels])
    explained = noise**2 + np.array([each.error for each in known]) ** 2
    large = moves & (error > MAX_ERROR * motion)
    if not np.any(large & (error > MAX_UNEXPLAINED * np.sqrt(explained))):
        return {}
    for change in varied():
        explained = explained + np.mean(change**2, axis=0)
    ratio = np.divide(error, np.sqrt(explained), out=np.zeros_like(error), where=explained > 0.0)
    at = np.flatnonzero(large & (ratio > MAX_UNEXPLAINED))
    return {prediction.channels[k]: float(ratio[k]) for k in at}


def predict_rigid(
    model: RigidModel, signals: Signals, arm: Arm, fitted: Sequence[Prediction] = ()
) -> Prediction:
    """Predict a record's drive signals from its motion with the rigid model.

    The motion is the record's own, measured; only the torques are predicted. `fit_percent` is that
    within the model's bandwidth, which is as far as a rigid model claims to hold;
    `unfiltered_fit_percent` compares with the torques as logged, noise and vibration included.
    Both are NaN for a motor that stands for most of the record. Where a motor stands for a while,
    the model predicts a set of torques, and the member next to the measured one is returned.

    Parameters
    ----------
    model : RigidModel
    signals : Signals
        From `signals.motor_side`.
    arm : Arm

    Returns
    -------
    Prediction
        Channels as logged: torques, or voltages where those were logged.

    Raises
    ------
    NotIdentifiable
        The model has no determined parameter at all, or the record is shorter than its filter.
    """
    if model.status == "not-identifiable":
        raise NotIdentifiable("a rigid model without a single known parameter predicts nothing")
    if len(signals.time) * signals.sample_time * model.bandwidth_hz < _MIN_PERIODS:
        raise NotIdentifiable(
            f"lasts {len(signals.time) * signals.sample_time:.3g} s, too short to be predicted"
            f" behind the rigid model's low-pass of {model.bandwidth_hz:.2g} Hz"
        )
    band, full = band_predictions(
        arm, model.solution, signals, model.bandwidth_hz, model.load_friction
    )
    names = signals.torque_channel
    per_channel = np.array(
        [
            (joint.torque_per_volt or 1.0) if name.startswith("u") else 1.0
            for name, joint in zip(names, arm.joints, strict=True)
        ]
    )
    prediction = Prediction(
        experiment=signals.experiment.name,
        time=band.time,
        channels=names,
        measured=band.measured / per_channel,
        predicted=band.predicted / per_channel,
        fit_percent=dict(zip(names, band.fit_percent.tolist(), strict=True)),
        unfiltered_fit_percent=dict(zip(names, full.fit_percent.tolist(), strict=True)),
        warnings=tuple(
            Diagnostic(
                "nothing-to-predict",
                signals.experiment.name,
                f"{name} has no fit: its motor stands, or its torque does not vary",
            )
            for name, fit in zip(names, band.fit_percent, strict=True)
            if not np.isfinite(fit)
        ),
    )

    def varied() -> Iterator[FloatArray]:
        for solution in _rigid_variations(model):
            other, _ = band_predictions(
                arm, solution, signals, model.bandwidth_hz, model.load_friction
            )
            yield (other.predicted - band.predicted) / per_channel

    usual = {
        name: _Usual(
            max(float(np.std(each.measured[:, k])) for each in fitted),
            max(float(np.std(each.measured[:, k] - each.predicted[:, k])) for each in fitted),
        )
        for k, name in enumerate(names if fitted else ())
    }
    errors = _unexplained(prediction, np.zeros(len(names)), usual, varied) if fitted else {}
    return replace(prediction, unexplained=errors)


def _rigid_variations(model: RigidModel) -> Iterator[FloatArray]:
    """The model's solution with other friction, and with errors of its covariance."""
    for k, p in enumerate(model.parameters):
        if p.name == COULOMB:
            other = model.solution.copy()
            other[k] *= 1.0 + FRICTION_VARIATION
            yield other
    covariance = np.nan_to_num(model.covariance, nan=0.0, posinf=0.0)
    rng = np.random.default_rng(0)
    for draw in rng.multivariate_normal(np.zeros(len(covariance)), covariance, _N_DRAWS):
        yield model.solution + draw / math.sqrt(_N_DRAWS)


def predict_elastic(model: ArmModel, log: Log, arm: Arm) -> Prediction:
    """Predict a record's motion with the whole arm, by simulating it under its servo.

    The channels are motor velocities and, where there are accelerometers, accelerations. The fit of
    a channel whose signal hardly exceeds its noise is NaN, and a warning says so.
    `stiffness_effect` says whether the record exercises each elastic gear, `unexplained` which
    channels the model does not predict. Raises InvalidInput if the log or the study lacks something
    that simulating it needs.
    """
    values, observed = dict(model.values), observe(log, arm)
    motion = observed.simulated(as_known(arm, values), values)
    prediction = prediction_of(observed, motion)
    elastic = [n for n, joint in enumerate(arm.joints, start=1) if joint.elastic]
    effects = {n: _stiffness_effect(prediction, observed, n, values, arm) for n in elastic}
    usual, noise = _usual(model), observed.noise

    def varied() -> Iterator[FloatArray]:
        for other in _variations(model):
            try:
                yield observed.simulated(as_known(arm, other), other) - motion
            except (InvalidInput, NumericalFailure):  # no arm can be so
                continue

    errors = _unexplained(prediction, noise, usual, varied)
    servo = bool(errors) and not _unexplained(
        _by_voltage(observed, values, arm), noise, usual, varied
    )
    return replace(
        prediction, stiffness_effect=effects, unexplained=errors, is_servo_at_fault=servo
    )


def _by_voltage(observed: Observed, values: Values, arm: Arm) -> Prediction:
    """The same prediction with the recorded voltages in place of the servo."""
    driven, drive = driven_by_voltage(arm, observed.log)
    other = replace(observed, drive=drive)
    return prediction_of(other, other.simulated(as_known(driven, values), values))


def _usual(model: ArmModel) -> Mapping[str, _Usual]:
    """Largest motion and residual of each channel in the records of the fit."""
    usual: dict[str, _Usual] = {}
    for test in model.criticism.residuals if model.criticism else ():
        fit = model.fit_percent.get(test.experiment, {}).get(test.channel, math.nan)
        spread = test.deviation / (1.0 - 0.01 * fit) if fit < 100.0 else 0.0
        known = usual.get(test.channel, _Usual(0.0, 0.0))
        usual[test.channel] = _Usual(max(known.motion, spread), max(known.error, test.deviation))
    return usual


def _variations(model: ArmModel) -> Iterator[Values]:
    """The model's values with other friction, and with errors of its covariance."""
    values = dict(model.values)
    for key, value in values.items():
        if key[0] == COULOMB:
            yield {**values, key: value * (1.0 + FRICTION_VARIATION)}
    own = [k for k, p in enumerate(model.parameters) if (p.name, p.joint) in values]
    covariance = model.covariance[np.ix_(own, own)]
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.zeros(len(own)), covariance, _N_DRAWS, check_valid="ignore")
    for draw in draws / math.sqrt(_N_DRAWS):
        other = dict(values)
        for k, change in zip(own, draw.tolist(), strict=True):
            p = model.parameters[k]
            other[p.name, p.joint] += change
        yield other


def _stiffness_effect(
    prediction: Prediction, observed: Observed, joint: int, values: Values, arm: Arm
) -> float:
    """Largest change of a channel by a fifth more stiffness of one gear, in its spreads.

    A motion too slow to load a gear is predicted as well with any stiffness: it says nothing of
    the elastic model.
    """
    stiffer = {
        (name, number): value * (_STIFFER if number == joint and "stiffness" in name else 1.0)
        for (name, number), value in values.items()
    }
    other = observed.simulated(as_known(arm, stiffer), stiffer)
    judged = np.isfinite([prediction.fit_percent[name] for name in prediction.channels])
    change = np.sqrt(np.mean((other - prediction.predicted) ** 2, axis=0))
    spread = np.std(prediction.measured, axis=0)
    return float(np.max(change[judged] / spread[judged], initial=0.0))
