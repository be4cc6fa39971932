"""Flat lists of numbers: JSON, and a header that a C compiler takes."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

import exports
from strainwave.export import IdentifiedArm
from strainwave.export.flat import entries, to_c_header, to_json


@pytest.fixture
def arm(tmp_path: Path) -> IdentifiedArm:
    """The rig under gravity; one friction is null."""
    study = exports.two_links(tmp_path, gravity=9.81)
    arm = exports.arm_of(study, exports.values_of(study))
    nulled = [
        replace(p, value=None, std=None, unit="*/ boo") if p.name == "friction_offset" else p
        for p in arm.parameters
    ]
    return replace(arm, parameters=tuple(nulled))


def test_names_are_flat_and_have_units(arm: IdentifiedArm) -> None:
    document = json.loads(to_json(arm).data)
    assert document["values"]["motor_inertia_2"] == 0.5e-4
    assert document["units"]["motor_inertia_2"] == "kg m^2"
    assert document["stds"]["motor_inertia_2"] == pytest.approx(0.5e-6)
    assert document["values"]["friction_offset_1"] is None
    known = {"link_length": 0.35, "gravity": 9.81, "gear_ratio_1": 0.01, "torque_per_volt_2": 0.03}
    assert known.items() <= document["values"].items()
    assert not known.keys() & document["stds"].keys()
    assert document["values"].keys() == document["units"].keys()


def test_a_single_joint_names_only_what_its_study_knows(tmp_path: Path) -> None:
    study, values = exports.single(tmp_path)
    names = [entry.name for entry in entries(exports.arm_of(study, values)) if entry.known]
    assert names == ["gear_ratio_1"]


def test_a_compiler_reads_the_header(arm: IdentifiedArm, tmp_path: Path) -> None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler here")
    (tmp_path / "arm.h").write_bytes(to_c_header(arm).data)
    reported = [entry for entry in entries(arm) if entry.value is not None]
    prints = "".join(f'printf("%.17g\\n", {entry.name});' for entry in reported)
    twice = '#include <stdio.h>\n#include "arm.h"\n#include "arm.h"\n'
    (tmp_path / "main.c").write_text(f"{twice}int main(void) {{ {prints} return 0; }}\n")
    program = str(tmp_path / "program")
    strict = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    source = str(tmp_path / "main.c")
    done = subprocess.run(
        [compiler, *strict, "-o", program, source], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert [float(line) for line in printed.split()] == [entry.value for entry in reported]


def test_a_header_says_what_is_missing(arm: IdentifiedArm) -> None:
    text = to_c_header(arm).data.decode()
    assert "/* friction_offset_1 [* / boo] was not identified */" in text
    assert "friction_offset_1 =" not in text
    assert "motor_inertia_1 = 0.00015; /* [kg m^2], std 1.5e-06 */" in text
    assert "gravity = 9.81; /* [m/s^2], known */" in text
