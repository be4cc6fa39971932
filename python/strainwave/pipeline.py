"""The only file that knows the order: logs, signals, rigid, decoupled, physical, tuned, report.

Each stage is one function from records to one record; this file calls them, keeps the time, and
decides what happens when one cannot answer.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from strainwave import __version__
from strainwave.domain import (
    ArmModel,
    Consistency,
    Decoupled,
    Diagnostic,
    FrequencyOptions,
    FrequencyResponse,
    Identification,
    JointModel,
    LinkSignals,
    LinkSummary,
    Log,
    MotorResponse,
    Options,
    Prediction,
    RecordModel,
    RigidModel,
    Signals,
    StateSpace,
    Study,
)
from strainwave.domain.combinations import is_uncoupled
from strainwave.domain.diagnostics import published_warnings
from strainwave.domain.progress import Progress, ProgressEvent, ignored
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import with_places
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification import amplitude_sweep as sweep
from strainwave.identification import decoupling, frequency, rigid, validation
from strainwave.identification import joint_model as physical
from strainwave.identification import whole_arm as tuning
from strainwave.identification.motor_responses import motor_response
from strainwave.io import logs
from strainwave.io.atomic_files import write_whole
from strainwave.io.logs.in_memory import Data
from strainwave.io.results import to_document, to_json
from strainwave.io.study import read_study, with_options
from strainwave.numerics.parallel import limited, one_blas_thread, side_by_side
from strainwave.presentation.matplotlib_backend import images
from strainwave.signals import consistency
from strainwave.signals import link_motion as links
from strainwave.signals import motor as signals
from strainwave.signals.activity import activity_of
from strainwave.signals.mounting_start import with_stand_ins
from strainwave.signals.recorded_input import missing_motor_signal, missing_recorded_input

STAGES = ("rigid", "decoupled", "tuned")
"""All stages, in order; a run takes a prefix of them."""

_Seen = tuple[Log, LinkSignals, tuple[Decoupled, ...]]
"""A record, both sides of its gears, and each joint on its own."""


def check_stages(names: Sequence[str]) -> tuple[str, ...]:
    """The stages to run, checked to be a prefix of all.

    Parameters
    ----------
    names : sequence of str

    Returns
    -------
    tuple of str

    Raises
    ------
    InvalidInput
        A stage that does not exist, or one whose predecessors are missing.
    """
    stages = tuple(names)
    if not stages or stages != STAGES[: len(stages)]:
        raise InvalidInput(
            f"cannot run the stages {', '.join(stages) or '(none)'}",
            where="--stages",
            remedy=f"name a beginning of this list, in its order: {', '.join(STAGES)}",
        )
    return stages


def identify(
    study: Study | Path,
    *,
    data: Data | None = None,
    stages: Sequence[str] = STAGES,
    options: Options | Mapping[str, Mapping[str, Any]] | Sequence[str] | None = None,
    progress: Progress = ignored,
    threads: int | None = None,
) -> Identification:
    """Logs to models: every stage on one study.

    Parameters
    ----------
    study : Study or Path
        Checked, or the study file.
    data : mapping, optional
        Experiment's name -> its log, a table in memory or a path, in place of the study's file.
    stages : sequence of str
        A prefix of `STAGES`.
    options : Options, mapping or sequence of str, optional
        In place of the study's [options]: all of them, those that change (stage -> key -> value),
        or "stage.key=value" as on the command line.
    progress : callable
        Gets a `ProgressEvent` at the start of each part and at each evaluation of the last fit.
    threads : int, optional
        That may work at a time; one per core without.

    Returns
    -------
    Identification
        Its `verdict` says what the data answered and what not.

    Raises
    ------
    InvalidInput
        The study, a log or an argument is at fault.
    """
    with one_blas_thread(), limited(threads):  # once for all: threads must not set it for others
        run = _Run(check_stages(stages), progress)
        with run.timed("read", "reading the logs"):
            the_study = study if isinstance(study, Study) else read_study(study)
            if options is not None:
                the_study = with_options(the_study, options)
            all_logs = logs.read_logs(the_study, data=data)
        return _identify(the_study, all_logs, run)


def _identify(the_study: Study, all_logs: Sequence[Log], run: _Run) -> Identification:
    run.arm = Arm.of(the_study.arm)
    for log in all_logs:
        run.warnings.extend(log.warnings)
    input_check = _consistency(run, the_study, all_logs)
    elastic = "decoupled" in run.stages and any(j.spring != "rigid" for j in run.arm.joints)
    excited = [log for log in all_logs if log.experiment.use in ("frequency", "sweep")]
    model: RigidModel | None = None
    fitted: tuple[Prediction, ...] = ()
    checks: tuple[Prediction, ...] = ()
    if input_check.motors_agree:  # the rigid model asks nothing of link sensors
        model, fitted, checks = _rigid(run, the_study, all_logs)
        input_check = _with_torques(the_study, input_check, model)
    elastic = elastic and not input_check.suspected
    records: tuple[RecordModel, ...] = ()
    joints: tuple[JointModel, ...] = ()
    responses: dict[int, FrequencyResponse] = {}
    if elastic:
        records, joints, responses = _decoupled(run, the_study, all_logs, model)
    tuned: ArmModel | None = None
    motors: tuple[MotorResponse, ...] = ()
    starts = joints
    if elastic and "tuned" in run.stages and not excited:
        starts = _from_catalogue(run, the_study, all_logs, model)
    if "tuned" in run.stages and len(starts) == run.arm.n_joints:
        tuned = _tuned(run, the_study, all_logs, model, starts)
    if tuned is not None:
        checks = _with_elastic(run, all_logs, tuned, checks)
        motors = _motor_responses(run, all_logs, tuned, starts)
    found = Identification(
        study=the_study,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        stages=run.stages,
        rigid=model,
        fitted=fitted,
        checks=checks,
        warnings=tuple(dict.fromkeys(run.warnings)),
        timing_s=run.timing_s,
        records=records,
        joints=joints,
        responses=responses,
        links=run.links,
        sweeps=sweep.sweeps(records),
        tuned=tuned,
        suspected=input_check.suspected,
        motor_responses=motors,
        failures=tuple(run.failures),
        activity=activity_of(all_logs, run.arm),
    )
    return replace(found, warnings=published_warnings(found))


def _consistency(run: _Run, the_study: Study, all_logs: Sequence[Log]) -> Consistency:
    """Whether the input agrees with itself."""
    with run.timed("consistency", "comparing the channels with one another"):
        return consistency.check(all_logs, the_study)


def _with_torques(
    the_study: Study, input_check: Consistency, model: RigidModel | None
) -> Consistency:
    """What the rigid fit says of the joints' torques against each other, with the rest."""
    if model is None or model.torque_ratio is None:
        return input_check
    torques = consistency.torque_constants(*model.torque_ratio, the_study)
    return Consistency((*input_check.suspected, torques)) if torques else input_check


def _rigid(
    run: _Run, the_study: Study, all_logs: Sequence[Log]
) -> tuple[RigidModel | None, tuple[Prediction, ...], tuple[Prediction, ...]]:
    """The rigid model, and its predictions of the fitted and of the check records."""
    with run.timed("rigid", "rigid joints: least squares"):
        seen = {use: _signals(run, all_logs, use) for use in ("motion", "check")}
        try:
            model = rigid.fit(seen["motion"], run.arm, the_study.options.rigid)
        except NotIdentifiable as failure:
            if _single_and_excited(run.arm, all_logs) and "decoupled" in run.stages:
                run.warnings.append(Diagnostic("no-rigid-model", str(the_study.path), str(failure)))
            else:
                run.failures.append(str(failure))
            return None, (), ()
        run.warnings.extend(model.warnings)
    if model.status == "not-identifiable":
        return model, (), ()
    with run.timed("checks", "predicting the check records"):
        predictions = {
            use: tuple(
                made
                for made in side_by_side([partial(_predicted, run, model, each) for each in chosen])
                if made is not None
            )
            for use, chosen in seen.items()
        }
    run.warnings.extend(c for made in predictions.values() for p in made for c in p.warnings)
    return model, predictions["motion"], predictions["check"]


def _predicted(run: _Run, model: RigidModel, each: Signals) -> Prediction | None:
    """A record's torques by the rigid model; None, with a warning, of one that is too short."""
    try:
        return validation.predict_rigid(model, each, run.arm)
    except NotIdentifiable as failure:
        name = each.experiment.name
        run.warnings.append(Diagnostic("nothing-to-predict", name, f"{name} {failure}"))
        return None


def _decoupled(
    run: _Run,
    the_study: Study,
    all_logs: Sequence[Log],
    model: RigidModel | None,
) -> tuple[tuple[RecordModel, ...], tuple[JointModel, ...], dict[int, FrequencyResponse]]:
    """Each excited record on its own, then all full-amplitude records of a joint at once."""
    excited = [log for log in all_logs if log.experiment.use in ("frequency", "sweep")]
    if not excited:
        text = 'no record excites the gears on purpose (use = "frequency"): where there are steps,'
        text += " the whole-arm fit starts from gears that such arms have"
        run.warnings.append(Diagnostic("no-frequency-record", str(the_study.path), text))
        return (), (), {}
    if model is None and not is_uncoupled(run.arm):
        return (), (), {}  # why there is none has been said

    with run.timed("decoupled", "decoupling the joints"):
        # where it is not known how a sensor sits, something like it stands in until the whole fit
        placed_logs, placed = with_stand_ins(excited, run.arm, all_logs)
        sides, delays = links.both_sides(placed_logs, placed, the_study.options.links)
        run.warnings.extend(links.corrected(delays))
        run.sensors = links.constants_of(sides, delays)
        if any("motor" in side.sources for side in sides):
            return (), _from_motors(run, the_study, model, sides), {}
        try:
            decoupled = side_by_side(
                [partial(decoupling.decouple, side, model, placed) for side in sides]
            )
        except NotIdentifiable as failure:
            run.failures.append(str(failure))
            return (), (), {}
        seen = list(zip(excited, sides, decoupled, strict=True))
        for log, both_sides, parts in seen:
            run.warnings.extend(both_sides.warnings)
            run.warnings.extend(w for p in _excited_joints(parts, log) for w in p.warnings)
            run.links += both_sides.summaries
        records, joints, responses = _physical(run, the_study, model, seen)
    for found in joints:
        run.warnings.extend(found.warnings)
    return tuple(records), tuple(joints), responses


def _from_motors(
    run: _Run, the_study: Study, model: RigidModel | None, sides: Sequence[LinkSignals]
) -> tuple[JointModel, ...]:
    """Models of the joints where not every link has a sensor: interaction is not measured then."""
    for side in sides:
        run.warnings.extend(side.warnings)
        run.links += side.summaries
    full = [side for side in sides if side.experiment.use == "frequency"]
    try:
        joints, *run.others = physical.models_from_motors(full or sides, model, run.arm)
    except NotIdentifiable as failure:
        run.warnings.append(Diagnostic("not-identifiable", str(the_study.path), str(failure)))
        return ()
    run.warnings.extend(w for joint in joints for w in joint.warnings)
    return joints


def _from_catalogue(
    run: _Run, the_study: Study, all_logs: Sequence[Log], model: RigidModel | None
) -> tuple[JointModel, ...]:
    """Gears to start from where no record excites them on purpose, but steps may show them."""
    if not _used_for(all_logs, "tuning"):
        return ()
    try:
        joints, *run.others = physical.models_from_catalogue(model, run.arm)
    except NotIdentifiable as failure:
        run.warnings.append(Diagnostic("not-identifiable", str(the_study.path), str(failure)))
        return ()
    return joints


def _physical(
    run: _Run,
    the_study: Study,
    model: RigidModel | None,
    seen: Sequence[_Seen],
) -> tuple[list[RecordModel], list[JointModel], dict[int, FrequencyResponse]]:
    """Models of each record and, for each joint excited at full amplitude, of all at once.

    Beside these the joint's nonparametric response, where its inputs can be separated.
    """
    options = the_study.options
    how = physical.RecordOptions(options.physical, options.statespace)
    at_full = [parts for log, _, parts in seen if log.experiment.use == "frequency"]
    together: dict[int, list[tuple[LinkSignals, Decoupled]]] = {}
    for log, both_sides, parts in seen:
        for part in _excited_joints(parts, log):
            if log.experiment.use == "frequency":
                together.setdefault(part.joint, []).append((both_sides, part))

    def all_at_once(
        joint: int,
    ) -> tuple[physical.JointFit | JointModel | Diagnostic, FrequencyResponse | None]:
        response = _response([parts[joint - 1] for parts in at_full], options.responses)
        own = together[joint]
        try:
            if options.physical.route == "equations":
                return physical.fit_joint(own, model, run.arm, options.physical), response
            return physical.joint_by_transfer([d for _, d in own], model, run.arm, how), response
        except (NotIdentifiable, np.linalg.LinAlgError) as failure:
            return Diagnostic("not-identifiable", f"joint {joint}", str(failure)), response

    numbers = sorted(together)
    found = side_by_side([partial(all_at_once, n) for n in numbers])
    run.warnings.extend(each for each, _ in found if isinstance(each, Diagnostic))
    fits = {fit.model.joint: fit for fit, _ in found if isinstance(fit, physical.JointFit)}
    joints = [fit.model for fit in fits.values()]
    joints += [each for each, _ in found if isinstance(each, JointModel)]
    responses = {n: r for n, (_, r) in zip(numbers, found, strict=True) if r is not None}
    for joint in joints if model is None else ():
        # without a rigid model dry friction is still in u, and the models have none in it
        own = [decoupling.without_friction(s, d, joint) for s, d in together[joint.joint]]
        response = _response(own, options.responses)
        responses |= {} if response is None else {joint.joint: response}
    ratios = [each.gear_ratio for each in run.arm.joints]
    joints = [physical.compared(j, ratios[j.joint - 1], responses.get(j.joint)) for j in joints]
    records = _record_models(run, the_study.options, model, seen, fits)
    return records, joints, responses


def _record_models(
    run: _Run,
    options: Options,
    model: RigidModel | None,
    seen: Sequence[_Seen],
    fits: Mapping[int, physical.JointFit],
) -> list[RecordModel]:
    """What each record says of the joints excited in it, and their responses in it.

    The state-space models of a sweep start from those at full amplitude.
    """
    how = physical.RecordOptions(options.physical, options.statespace)
    models: dict[int, StateSpace] = {}  # of a joint at full amplitude

    def one_by_one(log: Log, both_sides: LinkSignals, part: Decoupled) -> RecordModel:
        own = replace(how, judged=log.experiment.use == "frequency")
        fit, near = fits.get(part.joint), models.get(part.joint)
        found = physical.identify_record(both_sides, part, model, run.arm, own, fit, near)
        return replace(found, response=_response([part], options.responses))

    every = [(log, both, part) for log, both, ps in seen for part in _excited_joints(ps, log)]
    by_use: dict[str, Iterator[RecordModel]] = {}
    for use in ("frequency", "sweep"):
        jobs = [partial(one_by_one, *each) for each in every if each[0].experiment.use == use]
        made = side_by_side(jobs)
        models |= {r.signals.joint: r.state_space for r in reversed(made) if r.state_space}
        by_use[use] = iter(made)
    return [next(by_use[log.experiment.use]) for log, _, _ in every]


def _tuned(
    run: _Run,
    the_study: Study,
    all_logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
) -> ArmModel | None:
    """All parameters at once on all records; None, with a warning, without any."""
    what = "fitting the whole arm to all records at once"

    def count(evaluation: int, most: int) -> None:
        said = f"{what}: evaluation {evaluation} of at most {most}"
        run.report("tuned", said, evaluation / most)

    with run.timed("tuned", what):
        try:
            options = the_study.options.tuning
            start = run.sensors
            found = tuning.tune(
                all_logs,
                model,
                joints,
                run.arm,
                options,
                start=start,
                others=run.others,
                progress=count,
            )
        except NotIdentifiable as failure:
            run.warnings.append(Diagnostic("not-tuned", str(the_study.path), str(failure)))
            return None
    # what an earlier stage said of the same sensor is said again, and better
    late = {w.where for w in found.warnings if w.code == "sensor-delay"}
    run.warnings = [w for w in run.warnings if w.code != "sensor-delay" or w.where not in late]
    run.warnings.extend(found.warnings)
    return found


def _with_elastic(
    run: _Run,
    all_logs: Sequence[Log],
    tuned: ArmModel,
    checks: tuple[Prediction, ...],
) -> tuple[Prediction, ...]:
    """The check records' torques from the rigid model, and their motion from the tuned arm."""
    made = list(checks)
    with run.timed("checks", "simulating the check records"):
        identified = [
            log
            for log in _used_for(all_logs, "check")
            if missing_recorded_input(run.arm, log) is None
        ]
        placed = with_places(run.arm, tuned.values)
        found = side_by_side(
            [partial(validation.predict_elastic, tuned, log, placed) for log in identified]
        )
    run.warnings.extend(warning for each in found for warning in each.warnings)
    made.extend(found)
    return tuple(made)


def _motor_responses(
    run: _Run,
    all_logs: Sequence[Log],
    tuned: ArmModel,
    joints: Sequence[JointModel],
) -> tuple[MotorResponse, ...]:
    """How each motor answers in the records at full amplitude, of rig and fitted arm."""
    with run.timed("checks", "comparing the motors' responses"):
        seen = [
            log
            for log in _used_for(all_logs, "frequency")
            if log.experiment.joint is not None and missing_motor_signal(run.arm, log) is None
        ]
        made = [partial(motor_response, log, tuned, joints, run.arm) for log in seen]
        return tuple(side_by_side(made))


def _used_for(all_logs: Sequence[Log], use: str) -> list[Log]:
    return [log for log in all_logs if log.experiment.use == use]


def _response(records: Sequence[Decoupled], options: FrequencyOptions) -> FrequencyResponse | None:
    """The nonparametric response beside the models; None where the inputs cannot be separated."""
    try:
        return frequency.respond(records, options)
    except (NotIdentifiable, InvalidInput):  # records of several sample times do not combine
        return None


def _excited_joints(parts: Sequence[Decoupled], log: Log) -> list[Decoupled]:
    """The joint that an experiment names, or all."""
    return [part for part in parts if log.experiment.joint in (None, part.joint)]


def _single_and_excited(arm: Arm, all_logs: Sequence[Log]) -> bool:
    """Whether a joint can be identified without a rigid model."""
    return is_uncoupled(arm) and any(log.experiment.use == "frequency" for log in all_logs)


def write(
    identification: Identification,
    folder: Path,
    *,
    figures: bool = False,
    progress: Progress = ignored,
) -> None:
    """Result and report, and if wanted every figure as SVG and PNG: all whole or none.

    Parameters
    ----------
    identification : Identification
    folder : Path
        Made where it does not exist; an earlier result in it is replaced.
    figures : bool
        Whether the report's figures go to `figures/` in the folder, too.
    progress : callable
        Gets a `ProgressEvent`.

    Raises
    ------
    InvalidInput
        The folder cannot be written to, or there is no Matplotlib to draw the figures.
    """
    from strainwave.presentation.report import figures_of, render

    parts = len(_planned(identification.stages))
    progress(ProgressEvent("report", (parts - 1) / parts, "writing the report", parts, parts))
    begin = time.perf_counter()
    page = render(identification).encode()
    timing = {**identification.timing_s, "report": time.perf_counter() - begin}
    document = to_json(to_document(replace(identification, timing_s=timing)))
    files = {"report.html": page, "result.json": document}
    if figures:
        for name, drawn in figures_of(identification).items():
            for ending, data in images(drawn).items():
                files[f"figures/{name}.{ending}"] = data
    write_whole(folder, files)


@dataclass
class _Run:
    """What accumulates while the stages run."""

    stages: tuple[str, ...]
    progress: Progress
    arm: Arm = field(init=False)  # as soon as the study is read
    parts: list[str] = field(default_factory=list)  # that have begun, or been passed over
    warnings: list[Diagnostic] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    sensors: dict[tuple[str, int | None], float] = field(default_factory=dict)  # delays found
    links: tuple[LinkSummary, ...] = ()
    others: list[tuple[JointModel, ...]] = field(default_factory=list)  # more starts of the fit
    timing_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, part: str, said: str) -> Iterator[None]:
        self.report(part, said)
        begin = time.perf_counter()
        yield
        self.timing_s[part] = self.timing_s.get(part, 0.0) + time.perf_counter() - begin

    def report(self, part: str, said: str, within: float = 0.0) -> None:
        """Say what is being done, and how far that is: parts that cannot run are passed over."""
        planned = _planned(self.stages)
        begun = len(self.parts)
        if part in planned[begun:]:
            self.parts = planned[: planned.index(part, begun) + 1]
        number, parts = len(self.parts), len(planned)
        fraction = (number - 1 + min(within, 1.0)) / parts
        self.progress(ProgressEvent(part, fraction, said, number, parts))


def _planned(stages: Sequence[str]) -> list[str]:
    """The timed parts of a run, in order."""
    planned = ["read", "consistency", "rigid", "checks"]
    if "decoupled" in stages:
        planned.append("decoupled")
    if "tuned" in stages:
        planned += ["tuned", "checks"]
    return [*planned, "report"]


def _signals(run: _Run, all_logs: Sequence[Log], use: str) -> list[Signals]:
    """Motor-side signals of the records of one use, which have them."""
    chosen = _used_for(all_logs, use)
    found = side_by_side([partial(signals.motor_side, log, run.arm) for log in chosen])
    run.warnings.extend(warning for each in found for warning in each.warnings)
    return found
