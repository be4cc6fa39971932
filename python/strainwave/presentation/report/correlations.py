"""Parameters of which only a combination is identifiable: correlations of their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray, Identification, Parameter
from strainwave.presentation.figures import MEASURED, MODEL, Axis, Figure, HeatMap, Panel

STRONG = 0.95  # from which two parameters are said to be identifiable only together
_MOST_PAIRS = 8
# what follows from others goes with them of necessity, and is left out beside them
_PARTS = {"total_viscous_friction": "motor_viscous_friction", "link_inertia": "beta"}


@dataclass(frozen=True, slots=True)
class Correlations:
    """Of the errors of the parameters that have an interval."""

    names: tuple[str, ...]
    matrix: FloatArray  # (n_names, n_names)


def correlations(identification: Identification) -> Correlations | None:
    """From the whole-arm fit, else the last stage before; None without two errors known.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    Correlations or None
    """
    tuned, joints, rigid = identification.tuned, identification.joints, identification.rigid
    if tuned is not None:
        return _of(tuned.parameters, tuned.covariance)
    if len(joints) == 1:
        size = len(joints[0].parameters)
        return _of(joints[0].parameters, joints[0].covariance[:size, :size])
    return _of(rigid.parameters, rigid.covariance) if rigid is not None else None


def pairs(found: Correlations) -> list[tuple[str, str, float]]:
    """The pairs whose errors are most alike, strongest first.

    Parameters
    ----------
    found : Correlations

    Returns
    -------
    list of (str, str, float)
    """
    rows, columns = np.triu_indices(len(found.names), 1)
    sizes = found.matrix[rows, columns]
    order = [k for k in np.argsort(-np.abs(sizes)) if abs(sizes[k]) >= STRONG]
    return [
        (found.names[rows[k]], found.names[columns[k]], float(sizes[k]))
        for k in order[:_MOST_PAIRS]
    ]


def words(found: Correlations) -> str:
    """The pairs in words.

    Parameters
    ----------
    found : Correlations

    Returns
    -------
    str
    """
    strong = pairs(found)
    if not strong:
        return f"No two errors correlate by {STRONG:g} or more: each parameter stands on its own."
    said = "; ".join(f"{a} with {b} ({r:+.3f})" for a, b, r in strong)
    return (
        f"Correlated errors: {said}. Of such a pair the data identify a combination better than"
        " either alone."
    )


def heat_map(found: Correlations) -> Figure:
    """Correlation of every two parameters, from -1 blue over white to +1 vermilion.

    Parameters
    ----------
    found : Correlations

    Returns
    -------
    Figure
    """
    mark = HeatMap(found.names, found.matrix, -1.0, 1.0, (MEASURED, "#FFFFFF", MODEL))
    return Figure(Axis(""), (Panel(Axis(""), (mark,)),))


def _of(parameters: Sequence[Parameter], covariance: FloatArray) -> Correlations | None:
    variance = np.diag(covariance)
    names = {p.name for p in parameters}
    known = [
        k
        for k, p in enumerate(parameters)
        if p.value is not None
        and np.isfinite(variance[k])
        and variance[k] > 0.0
        and _PARTS.get(p.name) not in names
    ]
    if len(known) < 2:
        return None
    std = np.sqrt(variance[known])
    matrix = covariance[np.ix_(known, known)] / np.outer(std, std)
    return Correlations(tuple(_name(parameters[k]) for k in known), np.clip(matrix, -1.0, 1.0))


def _name(parameter: Parameter) -> str:
    joint = f" {parameter.joint}" if parameter.joint else ""
    return f"{parameter.name.replace('_', ' ')}{joint}"
