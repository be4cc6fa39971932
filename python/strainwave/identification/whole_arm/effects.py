"""What a joint may have beyond a spring and dry friction, as unknowns of the whole-arm fit."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, Effect, FloatArray
from strainwave.domain.parameters import EFFECT_PARAMETERS, Values, unit_of
from strainwave.dynamics.arm import Arm
from strainwave.identification.closed_loop import with_known_effects
from strainwave.identification.whole_arm.dataset import Dataset
from strainwave.identification.whole_arm.parametrisation import (
    COULOMB,
    Key,
    ParameterSpace,
    Unknown,
)

NamedEffect = tuple[int, Effect]
"""A joint, from 1, and an effect that it may have."""

_EVIDENT = 3.0  # deviations from nothing that an effect must have
_FAR = float(np.log(30.0))  # how far a parameter may go from its start
_STRIBECK_SHARE = 0.2  # of Coulomb's friction, to start from
STRIBECK_VELOCITY = 3.0
"""[rad/s] at the motor, to start from."""
_HYSTERESIS_SHARE = 0.02  # of the largest gear torque
HYSTERESIS_TORSION = 1.5e-4
"""[rad] to start from."""
_KINEMATIC_ERROR = 1e-4  # [rad] that count as much as a factor e elsewhere


def named_effects(arm: Arm) -> list[NamedEffect]:
    """The effects that a study names.

    Parameters
    ----------
    arm : Arm

    Returns
    -------
    list of (joint, effect)
    """
    return [(j, effect) for j, joint in enumerate(arm.joints, 1) for effect in joint.effects]


def sizes_of(one: NamedEffect) -> list[Key]:
    """The parameters that are zero where an effect is not there.

    Parameters
    ----------
    one : (joint, effect)

    Returns
    -------
    list of (name, joint)
    """
    joint, effect = one
    names = EFFECT_PARAMETERS[effect]
    return [(name, joint) for name in (names if effect == "kinematic-error" else names[:1])]


def with_effects(
    space: ParameterSpace, arm: Arm, values: Values, largest_torque: Sequence[float]
) -> tuple[ParameterSpace, FloatArray]:
    """The unknowns of every effect that a study names beside those there are.

    Parameters
    ----------
    search : ParameterSpace
    arm : Arm
    values : dict
        Where the fit without effects ended.
    largest_torque : sequence of float [N m]
        That each gear carries in the records.

    Returns
    -------
    ParameterSpace
    (n_unknowns,)
        Where to start.
    """
    starts: Values = {}
    for number, effect in named_effects(arm):
        sizes = {
            "stribeck": (_STRIBECK_SHARE * values[COULOMB, number], STRIBECK_VELOCITY),
            "hysteresis": (_HYSTERESIS_SHARE * largest_torque[number - 1], HYSTERESIS_TORSION),
            "kinematic-error": (0.0, 0.0),
        }[effect]
        starts |= {
            (name, number): size
            for name, size in zip(EFFECT_PARAMETERS[effect], sizes, strict=True)
        }
    more = []
    for (name, own), start in starts.items():
        signed = name in EFFECT_PARAMETERS["kinematic-error"]
        unit = unit_of(name, arm.joints[(own or 1) - 1])
        scale = _KINEMATIC_ERROR if signed else start
        more.append(Unknown(name, own, unit, start, scale, signed, _FAR))
    rows = np.pad(space.prior.rows, ((0, 0), (0, len(more))))
    unknowns = (*space.unknowns, *more)
    found = ParameterSpace(unknowns, space.fixed, replace(space.prior, rows=rows))
    return found, found.coordinates(values | starts)


def without(space: ParameterSpace, effects: Collection[NamedEffect]) -> ParameterSpace:
    """The unknowns less those of some effects.

    Parameters
    ----------
    search : ParameterSpace
    effects : collection of (joint, effect)

    Returns
    -------
    ParameterSpace
    """
    gone = {(name, j) for j, effect in effects for name in EFFECT_PARAMETERS[effect]}
    kept = [k for k, key in enumerate(space.keys) if key not in gone]
    prior = replace(space.prior, rows=space.prior.rows[:, kept])
    return ParameterSpace(tuple(space.unknowns[k] for k in kept), space.fixed, prior)


def idle(space: ParameterSpace, z: FloatArray, covariance: FloatArray) -> Iterator[NamedEffect]:
    """The effects whose size is nothing as far as the records show.

    Parameters
    ----------
    search : ParameterSpace
    z : (n_unknowns,)
    covariance : (n_unknowns, n_unknowns)
        Of the parameters.

    Yields
    ------
    (joint, effect)
    """
    values = space.parameters(z)
    at: dict[Key, int] = {key: k for k, key in enumerate(space.keys)}
    for effect, names in EFFECT_PARAMETERS.items():
        for name, joint in list(at):
            if name == names[0] and joint is not None:
                own = [at[key] for key in sizes_of((joint, effect))]
                size = values[own]
                if size @ np.linalg.solve(covariance[np.ix_(own, own)], size) < _EVIDENT**2:
                    yield joint, effect


def left_out(space: ParameterSpace, arm: Arm) -> Iterator[Diagnostic]:
    """What a reader must know of the effects that a study names and a fit does without.

    Parameters
    ----------
    search : ParameterSpace
        Of the fit.
    arm : Arm

    Yields
    ------
    Diagnostic
    """
    known = set(named_effects(with_known_effects(arm, space.keys)))
    for joint, effect in named_effects(arm):
        if (joint, effect) not in known:
            text = f"{effect} was tried and left out: the records do not show it; take it out of"
            text += " this joint's effects, or record slow motions and reversals"
            yield Diagnostic("effect-left-out", f"joint {joint}", text)


def records_with(
    records: Sequence[Dataset], arm: Arm, known: Collection[Key]
) -> tuple[Dataset, ...]:
    """The records on an arm with those of an arm's effects whose parameters are known.

    Parameters
    ----------
    records : sequence of Dataset
    arm : Arm
    known : collection of (name, joint)

    Returns
    -------
    tuple of `Dataset`
    """
    effects = [joint.effects for joint in with_known_effects(arm, known).joints]

    def given(record: Dataset) -> Dataset:
        pairs = zip(record.arm.joints, effects, strict=True)
        joints = (replace(joint, effects=own) for joint, own in pairs)
        return replace(record, arm=record.arm.with_joints(joints))

    return tuple(given(record) for record in records)
