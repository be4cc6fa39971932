"""Parameters of ros2_control: a trajectory controller whose PID is the cascade without filters.

With the position loop inside, the cascade without filters is a PID controller of the angle:

    kp (K (r - y) + w - v) + ki int(K (r - y) + w - v)
        = (kp K + ki) (r - y) + kp (w - v) + ki K int(r - y)

`JointTrajectoryController` computes p (r - y) + d (w - v) + i int(r - y) of position and velocity
of a joint, as an effort. Position and effort are those of the link: n times the motor angle, and
1 / n times the motor torque, so that gains are e / n^2 times those of the motor.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from strainwave.export.source import sentence_of
from strainwave.io.templates import fill_text
from strainwave.tune.closed_loop import Biquad
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover.json_document import Units


def low_pass_hz(one: Biquad, period: float) -> float | None:
    """`damping_frequency` [Hz] of a `control_filters/LowPassFilter` at a `damping_intensity` of 0.

    That filter is y_k = (1 - a) x_k-1 + a y_k-1 with a = exp(-2 pi f T). It delays slow signals by
    T / (1 - a), which is set to the delay of the second-order filter, so that the phase at the
    bandwidth remains. None if that delay is shorter than a period, or the filter no low-pass.
    """
    if one.kind != "low-pass":
        return None
    periods = np.sqrt(0.5) / np.tan(np.pi * one.frequency_hz * period)  # of delay
    return float(-np.log(1.0 - 1.0 / periods) / (2.0 * np.pi * period)) if periods > 1.0 else None


def to_ros2_control(design: ServoDesign) -> str:
    """YAML with `update_rate`, the gains of a trajectory controller, and low-pass filters."""
    arm, period = design.arm.study.arm, design.clock.period
    joints, filters = [], []
    for each, name, limit in zip(
        design.joints, arm.joint_names, design.limits.tolist(), strict=True
    ):
        joint, gains = design.arm.joint(each.joint), each.tuned.gains
        ratio = 1.0 if arm.is_coupled else joint.gear_ratio
        units = Units.of(joint)
        effort = units.input if joint.known_torque_per_volt is None else units.torque
        torque_per_command = joint.torque_per_command
        per_motor = torque_per_command / ratio**2
        pid = {
            "p": per_motor * (gains.kp * gains.position_gain + gains.ki),
            "i": per_motor * gains.ki * gains.position_gain,
            "d": per_motor * gains.kp,
            "max_effort": torque_per_command * limit / abs(ratio),
        }
        joints.append((name, units, effort, pid, gains.filters))
        corners = [hz for one in gains.filters if (hz := low_pass_hz(one, period)) is not None]
        if corners:
            filters.append((f"low_pass_{each.joint}", name, corners))
    return fill_text(
        Path(__file__).with_name("ros2_control.yaml.j2"),
        rate=round(1.0 / period),
        joints=joints,
        filters=filters,
        is_coupled=arm.is_coupled,
        notes=_notes(design),
        quoted=json.dumps,  # a string of JSON is one of YAML
        sentence_of=sentence_of,
    )


def _notes(design: ServoDesign) -> tuple[str, ...]:
    """Parts of the servo that the controllers of ros2_control lack, and assumptions."""
    period, arm = design.clock.period, design.arm.study.arm
    notes = [
        "the PID has the velocity of the hardware interface; the servo differences the motor angle "
        "over a period, so let the hardware interface do the same",
        "the PID limits the integral of the position error; the servo holds the integral of the "
        "velocity error while its input is limited",
        "omitted: input shapers: shape the trajectory before it is sent",
    ]
    filtered = [str(each.joint) for each in design.joints if each.tuned.gains.filters]
    if filtered:
        notes.append(
            f"omitted: filters of the input of joint {', '.join(filtered)}: without them the "
            "margins do not hold; run servo.h in the hardware interface, or design without filters"
        )
    if arm.is_coupled:
        notes.append(
            "the transmission couples joints: positions and efforts are those of the motors"
        )
    unknown = [str(number) for number in arm.unknown_drives]
    if unknown:
        notes.append(f"the effort of joint {', '.join(unknown)} is the input of the drive [V]")
    if abs(round(1.0 / period) * period - 1.0) > 1e-9:
        notes.append(
            f"update_rate is an integer: it is rounded from {1.0 / period:.6g} Hz, for which the "
            "gains are designed"
        )
    return tuple(notes)
