"""The export command: formats, files, notes and refusals."""

from __future__ import annotations

from pathlib import Path

import pytest

import exports
from command_line import Finished, run_here
from strainwave.errors import InvalidInput
from strainwave.export import FORMATS, export_file

BEGINS = {
    "arm.xml": b"<?xml version='1.0' encoding='utf-8'?>\n<mujoco",
    "arm.mjcf": b"<?xml version='1.0' encoding='utf-8'?>\n<mujoco",
    "arm.urdf": b"<?xml version='1.0' encoding='utf-8'?>\n<robot",
    "arm.usda": b"#usda 1.0",
    "arm.usd": b"#usda 1.0",
    "arm.sdf": b"<?xml version='1.0' encoding='utf-8'?>\n<sdf",
    "arm.mat": b"MATLAB 5.0 MAT-file",
    "arm.m": b"% An arm",
    "arm.h": b"/* Parameters",
    "arm.json": b'{\n  "schema": "strainwave/parameters/1"',
}


@pytest.fixture
def result(tmp_path: Path) -> Path:
    study = exports.two_links(tmp_path)
    return exports.write(study, exports.values_of(study))


def run(*arguments: str) -> Finished:
    return run_here("export", *arguments)


@pytest.mark.parametrize("name", BEGINS)
def test_the_ending_determines_the_format(name: str, result: Path) -> None:
    out = result.parent / "new" / name
    export_file(result, out)
    assert out.read_bytes().startswith(BEGINS[name])
    assert [path.name for path in out.parent.iterdir()] == [name]


@pytest.mark.parametrize("form", FORMATS)
def test_the_format_option_overrides_the_ending(form: str, result: Path) -> None:
    out = result.parent / "arm.txt"
    export_file(result, out, form=form)
    assert out.stat().st_size > 500


def test_wrong_outputs_are_refused(result: Path) -> None:
    folder = result.parent
    before = sorted(folder.iterdir())
    for out, form, message in [
        (folder / "arm.txt", None, r"'\.txt' does not determine a format"),
        (folder / "arm.xml", "urfd", "did you mean 'urdf'"),
        (result, "json", "overwrite an input file"),
        (folder / "study.toml", "json", "overwrite an input file"),
        (folder, "json", "is a directory"),
    ]:
        with pytest.raises(InvalidInput, match=message):
            export_file(result, out, form=form)
    assert sorted(folder.iterdir()) == before


def test_a_fault_leaves_an_earlier_export_alone(result: Path) -> None:
    out = result.parent / "arm.xml"
    out.write_text("earlier")
    text = result.read_text()
    result.write_text(text.replace('"alpha"', '"alfa"'))
    with pytest.raises(InvalidInput, match="alpha is missing"):
        export_file(result, out)
    assert out.read_text() == "earlier"


def test_the_command_takes_a_result_directory(result: Path) -> None:
    out = result.parent / "arm.xml"
    for argument in (result, result.parent):
        done = run(str(argument), "--out", str(out))
        assert (done.returncode, done.stderr) == (0, "")
        first, *notes = done.stdout.splitlines()
        assert first == f"the arm is in {out}"
        assert all(note.startswith(("note: lost", "read back by MuJoCo")) for note in notes)
        assert out.read_bytes().startswith(BEGINS["arm.xml"])
        out.unlink()


def test_the_command_prints_warnings_and_notes(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path, "three-slope")
    result = exports.write(study, exports.values_of(study))
    moved = study.path.rename(tmp_path / "elsewhere.toml")
    arguments = [str(result), "--format", "state-space", "--out", str(tmp_path / "arm.json")]
    missing = run(*arguments)
    assert (missing.returncode, missing.stdout) == (2, "")
    assert missing.stderr.startswith(f"strainwave: {result}: study: ")
    assert missing.stderr.count("\n") == 1
    done = run(*arguments, "--study", str(moved))
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("warning: joint") == 2
    assert "note: lost: motor_coulomb_friction (joint 1, 2), " in done.stdout
    assert run(*arguments, "--study", str(moved), "--quiet").stdout == ""
