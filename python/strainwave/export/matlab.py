"""MATLAB: a .mat file of numbers, and a script that makes `ss` and `idgrey` models."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.dynamics.two_inertia import NAMES
from strainwave.export.flat import entries
from strainwave.export.omissions import CORRELATIONS, ERRORS, LINEAR, omission_note, sentence_of
from strainwave.export.source import Export, IdentifiedArm
from strainwave.export.state_space import (
    INPUTS,
    OUTPUTS,
    STATES,
    Matrices,
    joint_model,
    linearised,
    models_of,
)
from strainwave.io.templates import fill_text

_UNKNOWN = float("nan")


def to_mat(arm: IdentifiedArm) -> Export:
    """MAT-file with structs `parameters`, `parameters_std`, `units`, and the models.

    `joints` has A, B, C, D of each joint, empty for a joint without model, `whole_arm` those of the
    arm. Errors as for `models_of`.
    """
    from scipy.io import savemat

    joints, whole_arm = models_of(arm)
    all_entries = entries(arm)
    content: dict[str, Any] = {
        "parameters": {e.name: _UNKNOWN if e.value is None else e.value for e in all_entries},
        "parameters_std": {
            e.name: _UNKNOWN if e.std is None else e.std for e in all_entries if not e.known
        },
        "units": {e.name: e.unit for e in all_entries},
        "joints": _joints(arm.study.arm.n_joints, joints),
        "states": np.array(STATES, dtype=object),
        "inputs": np.array(INPUTS, dtype=object),
        "outputs": np.array(OUTPUTS, dtype=object),
        "notes": np.array(_notes(arm), dtype=object),
    }
    names = ("states", "inputs", "outputs")
    arrays = {key: np.array(getattr(whole_arm, key), dtype=object) for key in names}
    content["whole_arm"] = whole_arm.matrices | arrays
    file = io.BytesIO()
    savemat(file, content, long_field_names=True, oned_as="column")
    return Export(file.getvalue(), linearised(arm), _notes(arm))


def _joints(count: int, models: Mapping[int, Matrices]) -> FloatArray:
    array = np.zeros(count, dtype=[(name, object) for name in "ABCD"])
    for i in range(count):
        for name in "ABCD":
            array[name][i] = getattr(models.get(i + 1), name, np.zeros((0, 0)))
    return array


def _notes(arm: IdentifiedArm) -> tuple[str, ...]:
    omitted = omission_note(arm, (*LINEAR, "servo", ERRORS))
    matrices = (f"{note}: not in the matrices, but in the struct parameters" for note in omitted)
    return (*arm.assumptions, *matrices, CORRELATIONS)


def to_script(arm: IdentifiedArm) -> Export:
    """Script with structs `parameters`, `parameters_std`, and models.

    They are `sys{i}` and `grey(i)` of each joint with a model of its own, and `sys_arm` of the
    whole arm. Errors as for `models_of`.
    """
    models, whole_arm = models_of(arm)
    joints = []
    for number, matrices in models.items():
        model = joint_model(arm, number)
        values = {name: getattr(model, name) for name in NAMES}
        joints.append((number, values, model.gear_ratio, matrices._asdict()))
    text = fill_text(
        Path(__file__).with_name("arm.m.j2"),
        entries=entries(arm),
        joints=joints,
        whole_arm=whole_arm,
        states=STATES,
        inputs=INPUTS,
        outputs=OUTPUTS,
        notes=_notes(arm),
        matrix=_matrix,
        names=lambda names: "{" + ", ".join(f"'{name}'" for name in names) + "}",
        number=lambda value: "NaN" if value is None else repr(value),
        sentence_of=sentence_of,
    )
    return Export(text.encode(), linearised(arm), _notes(arm))


def _matrix(matrix: FloatArray) -> str:
    rows = (", ".join(repr(float(x)) for x in row) for row in matrix)
    return f"[{'; '.join(rows)}]"
