"""What is published agrees with the project: versions, dependencies, extras, files, workflows."""

from __future__ import annotations

import ast
import re
import subprocess
import tarfile
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from benchmarks.installation import EXTRAS, readme

import strainwave

ROOT = Path(__file__).resolve().parents[2]
VERSION = strainwave.__version__
DEVELOPERS = {"bench", "build", "dev", "docs"}
"""Extras for developers, which `make develop` installs."""

MAX_FILE_BYTES = 300_000
MAX_SDIST_BYTES = 2_500_000
"""Twice the sizes of today: larger files are data or binaries, which no build needs."""

WORKFLOWS = sorted(ROOT.glob(".github/workflows/*.yml"))


def toml(name: str) -> Any:
    return tomllib.loads((ROOT / name).read_text(encoding="utf-8"))


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[ <>=\[]", requirement)[0].lower() for requirement in requirements}


PROJECT = toml("pyproject.toml")["project"]
RECIPE = yaml.safe_load(text("recipe/recipe.yaml"))


def test_one_version_everywhere() -> None:
    own = [
        package["version"]
        for package in toml("Cargo.lock")["package"]
        if package["name"].startswith("strainwave")
    ]
    assert toml("Cargo.toml")["workspace"]["package"]["version"] == VERSION
    assert set(own) == {VERSION}
    assert yaml.safe_load(text("CITATION.cff"))["version"] == VERSION
    assert RECIPE["context"]["version"] == VERSION
    heading = re.search(r"^## (.*)$", text("CHANGELOG.md"), re.MULTILINE)
    assert heading is not None
    assert re.fullmatch(rf"{re.escape(VERSION)} \(\d{{4}}-\d\d-\d\d\)", heading[1])


def test_the_conda_recipe_has_the_dependencies_of_the_package() -> None:
    run = {requirement.replace(" ", "") for requirement in RECIPE["requirements"]["run"]}
    assert run == {*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"}
    host = {requirement.replace(" ", "") for requirement in RECIPE["requirements"]["host"]}
    assert set(toml("pyproject.toml")["build-system"]["requires"]) <= host


def test_extras_for_users_are_named_in_the_readme_and_locked() -> None:
    extras = PROJECT["optional-dependencies"]
    assert set(extras) - DEVELOPERS == set(EXTRAS)
    line = re.search(r"^Extras: (.*)$", text("README.md"), re.MULTILINE)
    assert line is not None
    assert set(re.findall(r"`(\w+)`", line[1])) == set(EXTRAS)
    locked = names(re.findall(r"^[^ #]+==", text("requirements.lock"), re.MULTILINE))
    assert set().union(*map(names, extras.values())) <= locked


def test_remedies_name_the_packages_of_an_extra() -> None:
    extras = [names(PROJECT["optional-dependencies"][extra]) for extra in EXTRAS]
    remedies = [
        set(ast.literal_eval(call.args[2]).split())
        for path in ROOT.glob("python/**/*.py")
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and ast.unparse(call.func) == "import_optional"
    ]
    assert all(extra in remedies for extra in extras)
    assert set().union(*remedies) <= set().union(*extras, {"control", "pandas"})


@pytest.mark.parametrize("folder", ["python", "docs"])
def test_nothing_promises_an_extra_of_a_published_package(folder: str) -> None:
    files = [path for path in (ROOT / folder).rglob("*") if path.suffix in (".md", ".py", ".toml")]
    assert files
    assert not [path for path in files if "strainwave[" in path.read_text(encoding="utf-8")]


def test_the_readme_has_the_commands_that_the_check_of_an_installation_runs() -> None:
    commands, script = readme()
    assert [command.split()[1] for command in commands] == [
        "init",
        "identify",
        "export",
        "payload",
    ]
    compile(script, "README.md", "exec")


def test_an_sdist_has_what_a_build_needs_and_nothing_else(tmp_path: Path) -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a clone: which files belong to the project is unknown")
    tracked = set(
        subprocess.run(
            ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.splitlines()
    )
    maturin = ROOT / ".venv/bin/maturin"
    if not maturin.exists():
        pytest.skip("no .venv/bin/maturin, which `make setup` installs")
    subprocess.run([maturin, "sdist", "--out", tmp_path], cwd=ROOT, capture_output=True, check=True)
    (sdist,) = tmp_path.iterdir()
    assert sdist.name == f"strainwave-{VERSION}.tar.gz"
    assert sdist.stat().st_size < MAX_SDIST_BYTES
    with tarfile.open(sdist) as archive:
        sizes = {member.name.partition("/")[2]: member.size for member in archive}
    needed = {
        name for name in tracked if re.match(r"python/|rust/(programs/)?[^/]+/(src/|Cargo)", name)
    }
    assert needed | {"Cargo.lock", "Cargo.toml", "LICENSE", "README.md"} <= set(sizes)
    assert set(sizes) - tracked == {"PKG-INFO"}
    assert max(sizes.values()) < MAX_FILE_BYTES


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_pin_their_actions_and_may_only_read(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    used = re.findall(r"uses: (?!\./)(.*)", source)
    assert used or path.stem == "release"
    assert all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", action) for action in used)
    workflow = yaml.safe_load(source)
    assert workflow["permissions"] == {"contents": "read"}
    granted = {name: job.get("permissions") for name, job in workflow["jobs"].items()}
    assert {name: rights for name, rights in granted.items() if rights} == (
        {"publish": {"id-token": "write"}} if path.stem == "release" else {}
    )


def test_issue_forms_ask_for_the_check() -> None:
    forms = sorted(ROOT.glob(".github/ISSUE_TEMPLATE/[!c]*.yml"))
    assert len(forms) == 2
    assert all("strainwave check study.toml --json" in form.read_text("utf-8") for form in forms)
