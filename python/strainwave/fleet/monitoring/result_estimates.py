"""Estimates of one result with their joint covariance, for comparisons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from strainwave.domain import Parameter
from strainwave.domain.arm.link_sensors import ConstantKind, is_kind
from strainwave.domain.arm.parameter_table import record_of
from strainwave.domain.results.distributions import CI95_STDS, student_degrees
from strainwave.errors import InvalidInput
from strainwave.io import results
from strainwave.io.joint_covariance import JointCovariance

_USUAL_NAMES = ("result.json", "study.toml")  # files whose folder is a better label
_QUANTILE_TOLERANCE = 1e-3  # beyond it an interval is Student's; nu is then below about 2,400


@dataclass(frozen=True, slots=True, eq=False)
class ResultEstimates:
    """Parameters and joint covariance of one result."""

    label: str
    path: str
    created: str
    status: str
    study: tuple[str, str]  # path and SHA-256
    parameters: tuple[Parameter, ...]
    covariance: JointCovariance | None

    def of(self, label: str) -> Parameter:
        """A parameter by name and joint, as in the verdict."""
        return next(p for p in self.parameters if p.label == label)


def read_estimates(paths: Sequence[Path]) -> tuple[ResultEstimates, ...]:
    """Read results from result.json files or directories that contain one.

    Labels are unique. Raises `InvalidInput` for fewer than two paths, or a file that is missing or
    is not a result.
    """
    if len(paths) < 2:
        raise InvalidInput(
            "a comparison needs two results", remedy="give at least two result.json files"
        )
    files = map(results.result_path, paths)
    estimates = [estimates_of(results.read_document(path), path) for path in files]
    labels = [one.label for one in estimates]
    return tuple(
        one if labels.count(one.label) == 1 else replace(one, label=one.path) for one in estimates
    )


def estimates_of(document: Mapping[str, Any], path: Path) -> ResultEstimates:
    """Estimates of a result document that was read from `path`.

    Parameters of one record, such as the drift of a sensor bias, are omitted.
    """
    study = document.get("study") or {}
    return ResultEstimates(
        label=path.parent.name if path.name in _USUAL_NAMES and path.parent.name else path.name,
        path=str(path),
        created=str(document.get("created", "")),
        status=str(document.get("status", "")),
        study=(str(study.get("path", "")), str(study.get("sha256", ""))),
        parameters=tuple(
            p for p in results.parameters_of(document, str(path)) if not is_record_parameter(p.name)
        ),
        covariance=results.covariance_of(document, str(path)),
    )


def is_record_parameter(name: str) -> bool:
    """Whether a parameter describes one record instead of the arm."""
    return bool(record_of(name)) or is_kind((name, None), ConstantKind.DRIFT)


def degrees_of_freedom(parameter: Parameter) -> float:
    """Degrees of freedom of a standard deviation, from the width of its 95 % interval.

    The rigid stage estimates variances from few segments of motion and gives Student's intervals.
    Infinite if the interval is that of a normal distribution, or missing.
    """
    if parameter.ci95 is None or not parameter.std:
        return float("inf")
    quantile = 0.5 * (parameter.ci95[1] - parameter.ci95[0]) / parameter.std
    if quantile <= CI95_STDS + _QUANTILE_TOLERANCE:
        return float("inf")
    return max(1.0, student_degrees(quantile))
