"""The table of parameters: one row each, the arm's own first, then joint by joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strainwave.domain import Decision
from strainwave.domain.formatting import plus_minus
from strainwave.presentation.report.blocks import Cell, Group, Row, Table, number, table

_HEADS: tuple[str | Cell, ...] = (
    "parameter",
    "unit",
    *map(number, ("value", "± one sigma", "95 % interval", "95 % half-width, %")),
    "source stage",
)


_MEANINGS = {  # name -> symbol of docs/notation.md, meaning
    "alpha": ("alpha", "inertia of link 1, and of link 2 as a point at axis 2, about axis 1"),
    "beta": ("beta", "inertia of link 2 about its own axis"),
    "gamma": ("gamma", "coupling of the links: link length times first moment of link 2"),
    "gravity_torque_1": ("G₁", "largest gravity torque of link 1"),
    "gravity_torque_2": ("G₂", "largest gravity torque of link 2"),
    "rigid_inertia": ("alpha + m_M/n²", "inertia of joint 1 with its motor, link side"),
    "inertia": ("m", "motor and link together, motor side"),
    "motor_inertia": ("m_M", "inertia of the motor"),
    "motor_viscous_friction": ("d_M", "viscous friction of the motor"),
    "motor_coulomb_friction": ("f", "Coulomb friction, motor side"),
    "friction_offset": ("f₀", "constant part of the friction, motor side"),
    "link_inertia": ("m_L", "inertia of what the gear moves, arm stretched"),
    "link_viscous_friction": ("d_L", "viscous friction of the link"),
    "total_viscous_friction": ("d_M + n² d_L", "viscous friction of the joint, motor side"),
    "gear_stiffness": ("k", "stiffness of the gear, link side"),
    "gear_stiffness_k1": ("K₁", "stiffness of the gear below the first knee"),
    "gear_stiffness_k2": ("K₂", "stiffness of the gear between the knees"),
    "gear_stiffness_k3": ("K₃", "stiffness of the gear beyond the second knee"),
    "gear_knee_t1": ("T₁", "gear torque of the first knee"),
    "gear_knee_t2": ("T₂", "gear torque of the second knee"),
    "gear_damping": ("d_G", "damping of the gear, link side"),
}


def meanings_table(decisions: Sequence[Decision]) -> Iterator[Table]:
    """Symbol and meaning of every parameter in the table, once.

    Parameters
    ----------
    decisions : sequence of Decision

    Returns
    -------
    iterator of Table
    """
    names = dict.fromkeys(decision.parameter.name for decision in decisions)
    rows = [(name, *_MEANINGS[name]) for name in names if name in _MEANINGS]
    return table("What the parameters are", ("parameter", "symbol", "meaning"), rows)


def parameter_table(decisions: Sequence[Decision]) -> Iterator[Table]:
    """All parameters with their intervals.

    Parameters
    ----------
    decisions : sequence of Decision
        The final table.

    Returns
    -------
    iterator of Table
    """
    rows: list[Row | Group] = []
    last: int | None = -1
    for decision in decisions:
        p = decision.parameter
        if p.joint != last:
            rows.append(Group(f"joint {p.joint}" if p.joint else "arm"))
            last = p.joint
        rows.append(_row(decision))
    return table("Parameters", _HEADS, rows, heading=False)


def _row(decision: Decision) -> Row:
    p = decision.parameter
    value, spread = plus_minus(p.value, p.std)
    if p.value is None:
        value = "rejected" if decision.rejected else "not identified"
        spread, interval, half = "", decision.rejected or "not identifiable from these data", ""
    elif p.ci95 is None:
        interval, half = "not known", ""
    else:
        low, high = p.ci95
        interval = f"{_like(value, low)} … {_like(value, high)}"
        half = _share(0.5 * (high - low), p.value)
    return (p.name, p.unit, *map(number, (value, spread, interval, half)), p.stage)


def _share(half: float, value: float) -> str:
    """In percent of the value; beyond all of it the number says nothing more."""
    return f"{100.0 * half / abs(value):.2g}" if half < abs(value) else "over 100"


def _like(shown: str, number: float) -> str:
    """A number with the decimals, and the exponent, of another that is written already."""
    digits, _, exponent = shown.partition("e")
    decimals = len(digits.partition(".")[2])
    if not exponent:
        return f"{number:.{decimals}f}"
    return f"{number / 10.0 ** int(exponent):.{decimals}f}e{exponent}"
