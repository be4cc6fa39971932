"""Add logs to a study, change its experiments, and take rig values of other studies."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from strainwave.init import start_study
from strainwave.io.study import read_study
from workbench_drop import drop


def open_study(visit: Any, study: str = "arm") -> Any:
    page = visit.open(f"/study/{study}/study.toml")
    page.wait_for_selector("#state[data-state]")
    visit.wait_until("document.querySelector('#log').options.length > 0")
    return page


def experiments(visit: Any, study: str = "arm") -> Any:
    return read_study(visit.folder / study / "study.toml").experiments


def wait_for_rows(visit: Any, count: int) -> None:
    visit.wait_until(f"document.querySelectorAll('#experiments tr').length === {count}")


def test_a_dropped_log_becomes_an_experiment_that_is_undone(visit: Any, tmp_path: Path) -> None:
    log = tmp_path / "more 'x'.parquet"
    shutil.copy(visit.folder / "arm" / "prbs-j1.parquet", log)
    page = open_study(visit)
    before, n_rows = experiments(visit), page.locator("#experiments tr").count()
    drop(page, log)
    wait_for_rows(visit, n_rows + 1)
    added = experiments(visit)[-1]
    assert (added.name, added.file, added.use) == ("more -x", "more -x.parquet", "frequency")
    assert added.prbs == before[2].prbs
    message = page.locator("#message").inner_text()
    assert "Added: more -x (frequency)." in message
    assert "stored as more -x.parquet." in message
    visit.check_accessibility()
    page.click("#undo")
    wait_for_rows(visit, n_rows)
    assert experiments(visit) == before
    page.select_option("#log", "more -x.parquet")
    page.click("#add")
    wait_for_rows(visit, n_rows + 1)
    assert experiments(visit)[-1] == added


def test_experiments_are_duplicated_changed_and_removed(visit: Any) -> None:
    page = open_study(visit)
    first, n_rows = experiments(visit)[0], len(experiments(visit))
    page.get_by_role("button", name=f"Duplicate {first.name}", exact=True).click()
    wait_for_rows(visit, n_rows + 1)
    name = page.locator("#field-experiment-1-name")
    assert name.input_value() == f"{first.name} (2)"
    use = page.locator("#field-experiment-1-use")
    assert "check: validation" in use.inner_text()
    use.select_option("check")
    page.locator("#field-experiment-1-file").select_option("motion-check.parquet")
    page.fill("#field-experiment-1-start", "1.5")
    name.fill('half "a"')  # the start is saved meanwhile
    page.keyboard.press("Tab")
    visit.wait_until("document.querySelector('#text').value.includes('half')")
    assert page.evaluate("document.activeElement.id") == "field-experiment-1-file"
    second = experiments(visit)[1]
    assert (second.name, second.file) == ('half "a"', "motion-check.parquet")
    assert (second.use, second.start) == ("check", 1.5)
    visit.check_accessibility()
    page.get_by_role("button", name='Remove half "a"').press("Enter")
    wait_for_rows(visit, n_rows)
    assert experiments(visit)[0] == first
    assert len(experiments(visit)) == n_rows


def test_rig_values_come_from_a_study_of_the_folder_or_from_pasted_text(visit: Any) -> None:
    new = visit.folder / "new"
    new.mkdir()
    shutil.copy(visit.folder / "arm" / "prbs-j1.parquet", new)
    start_study([new / "prbs-j1.parquet"], new / "study.toml")
    draft = (new / "study.toml").read_text()
    page = open_study(visit, "new")
    page.select_option("#lender", "arm/study.toml")
    page.click("#take")
    page.wait_for_selector("#state[data-state=valid]")
    arm = read_study(new / "study.toml").arm
    assert arm == read_study(visit.folder / "arm" / "study.toml").arm
    assert "gear_ratio of joint 2" in page.locator("#message").inner_text()
    page.click("#undo")
    page.wait_for_selector("#state[data-state=error]")
    assert (new / "study.toml").read_text() == draft
    page.evaluate(
        """text => {
          const clipboardData = new DataTransfer();
          clipboardData.setData('text', text);
          const event = { clipboardData, bubbles: true };
          document.body.dispatchEvent(new ClipboardEvent('paste', event));
        }""",
        '{"arm": {"link_length": 0.4}}',
    )
    visit.wait_until("document.querySelector('#text').value.includes('link_length = 0.4 ')")


def test_values_that_cannot_be_taken_are_a_sentence(visit: Any, tmp_path: Path) -> None:
    (tmp_path / "sheet.toml").write_text("[[joint]]\ngear_ratio = 1.0\n")
    page = open_study(visit)
    before = (visit.folder / "arm" / "study.toml").read_text()
    drop(page, tmp_path / "sheet.toml")
    page.wait_for_selector("#message.bad:has-text('1 joint(s), and this arm has 2')")
    visit.take_refusals()
    assert (visit.folder / "arm" / "study.toml").read_text() == before
