"""Parameter files: values by name and joint, from a result.json or a JSON table."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from strainwave.domain.arm import gear_laws
from strainwave.domain.keys import Values
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import read_json
from strainwave.io.base_parameters import standard_key
from strainwave.io.results import noise_of, parameters_of, rigid_model_of


def read_parameters(path: Path) -> Values:
    """Read parameter values: (name, joint) -> value in SI units.

    The file has one of two layouts. The list of a result.json,

        {"parameters": [{"name": "beta", "joint": null, "value": 0.64}, ...]}

    without its null values, and with the `standard_parameters` of a serial arm; or the table

        {"alpha": 1.6, "joints": [{"motor_inertia": 1.5e-4, "gear_stiffness": [25000.0]}, ...]}

    in which `gear_stiffness` is a number, [K] or [K1, K2, K3] with `gear_knee_torque` [T1, T2]; the
    gear law defines its lists.
    """
    document = _document(path)
    if isinstance(document, dict) and isinstance(document.get("parameters"), list):
        standard = document.get("standard_parameters") or {}
        return _from_list(document["parameters"], path) | _standard(standard, path)
    if isinstance(document, dict) and isinstance(document.get("joints"), list):
        return _from_table(document, path)
    raise InvalidInput(
        'contains neither a list "parameters" nor a list "joints"',
        where=str(path),
        remedy="use a result.json, or see the layout in docs/notation.md",
    )


def parameter_file(values: Values) -> bytes:
    """Values as a file that `read_parameters` reads."""
    entries = [{"name": key[0], "joint": key[1], "value": value} for key, value in values.items()]
    return json.dumps({"parameters": entries}, indent=1).encode()


def read_torque_errors(path: Path) -> dict[int, float]:
    """Errors of the joints' torques over their rms values, as the rigid step of a result has them.

    Empty for other parameter files and for results of earlier versions.
    """
    document = _document(path)
    return dict(noise_of(document, str(path)).torques) if isinstance(document, dict) else {}


def read_assumptions(path: Path) -> Values:
    """Values of the rigid model for parameters that a result does not identify.

    They are the least-squares solution of smallest norm; empty for other parameter files.
    """
    document = _document(path)
    if not isinstance(document, dict) or not isinstance(document.get("stages"), dict):
        return {}
    rigid = document["stages"].get("rigid")
    columns = parameters_of(rigid if isinstance(rigid, dict) else {}, str(path))
    model = rigid_model_of(document, len(columns))
    if model is None:
        return {}
    missing = {p.key for p in parameters_of(document, str(path)) if p.value is None}
    solution = zip(columns, model.solution.tolist(), strict=True)
    return {p.key: value for p, value in solution if p.key in missing}


def _document(path: Path) -> Any:
    return read_json(path, "the file of parameters", "use a result.json or a parameter file")


def _from_list(entries: list[Any], path: Path) -> Values:
    values: Values = {}
    for number, entry in enumerate(entries, start=1):
        place = f"{path}: parameters, entry {number}"
        if not isinstance(entry, dict) or not isinstance(entry.get("name"), str):
            raise InvalidInput(
                "has no name", where=place, remedy='write {"name": ..., "value": ...}'
            )
        joint = entry.get("joint")
        if joint is not None and (not isinstance(joint, int) or isinstance(joint, bool)):
            raise InvalidInput(
                f"the joint is {joint!r}, not a number", where=place, remedy="use 1, 2 or null"
            )
        if entry.get("value") is not None:
            values[entry["name"], joint] = _number(entry["value"], place)
    return values


def _standard(entries: Any, path: Path) -> Values:
    """Links and motors of a serial arm, of which the list has combinations."""
    place = f"{path}: standard_parameters"
    if not isinstance(entries, dict):
        raise InvalidInput("is not a table", where=place, remedy='write {"m1": ..., ...}')
    values: Values = {}
    for name, value in entries.items():
        key = standard_key(name)
        if key is None:
            raise InvalidInput(
                f"{name!r} is not a standard parameter",
                where=place,
                remedy="use names such as m1, mx1, Ixx1 and motor_inertia1",
            )
        values[key] = _number(value, place)
    return values


def _from_table(document: Mapping[str, Any], path: Path) -> Values:
    values: Values = {}
    for key, value in document.items():
        if key != "joints":
            values[key, None] = _number(value, f"{path}: {key}")
    for joint, table in enumerate(document["joints"], start=1):
        place = f"{path}: joints, entry {joint}"
        if not isinstance(table, dict):
            raise InvalidInput(
                "is not a table", where=place, remedy="write {...} with the values of this joint"
            )
        for key, value in table.items():
            for name, entry in _names(key, value, place).items():
                values[name, joint] = _number(entry, f"{place}: {name}")
    return values


def _names(key: str, value: Any, place: str) -> dict[str, Any]:
    """The parameters that one key of the table gives."""
    if not isinstance(value, list):
        return {key: value}
    known = gear_laws.lists()
    names = known.get(key, {}).get(len(value))
    if names is not None:
        return dict(zip(names, value, strict=True))
    counts = [" or ".join(map(str, sorted(of_length))) for of_length in known.values()]
    lengths = [f"{name} takes {count}" for name, count in zip(known, counts, strict=True)]
    lengths[0] += " values"
    raise InvalidInput(
        f"{key} has {len(value)} values",
        where=place,
        remedy=f"{', '.join(lengths)}, all others one number",
    )


def _number(value: Any, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InvalidInput(
            f"{value!r} is not a finite number", where=place, remedy="write a number"
        )
    return float(value)
