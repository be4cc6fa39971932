"""The servo and its input shaper as a C99 header for a task of fixed period.

The servo of a joint as difference equations with numbers.
"""

from __future__ import annotations

from pathlib import Path

from strainwave.domain import FloatArray
from strainwave.export.flat import HEADER_PREFIX
from strainwave.export.source import Export
from strainwave.io.templates import fill_text
from strainwave.servo_design.control_law import Gains
from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.handover.json_document import Units
from strainwave.servo_design.handover.shaper_summary import chosen_shaper

_NOTES = (
    "the delay from a reading to its input is a property of the task that calls the servo",
    "the feed-forward is an argument; the header does not compute it",
)


def to_c_header(design: ServoDesign) -> Export:
    """Laws of all joints, their step and reset, observers, and the first shaper if there is one.

    States beyond those of a law are zero, so that all joints have one type.
    """
    laws = [(f"{i}", i, gains.law()) for i, gains in enumerate(design.gains, start=1)]
    laws += [
        (f"{one.joint}_DAMPED", one.joint, one.law) for one in design.dampings if not one.reason
    ]
    n_states = max(len(law.A) for _, _, law in laws)
    entries = []
    for macro, number, law in laws:
        rows = {name: getattr(law, name) for name in "ABCDE"}
        rows |= {"holds": law.holds.astype(int), "rest": law.rest()}
        values = {name: _initializer(row) for name, row in rows.items()}
        unit = Units.of(design.arm.joint(number)).input
        name = design.arm.study.arm.joint_names[number - 1]
        limit = float(design.limits[number - 1])
        entries.append((macro, number, name, len(law.A), limit, unit, law.names, values))
    systems = [(one.joint, one.system) for one in design.observers]
    observers = [
        (number, system, {name: _initializer(getattr(system, name)) for name in "ABCD"})
        for number, system in systems
    ]
    text = fill_text(
        Path(__file__).with_name("servo.h.j2"),
        prefix=HEADER_PREFIX,
        period=design.clock.period,
        delay=design.clock.delay,
        n_states=n_states,
        n_joints=len(design.gains),
        laws=entries,
        observers=observers,
        n_observed=max((len(system.A) for _, system in systems), default=0),
        n_inputs=max((len(system.inputs) for _, system in systems), default=0),
        shaper=chosen_shaper(design),
        notes=_NOTES,
        comment=lambda text: text.replace("*/", "* /"),  # which would end it
    )
    return Export(text.encode(), design.arm.warnings, _NOTES)


def _initializer(values: FloatArray) -> str:
    """Nested braces."""
    if values.ndim == 0:
        return repr(values.item())
    return "{" + ", ".join(_initializer(row) for row in values) + "}"


def difference_equations(gains: Gains, limit: float, units: Units) -> list[tuple[str, str]]:
    """Equations of sample k, in the order of computation, each with a remark and its unit.

    r and w are angle and velocity of the reference, y is the angle of the motor, ff the
    feed-forward and u the input of the drive.
    """
    T, limit = gains.period, float(limit)
    lines = [
        (
            f"e[k] = w[k] + {gains.position_gain!r}*(r[k] - y[k]) - (y[k] - y[k-1])/{T!r}",
            f"error of the velocity [{units.velocity}]",
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
        lines.append((equation, f"{one.kind} at {one.hz:.4g} Hz [{units.input}]"))
    end = f"g{len(gains.filters)}"
    lines.append(
        (
            f"u[k] = min(max({end}[k] + ff[k], {-limit!r}), {limit!r})",
            f"input of the drive [{units.input}]",
        )
    )
    return lines


HOLD = (
    "if u[k] is limited, the integral keeps its last value: after u[k] is computed, "
    "replace s[k] by s[k-1]"
)
"""The rule against windup, which the equations lack."""
