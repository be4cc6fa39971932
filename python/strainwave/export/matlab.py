"""MATLAB: a .mat file of numbers, and a script that makes `ss` and `idgrey` models."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.dynamics.two_inertia import NAMES
from strainwave.export.flat import entries
from strainwave.export.omissions import CORRELATIONS, Part, names_of, notes_of, sentence_of
from strainwave.export.source import Export, IdentifiedArm
from strainwave.export.state_space import (
    INPUTS,
    OMISSIONS,
    OUTPUTS,
    STATES,
    joint_model,
    linearised,
    state_space,
)
from strainwave.io.templates import fill_text

_UNKNOWN = float("nan")
_ELSEWHERE = (Part.SERVO, Part.UNCERTAINTY)  # not among the numbers of the file either


def to_mat(arm: IdentifiedArm) -> Export:
    """MAT-file with structs `parameters`, `parameters_std`, `units`, and `joints` with A, B, C, D.

    Raises `InvalidInput` if a gear is rigid or a parameter of the models is missing.
    """
    from scipy.io import savemat

    all_entries = entries(arm)
    content: dict[str, Any] = {
        "parameters": {e.name: _UNKNOWN if e.value is None else e.value for e in all_entries},
        "parameters_std": {
            e.name: _UNKNOWN if e.std is None else e.std for e in all_entries if not e.known
        },
        "units": {e.name: e.unit for e in all_entries},
        "joints": _joints(arm),
        "states": np.array(STATES, dtype=object),
        "inputs": np.array(INPUTS, dtype=object),
        "outputs": np.array(OUTPUTS, dtype=object),
        "notes": np.array(_notes(arm), dtype=object),
    }
    file = io.BytesIO()
    savemat(file, content, long_field_names=True, oned_as="column")
    return Export(file.getvalue(), linearised(arm), _notes(arm))


def _joints(arm: IdentifiedArm) -> FloatArray:
    """A struct array, one element per joint."""
    fields = [(name, object) for name in "ABCD"]
    array = np.zeros(arm.study.arm.n_joints, dtype=fields)
    for i in range(arm.study.arm.n_joints):
        for name, matrix in state_space(arm, i + 1)._asdict().items():
            array[name][i] = matrix
    return array


def _notes(arm: IdentifiedArm) -> tuple[str, ...]:
    """Notes on parts that the matrices neglect and parts that the file omits."""
    neglected = names_of(arm, [part for part in OMISSIONS if part not in _ELSEWHERE])
    matrices = f"not in the matrices: {neglected}: the struct parameters contains the values"
    servo = notes_of(arm, {Part.SERVO: "the study file has its gains"})
    return (matrices, *servo, CORRELATIONS)


def to_script(arm: IdentifiedArm) -> Export:
    """Script with structs `parameters`, `parameters_std`, and per joint `sys{i}` and `grey(i)`.

    Raises `InvalidInput` if a gear is rigid or a parameter of the models is missing.
    """
    numbers = range(1, arm.study.arm.n_joints + 1)
    models = [joint_model(arm, number) for number in numbers]
    text = fill_text(
        Path(__file__).with_name("arm.m.j2"),
        entries=entries(arm),
        joints=[
            ({name: getattr(model, name) for name in NAMES}, state_space(arm, number)._asdict())
            for number, model in zip(numbers, models, strict=True)
        ],
        gear_ratios=[model.gear_ratio for model in models],
        states=STATES,
        inputs=INPUTS,
        outputs=OUTPUTS,
        notes=_notes(arm),
        matrix=_matrix,
        names=_names,
        number=lambda value: "NaN" if value is None else repr(value),
        sentence_of=sentence_of,
    )
    return Export(text.encode(), linearised(arm), _notes(arm))


def _matrix(matrix: FloatArray) -> str:
    rows = (", ".join(repr(float(x)) for x in row) for row in matrix)
    return f"[{'; '.join(rows)}]"


def _names(names: tuple[str, ...]) -> str:
    return "{" + ", ".join(f"'{name}'" for name in names) + "}"
