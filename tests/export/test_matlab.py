"""MATLAB reads the same numbers from the MAT-file and from the script."""

from __future__ import annotations

import io
import math
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import exports
from strainwave.export import IdentifiedArm, state_space
from strainwave.export.flat import to_mat, to_script
from strainwave.export.linear_models import SIGNALS, linear_arm


@pytest.fixture
def arm(tmp_path: Path) -> IdentifiedArm:
    """The rig without friction offsets."""
    study = exports.two_links(tmp_path)
    arm = exports.arm_of(study, exports.values_of(study))
    offset = "friction_offset"
    nulled = [replace(p, value=None, std=None) if p.name == offset else p for p in arm.parameters]
    return replace(arm, parameters=tuple(nulled))


def test_the_mat_file_contains_all_numbers(arm: IdentifiedArm) -> None:
    content = loadmat(io.BytesIO(to_mat(arm).data), simplify_cells=True)
    for p in arm.parameters:
        name = p.name if p.joint is None else f"{p.name}_{p.joint}"
        for table, wanted in (("parameters", p.value), ("parameters_std", p.std)):
            found = content[table][name]
            assert found == wanted or (wanted is None and math.isnan(found)), name
        assert content["units"][name] == p.unit
    assert content["parameters"]["gear_ratio_2"] == 0.01
    for joint in (1, 2):
        for name, matrix in zip("ABCD", state_space(arm, joint), strict=True):
            np.testing.assert_array_equal(content["joints"][joint - 1][name], matrix)
    for key, names in SIGNALS.items():
        assert content[key].tolist() == list(names)


def test_both_files_note_what_they_leave_out(arm: IdentifiedArm) -> None:
    mat, script = to_mat(arm), to_script(arm)
    assert mat.notes == script.notes
    content = loadmat(io.BytesIO(mat.data), simplify_cells=True)
    assert list(content["notes"]) == list(mat.notes)
    assert "motor_coulomb_friction" in mat.notes[0]
    assert mat.notes[0].endswith("not in the matrices, but in the struct parameters")
    for note in script.notes:
        assert f"% {note[:1].upper()}{note[1:]}." in script.data.decode().splitlines()


def assigned(script: str, name: str, end: str = "") -> str:
    found = re.search(rf"^{re.escape(name)} = (.*?);{end}", script, re.MULTILINE | re.DOTALL)
    assert found is not None, name
    return found[1]


def matrix_of(text: str) -> list[list[float]]:
    return [[float(x) for x in row.split(",")] for row in text.strip("[]").split(";")]


def test_the_script_contains_the_same_numbers(arm: IdentifiedArm) -> None:
    script = to_script(arm).data.decode()
    for p in arm.parameters:
        name = p.name if p.joint is None else f"{p.name}_{p.joint}"
        found = float(assigned(script, f"parameters.{name}"))
        assert found == p.value or (p.value is None and math.isnan(found)), name
    for joint in (1, 2):
        for name, matrix in zip("ABCD", state_space(arm, joint), strict=True):
            assert matrix_of(assigned(script, f"joints({joint}).{name}", "\n")) == matrix.tolist()


def test_the_grey_box_function_gives_the_matrices(arm: IdentifiedArm) -> None:
    """Evaluated as Python with the parameters that the script lists."""
    script = to_script(arm).data.decode()
    names = re.search(r"= two_inertia\((.*)\)", script)
    assert names is not None
    listed = assigned(script, "grey(1).parameters", "\n").strip("{}").split(";")
    values = [float(pair.split(",")[1]) for pair in listed]
    ratio = float(assigned(script, "grey(1).args").strip("{}"))
    symbols = dict(zip(names[1].split(", "), [*values, 0.0, ratio], strict=True))
    found: dict[str, list[list[float]]] = {}
    for name in "ABCD":
        rows = assigned(script[names.end() :], name, "\n").strip("[]").split(";")
        found[name] = [row_of(row, symbols, found) for row in rows]
    for name, wanted in zip("ABCD", state_space(arm, 1), strict=True):
        assert np.array(found[name]) == pytest.approx(wanted, rel=1e-14)


def row_of(
    text: str, symbols: dict[str, float], found: dict[str, list[list[float]]]
) -> list[float]:
    """A row of a MATLAB matrix: expressions, or the third row of an earlier matrix."""
    reference = re.fullmatch(r"\s*([AB])\(3, :\)\s*", text)
    if reference:
        return found[reference[1]][2]
    python = text.replace("...", "").replace("^", "**")
    return [eval(cell.strip(), {}, dict(symbols)) for cell in python.split(",")]


@pytest.fixture(scope="module")
def octave() -> str:
    found = shutil.which("octave-cli") or shutil.which("octave")
    if found is None:
        pytest.skip("GNU Octave is not installed")
    asked = "disp(numel(pkg('list', 'control')))"
    done = subprocess.run([found, "--eval", asked], capture_output=True, text=True, check=False)
    if done.stdout.strip() != "1":
        pytest.skip("GNU Octave's control package is not installed")
    return found


_ASKED = """\
arm_model
for i = 1:numel(sys)
  [A, B, C, D] = grey(i).function(grey(i).parameters{:, 2}, 0, grey(i).args{:});
  H = freqresp(sys{i}, [1, 50, 300]);
  said(i) = struct('A', sys{i}.a, 'B', sys{i}.b, 'C', sys{i}.c, 'D', sys{i}.d, 'inputs', ...
    {sys{i}.inname}, 'off', norm([A, B; C, D] - [sys{i}.a, sys{i}.b; sys{i}.c, sys{i}.d]), ...
    'real', real(H), 'imag', imag(H));
end
save('-7', 'said.mat', 'said', 'parameters')
"""


def test_octave_runs_the_script(octave: str, arm: IdentifiedArm, tmp_path: Path) -> None:
    (tmp_path / "arm_model.m").write_bytes(to_script(arm).data)
    done = subprocess.run(
        [octave, "--eval", _ASKED], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    content = loadmat(tmp_path / "said.mat", simplify_cells=True)
    assert math.isnan(content["parameters"]["friction_offset_1"])
    assert content["parameters"]["gear_stiffness_2"] == arm.values["gear_stiffness", 2]
    for joint, said in enumerate(content["said"], start=1):
        A, B, C, D = state_space(arm, joint)
        for name, matrix in zip("ABCD", (A, B, C, D), strict=True):
            np.testing.assert_array_equal(said[name], matrix)
        assert said["inputs"].tolist() == list(SIGNALS["inputs"])
        # sums and quotients in another order
        assert said["off"] <= 1e-12 * np.linalg.norm(A)
        for k, omega in enumerate((1.0, 50.0, 300.0)):
            wanted = C @ np.linalg.solve(1j * omega * np.eye(3) - A, B) + D
            found = said["real"][..., k] + 1j * said["imag"][..., k]
            np.testing.assert_allclose(found, wanted, rtol=1e-8)


def test_both_files_contain_the_whole_arm(tmp_path: Path) -> None:
    """Joints behind rigid gears have no model of their own."""
    arm = exports.arm_of(*exports.chain(tmp_path, ("linear", "rigid", "linear")))
    content = loadmat(io.BytesIO(to_mat(arm).data), simplify_cells=True)
    script, wanted = to_script(arm).data.decode(), linear_arm(arm)
    for name, matrix in wanted.matrices.items():
        np.testing.assert_array_equal(content["whole_arm"][name], matrix)
        assert matrix_of(assigned(script, f"whole_arm.{name}", "\n")) == matrix.tolist()
    assert content["whole_arm"]["states"].tolist() == list(wanted.states)
    assert [np.size(model["A"]) for model in content["joints"]] == [9, 0, 9]
    assert re.findall(r"^sys\{(\d)\} =", script, re.MULTILINE) == ["1", "3"]
