"""The campaign command: exit codes, output, wrong arguments."""

from __future__ import annotations

import io
from datetime import datetime
from pathlib import Path

import pytest
from rich.console import Console

import strainwave as sw
from campaign_rigs import log, rig, rigs
from command_line import Finished, run_here
from strainwave.fleet.campaign import (
    MAX_LISTED_RUNS,
    Settings,
    Tally,
    _display,
    _undetermined,
    cause,
)
from strainwave.fleet.campaign import run as run_campaign
from strainwave.fleet.campaign.records import Outcome
from strainwave.fleet.campaign.store import Store


def campaign(*arguments: str | Path) -> Finished:
    """The command in this process; its studies run in a worker, as always."""
    return run_here("campaign", *arguments, "--stages", "rigid", "--workers", "1")


def test_the_exit_code_is_zero_only_if_all_are_determined(tmp_path: Path) -> None:
    rigs(tmp_path / "rigs", 2)
    done = campaign(tmp_path / "rigs", "--out", tmp_path / "store")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("2 of 2 studies: 2 determined; ")
    one_way = rig(tmp_path / "rigs" / "one-way")
    (one_way.parent / "motion.csv").write_bytes(log(0.02, backwards=False))
    broken = rig(tmp_path / "rigs" / "broken")
    (broken.parent / "motion.csv").write_bytes(b"")
    done = campaign(tmp_path / "rigs", "--out", tmp_path / "store")
    assert (done.returncode, done.stderr) == (3, "")
    counts = "2 determined, 1 partly-determined, 1 failed"
    assert done.stdout.startswith(f"4 of 4 studies, 2 of them recorded before: {counts}; ")
    assert done.stdout.count("\n") == 3
    rows = {row["study"]: row for row in sw.read_runs(tmp_path / "store").to_pylist()}
    for path, status in (
        (one_way, "partly-determined (exit code 3)"),
        (broken, "failed (exit code 2)"),
    ):
        (line,) = (each for each in done.stdout.splitlines() if str(path) in each)
        assert line.startswith(f"  {path}: {status}: ")
        assert "Remedy" not in line
        row = rows[str(path)]
        result = row["result"] or f"runs, run {row['run'][:8]}"
        assert line.endswith(f"[{tmp_path / 'store'}/{result}]")
    assert "not identified: motor_coulomb_friction 1" in done.stdout
    assert f"{broken.parent / 'motion.csv'}" in done.stdout
    again = campaign(tmp_path / "rigs", "--out", tmp_path / "store", "--quiet")
    assert (again.returncode, again.stderr) == (3, "")
    assert again.stdout.startswith(f"4 of 4 studies, 4 of them recorded before: {counts}; ")
    assert again.stdout.count("\n") == 1
    codes = dict(
        zip(
            *(sw.read_runs(tmp_path / "store")[c].to_pylist() for c in ("status", "exit_code")),
            strict=True,
        )
    )
    assert codes == {"determined": 0, "partly-determined": 3, "failed": 2}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["absent"], "absent: does not exist"),
        (["rigs", "--stages", "tuned"], "cannot run the stages tuned"),
        (["rigs", "--set", "rigid.bandwith_hz=3"], "did you mean 'bandwidth_hz'"),
        (["rigs", "--set", "rigid"], "STAGE.KEY=VALUE"),
        (["rigs", "--set", "links.ordr=1"], "--set links.ordr=1: the key 'ordr' is unknown"),
        (["rigs", "--scheduler", "tcp://x:1", "--cluster", "c.toml"], "are given together"),
        (["rigs", "--cluster", "c.toml"], "the cluster's description does not exist"),
        (["rigs", "--workers", "0"], "--workers"),
    ],
)
def test_wrong_arguments_exit_with_two_and_write_nothing(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rig(tmp_path / "rigs")
    done = run_here("campaign", *arguments, "--out", "store")
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.glob("store/*/*"))


def test_a_store_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    rig(tmp_path / "rigs")
    (tmp_path / "store").write_text("a file")
    done = campaign(tmp_path / "rigs", "--out", tmp_path / "store")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cannot write there" in done.stderr


def test_options_of_the_command_apply_to_every_study(tmp_path: Path) -> None:
    rig(tmp_path / "rigs")
    campaign(tmp_path / "rigs", "--out", tmp_path / "store")
    done = campaign(tmp_path / "rigs", "--out", tmp_path / "store", "--set", "rigid.bandwidth_hz=9")
    assert done.returncode == 0
    rows = sw.read_runs(tmp_path / "store").to_pylist()
    assert len({row["options_sha256"] for row in rows}) == 2
    bandwidths = {
        sw.read_result(tmp_path / "store" / row["result"]).document["options"]["rigid"][
            "bandwidth_hz"
        ]
        for row in rows
    }
    assert bandwidths == {None, 9.0}


def test_small_files_are_merged_at_the_end(tmp_path: Path) -> None:
    rigs(tmp_path / "rigs", 10)
    settings = Settings(store=str(tmp_path / "store"), stages=("rigid",), workers=1)
    summary = run_campaign([str(tmp_path / "rigs")], settings)
    assert (summary.exit_code, summary.unmerged) == (0, "")
    (file,) = (tmp_path / "store" / "runs").glob("*.parquet")
    assert file.name.startswith("part-")
    assert sw.read_runs(tmp_path / "store").num_rows == 10


def test_a_failed_merge_is_reported_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: Store) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Store, "merge", full)
    rigs(tmp_path / "rigs", 2)
    settings = Settings(store=str(tmp_path / "store"), stages=("rigid",), workers=1)
    summary = run_campaign([str(tmp_path / "rigs")], settings)
    assert (summary.exit_code, summary.ended_early) == (0, "")
    assert "could not be merged (No space left on device)" in summary.unmerged
    assert sw.read_runs(tmp_path / "store").num_rows == 2


def outcome(status: str, message: str = "", *, skipped: bool = False) -> Outcome:
    code = 0 if status == "determined" else 3
    return Outcome(
        run=message,
        study="s",
        status=status,
        exit_code=code,
        message=message,
        seconds=0.0,
        started=datetime(2026, 1, 1),
        skipped=skipped,
    )


def test_the_display_groups_runs_by_cause() -> None:
    tally = Tally(9)
    for number in range(3):
        tally.add(outcome("failed", f"/rigs/{number}/motion.csv: has {number} rows. Remedy: more"))
    tally.add(outcome("determined", skipped=True))
    tally.add(outcome("partly-determined", "not identified: gear_damping 1"))
    assert (tally.done, tally.skipped) == (4, 1)
    assert tally.seconds_left == pytest.approx(4 / tally.rate, rel=0.1)
    out = io.StringIO()
    Console(file=out, width=100).print(_display(tally, "http://host:8787/status"))
    shown = out.getvalue()
    assert "5 of 9 studies" in shown
    assert "1 determined, 1 partly-determined, 3 failed" in shown
    assert "  3 failed: ... has # rows." in shown
    assert "http://host:8787/status" in shown
    assert Tally(9).seconds_left is None


def test_many_undetermined_runs_are_summarised(tmp_path: Path) -> None:
    tally = Tally(50)
    for number in range(50):
        tally.add(outcome("failed", f"/rigs/{number}/motion.csv: has {number} rows. Remedy: more"))
    lines = list(_undetermined(tally, Store(tmp_path)))
    assert lines[0] == "  50 failed: ... has # rows."
    assert len(lines) == 1 + MAX_LISTED_RUNS + 1
    assert lines[1].startswith("  s: failed (exit code 3): /rigs/0/motion.csv: has 0 rows. [")
    assert lines[-1] == "  ... and 30 more: see sw.read_runs"


def test_a_cause_has_no_file_names_and_numbers() -> None:
    one = cause("a/study.toml, line 3: unknown key 'x'. Remedy: mend line 3")
    assert one == cause("b/c/study.toml, line 17: unknown key 'x'. Remedy: mend line 17")
    assert len(cause("word " * 100)) <= 90
