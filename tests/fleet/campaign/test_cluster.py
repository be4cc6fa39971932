"""A campaign on Dask loses nothing if workers, scheduler or driver are killed."""

from __future__ import annotations

import json
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

import pytest

import strainwave as sw
from campaign_commands import COUNT, PATIENCE, campaign, records_by_study, running, wait_for
from campaign_rigs import rig, rigs
from dask_processes import dask
from strainwave.fleet.campaign import cluster
from strainwave.fleet.campaign.records import RunLimits
from strainwave.fleet.campaign.runner import CampaignPlan, failed
from strainwave.fleet.campaign.store import Store
from strainwave.fleet.campaign.study_files import find
from strainwave.numerics import dask_cluster


@pytest.fixture(scope="module")
def studies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = rigs(tmp_path_factory.mktemp("studies"), COUNT)
    (folder / "rig-003" / "motion.csv").write_text("t,theta_m1\n0.0,1.0\n0.001")
    return folder


def failures(store: Path) -> list[dict[str, Any]]:
    return [row for row in sw.read_runs(store).to_pylist() if row["status"] != "determined"]


def test_a_worker_and_then_the_driver_are_killed(studies: Path, tmp_path: Path) -> None:
    """The other worker repeats the run; another driver continues on the same cluster."""
    out = tmp_path / "store"
    with dask(tmp_path) as it:
        arguments = (studies, "--out", out, "--scheduler", it.address)
        with running(*arguments, "--workers", "4") as driver:
            wait_for(out, 3, driver)
            it.workers[0].kill()
            wait_for(out, 8, driver)
            driver.kill()
        first = {row["run"]: row["started"] for row in sw.read_runs(out).to_pylist()}
        again = campaign(*arguments)
    assert again.returncode == 3, again.stderr
    assert f"{COUNT} of {COUNT} studies" in again.stdout
    assert "1 failed" in again.stdout
    assert set(records_by_study(out).values()) == {1}
    assert len(records_by_study(out)) == COUNT
    (failed,) = failures(out)
    assert "rig-003" in failed["study"]
    assert failed["exit_code"] == 2
    found = {row["run"]: row["started"] for row in sw.read_runs(out).to_pylist()}
    assert {run: found[run] for run in first} == first


def test_the_scheduler_is_killed_and_another_cluster_continues(
    studies: Path, tmp_path: Path
) -> None:
    out = tmp_path / "store"
    with (
        dask(tmp_path) as it,
        running(studies, "--out", out, "--scheduler", it.address, "--workers", "2") as driver,
    ):
        wait_for(out, 3, driver)
        it.scheduler.kill()
        _, errors = driver.communicate(timeout=PATIENCE)
    assert driver.returncode == 3, errors
    assert errors.count("\n") == 1, errors
    assert "the Dask scheduler is lost; the same command continues" in errors
    recorded = sw.read_runs(out).num_rows
    assert 3 <= recorded < COUNT
    description = tmp_path / "cluster.toml"
    description.write_text(
        'class = "distributed.LocalCluster"\n'
        'arguments = { n_workers = 1, threads_per_worker = 2, dashboard_address = ":0" }\n'
    )
    again = campaign(studies, "--out", out, "--cluster", description)
    assert again.returncode == 3, again.stderr
    assert again.stderr == ""
    assert len(records_by_study(out)) == COUNT
    assert set(records_by_study(out).values()) == {1}
    assert len(failures(out)) == 1


class Future:
    """A Dask future that has ended, or whose result was lost and is computed again."""

    def __init__(self, status: str, error: Exception | None = None, result: str = "") -> None:
        self.status, self._error, self._result = status, error, result

    @property
    def client(self) -> Any:
        return self

    def exception(self) -> Exception | None:
        return self._error if self.status == "error" else None

    def result(self) -> str:
        if self._error is not None:
            raise self._error
        return self._result

    def submit(self, *arguments: object, **keywords: object) -> None:
        self.result()


def planned(folder: Path) -> tuple[Any, CampaignPlan]:
    plan = CampaignPlan(Store(folder / "store"), "test", ("rigid",), {})
    found = cluster._plan(plan, find([str(rig(folder / "rig"))]).cases[0])
    return found, plan


def test_a_study_whose_workers_die_repeatedly_has_failed(tmp_path: Path) -> None:
    from distributed import KilledWorker

    task, plan = planned(tmp_path)
    outcome = cluster._outcome(task, Future("error", KilledWorker("key", None, 3)), plan)
    assert (outcome.status, outcome.exit_code) == ("failed", 1)
    assert "died, 4 in a row" in outcome.message
    (row,) = failures(tmp_path / "store")
    assert row["message"] == outcome.message


@pytest.mark.parametrize("status", ["finished", "lost", "pending"])
def test_an_outcome_whose_worker_died_meanwhile_is_waited_for(status: str, tmp_path: Path) -> None:
    task, plan = planned(tmp_path)
    outcome = failed(task[0], "a fault", exit_code=2, started=task[1], store=plan.store)
    future = Future(status, result=outcome.to_json())
    assert cluster._outcome(task, future, plan) == outcome


def test_a_run_recorded_by_a_dying_worker_is_not_repeated(tmp_path: Path) -> None:
    (task, since), plan = planned(tmp_path)
    limits = {"time_s": 60.0, "memory_mib": None, "tasks": 100}
    first = cluster.perform(task.to_json(), limits, since.isoformat())
    started = sw.read_runs(tmp_path / "store")["started"].to_pylist()
    again = cluster.perform(task.to_json(), limits, since.isoformat())
    cluster._thread.runner.close()
    assert json.loads(again)["status"] == json.loads(first)["status"] == "determined"
    assert sw.read_runs(tmp_path / "store")["started"].to_pylist() == started
    assert plan.store.recorded(task.run) is not None


@pytest.mark.parametrize(
    ("future", "error", "message"),
    [
        (Future("error", ModuleNotFoundError("No module 's'")), sw.InvalidInput, "No module 's'"),
        (Future("error", sw.InvalidInput("does not start")), sw.InvalidInput, "does not start"),
        (Future("cancelled", CancelledError()), dask_cluster.ClusterLost, "scheduler is lost"),
        (Future("finished", OSError("in <TCP>: closed")), dask_cluster.ClusterLost, "scheduler is"),
        (Future("finished", CancelledError()), dask_cluster.ClusterLost, "scheduler is lost"),
    ],
)
def test_other_errors_of_workers_end_the_campaign(
    future: Future, error: type[Exception], message: str, tmp_path: Path
) -> None:
    task, plan = planned(tmp_path)
    with pytest.raises(error, match=message):
        cluster._outcome(task, future, plan)


@pytest.mark.parametrize(
    ("client", "error"),
    [
        (Future("closed", RuntimeError("the client is closed")), dask_cluster.ClusterLost),
        (Future("running", OSError("in <TCP>: closed")), dask_cluster.ClusterLost),
        (Future("running", TypeError("a bug")), TypeError),
    ],
)
def test_a_scheduler_lost_before_a_task_is_submitted(
    client: Future, error: type[Exception], tmp_path: Path
) -> None:
    task, _ = planned(tmp_path)
    with pytest.raises(error):
        cluster._submit(client, task, RunLimits(time_s=60.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("class = ", "is not valid TOML"),
        ("klass = 'a'", "unknown key 'klass'.*did you mean 'class'"),
        ("workers = 3", "'class' is missing"),
        ("class = 'dask_jobqueue.Nothing'", "cannot be created"),
        (
            "class = 'distributed.LocalCluster'\narguments = 3",
            "'arguments' is missing or has the wrong",
        ),
        (
            "class = 'distributed.LocalCluster'\narguments = { foo = 3, dashboard_address = ':0' }",
            "cannot be created",
        ),
    ],
)
def test_wrong_descriptions_are_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "cluster.toml"
    path.write_text(text)
    with (
        pytest.raises(sw.InvalidInput, match=rf"cluster\.toml: .*{message}"),
        cluster.connected(None, path),
    ):
        pass


def test_no_scheduler_at_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "_CONNECT_TIMEOUT_S", 0.5)
    with (
        pytest.raises(sw.InvalidInput, match="no Dask scheduler answers"),
        cluster.connected("tcp://127.0.0.1:9", None),
    ):
        pass
