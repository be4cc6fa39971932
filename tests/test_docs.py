"""Examples in the documentation run, and its lists are complete.

Examples: study files, parameter files, commands, code, links. Lists: codes, keys, equations.
"""

from __future__ import annotations

import json
import re
import runpy
import shlex
import shutil
from contextlib import chdir
from pathlib import Path

import pytest

from command_line import run_here
from strainwave import cli
from strainwave.domain.arm.effects import possible_causes
from strainwave.domain.messages import catalogue
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study
from strainwave.virtual import scara

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
NOTEBOOKS = sorted(ROOT.glob("docs/notebooks/*.ipynb"))
STAGES = (
    "read",
    "hygiene",
    "rigid",
    "links",
    "statespace",
    "physical",
    "sweep",
    "tuning",
    "criticism",
    "report",
)
EXAMPLES = sorted(ROOT.glob("examples/*.py"))


def blocks_of(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def blocks(language: str) -> list[tuple[str, str]]:
    return [
        (f"{page.relative_to(ROOT)}-{k}", text)
        for page in PAGES
        for k, text in enumerate(blocks_of(page, language))
    ]


def programs() -> list[tuple[str, str]]:
    """Return the Python programs of the docs: one per page, and one of all stage pages."""
    stages = [ROOT / f"docs/stages/{name}.md" for name in STAGES]
    others = [page for page in PAGES if page not in stages and blocks_of(page, "python")]
    groups = {page.stem: [page] for page in others} | {"stages": stages}
    return [
        (name, "\n".join(text for page in pages for text in blocks_of(page, "python")))
        for name, pages in groups.items()
    ]


def commands() -> list[tuple[str, str]]:
    return [
        (page.name, line)
        for page in PAGES
        for line in re.findall(r"^ {4}(strainwave .*)$", page.read_text("utf-8"), re.MULTILINE)
    ]


def test_study_files_are_read(tmp_path: Path) -> None:
    texts = [text for _, text in blocks("toml")]
    complete = [text for text in texts if "[arm]" in text]
    assert complete
    path = tmp_path / "study.toml"
    for text in complete:
        path.write_text(text, encoding="utf-8")
        read_study(path, logs_exist=False)
    studies = []
    for part in (text for text in texts if text not in complete):
        path.write_text(complete[0] + "\n" + part, encoding="utf-8")
        studies.append(read_study(path, logs_exist=False))
    mapped = [study.channels["theta_m1"] for study in studies if study.channels]
    assert any(channel.scale < 1.0 for channel in mapped)
    assert any(study.arm.servo is not None for study in studies)
    assert any(study.experiments[-1].prbs is not None for study in studies)


@pytest.mark.parametrize(("name", "text"), blocks("json"))
def test_parameter_files_are_read(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / f"{Path(name).name}.json"
    path.write_text(text, encoding="utf-8")
    assert set(read_parameters(path)) <= set(scara.STIFF.parameters()) | set(
        scara.STIFF.parameters(spring="linear")
    )


@pytest.mark.parametrize(("page", "line"), commands())
def test_commands_have_the_options_shown(page: str, line: str) -> None:
    words = shlex.split(line, comments=True)
    help_text = run_here(words[1], "--help").stdout
    assert [word for word in words if word.startswith("--") and word not in help_text] == [], page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_have_targets(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), target


@pytest.fixture(scope="module")
def folder(demo: tuple[Path, str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder in which programs run; the demonstration is in `demo`."""
    folder = tmp_path_factory.mktemp("docs")
    shutil.copytree(demo[0], folder / "demo")
    return folder


@pytest.mark.parametrize(("name", "text"), programs())
def test_code_runs(name: str, text: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with chdir(folder):
        exec(compile(text, name, "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_examples_run(
    example: Path,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("sys.argv", [str(example), str(folder / "demo" / "study.toml")])
    runpy.run_path(str(example), run_name="__main__")
    assert capsys.readouterr().out


def test_every_key_of_a_study_is_documented() -> None:
    from dataclasses import fields

    from strainwave.domain import Experiment, Joint, PositionServo, Servo
    from strainwave.domain.arm.kinds import KINDS

    page = (ROOT / "docs" / "study.md").read_text(encoding="utf-8")
    for record in (
        *(kind.table for kind in KINDS.values()),
        Joint,
        Servo,
        PositionServo,
        Experiment,
    ):
        for field in fields(record):
            if field.name in ("origin", "axis", "torque_at_link"):
                continue  # the kinds place the joints, and the channels tell the side of a torque
            assert f"`{field.name}`" in page or f"{field.name} =" in page, field.name


def test_every_key_of_a_result_is_documented(folder: Path) -> None:
    page = (ROOT / "docs" / "result.md").read_text(encoding="utf-8")
    document = json.loads((folder / "demo" / "result.json").read_text())
    keys = [*document, *document["stages"]["rigid"], *document["parameters"][0]]
    assert [key for key in keys if f"`{key}`" not in page and f"stages.{key}" not in page] == []


def test_notebooks_are_committed_without_outputs() -> None:
    assert len(NOTEBOOKS) == 4
    for path in NOTEBOOKS:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        code = [cell for cell in cells if cell["cell_type"] == "code"]
        assert [cell["outputs"] for cell in code] == [[]] * len(code), path.name
        assert [cell["execution_count"] for cell in code] == [None] * len(code), path.name


def test_every_equation_number_is_unique() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    numbers = re.findall(r"\\tag\{(.*?)\}", text)
    assert sorted(numbers) == sorted(set(numbers))
    assert {f"S{k}" for k in range(1, 15)} <= set(numbers)


def codes_of_warnings() -> set[str]:
    """Return all warning codes: those of the catalogue and of likely effects."""
    return {*catalogue(), *(effect.warning_code for effect in possible_causes())}


def test_every_warning_has_a_section_in_troubleshooting() -> None:
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    sections = re.findall(r"^### `(.*)`$", page, re.MULTILINE)
    assert sorted(sections) == sorted(codes_of_warnings())
    for section in page.split("### `")[1:]:
        text = " ".join(section.split())
        for part in ("*Observed.*", "*Meaning.*", "*What to do.*"):
            assert part in text, text[:40]


def test_what_pages_take_from_the_package_is_current() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "generated.py"))
    for path, renew in script["PAGES"].items():
        page = path.read_text(encoding="utf-8")
        assert renew(page) == page, "run python docs/generated.py"


def test_every_exit_code_is_explained() -> None:
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    table = page.split("## Exit codes")[1].split("## ")[0]
    codes = {int(code) for code in re.findall(r"^\| (\d) \|", table, re.MULTILINE)}
    assert codes == {cli.DONE, cli.INPUT_AT_FAULT, cli.NOT_DETERMINED, cli.CHANGED, 1}
