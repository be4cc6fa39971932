"""Model and a record -> Prediction: what its torques, or its motion, should have been."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import ArmModel, Diagnostic, Log, Prediction, RigidModel, Signals
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import band_predictions
from strainwave.errors import NotIdentifiable
from strainwave.identification.closed_loop import predict_closed_loop

_FEWEST_PERIODS = 2.5
"""Of the low-pass in a record: its edges take one at either end."""

_STIFFER = 1.2
"""Stiffness for the question whether a record shows any: an error that validation should see."""


def predict_rigid(model: RigidModel, signals: Signals, arm: Arm) -> Prediction:
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
    if len(signals.time) * signals.sample_time * model.bandwidth_hz < _FEWEST_PERIODS:
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
    return Prediction(
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


def predict_elastic(model: ArmModel, log: Log, arm: Arm) -> Prediction:
    """Predict a record's motion with the whole arm, by simulating it under its servo.

    Parameters
    ----------
    model : ArmModel
    log : Log
        With its references, and voltages where a joint was in open loop.
    arm : Arm

    Returns
    -------
    Prediction
        Motor velocities and, where there are accelerometers, accelerations. The fit of a channel
        that hardly stands out of its noise is NaN, and a warning says so. `stiffness_effect` says
        whether the record exercises each elastic gear.

    Raises
    ------
    InvalidInput
        The log or the study lacks something that simulating it needs.
    """
    values = dict(model.values)
    predicted = predict_closed_loop(values, log, arm)
    elastic = [n for n, joint in enumerate(arm.joints, start=1) if joint.elastic]
    effects = {n: _stiffness_effect(predicted, n, values, log, arm) for n in elastic}
    return replace(predicted, stiffness_effect=effects)


def _stiffness_effect(
    predicted: Prediction, joint: int, values: Values, log: Log, arm: Arm
) -> float:
    """Largest change of a predicted channel by a fifth more stiffness of one gear, in its spreads.

    A motion too slow to load a gear is predicted as well with any stiffness: it says nothing of
    the elastic model.
    """
    stiffer = {
        (name, number): value * (_STIFFER if number == joint and "stiffness" in name else 1.0)
        for (name, number), value in values.items()
    }
    other = predict_closed_loop(stiffer, log, arm).predicted
    judged = np.isfinite([predicted.fit_percent[name] for name in predicted.channels])
    change = np.sqrt(np.mean((other - predicted.predicted) ** 2, axis=0))
    spread = np.std(predicted.measured, axis=0)
    return float(np.max(change[judged] / spread[judged], initial=0.0))
