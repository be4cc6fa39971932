"""Study, guessed parameters, limits -> Design: which records identify the arm, and how long ones.

`band` says where a joint's resonances are, `voltages` plans what excites them, `rigid_motion`
searches the motion that separates the rigid parameters and `motions` makes a record of it;
`predicted_motion` runs every plan on the guessed arm, `precision` says which intervals the declared
sensors would give, `written` makes files of it and `summary` the
table for the terminal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave.domain import Diagnostic, Study
from strainwave.domain.parameters import Values, completed
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.experiment_design.band import Band, band_of
from strainwave.experiment_design.motions import motion_records
from strainwave.experiment_design.plan import (
    ADD_SERVO,
    Design,
    LimitBroken,
    Limits,
    Planned,
    limits_of,
)
from strainwave.experiment_design.precision import predicted_precision
from strainwave.experiment_design.steps import step_records
from strainwave.experiment_design.voltages import Kind, sweep_records, voltage_record
from strainwave.experiment_design.written import write
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study

__all__ = ["Design", "Limits", "Planned", "design", "excite_study_file"]

_STARTS = 3  # of the search for the motion; the best two of them become records
_RESTING = 0.3  # of a record; more, and Coulomb friction at standstill hides what is asked
_POOR = 300.0  # condition number; designs that have room reach 10


def excite_study_file(
    study_path: Path,
    parameters_path: Path | None,
    folder: Path,
    *,
    limit_angle: str,
    limit_velocity: str,
    limit_voltage: str | None,
    limit_torque: str | None,
    kind: str,
    seed: int,
    progress: Callable[[str], None],
) -> Design:
    """Design the experiments of a study file's arm and write them to a folder.

    `parameters_path`: A guess of the arm, or an earlier result. `limit_angle`, `limit_velocity`,
    `limit_voltage`, `limit_torque`: As `limits_of` reads them; the last two may be None.
    `progress`: Called with what is being done. Raises `InvalidInput`: A file, a limit or the kind
    is at fault, or the limits leave no experiment.
    """
    if parameters_path is None:
        raise InvalidInput(
            "nothing can be designed for an arm of unknown size",
            where="--parameters",
            remedy="give a guess of every parameter, from a data sheet or a drawing, or an earlier "
            "result.json; docs/parameters.md has the layout",
        )
    if kind not in ("prbs", "multisine"):
        raise InvalidInput(
            f"{kind!r} is no kind of excitation", where="--kind", remedy="use prbs or multisine"
        )
    if folder.resolve() == study_path.resolve().parent:
        raise InvalidInput(
            "would write the designed study over the one it reads",
            where=f"--out {folder}",
            remedy="choose another directory than the study's",
        )
    study = read_study(study_path, logs_exist=False, experiments_exist=False)
    values = read_parameters(parameters_path)
    limits = limits_of(study.arm, limit_angle, limit_velocity, limit_voltage, limit_torque)
    chosen: Kind = "prbs" if kind == "prbs" else "multisine"
    planned = design(study, values, limits, kind=chosen, seed=seed, progress=progress)
    write(planned, folder)
    return planned


def design(
    study: Study,
    values: Values,
    limits: Limits,
    *,
    kind: Kind = "prbs",
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Design:
    """Plan the records that identify an arm, and those that validate it.

    A motion and one to check with; of each elastic joint a PRBS or multisine, the PRBS at smaller
    amplitudes, steps, and other steps to check the elastic model with.

    `study`: Its experiments are not looked at. `values`: (name, joint) -> value of the guessed arm.
    `kind`: Of the voltages. `seed`: Of the search's starts and of a multisine's phases. Raises
    `InvalidInput`: A parameter is missing, the limits leave no experiment, or the arm asks for a
    servo that is not described. One experiment that the limits do not leave is a warning.
    """
    arm = Arm.of(study.arm)
    arm.parameter_vector(values)  # refuses what is missing
    bands = {j: band_of(arm, values, j) for j in range(1, arm.n_joints + 1)}
    warnings = _without_servo(study, bands)
    lowest = min((b.anti_resonance_hz for b in bands.values() if b), default=None)
    records: tuple[Planned, ...] = ()
    refused: list[LimitBroken] = []
    if arm.servo is not None:
        progress("searching the rigid motion")
        try:
            records = motion_records(
                arm, values, limits, anti_resonance_hz=lowest, starts=_STARTS, seed=seed
            )
        except LimitBroken as error:
            refused.append(error)
    for joint, band in bands.items():
        if band:
            progress(f"sizing the excitation of joint {joint}")
            try:
                record = voltage_record(arm, values, limits, band, joint, kind=kind, seed=seed)
            except LimitBroken as error:
                refused.append(error)
            else:
                weaker, left_out = sweep_records(arm, values, limits, band, record, seed=seed)
                records += (record, *weaker)
                warnings += tuple(
                    Diagnostic("limit-broken", f"sweep of joint {joint}", f"not planned: {why}")
                    for why in left_out
                )
        if band and arm.servo is not None:
            progress(f"sizing the steps of joint {joint}")
            try:
                records += step_records(arm, values, limits, band, joint)
            except LimitBroken as error:
                refused.append(error)
    if not records:
        raise refused[0]
    warnings += tuple(
        Diagnostic(
            "limit-broken", error.where or "", f"not planned: {error.problem}; {error.remedy}"
        )
        for error in refused
    )
    known = completed(values, arm)
    warnings += tuple(c for record in records for c in _warnings(arm, known, record))
    for joint, band in bands.items():
        of_it = [record for record in records if record.experiment.joint == joint]
        if band and of_it and of_it[0].band_hz[1] < 0.99 * band.high_hz:
            text = f"the servo's clock lets {of_it[0].band_hz[1]:.3g} Hz through at most, and "
            text += f"{band.high_hz:.3g} Hz are wanted; drive the voltages by a faster clock"
            warnings += (Diagnostic("slow-clock", of_it[0].experiment.name, text),)
    warnings += _torques_without_limit(arm, limits, records)
    experiments = tuple(record.experiment for record in records)
    progress("predicting the intervals")
    precision = predicted_precision(study, values, records, seed=seed)
    return Design(replace(study, experiments=experiments), limits, records, warnings, precision)


def _torques_without_limit(
    arm: Arm, limits: Limits, records: Sequence[Planned]
) -> tuple[Diagnostic, ...]:
    """What the gears bear where nobody said what they may."""
    found = []
    for i in range(arm.n_joints):
        if np.isfinite(limits.gear_torque[i]) or not arm.joints[i].elastic:
            continue
        worst = max(records, key=lambda record: float(record.predicted.gear_torque[i]))
        text = (
            f"the gear of joint {i + 1} bears up to {worst.predicted.gear_torque[i]:.3g} N m in "
            f"{worst.experiment.name}, and no limit was given: compare this with the peak torque "
            "in its data sheet, or give --limit-torque"
        )
        found.append(Diagnostic("no-torque-limit", f"joint {i + 1}", text))
    return tuple(found)


def _without_servo(study: Study, bands: Mapping[int, Band | None]) -> tuple[Diagnostic, ...]:
    """What can be planned without a servo: voltages on elastic joints that lie in a plane."""
    if study.arm.servo is not None:
        return ()
    elastic = any(bands.values())
    if study.arm.gravity or not elastic:
        why = (
            "under gravity a servo holds the arm"
            if elastic
            else "a rigid arm is identified from motions"
        )
        raise InvalidInput(
            f"{why}, and the study describes no servo", where=str(study.path), remedy=ADD_SERVO
        )
    text = (
        "the study describes no servo, so only voltages in open loop are planned, no motion, which "
        "the rigid step needs, and no steps, which check the elastic model: "
        f"{ADD_SERVO}; or record a slow motion of all joints as you "
        'can and add it with use = "motion"'
    )
    return (Diagnostic("no-servo", study.path.name, text),)


def _warnings(arm: Arm, known: Values, record: Planned) -> tuple[Diagnostic, ...]:
    """What to know before one record is taken."""
    name, seen = record.experiment.name, record.predicted
    found = []
    if record.condition_number and record.condition_number > _POOR:
        text = f"condition number {record.condition_number:.0f}: the motion hardly separates the "
        text += "rigid parameters; allow more voltage, velocity or angle"
        found.append(Diagnostic("poor-excitation", name, text))
    for i in range(arm.n_joints):
        joint = i + 1
        moved = record.experiment.joint in (None, joint)
        stepped = record.experiment.joint is not None and record.motor_angle is not None
        if moved and not stepped and seen.rest_share[i] > _RESTING:
            text = f"the motor of joint {joint} stands for {100.0 * seen.rest_share[i]:.0f} % of "
            text += "the record, where friction hides the rest; allow more voltage or velocity"
            found.append(Diagnostic("standing", name, text))
        law = arm.joints[i].law
        knees = law.knees(law.of_joint(known, joint))
        beyond = [knee for knee in knees if knee > seen.gear_torque[i]]
        strongest = record.experiment.use == "frequency" and record.experiment.joint == joint
        if strongest and beyond:
            text = f"the gear of joint {joint} sees {seen.gear_torque[i]:.3g} N m, and its knees "
            text += f"are at {', '.join(f'{knee:.3g}' for knee in knees)} N m: its stiffness "
            text += "beyond will not be identifiable; allow more voltage, velocity or angle"
            found.append(Diagnostic("knee-not-reached", name, text))
    return tuple(found)
