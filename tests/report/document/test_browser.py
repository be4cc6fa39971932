"""The page in a browser: figures, no requests, no console errors, dark mode, print, phone."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from elastic_results import elastic_identification
from strainwave.report.document import figures_of, render

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")

# scripts of the tests observe the page and store results as data attributes of <html>
BEFORE = "<head>", "<head><script>{}</script>"
AFTER = (
    "</body>",
    "<script>setTimeout(() => {{ const data = document.documentElement.dataset; {} }}, 4000)</script></body>",
)


def run_page(page: str, folder: Path, *flags: str) -> tuple[dict[str, str], str]:
    """The stored results, and the lines of the console."""
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


FIGURES = figures_of(elastic_identification())
FOLDED = ("tuning-", "fitted-", "record-", "correlation-")
UNFOLD = "document.querySelectorAll('details').forEach((fold) => { fold.open = true; });"


def with_scripts(page: str, *, before: str = "", after: str = "") -> str:
    page = page.replace(BEFORE[0], BEFORE[1].format(before), 1)
    at = page.rindex(AFTER[0])
    return page[:at] + AFTER[1].format(after) + page[at + len(AFTER[0]) :]


@pytest.fixture(scope="module")
def page() -> str:
    return render(elastic_identification())


def test_every_figure_is_drawn_when_it_is_unfolded(page: str, tmp_path: Path) -> None:
    count = (
        "const plots = () => document.querySelectorAll('.plot .main-svg .cartesianlayer').length;"
        f"data.folded = plots(); {UNFOLD} setTimeout(() => {{ data.plots = plots(); }}, 2000);"
    )
    results, console = run_page(with_scripts(page, after=count), tmp_path)
    assert console == ""
    expected = len(FIGURES)
    folded = [name for name in FIGURES if name.startswith(FOLDED)]
    assert int(results["folded"]) == expected - len(folded)
    assert int(results["drawn"]) == int(results["plots"]) == expected


def test_the_contents_fold_unfold_and_reveal_sections(page: str, tmp_path: Path) -> None:
    steps = (
        "const open = () => document.querySelectorAll('section > details[open]').length;"
        "const button = document.querySelector('nav button');"
        "data.first = open(); button.click(); data.none = open();"
        "location.hash = '#parameter-motor_inertia';"
        "setTimeout(() => { data.one = open(); data.unfolded ="
        " document.querySelector('#parameters > details').open; button.click(); button.click();"
        " data.all = open(); }, 500);"
    )
    results, console = run_page(with_scripts(page, after=steps), tmp_path)
    assert console == ""
    count = str(page.count("<section "))
    assert (results["first"], results["none"], results["one"], results["all"]) == (
        count,
        "0",
        "1",
        count,
    )
    assert results["unfolded"] == "true"


def test_the_knees_of_the_stiffness_curve_are_drawn_on_the_curve(page: str, tmp_path: Path) -> None:
    """The vertices of the drawn path lie under the centres of the knee markers."""
    look = (
        "const plot = document.querySelector('#figure-gear-joint-1-torsion');"
        "const path = [...plot.querySelectorAll('.scatterlayer .js-line')].at(-1);"
        "const corners = path.getAttribute('d').slice(1).split('L').map((p) => p.split(','));"
        "const knees = [...plot.querySelectorAll('.points path')].map("
        " (p) => p.getAttribute('transform').match(/[\\d.]+/g));"
        "const off = knees.map(([x, y]) => Math.min(...corners.map("
        " ([u, v]) => Math.hypot(u - x, v - y))));"
        "data.knees = knees.length; data.off = Math.max(...off);"
    )
    results, console = run_page(with_scripts(page, after=look), tmp_path)
    assert console == ""
    assert results["knees"] == "2"
    assert float(results["off"]) < 0.5  # [px]


@pytest.mark.parametrize("width", [390, 1400])
def test_the_contents_stay_visible(page: str, width: int, tmp_path: Path) -> None:
    after = (
        "scrollTo(0, document.querySelector('#gears').offsetTop);"
        "window.dispatchEvent(new Event('scroll'));"  # headless Chromium sends no scroll event
        "setTimeout(() => { const box = document.querySelector('nav').getBoundingClientRect();"
        " data.top = Math.round(box.top); data.current ="
        " document.querySelector('nav [aria-current]').hash.slice(1); }, 500);"
    )
    results, _ = run_page(with_scripts(page, after=after), tmp_path, f"--window-size={width},800")
    assert (results["top"], results["current"]) == ("0", "gears")


def test_a_request_or_an_error_would_be_reported(page: str, tmp_path: Path) -> None:
    fetch = "new Image().src = 'https://example.org/x.png'; undefined.x;"
    _, console = run_page(with_scripts(page, after=fetch), tmp_path)
    assert "Content Security Policy" in console
    assert "TypeError" in console


def test_the_buttons_cover_nothing_and_upload_nothing(page: str, tmp_path: Path) -> None:
    look = (
        "const bars = [...document.querySelectorAll('.modebar')];"
        "const box = (one) => one.getBoundingClientRect();"
        "data.bars = bars.length; data.inside = bars.filter("
        " (bar) => box(bar).bottom > box(bar.closest('.plot')).top + 0.5).length;"
        "data.buttons = [...new Set([...document.querySelectorAll('.modebar-btn')]"
        " .map((one) => one.dataset.title))].join(', ');"
    )
    results, _ = run_page(with_scripts(page, after=look), tmp_path, "--window-size=1280,900")
    assert int(results["bars"]) > 0
    assert results["inside"] == "0"
    assert results["buttons"] == "Download plot as a PNG, Zoom, Pan, Zoom in, Zoom out, Reset axes"


def test_colours_follow_the_system_theme(page: str, tmp_path: Path) -> None:
    system = (
        "const real = matchMedia.bind(window); const dark = new EventTarget(); dark.matches = false;"
        "window.matchMedia = (query) => query.includes('dark') ? dark : real(query);"
        "window.system = dark;"
    )
    look = (
        "const line = () => document.querySelector('.scatterlayer .js-line').style.stroke;"
        "data.light = line(); system.matches = true; system.dispatchEvent(new Event('change'));"
        "data.dark = line();"
    )
    results, console = run_page(with_scripts(page, before=system, after=look), tmp_path)
    assert console == ""
    assert results["light"] != results["dark"]
    assert "rgb" in results["dark"]


def test_a_phone_scrolls_vertically_only(page: str, tmp_path: Path) -> None:
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
    results, _ = run_page(outer, tmp_path, "--allow-file-access-from-files")
    assert int(results["wide"]) <= 390
    assert results["over"] == "0"


def test_a_phone_shows_the_row_names_of_a_heat_map_only(page: str, tmp_path: Path) -> None:
    narrow = (
        "const real = matchMedia.bind(window); const narrow = new EventTarget();"
        "narrow.matches = true;"
        "window.matchMedia = (query) => query.includes('max-width') ? narrow : real(query);"
        "window.phone = narrow;"
    )
    look = (
        "const map_ = document.querySelector('#figure-correlations');"
        "const names = (axis) => map_.querySelectorAll(`.${axis}tick text`).length;"
        "data.below = names('x'); data.left = names('y');"
        "phone.matches = false; phone.dispatchEvent(new Event('change'));"
        "data.wide = names('x');"
    )
    results, console = run_page(with_scripts(page, before=narrow, after=look), tmp_path)
    assert console == ""
    assert results["below"] == "0"
    assert results["left"] == results["wide"] != "0"


def test_the_printed_page_is_light_and_holds_every_figure(page: str, tmp_path: Path) -> None:
    look = (
        "window.dispatchEvent(new Event('beforeprint'));"
        "const svgs = [...document.querySelectorAll('.plot .main-svg')];"
        "data.widest = Math.max(...svgs.map((svg) => svg.getBoundingClientRect().width));"
        "data.ink = document.querySelector('.xtick text').style.fill;"
    )
    results, console = run_page(
        with_scripts(page, after=look), tmp_path, "--blink-settings=preferredColorScheme=0"
    )
    assert console == ""
    assert float(results["widest"]) <= 180.0 / 25.4 * 96.0  # [px] of A4 between its margins
    assert results["ink"] == "rgb(28, 36, 48)"
