"""Linear starts of servo fits: gains of further joints, and motions at the torque limits."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.domain import Joint, PositionServo
from strainwave.domain.arm.description import UNKNOWN
from strainwave.domain.arm.kinds import planar_two_link
from strainwave.domain.keys import FloatArray, Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.position_servo.loop import ServoLoop
from strainwave.identification.position_servo.records import ReferenceHold, Segment, ServoRecord
from strainwave.identification.position_servo.start import linear_starts

PERIOD, SAMPLE_TIME = 0.002, 0.004
KP = (12.0, 1.5)
BODY: dict[Key, float] = {
    ("rigid_inertia", 1): 0.012,
    ("motor_inertia", 2): 0.0003,
    ("beta", None): 0.0008,
    ("gamma", None): 0.0015,
    ("gravity_torque_1", None): 0.5,
    ("gravity_torque_2", None): 0.08,
}


def two_joints(limits: tuple[float, float]) -> tuple[ServoLoop, ServoRecord]:
    """A simulated record of two servos whose gains are not known."""
    joint = Joint("rigid", 1.0, encoder_counts=4096.0, effects=())
    servo = PositionServo("position", PERIOD, (UNKNOWN, UNKNOWN), (UNKNOWN, UNKNOWN))
    arm = Arm.of(planar_two_link((joint, joint), 0.2, gravity=9.81))
    loop = ServoLoop(arm, servo, ReferenceHold.HELD)
    values: Values = dict(BODY)
    for i, kp in enumerate(KP, start=1):
        values |= {
            ("motor_coulomb_friction", i): 0.003 * kp,
            ("friction_offset", i): 0.0,
            ("motor_viscous_friction", i): 0.004 * kp,
            ("servo_kp", i): kp,
            ("servo_kd", i): 0.012 * kp,
            ("servo_delay", i): 0.012,
            ("velocity_lag", i): 0.0,
            ("torque_limit", i): limits[i - 1],
        }
    time: FloatArray = SAMPLE_TIME * np.arange(4000, dtype=np.float64)
    waves = [
        np.sin(2 * np.pi * f * np.add.outer(time, [0.0, 0.4 / f])) / f for f in (0.4, 1.1, 2.3)
    ]
    reference = 0.15 * np.sum(waves, axis=0)
    record = ServoRecord("one", time, reference, 0.0 * reference, reference, None)
    start = np.concatenate([reference[0], np.zeros(2)])
    run = loop.simulate(loop.prepare(values, record), Segment(record, 0, len(time)), start)
    count = 2.0 * np.pi / 4096
    angle = count * np.round(run.angle / count)
    return loop, ServoRecord("one", time, reference, 0.0 * reference, angle, None)


@pytest.mark.parametrize("limits", [(9.0, 1.5), (0.9, 0.12)], ids=["free", "at the limits"])
def test_starts_near_the_ratios_to_the_first_gain(limits: tuple[float, float]) -> None:
    loop, record = two_joints(limits)
    values = linear_starts(loop, [record])[0].values
    assert values["servo_kp", 2] == pytest.approx(KP[1] / KP[0], rel=0.3)
    assert values["servo_delay", 1] == pytest.approx(0.012, abs=0.006)
    gravity = BODY["gravity_torque_1", None] / KP[0]
    assert values["gravity_torque_1", None] == pytest.approx(gravity, rel=0.3)
