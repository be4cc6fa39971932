from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import studies
import virtual_arms
from strainwave import pipeline
from strainwave.domain import FloatArray, Log
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_logs, write_log
from strainwave.io.study import read_study, write_study

pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
import bags


def read(folder: Path, file: str, channels: str = bags.CHANNELS, window: str = "") -> Log:
    text = studies.STUDY.replace("motion.csv", file) + channels
    text = text.replace('use = "motion"\n', f'use = "motion"\n{window}', 1)
    study = read_study(studies.write(folder, text))
    return read_logs(study, study.experiments[:1])[0]


def ticks(period: float, samples: int) -> FloatArray:
    return period * np.arange(samples, dtype=np.float64)


def signals(time: FloatArray) -> dict[str, FloatArray]:
    return {
        "t": time,
        "u1": np.sign(np.sin(300.0 * time)),
        "u2": np.cos(7.0 * time),
        "theta_m1": np.sin(20.0 * time),
        "theta_m2": np.cos(20.0 * time),
        "a1": np.sin(30.0 * time),
    }


def expect(log: Log) -> None:
    for name, values in studies.columns().items():
        actual = log.time if name == "t" else log.channels[name]
        np.testing.assert_allclose(actual, values, rtol=0.0, atol=1e-12)
    # the commands have no header stamp, and the recorder has no delay
    assert [w.code for w in log.warnings] == ["recorder-stamps"]


def test_reads_both_storages_as_directory_and_as_file(tmp_path: Path) -> None:
    messages = bags.of_columns(studies.columns())
    for storage, suffix in (("MCAP", "mcap"), ("SQLITE3", "db3")):
        bags.write(tmp_path / storage, messages, storage)
        expect(read(tmp_path, storage))
        if suffix == "mcap":  # a .db3 of this version stores its connections in metadata.yaml
            shutil.copy(tmp_path / storage / f"{storage}.{suffix}", tmp_path / f"single.{suffix}")
            expect(read(tmp_path, f"single.{suffix}"))


def test_reads_a_ros1_bag(tmp_path: Path) -> None:
    time = ticks(0.001, 40)
    channels = "\n[channels]\n" + "".join(
        f'{channel} = {{ topic = "/js", field = "{field}", name = "{name}" }}\n'
        for channel, field, name in (
            ("theta_m1", "position", "a"),
            ("theta_m2", "position", "b"),
            ("u1", "effort", "a"),
            ("u2", "effort", "b"),
        )
    )
    bags.write_ros1(
        tmp_path / "run.bag",
        [
            ("/js", ns, bags.joint_state(ns, {"a": t, "b": -t}, (), (t**2, 1.0), bags.STORE1))
            for ns, t in zip(bags.stamps(time), time, strict=True)
        ],
    )
    log = read(tmp_path, "run.bag", channels)
    np.testing.assert_allclose(log.channels["u1"], time**2, atol=1e-15)
    assert not log.warnings  # every message has a header stamp


def test_the_rigid_step_gives_equal_results_for_a_bag_and_a_csv(tmp_path: Path) -> None:
    study = virtual_arms.rigid_two_link()
    log = virtual_arms.motion_log(study, virtual_arms.values_of(study, 1), 1, duration=6.0)
    columns = {"t": log.time, **log.channels, "a1": np.zeros(len(log))}
    experiment = virtual_arms.MOTION
    study = replace(study, path=tmp_path / "study.toml", experiments=(experiment,), channels={})
    write_log(tmp_path / "motion.csv", {name: columns[name] for name in ("t", *log.channels)})
    write_study(study, study.path)
    from_csv = pipeline.identify(study.path, stages=("rigid",))
    bags.write(tmp_path / "run", bags.of_columns(columns))
    text = study.path.read_text().replace("motion.csv", "run") + bags.CHANNELS
    study.path.write_text("".join(x for x in text.splitlines(True) if not x.startswith("a1")))
    from_bag = pipeline.identify(study.path, stages=("rigid",))
    assert from_bag.rigid is not None
    assert from_csv.rigid is not None
    for bag_parameter, csv_parameter in zip(
        from_bag.rigid.parameters, from_csv.rigid.parameters, strict=True
    ):
        assert bag_parameter.value is not None
        # rounding: positions are divided by 100 and multiplied by 100
        assert bag_parameter.value == pytest.approx(csv_parameter.value, rel=1e-6, abs=1e-9)
        assert bag_parameter.std == pytest.approx(csv_parameter.std, rel=1e-4)


# --- time -------------------------------------------------------------------------------------


def test_topics_are_resampled_to_the_time_stamps_of_the_motor_angle(tmp_path: Path) -> None:
    fast, slow = ticks(0.001, 400), 0.0003 + ticks(0.004, 99)
    messages = [m for m in bags.of_columns(signals(fast)) if m[0] != "/imu1"]
    messages += [
        ("/imu1", ns, bags.imu(ns, np.sin(30.0 * t)))
        for ns, t in zip(bags.stamps(slow), slow, strict=True)
    ]
    bags.write(tmp_path / "run", sorted(messages, key=lambda m: m[1]))
    log = read(tmp_path, "run")
    assert log.sample_time == pytest.approx(0.001)
    # the time span that all topics cover
    assert log.time[[0, -1]] == pytest.approx([0.001, 0.392])
    # a 5 Hz sine at 250 Hz: monotone cubics are of second order at its extrema
    np.testing.assert_allclose(log.channels["a1"], np.sin(30.0 * log.time), atol=5e-3)
    np.testing.assert_allclose(log.channels["theta_m1"], 100.0 * np.sin(20 * log.time) / 100.0)
    warnings = {w.code: w.message for w in log.warnings}
    # the stamps of /cmd include those of the motor angle
    assert "/cmd" not in warnings["resampled"]
    assert (
        "/imu1 (250 Hz): resampled to the time stamps of /joint_states (1000 Hz)"
        in warnings["resampled"]
    )


def test_commands_are_held_and_a_silent_one_is_reported(tmp_path: Path) -> None:
    time = ticks(0.001, 400)
    messages = [m for m in bags.of_columns(signals(time)) if m[0] != "/cmd"]
    command_times = np.array([*ticks(0.002, 50), 0.3])
    messages += [
        ("/cmd", ns, bags.floats([k, -k]))
        for k, ns in enumerate(bags.stamps(command_times + 0.0004))
    ]
    bags.write(tmp_path / "run", sorted(messages, key=lambda m: m[1]))
    log = read(tmp_path, "run")
    expected = np.searchsorted(command_times + 0.0004, log.time, side="right") - 1
    np.testing.assert_array_equal(log.channels["u1"], expected)
    warnings = [w.message for w in log.warnings if w.code == "silent-command"]
    assert len(warnings) == 1
    assert "/cmd sends nothing from 0.0984 to 0.3004 s" in warnings[0]


def test_a_window_includes_the_last_command_before_it(tmp_path: Path) -> None:
    time = ticks(0.001, 400)
    messages = [m for m in bags.of_columns(signals(time)) if m[0] != "/cmd"]
    messages += [("/cmd", ns, bags.floats([ns - bags.START, 0])) for ns in bags.stamps(time[::50])]
    bags.write(tmp_path / "run", sorted(messages, key=lambda m: m[1]))
    log = read(tmp_path, "run", window="start = 0.12\nstop = 0.23\n")
    assert (log.time[0], log.time[-1]) == (pytest.approx(0.12), pytest.approx(0.23))
    assert log.channels["u1"][0] == 100_000_000


def test_the_recorder_delay_is_reported_and_a_different_clock_refused(tmp_path: Path) -> None:
    for delay, name in ((0.003, "late"), (-1.7e9, "simulated")):
        delay_ns = round(delay * 1e9)
        messages = bags.of_columns(signals(ticks(0.001, 60)))
        messages = [
            (topic, ns + delay_ns if topic == "/cmd" or delay > 0 else ns, m)
            for topic, ns, m in messages
        ]
        for topic, ns, message in messages:
            if delay < 0 and topic != "/cmd":
                message.header = bags.header(ns - bags.START + 1)
        bags.write(tmp_path / name, sorted(messages, key=lambda m: m[1]))
    log = read(tmp_path, "late")
    warnings = [w.message for w in log.warnings if w.code == "recorder-stamps"]
    assert "lag by 3 ms" in warnings[0]
    with pytest.raises(InvalidInput, match=r"the clocks of headers and recorder differ.* of /cmd"):
        read(tmp_path, "simulated")


def test_recorder_stamps_replace_unset_headers(tmp_path: Path) -> None:
    messages = bags.of_columns(studies.columns())
    for _, _, message in messages:
        if hasattr(message, "header"):
            message.header = bags.header(0)
    bags.write(tmp_path / "run", messages)
    log = read(tmp_path, "run")
    np.testing.assert_allclose(log.time, studies.columns()["t"], atol=1e-9)
    assert not log.warnings


def test_a_gap_in_one_topic_splits_the_record(tmp_path: Path) -> None:
    messages = bags.of_columns(signals(ticks(0.001, 200)))
    gap = range(bags.START + 50_000_000, bags.START + 80_000_000)
    bags.write(tmp_path / "run", [m for m in messages if m[0] != "/imu1" or m[1] not in gap])
    log = read(tmp_path, "run")
    assert [w.code for w in log.warnings] == ["recorder-stamps", "split"]
    np.testing.assert_allclose(log.time, 0.001 * np.arange(50), atol=1e-9)


@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**32 - 1),
    doubled=st.lists(st.integers(0, 59), max_size=5),
    reach=st.integers(1, 20),
)
def test_the_order_of_messages_does_not_matter(
    tmp_path_factory: pytest.TempPathFactory, seed: int, doubled: list[int], reach: int
) -> None:
    folder = tmp_path_factory.mktemp("bag")
    values = signals(ticks(0.001, 60))
    messages = [m for m in bags.of_columns(values) if m[0] != "/cmd"]
    # duplicates with other values, recorded earlier: the last message counts
    repeated = [
        ("/joint_states", m[1], bags.joint_state(m[1], {"shoulder": 9.9, "elbow": 9.9}))
        for m in messages[::2]
    ]
    messages = [repeated[k] for k in doubled] + messages
    rng = np.random.default_rng(seed)
    sort_keys = np.arange(len(messages)) + reach * rng.uniform(size=len(messages))
    sort_keys[: len(doubled)] = -1.0
    order = np.argsort(sort_keys, kind="stable")
    recorded = [
        (messages[k][0], bags.START + 10**6 * n, messages[k][2]) for n, k in enumerate(order)
    ]
    recorded += [
        ("/cmd", bags.START, bags.floats([0, 0])),
        ("/cmd", bags.START + 20 * 10**6, bags.floats([1, 2])),
    ]
    # header and recorder stamps differ by less than a second
    bags.write(folder / "run", sorted(recorded, key=lambda m: m[1]))
    log = read(folder, "run")
    np.testing.assert_allclose(log.channels["theta_m1"], values["theta_m1"], atol=1e-12)
    np.testing.assert_allclose(log.channels["a1"], values["a1"], atol=1e-12)
    warnings = " ".join(w.message for w in log.warnings if w.code == "reordered")
    assert "/joint_states" in warnings or not doubled


def test_joints_that_several_nodes_publish_are_separated(tmp_path: Path) -> None:
    """Half of the messages contain only one joint; the order of joints varies."""
    time = ticks(0.001, 120)
    messages: list[bags.Message] = []
    for k, (ns, t) in enumerate(zip(bags.stamps(time), time, strict=True)):
        both = {"elbow": -t, "shoulder": t} if k % 3 else {"shoulder": t, "elbow": -t}
        published = both if k % 2 else {"shoulder": t}
        messages += [("/joint_states", ns, bags.joint_state(ns, published))]
        messages += [("/cmd", ns, bags.floats([np.sin(99 * t), 0.0]))]
        messages += [("/imu1", ns, bags.imu(ns, t))]
    bags.write(tmp_path / "run", messages)
    log = read(tmp_path, "run")
    np.testing.assert_allclose(log.channels["theta_m1"], 100.0 * log.time, atol=1e-9)
    np.testing.assert_allclose(log.channels["theta_m2"], -log.time, atol=1e-9)


# --- faults -----------------------------------------------------------------------------------


def line(channel: str, topic: str, field: str, name: str = "") -> str:
    named = f', name = "{name}"' if name else ""
    return f'{channel} = {{ topic = "{topic}", field = "{field}"{named} }}\n'


FAULTS = {
    "topic": (
        line("a1", "/imu", "linear_acceleration.y"),
        r"no topic '/imu', which .channels. names for 'a1'.*/imu1 \(sensor_msgs/msg/Imu, 40\)"
        r".*mean '/imu1'",
    ),
    "field": (
        line("a1", "/imu1", "acceleration.y"),
        r"no field 'acceleration.y' in the topic '/imu1'.*linear_acceleration.y",
    ),
    "joint": (
        line("a1", "/joint_states", "position", "knee"),
        r"no field 'position\[knee\]' in the topic '/joint_states'.*position\[shoulder\]",
    ),
    "empty array": (
        line("a1", "/joint_states", "effort", "elbow"),
        r"no field 'effort\[elbow\]' in the topic '/joint_states'",
    ),
    "index": (line("a1", "/cmd", "data[2]"), r"no field 'data\[2\]'.*data\[0\], data\[1\]"),
    "no field": ('a1 = { topic = "/imu1" }\n', "the key 'field' is missing"),
    "both": (
        'a1 = { topic = "/imu1", field = "x", column = "y" }\n',
        "the key 'column' is unknown",
    ),
    "time": ('t = "/imu1.header"\n', "no field 'header'"),
    "own time": (line("t", "/imu1", "linear_acceleration.y"), "contain their time stamps"),
    "nothing mapped": (
        line("torque2", "/cmd", "data[1]"),
        "no 'theta_m1', which every log must contain",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_error_states_what_the_bag_lacks(fault: str, tmp_path: Path) -> None:
    text, message = FAULTS[fault]
    bags.write(tmp_path / "run", bags.of_columns(studies.columns()))
    other_lines = [
        each
        for each in bags.CHANNELS.splitlines(True)
        if not each.startswith(text.split(" ")[0]) and fault != "nothing mapped"
    ]
    channels = "[channels]\n" if fault == "nothing mapped" else "".join(other_lines)
    with pytest.raises(InvalidInput, match=message) as error:
        read(tmp_path, "run", channels + text)
    assert error.value.remedy


def test_the_error_locates_a_value_that_is_not_a_number(tmp_path: Path) -> None:
    messages = bags.of_columns(studies.columns())
    messages[3 * 7 + 1] = ("/imu1", messages[3 * 7 + 1][1], bags.imu(messages[3 * 7][1], np.inf))
    bags.write(tmp_path / "run", messages)
    with pytest.raises(InvalidInput, match=r"run, message 8, column '/imu1.linear_acceleration.y'"):
        read(tmp_path, "run")
    read(tmp_path, "run", window="start = 0.01\n")  # the remedy works


def test_an_empty_topic_is_refused(tmp_path: Path) -> None:
    messages = [m for m in bags.of_columns(studies.columns()) if m[0] != "/imu1"]
    bags.write(tmp_path / "run", messages, silent={"/imu1": "sensor_msgs/msg/Imu"})
    with pytest.raises(InvalidInput, match="the topic '/imu1' has no messages"):
        read(tmp_path, "run")


def test_a_damaged_bag_and_another_directory_are_refused(tmp_path: Path) -> None:
    bags.write(tmp_path / "run", bags.of_columns(studies.columns()))
    data = (tmp_path / "run" / "run.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    with pytest.raises(InvalidInput, match=r"is not a bag, or is damaged.*mcap recover"):
        read(tmp_path, "cut.mcap")
    (tmp_path / "run" / "metadata.yaml").unlink()
    with pytest.raises(InvalidInput, match=r"directory without metadata.yaml.*the .mcap or .db3"):
        read(tmp_path, "run")


def test_the_command_line_prints_one_error_message(tmp_path: Path) -> None:
    bags.write(tmp_path / "run", bags.of_columns(studies.columns()))
    text = studies.STUDY.replace("motion.csv", "run") + bags.CHANNELS.replace("/imu1", "/imu7")
    path = studies.write(tmp_path, text)
    arguments = ["identify", str(path), "--out", str(tmp_path / "out")]
    process = subprocess.run(
        [sys.executable, "-m", "strainwave", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 2
    assert process.stderr.count("\n") == 1
    assert "no topic '/imu7'" in process.stderr
    assert not (tmp_path / "out").exists()


def test_a_bag_without_rosbags_gives_the_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bags.write(tmp_path / "run", bags.of_columns(studies.columns()))
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(InvalidInput, match="pip install rosbags"):
        read(tmp_path, "run")


def test_a_study_of_a_bag_reads_back_equal(tmp_path: Path) -> None:
    study = read_study(studies.write(tmp_path, studies.STUDY + bags.CHANNELS))
    write_study(study, study.path)
    assert read_study(study.path).channels == study.channels
    assert study.channels["u1"].column == "/cmd.data[0]"
    assert json.dumps(study.channels["theta_m1"].scale) == "100.0"
