"""Records that excite the gears -> a model of each joint by itself, and of each record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
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
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification import decoupling, frequency
from strainwave.identification import joint_model as physical
from strainwave.numerics.parallel import side_by_side
from strainwave.pipeline.run import Run
from strainwave.signals import link_motion as links
from strainwave.signals.mounting_start import with_stand_ins

_Seen = tuple[Log, LinkSignals, tuple[Decoupled, ...]]
"""A record, both sides of its gears, and each joint on its own."""


def decoupled(
    run: Run,
    the_study: Study,
    all_logs: Sequence[Log],
    model: RigidModel | None,
) -> tuple[tuple[RecordModel, ...], tuple[JointModel, ...], dict[int, FrequencyResponse]]:
    """Each excited record on its own, then all full-amplitude records of a joint at once.

    Parameters
    ----------
    run : Run
        Warnings, failures, delays of sensors and further starts are added to it.
    the_study : Study
    all_logs : sequence of Log
    model : RigidModel, optional

    Returns
    -------
    tuple
        A model per excited record and joint; a model per joint, of all its records; and by joint,
        from 1, its nonparametric response. Each is empty where the records cannot answer.
    """
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
            alone = side_by_side(
                [partial(decoupling.decouple, side, model, placed) for side in sides]
            )
        except NotIdentifiable as failure:
            run.failures.append(str(failure))
            return (), (), {}
        seen = list(zip(excited, sides, alone, strict=True))
        for log, both_sides, parts in seen:
            run.warnings.extend(both_sides.warnings)
            run.warnings.extend(w for p in _excited_joints(parts, log) for w in p.warnings)
            run.links += both_sides.summaries
        records, joints, responses = _physical(run, the_study, model, seen)
    for found in joints:
        run.warnings.extend(found.warnings)
    return tuple(records), tuple(joints), responses


def from_catalogue(
    run: Run, the_study: Study, all_logs: Sequence[Log], model: RigidModel | None
) -> tuple[JointModel, ...]:
    """Gears to start from where no record excites them on purpose, but steps may show them.

    Parameters
    ----------
    run : Run
        Warnings and further starts are added to it.
    the_study : Study
    all_logs : sequence of Log
    model : RigidModel, optional

    Returns
    -------
    tuple of JointModel
        None, where there is no such record or the rigid model does not suffice.
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
    run: Run,
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


def _response(records: Sequence[Decoupled], options: FrequencyOptions) -> FrequencyResponse | None:
    """The nonparametric response beside the models; None where the inputs cannot be separated."""
    try:
        return frequency.respond(records, options)
    except (NotIdentifiable, InvalidInput):  # records of several sample times do not combine
        return None


def _excited_joints(parts: Sequence[Decoupled], log: Log) -> list[Decoupled]:
    """The joint that an experiment names, or all."""
    return [part for part in parts if log.experiment.joint in (None, part.joint)]
