"""Logs of position servos -> arm and servos as the rigid step, and predictions of all records."""

from __future__ import annotations

from dataclasses import replace

from strainwave.domain import Clause
from strainwave.domain.results.stage_results import StageResults
from strainwave.errors import NotIdentifiable
from strainwave.identification import position_servo
from strainwave.identification.position_servo import conclusion
from strainwave.pipeline.inputs import Inputs, Reporter


def fit_servos(inputs: Inputs, results: StageResults, reporter: Reporter) -> StageResults:
    """Add the model of arm and servos, and its predictions of fitted and check records."""
    with reporter.time_part("rigid", "position servos: simulation of the closed loops"):
        try:
            fit = position_servo.fit_position_servos(inputs.logs_of("motion"), inputs.arm)
        except NotIdentifiable as failure:
            return results.fail(Clause("text", text=str(failure)))
        model = conclusion.rigid_model(fit)
        results = replace(results, rigid=model, activity=conclusion.activities(fit))
        results = results.warn(model.warnings)
    with reporter.time_part("checks", "predicting the check records"):
        checks = tuple(conclusion.predict_check(fit, log) for log in inputs.logs_of("check"))
        return replace(results, fitted=conclusion.predict(fit), checks=checks)
