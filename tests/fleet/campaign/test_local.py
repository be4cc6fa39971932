"""Worker processes on this machine: the death of one is a failure of one study."""

from __future__ import annotations

import io
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import psutil
import pytest

from campaign_rigs import inertia_of, rig, rigs
from strainwave.errors import InvalidInput
from strainwave.fleet.campaign import runner, worker
from strainwave.fleet.campaign.records import Outcome, RunLimits, Task
from strainwave.fleet.campaign.runner import CampaignPlan, Runner
from strainwave.fleet.campaign.store import Store, read_parameters, read_runs
from strainwave.fleet.campaign.study_files import find


class InProcess(Runner):
    """Runs tasks in this process, for tests without process failures."""

    def run(self, task: Task) -> Outcome:
        return worker.answer(task)


POISONED = partial(Runner, entry=("-m", "campaign_workers"))


def plan(store: Path, **changes: Any) -> CampaignPlan:
    settings: dict[str, Any] = {"campaign": "test", "stages": ("rigid",), "options": {}}
    return CampaignPlan(Store(store), **(settings | changes))


def run(studies: Path, store: Path, workers: int = 2, **changes: Any) -> dict[str, Outcome]:
    limits = changes.pop("limits", RunLimits())
    start = changes.pop("start", Runner)
    cases = find([str(studies)]).cases
    outcomes = runner.run(cases, plan(store, **changes), workers, limits, start)
    return {Path(each.study).parent.name: each for each in outcomes}


def workers() -> list[psutil.Process]:
    """Live worker processes of this process."""
    entries = {"strainwave.fleet.campaign.worker", "campaign_workers"}
    children = [p for p in psutil.Process().children() if p.status() != psutil.STATUS_ZOMBIE]
    return [child for child in children if entries & set(child.cmdline())]


def rows(store: Path) -> dict[str, dict[str, Any]]:
    found = read_runs(store).to_pylist()
    named = {Path(row["study"]).parent.name: row for row in found}
    assert len(named) == len(found)
    return named


def test_each_study_is_a_row_with_its_parameters(tmp_path: Path) -> None:
    rigs(tmp_path / "rigs", 3)
    run(tmp_path / "rigs", tmp_path / "store", start=InProcess)
    found = rows(tmp_path / "store")
    assert {row["status"] for row in found.values()} == {"determined"}
    parameters = read_parameters(tmp_path / "store").to_pylist()
    values = {p["run"]: p["value"] for p in parameters if p["name"] == "inertia"}
    for number in range(3):
        row = found[f"rig-{number:03d}"]
        assert values[row["run"]] == pytest.approx(inertia_of(number), rel=1e-3)
        assert (tmp_path / "store" / row["result"]).is_file()
        assert row["exit_code"] == 0
        assert row["seconds"] > row["rigid_s"] > 0.0
        assert "inertia 1" in row["identified"]


@pytest.fixture(scope="module")
def poisoned(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("poisoned")
    for name in ("exits", "crashes", "killed", "raises", "whole-1", "whole-2"):
        rig(folder / "rigs" / name)
    broken = rig(folder / "rigs" / "broken")
    (broken.parent / "motion.csv").write_text("t,theta_m1\n0.0,1.0\n0.001")
    (rig(folder / "rigs" / "no-log").parent / "motion.csv").unlink()
    rig(folder / "rigs" / "no-toml").write_text("[arm")
    rig(folder / "slow" / "hangs")  # apart, because a busy machine is slow with the others too
    run(folder / "slow", folder / "store", 1, limits=RunLimits(time_s=4.0), start=POISONED)
    run(folder / "rigs", folder / "store", 1, start=POISONED)
    return rows(folder / "store")


@pytest.mark.parametrize(
    ("name", "exit_code", "message"),
    [
        ("exits", 7, "exit code 7"),
        ("crashes", 139, "SIGSEGV"),
        ("killed", 137, "SIGKILL"),
        ("hangs", 124, "longer than 4 s"),
        ("raises", 1, "ZeroDivisionError"),
        ("broken", 2, "motion.csv"),
        ("no-log", 2, "motion.csv"),
        ("no-toml", 2, "TOML"),
    ],
)
def test_a_poisoned_study_is_a_failed_row(
    poisoned: dict[str, dict[str, Any]], name: str, exit_code: int, message: str
) -> None:
    row = poisoned[name]
    assert (row["status"], row["exit_code"]) == ("failed", exit_code)
    assert message in row["message"]
    assert "\n" not in row["message"]
    assert row["result"] is None


def test_the_other_studies_are_identified(poisoned: dict[str, dict[str, Any]]) -> None:
    assert len(poisoned) == 10
    assert {poisoned[name]["status"] for name in ("whole-1", "whole-2")} == {"determined"}


def test_failed_runs_are_repeated_on_request(tmp_path: Path) -> None:
    rig(tmp_path / "rigs" / "crashes")
    rig(tmp_path / "rigs" / "whole")
    run(tmp_path / "rigs", tmp_path / "store", start=POISONED)
    first = rows(tmp_path / "store")
    Store(tmp_path / "store").merge()
    again = run(tmp_path / "rigs", tmp_path / "store", start=InProcess)
    assert all(outcome.skipped for outcome in again.values())
    assert again["crashes"].status == "failed"
    again = run(tmp_path / "rigs", tmp_path / "store", start=InProcess, retry_failed=True)
    assert again["whole"].skipped
    second = rows(tmp_path / "store")
    assert second["crashes"]["status"] == "determined"
    assert second["crashes"]["run"] == first["crashes"]["run"]
    Store(tmp_path / "store").merge()
    assert rows(tmp_path / "store") == second


def test_changed_inputs_and_options_are_run(tmp_path: Path) -> None:
    path, store = rig(tmp_path / "rigs" / "one"), tmp_path / "store"

    def count(**changes: Any) -> int:
        run(tmp_path / "rigs", store, start=InProcess, **changes)
        return len(read_runs(store).to_pylist())

    assert count() == 1
    assert count() == 1
    path.write_text(path.read_text() + "# another text\n")
    assert count() == 2
    (path.parent / "motion.csv").write_bytes(b"t,theta_m1\n0.0,1.0\n")
    assert count() == 3
    assert count(options={"rigid": {"bandwidth_hz": 20.0}}) == 4
    assert count(stages=("rigid", "decoupled")) == 5
    case = find([str(path)]).cases[0]
    task = plan(tmp_path / "other").next(case)
    assert isinstance(task, Task)
    assert replace(task, version="9.9.9").run != task.run


def test_a_worker_of_another_version_refuses(tmp_path: Path) -> None:
    case = find([str(rig(tmp_path / "one"))]).cases[0]
    task = plan(tmp_path / "store").next(case)
    assert isinstance(task, Task)
    old = replace(task, version="0.0.1")
    runner = Runner(RunLimits())
    outcome = runner.run(old)
    runner.close()
    assert (outcome.status, outcome.exit_code) == ("failed", 2)
    assert "the campaign 0.0.1" in outcome.message


def test_a_process_is_reused_and_replaced(tmp_path: Path) -> None:
    rigs(tmp_path / "rigs", 3)
    run(tmp_path / "rigs", tmp_path / "store", 1, limits=RunLimits(tasks=2))
    ordered = sorted(rows(tmp_path / "store").values(), key=lambda row: row["started"])
    workers = [row["worker"] for row in ordered]
    assert [workers.count(each) for each in dict.fromkeys(workers)] == [2, 1]


def test_a_process_killed_between_studies_is_replaced(tmp_path: Path) -> None:
    rigs(tmp_path / "rigs", 2)
    runner = Runner(RunLimits())
    for case in find([str(tmp_path / "rigs")]).cases:
        task = plan(tmp_path / "store").next(case)
        assert isinstance(task, Task)
        assert runner.run(task).status == "determined"
        for child in workers():
            child.kill()
            child.wait(5.0)
    runner.close()


def test_the_memory_limit_fails_one_study(tmp_path: Path) -> None:
    """Without a limit the 8 GiB would be allocated, because they are never written."""
    rig(tmp_path / "rigs" / "hoards")
    rig(tmp_path / "rigs" / "whole")
    limits = RunLimits(memory_mib=4096)
    run(tmp_path / "rigs", tmp_path / "store", 1, limits=limits, start=POISONED)
    found = rows(tmp_path / "store")
    assert found["whole"]["status"] == "determined"
    assert (found["hoards"]["status"], found["hoards"]["exit_code"]) == ("failed", 1)
    assert "more memory" in found["hoards"]["message"]


def test_a_worker_that_ends_itself_reports_the_timeout(tmp_path: Path) -> None:
    """As without a parent; the last line of the traceback is not the cause."""
    script = (
        "import faulthandler, time; print('{}', flush=True);"
        "faulthandler.dump_traceback_later(0.1, exit=True); time.sleep(60.0)"
    )
    case = find([str(rig(tmp_path / "one"))]).cases[0]
    task = plan(tmp_path / "store").next(case)
    assert isinstance(task, Task)
    outcome = Runner(RunLimits(), entry=("-c", script)).run(task)
    assert (outcome.status, outcome.exit_code) == ("failed", 1)
    assert "Timeout (0:00:00.1" in outcome.message


def test_a_worker_that_does_not_start_ends_the_campaign(tmp_path: Path) -> None:
    rigs(tmp_path / "rigs", 2)
    absent = partial(Runner, entry=("-m", "no_such_module"))
    with pytest.raises(InvalidInput, match=r"does not start: .*No module named no_such_module"):
        run(tmp_path / "rigs", tmp_path / "store", start=absent)
    assert not (tmp_path / "store" / "runs").exists()


def test_closing_the_generator_kills_the_processes(tmp_path: Path) -> None:
    rig(tmp_path / "rigs" / "hangs-1")
    rig(tmp_path / "rigs" / "hangs-2")
    rig(tmp_path / "rigs" / "a-whole")
    cases = find([str(tmp_path / "rigs")]).cases
    outcomes = runner.run(cases, plan(tmp_path / "store"), 2, RunLimits(), POISONED)
    assert next(outcomes).status == "determined"
    start = time.monotonic()
    outcomes.close()
    assert time.monotonic() - start < 30.0  # they hang for an hour
    psutil.wait_procs(workers(), timeout=5.0)
    assert workers() == []
    assert list(rows(tmp_path / "store")) == ["a-whole"]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_worker_has_one_thread_for_blas(tmp_path: Path) -> None:
    rig(tmp_path / "rigs" / "one")
    task = plan(tmp_path / "store").next(find([str(tmp_path / "rigs")]).cases[0])
    assert isinstance(task, Task)
    runner = Runner(RunLimits())
    runner.run(task)
    (child,) = workers()
    assert child.environ()["OPENBLAS_NUM_THREADS"] == "1"
    runner.close()


class Dead:
    """A worker process that has ended with a code."""

    def __init__(self, code: int) -> None:
        self.code, self.stdin = code, io.BytesIO()

    def wait(self, _limit: float = 0.0) -> int:
        return self.code

    poll = wait


def test_an_exit_code_of_windows_is_recorded(tmp_path: Path) -> None:
    death = Runner(RunLimits())
    death._child = Dead(0xC0000005)  # type: ignore[assignment]
    code, message = death._death()
    assert (code, message) == (255, "the process ended with exit code 3221225477")


ON_MACOS = """
import sys
from strainwave import pipeline
from strainwave.fleet.campaign import worker
from strainwave.numerics.parallel import configure_process
configure_process()
sys.platform = "darwin"
worker.main()
"""


def test_a_limit_that_the_system_lacks_is_one_sentence(tmp_path: Path) -> None:
    start = partial(Runner, entry=("-c", ON_MACOS))
    limits = RunLimits(memory_mib=4096)
    with pytest.raises(InvalidInput, match="cannot limit the memory of a process") as error:
        run(rigs(tmp_path / "rigs", 1), tmp_path / "store", start=start, limits=limits)
    assert "leave the limit out" in str(error.value)
