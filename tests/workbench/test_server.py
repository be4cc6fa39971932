"""`strainwave serve` as a process: refusals, several clients, and a run that blocks nobody."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from strainwave.workbench.runs import Runs
from workbench_client import make_client

pytest.importorskip("uvicorn")


ESTIMATE = "/api/estimate/arm/study.toml"


def serve(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "strainwave", "serve", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def get(server: Any, path: str, data: bytes | None = None) -> bytes:
    with urlopen(server.request(path, data), timeout=60) as answer:
        return bytes(answer.read())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("no-such-folder",), "is not a folder"),
        ((".", "--token-file", "no-such-file"), "the token does not exist"),
        ((".", "--allow", "no-such-folder"), "--allow no-such-folder: is not a folder"),
    ],
)
def test_a_wrong_start_is_one_sentence(arguments: tuple[str, ...], words: str) -> None:
    done = serve(*arguments)
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_a_port_in_use_is_named(folder: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        done = serve(str(folder), "--port", str(listener.getsockname()[1]))
    assert done.returncode == 2
    assert "cannot listen on 127.0.0.1" in done.stderr


def test_a_run_does_not_block_the_pages(server: Any) -> None:
    runs = Runs(server.folder / "arm" / "study.toml")
    runs.prepare("one")
    runs.start("one", "identify", [("identify", "../../study.toml", "--out", ".")])
    query = "/api/signal-time/arm/study.toml?record=prbs-j1&channel=u1"
    for _ in range(10):
        begin = time.perf_counter()
        get(server, query)
        assert time.perf_counter() - begin < 10.0  # a run takes longer on a loaded machine
    assert runs.get("one").state in ("waiting", "running", "done")
    runs.cancel("one")


def test_ten_runs_at_once_all_end_and_the_pages_answer(server: Any) -> None:
    get(server, "/api/check/arm/study.toml", b"{}")
    bodies = [{"name": f"run-{k}", "stages": "rigid", "options": {}} for k in range(10)]
    with ThreadPoolExecutor(10) as pool:
        list(pool.map(lambda b: get(server, ESTIMATE, json.dumps(b).encode()), bodies))
    states = {"waiting"}
    while states & {"waiting", "running"}:
        begin = time.perf_counter()
        get(server, "/estimate/arm/study.toml")
        assert time.perf_counter() - begin < 10.0  # 0.2 s on a quiet machine
        states = {run["state"] for run in json.loads(get(server, ESTIMATE))["runs"]}
        time.sleep(0.2)
    assert states == {"done"}


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.2])
def test_a_run_ends_as_it_should_whenever_the_server_is_killed(
    folder: Path, start_server: Any, delay: float
) -> None:
    server = start_server(folder)
    get(server, "/api/check/arm/study.toml", b"{}")
    body = {"name": "one", "stages": "rigid", "options": {}}
    get(server, ESTIMATE, json.dumps(body).encode())
    time.sleep(delay)
    server.stop(at_once=True)
    again = start_server(folder)
    limit = time.monotonic() + 120.0
    while (run := json.loads(get(again, ESTIMATE))["runs"][0])["state"] in ("waiting", "running"):
        assert time.monotonic() < limit
        time.sleep(0.2)
    assert (run["state"], run["status"]) == ("done", "determined")


def test_clients_on_different_studies_do_not_mix(server: Any) -> None:
    (server.folder / "other").mkdir()
    for path in (server.folder / "arm").glob("*.*"):
        (server.folder / "other" / path.name).symlink_to(path)
    text = (server.folder / "arm" / "study.toml").read_text().replace("0.35", "0.45")
    (server.folder / "other" / "study.toml").unlink()
    (server.folder / "other" / "study.toml").write_text(text)

    def length(study: str) -> str:
        state = json.loads(get(server, f"/api/study/{study}/study.toml"))
        (arm,) = [group for group in state["groups"] if group["title"] == "Arm"]
        (row,) = [row for row in arm["rows"] if row["key"]["key"] == "link_length"]
        return str(row["fields"][0]["value"])

    with ThreadPoolExecutor(8) as pool:
        seen = list(pool.map(length, ["arm", "other"] * 10))
    assert seen == ["0.35", "0.45"] * 10


def test_a_second_server_sees_the_same(server: Any) -> None:
    get(server, "/api/check/arm/study.toml", b"{}")
    client = make_client(server.folder)
    assert client.get("/api/check/arm/study.toml").json()["state"] == "consistent"


def test_an_unknown_study_is_a_page_with_a_sentence(client: Any) -> None:
    answer = client.get("/study/none/study.toml", headers={"sec-fetch-dest": "document"})
    assert answer.status_code == 400
    assert "there is no such study" in answer.text
    assert answer.headers["content-type"].startswith("text/html")


def test_a_broken_link_and_a_large_file_are_no_studies(client: Any, folder: Path) -> None:
    (folder / "broken.toml").symlink_to(folder / "missing.toml")
    (folder / "large.toml").write_text("[arm]\n" + "#" * (2 << 20))
    page = client.get("/").text
    assert "arm/study.toml" in page
    assert "large.toml" not in page
