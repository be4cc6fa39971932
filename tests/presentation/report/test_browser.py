"""The page in a browser: figures stand, nothing is fetched or complained of, themes and paper work."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from elastic_results import elastic_identification
from strainwave.presentation.report import figures_of, render

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to show the page in")

# a script of the tests may watch the page, and say on <html> what it saw
BEFORE = "<head>", "<head><script>{}</script>"
AFTER = (
    "</body>",
    "<script>setTimeout(() => {{ const seen = document.documentElement.dataset; {} }}, 4000)</script></body>",
)


def shown(page: str, folder: Path, *flags: str) -> tuple[dict[str, str], str]:
    """What the page says of itself after a while, and the console's lines."""
    file = folder / "page.html"
    file.write_text(page, encoding="utf-8")
    done = subprocess.run(
        [
            str(CHROMIUM),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder / 'profile'}",
            "--enable-logging=stderr",
            "--v=0",
            "--virtual-time-budget=15000",
            *flags,
            "--dump-dom",
            file.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    head = re.search(r"<html[^>]*>", done.stdout)
    assert head is not None
    console = "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)
    return dict(re.findall(r'data-([a-z]+)="([^"]*)"', head[0])), console


def watched(page: str, *, before: str = "", after: str = "") -> str:
    page = page.replace(BEFORE[0], BEFORE[1].format(before), 1)
    at = page.rindex(AFTER[0])
    return page[:at] + AFTER[1].format(after) + page[at + len(AFTER[0]) :]


@pytest.fixture(scope="module")
def page() -> str:
    return render(elastic_identification())


def test_every_figure_is_drawn_and_the_console_is_silent(page: str, tmp_path: Path) -> None:
    count = "seen.plots = document.querySelectorAll('.plot .main-svg .cartesianlayer').length;"
    said, console = shown(watched(page, after=count), tmp_path)
    assert console == ""
    expected = str(len(figures_of(elastic_identification())))
    assert said["drawn"] == expected
    assert int(said["plots"]) == int(expected)


def test_a_page_that_fetches_or_fails_would_be_heard(page: str, tmp_path: Path) -> None:
    fetch = "new Image().src = 'https://example.org/x.png'; undefined.x;"
    _, console = shown(watched(page, after=fetch), tmp_path)
    assert "Content Security Policy" in console
    assert "TypeError" in console


def test_colours_follow_the_system_while_the_page_is_open(page: str, tmp_path: Path) -> None:
    system = (
        "const real = matchMedia.bind(window); const dark = new EventTarget(); dark.matches = false;"
        "window.matchMedia = (query) => query.includes('dark') ? dark : real(query);"
        "window.system = dark;"
    )
    look = (
        "const line = () => document.querySelector('.scatterlayer .js-line').style.stroke;"
        "seen.light = line(); system.matches = true; system.dispatchEvent(new Event('change'));"
        "seen.dark = line();"
    )
    said, console = shown(watched(page, before=system, after=look), tmp_path)
    assert console == ""
    assert said["light"] != said["dark"]
    assert "rgb" in said["dark"]


def test_a_phone_scrolls_one_way_only(page: str, tmp_path: Path) -> None:
    frame = tmp_path / "frame"
    frame.mkdir()
    (frame / "inner.html").write_text(page, encoding="utf-8")
    outer = (
        "<!doctype html><html><body><iframe src='frame/inner.html' width=390 height=800></iframe>"
        "<script>setTimeout(() => {"
        " const inner = document.querySelector('iframe').contentDocument.documentElement;"
        " document.documentElement.dataset.over = inner.scrollWidth - inner.clientWidth;"
        " document.documentElement.dataset.wide = inner.clientWidth;"
        "}, 5000)</script></body></html>"
    )
    said, _ = shown(outer, tmp_path, "--allow-file-access-from-files")
    assert int(said["wide"]) <= 390
    assert said["over"] == "0"


def test_paper_is_light_and_holds_every_figure(page: str, tmp_path: Path) -> None:
    look = (
        "window.dispatchEvent(new Event('beforeprint'));"
        "const svgs = [...document.querySelectorAll('.plot .main-svg')];"
        "seen.widest = Math.max(...svgs.map((svg) => svg.getBoundingClientRect().width));"
        "seen.ink = document.querySelector('.xtick text').style.fill;"
    )
    said, console = shown(
        watched(page, after=look), tmp_path, "--blink-settings=preferredColorScheme=0"
    )
    assert console == ""
    assert float(said["widest"]) <= 180.0 / 25.4 * 96.0  # [px] of A4 between its margins
    assert said["ink"] == "rgb(28, 36, 48)"
