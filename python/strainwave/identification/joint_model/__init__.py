"""Decoupled step: identify a model of one joint from each record, and its physical parameters.

Three methods return a `JointModel`:

- `identify_joint`: regression of the equations of motion (S6), (S7); needs a link sensor.
- `state_space_of`, `from_state_space`: the paper's method. It estimates a state-space model and
  computes the physical parameters from its transfer functions (15)-(18); needs a link sensor.
- `models_from_motors`: frequency responses of the motors; needs no link sensor.

`identify_record` applies the first two methods, or the second only if the options select it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from strainwave.domain import (
    Decoupled,
    Diagnostic,
    JointModel,
    LinearOptions,
    LinkSignals,
    Modes,
    PhysicalOptions,
    Place,
    RecordModel,
    RigidModel,
    SearchEnd,
    StateSpace,
)
from strainwave.dynamics.arm import Arm
from strainwave.errors import StrainwaveError
from strainwave.identification.joint_model.agreement import compare_response
from strainwave.identification.joint_model.equations import RigidKnowledge, rigid_knowledge
from strainwave.identification.joint_model.grey_box import JointFit, solve
from strainwave.identification.joint_model.linear import (
    LinearFit,
    fit_linear,
    judge,
    modes_of,
    physical_order,
    state_space_of,
)
from strainwave.identification.joint_model.motor_side import (
    models_from_catalogue,
    models_from_motors,
)
from strainwave.identification.joint_model.stretches import (
    FIRST_BAND_HZ,
    Band,
    band_for,
    other_bands,
    resonances_of,
)
from strainwave.identification.joint_model.transfer import from_state_space
from strainwave.numerics.parallel import one_blas_thread

__all__ = [
    "JointFit",
    "LinearFit",
    "LinearOptions",
    "PhysicalOptions",
    "RecordFit",
    "RecordOptions",
    "compare_response",
    "fit_joint",
    "fit_linear",
    "fit_record",
    "from_state_space",
    "identify_joint",
    "identify_record",
    "joint_by_transfer",
    "judge",
    "models_from_catalogue",
    "models_from_motors",
    "modes_of",
    "rigid_knowledge",
    "state_space_of",
]

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """Options of both methods that use link sensors."""

    physical: PhysicalOptions = field(default_factory=PhysicalOptions)
    linear: LinearOptions = field(default_factory=LinearOptions)
    state_space: bool = True  # whether to estimate a state-space model as well
    # True: select the model order from the data, check the model on held-out samples and compute
    # physical parameters from it. False: estimate three states in the band of the equations of
    # motion, which is 20 times faster
    judged: bool = True


def identify_joint(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    model: RigidModel | None,
    arm: Arm,
    options: PhysicalOptions | None = None,
    *,
    search_from_hz: Band = FIRST_BAND_HZ,
) -> JointModel:
    """Estimate the physical parameters of one joint from its equations of motion, (S6) and (S7).

    All records are fitted together and must belong to one joint. `search_from_hz` is the band [Hz]
    in which the search for the filter band starts.

    A parameter that the data do not determine has the value None and a warning `not-identifiable`.
    An impossible value is reported as estimated, with a warning `implausible`.
    """
    return fit_joint(records, model, arm, options, search_from_hz=search_from_hz).model


def fit_joint(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    model: RigidModel | None,
    arm: Arm,
    options: PhysicalOptions | None = None,
    *,
    search_from_hz: Band = FIRST_BAND_HZ,
) -> JointFit:
    """Fit one joint as `identify_joint` does and keep the solved equations."""
    chosen = options or PhysicalOptions()
    first, sides = records[0][1], [signals for signals, _ in records]
    known = rigid_knowledge(model, arm, first.joint, sides, first.posture)
    if not chosen.use_rigid:
        known = RigidKnowledge(None, None, None, known.errors)
    with one_blas_thread():  # many small systems: several threads are slower
        return solve(records, arm, known, chosen.band_hz, search_from_hz)


@dataclass(frozen=True, slots=True)
class RecordFit:
    """Models of one record, with the state-space fit from which other records can start."""

    record: RecordModel
    linear: LinearFit | None  # None: not requested or failed


def identify_record(
    signals: LinkSignals,
    decoupled: Decoupled,
    model: RigidModel | None,
    arm: Arm,
    options: RecordOptions | None = None,
) -> RecordModel:
    """Identify the joint that one record excites, with every method that the options select.

    The result of a method that fails is None, and a warning of the record gives the reason.
    """
    return fit_record(signals, decoupled, model, arm, options).record


def fit_record(
    signals: LinkSignals,
    decoupled: Decoupled,
    model: RigidModel | None,
    arm: Arm,
    options: RecordOptions | None = None,
    together: JointFit | None = None,
    near: StateSpace | None = None,
) -> RecordFit:
    """Identify one record as `identify_record` does, starting from the results of other records.

    `together` is the fit of several records of the joint. If it contains this record, its solution
    for this record is used; otherwise its band is the starting band. `near` is a state-space model
    of another record, the starting value of a model that is not judged.
    """
    chosen = options or RecordOptions()
    name = decoupled.experiment.name
    place = Place.in_records(name)
    warnings: list[Diagnostic] = []

    def attempt(code: str, step: Callable[[], Result]) -> Result | None:
        try:
            return step()
        except (StrainwaveError, np.linalg.LinAlgError) as problem:
            warnings.append(Diagnostic(code, place, reason=str(problem)))
            return None

    def grey_box() -> JointModel:
        if together is not None and name in together.model.experiments:
            return together.of_record(name)
        # start in the band of the fit of all records
        first = FIRST_BAND_HZ if together is None else together.model.band_hz
        pair = [(signals, decoupled)]
        return identify_joint(pair, model, arm, chosen.physical, search_from_hz=first)

    by_equations = chosen.physical.route == "equations"
    physical = attempt("grey-box-failed", grey_box) if by_equations else None
    linear = modes = transfer = check = None
    judged = chosen.judged or not by_equations
    if chosen.state_space or not by_equations:
        linear_options, resonances = chosen.linear, resonances_of(physical)
        if not judged:  # three states in the band around the resonances, if these are known
            linear_options = physical_order(linear_options)
            if resonances is not None:
                band = band_for(resonances, [decoupled], linear_options)
                linear_options = replace(linear_options, band_hz=band)
        start_model = None if judged else near
        linear = attempt(
            "state-space-failed", lambda: fit_linear(decoupled, linear_options, start_model)
        )
    if linear is not None:
        fit = linear
        warnings += [w.at(place) for w in fit.model.warnings]
        modes = attempt("modes-failed", lambda: modes_of(fit.model))
    if linear is not None and judged:
        check = attempt("not-judged", lambda: judge(fit))
        transfer = attempt(
            "transfer-function-failed", lambda: _by_transfer(fit, model, arm, chosen.physical)
        )
    state_space = None if linear is None else linear.model
    record = RecordModel(
        decoupled, physical, state_space, modes, transfer, check, warnings=tuple(warnings)
    )
    return RecordFit(record, linear)


def joint_by_transfer(
    records: Sequence[Decoupled],
    model: RigidModel | None,
    arm: Arm,
    options: RecordOptions | None = None,
) -> JointModel:
    """Estimate the physical parameters of one joint by the paper's method, (15) to (18).

    One state-space model is fitted to all records, which must belong to one joint. Raises
    `InvalidInput` for records of different joints or sampling rates, `NotIdentifiable` if no
    stretch of a record is long enough or the state-space model has no resonance.
    """
    chosen = options or RecordOptions()
    with one_blas_thread():
        fit = fit_linear(records, physical_order(chosen.linear))
        return _by_transfer(fit, model, arm, chosen.physical)


def _by_transfer(
    fit: LinearFit, model: RigidModel | None, arm: Arm, options: PhysicalOptions
) -> JointModel:
    """Physical parameters from a state-space model of three states, the order of (17).

    If that model does not converge or has no resonance, the least damped pole and zero pairs of the
    model of the selected order are used.
    """
    reduced, records = fit.of_physical_order(), fit.records
    known = rigid_knowledge(
        model if options.use_rigid else None, arm, records[0].joint, posture=records[0].posture
    )
    models_in_other_bands = _in_other_bands(records, reduced, modes_of(reduced), fit.options)
    return from_state_space(reduced, records, arm, known, models_in_other_bands)


def _in_other_bands(
    records: Sequence[Decoupled], near: StateSpace, modes: Modes, options: LinearOptions
) -> list[StateSpace]:
    """Models in a narrower and a wider band, which measure the effect of the band on the estimates.

    Models that fail or have no resonance are left out.
    """
    resonances = resonances_of(modes)
    if resonances is None or options.filter != "band":
        return []
    models = []
    for band in other_bands(band_for(resonances, records, options), records):
        # the rate follows the band
        band_options = replace(options, band_hz=band, decimation=None, sample_time=None)
        try:
            estimate = state_space_of(records, band_options, near)
            model = replace(estimate, covariance=None)
            if model.status is SearchEnd.CONVERGED and modes_of(model).resonance:
                models.append(model)
        except (StrainwaveError, np.linalg.LinAlgError):
            continue
    return models
