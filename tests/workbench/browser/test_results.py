"""The table of results in a browser: sort, filter, tag, compare, delete, and read reports by keyboard."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from strainwave.init.changes import KeyChange, edit_study
from strainwave.workbench.pages.check import run_check
from strainwave.workbench.runs import Runs
from workbench_runs import add_run, result_of

if TYPE_CHECKING:
    from playwright.sync_api import Dialog, Page

STUDY = "arm/study.toml"
ESTIMATE = f"/estimate/{STUDY}"


@pytest.fixture
def table(visit: Any) -> Any:
    """The page with four runs: two results, a failed and a damaged one, and a plan."""
    study = visit.folder / STUDY
    for day, (name, stiffness) in enumerate((("one", 6100.0), ("two", 6000.0)), start=2):
        result = result_of(stiffness, (90.0 + day, 99.0))
        command = ["identify", "study.toml", "--out", ".", "--stages", "rigid"]
        if name == "two":
            result["options"]["links"]["order"] = 1
            command += ["--set", "links.order=1"]
        created = f"2026-11-0{day}T10:00:00.000+00:00"
        add_run(study, name, result, created=created, commands=[command])
    failed = add_run(study, "failed", state="failed", status=None)
    (failed / "log.txt").write_text("strainwave: the log is empty.\n")
    (add_run(study, "damaged") / "run.json").write_text("{")
    add_run(study, "excite-1", kind="excite", status=None)
    visit.open(ESTIMATE).wait_for_selector("#runs tr")
    return visit


def names(page: Page) -> list[str]:
    return [row.get_attribute("data-run") or "" for row in page.locator("#runs tr").all()]


def focused(page: Page) -> str:
    key: str = page.evaluate("document.activeElement.dataset.key ?? document.activeElement.id")
    return key


def test_columns_are_sorted_by_keyboard_filtered_and_chosen(table: Any) -> None:
    page = table.page
    assert names(page)[:2] == ["two", "one"]  # the newest first
    page.focus("[data-key='sort parameter gear_stiffness 1']")
    page.keyboard.press("Enter")
    assert names(page)[:2] == ["one", "two"]
    page.keyboard.press("Enter")
    assert names(page)[:2] == ["two", "one"]
    assert focused(page) == "sort parameter gear_stiffness 1"
    assert page.locator("th[aria-sort='ascending']").inner_text().startswith("gear_stiffness 1")
    table.check_accessibility()
    assert "the log is empty" in page.inner_text("tr[data-run='failed']")
    assert "run.json is damaged" in page.inner_text("tr[data-run='damaged']")
    page.fill("#find", "links.order")
    assert names(page) == ["two"]
    page.fill("#find", "")
    page.select_option("#kind", "designs")
    assert names(page) == ["excite-1"]
    page.select_option("#kind", "estimates")
    page.select_option("#state", "failed")
    assert sorted(names(page)) == ["damaged", "failed"]
    page.select_option("#state", "")
    page.click("summary:has-text('Columns')")
    page.check("#columns input[value='alpha']")
    page.wait_for_selector("[data-key='sort parameter alpha']")
    page.reload()  # the browser keeps the choice
    page.wait_for_selector("[data-key='sort parameter alpha']")


def test_ticked_runs_are_compared_tagged_copied_and_deleted(table: Any) -> None:
    page = table.page
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.check("[data-key='tick one']")
    assert page.get_attribute("#compare", "href") is None
    page.check("[data-key='tick two']")
    href = page.get_attribute("#compare", "href")
    assert href == (
        f"/compare/{STUDY}?path=arm%2Fruns%2Fone%2Fresult.json&path=arm%2Fruns%2Ftwo%2Fresult.json"
    )
    page.click("#copy")
    page.wait_for_selector("#message:not([hidden])")
    assert "identify study.toml" in page.evaluate("navigator.clipboard.readText()")
    page.uncheck("[data-key='tick two']")
    page.fill("#tag", "warm")
    page.click("#add-tag")
    page.get_by_role("button", name="Filter by the tag warm").click()
    assert names(page) == ["one"]
    page.reload()
    page.wait_for_selector("#runs tr")
    page.select_option("#kind", "")
    page.check("[data-key='tick all']")
    page.uncheck("[data-key='tick two']")
    questions: list[str] = []

    def accept(dialog: Dialog) -> None:
        questions.append(dialog.message)
        dialog.accept()

    page.on("dialog", accept)
    page.focus("#delete")
    page.keyboard.press("Enter")
    page.wait_for_selector("tr[data-run='one']", state="detached")
    assert len(questions) == 1
    assert questions[0].startswith("Delete 4 runs with their files: ")
    assert [run.name for run in Runs(table.folder / STUDY).all()] == ["two"]


def test_a_report_is_opened_and_left_by_keyboard(table: Any) -> None:
    page = table.page
    page.focus("[data-key='open two']")
    page.keyboard.press("Enter")
    page.frame_locator("#report-frame").get_by_role("heading", name="two").wait_for()
    assert page.url.endswith("?run=two")
    assert focused(page) == "report-title"
    table.check_accessibility()
    page.keyboard.press("Escape")
    page.wait_for_selector("#report", state="hidden")
    assert focused(page) == "open two"
    assert page.url.endswith(ESTIMATE)
    page.go_forward()
    page.wait_for_selector("#report:not([hidden])")
    page.go_back()
    page.wait_for_selector("#report", state="hidden")
    table.open(f"{ESTIMATE}?run=failed")
    page.wait_for_selector("#report-log:not([hidden])")
    assert "Messages of failed" in page.inner_text("#report-title")
    page.click("#report-close")
    page.wait_for_selector("#report", state="hidden")
    assert page.url.endswith(ESTIMATE)


def test_a_refused_value_gets_the_focus_and_options_are_taken_and_reset(table: Any) -> None:
    changes = [KeyChange(("options", "tuning", "max_iterations"), 50)]
    edit_study(table.folder / STUDY, changes)
    run_check(table.folder / STUDY)
    page = table.open(ESTIMATE)
    page.wait_for_selector("#start:not([disabled])")
    page.click("#options > summary")
    page.fill("[id='option-statespace.order']", "99")
    assert page.inner_text("#changed") == "1 changed"
    page.click("#start")
    page.wait_for_selector("[aria-invalid='true']")
    assert focused(page) == "option-statespace.order"
    assert "'order' is 99" in page.inner_text("[id='fault-option-statespace.order']")
    table.check_accessibility()
    table.take_refusals()
    page.click("#reset")
    assert page.input_value("[id='option-statespace.order']") == ""
    assert page.locator("[aria-invalid]").count() == 0
    page.check("[data-key='tick two']")
    page.click("#use")
    assert page.input_value("[id='option-links.order']") == "1"
    assert page.input_value("[id='option-tuning.max_iterations']") == "100"  # not that of the study
    assert page.is_checked("input[value='rigid']")
    page.fill("#name", "one")
    page.click("#start")
    page.wait_for_selector("#name[aria-invalid='true']")
    assert focused(page) == "name"
    table.take_refusals()
    page.click("#options [aria-label='About links.order']")
    assert "low-pass" in page.inner_text("[id='text-links.order']")


def test_a_design_that_failed_has_its_message_and_is_deleted(visit: Any) -> None:
    path = add_run(visit.folder / STUDY, "tune-1", kind="tune", state="failed", status=None)
    (path / "log.txt").write_text("strainwave: --bandwidth=x: 'x' is not a number.\n")
    page = visit.open(f"/design/{STUDY}")
    page.wait_for_selector("tr[data-run='tune-1']")
    assert "Smallest bandwidth=x" in page.inner_text("tr[data-run='tune-1']")
    visit.check_accessibility()
    page.on("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Delete tune-1").press("Enter")
    page.wait_for_selector("tr[data-run='tune-1']", state="detached")
    assert not path.exists()
