from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.families.servos import STEP, ServoRig, draw_servo, simulate, study_text, true_values

from strainwave.io.study import read_study

pytest.importorskip("mujoco")

GRAVITY = 9.81
COUNT = 2.0 * np.pi / 4096


def standing(rig: ServoRig, angles: list[float], *, payload: bool = False) -> np.ndarray:
    """Angles at which the joints come to rest under constant goals."""
    goal = np.tile(angles, (round(0.5 / rig.goal_time), 1))
    return np.asarray(simulate(rig, goal, payload=payload)[-1])


@pytest.mark.parametrize("seed", [0, 4, 8, 12, 28])
def test_a_servo_at_rest_balances_gravity_within_friction(seed: int) -> None:
    """kp (goal - q) = G cos(q), but for Coulomb friction and counts; gears and joints of all kinds.

    Friction of the gear's load is at most its share of the load, MuJoCo's own creep below 1 %.
    """
    rig = draw_servo(seed)
    goal = [0.3, -0.5][: len(rig.links)]
    angle = standing(rig, goal)
    values = true_values(rig)
    torques = [values[f"gravity_torque_{i}", None] for i in range(1, len(goal) + 1)]
    shares = np.array(torques) * np.cos(np.cumsum(angle))
    loads = np.cumsum(shares[::-1])[::-1]
    for drive, load, wanted, q in zip(rig.drives, loads, goal, angle, strict=True):
        rest = drive.kp * (wanted - q) - load
        slack = drive.coulomb + drive.load_friction * abs(load) + drive.kp * COUNT
        slack += abs(load) * drive.backlash
        assert abs(rest) < 1.02 * slack


def test_a_payload_adds_its_weight() -> None:
    rig = replace(draw_servo(1), drives=(replace(draw_servo(1).drives[0], coulomb=0.0),))
    mass, x = rig.payload
    kp = rig.drives[0].kp
    free, loaded = (standing(rig, [0.2], payload=payload)[0] for payload in (False, True))
    weight = true_values(rig)["gravity_torque_1", None]
    expected = (weight + GRAVITY * mass * x) * math.cos(loaded) - weight * math.cos(free)
    assert kp * (free - loaded) == pytest.approx(expected, abs=1.5 * kp * COUNT)


def test_equal_delays_give_the_same_record() -> None:
    rig = replace(draw_servo(2), is_held=True)
    low, high = rig.equal_delays
    assert low < rig.delay <= high
    assert high - low >= STEP
    goal = 0.2 * np.sin(np.arange(200.0) / 5.0)[:, None]
    same, other = replace(rig, delay=high), replace(rig, delay=high + STEP)
    record = simulate(rig, goal)
    np.testing.assert_array_equal(simulate(same, goal), record)
    assert np.any(simulate(other, goal) != record)


def test_seeds_determine_rigs_and_cycle_through_flavours(tmp_path: Path) -> None:
    assert draw_servo(5) == draw_servo(5)
    rigs = [draw_servo(seed) for seed in range(96)]
    for key in ("flavour", "output", "gear", "joints", "motion"):
        counts = {rig.classes[key] for rig in rigs}
        assert len(counts) > 1
    for name in ("multisine", "loaded"):
        (tmp_path / f"{name}.csv").touch()
    for rig in rigs:
        path = tmp_path / "study.toml"
        path.write_text(study_text(rig, ("multisine", "loaded")))
        servo = read_study(path).arm.position_servo
        assert servo is not None
        if rig.states_scale and rig.output != "duty":
            assert servo.gain(1) == pytest.approx(rig.drives[0].kp, rel=1e-5)
        if rig.states_scale and rig.output == "duty":
            assert servo.torque_limit(1) == pytest.approx(rig.drives[0].limit, rel=1e-5)
            assert servo.back_emf_damping(1) == pytest.approx(rig.drives[0].back_emf, rel=1e-5)
