"""All records that excite the gears, RigidModel, JointModels -> ArmModel: every parameter at once.

Nonlinear least squares on simulations of the whole arm with exact sensitivities, started from what
the earlier stages found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from strainwave.domain import ArmModel, JointModel, Log, RigidModel, TuningOptions
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.conclusion import arm_model
from strainwave.identification.whole_arm.effects import records_with
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.model_selection import COARSE, FINE, selected
from strainwave.identification.whole_arm.parametrisation import Key
from strainwave.identification.whole_arm.predicted import predicted_parameters
from strainwave.identification.whole_arm.restricted import as_published
from strainwave.identification.whole_arm.second_opinion import blames_another
from strainwave.identification.whole_arm.selection import Selection
from strainwave.identification.whole_arm.solver import (
    Progress,
    coarse_search,
    fine_search,
    polished,
    reported,
)
from strainwave.identification.whole_arm.start import Start, start_of
from strainwave.numerics.parallel import one_blas_thread

__all__ = ["Fit", "TuningOptions", "blames_another", "fitted", "predicted_parameters", "tune"]


def tune(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    arm: Arm,
    options: TuningOptions | None = None,
    *,
    start: Mapping[Key, float] | None = None,
    others: Sequence[Sequence[JointModel]] = (),
    progress: Progress | None = None,
) -> ArmModel:
    """Every parameter of the arm from all `frequency`, `sweep` and `tuning` records at once.

    The recorded voltages drive the simulated arm. Differences of motor velocities and link
    accelerations, through one low-pass, count in robust deviations that the records show.
    The rigid model joins as rows of its own: motion has most information on friction and gravity.
    Sensors' constants, and how a record began that begins in motion, are unknowns of that record.

    The effects that the study names are left out at first, then fitted with the rest; those stay
    that the records show, and a warning names the others.

    `logs`: Those of other uses are left out.
    `model`: None will do for a single joint without gravity.
    `joints`: One per joint, to start from.
    `start`: (name, joint) -> value, in place of those of the stages before; delays and scales of
        link sensors among them are fitted from the beginning.
    `others`: More sets of joints to start from: the records decide.
    `progress`: Called with the number of each evaluation, and the most there may be.

    Returns: `values` has every parameter; in `parameters` what the data hardly identify has the
    value None, and a warning says why. A parameter at the end of its range gives status
    "at-bounds".

    Raises `NotIdentifiable`: there is no record to fit, or a start is missing or impossible;
    `InvalidInput`: A record lacks something that going through it again needs.
    """
    chosen = as_published(options or TuningOptions())
    with one_blas_thread(), reported(progress):  # thousands of small factorisations
        begin = start_of(logs, model, (joints, *others), arm, chosen, start)
        selection = Selection(arm, chosen)
        return arm_model(_fit(begin, selection), begin, selection)


def fitted(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    arm: Arm,
    options: TuningOptions | None = None,
    *,
    start: Mapping[Key, float] | None = None,
) -> Fit:
    """The fit behind `tune`, for those who want its rows; arguments and errors are the same."""
    chosen = as_published(options or TuningOptions())
    with one_blas_thread():
        begin = start_of(logs, model, (joints,), arm, chosen, start)
        return _fit(begin, Selection(arm, chosen))


def _fit(start: Start, selection: Selection) -> Fit:
    """In long steps to near the minimum, and from there in short ones, of the model selected."""
    coarse = coarse_search(start.coarse, start.start, selection.options)
    coarse = selected(coarse, COARSE, selection)
    pairs = zip(start.records, coarse.objective.records, strict=True)
    records = [replace(record, moving=found.moving) for record, found in pairs]
    with_effects = records_with(records, selection.arm, coarse.objective.space.keys)
    objective = coarse.objective.seen_by(with_effects).reweighted(coarse.z)
    fine = fine_search(objective, coarse.z, coarse.iterations, selection.options)
    if fine.converged:  # what comes beside has evaluations of its own
        selection.renew(fine)
    return polished(selected(fine, FINE, selection), selection.options)
