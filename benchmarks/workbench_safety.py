"""Safety of the workbench: `python -m benchmarks.workbench_safety [--items N] [--seed N]`.

Odd and malicious items in a served folder, to which every address and every API is applied; a
server that is killed during runs; ten runs at once. The numbers of the table are failures.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import time
import traceback
import zipfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch
from urllib.parse import quote, urlencode

import numpy as np
from rich.table import Table
from starlette.routing import Route
from starlette.testclient import TestClient

from benchmarks.console import Console
from benchmarks.odd_items import NUMBER, ODD, SECRET, Foreign, draw_items, replaced
from strainwave.workbench.app import ROUTES, create_app
from strainwave.workbench.options import ServerOptions
from strainwave.workbench.run_record import Run
from strainwave.workbench.runs import Runs

if TYPE_CHECKING:
    from httpx import Response

MAX_SECONDS = 1.0
"""Largest processor time of an answer, and on a quiet machine its time."""
MAX_WAIT = 20.0  # [s] of an answer on a loaded machine; a pipe never ends
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
_RAW = (b"", b"[]", b"\xff", b'{"index": NaN}', b'{"joint": 1e999, "index": 1e999}', b"[" * 100_000)
_RAW += (
    b'{"a":' * 50_000,
    b'{"joint": ' + b"9" * 5000 + b"}",
    b'{"name": "\\ud800"}',
    b" " * 5_000_000,
)
_QUERY = {"experiment": "motion", "channel": "u1", "channels": "u1,theta_m1", "column": "theta_m1"}
_QUERY |= {"run": "one", "name": "one", "file": "log.txt", "folder": "."}
_TEXTS = (
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
    client: TestClient, served: Path, item: str, rng: np.random.Generator
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
            is_slow = min(wait, used) > MAX_SECONDS or wait > MAX_WAIT
            if is_slow and not any(name in address for name in _LONG):
                yield Fault(item, request, f"{wait:.1f} s, {used:.1f} s used")
            text = _fault_of(answer)
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
                odd = [
                    quote(str(ODD[rng.integers(20)]).encode("utf-8", "surrogatepass"), "")
                    for _ in "ab"
                ]
                yield "PUT", f"/api/upload/{quote(item)}/{odd[0][:300]}.csv", rng.bytes(100)
                yield "PUT", f"/api/upload/{odd[1][:300]}/log.csv", b"t,u1\n0,1\n"


def _sha256(path: Path) -> str:
    import hashlib

    return (
        hashlib.sha256(path.read_bytes()).hexdigest()
        if path.is_file() and not path.is_symlink()
        else ""
    )


def _fault_of(answer: Response) -> str:
    content = answer.content
    if answer.headers.get("content-type") == "application/zip":
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            content = b"".join(map(archive.read, archive.namelist()))
    if answer.status_code not in _ANSWERS:
        return f"status {answer.status_code}: {content[:300].decode(errors='replace')}"
    foreign = (SECRET.encode(), str(NUMBER).encode()[:8], b"root:", b"PATH=", _TOKEN.encode())
    if any(each in content for each in foreign):
        return f"foreign bytes: {content[:300].decode(errors='replace')}"
    if answer.headers.get("content-type") == "application/json":
        try:
            json.loads(content, parse_constant=_refuse)
        except ValueError as error:
            return f"no JSON: {error}"
    return ""


def _refuse(text: str) -> None:
    raise ValueError(text)
