"""Convert the values and covariance of a joint model to parameters, warnings and a status."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal

import numpy as np

from strainwave.domain import (
    Diagnostic,
    FloatArray,
    Joint,
    Parameter,
    Place,
)
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.units import unit_of

_MAX_VISCOUS_RELATIVE_STD = (
    0.3  # relative standard deviation up to which a viscous friction is reported
)
# only the sum of these is well determined in fast records
_VISCOUS_FRICTIONS = ("motor_viscous_friction", "link_viscous_friction")


def parameters_of(
    values: Mapping[str, float],
    covariance: FloatArray,
    determined: Sequence[bool],
    joint: Joint,
    number: int,
) -> Iterator[Parameter]:
    """Yield each value as a parameter, then the total viscous friction.

    `covariance` is (n_values, n_values); where it is NaN, no standard deviation is reported. The
    value of a parameter that is not determined is None. `number` counts joints from 1.
    """
    standard_deviations = _standard_deviations(covariance)
    for (name, value), std, is_determined in zip(
        values.items(), standard_deviations, determined, strict=True
    ):
        identified = _is_identified(name, value, std, is_determined)
        yield _parameter(name, number, joint, (value, std) if identified else None)
    weight = np.array(
        [
            {"motor_viscous_friction": 1.0, "link_viscous_friction": joint.gear_ratio**2}.get(n, 0)
            for n in values
        ]
    )
    total = float(weight @ np.array(list(values.values())))
    total_std = float(np.sqrt(np.clip(weight @ covariance @ weight, 0.0, None)))
    yield _parameter("total_viscous_friction", number, joint, (total, total_std))


def warnings_of(
    values: Mapping[str, float],
    covariance: FloatArray,
    determined: Sequence[bool],
    joint: Joint,
    number: int,
    source: str,
) -> Iterator[Diagnostic]:
    """Yield warnings for parameters that are not identifiable, implausible or equivalent values.

    `source` lists the records that the values come from; the other arguments are those of
    `parameters_of`.
    """
    standard_deviations = _standard_deviations(covariance)
    for (name, value), std, is_determined in zip(
        values.items(), standard_deviations, determined, strict=True
    ):
        place, unit = Place(joint=number, parameter=name), unit_of(name, joint)
        identified = _is_identified(name, value, std, is_determined)
        estimate = f"{value:.3g} +- {std:.2g} {unit}" if np.isfinite(std) else f"{value:.3g} {unit}"
        if value + 2.0 * np.nan_to_num(std) < 0.0 and (
            identified or name not in _VISCOUS_FRICTIONS
        ):
            text = f"{estimate} is physically impossible: the model of the joint does not describe"
            yield Diagnostic.at("implausible", place, f"{text} {source}")
        elif not identified:
            text = f"{source} determine the value only to {estimate}"
            if name.endswith("viscous_friction"):
                text += "; only the total viscous friction is well determined"
            yield Diagnostic.at("not-identifiable", place, text)
    if joint.law.is_curved:
        text = f"equivalent stiffness at the torsion in {source}: "
        text += joint.law.equivalent_note
        place = Place(joint=number, parameter="gear_stiffness")
        yield Diagnostic.at("equivalent-stiffness", place, text)


def status_of(
    warnings: Iterable[Diagnostic],
) -> Literal["determined", "partly-determined", "implausible"]:
    """Status of a joint's parameters, from the codes of their warnings."""
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
        name,
        number,
        value,
        std,
        unit,
        "decoupled",
        (value - CI95_STDS * std, value + CI95_STDS * std),
    )


def _standard_deviations(covariance: FloatArray) -> list[float]:
    return [float(d) for d in np.sqrt(np.clip(np.diag(covariance), 0.0, None))]


def _is_identified(name: str, value: float, std: float, determined: bool) -> bool:
    """Whether the value of a parameter is reported.

    In fast records only the sum of the viscous frictions is well determined, so each of them needs
    a small relative standard deviation as well.
    """
    if name in _VISCOUS_FRICTIONS and not std <= _MAX_VISCOUS_RELATIVE_STD * abs(value):
        return False
    return determined
