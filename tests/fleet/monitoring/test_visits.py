"""Arms and visits of a store: names, times, covariates, omissions and input errors."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

import visited_arms
from strainwave.errors import InvalidInput
from strainwave.fleet.monitoring.visits import parse_time, read_conditions, read_histories


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    factors = {"arm-1": visited_arms.healthy, "arm-2": visited_arms.softening}
    return visited_arms.fleet(tmp_path_factory.mktemp("store"), factors, visits=6)


def table(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_an_arm_is_the_folder_of_its_studies(store: Path) -> None:
    histories = read_histories(store)
    assert sorted(arm.arm for arm in histories.arms) == ["arm-1", "arm-2"]
    arm = histories.arms[0]
    assert [visit.study for visit in arm.visits] == [
        f"fleet/{arm.arm}/visit-{k:03d}.toml" for k in range(6)
    ]
    stiffness = next(p for p in arm.parameters if p.label == "gear_stiffness 1")
    np.testing.assert_allclose(stiffness.series.time, 7.0 * np.arange(6))
    assert stiffness.series.covariates.shape == (6, 0)
    assert any("not of the recordings" in note for note in histories.notes)


def test_an_arm_by_column_or_expression(store: Path) -> None:
    assert [arm.arm for arm in read_histories(store, arm="worker").arms] == ["here:1"]
    by_number = read_histories(store, arm=r"arm-(\d)/")
    assert sorted(arm.arm for arm in by_number.arms) == ["1", "2"]
    by_group = read_histories(store, arm=r"(?P<arm>arm-1)/")
    assert [arm.arm for arm in by_group.arms] == ["arm-1"]


def test_studies_of_a_campaign_on_windows(tmp_path: Path) -> None:
    runs, parameters = visited_arms.rows("a", 3, np.random.default_rng(0))
    for run in runs:
        run["study"] = "C:\\" + run["study"].replace("/", "\\")
    store = visited_arms.write(tmp_path / "store", runs, parameters)
    assert [arm.arm for arm in read_histories(store).arms] == ["a"]
    (arm,) = read_histories(store, arm="fleet/([^/]+)/").arms
    assert arm.visits[0].study == "C:/fleet/a/visit-000.toml"
    names = ("a\\visit-000.toml", "a/visit-001.toml", "C:\\fleet\\a\\visit-002.toml")
    lines = [f"{name},{20 + k}" for k, name in enumerate(names)]
    path = table(tmp_path / "visits.csv", "study,temperature", *lines)
    (arm,) = read_histories(store, covariates=path).arms
    assert [visit.covariates for visit in arm.visits] == [(20.0,), (21.0,), (22.0,)]


def test_a_time_in_the_path(tmp_path: Path) -> None:
    runs, parameters = visited_arms.rows("a", 3, np.random.default_rng(0))
    for run, day in zip(runs, ("2026-03-01", "2026-01-01", "2026-02-01"), strict=True):
        run["study"] = f"fleet/a/{day}/study.toml"
    visited_arms.write(tmp_path, runs, parameters)
    histories = read_histories(tmp_path, arm=r"fleet/(?P<arm>[^/]+)/(?P<time>[\d-]+)/")
    assert [f"{visit.time:%m}" for visit in histories.arms[0].visits] == ["01", "02", "03"]
    assert not histories.notes
    with pytest.raises(InvalidInput, match="is not a time"):
        read_histories(tmp_path, arm=r"(?P<time>fleet)")


def test_covariates_and_times_by_the_end_of_the_path(store: Path, tmp_path: Path) -> None:
    lines = [f"arm-1/visit-{k:03d}.toml,2025-0{k + 1}-01,{20 + k}" for k in range(6)]
    lines[2] = "fleet/arm-1/visit-002.toml,2025-03-01,"
    path = table(tmp_path / "visits.csv", "study,time,temperature", *lines)
    histories = read_histories(store, covariates=path)
    assert histories.covariates == ("temperature",)
    (arm,) = histories.arms
    assert [visit.covariates for visit in arm.visits] == [
        (20.0,),
        (21.0,),
        (23.0,),
        (24.0,),
        (25.0,),
    ]
    assert arm.start == datetime(2025, 1, 1, tzinfo=UTC)
    assert any("7 visits are omitted" in note for note in histories.notes)


def test_failed_and_repeated_runs_are_omitted(tmp_path: Path) -> None:
    runs, parameters = visited_arms.rows("a", 4, np.random.default_rng(0))
    runs[0]["status"] = "failed"
    runs[2]["study"] = runs[1]["study"]  # a later run of the same study
    visited_arms.write(tmp_path, runs, parameters)
    histories = read_histories(tmp_path)
    assert [visit.run for visit in histories.arms[0].visits] == ["a-2", "a-3"]
    assert any("1 of 4 runs are omitted: they failed" in note for note in histories.notes)
    assert any("the same study has a later run" in note for note in histories.notes)


def test_values_of_another_stage_or_without_std_are_omitted(tmp_path: Path) -> None:
    runs, parameters = visited_arms.rows("a", 5, np.random.default_rng(0))
    stiffness = [p for p in parameters if p["name"] == "gear_stiffness"]
    stiffness[0]["stage"] = "decoupled"
    stiffness[1]["value"] = None
    stiffness[2]["std"] = 0.0
    for parameter in parameters:
        if parameter["name"] == "friction_offset":
            parameter["name"] = "gyro_drift"
    visited_arms.write(tmp_path, runs, parameters)
    (arm,) = read_histories(tmp_path).arms
    by_label = {p.label: p for p in arm.parameters}
    assert [visit.run for visit in by_label["gear_stiffness 1"].visits] == ["a-3", "a-4"]
    assert by_label["gear_stiffness 1"].stage == "tuned"
    assert "gyro_drift 1" not in by_label


def test_a_run_in_two_files_counts_once(tmp_path: Path) -> None:
    runs, parameters = visited_arms.rows("a", 3, np.random.default_rng(0))
    visited_arms.write(tmp_path, runs, parameters)
    for kind in ("runs", "parameters"):
        file = tmp_path / kind / "a-1.parquet"
        (tmp_path / kind / "part-1.parquet").write_bytes(file.read_bytes())
    (arm,) = read_histories(tmp_path).arms
    assert len(arm.visits) == 3
    assert {len(p.visits) for p in arm.parameters} == {3}


@pytest.mark.parametrize(
    ("arm", "message"),
    [
        ("(", "not a regular expression"),
        ("status2", "neither a column"),
        ("(nothing)", "matches no study.*such as 'fleet/"),
    ],
)
def test_wrong_expressions_are_refused(store: Path, arm: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        read_histories(store, arm=arm)


def test_wrong_tables_are_refused(store: Path, tmp_path: Path) -> None:
    path = tmp_path / "visits.csv"
    for lines, message in (
        (("arm,temperature", "a,1"), "no column 'study'"),
        (("study,temperature", "a,warm"), "line 2: 'warm' is not a finite number"),
        (("study,time", "a,yesterday"), "is not a time"),
    ):
        with pytest.raises(InvalidInput, match=message):
            read_conditions(table(path, *lines))
    with pytest.raises(InvalidInput, match="no study of the table"):
        read_histories(store, covariates=table(path, "study,temperature", "elsewhere,1"))


def test_another_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="contains no runs"):
        read_histories(tmp_path)


def test_times_without_zone_are_utc() -> None:
    assert parse_time("2026-01-05", "") == datetime(2026, 1, 5, tzinfo=UTC)
    assert parse_time("2026-01-05T01:00+01:00", "") == datetime(2026, 1, 5, tzinfo=UTC)
