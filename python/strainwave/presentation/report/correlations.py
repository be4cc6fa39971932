"""Correlations between the errors of the estimated parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from strainwave.domain import ArmDescription, FloatArray, Identification, Parameter
from strainwave.domain.combinations import reported
from strainwave.presentation.figures import Axis, Colour, Figure, HeatMap, Panel

MIN_STRONG_CORRELATION = 0.95  # above it, only a combination of the two parameters is identified
_MAX_LISTED_PAIRS = 8


@dataclass(frozen=True, slots=True)
class Correlations:
    """Correlations of the parameters that have an interval."""

    names: tuple[str, ...]
    matrix: FloatArray  # (n_names, n_names)


def correlations(identification: Identification) -> Correlations | None:
    """Of the whole-arm fit, else of the last stage before; None with fewer than two parameters."""
    whole_arm, joints, rigid = identification.whole_arm, identification.joints, identification.rigid
    arm = identification.study.arm
    if whole_arm is not None:
        return _of(arm, whole_arm.parameters, whole_arm.covariance)
    if len(joints) == 1:
        covariance = joints[0].covariance  # without the total viscous friction, the last parameter
        return _of(arm, joints[0].parameters[: len(covariance)], covariance)
    return _of(arm, rigid.parameters, rigid.covariance) if rigid is not None else None


class StrongPair(NamedTuple):
    """Two strongly correlated parameters."""

    first: str
    second: str
    correlation: float


def strong_pairs(errors: Correlations) -> list[StrongPair]:
    """Pairs of strongly correlated parameters, strongest first."""
    rows, columns = np.triu_indices(len(errors.names), 1)
    values = errors.matrix[rows, columns]
    order = [k for k in np.argsort(-np.abs(values)) if abs(values[k]) >= MIN_STRONG_CORRELATION]
    return [
        StrongPair(errors.names[rows[k]], errors.names[columns[k]], float(values[k]))
        for k in order[:_MAX_LISTED_PAIRS]
    ]


def describe(errors: Correlations) -> str:
    """Caption of the heat map."""
    pairs = strong_pairs(errors)
    if not pairs:
        return f"No two parameters have a correlation of {MIN_STRONG_CORRELATION:g} or more."
    text = "; ".join(f"{a} and {b} ({r:+.3f})" for a, b, r in pairs)
    return (
        f"Strong correlations: {text}. The data identify a combination of such a pair better than"
        " either parameter."
    )


def heat_map(errors: Correlations) -> Figure:
    """Correlation of every two parameters, from -1 (blue) over 0 (white) to +1 (vermilion)."""
    mark = HeatMap(
        errors.names, errors.matrix, -1.0, 1.0, (Colour.MEASURED, "#FFFFFF", Colour.MODEL)
    )
    return Figure(Axis(""), (Panel(Axis(""), (mark,)),))


def _of(
    arm: ArmDescription, parameters: Sequence[Parameter], covariance: FloatArray
) -> Correlations | None:
    """Without sums of other parameters, which are correlated with these by definition."""
    variance = np.diag(covariance)
    keys = {p.key for p in parameters}
    sums = {key for key, parts in reported(arm).items() if not keys.isdisjoint(parts)}
    rows = [
        k
        for k, p in enumerate(parameters)
        if p.value is not None
        and np.isfinite(variance[k])
        and variance[k] > 0.0
        and p.key not in sums
    ]
    if len(rows) < 2:
        return None
    std = np.sqrt(variance[rows])
    matrix = covariance[np.ix_(rows, rows)] / np.outer(std, std)
    return Correlations(tuple(_label(parameters[k]) for k in rows), np.clip(matrix, -1.0, 1.0))


def _label(parameter: Parameter) -> str:
    joint = f" {parameter.joint}" if parameter.joint else ""
    return f"{parameter.name.replace('_', ' ')}{joint}"
