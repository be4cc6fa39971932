"""Safety of the workbench: `python -m benchmarks.workbench_safety [--items N] [--seed N]`.

Odd and malicious items in a served folder, to which every address and every API is applied; a
server that is killed during runs; ten runs at once. The numbers of the table are failures.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import os
import subprocess
import sys
import time
import traceback
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from unittest.mock import patch
from urllib.parse import quote, urlencode
from urllib.request import Request, urlopen

import numpy as np
from rich.table import Table
from starlette.routing import Route
from starlette.testclient import TestClient

from benchmarks.console import Console
from benchmarks.odd_items import NUMBER, ODD, SECRET, Foreign, draw_items, replaced
from strainwave.dynamics.simulation import SensorNoise
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study
from strainwave.workbench.app import ROUTES, create_app
from strainwave.workbench.options import ServerOptions
from strainwave.workbench.runs import Runs

MAX_SECONDS = 1.0
"""Largest processor time of an answer, and on a quiet machine its time."""
MAX_WAIT = 60.0  # [s] of an answer on a loaded machine; a pipe never ends
_TOKEN = "the-token"
_ANSWERS = (200, 400, 404, 405, 422, 507)
_LONG = ("orders", "joint-spectrum")  # they identify
_PUBLIC = ("plotly.js", "static")
_VALUES = [{"name": "motor_inertia", "joint": 1, "value": 1e-4}]
BODIES: dict[str, dict[str, Any]] = {
    "study": {"changes": [{"place": ["joint", 0, "gear_ratio"], "kind": "number", "value": "1"}]},
    "apply-remedy": {"index": 0},
    "compare": {"paths": ["runs/one/result.json", "runs/one/result.json"]},
    "compare-joint": {"paths": ["runs/one/result.json"], "joint": 1},
    "compare-figure": {"paths": ["runs/one/result.json"], "key": "bode"},
    "save-comparison": {"paths": ["runs/one/result.json"]},
    "by-hand-begin": {"start": "runs/one/result.json", "experiment": "motion"},
    "by-hand": {"start": "runs/one/result.json", "experiment": "motion", "values": _VALUES},
    "by-hand-save": {"name": "mine", "values": _VALUES},
    "by-hand-fit": {"values": _VALUES, "held": ["motor_inertia"]},
    "window": {"experiment": "motion", "start": 0.1, "stop": 0.3},
    "cancel-run": {"name": "one"},
    "export": {"name": "one", "format": "json"},
    "design": {"kind": "tune", "parameters": "runs/one/result.json", "options": {"seed": "1"}},
    "estimate": {"name": "two", "stages": "rigid", "options": {"statespace.order": "4"}},
    "draft": {"folder": "item", "logs": ["log.csv"], "urdf": "robot.urdf"},
    "virtual": {"disks": 1, "spring": "linear"},
}
"""A request of each API; others get an empty one."""
_RAW: tuple[bytes, ...] = (
    b"",
    b"[]",
    b"\xff",
    b'{"index": NaN}',
    b'{"joint": 1e999, "index": 1e999}',
    b"[" * 100_000,
)
_RAW += (
    b'{"a":' * 50_000,
    b'{"joint": ' + b"9" * 5000 + b"}",
    b'{"name": "\\ud800"}',
    b" " * 5_000_000,
)
_QUERY = {"experiment": "motion", "channel": "u1", "channels": "u1,theta_m1", "column": "theta_m1"}
_QUERY |= {"run": "one", "name": "one", "file": "log.txt", "folder": "."}
_TEXTS: tuple[str, ...] = (
    "../../../foreign.csv",
    "/etc/passwd",
    "nan",
    "1e999",
    "9" * 5000,
    "a\0",
    "\u202eé'\"\n",
    "",
)
_TEXTS += ("report.html", "plan.csv", "lock", "..", "x" * 300, "u1," * 500)


class Fault(NamedTuple):
    """An answer that must not be."""

    item: str
    request: str
    text: str


def client_of(folder: Path) -> TestClient:
    """A client with the token; it raises what a page raises."""
    app = create_app(ServerOptions(folder, token=_TOKEN), 8765)
    cookies = {"strainwave-8765": _TOKEN}
    return TestClient(app, "http://127.0.0.1:8765", cookies=cookies)


def faults_of(
    client: TestClient,
    served: Path,
    item: str,
    rng: np.random.Generator,
    max_seconds: float = MAX_SECONDS,
) -> Iterator[Fault]:
    """Faults of the answers to all requests about an item; runs start no processes."""
    with patch.object(Runs, "_start", lambda _, run: run):
        for method, address, content in _requests(served, item, rng):
            begin, used = time.perf_counter(), time.process_time()
            request = f"{method} {address[:200]} {content[:200]!r}"
            try:
                answer = client.request(method, address, content=content)
            except Exception as error:  # a page raised it: status 500
                at = traceback.extract_tb(error.__traceback__)[-1]
                yield Fault(item, request, f"{error!r:.200}, {at.filename}:{at.lineno}")
                continue
            wait, used = time.perf_counter() - begin, time.process_time() - used
            is_slow = min(wait, used) > max_seconds or wait > MAX_WAIT
            if is_slow and not any(name in address for name in _LONG):
                yield Fault(item, request, f"{wait:.1f} s, {used:.1f} s used")
            media_type = answer.headers.get("content-type", "")
            text = fault_of(answer.status_code, media_type, answer.content)
            if text:
                yield Fault(item, request, text)


def _requests(
    served: Path, item: str, rng: np.random.Generator
) -> Iterator[tuple[str, str, bytes]]:
    """Method, address and content; every address with plain and with odd values."""
    studies = sorted((served / item).rglob("*.toml"), key=os.fsencode)
    addresses = [quote(os.fsencode(path.relative_to(served))) for path in studies]
    addresses = addresses or [f"{quote(item)}/study.toml"]
    runs = [os.fsencode(path.name) for path in (served / item / "runs").glob("*")]
    for route in (each for each in ROUTES if isinstance(each, Route)):
        methods, name = route.methods or set(), route.path.split("/")[-2]
        for study in addresses[: None if "{study" in route.path else 1]:
            path = route.path.replace("{study:path}", study)
            if "GET" in methods:
                plain: dict[str, Any] = dict(_QUERY)
                if runs:
                    plain |= dict.fromkeys(("run", "name"), runs[rng.integers(len(runs))])
                yield "GET", f"{path}?{urlencode(plain)}", b""
                key, odd = rng.choice(list(_QUERY)), _TEXTS[rng.integers(len(_TEXTS))]
                yield "GET", f"{path}?{urlencode(plain | {key: odd})}", b""
            elif "POST" in methods:
                name = name if "{" in route.path else route.path.split("/")[-1]
                text = json.dumps(BODIES.get(name, {"name": "one"}))
                body = json.loads(
                    text.replace("runs/", f"{item}/runs/").replace('"item"', f'"{item}"')
                )
                for each in (body, replaced(body, rng)):
                    if name == "study" and isinstance(each, dict):
                        each["sha256"] = _sha256(served / item / "study.toml")
                    yield "POST", path, json.dumps(each).encode()
                yield "POST", path, _RAW[rng.integers(len(_RAW))]
            else:
                names = [
                    quote(str(ODD[rng.integers(20)]).encode("utf-8", "surrogatepass"), "")
                    for _ in "ab"
                ]
                yield "PUT", f"/api/upload/{quote(item)}/{names[0][:300]}.csv", rng.bytes(100)
                yield "PUT", f"/api/upload/{names[1][:300]}/log.csv", b"t,u1\n0,1\n"


def _sha256(path: Path) -> str:

    return (
        hashlib.sha256(path.read_bytes()).hexdigest()
        if path.is_file() and not path.is_symlink()
        else ""
    )


def fault_of(status: int, media_type: str, content: bytes) -> str:
    """What is wrong with an answer; empty if nothing is."""
    if media_type == "application/zip":
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            content = b"".join(map(archive.read, archive.namelist()))
    if status not in _ANSWERS:
        return f"status {status}: {content[:300].decode(errors='replace')}"
    foreign = (SECRET.encode(), str(NUMBER).encode()[:8], b"root:", b"PATH=", _TOKEN.encode())
    if any(each in content for each in foreign):
        return f"foreign bytes: {content[:300].decode(errors='replace')}"
    if media_type == "application/json":
        try:
            json.loads(content, parse_constant=_refuse)
        except ValueError as error:
            return f"no JSON: {error}"
    return ""


def _refuse(text: str) -> None:
    raise ValueError(text)


# --- Kills and bursts -----------------------------------------------------------------------------

_STAGES = "rigid"
_KILLS = 20
_BURST = 10  # runs started at once
_MAX_PAGE = 0.2  # [s] of a page meanwhile
_POLL = 0.1  # [s]


class Served:
    """A served folder as a process."""

    def __init__(self, folder: Path) -> None:
        command = [sys.executable, "-m", "strainwave", "serve", str(folder), "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        link = self.process.stdout.readline().rsplit(" ", 1)[-1].strip()
        self.url, _, query = link.partition("/?token=")
        self.cookie = f"strainwave-{self.url.rpartition(':')[2]}={query}"

    def ask(self, path: str, body: object = None) -> Any:
        """The answer of an API, or the text of a page."""
        data = None if body is None else json.dumps(body).encode()
        with urlopen(Request(self.url + path, data, {"cookie": self.cookie})) as answer:
            text = answer.read()
        return json.loads(text) if path.startswith("/api/") else text

    def states(self) -> dict[str, tuple[str, str | None]]:
        """State and verdict of the runs by name, once all have ended."""
        while True:
            runs = self.ask("/api/runs/arm/study.toml")
            if not any(run["state"] in ("waiting", "running") for run in runs):
                return {run["name"]: (run["state"], run["status"]) for run in runs}
            time.sleep(_POLL)

    def kill(self) -> None:
        """End the server at once."""
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def write_arm(folder: Path) -> None:
    """The study of the built-in arm and its logs."""
    study = scara.STIFF.study(folder / "arm")
    values = scara.STIFF.parameters()
    simulate_study(study, values, folder / "arm", noise=SensorNoise(), as_recorded=False)


def count_wrong_states(folder: Path, rng: np.random.Generator) -> int:
    """Runs with a wrong state after a server was killed at drawn moments; half are cancelled."""
    wrong = 0
    for number in range(_KILLS):
        server, name, is_cancelled = Served(folder), f"kill-{number}", number % 2 == 1
        server.ask("/api/check/arm/study.toml", {})
        server.ask("/api/estimate/arm/study.toml", {"name": name, "stages": _STAGES})
        time.sleep(rng.uniform(0.0, 3.0))
        before = ""
        if is_cancelled:
            before = server.ask("/api/cancel-run/arm/study.toml", {"name": name})["state"]
        server.kill()
        server = Served(folder)
        state, status = server.states()[name]
        is_right = state == before if is_cancelled else (state, status) == ("done", "determined")
        wrong += not (is_right and state in ("done", "cancelled"))
        server.kill()
    return wrong


def burst(folder: Path) -> tuple[int, float]:
    """Runs of several started at once that do not end as done; longest time of a page meanwhile."""
    server = Served(folder)
    server.ask("/api/check/arm/study.toml", {})
    names = [f"burst-{number}" for number in range(_BURST)]
    bodies = [{"name": name, "stages": _STAGES} for name in names]
    with ThreadPoolExecutor(_BURST) as pool:
        for future in [pool.submit(server.ask, "/api/estimate/arm/study.toml", b) for b in bodies]:
            future.result()
    times = []
    while True:
        begin = time.perf_counter()
        server.ask("/estimate/arm/study.toml")
        times.append(time.perf_counter() - begin)
        runs = {run["name"]: run["state"] for run in server.ask("/api/runs/arm/study.toml")}
        if not any(runs[name] in ("waiting", "running") for name in names):
            break
        time.sleep(_POLL)
    server.kill()
    return sum(runs[name] != "done" for name in names), max(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--items", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    table = Table("what", "cases", "failures", box=None)
    console = Console()
    with TemporaryDirectory() as name:
        served = Path(name) / "served"
        served.mkdir()
        items = draw_items(served, Foreign(Path(name)), options.items, options.seed)
        client = client_of(served)
        client.get("/")  # loads the modules
        failed = set()
        for number, item in enumerate(items):
            for fault in faults_of(
                client, served, item, np.random.default_rng([options.seed, number])
            ):
                failed.add(item)
                console.print(fault, markup=False)
        table.add_row("odd items", str(len(items)), str(len(failed)))
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_arm(folder)
        wrong = count_wrong_states(folder, np.random.default_rng(options.seed))
        table.add_row("kills of the server in a run", str(_KILLS), str(wrong))
        unfinished, longest = burst(folder)
        table.add_row("runs started at once", str(_BURST), str(unfinished))
        table.add_row(
            f"longest page meanwhile, limit {_MAX_PAGE} s",
            f"{longest:.2f} s",
            str(int(longest > _MAX_PAGE)),
        )
    console.print(table)


if __name__ == "__main__":
    main()
