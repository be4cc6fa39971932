"""Odd and malicious items of a served folder: no page fails, hangs, or shows a foreign byte."""

from __future__ import annotations

import gzip
import json
import os
import shutil
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from strainwave.workbench.runs import Runs
from workbench_client import make_client

pytest.importorskip("starlette")

if TYPE_CHECKING:
    from starlette.testclient import TestClient

SECRET = "the-secret-of-another-user"
DIGITS = "9" * 5000
PAGES = ("study", "check", "signals", "estimate", "compare", "by-hand", "design", "files")
DATA = ("study", "check", "estimate", "runs", "files", "designs", "results")
SLOW = 20.0  # [s] of one answer on a loaded machine; a pipe never ends


def study_text(folder: Path) -> str:
    return (folder / "arm" / "study.toml").read_text()


def with_file(folder: Path, name: str, file: str) -> None:
    """A study whose first record is another file."""
    target = folder / name
    shutil.copytree(folder / "arm", target)
    text = study_text(folder).split("[[experiment]]")
    lines = [
        f"file = {json.dumps(file)}" if x.startswith("file") else x for x in text[1].split("\n")
    ]
    (target / "study.toml").write_text(
        "[[experiment]]".join([text[0], "\n".join(lines), *text[2:]])
    )


def foreign(folder: Path) -> Path:
    """A file of another user's, with the columns of a log."""
    path = folder.parent / "foreign.csv"
    path.write_text(f"t,{SECRET}\n" + "".join(f"{k / 100},{k}\n" for k in range(200)))
    return path


def in_run(folder: Path, name: str) -> Path:
    run = Runs(folder / "arm" / "study.toml").prepare(name)
    record = {"name": name, "kind": "identify", "commands": [["identify", "study.toml"]]}
    (run / "run.json").write_text(json.dumps(record | {"created": "", "state": "done"}))
    return run


def linked_log(folder: Path) -> None:
    with_file(folder, "other", "link.csv")
    (folder / "other" / "link.csv").symlink_to(foreign(folder))


def linked_bag(folder: Path) -> None:
    with_file(folder, "other", "bag")
    (folder / "other" / "bag").mkdir()
    (folder / "other" / "bag" / "metadata.yaml").symlink_to(foreign(folder))


def foreign_urdf(folder: Path) -> None:
    (folder / "other").mkdir()
    text = study_text(folder).replace("[arm]", f'[arm]\nurdf = "{foreign(folder)}"', 1)
    (folder / "other" / "study.toml").write_text(text)


def piped_log(folder: Path) -> None:
    with_file(folder, "other", "pipe.csv")
    os.mkfifo(folder / "other" / "pipe.csv")


def bomb(folder: Path) -> None:
    with_file(folder, "other", "bomb.csv.gz")
    (folder / "other" / "bomb.csv.gz").write_bytes(gzip.compress(bytes(100 << 20), 1))


def many_experiments(folder: Path) -> None:
    (folder / "other").mkdir()
    text = study_text(folder)
    block = text.split("[[experiment]]")[1]
    more = "".join(
        f"[[experiment]]{block.replace('name = ', f'name = {k}', 1)}" for k in range(1500)
    )
    (folder / "other" / "study.toml").write_text(text + more)


def digits_in_study(folder: Path) -> None:
    (folder / "digits.toml").write_text(f"[arm]\nkind = {DIGITS}\n")


def digits_in_record(folder: Path) -> None:
    (in_run(folder, "digits") / "run.json").write_text(f'{{"name": "a", "exit_code": {DIGITS}}}')
    (in_run(folder, "digits-2") / "result.json").write_text(f'{{"status": {DIGITS}}}')


def folder_as_record(folder: Path) -> None:
    run = in_run(folder, "folder")
    (run / "run.json").unlink()
    (run / "run.json").mkdir()


def pipes_in_run(folder: Path) -> None:
    run = in_run(folder, "pipes")
    for name in ("run.json", "log.txt", "result.json", "report.html"):
        (run / name).unlink(missing_ok=True)
        os.mkfifo(run / name)


def links_in_run(folder: Path) -> None:
    run = in_run(folder, "links")
    for name in ("log.txt", "report.html", "result.json", "exports"):
        (run / name).symlink_to(foreign(folder))
    (run.parent / "linked-run").symlink_to(folder.parent)
    (folder / "arm" / "runs" / "broken").symlink_to(folder / "nowhere")


def odd_names(folder: Path) -> None:
    for name in ("old&new", "a'b\"c", "%2e%2e", "<script>alert(1)</script>", "x" * 200, "ü\n"):
        shutil.copytree(folder / "arm", folder / name)
    in_run(folder, "one").rename(folder / "arm" / "runs" / "-odd&\n name")


def device_as_study(folder: Path) -> None:
    os.mkfifo(folder / "pipe.toml")
    (folder / "loop.toml").symlink_to(folder / "loop.toml")
    (folder / "folder.toml").mkdir()
    (folder / "stored.toml").symlink_to("/dev/zero")


def odd_check(folder: Path) -> None:
    runs = folder / "arm" / "runs"
    runs.mkdir(exist_ok=True)
    (runs / ".check.json").write_text('{"fingerprint": [], "document": [[]]}')


def random_bytes(folder: Path) -> None:
    data = np.random.default_rng(1).bytes(5000)
    (folder / "random.toml").write_bytes(b"[arm]\n" + data)
    for name in ("log.txt", "result.json", "report.html"):
        (in_run(folder, f"random-{name}") / name).write_bytes(data)


@pytest.mark.parametrize("file", ["/etc/passwd", "../../foreign.csv", "../arm/../../foreign.csv"])
def test_a_study_cannot_name_a_file_outside_the_folder(
    client: TestClient, folder: Path, file: str
) -> None:
    foreign(folder)
    with_file(folder, "other", file)
    texts = crawl(client, "other/study.toml")
    assert any("leads out of the served folder" in text for text in texts)


def test_an_allowed_folder_may_have_the_logs(folder: Path) -> None:
    logs = folder.parent / "logs"
    shutil.copytree(folder / "arm", logs)
    first = logs / tomllib.loads(study_text(folder))["experiment"][0]["file"]
    with_file(folder, "other", str(first))
    refused = make_client(folder).get("/api/estimate/other/study.toml")
    assert "leads out" in refused.json()["error"]
    allowed = make_client(folder, allowed=(logs,)).get("/api/estimate/other/study.toml")
    assert allowed.status_code == 200


@pytest.mark.parametrize(
    "make",
    [
        linked_log,
        linked_bag,
        foreign_urdf,
        piped_log,
        bomb,
        many_experiments,
        digits_in_study,
        digits_in_record,
        folder_as_record,
        pipes_in_run,
        links_in_run,
        odd_names,
        device_as_study,
        odd_check,
        random_bytes,
    ],
)
def test_no_item_of_the_folder_breaks_a_page(
    client: TestClient, folder: Path, make: Callable[[Path], None]
) -> None:
    make(folder)
    home = client.get("/")
    assert home.status_code == 200
    assert "arm/study.toml" in home.text
    for study in client.app.state.workspace.studies():  # type: ignore[attr-defined]
        crawl(client, study)


def crawl(client: TestClient, study: str) -> list[str]:
    """Texts of all pages and lists of a study, and of what the runs in them offer."""
    from urllib.parse import quote

    texts = []
    address = quote(study)
    paths = [f"/{page}/{address}" for page in PAGES] + [f"/api/{each}/{address}" for each in DATA]
    paths += [
        f"/api/preview/{address}?experiment={name}&column=t" for name in ("motion", "0motion")
    ]
    answer = client.get(f"/api/runs/{address}")
    for run in answer.json() if answer.status_code == 200 else []:
        name = quote(run["name"])
        paths += [f"/api/run-log/{address}?name={name}", f"/zip/{address}?run={name}"]
        paths += [f"/report/{address}?run={name}", f"/script/{address}?run={name}"]
        paths += [f"/download/{address}?run={name}&file=log.txt"]
    for path in paths:
        begin = time.monotonic()
        answer = client.get(path)
        assert time.monotonic() - begin < SLOW, path
        assert answer.status_code in (200, 400, 404, 422), path
        assert SECRET not in answer.text, path
        assert "root:" not in answer.text, path
        texts.append(answer.text)
    return texts
