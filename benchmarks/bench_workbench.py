"""The workbench against the times that a user notices.

A first page within a second; a study of about 9 MB on screen within two; a view of a million
samples, and curves that follow a slider, within a tenth.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING
from urllib.request import HTTPCookieProcessor, build_opener

import numpy as np

from benchmarks.studies.drawn_chains import draw_chain, simulate_chain
from benchmarks.timing import Row, best_of
from strainwave.domain import Experiment, Log
from strainwave.dynamics.simulation import SensorNoise
from strainwave.io.parameters import parameter_file
from strainwave.report.figures.log_figures import ShownRecord, View, time_figure
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study

if TYPE_CHECKING:
    from playwright.sync_api import Page

_SAMPLES = 1_000_000
_PIXELS = 2400
_FIRST_PAGE, _STUDY, _VIEW, _SLIDER = 1.0, 2.0, 0.1, 0.1  # [s] limits
_UPDATES = 20
_SAMPLE_TIME = 8e-5  # [s] of fast records: the study has about 9 MB


def rows() -> list[Row]:
    """The table's rows; without Chromium only those of the server."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        study, values = scara.STIFF.study(folder / "arm"), scara.STIFF.parameters()
        simulate_study(
            study,
            values,
            folder / "arm",
            noise=SensorNoise(),
            as_recorded=False,
            sample_time=_SAMPLE_TIME,
        )
        text = parameter_file(values)
        (folder / "arm" / "values.json").write_bytes(text)
        size = sum(p.stat().st_size for p in (folder / "arm").iterdir()) / 1e6
        table = [
            Row("workbench, first byte after the start", _first_byte(folder), "limit", _FIRST_PAGE)
        ]
        table.append(Row("workbench, view of 1e6 samples", _view_of_a_million(), "limit", _VIEW))
        _write_seven_joints(folder / "seven")
        if chromium():
            with serve(folder) as url:
                table += _in_browser(url, size)
        return table


def chromium() -> str | None:
    """Path of the system's Chromium."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((path for path in map(shutil.which, names) if path), None)


@contextmanager
def serve(folder: Path) -> Iterator[str]:
    """Address of a served folder, with the token."""
    command = [sys.executable, "-m", "strainwave", "serve", str(folder), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().rsplit(" ", 1)[-1].strip()
        finally:
            process.terminate()


def _first_byte(folder: Path) -> float:
    """Time from the start of the command to the first page, without a browser."""
    begin = time.perf_counter()
    with serve(folder) as url, build_opener(HTTPCookieProcessor()).open(url) as answer:
        answer.read()
        return time.perf_counter() - begin


def _view_of_a_million() -> float:
    time_axis = np.arange(_SAMPLES) * np.float64(1e-4)
    channels = {"u1": np.random.default_rng(0).normal(size=_SAMPLES)}
    experiment = Experiment("one", "one.csv", "motion", ("servo", "servo"))
    log = Log(experiment, time_axis, 1e-4, channels)
    span = (0.0, float(time_axis[-1]))
    view = View([ShownRecord("one", [log])], ["u1"], scara.STIFF.study(Path()).arm)
    return best_of(partial(time_figure, view, span, _PIXELS))


def _in_browser(link: str, size: float) -> list[Row]:
    from playwright.sync_api import sync_playwright

    url = link.partition("/?")[0]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        first = _time(page, link, "main h1")
        study = _time(page, f"{url}/signals/arm/study.toml", "#time[data-drawn]")
        sliders = {
            "curves after a slider": _slider(page, url, "arm", "step-j1"),
            "curves of seven joints after a slider": _slider(page, url, "seven", "motion"),
        }
        browser.close()
    return [
        Row("workbench, first page in Chromium", first, "limit", _FIRST_PAGE),
        Row(f"workbench, study of {size:.0f} MB on screen", study, "limit", _STUDY),
        *(Row(f"workbench, {task}", time, "limit", _SLIDER) for task, time in sliders.items()),
    ]


def _write_seven_joints(folder: Path) -> None:
    """Study and logs of the first drawn chain of seven joints, with an IMU on each link."""
    chains = (draw_chain(seed, (7,), ("imu",)) for seed in count())
    chain = next(chain for chain in chains if chain.engine == "own")
    simulate_chain(chain, folder, 0)
    (folder / "values.json").write_bytes(parameter_file(chain.values))


def _time(page: Page, address: str, selector: str) -> float:
    begin = time.perf_counter()
    page.goto(address)
    page.wait_for_selector(selector)
    return time.perf_counter() - begin


def _slider(page: Page, url: str, arm: str, record: str) -> float:
    """Median time from a change of a slider of joint 1 to the drawn curves."""
    page.goto(f"{url}/by-hand/{arm}/study.toml")
    page.select_option("#record", record)
    page.wait_for_selector(f"#note[data-record='{record}']", state="attached")
    page.select_option("#joint", "1")
    times = []
    slider = page.locator("[data-group='Joint 1'] .slider input[type=range]").first
    for _ in range(_UPDATES):
        slider.press("ArrowUp")
        page.wait_for_timeout(250)
        text = page.evaluate("document.querySelector('#note').dataset.milliseconds")
        times.append(1e-3 * float(text))
    return float(np.median(times))
