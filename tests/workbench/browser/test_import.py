"""Drop logs: they are stored, and the page of their study shows every signal."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strainwave.io.study import read_study
from workbench_drop import drop


def test_a_dropped_folder_becomes_a_study_that_shows_its_signals(
    visit: Any, tmp_path: Path
) -> None:
    rig = tmp_path / "my rig?"
    (rig / "day 1").mkdir(parents=True)
    shutil.copy(visit.folder / "arm" / "prbs-j1.parquet", rig / "day 1")
    shutil.copy(visit.folder / "arm" / "motion.parquet", rig / 'it"s 1.parquet')
    (rig / "README.md").write_text("no log")
    (rig / "bad.csv").write_text("t,x\n0,1\n1,oops\n")
    page = visit.page  # of the studies
    drop(page, rig)
    page.wait_for_url("**/study/**")
    page.wait_for_selector("#signals polyline")
    assert page.url.endswith("/study/my%20rig/study.toml")
    names = ["bad.csv", "day 1-prbs-j1.parquet", "it-s 1.parquet", "study.toml"]
    assert sorted(path.name for path in (visit.folder / "my rig").iterdir()) == names
    notes = page.locator("#import-notes").inner_text()
    for part in (
        "The folder is named my rig instead of my rig?",
        'it"s 1.parquet: stored as it-s 1.parquet.',
        "day 1/prbs-j1.parquet: stored as day 1-prbs-j1.parquet.",
        "README.md",
        "Left out: my rig/bad.csv: ",
    ):
        assert part in notes
    captions = page.locator("#signals figcaption").all_inner_texts()
    assert len(captions) == 9  # all, before a value is typed
    assert any(text.startswith("theta_m1") and "rad" in text for text in captions)
    visit.check_accessibility()
    page.select_option("#overview-record", label="it-s 1")
    page.wait_for_selector("#overview-facts:has-text('it-s 1.parquet')")
    page.click("#dismiss")
    page.reload()
    page.wait_for_selector("#signals polyline")
    assert not page.locator("#import-notes").is_visible()


def test_an_upload_shows_its_progress_and_is_cancelled(visit: Any, tmp_path: Path) -> None:
    for name in ("first", "second"):
        (tmp_path / f"{name}.csv").write_bytes(b"0" * (4 << 20))
    page = visit.open("/import")
    session = page.context.new_cdp_session(page)
    slow = {"offline": False, "latency": 0, "downloadThroughput": -1}
    session.send("Network.emulateNetworkConditions", slow | {"uploadThroughput": 1 << 19})
    drop(page, tmp_path / "first.csv", tmp_path / "second.csv")
    bar = page.locator("progress[aria-label='Upload of first.csv']")
    bar.wait_for()
    visit.wait_until("document.querySelector('progress').value > 0")
    visit.check_accessibility()
    page.get_by_role("button", name="Cancel second.csv").click()
    page.get_by_role("button", name="Cancel first.csv").click()
    page.wait_for_selector("#uploads li:has-text('second.csv: cancelled')")
    assert page.locator("#uploads").inner_text().splitlines() == [
        "first.csv: cancelled",
        "second.csv: cancelled",
    ]
    visit.wait_until("!document.querySelector('#drop[aria-busy]')")
    assert [path.name for path in visit.folder.iterdir()] == ["arm"]


def test_logs_of_different_kinds_are_chosen_after_the_upload(visit: Any, tmp_path: Path) -> None:
    rig = tmp_path / "rig"
    rig.mkdir()
    shutil.copy(visit.folder / "arm" / "motion.parquet", rig)
    for name in ("one", "two"):
        (rig / f"{name}.urdf").write_text("<robot/>")
    page = visit.open("/import")
    drop(page, rig)
    page.wait_for_selector("#message:has-text('Choose the URDF')")
    visit.check_accessibility()
    page.select_option("#urdf", "one.urdf")
    page.click("#draft")
    page.wait_for_selector("#message.bad:has-text('one.urdf')")
    visit.take_refusals()
    page.select_option("#urdf", "")
    page.click("#draft")
    page.wait_for_url("**/study/rig/study.toml")


def test_logs_with_a_data_sheet_are_a_complete_study(visit: Any, tmp_path: Path) -> None:
    logs = [visit.folder / "arm" / f"{name}.parquet" for name in ("motion", "prbs-j1", "step-j1")]
    sheet = tmp_path / "rig.toml"
    shutil.copy(visit.folder / "arm" / "study.toml", sheet)
    page = visit.open("/import")
    page.fill("#folder", "rig 7")
    page.set_input_files("#files", [str(path) for path in [*logs, sheet]])
    page.wait_for_url("**/study/rig%207/study.toml")
    page.wait_for_selector("#state[data-state=valid]")
    arm = read_study(visit.folder / "rig 7" / "study.toml").arm
    assert arm == read_study(visit.folder / "arm" / "study.toml").arm


def test_a_folder_of_bags_is_kept_together(visit: Any, tmp_path: Path) -> None:
    bags = pytest.importorskip("bags", reason="the extra `bags` is not installed")
    time = np.arange(0.0, 4.0, 0.004)
    rig = tmp_path / "rig"
    rig.mkdir()
    for name in ("one", "two"):
        messages = []
        for t, ns in zip(time, bags.stamps(time), strict=True):
            angle, rate = np.sin(3.0 * t), 3.0 * np.cos(3.0 * t)
            state = bags.joint_state(ns, {"j": angle}, [rate], [rate - 9.0 * angle])
            messages.append(("/joint_states", ns, state))
        bags.write(rig / name, messages)
    (visit.folder / "rig").mkdir()  # taken
    page = visit.page
    drop(page, rig)
    page.wait_for_url("**/study/rig%20(2)/study.toml")
    page.wait_for_selector("#signals polyline")
    study = read_study(visit.folder / "rig (2)" / "study.toml")
    assert [each.file for each in study.experiments] == ["one", "two"]
    assert page.locator("#signals figcaption b").all_inner_texts() == [
        "torque1",
        "theta_m1",
        "omega_m1",
    ]
