"""Results of one synthetic arm with errors from a known covariance."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.fleet.monitoring.comparison import ResultEstimates, estimates_of

NAMES = ("beta", "gear_stiffness 1", "motor_inertia 1", "motor_viscous_friction 1", "sum 1")
TRUE = np.array([0.64, 25000.0, 1.5e-4, 2e-4])
STD = np.array([1e-3, 50.0, 1e-6, 4e-6])


def covariance(rng: np.random.Generator) -> FloatArray:
    """Singular covariance of four parameters and one that depends on two of them."""
    mixed = rng.normal(size=(4, 4)) + np.eye(4)
    four = mixed @ mixed.T
    scale = STD / np.sqrt(np.diag(four))
    W = np.vstack([np.eye(4), [0.0, 0.0, 1.0, 0.25]])
    return np.asarray(W @ (four * np.outer(scale, scale)) @ W.T)


def drawn(
    rng: np.random.Generator, S: FloatArray, change: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """A result with Gaussian errors. `change` holds factors of the true values."""
    factors = np.array([(change or {}).get(name, 1.0) for name in NAMES[:4]])
    error = np.linalg.cholesky(S[:4, :4]) @ rng.normal(size=4)
    four = TRUE * factors + error
    values = [*four.tolist(), float(four[2] + 0.25 * four[3])]
    return document(values, S)


def document(values: list[float], S: FloatArray) -> dict[str, Any]:
    """A result.json with these values."""
    parameters = []
    for name, value, std in zip(NAMES, values, np.sqrt(np.diag(S)).tolist(), strict=True):
        word, _, joint = name.partition(" ")
        parameters.append(
            {
                "name": word,
                "joint": int(joint) if joint else None,
                "value": value,
                "std": std,
                "ci95": [value - 1.96 * std, value + 1.96 * std],
                "unit": "N m/rad" if "stiffness" in word else "kg m^2",
                "stage": "tuned",
            }
        )
    return {
        "schema": "strainwave/result/1",
        "created": "2026-01-01T00:00:00+00:00",
        "status": "determined",
        "study": {"path": "study.toml", "sha256": ""},
        "parameters": parameters,
        "covariance": {"stage": "tuned", "names": list(NAMES), "matrix": S.tolist()},
    }


def estimates(document: Mapping[str, Any], label: str) -> ResultEstimates:
    return estimates_of(document, Path(label) / "result.json")


def write(document: Mapping[str, Any], folder: Path) -> Path:
    """Write the result to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text(json.dumps(document), encoding="utf-8")
    return folder
