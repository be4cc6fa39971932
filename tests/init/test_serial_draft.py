"""Drafts of serial arms: joints by their names in a URDF, joint states, motor signals."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from command_line import run_here
from strainwave import pipeline
from strainwave.domain import ArmDescription, FloatArray, Joint, Prbs, Study
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.init import start_study
from strainwave.init.robot import Robot
from strainwave.init.signal_features import sequence_under_servo
from strainwave.io.logs import read_log, write_log
from strainwave.io.study import read_study, write_study
from strainwave.io.urdf import read_urdf
from virtual_arms import exact_motion

NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
JOINTS = tuple(f"{name}_joint" for name in NAMES)
GRAVITY = (0.0, 0.0, -9.81)
RATIO = 0.01
# viscous and Coulomb friction [N m s/rad], [N m]
FRICTION = (4.0, 6.0)
ENCODER = 2e-5  # [rad] noise of an angle

_BODY = (
    '<link name="{}"><inertial><origin xyz="0.05 0.02 0.1"/><mass value="{}"/>'
    '<inertia ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.02"/></inertial></link>'
)
_JOINT = (
    '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>'
    '<origin xyz="0.05 0.1 0.3" rpy="{} 0 0"/><axis xyz="0 0 1"/>'
    '<limit lower="-3.1" upper="3.1" velocity="3.1" effort="150"/></joint>'
)


def urdf(folder: Path, names: Sequence[str] = JOINTS, last: str = "revolute") -> Path:
    """A robot whose axes are in turn parallel and orthogonal."""
    links = ["base", *(f"link_{name}" for name in names)]
    parts = [_BODY.format(link, 6.0 / (1 + k)) for k, link in enumerate(links)]
    for k, name in enumerate(names):
        kind = last if k == len(names) - 1 else "revolute"
        parts.append(_JOINT.format(name, kind, links[k], links[k + 1], 0.5 * np.pi * (k % 2)))
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return path


def arm_of(path: Path) -> Arm:
    joints = [
        Joint(spring="rigid", gear_ratio=1.0, origin=j.origin, axis=j.axis, motion=j.motion)
        for j in read_urdf(path)
    ]
    return Arm.of(ArmDescription("serial", tuple(joints), GRAVITY))


def joint_motion(path: Path, seed: int = 1, duration: float = 20.0) -> dict[str, FloatArray]:
    """Time, and angle, velocity and torque of each joint behind its gear: q1, dq1, tau1, ..."""
    arm = arm_of(path)
    time, *motion = exact_motion(arm.n_joints, seed, duration, amplitude=0.4)
    priors = np.concatenate([joint.prior for joint in read_urdf(path)])
    viscous, coulomb = FRICTION
    torque = arm.base_regressor(*motion) @ priors
    torque += viscous * motion[1] + coulomb * np.sign(motion[1])
    rng = np.random.default_rng(seed)
    columns = {"t": time}
    for i in range(arm.n_joints):
        columns[f"q{i + 1}"] = motion[0][:, i] + ENCODER * rng.normal(size=len(time))
        columns[f"dq{i + 1}"] = motion[1][:, i]
        columns[f"tau{i + 1}"] = torque[:, i]
    return {name: values[::5] for name, values in columns.items()}


Renamed = Callable[[str, int], str]
# quantity and number from 1 -> column
VOCABULARIES: Mapping[str, Renamed] = {
    "names in a URDF": lambda quantity, k: f"{JOINTS[k - 1]}_{quantity}",
    "distinct words": lambda quantity, k: f"{quantity} {NAMES[k - 1].title()}",
    "topics in columns": lambda quantity, k: f"/joint_states/{JOINTS[k - 1]}/{quantity}",
    "numbers from 0": lambda quantity, k: f"{quantity}{k - 1}",
    "numbers from 1": lambda quantity, k: f"Joint {k} {quantity}",
}


@pytest.mark.parametrize("vocabulary", VOCABULARIES)
def test_columns_are_matched_to_joints_by_name_or_number(vocabulary: str, tmp_path: Path) -> None:
    name = VOCABULARIES[vocabulary]
    truth = joint_motion(urdf(tmp_path), duration=4.0)
    words = {"q": "position", "dq": "velocity", "tau": "effort"}
    columns = {"t": truth["t"]}
    for number in (3, 2, 1, 4, 6, 5):
        columns |= {name(word, number): truth[f"{short}{number}"] for short, word in words.items()}
    write_log(tmp_path / "run.parquet", columns)
    draft = start_study(
        [tmp_path / "run.parquet"], tmp_path / "study.toml", tmp_path / "robot.urdf"
    )
    (question,) = draft.warnings
    assert draft.n_todos == 0
    assert question.startswith("on which side of the gear is ")
    study = read_study(tmp_path / "study.toml")
    assert [(j.spring, j.gear_ratio) for j in study.arm.joints] == [("rigid", 1.0)] * 6
    log = read_log(study, study.experiments[0])
    for number in range(1, 7):
        np.testing.assert_array_equal(log.channels[f"theta_m{number}"], truth[f"q{number}"])
        np.testing.assert_array_equal(log.channels[f"omega_m{number}"], truth[f"dq{number}"])
        np.testing.assert_array_equal(log.channels[f"torque{number}"], truth[f"tau{number}"])


def write_bag(path: Path, columns: Mapping[str, FloatArray], joints: Sequence[str]) -> Path:
    """Joint states in alphabetical order, as drivers publish them, with a gripper."""
    import bags

    numbers = sorted(range(1, len(joints) + 1), key=lambda number: joints[number - 1])
    messages = []
    for k, ns in enumerate(bags.stamps(columns["t"])):
        angles = {joints[n - 1]: columns[f"q{n}"][k] for n in numbers}
        rates, efforts = ([columns[f"{short}{n}"][k] for n in numbers] for short in ("dq", "tau"))
        state = bags.joint_state(ns, angles | {"finger": 0.01}, [*rates, 0.0], [*efforts, 0.0])
        messages.append(("/ur10e/joint_states", ns, state))
    return bags.write(path, messages)


def test_joint_states_give_a_complete_study_that_identify_accepts(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    path = urdf(tmp_path)
    for seed, duration in ((1, 20.0), (2, 8.0)):
        write_bag(tmp_path / f"run-{seed}", joint_motion(path, seed, duration), JOINTS)
    process = run_here(
        *("init", "--urdf", path, tmp_path / "run-1", tmp_path / "run-2"),
        *("--out", tmp_path / "study.toml"),
    )
    assert (process.returncode, process.stderr) == (0, "")
    assert "6 joint(s), 2 record(s)" in process.stdout
    assert "0 value(s) are TODO" in process.stdout
    assert "position[finger]' is not used: no joint that moves in robot.urdf" in process.stdout
    text = (tmp_path / "study.toml").read_text()
    assert 'urdf = "robot.urdf"' in text
    assert "gravity = [0.0, 0.0, -9.81]" in text
    comments = re.findall(r"^\[\[joint\]\] +# (.*)$", text, re.MULTILINE)
    assert comments == [f"{number} {name}" for number, name in enumerate(JOINTS, start=1)]
    assert "/ur10e/joint_states has positions and efforts of the joints" in text
    study = read_study(tmp_path / "study.toml")
    assert study.channels["torque3"].column == "/ur10e/joint_states.effort[elbow_joint]"
    identified = pipeline.identify(study.path, stages=("rigid",))
    assert identified.rigid is not None
    for number in range(1, 7):
        viscous = identified.rigid.value("total_viscous_friction", number)
        coulomb = identified.rigid.value("motor_coulomb_friction", number)
        assert (viscous, coulomb) == pytest.approx(FRICTION, rel=0.02)
    assert [check.experiment for check in identified.checks] == ["run-2"]
    assert min(identified.checks[0].fit_percent.values()) > 97.0


def test_motor_angles_leave_gear_ratios_open(tmp_path: Path) -> None:
    """Motor angles exceed the limits of the joints; a prismatic joint is that of the URDF."""
    path = urdf(tmp_path, last="prismatic")
    columns = joint_motion(path, duration=4.0)
    motors = {
        n: v / RATIO if "q" in n else RATIO * v if "tau" in n else v for n, v in columns.items()
    }
    write_log(tmp_path / "run.csv", motors)
    draft = start_study([tmp_path / "run.csv"], tmp_path / "study.toml", path)
    assert (
        draft.n_todos == 5
    )  # the ratio of a prismatic joint is 1 if its signals are along the axis
    text = (tmp_path / "study.toml").read_text()
    assert 'motion = "prismatic"' in text
    assert "# [transmission]" in text
    reason = "angles exceed the limits of robot.urdf: those of motors"
    assert text.replace("\n# ", " ").count(reason) == 6


def test_joints_that_move_one_at_a_time_are_classified_by_their_own_records(tmp_path: Path) -> None:
    """The only motion of a joint is fitted, not kept for validation."""
    path = urdf(tmp_path, JOINTS[:4])
    logs = []
    for moving in (1, 2, 4):
        columns = joint_motion(path, moving, duration=4.0 + moving)
        for number in {1, 2, 3, 4} - {moving}:
            noise = ENCODER * np.random.default_rng(number).normal(size=(2, len(columns["t"])))
            columns |= {f"q{number}": 0.3 + noise[0], f"dq{number}": 10.0 * noise[1]}
        logs.append(tmp_path / f"joint-{moving}.csv")
        write_log(logs[-1], columns)
    draft = start_study(logs, tmp_path / "study.toml", path)
    assert {f"omega_m{number}" for number in (1, 2, 4)} <= set(draft.channels)
    assert draft.warnings[1:] == (
        "joint 3 (elbow_joint) stands still in all logs: record a motion of it",
    )
    assert {each.use for each in read_study(tmp_path / "study.toml").experiments} == {"motion"}


def test_the_velocity_reference_is_used_of_several_references(tmp_path: Path) -> None:
    path = urdf(tmp_path, JOINTS[:3])
    columns = joint_motion(path, duration=4.0)
    references = {}
    for k, name in enumerate(JOINTS[:3], start=1):
        velocity = columns[f"dq{k}"]
        references[f"desired.velocities {name}"] = velocity
        references[f"desired.accelerations {name}"] = np.gradient(velocity, columns["t"])
    write_log(tmp_path / "run.csv", columns | references)
    start_study([tmp_path / "run.csv"], tmp_path / "study.toml", path)
    channels = read_study(tmp_path / "study.toml").channels
    assert channels["ref2"].column == f"desired.velocities {JOINTS[1]}"
    text = (tmp_path / "study.toml").read_text()
    assert f'"desired.accelerations {JOINTS[1]}": another reference of joint 2' in text


def test_missing_torques_are_named(tmp_path: Path) -> None:
    path = urdf(tmp_path)
    columns = joint_motion(path, duration=4.0)
    del columns["tau4"]
    write_log(tmp_path / "run.csv", columns)
    draft = start_study([tmp_path / "run.csv"], tmp_path / "study.toml", path)
    assert draft.n_todos == 1
    _, warning = draft.warnings
    assert warning.startswith("no column was found for torque4, the torque [N m at the joint]")


# --- without a URDF ---------------------------------------------------------------------------


def test_sensors_of_torque_and_temperature_are_mapped(tmp_path: Path) -> None:
    columns = joint_motion(urdf(tmp_path, JOINTS[:3]), duration=4.0)
    signals = {"t": columns["t"]}
    for number in (1, 2, 3):
        signals[f"tau_model{number}"] = 0.9 * columns[f"tau{number}"]
        signals[f"tau_sensor{number}"] = columns[f"tau{number}"]
        signals[f"tau_motor{number}"] = RATIO * columns[f"tau{number}"]
        signals[f"q{number}"] = columns[f"q{number}"] / RATIO
        signals[f"motor temp {number} [degC]"] = 20.0 + 0.1 * columns["t"]
        for axis in "xyz":
            signals[f"imu{number}_acc_{axis}"] = columns[f"dq{number}"] + columns["t"]
    write_log(tmp_path / "run.csv", signals)
    start_study([tmp_path / "run.csv"], tmp_path / "study.toml")
    text = (tmp_path / "study.toml").read_text()
    for number in (1, 2, 3):
        for channel, column in (
            ("torque", "tau_motor"),
            ("tau_l", "tau_sensor"),
            ("theta_m", "q"),
        ):
            assert f'\n{channel}{number} = "{column}{number}"' in text
        assert f'\ntemperature{number} = "motor temp {number} [degC]"' in text
        assert f'\naz{number} = "imu{number}_acc_z"' in text
    assert text.count('spring = "auto"') == 3


@given(
    order=st.integers(6, 10),
    samples=st.integers(1, 4),
    periods=st.integers(2, 4),
    amplitude=st.sampled_from([0.5, 2.0, 10.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_sequence_added_to_a_servo_is_reported(
    order: int, samples: int, periods: int, amplitude: float, seed: int
) -> None:
    truth = Prbs(order, 0.001, periods, amplitude)
    values = np.repeat(excitation.prbs(truth), samples)
    rng = np.random.default_rng(seed)
    time = np.arange(len(values)) * 0.001 / samples
    servo = rng.uniform(0.0, 20.0) * np.sin(3.0 * time + rng.uniform(0.0, 6.0))
    servo += 0.01 * amplitude * rng.normal(size=len(values))
    sequence = sequence_under_servo(values + servo, 0.001 / samples)
    assert sequence is not None
    assert replace(sequence, amplitude=amplitude) == truth
    assert sequence.amplitude == pytest.approx(amplitude, rel=0.05)  # noise, and two digits
    assert sequence_under_servo(servo, 0.001 / samples) is None


# --- arms of other sources --------------------------------------------------------------------


def drafted(folder: Path, reference: Study, answers: Mapping[str, str]) -> Study:
    """The draft from the logs and the URDF of a study, with the answers to TODO by key."""
    logs = [reference.log_path(each) for each in reference.experiments]
    start_study(logs, folder / "study.toml", reference.path.parent / "arm.urdf")
    lines = (folder / "study.toml").read_text().splitlines()
    filled = [line.replace("TODO", answers.get(line.split(" = ")[0], "TODO")) for line in lines]
    (folder / "study.toml").write_text("\n".join(filled))
    return read_study(folder / "study.toml")


def test_a_measured_arm_has_no_questions_left(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data.parent / "serial" / "kinova-gen3" / "study.toml"
    if not path.exists():
        pytest.skip("no ../shared/serial beside the project")
    reference = read_study(path)
    study = drafted(tmp_path, reference, {})
    mapped = {n: c for n, c in reference.channels.items() if c.column != n}
    assert dict(study.channels) == mapped
    assert [j.gear_ratio for j in study.arm.joints] == [1.0] * 7
    assert study.arm.gravity == reference.arm.gravity


@pytest.mark.parametrize("arm", ["chain3-imu", "chain6-motor"])
def test_drafts_of_simulated_arms_agree_with_their_studies(
    shared_data: Path, tmp_path: Path, arm: str
) -> None:
    path = shared_data.parent / "serial" / arm / "study.toml"
    if not path.exists():
        pytest.skip("no ../shared/serial beside the project")
    reference = read_study(path)
    answers = {"gear_ratio": "0.01", "torque_per_volt": "0.1", "current_loop_hz": "1000.0"}
    study = drafted(tmp_path, reference, answers | {"kp": "0.1", "ki": "1.0", "limit": "10.0"})
    assert [j.spring for j in study.arm.joints] == ["auto"] * reference.arm.n_joints
    assert [j.encoder_counts for j in study.arm.joints] == [8192.0] * study.arm.n_joints
    for given_, draft in zip(reference.experiments, study.experiments, strict=True):
        assert (draft.name, draft.use, draft.joint) == (given_.name, given_.use, given_.joint)
        assert draft.control == given_.control
        if given_.prbs is not None:
            assert draft.prbs is not None
            assert (draft.prbs.order, draft.prbs.clock) == (given_.prbs.order, given_.prbs.clock)
            torque = 1.0 if "u1" in read_columns(study) else reference_gain(reference, given_.joint)
            expected = given_.prbs.amplitude * torque
            assert draft.prbs.amplitude == pytest.approx(expected, rel=0.08)


def read_columns(study: Study) -> set[str]:
    return set(read_log(study, study.experiments[0]).channels)


def reference_gain(study: Study, joint: int | None) -> float:
    gain = study.arm.joints[(joint or 1) - 1].known_torque_per_volt
    assert gain is not None
    return gain


# --- refusals ---------------------------------------------------------------------------------


def refused(folder: Path, columns: Mapping[str, FloatArray], path: Path) -> str:
    write_log(folder / "run.csv", columns)
    process = run_here("init", "--urdf", path, folder / "run.csv", "--out", folder / "study.toml")
    assert process.returncode == 2
    assert not (folder / "study.toml").exists()
    return process.stderr


def test_a_joint_without_columns_is_named(tmp_path: Path) -> None:
    path = urdf(tmp_path)
    columns = joint_motion(path, duration=4.0)
    five = {name: values for name, values in columns.items() if not name.endswith("4")}
    message = refused(tmp_path, five, path)
    assert "run.csv: no column is the angle of the joint 'wrist_1_joint'; the " in message
    assert "columns are q1, q2, q3, q5, q6" in message
    assert 'set its type to "fixed" in the URDF' in message
    names = "waist", "arm", "forearm", "roll", "pitch", "yaw"
    other = {
        re.sub(r"\d", lambda m: f"_{names[int(m[0]) - 1]}", name): values
        for name, values in columns.items()
    }
    message = refused(tmp_path, other, path)
    assert "the joint 'shoulder_pan_joint', 'shoulder_lift_joint', 'elbow_joint'" in message
    assert "the columns are q_waist, q_arm" in message


def test_an_arm_of_more_than_seven_joints_is_refused(tmp_path: Path) -> None:
    path = urdf(tmp_path, [f"joint_{k}" for k in range(1, 9)])
    with pytest.raises(InvalidInput, match=r"8 joints move .* at most 7") as error:
        Robot.read(path)
    assert "fixed" in str(error.value.remedy)


@pytest.mark.parametrize("moving", [6, 7])
def test_joints_at_the_end_that_no_log_has_are_held_at_zero(tmp_path: Path, moving: int) -> None:
    """A finger, a finger that mimics it, and a second arm are held; the study reads again."""
    names = [f"joint_{k}" for k in range(1, moving + 1)]
    path = urdf(tmp_path, names)
    columns = joint_motion(path, duration=4.0)
    last = f"link_{names[-1]}"
    ends = "".join(_BODY.format(f"link_{n}", 0.1) for n in ("left", "right", "other"))
    ends += _JOINT.format("left_finger1", "prismatic", last, "link_left", 0.0)
    mimic = '<mimic joint="left_finger1"/></joint>'
    ends += _JOINT.format("right_finger1", "prismatic", last, "link_right", 0.0)[:-8] + mimic
    ends += _JOINT.format("other_shoulder", "revolute", "base", "link_other", 0.0)
    path.write_text(path.read_text().replace("</robot>", ends + "</robot>"))
    write_log(tmp_path / "run.csv", columns | {"left_finger1_position": 0.02 + 0.0 * columns["t"]})
    start_study([tmp_path / "run.csv"], tmp_path / "study.toml", path)
    study = read_study(tmp_path / "study.toml")
    assert study.arm.n_joints == moving
    assert study.arm.urdf is not None
    assert set(study.arm.urdf.held) == {"left_finger1", "right_finger1", "other_shoulder"}
    assert '"left_finger1_position"' in (tmp_path / "study.toml").read_text()
    write_study(study, tmp_path / "again.toml")
    assert read_study(tmp_path / "again.toml").arm == study.arm


def test_angles_of_joint_states_beyond_the_limits_are_degrees(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    path = urdf(tmp_path)
    columns = joint_motion(path, duration=4.0)
    degrees = {name: np.rad2deg(v) if "q" in name else v for name, v in columns.items()}
    write_bag(tmp_path / "run", degrees, JOINTS)
    start_study([tmp_path / "run"], tmp_path / "study.toml", path)
    channels = read_study(tmp_path / "study.toml").channels
    assert {channels[f"theta_m{k}"].scale for k in range(1, 7)} == {np.pi / 180.0}
    assert {channels[f"omega_m{k}"].scale for k in range(1, 7)} == {np.pi / 180.0}


# --- names ------------------------------------------------------------------------------------


def robot_of(*names: str) -> Robot:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        return Robot.read(urdf(Path(folder), names))


def test_names_contain_joints() -> None:
    robot = robot_of(*(f"left_{name}" for name in JOINTS))
    both = [f"{side}_{name}" for side in ("left", "right") for name in JOINTS]
    numbers = {name: number for name, (number, _) in robot.named_joints(both).items()}
    assert numbers == {f"left_{name}": k for k, name in enumerate(JOINTS, start=1)}
    short = robot.named_joints(["wrist_1_pos", "elbow", "pos1"])
    assert {name: number for name, (number, _) in short.items()} == {"wrist_1_pos": 4, "elbow": 3}


def test_numbered_joints_keep_their_numbers() -> None:
    robot = robot_of("panda_joint2", "panda_joint3")
    assert [robot.number_of(number) for number in (1, 2, 3, None)] == [None, 1, 2, None]
    from_zero = robot_of("joint_0", "joint_1")
    assert [from_zero.number_of(number) for number in (1, 2, 3)] == [1, 2, None]
    assert robot_of("rail").number_of(None) == 1
    assert [robot_of("x", "y").number_of(number) for number in (1, 2, 3)] == [1, 2, None]
