"""Drafts from logs of position servos: commanded and measured angles, no torque."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from strainwave.domain import FloatArray
from strainwave.init import StudyDraft, start_study
from strainwave.io.study import read_study

DEGREE, TURN = np.pi / 180.0, 2.0 * np.pi
COUNT = TURN / 4096
TIME: FloatArray = 0.005 * np.arange(4000, dtype=np.float64)


def signals(size: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Commanded and measured angles [rad] of a servo of 12 bits that follows late and too far."""
    waves = [np.sin(w * TIME + w) for w in (0.9, 2.3, 7.0)]
    goal: FloatArray = 0.5 * size * np.sum(waves, axis=0)
    late = np.interp(TIME - 0.04, TIME, goal)
    return goal, np.asarray(COUNT * np.round((1.1 * late - 0.02) / COUNT))


def draft(folder: Path, columns: dict[str, FloatArray], name: str = "log.csv") -> StudyDraft:
    rows = np.column_stack(list(columns.values()))
    head = ",".join(columns)
    np.savetxt(folder / name, rows, fmt="%.9g", delimiter=",", header=head, comments="")
    return start_study([folder / name], folder / "study.toml")


def scales(draft: StudyDraft) -> dict[str, tuple[str, float | None]]:
    return {g.channel: (g.column, g.scale and round(g.scale, 9)) for g in draft.guesses}


@pytest.mark.parametrize(
    ("command", "measured"),
    [
        ("goal_position", "present_position"),
        ("des_pos", "dof_pos"),
        ("ref", "q"),
        ("q_des", "q"),
        ("target_position", "actual_position"),
        ("cmd_pos", "pos"),
        ("command_position", "position"),
        ("reference.positions[0]", "feedback.positions[0]"),
        ("action", "observation.state"),
    ],
)
def test_commanded_and_measured_angles_draft_a_position_servo(
    tmp_path: Path, command: str, measured: str
) -> None:
    goal, angle = signals()
    result = draft(tmp_path, {"time": TIME, command: goal, measured: angle})
    assert scales(result) == {"theta_m1": (measured, 1.0), "ref1": (command, 1.0)}
    assert result.n_todos == 0
    arm = read_study(tmp_path / "study.toml").arm
    assert arm.servo is None
    assert arm.position_servo is not None
    assert arm.position_servo.kp == arm.position_servo.kd == ("unknown",)
    assert arm.position_servo.delay == "unknown"
    joint = arm.joints[0]
    assert (joint.spring, joint.gear_ratio, joint.encoder_counts) == ("rigid", 1.0, 4096)
    assert any("kp" in warning and "weight" in warning for warning in result.warnings)


@pytest.mark.parametrize(
    ("names", "unit", "offset"),
    [
        (("goal_position", "present_position"), COUNT, 2048.0),
        (("goal_position", "present_position"), DEGREE, 0.0),
        (("command_position", "position"), TURN, 0.0),
    ],
    ids=["registers", "degrees", "turns"],
)
def test_steps_of_an_encoder_show_the_unit(
    tmp_path: Path, names: tuple[str, str], unit: float, offset: float
) -> None:
    goal, angle = (x / unit + offset for x in signals())
    if offset:
        goal, angle = np.round(goal), np.round(angle)
    result = draft(tmp_path, {"time": TIME, names[0]: goal, names[1]: angle})
    assert result.n_todos == 0
    assert {scale for _, scale in scales(result).values()} == {round(unit, 9)}


def test_lists_of_lerobot(tmp_path: Path) -> None:
    """Degrees are known by the steps of the encoder; a normalised range is asked for."""
    for name, unit in (("degrees", DEGREE), ("range", 1.7 / 100.0)):
        goals, angles = zip(*(signals(size) for size in (1.0, 0.8, 0.6)), strict=True)
        lists = {
            key: pa.array((np.column_stack(x) / unit).tolist(), pa.list_(pa.float32()))
            for key, x in (("action", goals), ("observation.state", angles))
        }
        path = tmp_path / f"{name}.parquet"
        pq.write_table(pa.table({**lists, "timestamp": TIME.astype(np.float32)}), path)
        result = start_study([path], tmp_path / f"{name}.toml")
        columns = scales(result)
        assert columns.keys() == {f"{c}{i}" for c in ("theta_m", "ref") for i in (1, 2, 3)}
        assert columns["ref3"][0] == "action[2]"
        if name == "degrees":
            assert {scale for _, scale in columns.values()} == {round(DEGREE, 9)}
        else:
            assert {scale for _, scale in columns.values()} == {None}
            todo = next(g.todo for g in result.guesses if g.channel == "theta_m1")
            assert "calibrated range" in todo
            assert "0.017 if an encoder of 4096" in todo


def test_short_registers_and_wide_angles_are_asked_for(tmp_path: Path) -> None:
    goal, angle = (np.round(x / COUNT / 4.0 + 512.0) for x in signals())
    result = draft(tmp_path, {"time": TIME, "goal_position": goal, "present_position": angle})
    assert {scale for _, scale in scales(result).values()} == {None}
    rng = np.random.default_rng(1)
    goal, angle = (x / DEGREE + 1e-4 * rng.normal(size=len(x)) for x in signals())
    (tmp_path / "study.toml").unlink()
    result = draft(tmp_path, {"time": TIME, "q_des": goal, "q": angle})
    assert {scale for _, scale in scales(result).values()} == {None}


def test_a_torque_or_a_velocity_reference_is_no_position_servo(tmp_path: Path) -> None:
    goal, angle = signals()
    for k, more in enumerate(({"tau": np.gradient(goal)}, {"link_position": 0.9 * angle})):
        path = tmp_path / str(k)
        path.mkdir()
        draft(path, {"time": TIME, "q_des": goal, "q": angle, **more})
        assert "[servo]\nkind" not in (path / "study.toml").read_text()
    path = tmp_path / "velocity"
    path.mkdir()
    draft(path, {"time": TIME, "vel_des": np.gradient(angle, TIME), "pos": angle})
    assert "[servo]\nkind" not in (path / "study.toml").read_text()
