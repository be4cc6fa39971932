"""The servo of a joint as difference equations with numbers."""

from __future__ import annotations

from strainwave.servo_design.control_law import Gains
from strainwave.servo_design.handover.units import Units


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
