"""Values and their covariance -> parameters to print, and what must be said of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Joint, Parameter
from strainwave.domain.parameters import unit_of

_IDENTIFIED = 0.3  # relative deviation up to which a damping or friction is worth printing
_SPLIT = ("motor_viscous_friction", "link_viscous_friction")
_REACH = 1.96  # of a 95 % interval, in deviations


def parameters_of(
    values: Mapping[str, float],
    covariance: FloatArray,
    determined: Sequence[bool],
    joint: Joint,
    number: int,
) -> Iterator[Parameter]:
    """Each value as a parameter, None if hardly identified, then the total viscous friction.

    `covariance` (n_values, n_values): NaN where it is not known: then no deviation is given.
    `determined` (n_values,).
    `number`: The joint's, from 1.
    """
    deviation = _deviations(covariance)
    for (name, value), std, known in zip(values.items(), deviation, determined, strict=True):
        identified = _is_identified(name, value, std, known)
        yield _parameter(name, number, joint, (value, std) if identified else None)
    weight = np.array(
        [
            {"motor_viscous_friction": 1.0, "link_viscous_friction": joint.gear_ratio**2}.get(n, 0)
            for n in values
        ]
    )
    total = float(weight @ np.array(list(values.values())))
    spread = float(np.sqrt(np.clip(weight @ covariance @ weight, 0.0, None)))
    yield _parameter("total_viscous_friction", number, joint, (total, spread))


def warnings_of(
    values: Mapping[str, float],
    covariance: FloatArray,
    determined: Sequence[bool],
    joint: Joint,
    number: int,
    source: str,
) -> Iterator[Diagnostic]:
    """What is hardly identified, what is impossible, and what is an average.

    `values, covariance, determined, joint, number`: As for `parameters_of`.
    `source`: Where the values come from: the records' names.
    """
    deviation = _deviations(covariance)
    for (name, value), std, known in zip(values.items(), deviation, determined, strict=True):
        place, unit = f"{name} of joint {number}", unit_of(name, joint)
        identified = _is_identified(name, value, std, known)
        size = f"{value:.3g} +- {std:.2g} {unit}" if np.isfinite(std) else f"{value:.3g} {unit}"
        if value + 2.0 * np.nan_to_num(std) < 0.0 and (identified or name not in _SPLIT):
            text = f"{size} is impossible: {source} show something that"
            yield Diagnostic("implausible", place, text + " this joint's model has not")
        elif not identified:
            text = f"{source} identify it only to {size}"
            if name.endswith("viscous_friction"):
                text += "; of the viscous frictions only the total is well known"
            yield Diagnostic("not-identifiable", place, text)
    if joint.law.is_curved:
        text = f"one stiffness for the whole curve, at the torsion reached in {source}: "
        text += joint.law.equivalent_note
        yield Diagnostic("equivalent-stiffness", f"gear_stiffness of joint {number}", text)


def status_of(
    warnings: Iterable[Diagnostic],
) -> Literal["determined", "partly-determined", "implausible"]:
    """The verdict on a joint's parameters that their warnings make."""
    codes = {warning.code for warning in warnings}
    if "implausible" in codes:
        return "implausible"
    return "partly-determined" if "not-identifiable" in codes else "determined"


def _parameter(
    name: str, number: int, joint: Joint, identified: tuple[float, float] | None
) -> Parameter:
    unit = unit_of(name, joint)
    if identified is None:
        return Parameter(name, number, None, None, unit, "decoupled")
    value, std = identified
    if not np.isfinite(std):
        return Parameter(name, number, value, None, unit, "decoupled")
    return Parameter(
        name, number, value, std, unit, "decoupled", (value - _REACH * std, value + _REACH * std)
    )


def _deviations(covariance: FloatArray) -> list[float]:
    return [float(d) for d in np.sqrt(np.clip(np.diag(covariance), 0.0, None))]


def _is_identified(name: str, value: float, std: float, determined: bool) -> bool:
    """Only the sum of the viscous frictions shows in fast records; their split hardly does."""
    if name in _SPLIT and not std <= _IDENTIFIED * abs(value):
        return False
    return determined
