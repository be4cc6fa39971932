"""A served folder with the study of the virtual arm, a client, and a browser."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any
from urllib.request import Request

import pytest

from strainwave.dynamics.simulation import SensorNoise
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study
from workbench_client import TOKEN, make_client

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext, Page
    from starlette.applications import Starlette
    from starlette.testclient import TestClient
    from starlette.types import Receive, Scope, Send

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
STUDY = "arm/study.toml"
"""The study in every served folder: the virtual two-link arm, with its true parameters."""


@pytest.fixture(autouse=True)
def _own_queue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of tests in other processes do not wait for each other."""
    (tmp_path / "runtime").mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))


@pytest.fixture(scope="session")
def arm_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs and study of the virtual arm; copy the folder before you change it."""
    folder = tmp_path_factory.mktemp("virtual") / "arm"
    study = scara.STIFF.study(folder)
    simulate_study(study, scara.STIFF.parameters(), folder, noise=SensorNoise(), as_recorded=False)
    return folder


@pytest.fixture
def folder(tmp_path: Path, arm_folder: Path) -> Path:
    """A folder to serve, with one study."""
    shutil.copytree(arm_folder, tmp_path / "served" / "arm")
    return tmp_path / "served"


@pytest.fixture
def client(folder: Path) -> TestClient:
    """A client of the application without a server."""
    pytest.importorskip("starlette")
    return make_client(folder)


@dataclass
class Server:
    """A served folder: `strainwave serve` as a process."""

    folder: Path
    process: subprocess.Popen[str]
    url: str
    token: str

    def request(self, path: str, data: bytes | None = None) -> Request:
        """A request of a client that has the token."""
        cookie = f"strainwave-{self.url.rpartition(':')[2]}={self.token}"
        return Request(self.url + path, data, {"cookie": cookie})

    def stop(self, *, at_once: bool = False) -> None:
        """End the server as Ctrl-C does, or by kill -9."""
        if at_once:
            self.process.kill()
        else:
            self.process.terminate()
        self.process.wait(timeout=20)
        assert self.process.stdout is not None
        self.process.stdout.close()


def launch_server(folder: Path, *arguments: str) -> Server:
    """`strainwave serve` on a free port."""
    command = [sys.executable, "-m", "strainwave", "serve", str(folder), "--port", "0", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ)
    assert process.stdout is not None
    line = process.stdout.readline()
    url, _, query = line.rsplit(" ", 1)[-1].strip().partition("/?")
    return Server(folder, process, url, query.partition("=")[2])


@pytest.fixture
def start_server() -> Iterator[Callable[[Path], Server]]:
    """Function that serves a folder; the servers end with the test."""
    started: list[Server] = []

    def start(folder: Path) -> Server:
        started.append(launch_server(folder))
        return started[-1]

    yield start
    for server in started:
        if server.process.poll() is None:
            server.stop()


@pytest.fixture
def server(folder: Path, start_server: Callable[[Path], Server]) -> Server:
    """The served folder as a process."""
    return start_server(folder)


@dataclass
class Site:
    """An address at which each test serves its own folder."""

    port: int
    app: Starlette | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        assert self.app is not None
        await self.app(scope, receive, send)

    @property
    def url(self) -> str:
        """Its address."""
        return f"http://127.0.0.1:{self.port}"

    def serve(self, folder: Path) -> None:
        """Serve a folder from here on."""
        from strainwave.workbench.app import create_app
        from strainwave.workbench.options import ServerOptions

        self.app = create_app(ServerOptions(folder, token=TOKEN), self.port)


@pytest.fixture(scope="session")
def site() -> Iterator[Site]:
    """A server in a thread. A process for each test would import the package each time."""
    uvicorn = pytest.importorskip("uvicorn")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        site = Site(listener.getsockname()[1])
        config = uvicorn.Config(
            site, log_level="warning", lifespan="off", timeout_graceful_shutdown=1
        )
        server = uvicorn.Server(config)
        thread = Thread(target=server.run, args=([listener],))
        thread.start()
        yield site
        server.should_exit = True
        thread.join()


@pytest.fixture(scope="session")
def context(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrowserContext]:
    """Debian's Chromium without a window; its cache keeps the compiled plotting library."""
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        window = playwright.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("chromium"),
            executable_path=CHROMIUM,
            args=["--no-sandbox"],
            viewport={"width": 1280, "height": 900},
            reduced_motion="reduce",  # colours in the middle of a transition have little contrast
        )
        window.set_default_timeout(60_000)
        yield window
        window.close()


@dataclass
class Visit:
    """A page of the browser, and what went wrong on it."""

    page: Page
    url: str
    folder: Path  # served
    faults: list[str] = field(default_factory=list)

    def open(self, path: str) -> Page:
        """Open an address of the server."""
        self.page.goto(f"{self.url}{path}")
        return self.page

    def wait_until(self, expression: str) -> None:
        """Wait until a JavaScript expression is true; the page's policy allows no eval."""
        limit = time.monotonic() + 60.0
        while not self.page.evaluate(expression):
            assert time.monotonic() < limit, expression
            time.sleep(0.05)

    def take_refusals(self) -> None:
        """Wait for the browser's report of a refused request, and forget it.

        The report may come later than the page's own message.
        """
        limit = time.monotonic() + 60.0
        while not self.faults:
            assert time.monotonic() < limit, "no request was refused"
            self.page.wait_for_timeout(50)
        assert all("status of 400" in fault for fault in self.faults), self.faults
        self.faults.clear()

    def check_accessibility(self) -> None:
        """Fail if axe-core finds a fault on the page."""
        from axe_playwright_python.sync_playwright import Axe

        response: dict[str, Any] = Axe().run(self.page).response
        faults = [
            {"id": v["id"], "nodes": [n["target"] for n in v["nodes"]][:5]}
            for v in response["violations"]
        ]
        assert not faults, json.dumps(faults, indent=1)


@pytest.fixture
def visit(folder: Path, site: Site, context: BrowserContext) -> Iterator[Visit]:
    """A page; the test fails for each console error, page error and request to outside."""
    site.serve(folder)
    context.clear_cookies()
    page = context.new_page()
    page.goto(f"{site.url}/?token={TOKEN}")
    page.evaluate("localStorage.clear()")
    visited = Visit(page, site.url, folder)
    page.on(
        "console",
        lambda m: visited.faults.append(f"console: {m.text}") if m.type == "error" else None,
    )
    page.on("pageerror", lambda error: visited.faults.append(f"page: {error}"))
    page.on(
        "request",
        lambda request: (
            None
            if request.url.startswith((site.url, "data:", "blob:"))
            else visited.faults.append(f"request: {request.url}")
        ),
    )
    yield visited
    page.close()
    assert not visited.faults, visited.faults
