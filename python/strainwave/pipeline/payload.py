"""An identified arm and records that carry an unknown load -> the load."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import (
    ArmDescription,
    Diagnostic,
    Experiment,
    FloatArray,
    Log,
    Parameter,
    Payload,
    PayloadEstimate,
    Place,
    RigidModel,
    Signals,
    Study,
)
from strainwave.domain.arm.description import UNKNOWN
from strainwave.domain.arm.link_sensors.link_space import attitude
from strainwave.domain.results.identification import merge_by_cause
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.export.source import IdentifiedArm, arm_of
from strainwave.identification import load_quantities as quantities
from strainwave.identification.payload import ArmPrior, LoadFit, fit_load, prior_of
from strainwave.io import results
from strainwave.io.logs import read_logs
from strainwave.io.logs.arrays import Data
from strainwave.numerics.parallel import one_blas_thread, run_parallel
from strainwave.pipeline.inputs import with_sensed_torques
from strainwave.signals import hygiene
from strainwave.signals.motor import SignalOptions, detect_standing_motors, prepare_motor_signals

# relative difference of ratios, and difference of angles and lengths [rad, m], of equal arms: both
# come from text with at least six digits
_MAX_DIFFERENCE = 1e-5


def estimate_payload(
    document: Mapping[str, Any],
    source: Path,
    study: Study,
    *,
    identified: Study | None = None,
    data: Data | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> PayloadEstimate:
    """Estimate the load of the motion records of a study of an identified arm.

    `document` is the arm's result, of the file `source`; `identified` is the study of a result that
    was not read from a file, and `data` that of `identify`. If there are no motion records, all are
    fitted. If all state the same payload, the estimate is compared with it, which checks the torque
    constants. Raises InvalidInput if the study is not of this arm or a log is at fault, and
    NotIdentifiable if the arm or the load is not determined.
    """
    known = known_arm(document, source, identified)
    arm = known.arm
    _require_same_arm(study, arm)
    with one_blas_thread():
        progress("reading the logs")
        logs = _read(study, arm, data)
        stated = _stated_payload([log.experiment for log in logs], study)
        usable, warnings = hygiene.repair_records(logs, arm)
        if not usable:
            causes = "; ".join(dict.fromkeys(f"{w.where}: {w.observation}" for w in warnings))
            raise InvalidInput(
                f"no record is usable ({causes})",
                where=str(study.path),
                remedy="correct the sensor or its cable, and record again",
            )
        progress("estimating the load")
        signals = _prepare(usable, arm, known.prior, known.model)
        fit = fit_load(signals, arm, known.prior)
    warnings = (
        *(warning for log in logs for warning in log.warnings),
        *warnings,
        *(warning for each in signals for warning in each.warnings),
    )
    records = tuple(each.experiment.name for each in signals)
    return estimate_of(known, fit, study, records, warnings, stated)


@dataclass(frozen=True, slots=True)
class KnownArm:
    """An identified arm whose load is estimated."""

    arm: Arm
    model: RigidModel
    prior: ArmPrior
    gain_error: float  # relative, of identified torque constants
    study: Study  # of the identification
    source: Path  # of the result


def known_arm(document: Mapping[str, Any], source: Path, identified: Study | None) -> KnownArm:
    """The arm of a result. Raises InvalidInput without a rigid model of it."""
    found = arm_of(document, source, identified=identified)
    model = found.rigid
    if model is None:
        raise InvalidInput(
            "has no rigid model, to whose torques a load adds",
            where=f"{source}: stages.rigid.prediction",
            remedy='identify the arm again, with records of use = "motion"',
        )
    found = found.with_identified_drives()
    described = found.study.arm
    if described.urdf is not None:  # relative to the study of the identification
        file = str(found.study.path.parent / described.urdf.file)
        described = replace(described, urdf=replace(described.urdf, file=file))
    arm = Arm.of(described)
    prior = _prior(found, arm, document, model)
    return KnownArm(arm, model, prior, _gain_error(found), found.study, source)


def estimate_of(
    known: KnownArm,
    fit: LoadFit,
    study: Study,
    records: tuple[str, ...],
    warnings: Sequence[Diagnostic] = (),
    stated: Payload | None = None,
) -> PayloadEstimate:
    """The record of a load with all warnings."""
    fit = quantities.with_gain_errors(fit, known.gain_error)
    estimate = quantities.quantities_of(fit)
    of_bodies = known.arm.rigid_columns[: known.arm.n_body]
    missing = tuple(
        column.label
        for column, is_known in zip(of_bodies, known.prior.is_determined, strict=False)
        if not is_known
    )
    scale_is_known = known.gain_error > 0.0 or stated is not None
    of_load = quantities.warnings_of(fit, estimate, scale_is_known=scale_is_known)
    warnings = (*warnings, *of_load)
    if missing:
        place = Place(file=str(known.source))
        warnings = (*warnings, Diagnostic("arm-undetermined", place, names=missing))
    scale = None
    if stated is not None:
        check = quantities.compare_with_stated(fit, stated)
        scale = check.scale
        warnings = (*warnings, *_contradictions(check, stated))
    is_load = estimate.mass is not None and estimate.mass.ci95[0] > 0.0
    body, assumed = quantities.body_of(fit, estimate) if is_load else (None, ())
    return PayloadEstimate(
        quantities=estimate,
        standard=fit.value,
        covariance=fit.covariance,
        body=body,
        assumed=assumed,
        records=records,
        warnings=merge_by_cause(dict.fromkeys(warnings)),
        study=replace(study, arm=known.arm),
        result=known.source,
        stated=stated,
        torque_scale=scale,
    )


def _require_same_arm(study: Study, arm: ArmDescription) -> None:
    """Raise InvalidInput, with key and values, unless the study describes the identified arm."""
    described = study.arm
    if described.n_joints != arm.n_joints:
        raise InvalidInput(
            f"the study has {described.n_joints} joints, and the identified arm {arm.n_joints}",
            where=str(study.path),
            remedy="give the result and a study of one arm",
        )
    pairs: list[tuple[str, Any, Any]]
    pairs = [("gravity of [arm]", described.gravity or (0.0,) * 3, arm.gravity or (0.0,) * 3)]
    ours, theirs = (each.coupling or np.eye(arm.n_joints) for each in (described, arm))
    pairs.append(("coupling of [transmission]", ours, theirs))
    for number, (a, b) in enumerate(zip(described.joints, arm.joints, strict=True), start=1):
        if a.motion != b.motion:
            raise _other_arm(study, f"motion of joint {number}", a.motion, b.motion)
        turns = [attitude(each.origin.rpy) for each in (a, b)]
        axes = [np.array(each.axis) / np.linalg.norm(each.axis) for each in (a, b)]
        pairs += [
            (f"gear_ratio of joint {number}", a.gear_ratio, b.gear_ratio),
            (f"origin of joint {number}", a.origin.xyz, b.origin.xyz),
            (f"attitude of joint {number}", turns[0], turns[1]),
            (f"axis of joint {number}", axes[0], axes[1]),
        ]
        drives = (a.torque_per_volt, b.torque_per_volt)
        if UNKNOWN not in drives and None not in drives:
            pairs.append((f"torque_per_volt of joint {number}", *drives))
    for name, given, expected in pairs:
        values = [np.asarray(each, dtype=np.float64) for each in (given, expected)]
        size = max(float(np.max(np.abs(values[1]))), np.finfo(float).tiny)
        is_length = name.startswith("origin")
        if np.max(np.abs(values[0] - values[1])) > _MAX_DIFFERENCE * (1.0 if is_length else size):
            raise _other_arm(study, name, *(np.round(each, 6).tolist() for each in values))


def _other_arm(study: Study, name: str, given: Any, expected: Any) -> InvalidInput:
    return InvalidInput(
        f"{name} is {given}, and that of the identified arm is {expected}",
        where=str(study.path),
        remedy="give the result and a study of one arm, or identify the arm with these values",
    )


def _read(study: Study, arm: Arm, data: Data | None) -> tuple[Log, ...]:
    """Logs of the motion records, or of all records without one, with the result's torques."""
    motions = [each for each in study.experiments if each.use == "motion"]
    as_logged = arm.with_joints(replace(joint, torque_at_link=False) for joint in arm.joints)
    study = replace(study, arm=as_logged)
    logs = read_logs(study, motions or study.experiments, data=data)
    at_link = [i for i, joint in enumerate(arm.joints, start=1) if joint.torque_at_link]
    motors = {f"{kind}{i}" for i in at_link for kind in ("torque", "u")}
    logs = tuple(
        replace(log, channels={k: x for k, x in log.channels.items() if k not in motors})
        for log in logs
    )
    sensed, logs = with_sensed_torques(study, logs)
    for number, (a, b) in enumerate(zip(sensed.arm.joints, arm.joints, strict=True), start=1):
        if a.torque_at_link != b.torque_at_link:
            names = ("tau_l", "torque") if b.torque_at_link else ("torque", "tau_l")
            raise InvalidInput(
                f"the arm was identified from {names[0]}{number}, and the logs have only "
                f"{names[1]}{number}",
                where=str(study.path),
                remedy="log the same torque as for the identification, or identify the arm from "
                "the other one",
            )
    return logs


def _stated_payload(experiments: Sequence[Experiment], study: Study) -> Payload | None:
    """The payload that all records state; None if none does."""
    payloads = {each.payload for each in experiments}
    if len(payloads) > 1:
        raise InvalidInput(
            "the records state different payloads",
            where=f"{study.path}, payload in [[experiment]]",
            remedy="write one study per load: without payload to estimate it, with the payload in "
            "all records to check the scale of the torques",
        )
    return next(iter(payloads), None)


def _prior(
    found: IdentifiedArm, arm: Arm, document: Mapping[str, Any], model: RigidModel
) -> ArmPrior:
    """The arm's parameters; raises NotIdentifiable if none of its bodies is known."""
    values = {p.key: (p.value, p.std or 0.0) for p in found.parameters if p.value is not None}
    joint = results.covariance_of(document)
    names, matrix = ((), np.zeros((0, 0))) if joint is None else (joint.names, joint.matrix)
    prior = prior_of(arm, values, names, matrix, model.bandwidth_hz, model.friction_terms)
    if not prior.is_determined[: arm.n_body].any():
        raise NotIdentifiable(
            "the result has no inertia and no gravity torque of the arm, to which those of a load "
            "add: identify the arm with faster motions of all joints"
        )
    return prior


def _prepare(
    logs: Sequence[Log], arm: Arm, prior: ArmPrior, model: RigidModel
) -> tuple[Signals, ...]:
    """Signals of the records, without their stated payload, which is estimated.

    A motor stands if it moves far less than when the arm was identified.
    """
    options = SignalOptions(with_torsion=bool(np.isinf(prior.compliance_std).any()))
    signals = run_parallel([partial(prepare_motor_signals, log, arm, options) for log in logs])
    reference: list[FloatArray] = [model.motion[0]] if model.motion.size else []
    stands = detect_standing_motors([*reference, *(each.motor_angle for each in signals)])
    return tuple(
        replace(
            each,
            experiment=replace(each.experiment, payload=None),
            direction=np.where(at, 0.0, each.direction),
        )
        for each, at in zip(signals, stands[len(reference) :], strict=True)
    )


def _gain_error(found: IdentifiedArm) -> float:
    """Relative standard deviation of identified torques per volt; zero for stated ones."""

    def relative(p: Parameter) -> float:
        return (p.std or 0.0) / (p.value or 1.0)

    return max((relative(p) for p in found.parameters if p.name == "torque_per_volt"), default=0.0)


def _contradictions(check: quantities.ScaleCheck, stated: Payload) -> Iterator[Diagnostic]:
    place = Place(key="payload", part="load")
    scale = check.scale
    if scale is not None and not scale.ci95[0] <= 1.0 <= scale.ci95[1]:
        low, high = scale.ci95
        values = {"mass": stated.mass, "factor": scale.value, "low": low, "high": high}
        yield Diagnostic("torque-scale-contradicted", place, **values)
    if not check.is_explained:
        yield Diagnostic("load-differs", place)
