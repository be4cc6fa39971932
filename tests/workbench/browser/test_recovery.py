"""kill -9 of the server in the middle of a run."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext


def test_after_a_kill_the_study_and_finished_runs_are_there(
    folder: Path, context: BrowserContext, start_server: Any
) -> None:
    from strainwave.workbench.runs import Runs

    server = start_server(folder)
    page = context.new_page()
    page.goto(f"{server.url}/?token={server.token}")
    page.goto(f"{server.url}/check/arm/study.toml")
    page.click("#check")
    page.wait_for_selector("#state[data-state=consistent]")
    page.goto(f"{server.url}/estimate/arm/study.toml")
    page.wait_for_selector("#start:not([disabled])")
    page.check("input[value='rigid']")
    page.click("#start")
    page.wait_for_selector("tr[data-run='identify-1'][data-state='done']")
    page.check("input[value='rigid,decoupled,tuned']")
    page.click("#start")
    page.wait_for_selector("tr[data-run='identify-2'][data-state='running']")
    server.stop(at_once=True)
    group = Runs(folder / "arm" / "study.toml").get("identify-2").group
    assert group is not None  # its processes live
    os.killpg(group, signal.SIGKILL)

    again = start_server(folder)
    page.goto(f"{again.url}/?token={again.token}")
    page.goto(f"{again.url}/estimate/arm/study.toml")
    page.wait_for_selector("tr[data-run='identify-1'][data-state='done']")
    page.wait_for_selector("tr[data-run='identify-2'][data-state='interrupted']")
    assert page.locator("#start").is_enabled()  # the check is still valid
    page.goto(f"{again.url}/study/arm/study.toml")
    page.wait_for_selector("#state[data-state=valid]")
    page.close()
