"""Notes on what an export format cannot hold, and texts of comments and exact numbers."""

from __future__ import annotations

from collections.abc import Collection

from strainwave.domain.arm.link_sensors import key_texts, sensor_constants
from strainwave.domain.arm.parameter_table import base_name, family_of
from strainwave.export.source import IdentifiedArm

GEAR, SENSORS, ERRORS = "gear", "sensors", "standard deviations and correlations"
LINEAR = (
    *("motor_inertia", "motor_viscous_friction", "link_viscous_friction"),
    *(GEAR, "gravity", "transmission"),
)
"""Parts of a linear model of the whole arm."""

CORRELATIONS = "omitted: correlations between parameters: see covariance in result.json"
"""Note of formats that contain standard deviations."""


def omission_note(arm: IdentifiedArm, held: Collection[str]) -> tuple[str, ...]:
    """A note on the parts of an arm that are not `held`, with their joints.

    Parts are parameters, effects and keys of the study by name, and all of `GEAR`, `SENSORS`. Every
    format has the links, and sums of parameters.
    """
    parts: dict[str, set[int]] = {}
    for p in arm.parameters:
        name = base_name(p.name)
        is_sum = name == "total_viscous_friction" or family_of(name) in ("inertia", "gravity")
        if p.value is not None and (not is_sum or name == "motor_inertia"):
            is_gear = name == "gear_damping" or family_of(name) == "stiffness"
            is_gear |= p.joint is not None and name in arm.joint(p.joint).law.names
            part = GEAR if is_gear else SENSORS if name in sensor_constants() else name
            parts.setdefault(part, set()).update(() if p.joint is None else (p.joint,))
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        drive = [key for key in ("torque_per_volt", "current_loop_hz") if getattr(joint, key)]
        has_sensor = any(getattr(joint, key) for key in ("encoder_counts", *key_texts()))
        for part in (*joint.named_effects, *drive, *[SENSORS] * has_sensor):
            parts.setdefault(part, set()).add(number)
    description = arm.study.arm
    present = {
        "gravity": description.gravity,
        "transmission": description.is_coupled,
        "servo": description.servo,
        ERRORS: True,
    }
    parts |= {part: set() for part, value in present.items() if value}
    listed = [
        part + (f" (joint {', '.join(map(str, sorted(joints)))})" if joints else "")
        for part, joints in parts.items()
        if part not in held
    ]
    return (f"omitted: {', '.join(listed)}",) if listed else ()


def sentence_of(note: str) -> str:
    """Note as a sentence."""
    return f"{note[:1].upper()}{note[1:]}."


def numbers(*values: float) -> str:
    """Numbers separated by blanks, with all digits."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0


def comment_text(text: str) -> str:
    """Text of a comment; two hyphens in a row, which XML forbids, become one."""
    return text.replace("--", "-")
