"""The joint covariance of the final table's parameters: into result.json, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from strainwave.domain import FloatArray, Identification, Parameter
from strainwave.errors import InvalidInput

_ALIKE = 1e-9  # relative difference of a value or deviation that is the stage's own


@dataclass(frozen=True, slots=True, eq=False)
class JointCovariance:
    """Of the errors of those parameters of the final table that the last stage decided."""

    stage: str
    names: tuple[str, ...]  # with joint, as in the verdict
    matrix: FloatArray  # (n_names, n_names), in the parameters' units


def joint_covariance(identification: Identification) -> JointCovariance | None:
    """The covariance that the last stage gives.

    Values of the final table that are the stage's own count; those that were clipped at zero, made
    of several stages or rejected have no covariance with others.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    JointCovariance or None
        None where the last stage knows no parameter's error.
    """
    published = {p.label: p for p in identification.parameters}
    stage, blocks = _blocks(identification)
    kept = [
        (names, matrix)
        for parameters, covariance in blocks
        if (found := _own(parameters, covariance, published)) is not None
        for names, matrix in [found]
    ]
    if not kept:
        return None
    names = tuple(name for own, _ in kept for name in own)
    matrix = np.zeros((len(names), len(names)))
    at = 0
    for own, block in kept:
        to = at + len(own)
        matrix[at:to, at:to] = block
        at = to
    return JointCovariance(stage, names, matrix)


def covariance_document(known: JointCovariance | None) -> dict[str, Any] | None:
    """As result.json has it.

    Parameters
    ----------
    known : JointCovariance or None

    Returns
    -------
    dict or None
        `stage`, `names`, `matrix`.
    """
    if known is None:
        return None
    return {"stage": known.stage, "names": list(known.names), "matrix": known.matrix.tolist()}


def covariance_of(document: Mapping[str, Any]) -> JointCovariance | None:
    """The joint covariance that a result holds.

    Parameters
    ----------
    document : mapping
        A result, in the layout of docs/result.md.

    Returns
    -------
    JointCovariance or None
        None of a result that has none, as those of earlier versions.

    Raises
    ------
    InvalidInput
        Names and matrix do not belong together, or an entry is no finite number.
    """
    table = document.get("covariance")
    if table is None:
        return None
    try:
        names = tuple(str(name) for name in table["names"])
        matrix = np.array(table["matrix"], dtype=np.float64)
        stage = str(table["stage"])
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInput("covariance is incomplete", where="the result") from error
    if matrix.shape != (len(names), len(names)) or not np.isfinite(matrix).all():
        raise InvalidInput(
            f"covariance has {len(names)} names and a matrix of shape {matrix.shape}, "
            "or an entry that is no finite number",
            where="the result",
        )
    return JointCovariance(stage, names, matrix)


def _blocks(
    identification: Identification,
) -> tuple[str, Iterator[tuple[Sequence[Parameter], FloatArray]]]:
    """Parameters whose errors are correlated, group by group, of the last stage reached."""
    if identification.tuned is not None:
        tuned = identification.tuned
        return "tuned", iter([(tuned.parameters, tuned.covariance)])
    if identification.joints:
        return "decoupled", (
            (one.parameters, one.covariance[: len(one.parameters), : len(one.parameters)])
            for one in identification.joints
        )
    rigid = identification.rigid
    return "rigid", iter([(rigid.parameters, rigid.covariance)] if rigid is not None else [])


def _own(
    parameters: Sequence[Parameter], covariance: FloatArray, published: Mapping[str, Parameter]
) -> tuple[list[str], FloatArray] | None:
    """Names and covariance of those whose value and deviation are as published."""
    known = [
        k
        for k, p in enumerate(parameters)
        if k < len(covariance)
        and (other := published.get(p.label)) is not None
        and _same(p.value, other.value)
        and other.std is not None
        and _same(float(np.sqrt(max(covariance[k, k], 0.0))), other.std)
    ]
    if not known:
        return None
    return [parameters[k].label for k in known], covariance[np.ix_(known, known)]


def _same(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return False
    return bool(np.isfinite(other)) and abs(one - other) <= _ALIKE * max(abs(one), abs(other))
