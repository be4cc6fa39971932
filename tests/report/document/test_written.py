"""Report and figure files: written completely or not at all."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

import studies
from results import identification, prediction
from strainwave import cli, pipeline
from strainwave.errors import InvalidInput
from strainwave.report.document import figures_of

pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")

BOTH = {"report.html", "result.json"}


def test_figures_are_written_on_request(tmp_path: Path) -> None:
    one = replace(identification(), checks=(prediction("a", 90.0),), fitted=())
    pipeline.write(one, tmp_path / "plain")
    assert {path.name for path in (tmp_path / "plain").iterdir()} == BOTH
    pipeline.write(one, tmp_path / "drawn", figures=True)
    assert {path.name for path in (tmp_path / "drawn").iterdir()} == {*BOTH, "figures"}
    names = {path.name for path in (tmp_path / "drawn" / "figures").iterdir()}
    assert names == {f"{name}.{ending}" for name in figures_of(one) for ending in ("svg", "png")}


def test_a_failed_write_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "figures").write_text("")  # a file in place of the folder
    with pytest.raises(InvalidInput, match="cannot write there"):
        pipeline.write(identification(), tmp_path, figures=True)
    assert [path.name for path in tmp_path.iterdir()] == ["figures"]


@pytest.mark.parametrize("command", ["identify", "demo"])
def test_a_missing_matplotlib_is_reported_before_the_run(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    study = [str(studies.write(tmp_path))] if command == "identify" else []
    out = tmp_path / "out"
    done = CliRunner().invoke(cli.app, [command, *study, "--out", str(out), "--figures"])
    assert isinstance(done.exception, InvalidInput)
    assert "pip install matplotlib" in str(done.exception)
    assert not out.exists()


def test_the_command_writes_figures_and_prints_their_folder(tmp_path: Path) -> None:
    study = str(studies.write(tmp_path, studies.STUDY.replace('use = "motion"', 'use = "sweep"')))
    out = tmp_path / "out"
    given: list[bool] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "write", lambda *_, figures, **__: given.append(figures))
        for flags in ([], ["--figures"]):
            done = CliRunner().invoke(cli.app, ["identify", study, "--out", str(out), *flags])
            assert ("figures" in done.output) == bool(flags)
    assert given == [False, True]
