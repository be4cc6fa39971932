from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import studies
from strainwave.domain import Channel, Experiment, Joint, Origin, Prbs, Servo, Study
from strainwave.domain.arm.kinds import planar_two_link
from strainwave.errors import InvalidInput
from strainwave.io.study import read_study, write_study


def test_a_study_file_is_read(tmp_path: Path) -> None:
    study = read_study(studies.write(tmp_path))
    assert study.arm.kind == "planar-two-link"
    origin = Origin((0.35, 0.0, 0.0))
    assert study.arm.joints[1] == Joint("linear", 0.01, torque_per_volt=0.03, origin=origin)
    assert study.arm.servo == Servo("pi-velocity", 0.001, (0.12, 0.1), (1.5, 1.5), 10.0)
    assert study.experiments[1].prbs == Prbs(10, 0.001, 4, 10.0)
    assert study.experiments[1].control == ("open", "open")
    assert len(study.sha256) == 64


def test_channels_are_names_or_tables(tmp_path: Path) -> None:
    text = (
        studies.STUDY + '\n[channels]\nt = "time"\nu1 = { column = "v", scale = 2, offset = -1 }\n'
    )
    study = read_study(studies.write(tmp_path, text))
    assert study.channels == {"t": Channel("time"), "u1": Channel("v", 2.0, -1.0)}


def test_the_default_control_is_open(tmp_path: Path) -> None:
    text = studies.STUDY.replace('control = ["servo", "servo"]\n', "")
    assert read_study(studies.write(tmp_path, text)).experiments[0].control == ("open", "open")


FAULTS = {
    "missing key": (
        'spring = "linear"\n',
        "",
        1,
        r"line 5, \[\[joint\]\] 1: the key 'spring' is missing",
    ),
    "unknown key": (
        "gear_ratio",
        "gear_ration",
        1,
        r"line 7.*'gear_ration' is unknown.*mean 'gear_ratio'",
    ),
    "unknown table": ("[servo]", "[server]", 1, r"'server' is unknown.*mean 'servo'"),
    "wrong type": (
        "link_length = 0.35",
        'link_length = "0.35"',
        1,
        r"line 3, \[arm\]: 'link_length'",
    ),
    "no such choice": (
        '"planar-two-link"',
        '"scara"',
        1,
        r"'scara', but it should be 'planar-two-link'",
    ),
    "ratio upside down": (
        "gear_ratio = 0.01",
        "gear_ratio = 100",
        1,
        r"100 .*probably inverted: set 0.01",
    ),
    "millimetres": (
        "link_length = 0.35",
        "link_length = 350",
        1,
        r"if 350 is in mm, set 0.35",
    ),
    "milliseconds": (
        "period = 0.001",
        "period = 1.0",
        1,
        r"if 1 is in ms, set 0.001",
    ),
    "clock in ms": ("clock = 0.001", "clock = 10.0", 1, r"if 10 is in ms, set 0.01"),
    "kilohertz": (
        "encoder_counts = 8192",
        "current_loop_hz = 1.0",
        1,
        r"if 1 is in kHz, set 1000",
    ),
    "negative": (
        "limit = 10.0",
        "limit = -10.0",
        1,
        r"'limit' is -10.0, but it should be greater than 0",
    ),
    "too large": (
        "limit = 10.0",
        "limit = 1e300",
        1,
        r"'limit' is 1e\+300, but it should be less than or equal to 1000000000000",
    ),
    "not finite": ("limit = 10.0", "limit = nan", 1, r"'limit' is nan"),
    "too few gains of a position loop": (
        "limit = 10.0",
        "limit = 10.0\nposition_gain = [8.0]",
        2,
        r"'position_gain' has 1 value.*2 joint",
    ),
    "too few gains": ("kp = [0.12, 0.1]", "kp = [0.12]", 1, r"'kp' has 1 value.*2 joint"),
    "joint out of range": ("joint = 1", "joint = 3", 1, r"there is no joint 3: the arm has 2"),
    "joint zero": (
        "joint = 1",
        "joint = 0",
        1,
        r"'joint' is 0, but it should be greater than or equal to 1",
    ),
    "empty window": (
        'use = "motion"',
        'use = "motion"\nstart = 3.0\nstop = 2.0',
        1,
        r"the window is empty",
    ),
    "same name": ('name = "prbs"', 'name = "motion"', 1, r"two experiments have the name 'motion'"),
    "no such log": (
        "motion.csv",
        "motoin.csv",
        1,
        r"'motoin.csv' does not exist.*mean 'motion.csv'",
    ),
    "no such channel": (
        "[servo]",
        '[channels]\ntheta1 = "x"\n[servo]',
        1,
        r"'theta1' is not a channel.*mean 'theta_m1'",
    ),
    "no scale": (
        "[servo]",
        '[channels]\nu1 = { column = "x", scale = 0 }\n[servo]',
        1,
        r"the scale of 'u1' is zero",
    ),
    "channel of no kind": (
        "[servo]",
        "[channels]\nu1 = 3\n[servo]",
        1,
        r"'u1' is 3.*write a name",
    ),
    "no link length": ("link_length = 0.35\n", "", 1, r"'link_length' is missing"),
    "bad TOML": ("[servo]", "[servo", 1, r"is not valid TOML .*line 17"),
    "slider": (
        'spring = "linear"',
        'spring = "linear"\nmotion = "prismatic"',
        1,
        r"revolute joints only",
    ),
    "one for many": ("[[joint]]", "[joint]", 2, r"not valid TOML|must be a list"),
    "prbs of a wrong type": (
        "periods = 4",
        "periods = 4.5",
        1,
        r"'periods' is 4.5, but it should be a valid integer",
    ),
    "no such effect": (
        'spring = "linear"',
        'spring = "linear"\neffects = ["stribek"]',
        1,
        r"'effects' is \['stribek'\], but it should be 'stribeck', 'hysteresis',",
    ),
    "effect of a rigid gear": (
        'spring = "linear"',
        'spring = "rigid"\neffects = ["stribeck", "kinematic-error"]',
        1,
        r"line 7, \[\[joint\]\] 1: the effect 'kinematic-error' needs an elastic gear",
    ),
    "prbs unknown": ("periods = 4", "period = 4", 1, r"'period' is unknown.*mean 'periods'"),
}


def test_six_joints_are_rejected_with_the_supported_arms(tmp_path: Path) -> None:
    joints = 6 * '[[joint]]\nspring = "rigid"\ngear_ratio = 0.01\ntorque_per_volt = 0.08\n'
    control = ", ".join(6 * ['"servo"'])
    experiment = f'name = "m"\nfile = "m.csv"\nuse = "motion"\ncontrol = [{control}]\n'
    arm = '[arm]\nkind = "planar-two-link"\nlink_length = 0.3\n'
    path = studies.write(tmp_path, f"{arm}{joints}[[experiment]]\n{experiment}")
    with pytest.raises(InvalidInput, match=r"has 2 joint\(s\), but there are 6") as caught:
        read_study(path)
    assert "recorded with all other joints at rest" in str(caught.value)


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_reported_with_its_place(fault: str, tmp_path: Path) -> None:
    old, new, times, expected = FAULTS[fault]
    assert old in studies.STUDY
    path = studies.write(tmp_path, studies.STUDY.replace(old, new, times))
    with pytest.raises(InvalidInput, match=expected) as caught:
        read_study(path)
    message = str(caught.value)
    assert str(path) in message
    assert "Remedy: " in message
    assert "\n" not in message


def test_a_prismatic_joint_rejects_gravity(tmp_path: Path) -> None:
    text = '[arm]\nkind = "single-joint"\ngravity = 9.81\n[[joint]]\nmotion = "prismatic"\n'
    text += 'spring = "rigid"\ngear_ratio = 1.0\n[[experiment]]\nname = "a"\nfile = "motion.csv"\nuse = "motion"\n'
    with pytest.raises(InvalidInput, match="perpendicular to gravity"):
        read_study(studies.write(tmp_path, text))


def test_counts_per_turn_need_a_revolute_joint(tmp_path: Path) -> None:
    text = '[arm]\nkind = "single-joint"\n[[joint]]\nmotion = "prismatic"\nspring = "rigid"\n'
    text += "gear_ratio = 1.0\nlink_encoder_counts = 1e6\n"
    text += '[[experiment]]\nname = "a"\nfile = "motion.csv"\nuse = "motion"\n'
    with pytest.raises(InvalidInput, match="'link_encoder_counts' are counts per turn"):
        read_study(studies.write(tmp_path, text))


@pytest.mark.parametrize("table", ["arm", "joint", "experiment"])
def test_a_study_needs_its_tables(table: str, tmp_path: Path) -> None:
    remaining = [
        part for part in studies.STUDY.split("\n\n") if not part.lstrip("[").startswith(table)
    ]
    with pytest.raises(InvalidInput, match=f"there is no .*{table}"):
        read_study(studies.write(tmp_path, "\n\n".join(remaining)))


def test_a_third_joint_is_rejected(tmp_path: Path) -> None:
    text = studies.STUDY + '\n[[joint]]\nspring = "rigid"\ngear_ratio = 0.01\n'
    with pytest.raises(InvalidInput, match=r"there are 3"):
        read_study(studies.write(tmp_path, text))


def test_unreadable_files_are_rejected(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_bytes(b"")
    with pytest.raises(InvalidInput, match=r"does not exist.*mean 'study.toml'"):
        read_study(tmp_path / "stady.toml")
    with pytest.raises(InvalidInput, match="is a directory"):
        read_study(tmp_path)
    (tmp_path / "study.toml").write_bytes(b"[arm]\nkind = '\xff'\n")
    with pytest.raises(InvalidInput, match=r"line 2: is not UTF-8: byte 0xff"):
        read_study(tmp_path / "study.toml")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads anything")
def test_a_file_without_read_permission_is_rejected(tmp_path: Path) -> None:
    path = studies.write(tmp_path)
    path.chmod(0)
    with pytest.raises(InvalidInput, match="Permission denied"):
        read_study(path)


names = st.text(
    st.characters(codec="utf-8", categories=("L", "N", "P", "Zs")), min_size=1, max_size=12
).filter(lambda name: "TODO" not in name)  # which stands for a value that is missing
sizes = st.floats(0.01, 1.0)
joint = st.builds(
    Joint,
    spring=st.sampled_from(["linear", "three-slope", "rigid"]),
    gear_ratio=sizes,
    torque_per_volt=st.none() | sizes,
    current_loop_hz=st.none() | st.floats(10.0, 1e4),
    encoder_counts=st.none() | st.floats(100.0, 1e5),
    accelerometer_distance=st.none() | sizes,
    gyro_hz=st.none() | st.floats(1.0, 100.0),
    effects=st.sampled_from([(), ("stribeck",)]),
)
experiment = st.builds(
    Experiment,
    name=names,
    file=names,
    use=st.sampled_from(["motion", "frequency", "sweep", "tuning", "check"]),
    control=st.tuples(st.sampled_from(["open", "servo"]), st.sampled_from(["open", "servo"])),
    joint=st.none() | st.integers(1, 2),
    prbs=st.none() | st.builds(Prbs, st.integers(2, 20), sizes, st.integers(1, 9), sizes),
    start=st.none() | st.floats(0.0, 1.0),
    stop=st.none() | st.floats(2.0, 3.0),
    add=st.dictionaries(st.sampled_from(["u1", "torque2"]), names, max_size=2),
)
servo = st.builds(
    Servo,
    st.just("pi-velocity"),
    st.floats(1e-4, 0.1),
    st.tuples(sizes, sizes),
    st.tuples(sizes, sizes),
    sizes,
)
whole = st.builds(
    Study,
    path=st.just(Path("study.toml")),
    sha256=st.just(""),
    arm=st.builds(
        planar_two_link,
        st.tuples(joint, joint),
        sizes,
        st.none() | st.floats(0.0, 20.0),
        st.none() | servo,
    ),
    experiments=st.lists(experiment, min_size=1, max_size=3, unique_by=lambda e: e.name).map(tuple),
    channels=st.dictionaries(
        st.sampled_from(["t", "u1", "theta_m2"]),
        st.builds(Channel, names, sizes, sizes),
        max_size=3,
    ),
)


@given(study=whole)
def test_written_studies_read_back_equal(
    study: Study, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("study") / "study.toml"
    write_study(study, path)
    back = read_study(path, logs_exist=False)
    assert dataclasses.replace(back, path=study.path, sha256="") == study


def test_all_studies_of_the_measured_data_are_read(shared_data: Path) -> None:
    paths = sorted(shared_data.glob("*/*/study.toml"))
    assert len(paths) >= 6
    for path in paths:
        assert read_study(path).experiments


def test_a_path_of_windows_is_compared_by_its_last_part(tmp_path: Path) -> None:
    path = studies.write(tmp_path)
    text = path.read_text().replace('"motion.csv"', r"'C:\logs\motoin.csv'")
    path.write_text(text)
    with pytest.raises(InvalidInput, match=r"does not exist.*did you mean 'motion.csv'"):
        read_study(path)
