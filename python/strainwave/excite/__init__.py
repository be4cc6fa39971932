"""Design experiments from a study, guessed parameters and limits.

`guessed_arm` simulates every record and gives the frequencies of a joint's resonances, whose
excitation `voltages` plans. `rigid_motion` searches the motion that best separates the rigid
parameters, and `motions` makes a record of it. `files` has the files and the terminal output.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave.domain import Clause, Diagnostic, Place, Study
from strainwave.domain.arm.parameters import complete_values, with_known_constants
from strainwave.domain.keys import Values, label_of
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.excite.files import write
from strainwave.excite.guessed_arm import (
    ExcitationBand,
    GuessedArm,
    band_of,
    predicted_precision,
    torque_errors_of,
)
from strainwave.excite.motions import motion_records, step_records
from strainwave.excite.plan import (
    ADD_SERVO,
    Design,
    LimitBroken,
    Limits,
    Planned,
    follows_angles,
    limits_of,
)
from strainwave.excite.voltages import (
    MIN_PERIODS,
    SETTLING_PERIODS,
    Kind,
    sweep_records,
    voltage_record,
)
from strainwave.io.parameters import read_assumptions, read_parameters, read_torque_errors
from strainwave.io.study import read_study

__all__ = ["Design", "Limits", "Planned", "design", "excite_study_file"]

_MOTION_SHARE = 0.25  # of the longest duration of a design, for each of two motions
_N_STARTS = 3  # of the search for the motion; the best two results become records
_MAX_STICTION_SHARE = 0.3  # of a record's time; a sticking motor hides the rigid parameters
_MAX_CONDITION_NUMBER = 300.0  # designs within generous limits reach 10
_MIN_BAND_SHARE = 0.99  # of the upper edge of the wanted band that the clock must allow


def excite_study_file(
    study_path: Path,
    parameters_path: Path | None,
    folder: Path,
    *,
    limit_angle: str | None,
    limit_velocity: str | None,
    limit_voltage: str | None,
    limit_torque: str | None,
    limit_distance: str | None,
    kind: str,
    minutes: float | None,
    seed: int,
    progress: Callable[[str], None],
) -> Design:
    """Design the experiments for the arm of a study file and write them to a folder.

    `parameters_path` is a parameter file or an earlier result. The limits are texts as `limits_of`
    reads them. `progress` receives the current activity. Raises InvalidInput if a file, a limit or
    the kind is invalid, or if no experiment satisfies the limits.
    """
    if parameters_path is None:
        raise InvalidInput(
            "the design needs approximate parameters of the arm",
            where="--parameters",
            remedy="pass an earlier result.json, or a file with a guess of every parameter from "
            "data sheets or drawings; docs/notation.md describes the format",
        )
    if kind not in ("prbs", "multisine"):
        raise InvalidInput(
            f"{kind!r} is not a kind of excitation", where="--kind", remedy="use prbs or multisine"
        )
    if folder.resolve() == study_path.resolve().parent:
        raise InvalidInput(
            "the design would overwrite the study that it reads",
            where=f"--out {folder}",
            remedy="choose a directory other than that of the study",
        )
    if minutes is not None and not minutes > 0.0:
        raise InvalidInput(
            f"{minutes:g} minutes are no duration", where="--minutes", remedy="use more than zero"
        )
    study = read_study(study_path, logs_exist=False, experiments_exist=False)
    assumed = read_assumptions(parameters_path)
    values = assumed | read_parameters(parameters_path)
    limits = limits_of(
        with_known_constants(study.arm, values),
        limit_angle,
        limit_velocity,
        limit_voltage,
        limit_torque,
        distance=limit_distance,
    )
    planned = design(
        study,
        values,
        limits,
        kind="prbs" if kind == "prbs" else "multisine",
        seed=seed,
        longest=np.inf if minutes is None else 60.0 * minutes,
        torque_errors=read_torque_errors(parameters_path),
        progress=progress,
    )
    if assumed:
        listed = ", ".join(f"{label_of(*key)} = {value:.4g}" for key, value in assumed.items())
        warning = Diagnostic("assumed", Place(file=str(parameters_path)), "guess", listed=listed)
        planned = replace(planned, warnings=(*planned.warnings, warning))
    write(planned, folder)
    return planned


def design(
    study: Study,
    values: Values,
    limits: Limits,
    *,
    kind: Kind = "prbs",
    seed: int = 0,
    longest: float = np.inf,
    torque_errors: Mapping[int, float] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Design:
    """Plan the records that identify an arm, and those that validate it.

    The design contains a motion and a motion for validation. For each elastic joint it contains a
    PRBS or multisine, the PRBS at lower amplitudes, steps, and steps for validation. Without a
    servo it contains open-loop voltages, or the motions of an arm that `follows_angles`. The
    experiments of `study` are ignored. `kind` is that of the voltages, `seed` that of the search
    and of a multisine's phases. `longest` is the duration [s] of all records. `torque_errors` are
    those of an earlier result, by joint. Raises InvalidInput if a parameter is missing, if no
    experiment satisfies the limits, or if no plan is as short. A single experiment that violates
    the limits gives a warning.
    """
    stated = study.arm.joints
    study = replace(study, arm=with_known_constants(study.arm, values))
    arm = Arm.of(study.arm)
    guess = GuessedArm(arm, values, limits)
    arm.parameter_vector(values)  # raises InvalidInput if a parameter is missing
    bands = {j: band_of(arm, values, j, limits.centre) for j in range(1, arm.n_joints + 1)}
    is_led = follows_angles(study.arm)
    warnings: tuple[Diagnostic, ...] = ()
    if arm.servo is None and any(joint.elastic for joint in arm.joints):
        place, variant = Place(file=study.path.name), "motions" if is_led else ""
        warnings = (Diagnostic("no-servo", place, variant, remedy=ADD_SERVO),)
    errors = torque_errors or {}
    lowest = min((b.anti_resonance_hz for b in bands.values() if b), default=None)
    records: tuple[Planned, ...] = ()
    failures: list[LimitBroken] = []

    @contextmanager
    def collecting() -> Iterator[None]:
        try:
            yield
        except LimitBroken as error:
            failures.append(error)

    if arm.servo is not None or is_led:
        progress("optimising the rigid motion")
        with collecting():
            records = motion_records(
                guess,
                anti_resonance_hz=lowest,
                starts=_N_STARTS,
                seed=seed,
                torque_errors=torque_errors_of(arm, errors),
                longest=_MOTION_SHARE * longest,
            )
    for joint, band in bands.items():
        if not band or is_led:
            continue
        progress(f"sizing the excitation of joint {joint}")
        with collecting():
            record = voltage_record(guess, band, joint, kind=kind, seed=seed)
            records += (record,)
            if stated[joint - 1].spring != "linear":  # whose stiffness amplitudes do not change
                sweep, omissions = sweep_records(guess, band, record, seed=seed)
                records += sweep
                place = Place(part="sweep", joint=joint)
                warnings += tuple(
                    Diagnostic("limit-broken", place, reason=text, remedy=None)
                    for text in omissions
                )
        if arm.servo is not None:
            progress(f"sizing the steps of joint {joint}")
            with collecting():
                records += step_records(guess, band, joint)
    if not records:
        raise failures[0]
    warnings += tuple(
        Diagnostic(
            "limit-broken",
            Place.in_records(error.where or ""),
            reason=error.problem,
            remedy=Clause("and-remedy", remedy=error.remedy),
        )
        for error in failures
    )
    records, omitted = fit_duration(records, longest)
    warnings += tuple(_warnings(guess, bands, records))
    experiments = tuple(record.experiment for record in records)
    progress("predicting the intervals")
    precision = predicted_precision(study, values, records, seed=seed)
    joints = (
        replace(joint, spring=each.spring)  # the assumed law of a gear is not a finding
        for joint, each in zip(arm.joints, stated, strict=True)
    )
    planned = replace(study, arm=study.arm.with_joints(joints), experiments=experiments)
    return Design(planned, limits, records, warnings, precision, omitted, errors)


def _warnings(
    guess: GuessedArm,
    bands: Mapping[int, ExcitationBand | None],
    records: Sequence[Planned],
) -> Iterator[Diagnostic]:
    """Yield the warnings of records, of too slow clocks and of torques without a limit."""
    arm = guess.arm
    known = complete_values(guess.values, arm)
    for record in records:
        place, motion = Place.in_records(record.experiment.name), record.predicted
        condition = record.condition_number
        if condition and condition > _MAX_CONDITION_NUMBER:
            yield Diagnostic("poor-excitation", place, "planned", condition=condition)
        for joint, each in enumerate(arm.joints, start=1):
            is_excited = record.experiment.joint in (None, joint)
            is_step = record.experiment.joint is not None and record.motor_angle is not None
            share = float(motion.rest_share[joint - 1])
            torque = float(motion.gear_torque[joint - 1])
            if is_excited and not is_step and share > _MAX_STICTION_SHARE:
                yield Diagnostic("standing", place, "planned", joint=joint, share=share)
            knees = tuple(each.law.knees(each.law.of_joint(known, joint)))
            is_strongest = record.experiment.use == "frequency" and record.experiment.joint == joint
            if is_strongest and any(knee > torque for knee in knees):
                yield Diagnostic("knee-not-reached", place, joint=joint, torque=torque, knees=knees)
    for joint, band in bands.items():
        first = next((r for r in records if r.experiment.joint == joint), None)
        if band and first and first.band_hz[1] < _MIN_BAND_SHARE * band.high_hz:
            hz = {"limit_hz": first.band_hz[1], "needed_hz": band.high_hz}
            yield Diagnostic("slow-clock", Place.in_records(first.experiment.name), **hz)
    for i, each in enumerate(arm.joints):
        if each.elastic and not np.isfinite(guess.limits.gear_torque[i]):
            torques = {r.experiment.name: float(r.predicted.gear_torque[i]) for r in records}
            worst = max(torques, key=torques.__getitem__)
            place = Place(joint=i + 1)
            yield Diagnostic(
                "no-torque-limit", place, joint=i + 1, torque=torques[worst], experiment=worst
            )


def fit_duration(
    records: Sequence[Planned], longest: float
) -> tuple[tuple[Planned, ...], tuple[str, ...]]:
    """Records of at most `longest` [s] together, and the names of omitted ones.

    Sweeps are omitted first, the last joint's first; then the longest PRBS loses periods, down to
    those that separate noise from distortion. Raises `InvalidInput` if that does not suffice.
    """
    kept, omitted = list(records), list[str]()
    sweeps = [record for record in records if record.experiment.use == "sweep"]
    while (total := sum(record.duration for record in kept)) > longest:
        if sweeps:
            sweep = sweeps.pop()
            kept.remove(sweep)
            omitted.append(sweep.experiment.name)
            continue
        spare = [
            k
            for k, record in enumerate(kept)
            if record.experiment.prbs
            and record.experiment.prbs.periods > SETTLING_PERIODS + MIN_PERIODS
        ]
        if not spare:
            raise InvalidInput(
                f"the shortest plan takes {total / 60.0:.1f} minutes",
                where="--minutes",
                remedy="allow at least as much",
            )
        k = max(spare, key=lambda k: kept[k].duration)
        experiment, drive = kept[k].experiment, kept[k].drive
        assert experiment.prbs is not None
        periods = experiment.prbs.periods - 1
        n = len(drive.voltage) * periods // (periods + 1)
        kept[k] = replace(  # the predicted motion contains that of the shorter record
            kept[k],
            experiment=replace(experiment, prbs=replace(experiment.prbs, periods=periods)),
            drive=replace(drive, voltage=drive.voltage[:n], reference=drive.reference[:n]),
            reasons=(*kept[k].reasons, f"{periods} periods for the duration that is allowed"),
        )
    return tuple(kept), tuple(omitted)
