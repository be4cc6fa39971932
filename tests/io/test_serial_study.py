"""Study files of serial arms: tables, URDF, transmission, and refusals."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from results import identification
from strainwave import InvalidInput
from strainwave.domain import JointLimits, Payload
from strainwave.dynamics.arm import Arm
from strainwave.io.logs import read_logs
from strainwave.io.results import study_of, to_document
from strainwave.io.study import read_study, write_study
from studies import STUDY, write

_ARM = """
[arm]
kind = "serial"
gravity = [0.0, 0.0, -9.81]
"""

_JOINT = """
[[joint]]
origin = { xyz = [0.0, 0.1, 0.3], rpy = [0.2, 0.0, 0.0] }
axis = [0.0, 1.0, 0.0]
spring = "linear"
gear_ratio = -0.01
torque_per_volt = 0.1
"""

_COUPLING = """
[transmission]
coupling = [[1.0, 0.0], [0.5, 1.0]]
"""

_RECORD = """
[[experiment]]
name = "motion"
file = "motion.csv"
use = "motion"
control = ["servo", "servo"]
"""

_STUDY = _ARM + 2 * _JOINT + _COUPLING + _RECORD

_URDF = """<robot name="r"><link name="base"/><link name="a"/><link name="b"/>
<joint name="one" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/></joint>
<joint name="two" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<origin xyz="0.2 0 0.1"/><limit lower="-1" upper="1.5" velocity="2" effort="0"/></joint></robot>"""

_PLACED_BY_URDF = (
    _ARM
    + 'urdf = "robot.urdf"\n'
    + 2
    * _JOINT.replace(
        "origin = { xyz = [0.0, 0.1, 0.3], rpy = [0.2, 0.0, 0.0] }\naxis = [0.0, 1.0, 0.0]\n", ""
    )
)


def _read(folder: Path, text: str, urdf: str = _URDF) -> Arm:
    (folder / "robot.urdf").write_text(urdf)
    (folder / "study.toml").write_text(text)
    return Arm.of(read_study(folder / "study.toml", logs_exist=False).arm)


def test_tables_place_the_joints_and_couple_the_motors(tmp_path: Path) -> None:
    arm = _read(tmp_path, _STUDY)
    assert arm.joints[1].origin.xyz == (0.0, 0.1, 0.3)
    assert arm.gravity == (0.0, 0.0, -9.81)
    np.testing.assert_allclose(arm.links_of(np.array([100.0, 0.0])), [-1.0, -0.5])


def test_a_urdf_places_the_joints(tmp_path: Path) -> None:
    arm = _read(tmp_path, _PLACED_BY_URDF + _RECORD)
    assert arm.joints[1].origin.xyz == (0.2, 0.0, 0.1)
    assert arm.joints[1].axis == (0.0, 1.0, 0.0)
    assert arm.joint_names == ("one", "two")
    assert [joint.limits for joint in arm.joints] == [None, JointLimits(-1.0, 1.5, 2.0)]


def test_a_joint_slides_as_in_the_urdf(tmp_path: Path) -> None:
    urdf = _URDF.replace('name="two" type="revolute"', 'name="two" type="prismatic"')
    arm = _read(tmp_path, _PLACED_BY_URDF + _RECORD, urdf)
    assert [joint.motion for joint in arm.joints] == ["revolute", "prismatic"]


_LIMITED = _STUDY.replace("spring", "limits = { lower = -1.0, upper = 2.0, effort = 80.0 }\nspring")


@pytest.mark.parametrize("text", [_STUDY, _LIMITED, _PLACED_BY_URDF + _RECORD])
def test_a_written_study_reads_back_equal(tmp_path: Path, text: str) -> None:
    arm = _read(tmp_path, text)
    study = read_study(tmp_path / "study.toml", logs_exist=False)
    write_study(study, tmp_path / "again.toml")
    assert Arm.of(read_study(tmp_path / "again.toml", logs_exist=False).arm) == arm


def test_a_result_places_the_joints_without_the_urdf(tmp_path: Path) -> None:
    arm = _read(tmp_path, _PLACED_BY_URDF + _RECORD)
    study = read_study(tmp_path / "study.toml", logs_exist=False)
    document = to_document(replace(identification(), study=study))
    again = study_of(document, Path("elsewhere/result.json"))
    assert again is not None
    assert again.arm == replace(study.arm, urdf=None)
    assert again.arm.joint_names == arm.joint_names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_STUDY.replace("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 0.0]"), "length zero"),
        (_STUDY.replace("[0.5, 1.0]", "[1.0, 0.0]"), "'coupling' is singular"),
        (_STUDY.replace("linear", "rigid", 1), "joins the joints 2 and 1, of which one is rigid"),
        (_STUDY.replace("[[1.0, 0.0], [0.5, 1.0]]", "[[1.0]]"), "2 rows and 2 columns"),
        (
            _STUDY + '[channels]\ntheta_m3 = "q3"\n',
            "'theta_m3' is not a channel of this arm, which",
        ),
        (
            _STUDY + '[channels]\ngx3 = "q3"\n',
            "has 2 joints. Remedy: remove it, or describe joint 3",
        ),
        (_STUDY.replace("-9.81", "-9810.0"), "if 9810 is in mm/s^2, set 9.81"),
        (_STUDY.replace("gear_ratio = -0.01", "gear_ratio = -100.0"), "inverted: set -0.01"),
        (_STUDY.replace("spring", 'name = "elbow"\nspring'), "two joints have the name 'elbow'"),
        (_LIMITED.replace("lower = -1.0", "lower = 3.0", 1), "3, is not below the upper, 2"),
        (_LIMITED.replace("80.0", "-80.0", 1), "'effort' is -80.0"),
        (_ARM + 8 * _JOINT + _RECORD, "at most 7"),
        (re.sub(r"origin = .*", "origin = 3", _STUDY), "'origin' is 3, but it should be a table"),
        (_PLACED_BY_URDF + _JOINT + _RECORD, "2 joints move in robot.urdf (one, two)"),
        (_PLACED_BY_URDF.replace("robot.urdf", "none.urdf") + _RECORD, "none.urdf"),
        (
            _PLACED_BY_URDF.replace("[[joint]]", "[[joint]]\naxis = [0.0, 0.0, 1.0]", 1) + _RECORD,
            "'axis' is given, but the URDF determines it",
        ),
        (
            _PLACED_BY_URDF.replace("[[joint]]", '[[joint]]\nmotion = "prismatic"', 1) + _RECORD,
            "'motion' is 'prismatic', but the joint 'one' of the URDF is revolute",
        ),
        (
            '[arm]\nkind = "planar-two-link"\nlink_length = 0.35\n'
            + 2 * '[[joint]]\nspring = "linear"\ngear_ratio = 0.01\n'
            + _COUPLING
            + _RECORD,
            "motors of a planar-two-link arm are not coupled",
        ),
    ],
)
def test_faults_are_named_with_their_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInput) as caught:
        _read(tmp_path, text)
    assert message in str(caught.value)
    assert str(tmp_path) in str(caught.value)


_IMU = "imu = { xyz = [0.1, 0.0, 0.0] }\n"
_SLIDING = _STUDY.replace("spring", f'motion = "prismatic"\n{_IMU}spring')


def test_imus_need_a_link_that_turns_or_a_known_mounting(tmp_path: Path) -> None:
    _read(tmp_path, _SLIDING.replace("prismatic", "revolute", 1))
    with pytest.raises(InvalidInput, match=r"\[\[joint\]\] 1: the link of this joint only slides"):
        _read(tmp_path, _SLIDING)
    _read(tmp_path, _SLIDING.replace("0.0] }\nspring", "0.0], rpy = [0.1, 0.0, 0.0] }\nspring"))
    single = '[arm]\nkind = "single-joint"\n[[joint]]\nmotion = "prismatic"\nspring = "linear"\n'
    single += "gear_ratio = 0.01\n" + _IMU + _RECORD.replace(', "servo"', "")
    with pytest.raises(InvalidInput, match="needs a serial arm, and the kind is single-joint"):
        _read(tmp_path, single)


_LOADED = (
    _RECORD.replace('"motion', '"loaded').replace('use = "loaded"', 'use = "motion"')
    + "payload = { mass = 2.0, xyz = [0.0, 0.0, 0.1] }\n"
)
_UNKNOWN = _STUDY.replace("torque_per_volt = 0.1", 'torque_per_volt = "unknown"')


def test_unknown_drives_and_payloads_read_back(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(_UNKNOWN + _LOADED)
    study = read_study(tmp_path / "study.toml", logs_exist=False)
    assert study.arm.unknown_drives == (1, 2)
    assert study.experiments[1].payload == Payload(2.0, (0.0, 0.0, 0.1))
    write_study(study, tmp_path / "copy.toml")
    assert read_study(tmp_path / "copy.toml", logs_exist=False).experiments == study.experiments


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            _STUDY + _LOADED,
            r"\[\[experiment\]\] 2: a payload is given, but .* known.* Remedy: remove",
        ),
        (
            _UNKNOWN,
            r"\[\[joint\]\] 1: 'torque_per_volt' is \"unknown\", but .* record a motion without",
        ),
        (_UNKNOWN + _LOADED.replace("2.0", "-2.0"), "'mass' is -2.0"),
        (_UNKNOWN + _LOADED.replace("2.0", "2e5"), r"'mass' is 200000 kg.*in g, set 200"),
        (_UNKNOWN + _LOADED.replace("0.1]", "100.0]"), r"'xyz' is 100 m.*in mm, set 0.1"),
        (_UNKNOWN.replace('"unknown"', '"unkown"'), "'torque_per_volt' is 'unkown'"),
    ],
)
def test_unknown_drives_need_payloads(text: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(InvalidInput, match=expected):
        read_study(tmp_path / "study.toml", logs_exist=False)


@pytest.mark.parametrize(
    ("study", "remedy"),
    [
        (_STUDY, "; else map it"),
        (_PLACED_BY_URDF + _RECORD, ' and set its type to "fixed" in robot.urdf; else map it'),
    ],
)
def test_a_log_without_one_of_the_joints_is_refused(
    study: str, remedy: str, tmp_path: Path
) -> None:
    _read(tmp_path, study)
    (tmp_path / "motion.csv").write_text("t,theta_m1,u1,u2\n0,0,0,0\n1,1,1,1\n")
    with pytest.raises(InvalidInput) as caught:
        read_logs(read_study(tmp_path / "study.toml"))
    message = str(caught.value)
    assert f"{tmp_path / 'motion.csv'}: there is no column 'theta_m2'" in message
    assert f"if joint 2 stands still in all logs, remove its [[joint]] table{remedy}" in message
    assert "did you mean" not in message  # the angle of another joint


def test_planar_arms_have_known_drives(tmp_path: Path) -> None:
    text = STUDY.replace("torque_per_volt = 0.08", 'torque_per_volt = "unknown"')
    path = write(tmp_path, text)
    with pytest.raises(InvalidInput, match=r"of a planar-two-link arm must be known.*\"serial\""):
        read_study(path)
