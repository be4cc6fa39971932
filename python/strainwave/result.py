"""Identification -> result.json."""

from __future__ import annotations

import json
import math
from typing import Any

from strainwave.records import Caution, Identification, Parameter, RigidModel

SCHEMA = "strainwave/result/1"


def to_document(identification: Identification) -> dict[str, Any]:
    """The result as plain JSON values, in the layout of docs/result.md.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    dict
        Only dict, list, str, bool, int, finite float and None.
    """
    stages: dict[str, Any] = {}
    if identification.rigid is not None:
        stages["rigid"] = _rigid(identification.rigid)
    document = {
        "schema": SCHEMA,
        "version": identification.version,
        "study": {"path": str(identification.study.path), "sha256": identification.study.sha256},
        "created": identification.created,
        "status": "determined" if identification.determined else "not-identifiable",
        "reason": identification.reason,
        "parameters": [_parameter(p) for p in identification.parameters],
        "stages": stages,
        "checks": [
            {"experiment": check.experiment, "fit_percent": dict(check.fit_percent)}
            for check in identification.checks
        ],
        "warnings": [_warning(w) for w in identification.warnings],
        "timing_s": dict(identification.timing_s),
    }
    finite: dict[str, Any] = _finite(document)
    return finite


def to_json(identification: Identification) -> bytes:
    """`to_document` as UTF-8 text that ends with a newline."""
    text = json.dumps(to_document(identification), indent=2, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()


def _rigid(model: RigidModel) -> dict[str, Any]:
    return {
        "status": model.status,
        "parameters": [_parameter(p) for p in model.parameters],
        "fit_percent": {name: dict(fits) for name, fits in model.fit_percent.items()},
        "condition_number": model.condition_number,
        "bandwidth_hz": model.bandwidth_hz,
        "decimation": model.decimation,
        "n_rows": model.n_rows,
    }


def _parameter(parameter: Parameter) -> dict[str, Any]:
    return {
        "name": parameter.name,
        "joint": parameter.joint,
        "value": parameter.value,
        "std": parameter.std,
        "ci95": list(parameter.ci95) if parameter.ci95 is not None else None,
        "unit": parameter.unit,
        "stage": parameter.stage,
    }


def _warning(warning: Caution) -> dict[str, str]:
    return {"code": warning.code, "where": warning.where, "message": warning.message}


def _finite(value: Any) -> Any:
    """Numbers that JSON can hold; what is not finite could not be told, and is null."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float):  # also NumPy's float64
        return float(value) if math.isfinite(value) else None
    return value
