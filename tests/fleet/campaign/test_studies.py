"""Studies that the arguments of a campaign name, and their hashes."""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath, PureWindowsPath

import fsspec
import pytest

import strainwave as sw
from campaign_rigs import STUDY, rig, rigs
from strainwave.fleet.campaign import study_files
from strainwave.fleet.campaign.records import Task
from strainwave.fleet.campaign.study_files import (
    CaseSelection,
    StudyFile,
    find,
    leaves_folder,
    resolved,
)


def names(found: CaseSelection, folder: Path | str) -> list[str]:
    return [case.name.removeprefix(f"{folder}/") for case in found.cases]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rigs(tmp_path / "a", 2)
    rig(tmp_path / "b")
    (tmp_path / "b" / "study.toml").rename(tmp_path / "b" / "other.toml")
    return tmp_path


BOTH = ["a/rig-000/study.toml", "a/rig-001/study.toml"]


def test_files_folders_and_globs(folder: Path) -> None:
    one = str(folder / "b" / "other.toml")
    assert names(find([one]), folder) == ["b/other.toml"]
    assert names(find([str(folder)]), folder) == BOTH
    assert names(find([str(folder / "a" / "rig-*")]), folder) == BOTH
    assert names(find([f"{folder}/**/*.toml"]), folder) == [*BOTH, "b/other.toml"]
    assert names(find([str(folder / "a"), one, one, str(folder)]), folder) == [
        *BOTH,
        "b/other.toml",
    ]


def test_a_study_has_the_name_of_its_argument(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder / "a")
    found = find(["rig-001"])
    assert [case.name for case in found.cases] == ["rig-001/study.toml"]
    (case,) = found.cases
    assert isinstance(case, StudyFile)
    assert case.location == str(folder / "a" / "rig-001" / "study.toml")


def test_tables_of_paths(folder: Path) -> None:
    (folder / "list.txt").write_text("# rigs\na/rig-001/study.toml\n\nb/other.toml\n")
    assert names(find([str(folder / "list.txt")]), folder) == [
        "a/rig-001/study.toml",
        "b/other.toml",
    ]
    (folder / "list.csv").write_text(
        f"note,study\nx,{folder}/b/other.toml\ny,a/rig-000/study.toml\n"
    )
    assert names(find([str(folder / "list.csv")]), folder) == [
        "b/other.toml",
        "a/rig-000/study.toml",
    ]


@pytest.mark.parametrize("scheme", ["memory", "file"])
def test_urls(scheme: str, folder: Path) -> None:
    root = f"{scheme}://{folder}"
    if scheme == "memory":
        for path in folder.rglob("*.*"):
            with fsspec.open(f"memory://{path}", "wb") as file:
                file.write(path.read_bytes())
    with fsspec.open(f"{root}/list.txt", "w") as file:
        file.write("a/rig-001/study.toml\n")
    assert names(find([f"{root}/b/other.toml"]), root) == ["b/other.toml"]
    assert names(find([root]), root) == BOTH
    assert names(find([f"{root}/a/rig-*/study.toml"]), root) == BOTH
    assert names(find([f"{root}/list.txt"]), root) == ["a/rig-001/study.toml"]
    case = find([f"{root}/a/rig-000/study.toml"]).cases[0]
    with case.opened() as opened:
        assert isinstance(opened.study, Path)
        assert sw.identify(opened.study, stages=("rigid",)).status == "determined"
        fetched = opened.study.parent
    assert not fetched.exists()
    first = case.hashes()
    assert first == case.hashes()
    with fsspec.open(f"{root}/a/rig-000/motion.csv", "w") as file:
        file.write("t,theta_m1\n")
    assert case.hashes()[1] != first[1]
    with pytest.raises(sw.InvalidInput, match="does not exist"):
        find([f"{root}/absent.toml"])


def test_a_log_at_a_url_is_in_the_folder_of_its_study(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace("motion.csv", "../secret.csv"))
    with (
        pytest.raises(sw.InvalidInput, match="is not in the folder of the study"),
        StudyFile(path.as_uri(), path.as_uri()).opened(),
    ):
        pass


def test_hashes_change_with_the_study_and_its_logs(tmp_path: Path) -> None:
    path = rig(tmp_path)
    case = find([str(path)]).cases[0]
    first = case.hashes()
    path.write_text(STUDY + "\n")
    second = case.hashes()
    assert second[0] != first[0]
    assert second[1] == first[1]
    with (tmp_path / "motion.csv").open("a") as file:
        file.write("\n")
    third = case.hashes()
    assert third[0] == second[0]
    assert third[1] != second[1]
    (tmp_path / "motion.csv").unlink()
    assert case.hashes()[1] not in (second[1], third[1])
    os.utime(path)
    path.unlink()
    assert case.hashes()[0] is None


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("robot.urdf", 'kind = "single-joint"', 'kind = "serial"\nurdf = "robot.urdf"'),
        (
            "part2.csv",
            "[[experiment]]",
            '[[experiment]]\nsteps = [{ kind = "merge", file = "part2.csv" }]',
        ),
    ],
    ids=["urdf", "merged log"],
)
def test_further_files_are_inputs_of_their_study(
    tmp_path: Path, name: str, before: str, after: str
) -> None:
    (tmp_path / "study.toml").write_text(STUDY.replace(before, after, 1))
    (tmp_path / name).write_text("<robot/>")
    location = (tmp_path / "study.toml").as_uri()
    with StudyFile(location, location).opened() as opened:
        assert isinstance(opened.study, Path)
        assert (opened.study.parent / name).read_text() == "<robot/>"
    local = StudyFile("study", str(tmp_path / "study.toml"))
    first = local.hashes()
    (tmp_path / name).write_text("<robot></robot>")
    assert local.hashes()[0] == first[0]
    assert local.hashes()[1] != first[1]


def test_a_folder_of_logs_is_hashed_file_by_file(tmp_path: Path) -> None:
    """For example a bag."""
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace("motion.csv", "bag"))
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "one.mcap").write_bytes(b"1")
    case = find([str(path)]).cases[0]
    first = case.hashes()
    (tmp_path / "bag" / "one.mcap").write_bytes(b"2")
    assert case.hashes() != first


def test_a_case_is_restored_from_json(tmp_path: Path) -> None:
    case = find([str(rig(tmp_path))]).cases[0]
    task = Task(
        case=case, study_sha256="", inputs_sha256="", stages=("rigid",), store="", campaign=""
    )
    assert Task.from_json(task.to_json()) == task


CAMPAIGN = """\
stages = ["rigid"]

[options]
rigid = { bandwidth_hz = 30.0 }

[studies]
paths = ["a", "b/other.toml"]
"""


def test_a_campaign_file(folder: Path) -> None:
    path = folder / "campaign.toml"
    path.write_text(CAMPAIGN)
    found = find([str(path)])
    assert names(found, folder) == [*BOTH, "b/other.toml"]
    assert found.stages == ("rigid",)
    assert found.options == {"rigid": {"bandwidth_hz": 30.0}}
    path.rename(folder / "nightly.toml")
    assert names(find([str(folder / "nightly.toml")]), folder) == names(found, folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CAMPAIGN.replace("stages", "stage"), "unknown key 'stage'.*did you mean 'stages'"),
        (CAMPAIGN.replace('["rigid"]', '"rigid"'), "'stages' is missing or invalid"),
        (CAMPAIGN.replace("paths = ", "path = "), "'studies' is missing or invalid"),
        (CAMPAIGN.replace('"a", ', "3, "), r"'studies\.paths' is missing or invalid"),
        (CAMPAIGN.replace("{ bandwidth_hz = 30.0 }", "3"), "'options' is missing or invalid"),
        (CAMPAIGN.replace('"a"', '"absent"'), "absent: does not exist"),
        (CAMPAIGN + "[", "is not valid TOML"),
    ],
)
def test_wrong_campaign_files_are_refused(text: str, message: str, folder: Path) -> None:
    path = folder / "campaign.toml"
    path.write_text(text)
    with pytest.raises(sw.InvalidInput, match=message):
        find([str(path)])


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("absent", "does not exist"),
        ("b", "there is no study.toml in this folder or below"),
        ("a/*.toml", "matches no file"),
        ("none.txt", "lists no studies"),
        ("none.csv", "has no column 'study'"),
        ("absent.csv", "the list of studies does not exist"),
        ("nobody://x/study.toml", "this kind of URL cannot be read"),
    ],
)
def test_arguments_without_studies_are_refused(
    argument: str, message: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    Path("none.txt").write_text("# nothing\n")
    Path("none.csv").write_text("path\nb/other.toml\n")
    with pytest.raises(sw.InvalidInput, match=message):
        find([argument])


def test_a_campaign_file_is_given_alone(folder: Path) -> None:
    (folder / "campaign.toml").write_text(CAMPAIGN)
    with pytest.raises(sw.InvalidInput, match="is given with other arguments"):
        find([str(folder / "campaign.toml"), str(folder / "a")])


@pytest.mark.parametrize("name", ["../a.csv", "logs/../../a.csv", r"..\a.csv", r"C:\a.csv", r"\a"])
def test_a_copied_study_names_only_files_of_its_folder(name: str) -> None:
    assert leaves_folder(PureWindowsPath(name))
    assert leaves_folder(PurePosixPath(name)) == ("/" in name)  # a backslash is a letter there
    assert not leaves_folder(PureWindowsPath(r"logs\a.csv"))


def test_a_table_of_paths_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_files, "Path", PureWindowsPath)
    table = r"C:\rigs\studies.txt"
    assert resolved(r"arm\study.toml", table) == r"C:\rigs\arm\study.toml"
    assert resolved("arm/study.toml", table) == r"C:\rigs\arm\study.toml"
    assert resolved(r"D:\arm\study.toml", table) == r"D:\arm\study.toml"
    assert resolved("study.toml", "s3://rigs/studies.txt") == "s3://rigs/study.toml"
