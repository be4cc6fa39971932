"""Result of the whole-arm fit: parameters, covariance, residual analysis, effects and warnings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import (
    WHOLE_ARM_FIT,
    ArmModel,
    Cause,
    Clause,
    Criticism,
    Diagnostic,
    FloatArray,
    Parameter,
    ParameterShift,
    Place,
    Prediction,
    SearchEnd,
    TorqueHistogram,
)
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.arm.gear_laws import gear_law
from strainwave.domain.arm.link_sensors import is_hidden
from strainwave.domain.arm.parameter_table import SETTLING, base_name
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.closed_loop import predict_closed_loop
from strainwave.identification.whole_arm.inference.fit_tests import (
    agreement_tests,
    disagreement,
    residual_tests,
    residual_warnings,
    stage_differences,
)
from strainwave.identification.whole_arm.inference.parameter_estimates import (
    parameters_at_bounds,
    parameters_of,
    warnings_of,
)
from strainwave.identification.whole_arm.inference.predicted_precision import sensor_gains
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    effects_among,
    warn_removed_effects,
)
from strainwave.identification.whole_arm.problem.starting_values import (
    gear_torque_samples,
    gear_torques,
    largest_of,
)
from strainwave.identification.whole_arm.search import Fit
from strainwave.identification.whole_arm.selection.candidate import Selection
from strainwave.identification.whole_arm.selection.causes import ModelComparison
from strainwave.identification.whole_arm.selection.gear_laws import equivalent_stiffnesses
from strainwave.identification.whole_arm.selection.sensor_constants import sensor_warnings
from strainwave.identification.whole_arm.start import Start
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.recorded_input import missing_recorded_input

HISTOGRAM_BINS = 60
MIN_LISTED_WEIGHT = 0.05  # of a plausible effect
MAX_NAMED_PARAMETERS = 3  # in a warning, of the effect and of the arm


def arm_model(
    fit: Fit, comparison: ModelComparison, start: Start, selection: Selection
) -> ArmModel:
    """Build the result of a whole-arm fit.

    `comparison` has the models that were compared with the fit, `start` the starting values,
    `selection` the arm of the study and the options.
    """
    arm = selection.arm
    instant_settling = {(SETTLING, number): 0.0 for number in range(1, arm.n_joints + 1)}
    values = instant_settling | fit.values
    gear_loads = gear_torque_samples(fit.objective.records, values)
    largest_torque = largest_of(gear_loads).tolist()
    (agreement, excess), differences = agreement_tests(fit), stage_differences(fit, arm)
    parameters, covariance = parameters_of(fit, arm, largest_torque, comparison.plausible, excess)
    keys_at_bounds = tuple(parameters_at_bounds(fit, arm))
    criticism = Criticism(
        residual_tests(fit.objective, fit.z),
        tuple(list_causes(comparison, parameters)),
    )
    public = [k for k, p in enumerate(parameters) if not is_hidden(p.key)]
    return ArmModel(
        parameters=tuple(parameters[k] for k in public),
        values=values,
        covariance=covariance[np.ix_(public, public)],
        fit_percent=fit.objective.fit_percentages(fit.z),
        initial_fit_percent=start.coarse.objective.fit_percentages(start.initial),
        simulated=_predict(values, start, arm),
        initial=_predict(start.coarse.space.values(start.initial), start, arm),
        iterations=fit.iterations,
        end=SearchEnd.BOUND if fit.end.is_minimum and any(fit.at_bounds) else fit.end,
        warnings=(
            *start.rejected,
            *warnings_of(fit, parameters),
            *disagreement(differences, agreement),
            *warn_removed_effects(fit.space, arm),
            *effect_warnings(criticism.causes, comparison),
            *sensor_warnings(parameters),
            *residual_warnings(criticism.residuals, explained=bool(criticism.causes)),
            *equivalent_stiffnesses(comparison.tests, fit, selection, largest_torque),
        ),
        criticism=criticism,
        gear_loads=histograms_of(gear_loads),
        at_bounds=keys_at_bounds,
        agreement=agreement,
        sensor_gains=tuple(sensor_gains(fit, arm, parameters)) if fit.end.is_minimum else (),
        gear_laws=tuple(
            replace(choice, largest_torque=largest_torque[joint - 1])
            for joint, choice in selection.law_choices.items()
        ),
    )


def histograms_of(gear_loads: Sequence[FloatArray]) -> tuple[TorqueHistogram, ...]:
    """Share of samples by torque of each gear, over all records."""
    together = np.concatenate(gear_loads)
    histograms = []
    for joint, torque in enumerate(together.T, start=1):
        count, edges = np.histogram(torque, bins=HISTOGRAM_BINS, range=(0.0, float(torque.max())))
        histograms.append(TorqueHistogram(joint, edges, count / len(torque)))
    return tuple(histograms)


def has_likelier_effect(model: ArmModel, arm: Arm) -> bool:
    """Whether the fit includes an effect that is not a wrong torque constant.

    `model` is the whole-arm model of a study whose rigid step suspects a torque constant.
    """
    fitted = [name for _, name in effects_among([p.key for p in model.parameters], arm.n_joints)]
    return model.end.is_minimum and bool(fitted) and "drive-gain" not in fitted


def _predict(values: Values, start: Start, arm: Arm) -> tuple[Prediction, ...]:
    """Predictions of the fitted records of servoed steps, by simulation with the servo."""
    logs = [
        log
        for log in start.logs
        if log.experiment.use == "tuning" and missing_recorded_input(arm, log) is None
    ]
    return tuple(run_parallel([partial(predict_closed_loop, values, log, arm) for log in logs]))


def list_causes(comparison: ModelComparison, parameters: Sequence[Parameter]) -> Iterator[Cause]:
    """The included effects with their `parameters` of the result, then the plausible ones."""
    for rival in comparison.included:
        yield replace(_with_parameters(rival.cause, parameters), is_included=True)
    for rival in comparison.rivals:
        if rival.cause.weight > MIN_LISTED_WEIGHT:
            largest = gear_torques(rival.fit.objective.records, rival.fit.values).tolist()
            estimates = parameters_of(rival.fit, rival.arm, largest)[0]
            yield _with_parameters(rival.cause, estimates)


def _with_parameters(cause: Cause, parameters: Sequence[Parameter]) -> Cause:
    effect = effect_named(cause.effect)
    names = gear_law(effect.fitted_law).names if effect.fitted_law else effect.names
    own = (p for p in parameters if p.joint == cause.joint and base_name(p.name) in names)
    return replace(cause, parameters=tuple(own))


def effect_warnings(causes: Sequence[Cause], comparison: ModelComparison) -> Iterator[Diagnostic]:
    """Warn about included effects, the most likely plausible one, and those without a fit."""
    for cause in causes:
        if cause.is_included:
            effect = effect_named(cause.effect)
            yield Diagnostic(
                "effect-taken-up",
                Place(joint=cause.joint),
                effect=effect.name,
                description=effect.description,
                consequence=effect.consequence,
                sizes=tuple(_sizes(cause.parameters)),
                changes=_changes(cause.shifts),
                experiment=effect.experiment,
            )
    yield from warn_likely_cause([cause for cause in causes if not cause.is_included])
    if comparison.excluded:
        effects = tuple(Clause("of-joint", name=e, joint=j) for j, e in comparison.excluded)
        evaluations = comparison.evaluations
        yield Diagnostic(
            "causes-not-fitted", WHOLE_ARM_FIT, effects=effects, evaluations=evaluations
        )


def warn_likely_cause(causes: Sequence[Cause]) -> Iterator[Diagnostic]:
    """Warn about the most likely effect that is not included, with its rivals."""
    for cause in causes[:1]:
        effect = effect_named(cause.effect)
        rivals = tuple(Clause("of-joint", name=c.effect, joint=c.joint) for c in causes[1:])
        clause = Clause(
            "effect-likely",
            effect=cause.effect,
            setting=effect.setting,
            share=cause.share,
            sizes=tuple(_sizes(cause.parameters)),
            changes=_changes(cause.shifts) if cause.shifts else None,
            rivals=Clause("rivals", effects=rivals) if rivals else None,
            experiment=effect.experiment,
        )
        yield Diagnostic.of(effect.warning_code, Place(joint=cause.joint), clause)


def _sizes(parameters: Sequence[Parameter]) -> Iterator[Clause]:
    estimates = [p for p in parameters if p.value is not None and p.std is not None]
    for p in estimates[:MAX_NAMED_PARAMETERS]:
        template = "effect-size" if p.unit else "effect-size/no-unit"
        yield Clause(template, name=p.name, value=p.value, std=p.std, unit=p.unit)


def _changes(shifts: Sequence[ParameterShift]) -> Clause:
    """The parameters that an effect changes most."""
    listed = tuple(
        Clause(
            "shift",
            parameter=Place(joint=shift.joint, parameter=shift.name),
            change=shift.shift / shift.without,
        )
        for shift in shifts[:MAX_NAMED_PARAMETERS]
        if shift.without
    )
    return Clause("changes", shifts=listed)
