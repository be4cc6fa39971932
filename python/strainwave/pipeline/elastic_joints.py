"""Records that excite the gears -> a model of each joint by itself, and of each record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from strainwave.domain import (
    Decoupled,
    Diagnostic,
    FrequencyOptions,
    FrequencyResponse,
    JointModel,
    LinkSignals,
    Log,
    Options,
    RecordModel,
    RigidModel,
    StateSpace,
    Study,
)
from strainwave.domain.combinations import is_uncoupled
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification import decoupling, frequency
from strainwave.identification import joint_model as physical
from strainwave.numerics.parallel import side_by_side
from strainwave.pipeline.run import Run
from strainwave.signals import link_motion as links
from strainwave.signals.mounting_start import with_stand_ins

_Seen = tuple[Log, LinkSignals, tuple[Decoupled, ...]]
"""A record, both sides of its gears, and each joint on its own."""


@dataclass(frozen=True, slots=True)
class JointStage:
    """The joints by themselves; each member is empty where the records cannot answer."""

    joints: tuple[JointModel, ...] = ()  # one per joint, of all its records
    responses: Mapping[int, FrequencyResponse] = field(default_factory=dict)  # by joint, from 1
    # models of each excited record and joint: nothing rests on them, so they are made when asked
    record_models: Callable[[], tuple[RecordModel, ...]] = tuple


def decoupled(
    run: Run,
    the_study: Study,
    all_logs: Sequence[Log],
    model: RigidModel | None,
) -> JointStage:
    """Decouple the joints in each excited record and fit each joint to its full-amplitude records.

    Warnings, failures, delays of sensors and further starts are added to the run.
    """
    excited = [log for log in all_logs if log.experiment.use in ("frequency", "sweep")]
    if not excited:
        text = 'no record excites the gears on purpose (use = "frequency"): where there are steps,'
        text += " the whole-arm fit starts from gears that such arms have"
        run.warnings.append(Diagnostic("no-frequency-record", str(the_study.path), text))
        return JointStage()
    if model is None and not is_uncoupled(run.arm):
        return JointStage()  # why there is none has been said

    with run.timed("decoupled", "decoupling the joints"):
        # where it is not known how a sensor sits, something like it stands in until the whole fit
        placed_logs, placed = with_stand_ins(excited, run.arm, all_logs)
        sides, delays = links.both_sides(placed_logs, placed, the_study.options.links)
        run.warnings.extend(links.corrected(delays))
        run.sensors = links.constants_of(sides, delays)
        if any("motor" in side.sources for side in sides):
            return JointStage(_from_motors(run, the_study, model, sides))
        try:
            alone = side_by_side(
                [partial(decoupling.decouple, side, model, placed) for side in sides]
            )
        except NotIdentifiable as failure:
            run.failures.append(str(failure))
            return JointStage()
        seen = list(zip(excited, sides, alone, strict=True))
        for log, both_sides, parts in seen:
            run.warnings.extend(both_sides.warnings)
            run.warnings.extend(w for p in _excited_joints(parts, log) for w in p.warnings)
            run.links += both_sides.summaries
        stage = _physical(run, the_study, model, seen)
    for found in stage.joints:
        run.warnings.extend(found.warnings)
    return stage


def from_catalogue(
    run: Run, the_study: Study, all_logs: Sequence[Log], model: RigidModel | None
) -> tuple[JointModel, ...]:
    """Gears to start from where no record excites them on purpose, but steps may show them.

    `run`: Warnings and further starts are added to it.

    Returns: None, where there is no such record or the rigid model does not suffice.
    """
    if not any(log.experiment.use == "tuning" for log in all_logs):
        return ()
    try:
        joints, *run.others = physical.models_from_catalogue(model, run.arm)
    except NotIdentifiable as failure:
        run.warnings.append(Diagnostic("not-identifiable", str(the_study.path), str(failure)))
        return ()
    return joints


def _from_motors(
    run: Run, the_study: Study, model: RigidModel | None, sides: Sequence[LinkSignals]
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


def _physical(
    run: Run,
    the_study: Study,
    model: RigidModel | None,
    seen: Sequence[_Seen],
) -> JointStage:
    """Fit each joint excited at full amplitude to all its records at once.

    Its nonparametric response is estimated too, where its inputs can be separated.
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
    record_models = partial(_record_models, run.arm, the_study.options, model, seen, fits)
    return JointStage(tuple(joints), responses, record_models)


def _record_models(
    arm: Arm,
    options: Options,
    model: RigidModel | None,
    seen: Sequence[_Seen],
    fits: Mapping[int, physical.JointFit],
) -> tuple[RecordModel, ...]:
    """Models of each record alone, of the joints excited in it, with their responses in it.

    The state-space model of a sweep starts from that of a record at full amplitude.
    """
    how = physical.RecordOptions(options.physical, options.statespace)
    starts: dict[int, StateSpace] = {}  # by joint

    def fit_of(log: Log, both_sides: LinkSignals, part: Decoupled) -> physical.RecordFit:
        own = replace(how, judged=log.experiment.use == "frequency")
        together, near = fits.get(part.joint), starts.get(part.joint)
        fit = physical.fit_record(both_sides, part, model, arm, own, together, near)
        record = replace(fit.record, response=_response([part], options.responses))
        return replace(fit, record=record)

    every = [(log, both, part) for log, both, ps in seen for part in _excited_joints(ps, log)]
    by_use: dict[str, Iterator[RecordModel]] = {}
    for use in ("frequency", "sweep"):
        jobs = [partial(fit_of, *each) for each in every if each[0].experiment.use == use]
        made = side_by_side(jobs)
        for fit in made if use == "frequency" else ():
            if fit.linear is not None:
                joint = fit.record.signals.joint
                starts.setdefault(joint, fit.linear.of_physical_order())
        by_use[use] = iter([fit.record for fit in made])
    return tuple(next(by_use[log.experiment.use]) for log, _, _ in every)


def _response(records: Sequence[Decoupled], options: FrequencyOptions) -> FrequencyResponse | None:
    """The nonparametric response beside the models; None where the inputs cannot be separated."""
    try:
        return frequency.respond(records, options)
    except (NotIdentifiable, InvalidInput):  # records of several sample times do not combine
        return None


def _excited_joints(parts: Sequence[Decoupled], log: Log) -> list[Decoupled]:
    """The joint that an experiment names, or all."""
    return [part for part in parts if log.experiment.joint in (None, part.joint)]
