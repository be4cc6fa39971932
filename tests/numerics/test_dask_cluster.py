"""Jobs on a Dask cluster: results, data that are sent once, and every failure in one sentence."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from command_line import run_here
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.numerics import dask_cluster
from strainwave.numerics.dask_cluster import Cluster, ClusterFailure, connected, distributed
from strainwave.numerics.parallel import current_cluster
from strainwave.version import __version__


class Datum:
    """A datum that counts how often it is pickled."""

    def __init__(self, value: int) -> None:
        self.value, self.pickled = value, 0

    def __getstate__(self) -> dict[str, int]:
        self.pickled += 1
        return {"value": self.value}


def scaled(datum: Datum, factor: int) -> tuple[int, list[int]]:
    if factor < 0:
        raise NumericalFailure("the factor is negative")
    if factor > 100:
        raise TypeError("the factor is large")
    return datum.value * factor, [datum.value] * factor


@pytest.fixture(scope="module")
def in_process() -> Iterator[Any]:
    """A cluster of two workers in threads of this process."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as it:
        yield it


@pytest.fixture
def cluster(in_process: Any) -> Iterator[Cluster]:
    with connected(in_process) as client:
        yield Cluster(client)


def test_large_results_are_fetched_and_data_are_sent_once(cluster: Cluster) -> None:
    data = [Datum(2), Datum(3)]
    small, fetch = cluster.map(scaled, data, [1, 2])
    assert small == [2, 6]
    assert fetch() == [[2], [3, 3]]
    assert cluster.map(scaled, data, [3, 3])[0] == [6, 9]
    assert [datum.pickled for datum in data] == [1, 1]
    assert len(cluster._sent) == 2
    del data
    gc.collect()
    assert not cluster._sent


def test_errors_of_simulations_are_those_of_the_job(cluster: Cluster) -> None:
    with pytest.raises(NumericalFailure, match="the factor is negative"):
        cluster.map(scaled, [Datum(1), Datum(2)], [1, -1])


def test_other_errors_are_failures_of_the_cluster(cluster: Cluster) -> None:
    with pytest.raises(ClusterFailure, match=r"cannot run strainwave .*the factor is large"):
        cluster.map(scaled, [Datum(1)], [101])


def test_a_worker_of_another_version_is_refused(cluster: Cluster) -> None:
    load = cluster._client.submit(dask_cluster._load, "0.0.1", b"", pure=False)
    with pytest.raises(ClusterFailure, match=rf"worker has strainwave {__version__}, .* 0.0.1"):
        cluster._gather([load])


def test_the_cluster_is_that_of_the_block(in_process: Any) -> None:
    with distributed(in_process.scheduler_address):
        assert isinstance(current_cluster(), Cluster)
    assert current_cluster() is None
    with distributed(None):
        assert current_cluster() is None


def test_a_cluster_without_workers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed import LocalCluster

    monkeypatch.setattr(dask_cluster, "_WORKER_TIMEOUT_S", 0.2)
    monkeypatch.setattr(dask_cluster, "_WORKER_CHECK_S", 0.05)
    with (
        LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as empty,
        pytest.raises(InvalidInput, match=r"^inproc://.* has had no worker .*start workers"),
        distributed(empty.scheduler_address),
    ):
        pass


def test_identify_refuses_an_address_without_scheduler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_cluster, "_CONNECT_TIMEOUT_S", 0.5)
    out = tmp_path / "results"
    ended = run_here("identify", "s.toml", "--out", out, "--scheduler", "tcp://127.0.0.1:9")
    assert ended.returncode == 2
    assert ended.stderr.startswith("strainwave: tcp://127.0.0.1:9: no Dask scheduler answers")
    assert ended.stderr.count("\n") == 1
    assert not out.exists()
