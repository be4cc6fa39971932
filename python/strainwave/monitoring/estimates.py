"""Results as what is compared: each parameter's estimate, and how their errors go together."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from strainwave.domain import Parameter
from strainwave.errors import InvalidInput
from strainwave.io import results
from strainwave.io.joint_covariance import JointCovariance, covariance_of

_USUAL_NAMES = ("result.json", "study.toml")  # the folder says more
_OF_ONE_RECORD = re.compile(r".*_drift|.*\[.*\]")
_NORMAL = 1.96  # deviations of 95 %, as the intervals of the whole-arm fit have it


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """What one result says of an arm."""

    label: str
    path: str
    created: str
    status: str
    study: tuple[str, str]  # path and hash
    parameters: tuple[Parameter, ...]
    covariance: JointCovariance | None

    def of(self, label: str) -> Parameter:
        """One parameter by name with joint."""
        return next(p for p in self.parameters if p.label == label)


def read_estimates(paths: Sequence[Path]) -> tuple[Estimates, ...]:
    """Results to compare.

    Parameters
    ----------
    paths : sequence of Path
        result.json files, or directories that hold one.

    Returns
    -------
    tuple of Estimates
        With labels that distinguish them.

    Raises
    ------
    InvalidInput
        Fewer than two, or one that is missing or no result.
    """
    if len(paths) < 2:
        raise InvalidInput("a comparison needs two results", remedy="name two result.json or more")
    read = [_read(path / "result.json" if path.is_dir() else path) for path in paths]
    labels = [one.label for one in read]
    return tuple(
        one if labels.count(one.label) == 1 else replace(one, label=one.path) for one in read
    )


def estimates_of(document: Mapping[str, Any], path: Path) -> Estimates:
    """What a result's document says.

    Parameters
    ----------
    document : mapping
        In the layout of docs/result.md.
    path : Path
        Where it was read from.

    Returns
    -------
    Estimates
        Without what describes one record only, as the drift of a sensor's bias in it.

    Raises
    ------
    InvalidInput
        A part is incomplete.
    """
    study = document.get("study") or {}
    return Estimates(
        label=path.parent.name if path.name in _USUAL_NAMES and path.parent.name else path.name,
        path=str(path),
        created=str(document.get("created", "")),
        status=str(document.get("status", "")),
        study=(str(study.get("path", "")), str(study.get("sha256", ""))),
        parameters=tuple(p for p in results.parameters_of(document) if not of_one_record(p.name)),
        covariance=covariance_of(document),
    )


def of_one_record(name: str) -> bool:
    """Whether a parameter describes one record and not the arm, as a sensor's drift does.

    Parameters
    ----------
    name : str

    Returns
    -------
    bool
    """
    return _OF_ONE_RECORD.fullmatch(name) is not None


def degrees_of(parameter: Parameter) -> float:
    """Degrees of freedom behind a standard deviation, by how far its 95 % interval reaches.

    The rigid stage knows a variance from few stretches of motion, and its intervals are Student's.

    Parameters
    ----------
    parameter : Parameter

    Returns
    -------
    float
        Infinite where the interval is a normal variable's, or there is none.
    """
    if parameter.ci95 is None or not parameter.std:
        return float("inf")
    reach = 0.5 * (parameter.ci95[1] - parameter.ci95[0]) / parameter.std
    return _degrees(round(reach, 6))


@cache
def _degrees(reach: float) -> float:
    """Degrees at which Student's 97.5 % quantile is so many deviations."""
    from scipy.optimize import brentq
    from scipy.stats import t

    if reach <= _NORMAL + 1e-3:
        return float("inf")
    if reach >= t.ppf(0.975, 1.0):
        return 1.0
    return float(brentq(lambda nu: t.ppf(0.975, nu) - reach, 1.0, 1e5))


def _read(path: Path) -> Estimates:
    try:
        return estimates_of(results.read_document(path), path)
    except InvalidInput as error:
        if error.where != "the result":
            raise
        raise InvalidInput(error.problem, where=str(path), remedy=error.remedy) from error
