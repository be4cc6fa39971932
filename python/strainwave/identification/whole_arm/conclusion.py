"""Result of the whole-arm fit: parameters, covariance, warnings and residual analysis."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import ArmModel, Criticism, Prediction, SearchEnd
from strainwave.domain.keys import Values
from strainwave.domain.link_sensors import is_hidden
from strainwave.domain.parameter_table import SETTLING
from strainwave.dynamics.arm import Arm
from strainwave.identification.closed_loop import predict_closed_loop
from strainwave.identification.whole_arm.inference.agreement import (
    agreement_tests,
    disagreement,
    stage_differences,
)
from strainwave.identification.whole_arm.inference.bounds import at_bounds, parameters_at_bounds
from strainwave.identification.whole_arm.inference.parameter_estimates import parameters_of
from strainwave.identification.whole_arm.inference.parameter_warnings import warnings_of
from strainwave.identification.whole_arm.inference.residual_analysis import (
    residual_tests,
    residual_warnings,
)
from strainwave.identification.whole_arm.inference.sensor_gains import sensor_gains
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    effects_among,
    warn_removed_effects,
)
from strainwave.identification.whole_arm.records.loads import (
    gear_torque_samples,
    histograms_of,
    largest_of,
)
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.selection.candidate import Selection
from strainwave.identification.whole_arm.selection.causes import (
    ModelComparison,
    effect_warnings,
    list_causes,
)
from strainwave.identification.whole_arm.selection.gear_laws import equivalent_stiffnesses
from strainwave.identification.whole_arm.selection.sensor_constants import sensor_warnings
from strainwave.identification.whole_arm.start import Start
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.recorded_input import missing_recorded_input


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
        end=SearchEnd.BOUND if fit.end.is_minimum and any(at_bounds(fit)) else fit.end,
        warnings=(
            *start.rejected,
            *warnings_of(fit, at_bounds(fit), parameters),
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
