"""The public API, on a small arm that another engine moves: as a notebook or a program uses it."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import strainwave as sw
from strainwave.domain import Identification
from strainwave.domain.progress import Progress, ProgressEvent
from strainwave.io import results

FOLDER = Path(__file__).parent / "data" / "small-arm"
STUDY = FOLDER / "study.toml"


@cache
def rigid() -> sw.Result:
    return sw.identify(STUDY, stages=("rigid",))


def tables(form: str) -> dict[str, Any]:
    """All logs of the study in memory."""
    found: dict[str, Any] = {}
    for each in sw.read_study(STUDY).experiments:
        table = pq.read_table(FOLDER / each.file)
        match form:
            case "arrow":
                found[each.name] = table
            case "pandas":
                found[each.name] = table.to_pandas()
            case "polars":
                found[each.name] = pl.from_arrow(table)
            case "arrays":
                found[each.name] = {n: table[n].to_numpy() for n in table.column_names}
            case "path":
                found[each.name] = str(FOLDER / each.file)
    return found


def test_a_parameter_by_name_and_joint() -> None:
    found = rigid()
    beta = found["beta"]
    assert beta.value is not None
    assert beta.std is not None
    assert beta.ci95 is not None
    assert beta.ci95[0] < beta.value < beta.ci95[1]
    assert found["motor_inertia", 2].joint == 2
    with pytest.raises(KeyError, match="did you mean 'motor_inertia 2'"):
        found["motor_inertias", 2]


def test_the_table_is_a_sequence_and_a_frame() -> None:
    table = rigid().parameters
    assert [one.label for one in table][: len(table)] == [one.label for one in table[:]]
    frame = table.to_frame()
    assert isinstance(frame, pd.DataFrame)
    beta = frame[frame["name"] == "beta"].iloc[0]
    assert beta["value"] == rigid()["beta"].value
    assert beta["ci95_low"] < beta["value"] < beta["ci95_high"]
    assert pd.isna(beta["joint"])
    assert len(frame) == len(table)


@pytest.mark.parametrize("form", ["arrow", "pandas", "polars", "arrays", "path"])
def test_data_in_memory_give_what_files_give(form: str, tmp_path: Path) -> None:
    """The study's own files are out of reach, so that what is read must be what is given."""
    study = replace(sw.read_study(STUDY), path=tmp_path / "study.toml")
    found = sw.identify(study, data=tables(form), stages=("rigid",))
    assert found.parameters == rigid().parameters


def test_a_table_that_is_none_is_refused() -> None:
    data = tables("arrays")
    first = next(iter(data))
    with pytest.raises(sw.InvalidInput, match="is no table, but int"):
        sw.identify(STUDY, data={first: 3})
    with pytest.raises(sw.InvalidInput, match=rf"data\['{first}'\].*no vector of numbers"):
        sw.identify(STUDY, data={first: data[first] | {"u1_counts": ["a", "b"]}}, stages=("rigid",))
    with pytest.raises(sw.InvalidInput, match="differ in length"):
        sw.identify(STUDY, data={first: data[first] | {"u1_counts": np.ones(3)}}, stages=("rigid",))
    with pytest.raises(sw.InvalidInput, match="the study has no experiment 'another'"):
        sw.identify(STUDY, data={"another": data[first]})
    holed = data[first] | {
        "u1_counts": np.where(np.arange(len(data[first]["u1_counts"])) == 7, np.nan, 1.0)
    }
    with pytest.raises(sw.InvalidInput, match=rf"data\['{first}'\].*row 8"):
        sw.identify(STUDY, data={first: holed}, stages=("rigid",))
    with pytest.raises(sw.InvalidInput, match="stands twice"):
        sw.identify(STUDY, data={first: pa.table([[1.0], [2.0]], names=["t", "t"])})


def test_a_missing_log_is_named_by_its_line(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY.read_text())
    first = sw.read_study(path).experiments[0]
    lines = path.read_text().splitlines()
    number = 1 + next(k for k, line in enumerate(lines) if first.file in line)
    with pytest.raises(sw.InvalidInput, match=rf"study\.toml, line {number}\b"):
        sw.identify(path)


def test_a_result_reads_back_equal(tmp_path: Path) -> None:
    whole = sw.identify(STUDY)
    path = whole.save(tmp_path / "result.json")
    again = sw.read_result(path)
    assert again == whole
    assert again.parameters == whole.parameters
    assert again.verdict == whole.verdict
    assert again.warnings == whole.warnings
    assert again.status == whole.status == "determined"
    assert again != rigid()
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()
    with pytest.raises(sw.InvalidInput, match="samples"):
        again.report(tmp_path / "report.html")
    assert whole.report(tmp_path / "report.html").read_text().startswith("<!doctype html>")
    assert whole.plot("bode", joint=1).axes
    with pytest.raises(sw.InvalidInput, match="there is no figure 'bode-joint-3'"):
        whole.plot("bode", joint=3)
    assert "gear_damping" in whole._repr_html_()


def test_a_figure_by_the_name_of_its_experiment() -> None:
    """Also by one that has letters no file's name should have."""
    run = rigid().run
    assert run is not None
    made = replace(run.fitted[0], experiment="Slow motion (1)")
    result = sw.Result.of(replace(run, fitted=(made,)))
    assert result.plot("fitted", experiment="Slow motion (1)").axes
    with pytest.raises(sw.InvalidInput, match="there is no figure 'fitted-slow-motion-2'"):
        result.plot("fitted", experiment="Slow motion (2)")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is not JSON"),
        ("[1]", 'has no key "schema"'),
        ('{"schema": "strainwave/result/9"}', "has the schema"),
    ],
)
def test_what_is_no_result_is_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(sw.InvalidInput, match=said):
        sw.read_result(tmp_path / "r.json")
    with pytest.raises(sw.InvalidInput, match="does not exist"):
        sw.read_result(tmp_path / "none.json")


def test_a_result_that_lacks_keys_is_refused() -> None:
    with pytest.raises(sw.InvalidInput, match="parameters is incomplete"):
        sw.Result({"schema": results.SCHEMA, "parameters": [{"name": "beta"}]})


def test_progress_comes_in_the_callers_thread_and_grows() -> None:
    events: list[ProgressEvent] = []
    threads = set[int]()

    def follow(event: ProgressEvent) -> None:
        events.append(event)
        threads.add(threading.get_ident())

    sw.identify(STUDY, stages=("rigid",), progress=follow)
    assert [event.stage for event in events][:3] == ["read", "consistency", "rigid"]
    fractions = [event.fraction for event in events]
    assert fractions == sorted(fractions)
    assert threads == {threading.get_ident()}


def test_progress_said_at_the_very_end_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the last look at what there is, and before the work's thread ends."""
    last = ProgressEvent("tuned", 1.0, "the last word", 8, 8)
    found = rigid().run
    begun, looked = threading.Event(), threading.Event()
    workers: list[threading.Thread] = []

    def work(*_: object, progress: Progress, **__: object) -> Identification | None:
        workers.append(threading.current_thread())
        begun.set()
        looked.wait()
        progress(last)
        return found

    def asked() -> bool:
        begun.wait()
        looked.set()
        workers[0].join()
        return False

    events: list[ProgressEvent] = []
    monkeypatch.setattr("strainwave.pipeline.identify", work)
    sw.identify(STUDY, progress=events.append, cancel=asked)
    assert events == [last]


@pytest.mark.parametrize("stage", ["read", "rigid", "decoupled", "tuned"])
def test_cancel_ends_every_stage(stage: str) -> None:
    wanted = threading.Event()

    def follow(event: ProgressEvent) -> None:
        if event.stage == stage:
            wanted.set()

    with pytest.raises(sw.Cancelled):
        sw.identify(STUDY, progress=follow, cancel=wanted)
    for thread in threading.enumerate():
        if thread.name == "strainwave":  # what was given up ends at its next look
            thread.join(60.0)
            assert not thread.is_alive()


def test_cancel_does_not_wait_for_what_cannot_be_interrupted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As compiled code: here, work that never looks whether it is still wanted."""
    begun, release = threading.Event(), threading.Event()

    def endless(*_: object, **__: object) -> None:
        begun.set()
        release.wait()

    monkeypatch.setattr("strainwave.pipeline.identify", endless)
    with pytest.raises(sw.Cancelled):
        sw.identify(STUDY, cancel=begun)
    assert not release.is_set()
    release.set()


def test_cancel_may_be_a_function() -> None:
    with pytest.raises(sw.Cancelled):
        sw.identify(STUDY, cancel=lambda: True)


def test_what_fails_in_the_callers_progress_comes_out() -> None:
    def follow(_event: ProgressEvent) -> None:
        raise RuntimeError("no")

    with pytest.raises(RuntimeError, match="no"):
        sw.identify(STUDY, progress=follow)


def test_threads_change_nothing_but_how_many_work() -> None:
    most = [0]
    begin = threading.active_count()

    def follow(_event: ProgressEvent) -> None:
        most[0] = max(most[0], threading.active_count() - begin)

    one = sw.identify(STUDY, threads=1, progress=follow)
    assert most[0] <= 1  # the run's own thread
    two = sw.identify(STUDY, threads=2)
    assert one.parameters == two.parameters
    with pytest.raises(sw.InvalidInput, match="threads is 0"):
        sw.identify(STUDY, threads=0)


def test_every_public_name_is_there_and_listed() -> None:
    for name in sw.__all__:
        assert getattr(sw, name) is not None
    assert set(sw.__all__) <= set(dir(sw))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        sw.nothing  # noqa: B018
