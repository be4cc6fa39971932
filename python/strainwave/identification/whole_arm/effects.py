"""What a joint may have beyond a spring and dry friction, as unknowns of the whole-arm fit."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, Effect, FloatArray, Study
from strainwave.domain.parameters import EFFECT_PARAMETERS, Values, unit_of
from strainwave.identification.closed_loop import with_known_effects
from strainwave.identification.whole_arm.dataset import Replayed
from strainwave.identification.whole_arm.parametrisation import COULOMB, Key, Search, Unknown

Tried = tuple[int, Effect]
"""A joint, from 1, and an effect that it may have."""

_EVIDENT = 3.0  # deviations from nothing that an effect must have
_FAR = float(np.log(30.0))  # how far a parameter may go from its start
_STRIBECK_SHARE = 0.2  # of Coulomb's friction, to start from
STRIBECK_VELOCITY = 3.0
"""[rad/s] at the motor, to start from."""
_HYSTERESIS_SHARE = 0.02  # of the largest gear torque
HYSTERESIS_TWIST = 1.5e-4
"""[rad] to start from."""
_KINEMATIC_ERROR = 1e-4  # [rad] that count as much as a factor e elsewhere


def tried(study: Study) -> list[Tried]:
    """The effects that a study names.

    Parameters
    ----------
    study : Study

    Returns
    -------
    list of (joint, effect)
    """
    return [(j, effect) for j, joint in enumerate(study.arm.joints, 1) for effect in joint.effects]


def sizes_of(one: Tried) -> list[Key]:
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
    search: Search, study: Study, values: Values, largest_torque: Sequence[float]
) -> tuple[Search, FloatArray]:
    """The unknowns of every effect that a study names beside those there are.

    Parameters
    ----------
    search : Search
    study : Study
    values : dict
        Where the fit without effects ended.
    largest_torque : sequence of float [N m]
        That each gear carries in the records.

    Returns
    -------
    Search
    (n_unknowns,)
        Where to start.
    """
    starts: Values = {}
    for number, effect in tried(study):
        sizes = {
            "stribeck": (_STRIBECK_SHARE * values[COULOMB, number], STRIBECK_VELOCITY),
            "hysteresis": (_HYSTERESIS_SHARE * largest_torque[number - 1], HYSTERESIS_TWIST),
            "kinematic-error": (0.0, 0.0),
        }[effect]
        starts |= {
            (name, number): size
            for name, size in zip(EFFECT_PARAMETERS[effect], sizes, strict=True)
        }
    more = []
    for (name, own), start in starts.items():
        signed = name in EFFECT_PARAMETERS["kinematic-error"]
        unit = unit_of(name, study.arm.joints[(own or 1) - 1])
        scale = _KINEMATIC_ERROR if signed else start
        more.append(Unknown(name, own, unit, start, scale, signed, _FAR))
    rows = np.pad(search.prior.rows, ((0, 0), (0, len(more))))
    unknowns = (*search.unknowns, *more)
    found = Search(unknowns, search.fixed, replace(search.prior, rows=rows))
    return found, found.coordinates(values | starts)


def without(search: Search, effects: Collection[Tried]) -> Search:
    """The unknowns less those of some effects.

    Parameters
    ----------
    search : Search
    effects : collection of (joint, effect)

    Returns
    -------
    Search
    """
    gone = {(name, j) for j, effect in effects for name in EFFECT_PARAMETERS[effect]}
    kept = [k for k, key in enumerate(search.keys) if key not in gone]
    prior = replace(search.prior, rows=search.prior.rows[:, kept])
    return Search(tuple(search.unknowns[k] for k in kept), search.fixed, prior)


def idle(search: Search, z: FloatArray, covariance: FloatArray) -> Iterator[Tried]:
    """The effects whose size is nothing as far as the records show.

    Parameters
    ----------
    search : Search
    z : (n_unknowns,)
    covariance : (n_unknowns, n_unknowns)
        Of the parameters.

    Yields
    ------
    (joint, effect)
    """
    values = search.parameters(z)
    at: dict[Key, int] = {key: k for k, key in enumerate(search.keys)}
    for effect, names in EFFECT_PARAMETERS.items():
        for name, joint in list(at):
            if name == names[0] and joint is not None:
                own = [at[key] for key in sizes_of((joint, effect))]
                size = values[own]
                if size @ np.linalg.solve(covariance[np.ix_(own, own)], size) < _EVIDENT**2:
                    yield joint, effect


def left_out(search: Search, study: Study) -> Iterator[Diagnostic]:
    """What a reader must know of the effects that a study names and a fit does without.

    Parameters
    ----------
    search : Search
        Of the fit.
    study : Study

    Yields
    ------
    Diagnostic
    """
    known = set(tried(with_known_effects(study, search.keys)))
    for joint, effect in tried(study):
        if (joint, effect) not in known:
            text = f"{effect} was tried and left out: the records do not show it; take it out of"
            text += " this joint's effects, or record slow motions and reversals"
            yield Diagnostic("effect-left-out", f"joint {joint}", text)


def records_with(
    records: Sequence[Replayed], study: Study, known: Collection[Key]
) -> tuple[Replayed, ...]:
    """The records on an arm with those of a study's effects whose parameters are known.

    Parameters
    ----------
    records : sequence of Replayed
    study : Study
    known : collection of (name, joint)

    Returns
    -------
    tuple of `Replayed`
    """
    effects = [joint.effects for joint in with_known_effects(study, known).arm.joints]

    def given(record: Replayed) -> Replayed:
        pairs = zip(record.study.arm.joints, effects, strict=True)
        joints = tuple(replace(joint, effects=own) for joint, own in pairs)
        return replace(
            record, study=replace(record.study, arm=replace(record.study.arm, joints=joints))
        )

    return tuple(given(record) for record in records)
