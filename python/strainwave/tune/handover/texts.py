"""The servo as equations for people, C99, ros2_control, models of MATLAB and python-control."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.arm.description import INPUTS, ControlLaw
from strainwave.errors import import_optional
from strainwave.export.flat import HEADER_PREFIX
from strainwave.export.source import sentence_of
from strainwave.io.templates import fill_text
from strainwave.tune.closed_loop import Biquad, Gains
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover.json_document import Units
from strainwave.tune.margins import margin_summaries
from strainwave.tune.observer import OUTPUTS

if TYPE_CHECKING:
    from control import StateSpace

_C_NOTES = (
    "the delay from a reading to its input is a property of the task that calls the servo",
    "the feed-forward is an argument; the header does not compute it",
)
_LIMITS = {
    "margins": "the margins with period, delay and resonances limit the bandwidth",
    "encoder": "the resolution of the motor encoder limits the bandwidth",
}
_MATLAB_NOTES = (
    "not in the ss models: the limit of the input, the hold of integrators and the feed-forward",
    "not in the script: margins, see servo.json",
)
HOLD = (
    "if u[k] is limited, the integral keeps its last value: after u[k] is computed, "
    "replace s[k] by s[k-1]"
)
"""The rule against windup, which the equations lack."""


def difference_equations(gains: Gains, limit: float, units: Units) -> list[tuple[str, str]]:
    """Equations of sample k, in the order of computation, each with a remark and its unit.

    r and w are angle and velocity of the reference, y is the angle of the motor, ff the
    feed-forward and u the input of the drive.
    """
    T, limit = gains.period, float(limit)
    lines = [
        (
            f"e[k] = w[k] + {gains.position_gain!r}*(r[k] - y[k]) - (y[k] - y[k-1])/{T!r}",
            f"error of the velocity [{units.angle}/s]",
        ),
        (f"s[k] = s[k-1] + {T!r}*e[k]", f"integral [{units.angle}]; see below"),
        (f"g0[k] = {gains.kp!r}*e[k] + {gains.ki!r}*s[k]", f"PI controller [{units.input}]"),
    ]
    for i, one in enumerate(gains.filters):
        (b0, b1, b2), (a1, a2) = one.b, one.a
        now, last = f"g{i + 1}", f"g{i}"
        equation = (
            f"{now}[k] = {b0!r}*{last}[k] + {b1!r}*{last}[k-1] + {b2!r}*{last}[k-2]"
            f" - ({a1!r})*{now}[k-1] - ({a2!r})*{now}[k-2]"
        )
        lines.append((equation, f"{one.kind} at {one.frequency_hz:.4g} Hz [{units.input}]"))
    end = f"g{len(gains.filters)}"
    lines.append(
        (
            f"u[k] = min(max({end}[k] + ff[k], {-limit!r}), {limit!r})",
            f"input of the drive [{units.input}]",
        )
    )
    return lines


def to_markdown(design: ServoDesign) -> str:
    """Difference equations, gains with units and margins of each joint; shapers; conditions."""
    return _filled("servo.md.j2", design, limits=_LIMITS, margin_summaries=margin_summaries)


def to_c_header(design: ServoDesign) -> str:
    """Laws of all joints, their step and reset, observers, and the first shaper if there is one.

    States beyond those of a law are zero, so that all joints have one type.
    """
    laws = [(f"{i}", i, gains.law()) for i, gains in enumerate(design.gains, start=1)]
    laws += [
        (f"{one.joint}_DAMPED", one.joint, one.law) for one in design.dampings if not one.reason
    ]
    return _filled(
        "servo.h.j2",
        design,
        prefix=HEADER_PREFIX,
        n_states=max(len(law.A) for _, _, law in laws),
        laws=laws,
        observers=[(one.joint, one.system) for one in design.observers],
        notes=_C_NOTES,
        initializer=_initializer,
        comment=lambda text: text.replace("*/", "* /"),  # which would end it
    )


def _initializer(values: FloatArray) -> str:
    if values.ndim == 0:
        return repr(values.item())
    return "{" + ", ".join(_initializer(row) for row in values) + "}"


def to_script(design: ServoDesign) -> str:
    """Script with `servo(i)`: gains, matrices, `ss` model and the `tf` of each filter."""
    return _filled(
        "servo.m.j2",
        design,
        inputs=INPUTS,
        outputs=OUTPUTS,
        notes=_MATLAB_NOTES,
        matrix=_matrix,
        cell=lambda names: "{" + ", ".join(f"'{name}'" for name in names) + "}",
        state_names=_state_names,
    )


def _filled(template: str, design: ServoDesign, **values: Any) -> str:
    return fill_text(
        Path(__file__).with_name(template),
        design=design,
        shaper=next(iter(design.shapers), None),
        units_of=lambda joint: Units.of(design.arm.joint(joint)),
        difference_equations=difference_equations,
        hold=HOLD,
        sentence_of=sentence_of,
        **values,
    )


def _matrix(matrix: FloatArray) -> str:
    rows = (", ".join(map(repr, row)) for row in np.atleast_2d(matrix).tolist())
    return f"[{'; '.join(rows)}]"


def _state_names(law: ControlLaw) -> list[str]:
    """Names of the states of a law as identifiers."""
    words = (name.replace("-", " ").replace(",", " ").split() for name in law.names)
    return ["_".join(each) for each in words]


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
    """YAML with `update_rate`, the gains of a trajectory controller, and low-pass filters.

    With the position loop inside, the cascade without filters is a PID controller of the angle:

        kp (K (r - y) + w - v) + ki int(K (r - y) + w - v)
            = (kp K + ki) (r - y) + kp (w - v) + ki K int(r - y)

    `JointTrajectoryController` computes p (r - y) + d (w - v) + i int(r - y) of position and
    velocity of a joint, as an effort. Position and effort are those of the link: n times the motor
    angle, and 1 / n times the motor torque, so that gains are e / n^2 times those of the motor.
    """
    arm, period = design.arm.study.arm, design.clock.period
    joints, filters = [], []
    for each, name, limit in zip(
        design.joints, arm.joint_names, design.limits.tolist(), strict=True
    ):
        joint, gains = design.arm.joint(each.joint), each.gains
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
        notes=_ros2_notes(design),
        quoted=json.dumps,  # a string of JSON is one of YAML
        sentence_of=sentence_of,
    )


def _ros2_notes(design: ServoDesign) -> tuple[str, ...]:
    """Parts of the servo that the controllers of ros2_control lack, and assumptions."""
    period, arm = design.clock.period, design.arm.study.arm
    notes = [
        "the PID has the velocity of the hardware interface; the servo differences the motor angle "
        "over a period, so let the hardware interface do the same",
        "the PID limits the integral of the position error; the servo holds the integral of the "
        "velocity error while its input is limited",
        "omitted: input shapers: shape the trajectory before it is sent",
    ]
    filtered = [str(each.joint) for each in design.joints if each.gains.filters]
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


def controllers(design: ServoDesign) -> list[StateSpace]:
    """Discrete state-space system of each joint: `INPUTS` to `voltage`, not limited.

    The limit, the hold of integrators and the feed-forward are not linear parts of the law and are
    absent. Raises `InvalidInput` if python-control is missing.
    """
    control = import_optional("control", "a controller as state-space object", "control")
    systems = []
    for number, gains in enumerate(design.gains, start=1):
        law = gains.law()
        systems.append(
            control.ss(
                law.A + np.outer(law.E, law.C),
                law.B + np.outer(law.E, law.D),
                law.C[None],
                law.D[None],
                dt=gains.period,
                name=f"servo_{number}",
                states=_state_names(law),
                inputs=list(INPUTS),
                outputs=["voltage"],
            )
        )
    return systems


def observers(design: ServoDesign) -> list[StateSpace]:
    """Discrete state-space system of each elastic joint, from its inputs to `OUTPUTS`.

    The inputs are that of the drive, the interaction torque and the readings. Raises `InvalidInput`
    if python-control is missing.
    """
    control = import_optional("control", "an observer as state-space object", "control")
    systems = []
    for observer in design.observers:
        system = observer.system
        systems.append(
            control.ss(
                *(system.A, system.B, system.C, system.D),
                dt=observer.period,
                name=f"observer_{observer.joint}",
                states=list(system.states),
                inputs=list(system.inputs),
                outputs=list(OUTPUTS),
            )
        )
    return systems
