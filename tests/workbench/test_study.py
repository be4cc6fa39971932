"""Page "Study": the form and the command line share one file."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from strainwave.init.draft import placed_arm
from strainwave.io.study import read_study

pytest.importorskip("starlette")

from strainwave.init.changes import KeyChange, changed_text, edit_study, parse_draft
from strainwave.workbench.study_form import missing_values

if TYPE_CHECKING:
    from starlette.testclient import TestClient

API = "/api/study/arm/study.toml"
DRAFT = """# my rig
[arm]
kind = "planar-two-link"  # TODO is a word in a comment
link_length = TODO        # [m] measured

[[joint]]
spring = "linear"
gear_ratio = TODO
[[joint]]
spring = "linear"
gear_ratio = 0.01

[servo]
kp = [TODO, TODO]  # gains
"""


def tables_in(text: str) -> dict[str, Any]:
    return parse_draft(text, Path("study.toml")).unwrap()


def saved(client: TestClient, *changes: dict[str, Any], sha256: str | None = None) -> Any:
    state = client.get(API).json()
    body = {"sha256": sha256 or state["sha256"], "changes": list(changes)}
    return client.post(API, json=body)


def change(place: list[str | int], value: str, kind: str = "number") -> dict[str, Any]:
    return {"place": place, "kind": kind, "value": value}


def test_a_change_keeps_comments_and_is_read_by_the_command_line(
    client: TestClient, folder: Path
) -> None:
    study = folder / "arm" / "study.toml"
    study.write_text("# measured in May\n" + study.read_text())
    answer = saved(client, change(["joint", 0, "torque_per_volt"], "0.075"))
    assert answer.json()["error"] is None
    assert study.read_text().startswith("# measured in May\n")
    assert read_study(study).arm.joints[0].torque_per_volt == 0.075


def test_a_file_of_the_command_line_is_shown(client: TestClient, folder: Path) -> None:
    edit_study(folder / "arm" / "study.toml", [KeyChange(("joint", 1, "gear_ratio"), 0.0125)])
    groups = client.get(API).json()["groups"]
    (joints,) = [group for group in groups if group["title"] == "Joints"]
    (row,) = [row for row in joints["rows"] if row["key"]["key"] == "gear_ratio"]
    assert row["fields"][1]["value"] == "0.0125"
    assert row["key"]["range"] == [1e-4, 1.0]
    assert [unit["name"] for unit in row["units"]] == ["n", "1/n"]


def test_a_file_that_changed_in_the_meantime_is_not_overwritten(
    client: TestClient, folder: Path
) -> None:
    before = client.get(API).json()["sha256"]
    study = folder / "arm" / "study.toml"
    study.write_text(study.read_text() + "# by hand\n")
    answer = saved(client, change(["joint", 0, "gear_ratio"], "0.02"), sha256=before)
    assert answer.status_code == 400
    assert "changed in the meantime" in answer.json()["error"]
    assert study.read_text().endswith("# by hand\n")


def test_an_error_of_the_study_names_the_key_and_the_file_stays_editable(
    client: TestClient,
) -> None:
    wrong = saved(client, change(["joint", 0, "gear_ratio"], "100")).json()
    assert "gear_ratio" in wrong["error"]
    assert "/served/" not in wrong["error"]
    assert saved(client, change(["joint", 0, "gear_ratio"], "0.01")).json()["error"] is None


def test_the_text_is_saved_whole_or_not_at_all(client: TestClient, folder: Path) -> None:
    study = folder / "arm" / "study.toml"
    state = client.get(API).json()
    text = state["text"].replace('kind = "planar-two-link"', 'kind = "planar-two-link"  # ours')
    good = client.post(API, json={"sha256": state["sha256"], "text": text})
    assert good.status_code == 200
    assert "# ours" in study.read_text()
    bad = client.post(API, json={"sha256": good.json()["sha256"], "text": "[arm"})
    assert bad.status_code == 400
    assert "# ours" in study.read_text()


def test_a_column_is_mapped_scaled_and_removed(client: TestClient, folder: Path) -> None:
    study = folder / "arm" / "study.toml"
    saved(client, change(["channels", "a1", "column"], "a1", "text"))
    saved(client, change(["channels", "a1", "scale"], "9.81"))
    assert read_study(study).channels["a1"].scale == 9.81
    query = {"experiment": "motion", "channel": "a1", "column": "a1", "scale": "2", "offset": "1"}
    figure = client.get("/api/preview/arm/study.toml", params=query).json()
    assert figure["layout"]["yaxis"]["title"]["text"] == "a1 [m/s²]"
    saved(client, change(["channels", "a1"], "", "text"))
    assert "a1" not in read_study(study).channels


def test_todo_values_are_listed_and_survive_other_changes() -> None:
    document = parse_draft(DRAFT, Path("study.toml"))
    missing = missing_values(document)
    places = [("arm", "link_length"), ("joint", 0, "gear_ratio")]
    assert [*missing] == places + [("servo", key) for key in ("period", "kp", "ki", "limit")]
    assert missing["arm", "link_length"] == "[m] measured"
    assert missing["servo", "limit"] == "largest output; integration stops there"
    text = changed_text(DRAFT, [KeyChange(("arm", "link_length"), 0.35)], Path("study.toml"))
    assert text == DRAFT.replace("link_length = TODO", "link_length = 0.35")


def test_missing_values_of_channels_and_experiments_are_listed() -> None:
    text = """[channels]
sample_rate = TODO
a1 = { column = "acc", scale = TODO }  # counts of the sensor
gyro1 = "TODO"
[[experiment]]
name = "chirp"
prbs = { order = 10, amplitude = TODO }
"""
    document = parse_draft(text, Path("study.toml"))
    missing = missing_values(document)
    del missing["arm", "kind"]
    assert missing == {
        ("channels", "sample_rate"): "of logs without a time column",
        ("channels", "a1", "scale"): "counts of the sensor",
        ("channels", "gyro1"): "",
        ("experiment", 0, "prbs", "amplitude"): "",
    }


def test_a_cleared_value_is_missing_if_the_study_needs_it(client: TestClient) -> None:
    state = saved(client, change(["joint", 1, "gear_ratio"], "")).json()
    assert [each["place"] for each in state["missing"]] == [["joint", 1, "gear_ratio"]]
    assert "gear_ratio" in state["error"]


def test_the_arm_is_drawn_while_values_are_missing(client: TestClient, folder: Path) -> None:
    study = folder / "arm" / "study.toml"
    study.write_text(DRAFT)
    state = client.get(API).json()
    assert state["error"]
    assert "its length is missing" in state["caption"]
    assert state["arm"]["data"]
    arm, note = placed_arm(tables_in(DRAFT.replace("h = TODO", "h = 0.4")), study)
    assert (arm.joints[1].origin.xyz[0], note) == (0.4, "")


def test_a_serial_arm_without_positions_says_which_are_missing() -> None:
    text = """[arm]
kind = "serial"
[[joint]]
origin = { xyz = [0, 0, 0.3], rpy = [TODO, TODO, TODO] }
axis = [TODO, TODO, TODO]
[[joint]]
gear_ratio = TODO
"""
    arm, note = placed_arm(tables_in(text), Path("study.toml"))
    assert arm.joints[0].origin.xyz == (0.0, 0.0, 0.3)
    assert note == "No position is given of joint 2: see Placement."


def test_units_of_a_prismatic_joint(client: TestClient, folder: Path) -> None:
    text = '[arm]\nkind = "single-joint"\n[[joint]]\nmotion = "prismatic"\ngear_ratio = 0.02\n'
    (folder / "arm" / "study.toml").write_text(text)
    state = client.get(API).json()
    (angle,) = [row for row in state["channels"] if row["channel"] == "theta_m1"]
    assert (angle["unit"], [unit["name"] for unit in angle["units"]]) == ("m", ["m", "mm"])
    (joint,) = [group for group in state["groups"] if group["title"] == "Joint"]
    (ratio,) = [row for row in joint["rows"] if row["key"]["key"] == "gear_ratio"]
    assert (ratio["key"]["unit"], ratio["units"]) == ("link rad (or m) per motor rad", [])


@pytest.mark.parametrize(
    "text",
    [
        "arm = 3",
        "joint = [1]",
        '[arm]\nkind = "serial"\n[[joint]]\norigin = 3',
        '[arm]\nkind = "serial"\n[[joint]]\nimu = 3\n[channels]\na1 = 3',
        '[arm]\nkind = "planar-two-link"\nlink_length = "x"\n[[joint]]\n[[joint]]',
        "x = TODO",
    ],
)
def test_a_file_with_wrong_tables_stays_editable(
    client: TestClient, folder: Path, text: str
) -> None:
    (folder / "arm" / "study.toml").write_text(text)
    state = client.get(API).json()
    assert state["error"]
    assert (state["text"], state["arm"]) == (text, None)


def test_a_urdf_outside_the_folder_is_not_drawn(client: TestClient, folder: Path) -> None:
    (folder.parent / "secret.urdf").write_text("<robot name='x'/>")
    draft = '[arm]\nkind = "serial"\nurdf = "../../secret.urdf"\n[[joint]]\ngear_ratio = TODO\n'
    (folder / "arm" / "study.toml").write_text(draft)
    state = client.get(API).json()
    assert state["arm"] is None
    assert state["error"]


def test_the_list_of_studies_names_arms_errors_and_verdicts(
    client: TestClient, folder: Path
) -> None:
    (folder / "broken").mkdir()
    (folder / "broken" / "study.toml").write_text('[arm]\nkind = "cube"\n')
    page = client.get("/").text
    assert "planar two link, 2 joints" in page
    assert "there is no [[joint]] table" in page


@pytest.mark.parametrize("name", ["ä rig #1", "100 % + more", "a&b=c", "quote's"])
def test_unusual_names_of_folders_work(client: TestClient, folder: Path, name: str) -> None:
    from urllib.parse import quote

    shutil.copytree(folder / "arm", folder / name)
    path = quote(f"{name}/study.toml")
    assert path in client.get("/").text
    assert client.get(f"/signals/{path}").status_code == 200
    assert client.get(f"/api/study/{path}").json()["error"] is None
