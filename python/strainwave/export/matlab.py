"""For MATLAB: a .mat file of numbers, and a script that makes `ss` and `idgrey` models of them."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.dynamics.two_inertia import NAMES
from strainwave.export.flat import entries
from strainwave.export.source import Export, IdentifiedArm
from strainwave.export.state_space import (
    INPUTS,
    OUTPUTS,
    STATES,
    joint_model,
    linearised,
    state_space,
)

_UNKNOWN = float("nan")  # MATLAB's missing number

_GREY_MODEL = """\
function [A, B, C, D] = two_inertia(m_M, d_M, m_L, d_L, k, d_G, Ts, n)
% One joint: motor, gear and link. Ts is 0, the model is one of continuous time.
A = [0, n, -1; ...
     -n*k/m_M, -(d_M + n^2*d_G)/m_M, n*d_G/m_M; ...
     k/m_L, n*d_G/m_L, -(d_L + d_G)/m_L];
B = [0, 0; 1/m_M, 0; 0, 1/m_L];
C = [0, 1, 0; A(3, :)];
D = [0, 0; B(3, :)];
end
"""


def to_mat(arm: IdentifiedArm) -> Export:
    """Structs `parameters`, `parameters_std`, `units` by name; `joints` with A, B, C, D; names.

    Parameters
    ----------
    arm : IdentifiedArm

    Returns
    -------
    Export

    Raises
    ------
    InvalidInput
        A gear is rigid, or a parameter of the joints' models is null or impossible.
    """
    from scipy.io import savemat

    listed = entries(arm)
    content: dict[str, Any] = {
        "parameters": {e.name: _UNKNOWN if e.value is None else e.value for e in listed},
        "parameters_std": {
            e.name: _UNKNOWN if e.std is None else e.std for e in listed if not e.known
        },
        "units": {e.name: e.unit for e in listed},
        "joints": _joints(arm),
        "states": np.array(STATES, dtype=object),
        "inputs": np.array(INPUTS, dtype=object),
        "outputs": np.array(OUTPUTS, dtype=object),
    }
    file = io.BytesIO()
    savemat(file, content, long_field_names=True, oned_as="column")
    return Export(file.getvalue(), linearised(arm))


def _joints(arm: IdentifiedArm) -> FloatArray:
    """A struct array, one element a joint."""
    fields = [(name, object) for name in "ABCD"]
    array = np.zeros(arm.study.arm.n_joints, dtype=fields)
    for i in range(arm.study.arm.n_joints):
        for name, matrix in zip("ABCD", state_space(arm, i + 1), strict=True):
            array[name][i] = matrix
    return array


def to_script(arm: IdentifiedArm) -> Export:
    """A script that stands alone: `parameters`, `parameters_std`; per joint `sys{i}`, `grey(i)`.

    Parameters
    ----------
    arm : IdentifiedArm

    Returns
    -------
    Export

    Raises
    ------
    InvalidInput
        A gear is rigid, or a parameter of the joints' models is null or impossible.
    """
    lines = [
        "% An arm with elastic joints, identified by strainwave. SI units, angles in rad.",
        "% sys{i} is joint i on its own; refine it on your own data with",
        "%   greyest(data, idgrey(grey(i).function, grey(i).parameters, 'c', grey(i).args))",
        "if exist('OCTAVE_VERSION', 'builtin'), pkg load control, end % Octave's ss",
        "",
    ]
    for entry in entries(arm):
        unit = " ".join(entry.unit.split())  # one line, or it would end the comment
        lines.append(f"parameters.{entry.name} = {_number(entry.value)}; % [{unit}]")
        if not entry.known:
            lines.append(f"parameters_std.{entry.name} = {_number(entry.std)};")
    for number in range(1, arm.study.arm.n_joints + 1):
        lines += ["", *_joint_lines(arm, number)]
    text = "\n".join(lines) + "\n\n" + _GREY_MODEL
    return Export(text.encode(), linearised(arm))


def _joint_lines(arm: IdentifiedArm, number: int) -> list[str]:
    """`ss` of one joint, and what `idgrey` takes for it."""
    model = joint_model(arm, number)
    at = f"({number})"
    listed = "; ".join(f"'{name}', {getattr(model, name)!r}" for name in NAMES)
    matrices = zip("ABCD", state_space(arm, number), strict=True)
    return [
        f"% joint {number}",
        *(f"joints{at}.{name} = {_matrix(matrix)};" for name, matrix in matrices),
        f"sys{{{number}}} = ss(joints{at}.A, joints{at}.B, joints{at}.C, joints{at}.D, ...",
        f"    'StateName', {_names(STATES)}, ...",
        f"    'InputName', {_names(INPUTS)}, ...",
        f"    'OutputName', {_names(OUTPUTS)});",
        f"grey{at}.function = @two_inertia;",
        f"grey{at}.parameters = {{{listed}}};",
        f"grey{at}.args = {{{model.gear_ratio!r}}};",
    ]


def _number(value: float | None) -> str:
    return "NaN" if value is None else repr(value)


def _matrix(matrix: FloatArray) -> str:
    rows = (", ".join(repr(float(x)) for x in row) for row in matrix)
    return f"[{'; '.join(rows)}]"


def _names(names: tuple[str, ...]) -> str:
    return "{" + ", ".join(f"'{name}'" for name in names) + "}"
