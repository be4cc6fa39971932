"""Records, RigidModel, JointModels -> ArmModel: fit every parameter of the arm at once.

Nonlinear least squares on simulations of the whole arm with exact sensitivities, started from the
results of the earlier stages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

from strainwave.domain import ArmModel, JointModel, Log, RigidModel, WholeArmOptions
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET
from strainwave.domain.keys import Key
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.conclusion import arm_model, has_likelier_effect
from strainwave.identification.whole_arm.inference.predicted_precision import predicted_parameters
from strainwave.identification.whole_arm.inference.score_tests import score_tests_of
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    set_record_effects,
    with_effects,
)
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.search import (
    Fit,
    Progress,
    are_exceptions,
    coarse_search,
    find_undescribed,
    fine_search,
    polish,
    published_search,
    refine,
    report_progress,
)
from strainwave.identification.whole_arm.selection import (
    candidate,
    causes,
    gear_laws,
    mountings,
    sensor_constants,
)
from strainwave.identification.whole_arm.selection.candidate import Selection
from strainwave.identification.whole_arm.selection.causes import ModelComparison, include_effects
from strainwave.identification.whole_arm.start import Start, prepare_start
from strainwave.numerics.parallel import one_blas_thread

__all__ = [
    "Fit",
    "WholeArmOptions",
    "fit_records",
    "fit_whole_arm",
    "has_likelier_effect",
    "predicted_parameters",
]

_COARSE: tuple[Callable[[Fit, Selection], Fit], ...] = (
    candidate.extend_coarse_ranges,
    candidate.add_significant_initial_motion,
    mountings.improve_mountings,
    gear_laws.select_gear_laws,
    gear_laws.restart_coarse_fit,
    sensor_constants.add_coarse_sensor_constants,
    sensor_constants.add_coarse_bandwidths,
    candidate.add_settling_times,
    causes.add_named_effects,
)
"""Candidates of a coarse fit, in the order of their trials. They only add parameters."""

_FINE: tuple[Callable[[Fit, Selection], Fit], ...] = (
    candidate.extend_ranges,
    gear_laws.restart_fine_fit,
    gear_laws.remove_insignificant_stiffness_terms,
    causes.remove_insignificant_effects,
    sensor_constants.add_fine_sensor_constants,
    sensor_constants.add_fine_bandwidths,
    mountings.add_mount_resonances,
    mountings.add_significant_tilts,
    sensor_constants.remove_insignificant_sensor_constants,
    candidate.remove_insignificant_settling_times,
    gear_laws.straighten_curves,
)
"""Candidates of the fine fit, which also remove parameters that are not significant."""


def fit_whole_arm(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    arm: Arm,
    options: WholeArmOptions | None = None,
    *,
    start: Mapping[Key, float] | None = None,
    others: Sequence[Sequence[JointModel]] = (),
    progress: Progress | None = None,
) -> ArmModel:
    """Fit every parameter of the arm to all `frequency`, `sweep` and `tuning` records.

    The recorded voltages drive the simulated arm. Residuals of motor velocities and link
    accelerations pass one low-pass and are weighted by robust standard deviations estimated from
    the records. The rigid model adds rows of its own, because motion records have most information
    on friction and gravity. Sensor constants, and the initial state of a record that starts in
    motion, are unknowns of that record.

    Effects that the study names are added once the fit without them is near its minimum; those that
    are not significant are removed with a warning.

    `model` may be None for a single joint without gravity. `joints` has one model per joint to
    start from, `others` further sets of start models. `start` overrides start values by (name,
    joint); delays and scales of link sensors in it are fitted from the beginning. `progress` is
    called with the number of each evaluation and the maximum number.

    A parameter that the data hardly determine has the value None in `parameters` of the result,
    with a warning; `values` has all of them. A parameter at the limit of its range sets the status
    "at-bounds". Raises `NotIdentifiable` without a usable record or start, and `InvalidInput` if a
    record lacks what its simulation needs.
    """
    chosen = _expand_published_options(options or WholeArmOptions())
    with one_blas_thread(), report_progress(progress):  # thousands of small factorisations
        prepared = prepare_start(logs, model, (joints, *others), arm, chosen, start)
        selection = Selection(arm, chosen)
        fit = _fit(prepared, selection)
        if chosen.as_published:
            comparison = ModelComparison(score_tests_of(fit, selection.arm))
        else:
            fit, comparison = include_effects(fit, selection)
        return arm_model(fit, comparison, prepared, selection)


def fit_records(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    arm: Arm,
    options: WholeArmOptions | None = None,
    *,
    start: Mapping[Key, float] | None = None,
) -> Fit:
    """Fit as `fit_whole_arm` does, and return the fit itself with its residuals."""
    chosen = _expand_published_options(options or WholeArmOptions())
    with one_blas_thread():
        prepared = prepare_start(logs, model, (joints,), arm, chosen, start)
        return _fit(prepared, Selection(arm, chosen))


def _expand_published_options(options: WholeArmOptions) -> WholeArmOptions:
    """Expand the option `as_published` into the options that it implies."""
    if not options.as_published:
        return options
    return replace(
        options,
        closed_loop=True,
        settling=bool(options.settling),
        hold=tuple(dict.fromkeys((*options.hold, COULOMB, OFFSET))),
    )


def _fit(start: Start, selection: Selection) -> Fit:
    """Fit all records; again from the fit of the others if single records are not described."""
    if selection.options.as_published:
        budget = selection.options.max_iterations
        return published_search(start.coarse, start.records, selection.arm, budget)
    stated_arm = selection.arm  # the search sets the gear laws that it selects
    fit = _search(start, selection)
    undescribed = find_undescribed(fit)
    if not fit.end.is_minimum or not are_exceptions(undescribed, fit):
        return fit
    others = [k for k in range(len(start.records)) if k not in undescribed]
    # from this fit first, which takes a third of the time of another one
    with suppress(NotIdentifiable):
        near = fit.restart(fit.objective.select_records(*others), fit.z)
        near = polish(refine(near, selection.options), selection.options)
        again = _rejoin(near, fit.objective, selection.options)
        if not find_undescribed(again):
            return again
    of_others = replace(
        start,
        records=tuple(start.records[k] for k in others),
        coarse=replace(start.coarse, objective=start.coarse.objective.select_records(*others)),
    )
    other_selection = Selection(
        stated_arm, replace(selection.options, max_iterations=selection.budget)
    )
    try:
        without = _search(of_others, other_selection)
    except NotIdentifiable:
        return fit
    objective = with_effects(fit.objective, without.space, other_selection.arm)
    again = _rejoin(without, objective, selection.options)
    if find_undescribed(again):
        return fit
    selection.arm, selection.law_choices = other_selection.arm, other_selection.law_choices
    return again


def _rejoin(without: Fit, objective: Objective, options: WholeArmOptions) -> Fit:
    """Fit of all records of the objective from that of some of them."""
    without.objective.forget()
    rejoined = without.restart(objective.update_weights(without.z), without.z)
    return polish(refine(rejoined, options), options)


def _search(start: Start, selection: Selection) -> Fit:
    """Fit in long steps to near the minimum, then in short steps, with the selected model."""
    coarse = coarse_search(start.coarse, selection.options)
    for add in _COARSE:
        coarse = add(coarse, selection)
    records = [
        replace(record, begins_in_motion=long_steps.begins_in_motion)
        for record, long_steps in zip(start.records, coarse.objective.records, strict=True)
    ]
    with_found = set_record_effects(records, selection.arm, coarse.space.keys)
    objective = coarse.objective.replace_records(with_found).update_weights(coarse.z)
    objective.free_ended(start.coarse.objective, coarse.objective)
    fine = fine_search(
        replace(coarse, objective=objective),
        selection.options,
        partial(sensor_constants.with_evident_constants, selection=selection),
    )
    if fine.end.is_minimum:  # the model selection has its own budget of evaluations
        selection.renew(fine)
    for revise in _FINE:
        fine = revise(fine, selection)
    return polish(fine, selection.options)
