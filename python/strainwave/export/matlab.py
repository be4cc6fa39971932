"""MATLAB: a .mat file of numbers, and a script that makes `ss` and `idgrey` models."""

from __future__ import annotations

import io
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

_UNKNOWN = float("nan")
_ELSEWHERE = (Part.SERVO, Part.UNCERTAINTY)  # not among the numbers of the file either

_GREY_MODEL = """\
function [A, B, C, D] = two_inertia(m_M, d_M, m_L, d_L, k, d_G, Ts, n)
% One joint: motor, gear and link. Ts is 0: the model is in continuous time.
A = [0, n, -1; ...
     -n*k/m_M, -(d_M + n^2*d_G)/m_M, n*d_G/m_M; ...
     k/m_L, n*d_G/m_L, -(d_L + d_G)/m_L];
B = [0, 0; 1/m_M, 0; 0, 1/m_L];
C = [0, 1, 0; A(3, :)];
D = [0, 0; B(3, :)];
end
"""


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
    lines = [
        "% An arm with elastic joints, identified by strainwave. SI units, angles in rad.",
        *(f"% {sentence_of(note)}" for note in _notes(arm)),
        "% sys{i} is the model of joint i alone; refine it on your own data with",
        "%   greyest(data, idgrey(grey(i).function, grey(i).parameters, 'c', grey(i).args))",
        "if exist('OCTAVE_VERSION', 'builtin'), pkg load control, end % ss in GNU Octave",
        "",
    ]
    for entry in entries(arm):
        unit = " ".join(entry.unit.split())  # a line end would end the comment
        lines.append(f"parameters.{entry.name} = {_number(entry.value)}; % [{unit}]")
        if not entry.known:
            lines.append(f"parameters_std.{entry.name} = {_number(entry.std)};")
    for number in range(1, arm.study.arm.n_joints + 1):
        lines += ["", *_joint_lines(arm, number)]
    text = "\n".join(lines) + "\n\n" + _GREY_MODEL
    return Export(text.encode(), linearised(arm), _notes(arm))


def _joint_lines(arm: IdentifiedArm, number: int) -> list[str]:
    """`ss` model of one joint, and the arguments of `idgrey`."""
    model = joint_model(arm, number)
    index = f"({number})"
    parameter_list = "; ".join(f"'{name}', {getattr(model, name)!r}" for name in NAMES)
    matrices = state_space(arm, number)._asdict().items()
    return [
        f"% joint {number}",
        *(f"joints{index}.{name} = {_matrix(matrix)};" for name, matrix in matrices),
        f"sys{{{number}}} = ss({', '.join(f'joints{index}.{name}' for name in 'ABCD')}, ...",
        f"    'StateName', {_names(STATES)}, ...",
        f"    'InputName', {_names(INPUTS)}, ...",
        f"    'OutputName', {_names(OUTPUTS)});",
        f"grey{index}.function = @two_inertia;",
        f"grey{index}.parameters = {{{parameter_list}}};",
        f"grey{index}.args = {{{model.gear_ratio!r}}};",
    ]


def _number(value: float | None) -> str:
    return "NaN" if value is None else repr(value)


def _matrix(matrix: FloatArray) -> str:
    rows = (", ".join(repr(float(x)) for x in row) for row in matrix)
    return f"[{'; '.join(rows)}]"


def _names(names: tuple[str, ...]) -> str:
    return "{" + ", ".join(f"'{name}'" for name in names) + "}"
