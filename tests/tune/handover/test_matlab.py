"""The MATLAB script has the numbers of the design."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import FloatArray
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover.texts import to_script


def matrix_of(script: str, name: str) -> FloatArray:
    found = re.search(rf"^{re.escape(name)} = \[(.*)\];", script, re.MULTILINE)
    assert found is not None, name
    return np.array([[float(x) for x in row.split(",")] for row in found[1].split(";")])


def test_the_script_has_matrices_filters_and_shaper(filtered: ServoDesign) -> None:
    script = to_script(filtered)
    assert f"Ts = {filtered.clock.period!r};" in script
    for i, gains in enumerate(filtered.gains, start=1):
        law = gains.law()
        for name in ("A", "B"):
            found = matrix_of(script, f"servo({i}).{name}")
            assert found.tolist() == getattr(law, name).tolist()
        assert matrix_of(script, f"servo({i}).C").tolist() == [law.C.tolist()]
        assert matrix_of(script, f"servo({i}).D").tolist() == [law.D.tolist()]
        assert matrix_of(script, f"servo({i}).E").T.tolist() == [law.E.tolist()]
        assert f"servo({i}).kp = {gains.kp!r}; % [V s/rad]" in script
        for k, one in enumerate(gains.filters, start=1):
            line = f"servo({i}).filters{{{k}}} = tf({list(one.b)}, {[1.0, *one.a]}, Ts);"
            assert line in script
    amplitudes = matrix_of(script, "shaper.amplitudes")
    assert amplitudes.sum() == pytest.approx(1.0)


_ASKED = """\
servo_file
for i = 1:numel(servo)
  if max(abs(pole(servo(i).model))) > 1 + 1e-9, error('unstable'), end
end
disp(numel(servo(1).filters)), disp(numel(shaper.filter))
"""


def test_octave_runs_the_script(filtered: ServoDesign, tmp_path: Path) -> None:
    found = shutil.which("octave-cli") or shutil.which("octave")
    if found is None:
        pytest.skip("GNU Octave is not installed")
    (tmp_path / "servo_file.m").write_text(to_script(filtered))
    done = subprocess.run(
        [found, "--eval", _ASKED], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    if "package control" in done.stderr:
        pytest.skip("GNU Octave's control package is not installed")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["2", str(len(filtered.shapers[0].impulses.amplitudes))]
