"""Both sides of a joint, decoupled -> JointModel: its physical parameters, with deviations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.parameters import unit_of
from strainwave.physical.grey_box import GreyBoxFit, RigidKnowledge, fit_grey_box
from strainwave.physical.two_inertia import NAMES, anti_resonance, resonance
from strainwave.records import (
    Caution,
    Decoupled,
    FloatArray,
    Joint,
    JointModel,
    LinkSignals,
    Parameter,
    RecordModel,
    RigidModel,
    Study,
)

__all__ = ["PhysicalOptions", "identify_joint"]

_TOLD = 0.3  # relative deviation up to which a damping or friction is worth printing
_REACH = 1.96  # of a 95 % interval, in deviations
_ALL = (*NAMES, "motor_coulomb_friction")


@dataclass(frozen=True, slots=True)
class PhysicalOptions:
    """What may be set by hand."""

    band_hz: tuple[float, float] | None = None  # of the equations' filter; None: from the data
    use_rigid: bool = True  # whether what the rigid model knows joins as equations


def identify_joint(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    model: RigidModel | None,
    study: Study,
    options: PhysicalOptions | None = None,
) -> JointModel:
    """Physical parameters of one joint from its equations of motion, (S6) and (S7).

    Parameters
    ----------
    records : sequence of (LinkSignals, Decoupled)
        Of one joint, all fitted at once.
    model : RigidModel or None
    study : Study
    options : PhysicalOptions, optional

    Returns
    -------
    JointModel
        A parameter that the records hardly tell has the value None, and a warning says so; an
        impossible one is reported as it came, with a warning.
    """
    from threadpoolctl import threadpool_limits

    chosen = options or PhysicalOptions()
    number = records[0][1].joint
    joint = study.joints[number - 1]
    known = RigidKnowledge(None, None, None)
    if model is not None and chosen.use_rigid:
        known = rigid_knowledge(model, study, number)
    with threadpool_limits(limits=1, user_api="blas"):  # many small systems, as in the rigid step
        fit = fit_grey_box(records, study, known, chosen.band_hz)
    names = tuple(signals.experiment.name for signals, _ in records)
    warnings = tuple(_warnings(fit, joint, number, names))
    told = [w.where for w in warnings if w.code == "not-identifiable"]
    wrong = any(w.code == "implausible" for w in warnings)
    return JointModel(
        joint=number,
        experiments=names,
        method="grey-box",
        parameters=tuple(_parameters(fit, joint, number)),
        values=_values(fit),
        covariance=fit.covariance,
        anti_resonance=anti_resonance(fit.joint, fit.covariance[:6, :6]),
        resonance=resonance(fit.joint, fit.covariance[:6, :6]),
        band_hz=fit.band_hz,
        fit_percent={"torque": fit.torque_fit_percent, "twist": fit.twist_fit_percent},
        status="implausible" if wrong else "partly-determined" if told else "determined",
        warnings=warnings,
    )


def rigid_knowledge(model: RigidModel, study: Study, joint: int) -> RigidKnowledge:
    """c_1, c_0 and f of one joint, each with its deviation, as the rigid model tells them.

    Parameters
    ----------
    model : RigidModel
    study : Study
    joint : int
        From 1.

    Returns
    -------
    RigidKnowledge
        None for what it does not tell.
    """
    n2 = study.joints[joint - 1].gear_ratio ** 2
    inertia: dict[tuple[str, int | None], float]
    if study.n_joints == 1:
        inertia = {("inertia", 1): 1.0}
    elif joint == 1:
        inertia = {("rigid_inertia", 1): n2, ("beta", None): n2, ("gamma", None): 2.0 * n2}
    else:
        inertia = {("motor_inertia", 2): 1.0, ("beta", None): n2}
    return RigidKnowledge(
        total_inertia=_sum(model, inertia),
        total_viscous_friction=_sum(model, {("total_viscous_friction", joint): 1.0}),
        coulomb_friction=_sum(model, {("motor_coulomb_friction", joint): 1.0}),
    )


def _sum(
    model: RigidModel, weights: dict[tuple[str, int | None], float]
) -> tuple[float, float] | None:
    """A weighted sum of rigid parameters and its deviation."""
    weight = np.zeros(len(model.parameters))
    for k, p in enumerate(model.parameters):
        weight[k] = weights.get((p.name, p.joint), 0.0)
        if weight[k] and p.value is None:
            return None
    if np.count_nonzero(weight) != len(weights):
        return None
    used = np.flatnonzero(weight)
    variance = weight[used] @ model.covariance[np.ix_(used, used)] @ weight[used]
    return float(weight @ model.solution), float(np.sqrt(variance))


def _values(fit: GreyBoxFit) -> dict[str, float]:
    values = [*fit.joint.vector.tolist(), fit.coulomb_friction]
    return dict(zip(_ALL, values, strict=True))


def _deviations(fit: GreyBoxFit) -> FloatArray:
    return np.asarray(np.sqrt(np.clip(np.diag(fit.covariance), 0.0, None)))


def _parameters(fit: GreyBoxFit, joint: Joint, number: int) -> Iterator[Parameter]:
    values, deviation = _values(fit), _deviations(fit)
    for k, name in enumerate(_ALL):
        told = _is_told(name, values[name], float(deviation[k]), fit.determined[k])
        yield _parameter(name, number, joint, (values[name], float(deviation[k])) if told else None)
    n2 = joint.gear_ratio**2
    weight = np.zeros(len(_ALL))
    weight[[_ALL.index("motor_viscous_friction"), _ALL.index("link_viscous_friction")]] = 1.0, n2
    total = float(weight @ np.array(list(values.values())))
    spread = float(np.sqrt(weight @ fit.covariance @ weight))
    yield _parameter("total_viscous_friction", number, joint, (total, spread))


def _parameter(name: str, number: int, joint: Joint, told: tuple[float, float] | None) -> Parameter:
    unit = unit_of(name, joint)
    if told is None:
        return Parameter(name, number, None, None, unit, "decoupled")
    value, std = told
    return Parameter(
        name, number, value, std, unit, "decoupled", (value - _REACH * std, value + _REACH * std)
    )


def _is_told(name: str, value: float, std: float, determined: bool) -> bool:
    """Only the sum of the viscous frictions shows in fast records; their split hardly does."""
    split = name in ("motor_viscous_friction", "link_viscous_friction")
    return determined and not (split and std > _TOLD * abs(value))


def _warnings(
    fit: GreyBoxFit, joint: Joint, number: int, names: Sequence[str]
) -> Iterator[Caution]:
    where = ", ".join(names)
    deviation = _deviations(fit)
    for k, (name, value) in enumerate(_values(fit).items()):
        place = f"{name} of joint {number}"
        std = float(deviation[k])
        if not _is_told(name, value, std, fit.determined[k]):
            text = f"{where} tell it only to {value:.3g} +- {std:.2g} {unit_of(name, joint)}"
            if name.endswith("viscous_friction"):
                text += "; of the viscous frictions only the total is well known"
            yield Caution("not-identifiable", place, text)
        elif value + 2.0 * std < 0.0:
            text = f"{value:.3g} +- {std:.2g} {unit_of(name, joint)} is impossible: {where} show"
            text += " something that this joint's model has not"
            yield Caution("implausible", place, text)
    if joint.spring == "three-slope":
        text = f"one slope for the whole curve, as twisted in {where}: between the softest and the"
        text += " stiffest of the three"
        yield Caution("equivalent-stiffness", f"gear_stiffness of joint {number}", text)


def identify_record(
    signals: LinkSignals, decoupled: Decoupled, model: RigidModel | None, study: Study
) -> RecordModel:
    """TEMPORARY."""
    return RecordModel(
        decoupled, identify_joint([(signals, decoupled)], model, study), None, None, None
    )
