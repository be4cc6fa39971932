"""What the user allows the whole-arm fit: parameters that are held, and ranges around the start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Log, TuningOptions
from strainwave.domain.gear_laws import STIFFNESS, is_slope
from strainwave.domain.options import PUBLISHED_RANGE
from strainwave.domain.parameter_table import base_name
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import is_sensor_constant
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification.whole_arm.parametrisation import (
    COULOMB,
    OFFSET,
    Key,
    ParameterSpace,
    Prior,
    Unknown,
)
from strainwave.signals.recorded_input import missing_recorded_input


def as_published(options: TuningOptions) -> TuningOptions:
    """The options with all that `as_published` stands for; others as they are."""
    if not options.as_published:
        return options
    return replace(
        options,
        closed_loop=True,
        settling=bool(options.settling),
        hold=tuple(dict.fromkeys((*options.hold, COULOMB, OFFSET))),
    )


def published_records(logs: Sequence[Log], arm: Arm) -> list[Log]:
    """The records that tuning as published rests on: steps under servo.

    `logs`: That can be gone through again with recorded voltages.

    Raises `NotIdentifiable`: there is none; `InvalidInput`: one lacks something that a simulation
    in closed loop needs.
    """
    chosen = [log for log in logs if log.experiment.use == "tuning"]
    if not chosen:
        raise NotIdentifiable(
            'tuning as published needs records with use = "tuning": steps under servo'
        )
    for log in chosen:
        missing = missing_recorded_input(arm, log)
        if missing is not None:
            raise InvalidInput(
                f"tuning as published simulates in closed loop, but {missing}",
                where=log.name,
                remedy="give what is missing, or leave tuning.as_published out",
            )
    return chosen


def restricted(space: ParameterSpace, options: TuningOptions, z: FloatArray) -> ParameterSpace:
    """Without the parameters that are held, the others within their ranges.

    `z` (n_unknowns,): Where the fit starts: ranges lie around it, and held parameters stay there.

    Raises `InvalidInput`: nothing is left to be fitted.
    """
    if options.as_published:  # the records alone speak
        empty = Prior(np.zeros((0, len(z))), np.zeros(0), np.zeros((0, 0)))
        space = replace(space, prior=empty)
    values = space.values(z)
    held = {key: values[key] for key in space.keys if is_held(key, options)}
    if len(held) == len(space.unknowns):
        raise InvalidInput(
            "every parameter is held",
            where="[options] tuning.hold",
            remedy="leave something to be fitted",
        )
    limited = tuple(
        _limited(unknown, _range(options, unknown.key), at)
        for unknown, at in zip(space.unknowns, z.tolist(), strict=True)
    )
    return replace(space, unknowns=limited).holding(held)


def is_held(key: Key, options: TuningOptions) -> bool:
    """Whether a parameter is not to be fitted."""
    return bool(set(_names(key)) & set(options.hold))


def _names(key: Key) -> list[str]:
    """What the options may call a parameter, the most particular first."""
    name, joint = key
    each = dict.fromkeys((name, base_name(name)))  # of one record, then of all
    names = [own for n in each for own in ([n] if joint is None else [f"{n} {joint}", n])]
    if name != STIFFNESS and is_slope(name):  # one word for all slopes of a gear
        names += [f"{STIFFNESS} {joint}", STIFFNESS]
    return names


def _range(options: TuningOptions, key: Key) -> tuple[float, float] | None:
    """Factors of the start; what a sensor does to its signal is no parameter of the arm."""
    given = next((options.ranges[name] for name in _names(key) if name in options.ranges), None)
    usual = options.as_published and not is_sensor_constant(key)
    return given or (PUBLISHED_RANGE if usual else None)


def _limited(unknown: Unknown, factors: tuple[float, float] | None, at: float) -> Unknown:
    """Within factors of the value at a coordinate; what is zero there has no such range."""
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
