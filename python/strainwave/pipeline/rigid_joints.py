"""Motor signals -> rigid model, and its predictions of the fitted and the check records.

Motion records with and without a payload -> torques per volt of the drives.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import (
    Clause,
    Diagnostic,
    DriveGains,
    Log,
    Place,
    Prediction,
    RigidModel,
    Signals,
)
from strainwave.domain.arm.combinations import is_uncoupled
from strainwave.domain.arm.effects import OF_RIGID_JOINTS
from strainwave.domain.arm.link_sensors import link_channel_kinds
from strainwave.domain.results.stage_results import StageResults
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, RecordTooShort
from strainwave.identification import rigid, validation
from strainwave.numerics.parallel import run_parallel
from strainwave.pipeline.inputs import Inputs, Reporter
from strainwave.signals import hygiene
from strainwave.signals.motor import SignalOptions, mark_standstill, prepare_motor_signals


def fit_rigid_joints(
    inputs: Inputs, results: StageResults, reporter: Reporter, gains: DriveGains | None = None
) -> StageResults:
    """Add the rigid model, and its predictions of the torques of its records and the check records.

    `gains` are the estimated torques per volt, which the arm has.
    """
    arm = inputs.arm
    _check_effects(arm)
    with reporter.time_part("rigid", "rigid joints: least squares"):
        motion_logs = inputs.logs_of("motion")
        # stages of elastic gears fit the torsion themselves
        is_last = not inputs.logs_of("frequency", "sweep", "tuning")
        options = SignalOptions(with_torsion=is_last)
        prepared = run_parallel(
            [partial(prepare_motor_signals, log, arm, options) for log in motion_logs]
            + [partial(_prepare_check, log, arm, options) for log in inputs.logs_of("check")]
        )
        records = mark_standstill([each for each in prepared if isinstance(each, Signals)])
        motion, checks = records[: len(motion_logs)], records[len(motion_logs) :]
        results = results.warn(warning for each in records for warning in each.warnings)
        results = results.warn(each for each in prepared if isinstance(each, Diagnostic))
        try:
            model = rigid.fit_rigid(motion, arm, inputs.study.options.rigid, gains)
        except NotIdentifiable as failure:
            is_excited = bool(inputs.logs_of("frequency"))
            if is_uncoupled(inputs.arm) and is_excited and "decoupled" in inputs.stages:
                # the joints can be identified without a rigid model
                return results.warn(
                    [Diagnostic("no-rigid-model", inputs.place, reason=str(failure))]
                )
            return results.fail(Clause("text", text=str(failure)))
        results = replace(results, rigid=model)
        results = results.warn((*model.warnings, *_assumed_units(inputs, motion_logs)))
    if model.status == "not-identifiable":
        return results
    with reporter.time_part("checks", "predicting the check records"):
        fitted, warnings_of_fit = _predict(model, motion, arm)
        checked, warnings_of_checks = _predict(model, checks, arm, fitted)
    results = results.warn((*warnings_of_fit, *warnings_of_checks))
    return replace(results, fitted=fitted, checks=checked)


def _assumed_units(inputs: Inputs, logs: Sequence[Log]) -> Iterator[Diagnostic]:
    """Warn of joints of which no relation between channels, masses or gravity shows the units."""
    arm, channels = inputs.study.arm, inputs.study.channels
    has_weight = arm.gravity_size > 0.0 or arm.urdf is not None
    if has_weight or any(log.experiment.payload for log in logs):
        return
    for number, joint in enumerate(arm.joints, start=1):
        names = [f"theta_m{number}", f"torque{number}"]
        others = [f"{kind}{number}" for kind in ("omega_m", "ref", *link_channel_kinds())]
        is_stated = joint.encoder_counts or any(
            name in channels and channels[name].scale != 1.0 for name in names
        )
        own = [log.channels for log in logs if all(name in log.channels for name in names)]
        if joint.elastic or is_stated or not own or any(o in log for log in own for o in others):
            continue
        angles = np.concatenate([log[names[0]] for log in own])
        is_whole = bool(np.all(angles == np.round(angles)) and np.ptp(angles) > 1.0)
        variant = ["counts"] if is_whole else []
        place, span = Place(joint=number), float(np.ptp(angles))
        yield Diagnostic("units-assumed", place, *variant, joint=number, span=span)


def _check_effects(arm: Arm) -> None:
    """Raise InvalidInput for an effect that no stage of an arm with rigid joints has.

    The whole-arm fit, which needs an elastic gear, has equations of all effects.
    """
    if any(joint.elastic for joint in arm.joints):
        return
    for number, joint in enumerate(arm.joints, start=1):
        for name in set(joint.named_effects) - set(OF_RIGID_JOINTS):
            raise InvalidInput(
                f"the effect '{name}' is part of the whole-arm fit, which needs an elastic gear",
                where=f"joint {number}, effects",
                remedy=f"remove '{name}'; rigid arms can have {', '.join(OF_RIGID_JOINTS)}",
            )
        if "encoder-zero" in joint.named_effects and not arm.gravity_size:
            raise InvalidInput(
                "the effect 'encoder-zero' needs gravity, whose torque shows the zero",
                where=f"joint {number}, effects",
                remedy="set gravity in [arm], or remove 'encoder-zero'",
            )
        if "gear-torsion" in joint.named_effects and not joint.torque_at_link:
            raise InvalidInput(
                "the effect 'gear-torsion' needs the torque of a sensor behind the gear",
                where=f"joint {number}, effects",
                remedy=f"log tau_l{number} in place of torque{number}, or remove 'gear-torsion'",
            )


def _prepare_check(log: Log, arm: Arm, options: SignalOptions) -> Signals | Diagnostic:
    """Signals of a check record; a warning if it is too short for a rigid prediction."""
    try:
        return prepare_motor_signals(log, arm, options)
    except RecordTooShort as error:
        place = Place.in_records(log.name)
        return Diagnostic(
            "nothing-to-predict", place, "reason", reason=f"is too short: {error.problem}"
        )


def _predict(
    model: RigidModel, records: Sequence[Signals], arm: Arm, fitted: Sequence[Prediction] = ()
) -> tuple[tuple[Prediction, ...], tuple[Diagnostic, ...]]:
    """Predict the torques of records, with warnings; `fitted` determines the expected errors."""

    def predict(record: Signals) -> Prediction | Diagnostic:
        try:
            return validation.predict_rigid(model, record, arm, fitted)
        except NotIdentifiable as failure:
            place = Place.in_records(record.experiment.name)
            return Diagnostic("nothing-to-predict", place, "reason", reason=str(failure))

    outcomes = run_parallel([partial(predict, record) for record in records])
    predictions = tuple(each for each in outcomes if isinstance(each, Prediction))
    return predictions, tuple(each for each in outcomes if isinstance(each, Diagnostic))


def estimate_drives(
    results: StageResults, reporter: Reporter
) -> tuple[StageResults, DriveGains | None]:
    """Estimate the unknown torques per volt of a study's arm, which the study then has.

    If the records do not determine them, the study stays as it is, and the results have the
    failure.
    """
    study = results.study
    arm = Arm.of(study.arm)
    with reporter.time_part("rigid", "unknown drives: motions with and without payload"):
        usable, _ = hygiene.repair_records(results.logs, arm)
        motions = [log for log in usable if log.experiment.use == "motion"]
        try:
            signals = run_parallel([partial(prepare_motor_signals, log, arm) for log in motions])
            gains = rigid.estimate_drive_gains(signals, arm)
        except NotIdentifiable as failure:
            return results.fail(Clause("text", text=str(failure))), None
    study = replace(study, arm=gains.of(study.arm))
    results = replace(results, study=study, drive_gains=gains.parameters)
    return results.warn(gains.warnings), gains
