"""What models with one more effect would explain of what a fit left, without fitting them.

A score test: the derivative of every channel by an effect's size, at size nothing, joins the fit's
own derivatives as one more column. What it takes off the cost in one linear step is the evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.cores import side_by_side
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.parameters import EFFECT_PARAMETERS, Values
from strainwave.records import Caution, Effect, FloatArray, RicherModel, Study
from strainwave.tuning.effects import (
    HYSTERESIS_TWIST,
    STRIBECK_VELOCITY,
    Tried,
    records_with,
    sizes_of,
)
from strainwave.tuning.misfit import LEAST_BEND, Evaluated
from strainwave.tuning.replayed import Replayed
from strainwave.tuning.told import Fit
from strainwave.tuning.unknowns import Key

_EVIDENT = 5.0  # deviations from nothing
_MATTERS = 0.01  # and share of the cost
_AT_NOTHING = {
    "stribeck_friction": 0.0,
    "stribeck_velocity": STRIBECK_VELOCITY,
    "hysteresis_torque": 0.0,
    "hysteresis_twist": HYSTERESIS_TWIST,
    "kinematic_error_cos": 0.0,
    "kinematic_error_sin": 0.0,
}
_EXPERIMENTS: Mapping[Effect, str] = {
    "stribeck": "turn the motor slowly, at several constant speeds of either sign",
    "hysteresis": "hold the link and twist the gear slowly to and fro, to several torques",
    "kinematic-error": "turn the motor at a constant speed through many turns, and look for lines"
    " at two per turn in the accelerometers",
}


def richer_models(fit: Fit, study: Study) -> list[RicherModel]:
    """The effects that no joint's model has yet, the most telling first.

    Parameters
    ----------
    fit : Fit
    study : Study

    Returns
    -------
    list of RicherModel
        Each one's gain is what is left to it by those before; empty where the arm with effects
        cannot be simulated.
    """
    candidates = _missing(fit, study)
    if not candidates:
        return []
    try:
        factor = _bordered(fit, study, [key for one in candidates for key in sizes_of(one)])
    except (InvalidInput, NumericalFailure):
        return []
    return list(_chosen(candidates, factor, fit.cost))


def _missing(fit: Fit, study: Study) -> list[Tried]:
    known = fit.misfit.search.keys
    return [
        (number, effect)
        for number, joint in enumerate(study.joints, start=1)
        for effect, names in EFFECT_PARAMETERS.items()
        if joint.spring != "rigid" and (names[0], number) not in known
    ]


def _bordered(fit: Fit, study: Study, keys: Sequence[Key]) -> FloatArray:
    """R of [effects residual] in what the fit's unknowns cannot imitate: (n_keys + 1,) squared."""
    misfit, n = fit.misfit, len(fit.misfit.search.unknowns)
    numbers = range(1, study.n_joints + 1)
    nothing = {(name, j): value for name, value in _AT_NOTHING.items() for j in numbers}
    values: Values = nothing | misfit.search.values(fit.z)
    joints = tuple(replace(joint, effects=tuple(EFFECT_PARAMETERS)) for joint in study.joints)
    rich = records_with(misfit.records, replace(study, joints=joints), values)

    def factor(k: int, record: Replayed, evaluated: Evaluated) -> FloatArray:
        begun = misfit.memory.own[k][: len(record.local)]
        _, tangent = record.linearised(values, begun, keys)
        columns = np.concatenate([evaluated.columns, tangent[..., : len(keys)]], axis=2)
        whole = replace(evaluated, columns=columns)
        return whole.weighted(misfit.weights[k]).factor(LEAST_BEND)

    evaluated = enumerate(zip(rich, misfit.evaluate(fit.z), strict=True))
    parts = side_by_side([partial(factor, k, record, one) for k, (record, one) in evaluated])
    prior = misfit.search.prior
    known = prior.rows @ misfit.search.slope(fit.z)
    off = prior.rows @ misfit.search.parameters(fit.z) - prior.target
    border = np.zeros((len(known), len(keys)))
    stacked = np.concatenate([*parts, np.column_stack([known, border, off])])
    return np.asarray(np.linalg.qr(stacked, mode="r"))[n:, n:]


@dataclass(frozen=True, slots=True)
class _Step:
    """What one effect takes off the cost, and by which sizes."""

    candidate: Tried
    gain: float
    size: FloatArray
    std: FloatArray


def _chosen(candidates: Sequence[Tried], factor: FloatArray, cost: float) -> Iterator[RicherModel]:
    """One after the other, each given those before it as long as they are evident."""
    columns, at = {}, 0
    for one in candidates:
        width = len(sizes_of(one))
        columns[one] = factor[:, at : at + width]
        at += width
    left, target = list(candidates), factor[:, -1]
    taken = np.zeros((len(target), 0))
    while left:
        best = max((_step(one, columns[one], taken, target) for one in left), key=_gain)
        share = best.gain / max(cost, 1e-300)
        evident = best.gain > _EVIDENT**2 and share > _MATTERS
        joint, effect = best.candidate
        names = [name for name, _ in sizes_of(best.candidate)]
        yield RicherModel(
            joint=joint,
            effect=effect,
            sizes=dict(zip(names, best.size.tolist(), strict=True)),
            stds=dict(zip(names, best.std.tolist(), strict=True)),
            gain=best.gain,
            share=share,
            evident=evident,
        )
        left.remove(best.candidate)
        if evident:
            taken = np.column_stack([taken, columns[best.candidate]])


def _gain(step: _Step) -> float:
    return step.gain


def _step(candidate: Tried, columns: FloatArray, taken: FloatArray, target: FloatArray) -> _Step:
    """The best sizes of one effect beside those taken already; none below nothing."""
    basis = np.linalg.qr(taken)[0]
    columns = columns - basis @ (basis.T @ columns)
    target = target - basis @ (basis.T @ target)
    size = np.asarray(np.linalg.lstsq(columns, -target)[0], dtype=float)
    gain = float(np.sum(target**2) - np.sum((target + columns @ size) ** 2))
    std = np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns)))
    if candidate[1] != "kinematic-error" and size[0] < 0.0:
        size, gain = np.zeros_like(size), 0.0
    return _Step(candidate, gain, size, std)


def effect_cautions(richer: Sequence[RicherModel]) -> Iterator[Caution]:
    """The effects that the records speak for, and the experiment that would settle it.

    Parameters
    ----------
    richer : sequence of RicherModel

    Yields
    ------
    Caution
    """
    for one in richer:
        if not one.evident:
            continue
        sizes = ", ".join(
            f"{name} {size:.2g} +- {one.stds[name]:.1g}" for name, size in one.sizes.items()
        )
        text = f"{one.effect} would explain {100.0 * one.share:.2g} % of what is left ({sizes});"
        text += f' give the joint effects = ["{one.effect}"] to fit it; to be sure,'
        text += f" {_EXPERIMENTS[one.effect]}"
        yield Caution(f"{one.effect}-likely", f"joint {one.joint}", text)
