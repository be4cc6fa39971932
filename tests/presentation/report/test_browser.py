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


UNFOLD = "document.querySelectorAll('details').forEach((fold) => { fold.open = true; });"


def watched(page: str, *, before: str = "", after: str = "") -> str:
    page = page.replace(BEFORE[0], BEFORE[1].format(before), 1)
    at = page.rindex(AFTER[0])
    return page[:at] + AFTER[1].format(after) + page[at + len(AFTER[0]) :]


@pytest.fixture(scope="module")
def page() -> str:
    return render(elastic_identification())


def test_every_figure_is_drawn_once_it_is_unfolded(page: str, tmp_path: Path) -> None:
    count = (
        "const plots = () => document.querySelectorAll('.plot .main-svg .cartesianlayer').length;"
        f"seen.folded = plots(); {UNFOLD} setTimeout(() => {{ seen.plots = plots(); }}, 2000);"
    )
    said, console = shown(watched(page, after=count), tmp_path)
    assert console == ""
    expected = len(figures_of(elastic_identification()))
    assert int(said["folded"]) == expected - 2  # of records that were fitted
    assert int(said["drawn"]) == int(said["plots"]) == expected


def test_contents_fold_unfold_and_lead_into_what_is_folded(page: str, tmp_path: Path) -> None:
    steps = (
        "const open = () => document.querySelectorAll('section > details[open]').length;"
        "const button = document.querySelector('nav button');"
        "seen.first = open(); button.click(); seen.none = open();"
        "location.hash = '#parameter-motor_inertia';"
        "setTimeout(() => { seen.one = open(); seen.unfolded ="
        " document.querySelector('#parameters > details').open; button.click(); button.click();"
        " seen.all = open(); }, 500);"
    )
    said, console = shown(watched(page, after=steps), tmp_path)
    assert console == ""
    assert (said["first"], said["none"], said["one"], said["all"]) == ("10", "0", "1", "10")
    assert said["unfolded"] == "true"


@pytest.mark.parametrize("width", [390, 1400])
def test_contents_stay_in_sight(page: str, width: int, tmp_path: Path) -> None:
    after = (
        "scrollTo(0, document.querySelector('#gears').offsetTop);"
        "window.dispatchEvent(new Event('scroll'));"  # no frames, no event of its own
        "setTimeout(() => { const box = document.querySelector('nav').getBoundingClientRect();"
        " seen.top = Math.round(box.top); seen.current ="
        " document.querySelector('nav [aria-current]').hash.slice(1); }, 500);"
    )
    said, _ = shown(watched(page, after=after), tmp_path, f"--window-size={width},800")
    assert (said["top"], said["current"]) == ("0", "gears")


def test_a_page_that_fetches_or_fails_would_be_heard(page: str, tmp_path: Path) -> None:
    fetch = "new Image().src = 'https://example.org/x.png'; undefined.x;"
    _, console = shown(watched(page, after=fetch), tmp_path)
    assert "Content Security Policy" in console
    assert "TypeError" in console


def test_buttons_hide_nothing_and_send_nothing_away(page: str, tmp_path: Path) -> None:
    look = (
        "const bars = [...document.querySelectorAll('.modebar')];"
        "const box = (one) => one.getBoundingClientRect();"
        "seen.bars = bars.length; seen.inside = bars.filter("
        " (bar) => box(bar).bottom > box(bar.closest('.plot')).top + 0.5).length;"
        "seen.buttons = [...new Set([...document.querySelectorAll('.modebar-btn')]"
        " .map((one) => one.dataset.title))].join(', ');"
    )
    said, _ = shown(watched(page, after=look), tmp_path, "--window-size=1280,900")
    assert int(said["bars"]) > 0
    assert said["inside"] == "0"
    assert said["buttons"] == "Download plot as a PNG, Zoom, Pan, Zoom in, Zoom out, Reset axes"


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


def test_a_phone_shows_a_heat_map_with_names_at_its_left_only(page: str, tmp_path: Path) -> None:
    narrow = (
        "const real = matchMedia.bind(window); const narrow = new EventTarget();"
        "narrow.matches = true;"
        "window.matchMedia = (query) => query.includes('max-width') ? narrow : real(query);"
        "window.phone = narrow;"
    )
    look = (
        "const own = document.querySelector('#figure-correlations');"
        "const names = (axis) => own.querySelectorAll(`.${axis}tick text`).length;"
        "seen.below = names('x'); seen.left = names('y');"
        "phone.matches = false; phone.dispatchEvent(new Event('change'));"
        "seen.wide = names('x');"
    )
    said, console = shown(watched(page, before=narrow, after=look), tmp_path)
    assert console == ""
    assert said["below"] == "0"
    assert said["left"] == said["wide"] != "0"


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
