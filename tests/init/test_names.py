"""Names, units and sides of the columns of robot systems, and what their numbers decide."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from command_line import run_here
from strainwave.domain import FloatArray
from strainwave.init import start_study
from strainwave.init.names import UNITS, Quantity, names_accelerometer, parse
from strainwave.init.signal_features import sign_bit
from strainwave.io.logs import write_log
from strainwave.io.logs.tables import LogTable

DEG, TURN, RPM = np.pi / 180.0, 2.0 * np.pi, np.pi / 30.0
OPEN = None  # a scale that a data sheet gives

# name -> quantity, joint, scale of the unit ("" without a unit), side
NAMES: Mapping[str, tuple[str | None, int | None, float | str | None, str | None]] = {
    "q1": ("angle", 1, "", None),
    "A1_pos": ("angle", 1, "", None),
    "Joint 1 Angle": ("angle", 1, "", None),
    "1_position": ("angle", 1, "", None),
    "axis_2.pos": ("angle", 2, "", None),
    "pos[0]": ("angle", 0, "", None),
    "theta1_ddot": ("second_derivative", 1, "", None),
    "dtheta1": ("velocity", 1, "", None),
    "q1dot": ("velocity", 1, "", None),
    "q̇1": ("velocity", 1, "", None),
    "d2q1": ("second_derivative", 1, "", None),
    "qddot_3": ("second_derivative", 3, "", None),
    "q_dot_dot": ("second_derivative", None, "", None),
    "joint_acceleration": ("second_derivative", None, "", None),
    "acc1 [rad/s^2]": ("second_derivative", 1, 1.0, None),
    "acc1 [m/s²]": ("acceleration", 1, 1.0, None),
    "acc [mg]": ("acceleration", None, 9.80665e-3, None),
    "link_acc": ("acceleration", None, "", "link"),
    "imu1_acc_z": ("acceleration", 1, "", None),
    "gyr1 [deg/s]": ("gyro", 1, DEG, None),
    "motor_angle_1_rad": ("angle", 1, 1.0, "motor"),
    "Position (°)": ("angle", None, DEG, None),
    "pos_turns": ("angle", None, TURN, None),
    "enc1_counts": ("angle", 1, OPEN, None),
    "speed [U/min]": ("velocity", None, RPM, None),
    "vel_deg_s": ("velocity", None, DEG, None),
    "vel [0.1 rpm]": ("velocity", None, 0.1 * RPM, None),
    "torque(kgf·cm)": ("torque", None, 0.0980665, None),
    "torque [oz-in]": ("torque", None, 0.00706155181422604, None),
    "Torque [lbf-in]": ("torque", None, 0.1129848290276167, None),
    "torque_mNm": ("torque", None, 1e-3, None),
    "force [kN]": ("torque", None, 1e3, None),
    "torque [%]": ("torque", None, OPEN, None),
    "torque [‰]": ("torque", None, OPEN, None),
    "effort [A]": ("current", None, OPEN, None),
    "cur1 (mA)": ("current", 1, OPEN, None),
    "i1_A": ("current", 1, OPEN, None),
    "u1_mV": ("voltage", 1, 1e-3, None),
    "Winkelgeschwindigkeit": ("velocity", None, "", None),
    "Winkelbeschleunigung": ("second_derivative", None, "", None),
    "Istposition Achse 2 [Grad]": ("angle", 2, DEG, None),
    "Sollwinkel_1": ("reference", 1, "", None),
    "Motordrehmoment": ("torque", None, "", "motor"),
    "Schleppfehler_1": (None, None, "", None),
    "vitesse_articulation_1": ("velocity", 1, "", None),
    "Couple mesuré 1 [N.m]": ("torque", 1, 1.0, None),
    "angolo_giunto_2": ("angle", 2, "", None),
    "Velocità [giri/min]": ("velocity", None, RPM, None),
    "Posición_1": ("angle", 1, "", None),
    "par_motor_1": ("torque", 1, "", None),
    "関節1角度": ("angle", 1, "", None),
    "角速度[rad/s]": ("velocity", None, 1.0, None),
    "角加速度": ("second_derivative", None, "", None),
    "トルク[Nm]": ("torque", None, 1.0, None),
    "目標角度1": ("reference", 1, "", None),
    "关节1位置": ("angle", 1, "", None),
    "实际力矩_1": ("torque", 1, "", None),
    "电机电流": ("current", None, "", "motor"),
    "tau_J[2]": ("torque", 2, "", None),
    "tau_ext_hat_filtered[0]": (None, None, "", None),
    "ExternalTorque_1": (None, None, "", None),
    "dtau_J[0]": (None, None, "", None),
    "q_d[1]": ("reference", 1, "", None),
    "actual_qd_0": ("velocity", 0, "", None),
    "target_moment_0": ("torque", 0, "", None),
    "current_position": ("angle", None, "", None),
    "joint_current_1": ("current", 1, "", None),
    "0x6064": ("angle", None, "", None),
    "0x607A:00": ("reference", None, "", None),
    "present_voltage": (None, None, "", None),
    "d_current": (None, None, "", None),
    "motor temp 1 [degC]": ("temperature", 1, 1.0, "motor"),
    "status_1": (None, None, "", None),
}


@pytest.mark.parametrize("name", NAMES)
def test_names_state_quantity_joint_unit_and_side(name: str) -> None:
    each = parse(name)
    scale = "" if each.measure is None else each.measure.scale
    quantity, number, wanted, side = NAMES[name]
    assert (each.quantity, each.number, each.side) == (quantity, number, side)
    assert scale == (wanted if wanted in ("", None) else pytest.approx(wanted))
    if wanted is None:
        assert each.measure is not None
        assert each.measure.todo  # the formula of the scale


def test_a_units_row_precedes_the_word() -> None:
    assert parse("position", (), "°").scale_or(None) == pytest.approx(DEG)
    assert parse("effort", (), "A").quantity == "current"
    unknown = parse("torque", (), "foo/bar").measure
    assert unknown is not None
    assert unknown.scale is None
    assert "foo/bar" in unknown.todo


# --- logs of robot systems --------------------------------------------------------------------

INERTIA, VISCOUS, COULOMB = 0.02, 0.05, 0.12


def truth(seed: int = 1, amplitude: float = 1.0) -> dict[str, FloatArray]:
    """Time, angle, velocity, acceleration and torque of a rigid joint, in SI units."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 10.0, 0.005)
    q, v, a = np.zeros((3, len(t)))
    for hz, size in ((0.11, 0.6), (0.3, 0.25), (0.52, 0.15)):
        w, phase = 2.0 * np.pi * hz, rng.uniform(0.0, 6.0)
        q += amplitude * size * np.sin(w * t + phase)
        v += amplitude * size * w * np.cos(w * t + phase)
        a -= amplitude * size * w * w * np.sin(w * t + phase)
    tau = INERTIA * a + VISCOUS * v + COULOMB * np.sign(v) + 1e-3 * rng.normal(size=len(t))
    return {"t": t, "q": q, "v": v, "a": a, "tau": tau}


Expected = Mapping[str, tuple[str, float | None]]
Columns = Callable[[dict[str, FloatArray]], dict[str, FloatArray]]
# columns of a log of the system, and channel -> column, scale
SYSTEMS: Mapping[str, tuple[Columns, Expected]] = {
    "ROS joint states": (
        lambda c: {
            "time": c["t"],
            "/joint_states/elbow_joint/position": c["q"],
            "/joint_states/elbow_joint/velocity": c["v"],
            "/joint_states/elbow_joint/effort": c["tau"],
        },
        {
            "theta_m1": ("/joint_states/elbow_joint/position", 1.0),
            "omega_m1": ("/joint_states/elbow_joint/velocity", 1.0),
            "torque1": ("/joint_states/elbow_joint/effort", 1.0),
        },
    ),
    "UR RTDE": (
        lambda c: {
            "timestamp": c["t"],
            "target_q_0": c["q"],
            "target_moment_0": c["tau"],
            "actual_q_0": c["q"] + 1e-4,
            "actual_qd_0": c["v"],
            "actual_current_0": c["tau"] / 12.7,
            "actual_robot_voltage": 48.0 + 0.01 * c["v"],
        },
        {
            "theta_m1": ("actual_q_0", 1.0),
            "omega_m1": ("actual_qd_0", 1.0),
            "torque1": ("actual_current_0", OPEN),
        },
    ),
    "libfranka": (
        lambda c: {
            "time": c["t"],
            "q[0]": c["q"],
            "q_d[0]": c["q"] + 1e-4,
            "dq[0]": c["v"],
            "tau_J[0]": c["tau"],
            "tau_J_d[0]": 0.9 * c["tau"],
            "tau_ext_hat_filtered[0]": 0.1 * c["tau"],
        },
        {"theta_m1": ("q[0]", 1.0), "omega_m1": ("dq[0]", 1.0), "torque1": ("tau_J[0]", 1.0)},
    ),
    "KUKA FRI": (
        lambda c: {
            "time": c["t"],
            "MeasuredJointPosition_1": c["q"],
            "CommandedJointPosition_1": c["q"] + 1e-3,
            "MeasuredTorque_1": c["tau"],
            "ExternalTorque_1": 0.1 * c["tau"],
        },
        {"theta_m1": ("MeasuredJointPosition_1", 1.0), "torque1": ("MeasuredTorque_1", 1.0)},
    ),
    "TwinCAT": (
        lambda c: {
            "time": c["t"],
            "Axis 1.ActPos": c["q"] / DEG,
            "Axis 1.ActVelo": c["v"] / DEG,
            "Axis 1.PosDiff": 1e-3 * c["v"],
            "Axis 1.ActTorque": c["tau"] / 1.27e-3,
        },
        {
            "theta_m1": ("Axis 1.ActPos", OPEN),
            "omega_m1": ("Axis 1.ActVelo", OPEN),
            "torque1": ("Axis 1.ActTorque", OPEN),
        },
    ),
    "DS402": (
        lambda c: {
            "time": c["t"],
            "0x6064": np.round(c["q"] / TURN * 2**17),
            "0x606C": np.round(c["v"] / TURN * 2**17),
            "0x6071": np.round(c["tau"] / 1.27e-3),
            "0x6077": np.round(c["tau"] / 1.27e-3),
        },
        {"theta_m1": ("0x6064", OPEN), "omega_m1": ("0x606C", OPEN), "torque1": ("0x6077", OPEN)},
    ),
    "objects by name": (
        lambda c: {
            "time": c["t"],
            "ActualPosition": np.round(c["q"] / TURN * 2**17),
            "ActualVelocity": np.round(c["v"] / TURN * 2**17),
            "ActualTorque": np.round(c["tau"] / 1.27e-3),
        },
        {
            "theta_m1": ("ActualPosition", OPEN),
            "omega_m1": ("ActualVelocity", OPEN),
            "torque1": ("ActualTorque", OPEN),
        },
    ),
    "Dynamixel": (
        lambda c: {
            "time": c["t"],
            "Goal_Position": np.round(c["q"] / TURN * 4096) + 2048,
            "Present_Position": np.round(c["q"] / TURN * 4096) + 2048,
            "Present_Current": np.round(c["tau"] / 0.003),
            "Present_Voltage": np.round(120.0 + c["v"]),
            "Present_Temperature": np.round(40.0 + c["t"]),
        },
        {"theta_m1": ("Present_Position", OPEN), "torque1": ("Present_Current", OPEN)},
    ),
    "Feetech": (
        lambda c: {
            "time": c["t"],
            "Present_Position": np.mod(np.round(c["q"] / TURN * 4096), 4096),
            "Present_Load": np.where(
                c["tau"] < 0.0, 1024 + np.round(-c["tau"] / 3e-3), np.round(c["tau"] / 3e-3)
            ),
        },
        {"theta_m1": ("Present_Position", OPEN), "torque1": ("Present_Load", OPEN)},
    ),
    "ODrive": (
        lambda c: {
            "time": c["t"],
            "pos_estimate": c["q"] / TURN,
            "vel_estimate": c["v"] / TURN,
            "Iq_setpoint": c["tau"] / 0.05,
            "Iq_measured": c["tau"] / 0.05,
        },
        {
            "theta_m1": ("pos_estimate", TURN),
            "omega_m1": ("vel_estimate", TURN),
            "torque1": ("Iq_measured", OPEN),
        },
    ),
    "moteus": (
        lambda c: {
            "time": c["t"],
            "position": c["q"] / TURN,
            "velocity": c["v"] / TURN,
            "torque": c["tau"],
            "q_current": c["tau"] / 0.05,
            "d_current": 0.01 * c["v"],
        },
        {
            "theta_m1": ("position", TURN),
            "omega_m1": ("velocity", TURN),
            "torque1": ("torque", 1.0),
        },
    ),
    "LeRobot without effort": (
        lambda c: {"timestamp": c["t"], "action[0]": c["q"] + 0.01, "observation.state[0]": c["q"]},
        {"theta_m1": ("observation.state[0]", 1.0), "ref1": ("action[0]", 1.0)},
    ),
    "voltage and current commanded": (
        lambda c: {"t": c["t"], "pos_rad": c["q"], "i_cmd": c["tau"] / 0.05},
        {"theta_m1": ("pos_rad", 1.0), "u1": ("i_cmd", 1.0)},
    ),
    "velocity alone": (
        lambda c: {"time": c["t"], "speed [rpm]": c["v"] / RPM, "torque [Nm]": c["tau"]},
        {"omega_m1": ("speed [rpm]", RPM), "torque1": ("torque [Nm]", 1.0)},
    ),
    "turns that only the velocity shows": (
        lambda c: {"time": c["t"], "pos": c["q"] / TURN, "vel_rad_s": c["v"], "tau": c["tau"]},
        {"theta_m1": ("pos", TURN), "omega_m1": ("vel_rad_s", 1.0), "torque1": ("tau", 1.0)},
    ),
    "degrees that only the wrap shows": (
        lambda c: {"time": c["t"], "pos": np.mod(9.0 * c["q"] / DEG, 360.0), "tau": c["tau"]},
        {"theta_m1": ("pos", DEG), "torque1": ("tau", 1.0)},
    ),
}


def drafted(folder: Path, columns: Mapping[str, FloatArray]) -> tuple[str, dict[str, object]]:
    """The text of a draft and its channels; TODO becomes None."""
    write_log(folder / "run.parquet", dict(columns))
    draft = start_study([folder / "run.parquet"], folder / "study.toml")
    text = draft.path.read_text()
    channels = tomllib.loads(re.sub(r'"?\bTODO\b"?', '"TODO"', text))["channels"]
    return text, channels


def entry(value: object) -> tuple[object, object]:
    if isinstance(value, dict):
        scale = value.get("scale", 1.0)
        return value["column"], OPEN if scale == "TODO" else scale
    return value, 1.0


@pytest.mark.parametrize("system", SYSTEMS)
def test_logs_of_robot_systems_give_si_or_a_todo(system: str, tmp_path: Path) -> None:
    columns, expected = SYSTEMS[system]
    text, channels = drafted(tmp_path, columns(truth()))
    time = channels.pop("t", None)
    assert time is None or entry(time)[1] == 1.0
    assert "TODO" not in channels.values()
    assert ('kind = "position"' in text) == (set(expected) == {"theta_m1", "ref1"})
    found = {name: entry(value) for name, value in channels.items() if name != "temperature1"}
    assert set(found) == set(expected)
    for name, (column, scale) in expected.items():
        assert found[name] == (column, scale if scale is None else pytest.approx(scale))
    sensors = [n for n, v in channels.items() if isinstance(v, dict) and "meaning" in v]
    assert sensors == (["torque1"] if system in ("libfranka", "KUKA FRI") else [])
    if "u1" in expected:  # the drive's current loop lies between command and torque
        assert "\ncurrent_loop_hz = TODO" in text
        assert "torque_per_volt = TODO" in text


@pytest.mark.parametrize("bit", [10, 11, 15])
def test_the_sign_of_a_register_is_not_its_size(bit: int) -> None:
    values = np.round(200.0 * np.sin(0.1 * np.arange(300.0)))
    magnitude = np.where(values < 0, np.abs(values) + 2**bit, values)
    complement = np.where(values < 0, values + 2.0 ** (bit + 1), values)
    assert [sign_bit(v) for v in (magnitude, complement)] == [bit, bit]
    assert [sign_bit(v) for v in (values, np.abs(values), 0.5 + magnitude)] == [None] * 3


# --- what the numbers decide ------------------------------------------------------------------


def test_accelerations_of_the_joint_are_not_sensors(tmp_path: Path) -> None:
    c = truth()
    names = ("q1", "dq1", "ddq1", "tau1"), ("theta1", "theta1_dot", "theta1_ddot", "tau1")
    for k, (q, v, a, tau) in enumerate((*names, ("pos", "vel", "a1", "torque"))):
        (tmp_path / str(k)).mkdir()
        columns = {"time": c["t"], a: c["a"], tau: c["tau"], v: c["v"], q: c["q"]}
        text, channels = drafted(tmp_path / str(k), columns)
        assert set(channels) == {"t", "theta_m1", "omega_m1", "torque1"}
        assert f'not used: "{a}": it is the derivative of' in text.replace("\n# ", " ")
    (tmp_path / "sensor").mkdir()
    sensor = {"t": c["t"], "q": c["q"], "tau": c["tau"], "a1": 0.3 * c["a"]}
    _, channels = drafted(tmp_path / "sensor", sensor)
    assert set(channels) == {"theta_m1", "torque1"}  # t and a1 are channel names
    assert "accelerometer_distance" in (tmp_path / "sensor" / "study.toml").read_text()


@pytest.mark.parametrize(
    ("word", "is_sensor"),
    [
        ("acceleration", False),
        ("beschleunigung", False),
        ("acelerometro", True),
        ("linear_acceleration", True),
        ("加速度計", True),
    ],
)
def test_words_of_accelerometers_are_data(word: str, is_sensor: bool) -> None:
    assert names_accelerometer(word) is is_sensor


def test_two_angles_of_different_motions_are_not_motor_and_link(tmp_path: Path) -> None:
    one, two = truth(1), truth(2)
    columns = {"t": one["t"], "tau": one["tau"], "pos": one["q"], "angle": two["q"]}
    text, channels = drafted(tmp_path, columns)
    assert "theta_l1" not in channels
    assert "if one is the motor's and the other the link's" in text.replace("\n# ", " ")


def test_joints_are_letters_words_or_numbers(tmp_path: Path) -> None:
    one, two = truth(1), truth(2)
    vocabularies = (
        ("qA", "qB", "tauA", "tauB"),
        ("pos_a", "pos_b", "i_a", "i_b"),
        ("left_hip_pos", "left_knee_pos", "left_hip_effort", "left_knee_effort"),
        ("Schulter Winkel", "Ellbogen Winkel", "Schulter Moment", "Ellbogen Moment"),
        ("J1.q", "J2.q", "J1.tau", "J2.tau"),
        ("肩角度", "肘角度", "肩トルク", "肘トルク"),
    )
    for k, (q1, q2, tau1, tau2) in enumerate(vocabularies):
        (tmp_path / str(k)).mkdir()
        columns = {"time": one["t"], tau2: two["tau"], q2: two["q"], tau1: one["tau"], q1: one["q"]}
        _, channels = drafted(tmp_path / str(k), columns)
        found = [entry(channels[n])[0] for n in ("theta_m1", "theta_m2", "torque1", "torque2")]
        assert found == [q1, q2, tau1, tau2]


def test_a_measured_ratio_is_not_rounded_beyond_its_error(tmp_path: Path) -> None:
    c = truth(amplitude=100.0)
    for turns, written in ((256.912, "gear_ratio = 0.00389"), (100.0, "gear_ratio = 0.01\n")):
        (tmp_path / str(turns)).mkdir()
        columns = {"t": c["t"], "motor_pos": c["q"], "link_pos": c["q"] / turns, "tau": c["tau"]}
        text, _ = drafted(tmp_path / str(turns), columns)
        assert f"\n{written}" in text


def test_sizes_beyond_any_arm_are_a_todo(tmp_path: Path) -> None:
    c = truth()
    far = {"t": c["t"], "pos": 1000.0 * c["q"], "tau": c["tau"]}
    _, channels = drafted(tmp_path, far)
    assert entry(channels["theta_m1"])[1] is OPEN
    (tmp_path / "heavy").mkdir()
    heavy = {"t": c["t"], "pos": c["q"], "tau": 1e7 * c["tau"]}
    _, channels = drafted(tmp_path / "heavy", heavy)
    assert entry(channels["torque1"])[1] is OPEN


def test_columns_without_a_meaning_are_listed_and_asked(tmp_path: Path) -> None:
    c = truth()
    columns = {"time": c["t"], "data[0]": c["a"], "data[1]": np.sin(9.0 * c["q"])}
    text, channels = drafted(tmp_path, columns)
    assert channels["theta_m1"] == "TODO"
    assert all(f'not used: "{name}"' in text for name in ("data[0]", "data[1]"))


def test_init_prints_each_channel_and_what_is_left_to_fill_in(tmp_path: Path) -> None:
    c = truth()
    columns = {"t": c["t"], "pos_deg": c["q"] / DEG, "motor current [A]": c["tau"] / 0.1}
    write_log(tmp_path / "run.csv", columns)
    out = run_here("init", tmp_path / "run.csv", "--out", tmp_path / "study.toml")
    assert out.returncode == 0
    lines = out.stdout.splitlines()
    assert lines[1].split()[:3] == ["theta_m1", "likely", "'pos_deg'"]
    assert lines[2].split()[:2] == ["torque1", "TODO"]
    keys = [re.split(r"\s+", line)[4] for line in lines if line.startswith("fill in: line ")]
    assert keys == ["gear_ratio", "torque1"]


# --- any unit ---------------------------------------------------------------------------------

WORDS: Mapping[Quantity, str] = {"angle": "position", "velocity": "velocity", "torque": "torque"}
STATED = [(quantity, word, unit) for quantity, word in WORDS.items() for unit in UNITS[quantity]]


@given(case=st.sampled_from(STATED), brackets=st.sampled_from(["{} [{}]", "{} ({})", "row"]))
def test_a_column_in_any_unit_of_the_table_drafts_back_to_si(
    tmp_path_factory: pytest.TempPathFactory, case: tuple[Quantity, str, str], brackets: str
) -> None:
    quantity, word, unit = case
    c = truth()
    scale = UNITS[quantity][unit]
    name = word if brackets == "row" else brackets.format(word, unit)
    si = {"position": c["q"], "velocity": c["v"], "torque": c["tau"]}
    columns = {"time": c["t"]}
    for other, values in si.items():
        columns[name if other == word else other] = values / scale if other == word else values
    folder = tmp_path_factory.mktemp("unit")
    if brackets == "row":
        path = folder / "run.csv"
        with_units(path, columns, {word: unit})
        return
    _, channels = drafted(folder, columns)
    channel = {"position": "theta_m1", "velocity": "omega_m1", "torque": "torque1"}[word]
    assert entry(channels[channel]) == (name, pytest.approx(scale))


def with_units(path: Path, columns: Mapping[str, FloatArray], units: Mapping[str, str]) -> None:
    """Read the columns with a units row: each name has the unit of its row."""
    table = LogTable(
        path, tuple(columns), lambda names: {n: columns[n] for n in names}, units=units
    )
    for name in columns:
        unit = parse(name, (), table.units.get(name, "")).unit
        assert (unit is None) == (name not in units)
