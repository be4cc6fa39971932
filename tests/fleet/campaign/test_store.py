"""The store: rows are complete and unique under concurrent writes, merges and reads."""

from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import duckdb
import fsspec
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import strainwave as sw
from campaign_records import DAY, record, write_many
from strainwave.fleet.campaign.records import PARAMETERS_SCHEMA, RUNS_SCHEMA, RunRecord
from strainwave.fleet.campaign.store import Store


def runs(store: Path | str) -> list[str]:
    return sorted(sw.read_runs(store)["run"].to_pylist())


def queried(sql: str) -> list[Any]:
    """Rows of a DuckDB query."""
    return duckdb.connect().execute(sql).fetchall()


def test_many_writers_mergers_and_readers_at_once(tmp_path: Path) -> None:
    """Three processes write 40 runs each, half of them by two; all merge; one reads."""
    seen = 0
    with ProcessPoolExecutor(3, mp_context=get_context("spawn")) as pool:
        work = [pool.submit(write_many, str(tmp_path), first, 40) for first in (0, 0, 40)]
        while not all(each.done() for each in work):
            table = Store(tmp_path).table("runs", ["run"])["run"].to_pylist()
            assert len(table) == len(set(table))
            assert len(table) >= seen
            seen = len(table)
        for each in work:
            each.result()
    expected = [f"run-{number:05d}" for number in range(80)]
    assert runs(tmp_path) == expected
    assert sw.read_parameters(tmp_path).num_rows == 3 * 80
    Store(tmp_path).merge()
    assert runs(tmp_path) == expected
    assert queried(f"select count(*) from '{tmp_path}/runs/*.parquet'") == [(80,)]


@given(
    steps=st.lists(
        st.one_of(
            st.tuples(st.just("write"), st.integers(0, 5), st.booleans()),
            st.just(("merge", 0, False)),
        ),
        max_size=14,
    )
)
@settings(max_examples=30)
def test_a_repeated_run_has_its_last_row(
    steps: list[tuple[str, int, bool]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("store")
    store, expected = Store(folder), dict[str, str]()
    for number, (what, run, good) in enumerate(steps):
        if what == "merge":
            store.merge()
        else:
            status = "determined" if good else "failed"
            store.write(record(f"run-{run}", number, status))
            expected[f"run-{run}"] = status
        known = store.table("runs", ["run", "status"]).to_pylist()
        assert {each["run"]: each["status"] for each in known} == expected
        assert len(known) == len(expected)
        assert store.table("parameters").num_rows == 3 * len(expected)
        for run_name, status in expected.items():
            found = Store(folder).recorded(run_name)
            assert found is not None
            assert found.status == status
        assert store.recorded("another") is None


def test_duplicates_of_an_interrupted_merge_are_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path)
    for number in range(4):
        store.write(record(f"run-{number}", number))
    with monkeypatch.context() as cut:
        cut.setattr("strainwave.fleet.campaign.store.Store._delete", lambda *_: None)
        store.merge()
    assert len(list((tmp_path / "runs").glob("*.parquet"))) == 5
    assert runs(tmp_path) == [f"run-{number}" for number in range(4)]
    assert sw.read_parameters(tmp_path).num_rows == 12
    store.merge()
    assert len(list((tmp_path / "runs").glob("*.parquet"))) == 1
    assert len(list((tmp_path / "parameters").glob("*.parquet"))) == 1
    assert runs(tmp_path) == [f"run-{number}" for number in range(4)]


def test_parameters_without_a_row_are_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full when the row is written, or the process is killed before."""
    store = Store(tmp_path)
    store.write(record("whole"))

    put = Store._put

    def full(self: Store, name: str, data: bytes) -> None:
        if name.startswith("runs/"):
            raise OSError(28, "No space left on device")
        put(self, name, data)

    with monkeypatch.context() as disk:
        disk.setattr(Store, "_put", full)
        with pytest.raises(OSError, match="No space"):
            store.write(record("half"))
        assert not [path for path in tmp_path.rglob("*half*") if path.is_file()]
        assert not list(tmp_path.glob("results/half/*"))
        disk.setattr(Store, "_delete", lambda *_: None)
        with pytest.raises(OSError, match="No space"):
            store.write(record("killed"))
    assert list(tmp_path.glob("parameters/killed*"))
    assert runs(tmp_path) == ["whole"]
    assert set(sw.read_parameters(tmp_path)["run"].to_pylist()) == {"whole"}


def test_temporary_files_are_not_read(tmp_path: Path) -> None:
    Store(tmp_path).write(record("whole"))
    aside = tmp_path / "runs" / ".half.parquet.abc.aside"
    aside.write_bytes(b"PAR1")
    assert runs(tmp_path) == ["whole"]
    assert queried(f"select run from '{tmp_path}/runs/*.parquet'") == [("whole",)]
    assert len(pl.read_parquet(tmp_path / "runs" / "*.parquet")) == 1
    Store(tmp_path).write(record("other"))
    Store(tmp_path).merge()
    assert runs(tmp_path) == ["other", "whole"]


def test_a_foreign_file_is_named(tmp_path: Path) -> None:
    Store(tmp_path).write(record("whole"))
    (tmp_path / "runs" / "foreign.parquet").write_bytes(b"nothing")
    with pytest.raises(sw.InvalidInput, match=r"foreign\.parquet: is not a Parquet file"):
        sw.read_runs(tmp_path)
    with pytest.raises(sw.InvalidInput, match="contains no runs"):
        sw.read_runs(tmp_path / "absent")


def test_duckdb_pandas_and_polars_read_the_same_rows(tmp_path: Path) -> None:
    """Also if a column of one file has only nulls."""
    store = Store(tmp_path)
    store.write(record("a", 1.0))
    store.write(RunRecord({"run": "b", "started": DAY, "status": "failed"}))
    store.write(record("c", 2.0))
    store.merge()
    store.write(RunRecord({"run": "d", "started": DAY, "warnings": ["clipped"], "tuned_s": 1.0}))
    for kind, schema in (("runs", RUNS_SCHEMA), ("parameters", PARAMETERS_SCHEMA)):
        pattern = str(tmp_path / kind / "*.parquet")
        own: pa.Table = store.table(kind)
        assert own.schema.equals(schema)
        ours = own.sort_by([("run", "ascending")])
        sql = f"select * from '{pattern}' order by run"
        assert queried(sql) == [tuple(row.values()) for row in ours.to_pylist()]
        assert pl.read_parquet(pattern).sort("run").equals(pl.DataFrame(pl.from_arrow(ours)))
        frame = pd.read_parquet(tmp_path / kind).sort_values("run")
        assert frame["run"].tolist() == ours["run"].to_pylist()
        assert frame.columns.tolist() == schema.names
    assert store.table("runs").num_rows == 4


def test_columns_that_an_earlier_version_lacks_are_null(tmp_path: Path) -> None:
    Store(tmp_path).write(record("new"))
    old = pa.table({"run": ["old"], "started": pa.array([DAY], pa.timestamp("us"))})
    pq.write_table(old, tmp_path / "runs" / "old.parquet")
    assert runs(tmp_path) == ["new", "old"]
    Store(tmp_path).merge()
    assert runs(tmp_path) == ["new", "old"]
    assert sw.read_runs(tmp_path).schema.equals(RUNS_SCHEMA)


def test_ten_thousand_runs_are_listed_in_a_second(tmp_path: Path) -> None:
    """Merged except for the last thousand, as after a campaign."""
    rows = [record(f"run-{number:05d}", number).row for number in range(9000)]
    (tmp_path / "runs").mkdir()
    pq.write_table(
        pa.Table.from_pylist(rows, schema=RUNS_SCHEMA), tmp_path / "runs" / "part-0.parquet"
    )
    store = Store(tmp_path)
    for number in range(9000, 9990):
        row = pa.Table.from_pylist([record(f"run-{number:05d}").row], schema=RUNS_SCHEMA)
        pq.write_table(row, tmp_path / "runs" / f"run-{number:05d}.parquet")
    begin = time.perf_counter()
    found = store.table("runs", ["run", "study", "status"])
    seconds = time.perf_counter() - begin
    assert found.num_rows == 9990
    assert seconds < 3.0  # 0.6 s of processor time; the machine may have others to serve
    begin = time.perf_counter()
    assert store.recorded("run-00017") is not None
    assert time.perf_counter() - begin < 3.0


@pytest.mark.parametrize("scheme", ["memory", "file"])
def test_a_store_at_a_url(scheme: str, tmp_path: Path) -> None:
    url = f"{scheme}://{tmp_path}/store"
    store = Store(url)
    assert store.recorded("a") is None
    store.write(record("a"))
    store.write(record("b", status="failed"))
    store.write(record("b", 1.0))
    store.merge()  # it is left as it is
    assert runs(url) == ["a", "b"]
    assert sw.read_parameters(url).num_rows == 6
    found = store.recorded("b")
    assert found is not None
    assert found.status == "determined"
    names = sorted(Path(each.path).name for each in fsspec.open_files(f"{url}/runs/*"))
    assert names == ["a.parquet", "b.parquet"]


def test_a_merge_does_not_wait_for_the_lock(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write(record("a"))
    store.write(record("b"))
    hold = "import fcntl, sys; f = open(sys.argv[1], 'ab'); fcntl.flock(f, 2); print(); input()"
    with subprocess.Popen(
        [sys.executable, "-c", hold, str(tmp_path / ".lock")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as other:
        assert other.stdout is not None
        other.stdout.readline()
        store.merge()
        assert len(list((tmp_path / "runs").glob("*.parquet"))) == 2
        other.communicate(b"\n")
    store.merge()
    assert len(list((tmp_path / "runs").glob("*.parquet"))) == 1
    assert runs(tmp_path) == ["a", "b"]


def test_a_full_disk(tmp_path: Path) -> None:
    """The system refuses files beyond a size, as a full disk refuses all."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))"
    work = "import sys; from strainwave.fleet.campaign.store import RunRecord, Store"
    row = "RunRecord({'run': 'big'}, (), b'x' * 10000)"
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            f"{limit}\n{work}\nStore(sys.argv[1]).write({row})",
            str(tmp_path),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "File too large" in done.stderr
    left = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert left == []
