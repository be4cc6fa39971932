"""Closed-loop records, RigidModel, JointModels -> ArmModel: all parameters at once.

Nonlinear least squares on simulations of the whole arm under its servo, within bounds around what
the earlier stages found.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from strainwave.closed_loop import linearised, observe, predict_closed_loop, velocity_band
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.parameters import unit_of
from strainwave.records import (
    ArmModel,
    Caution,
    FloatArray,
    JointModel,
    Log,
    Parameter,
    Prediction,
    RigidModel,
    Study,
)
from strainwave.tuning.misfit import Misfit, covariance_of
from strainwave.tuning.unknowns import VISCOUS, Search, link_inertias, search_of

__all__ = ["TuningOptions", "tune"]

_ROUNDS = 6  # of new weights; the third seldom moves anything
_SETTLED = 0.2  # relative change of the weights
_TOLERANCE = 1e-6  # of the coordinates and of the cost
_EDGE = 0.01  # of its reach, so near to which a parameter counts as at its bound
_TOLD = 0.3  # relative deviation up to which a viscous friction is worth printing
_REACH = 1.96  # of a 95 % interval, in deviations


@dataclass(frozen=True, slots=True)
class TuningOptions:
    """What may be set by hand."""

    cutoff_hz: float | None = None  # of what is compared; None: as far up as there is signal
    accelerometers: bool = True  # whether they are compared beside the motor velocities
    least_deviation: float = 0.002  # of what earlier stages know, as a share of each value
    span: float = 0.1  # least share by which a parameter may leave its start
    max_iterations: int = 50


def tune(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
    options: TuningOptions | None = None,
) -> ArmModel:
    """Fine tuning: every parameter but Coulomb friction and offset, on all tuning records at once.

    Each record is simulated with its own servo, references and initial state. Differences of motor
    velocities and accelerations, through one zero-phase low-pass, are divided by their robust
    deviations. What the earlier stages know joins as rows of its own, with its correlations and
    with a least deviation for the error of their models: a step tells little of some parameters,
    and those stay where they were.

    A three-slope gear is simulated with one stiffness for the whole curve.

    Parameters
    ----------
    logs : sequence of Log
        Those whose use is "tuning" are taken.
    model : RigidModel or None
        None will do for a single joint without gravity.
    joints : sequence of JointModel
        One a joint.
    study : Study
    options : TuningOptions, optional

    Returns
    -------
    ArmModel
        `values` has every parameter; in `parameters` a viscous friction that is hardly told has
        the value None, and a warning says so. A parameter at the end of its range gives the status
        "at-bounds".

    Raises
    ------
    NotIdentifiable
        There is no tuning record, or a start is missing or impossible.
    InvalidInput
        A record lacks something that replaying it needs.
    """
    chosen = options or TuningOptions()
    used = [log for log in logs if log.experiment.use == "tuning"]
    if not used:
        raise NotIdentifiable(
            'tuning needs a record with use = "tuning": steps of a servo\'s reference, one joint at'
            " a time"
        )
    search = search_of(model, joints, study, floor=chosen.least_deviation, span=chosen.span)
    cutoff = chosen.cutoff_hz or min(velocity_band(log, study) for log in used)
    records = tuple(
        observe(log, study, cutoff, accelerometers=chosen.accelerometers) for log in used
    )
    end = _minimise(Misfit(linearised(study, search.fixed), search, records), chosen.max_iterations)
    values = search.values(end.z)
    start = search.values(np.zeros(len(end.z)))
    initial = tuple(predict_closed_loop(start, log, study, cutoff) for log in used)
    tuned = tuple(predict_closed_loop(values, log, study, cutoff) for log in used)
    parameters, covariance = _parameters(search, end, model, joints, study)
    bounded = [u for u, at in zip(search.unknowns, _at_bounds(search, end), strict=True) if at]
    status: Literal["converged", "iteration-limit", "at-bounds"] = "converged"
    if bounded:
        status = "at-bounds"
    if not end.converged:
        status = "iteration-limit"
    return ArmModel(
        parameters=parameters,
        values=values,
        covariance=covariance,
        fit_percent=_fits(tuned),
        initial_fit_percent=_fits(initial),
        simulated=tuned,
        initial=initial,
        iterations=end.iterations,
        status=status,
        warnings=tuple(_warnings(search, end, parameters, study)),
    )


@dataclass(frozen=True, slots=True)
class _End:
    """Where the search ended."""

    z: FloatArray  # (n_unknowns,)
    covariance: FloatArray  # (n_unknowns, n_unknowns) of the parameters
    iterations: int
    converged: bool


def _minimise(misfit: Misfit, max_iterations: int) -> _End:
    """Least squares, and what is held meanwhile, in turn until the weights stay."""
    from scipy.optimize import least_squares

    z = np.zeros(len(misfit.search.unknowns))
    reach = misfit.search.reach
    try:
        misfit = misfit.around(z)
    except (InvalidInput, NumericalFailure) as failure:
        raise NotIdentifiable(
            f"tuning cannot simulate what the steps before found: {failure}"
        ) from failure
    iterations, converged = 0, False
    for _ in range(_ROUNDS):
        found = least_squares(
            misfit.residual,
            z,
            jac=misfit.jacobian,
            bounds=(-reach, reach),
            method="trf",
            x_scale="jac",
            xtol=_TOLERANCE,
            ftol=_TOLERANCE,
            gtol=1e-12,  # the gradient's size says nothing where rows are so many
            max_nfev=max(1, max_iterations - iterations),
        )
        z, converged = found.x, bool(found.status > 0)
        iterations += int(found.njev)
        if not converged:
            break
        renewed = misfit.around(z)
        changes = [
            np.max(np.abs(np.log(new / old)))
            for new, old in zip(renewed.weights, misfit.weights, strict=True)
        ]
        if max(changes) < _SETTLED or iterations >= max_iterations:
            break
        misfit = renewed
    effect = misfit.friction_effect(z)
    covariance = covariance_of(found.fun, found.jac, misfit.block_of_rows(), effect)
    slope = misfit.search.slope(z)
    return _End(z, covariance * np.outer(slope, slope), iterations, converged)


def _at_bounds(search: Search, end: _End) -> list[bool]:
    near: list[bool] = (np.abs(end.z) > (1.0 - _EDGE) * search.reach).tolist()
    return near


def _fits(predictions: Sequence[Prediction]) -> dict[str, dict[str, float]]:
    return {p.experiment: dict(p.fit_percent) for p in predictions}


def _parameters(
    search: Search,
    end: _End,
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
) -> tuple[tuple[Parameter, ...], FloatArray]:
    """The unknowns, what is derived from them, the friction taken over; and their covariance."""
    names = [(u.name, u.joint) for u in search.unknowns]
    units = [u.unit for u in search.unknowns]
    weight = [*np.eye(len(names))]
    link = link_inertias(study, names)
    for number, joint in enumerate(study.joints, start=1):
        total = np.zeros(len(weight[0]))
        total[search.index(VISCOUS[0], number)] = 1.0
        total[search.index(VISCOUS[1], number)] = joint.gear_ratio**2
        derived = [("total_viscous_friction", total)]
        if study.n_joints > 1:
            derived.append(("link_inertia", link[number - 1]))
        for name, row in derived:
            names.append((name, number))
            units.append(unit_of(name, joint))
            weight.append(row)
    W = np.array(weight)
    values = W @ search.parameters(end.z)
    covariance = W @ end.covariance @ W.T
    deviation = np.sqrt(np.diag(covariance))
    found = [
        _parameter(name, joint, unit, float(value), float(std))
        for (name, joint), unit, value, std in zip(names, units, values, deviation, strict=True)
    ]
    taken = [_coulomb(search, joint, model, study) for joint in joints]
    whole = np.zeros((len(found) + len(taken),) * 2)
    whole[: len(found), : len(found)] = covariance
    for k, parameter in enumerate(taken, start=len(found)):
        whole[k, k] = (parameter.std or 0.0) ** 2
    return (*found, *taken), whole


def _parameter(name: str, joint: int | None, unit: str, value: float, std: float) -> Parameter:
    if name in VISCOUS and std > _TOLD * abs(value):
        return Parameter(name, joint, None, None, unit, "tuned")
    reach = _REACH * std
    return Parameter(name, joint, value, std, unit, "tuned", (value - reach, value + reach))


def _coulomb(
    search: Search, joint: JointModel, model: RigidModel | None, study: Study
) -> Parameter:
    """Taken over, with the name of the stage that found it."""
    name, number = "motor_coulomb_friction", joint.joint
    sources = [*(model.parameters if model is not None else ()), *joint.parameters]
    for parameter in sources:
        if (parameter.name, parameter.joint) == (name, number) and parameter.value is not None:
            return parameter
    value = search.fixed[name, number]
    unit = unit_of(name, study.joints[number - 1])
    return Parameter(name, number, value, None, unit, "decoupled")


def _warnings(
    search: Search, end: _End, parameters: Sequence[Parameter], study: Study
) -> Iterator[Caution]:
    values = search.parameters(end.z)
    deviation = np.sqrt(np.diag(end.covariance))
    for k, (unknown, at) in enumerate(zip(search.unknowns, _at_bounds(search, end), strict=True)):
        if at:
            text = (
                f"tuning ended at the end of its range, {values[k]:.3g} {unknown.unit}: the steps"
            )
            text += " and the records before them do not agree on it"
            yield Caution("at-bounds", str(unknown), text)
        if parameters[k].value is None:
            text = f"tuning tells it only to {values[k]:.3g} +- {deviation[k]:.2g} {unknown.unit}"
            text += "; of the viscous frictions only the total is well known"
            yield Caution("not-identifiable", str(unknown), text)
    if not end.converged:
        text = f"still moving after {end.iterations} iterations; allow more, or record longer steps"
        yield Caution("iteration-limit", "tuning", text)
    for number, joint in enumerate(study.joints, start=1):
        if joint.spring == "three-slope":
            text = "one slope for the whole curve, as twisted in the tuning records: between the"
            text += " softest and the stiffest of the three"
            yield Caution("equivalent-stiffness", f"gear_stiffness of joint {number}", text)
