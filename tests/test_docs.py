"""What the docs show works: study files, parameter files, commands, code, links, examples."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from strainwave import scara, virtual
from strainwave.parameters import read_parameters
from strainwave.study import read_study

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
EXAMPLES = sorted(ROOT.glob("examples/*.py"))


def blocks(language: str) -> list[tuple[str, str]]:
    found = []
    for page in PAGES:
        code = re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
        found += [(f"{page.name}-{k}", text) for k, text in enumerate(code)]
    return found


def commands() -> list[tuple[str, str]]:
    found = []
    for page in PAGES:
        for line in re.findall(r"^ {4}(strainwave .*)$", page.read_text("utf-8"), re.MULTILINE):
            found.append((page.name, line))
    return found


def test_study_files_are_read(tmp_path: Path) -> None:
    texts = [text for _, text in blocks("toml")]
    whole = [text for text in texts if "[arm]" in text]
    assert whole
    path = tmp_path / "study.toml"
    for text in whole:
        path.write_text(text, encoding="utf-8")
        read_study(path, logs_exist=False)
    for part in texts:
        if part not in whole:
            path.write_text(whole[0] + part, encoding="utf-8")
            assert read_study(path, logs_exist=False).channels["theta_m1"].scale != 1.0


@pytest.mark.parametrize(("name", "text"), blocks("json"))
def test_parameter_files_are_read(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name}.json"
    path.write_text(text, encoding="utf-8")
    assert set(read_parameters(path)) <= set(scara.parameters()) | set(
        scara.parameters(spring="linear")
    )


@pytest.mark.parametrize(("page", "line"), commands())
def test_commands_have_the_options_shown(page: str, line: str) -> None:
    words = shlex.split(line, comments=True)
    shown = run(["-m", "strainwave", words[1], "--help"], ROOT)
    assert [word for word in words if word.startswith("--") and word not in shown] == [], page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), target


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("docs")
    virtual.demonstrate(folder / "demo", seed=0, progress=lambda _: None)
    return folder


def run(arguments: list[str], folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONWARNINGS": "error"},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(("name", "text"), blocks("python"))
def test_code_runs(name: str, text: str, demo: Path) -> None:
    assert "rigid_inertia" in run(["-c", text], demo), name


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_examples_run(example: Path, demo: Path) -> None:
    assert run([str(example), str(demo / "demo" / "study.toml")], demo)


def test_every_key_of_a_study_is_documented() -> None:
    from dataclasses import fields

    from strainwave.records import Arm, Experiment, Joint, Servo

    page = (ROOT / "docs" / "study.md").read_text(encoding="utf-8")
    for record in (Arm, Joint, Servo, Experiment):
        for field in fields(record):
            assert f"`{field.name}`" in page or f"{field.name} =" in page, field.name


def test_every_key_of_a_result_is_documented(demo: Path) -> None:
    page = (ROOT / "docs" / "result.md").read_text(encoding="utf-8")
    document = json.loads((demo / "demo" / "result.json").read_text())
    keys = [*document, *document["stages"]["rigid"], *document["parameters"][0]]
    assert [key for key in keys if f"`{key}`" not in page and f"stages.{key}" not in page] == [
        "stages"
    ]
