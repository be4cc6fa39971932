"""Restrictions of the whole-arm fit by the options: held parameters and parameter ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Log, WholeArmOptions
from strainwave.domain.gear_laws import STIFFNESS, is_slope
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors import constant_of
from strainwave.domain.options import PUBLISHED_RANGE
from strainwave.domain.parameter_table import COULOMB, OFFSET, base_name
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace, Unknown
from strainwave.identification.whole_arm.problem.prior import Prior
from strainwave.signals.recorded_input import missing_recorded_input


def expand_published_options(options: WholeArmOptions) -> WholeArmOptions:
    """Expand the option `as_published` into the options that it implies."""
    if not options.as_published:
        return options
    return replace(
        options,
        closed_loop=True,
        settling=bool(options.settling),
        hold=tuple(dict.fromkeys((*options.hold, COULOMB, OFFSET))),
    )


def published_records(logs: Sequence[Log], arm: Arm) -> list[Log]:
    """Select the records of the published tuning method: steps in closed loop.

    `logs` have the motor signals that a simulation needs. Raises `NotIdentifiable` if none has
    use = "tuning", or if one lacks data for a closed-loop simulation.
    """
    selected = [log for log in logs if log.experiment.use == "tuning" and not log.is_continuation]
    if not selected:
        raise NotIdentifiable(
            'tuning as published needs records with use = "tuning": steps under servo'
        )
    for log in selected:
        missing = missing_recorded_input(arm, log)
        if missing is not None:
            raise NotIdentifiable(
                f"tuning as published simulates {log.name} in closed loop, but {missing}: add the "
                "missing data, or set tuning.as_published = false"
            )
    return selected


def restrict_space(
    space: ParameterSpace, options: WholeArmOptions, z: FloatArray
) -> ParameterSpace:
    """Hold parameters and limit the ranges of the others, as the options require.

    `z` (n_unknowns,) is the start of the fit: it fixes the held values and the centres of the
    ranges. Raises `InvalidInput` if all parameters are held.
    """
    if options.as_published:  # the published method has no prior
        space = replace(space, prior=Prior.empty(len(z)))
    values = space.values(z)
    held = {key: values[key] for key in space.keys if is_held(key, options)}
    if len(held) == len(space.unknowns):
        raise InvalidInput(
            "every parameter is held",
            where="[options] tuning.hold",
            remedy="remove at least one parameter from the list",
        )
    limited = tuple(
        limit_unknown(unknown, options, at)
        for unknown, at in zip(space.unknowns, z.tolist(), strict=True)
    )
    return replace(space, unknowns=limited).fix_values(held)


def is_held(key: Key, options: WholeArmOptions) -> bool:
    """Whether the options hold a parameter at its start."""
    return bool(set(_names(key)) & set(options.hold))


def _names(key: Key) -> list[str]:
    """Names of a parameter in the options, the most specific first."""
    name, joint = key
    base_names = dict.fromkeys((name, base_name(name)))  # for one record, then for all records
    names = [
        full_name
        for n in base_names
        for full_name in ([n] if joint is None else [f"{n} {joint}", n])
    ]
    if name != STIFFNESS and is_slope(name):  # one name covers all slopes of a gear
        names += [f"{STIFFNESS} {joint}", STIFFNESS]
    return names


def limit_unknown(unknown: Unknown, options: WholeArmOptions, at: float) -> Unknown:
    """Limit an unknown to the options' factors of its value at coordinate `at`, unless it is 0."""
    factors = next((options.ranges[n] for n in _names(unknown.key) if n in options.ranges), None)
    if factors is None and options.as_published and not constant_of(unknown.key):
        factors = PUBLISHED_RANGE
    if factors is None:
        return unknown
    if not unknown.signed:
        low, high = (at + float(np.log(factor)) for factor in factors)
        return replace(unknown, limits=(low, high))
    value = unknown.start + unknown.scale * at
    if value == 0.0:
        return unknown
    ends = sorted((factor * value - unknown.start) / unknown.scale for factor in factors)
    return replace(unknown, limits=(ends[0], ends[1]))
