"""The servo as equations for people, C99, and models of MATLAB and python-control."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.control_law import INPUTS, ControlLaw
from strainwave.errors import import_optional
from strainwave.export.flat import HEADER_PREFIX
from strainwave.export.omissions import sentence_of
from strainwave.io.templates import fill_text
from strainwave.tune.closed_loop import Gains
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover.json_document import Units
from strainwave.tune.margins import margin_summaries
from strainwave.tune.observer import OUTPUTS, Observer

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
        lines.append((equation, f"{one.kind} at {one.hz:.4g} Hz [{units.input}]"))
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
    joints = []
    for each in design.joints:
        gains, units = each.tuned.gains, Units.of(design.arm.joint(each.joint))
        joints.append(
            (
                each,
                design.arm.study.arm.joint_names[each.joint - 1],
                units,
                difference_equations(gains, design.limits[each.joint - 1], units),
                [
                    (one, design.condition[one.plant] + 1)
                    for one in margin_summaries(each.results.margins, design.options.required)
                ],
            )
        )
    return fill_text(
        Path(__file__).with_name("servo.md.j2"),
        design=design,
        joints=joints,
        limits=_LIMITS,
        shaper=next(iter(design.shapers), None),
        hold=HOLD,
        sentence_of=sentence_of,
    )


def to_c_header(design: ServoDesign) -> str:
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
    observers = [
        (one.joint, one.system, {name: _initializer(getattr(one.system, name)) for name in "ABCD"})
        for one in design.observers
    ]
    return fill_text(
        Path(__file__).with_name("servo.h.j2"),
        prefix=HEADER_PREFIX,
        period=design.clock.period,
        delay=design.clock.delay,
        n_states=n_states,
        n_joints=len(design.gains),
        laws=entries,
        observers=observers,
        n_observed=max((len(system.A) for _, system, _ in observers), default=0),
        n_inputs=max((len(system.inputs) for _, system, _ in observers), default=0),
        shaper=next(iter(design.shapers), None),
        notes=_C_NOTES,
        comment=lambda text: text.replace("*/", "* /"),  # which would end it
    )


def _initializer(values: FloatArray) -> str:
    if values.ndim == 0:
        return repr(values.item())
    return "{" + ", ".join(_initializer(row) for row in values) + "}"


def to_script(design: ServoDesign) -> str:
    """Script with `servo(i)`: gains, matrices, `ss` model and the `tf` of each filter."""
    joints = []
    for each in design.joints:
        gains, units = each.tuned.gains, Units.of(design.arm.joint(each.joint))
        law = gains.law()
        equations = difference_equations(gains, design.limits[each.joint - 1], units)
        states = _cell(_state_names(law))
        joints.append((each.joint, gains, units, _matrices(law), states, equations))
    return fill_text(
        Path(__file__).with_name("servo.m.j2"),
        design=design,
        joints=joints,
        inputs=_cell(INPUTS),
        observers=[_observer(one) for one in design.observers],
        damped=[(one, _matrices(one.law)) for one in design.dampings if not one.reason],
        shaper=next(iter(design.shapers), None),
        notes=_MATLAB_NOTES,
        hold=HOLD,
        sentence_of=sentence_of,
    )


def _observer(observer: Observer) -> tuple[Observer, dict[str, str], dict[str, str]]:
    system = observer.system
    names = {
        "StateName": _cell(system.states),
        "InputName": _cell(system.inputs),
        "OutputName": _cell(OUTPUTS),
    }
    return observer, {name: _matrix(getattr(system, name)) for name in "ABCD"}, names


def _matrices(law: ControlLaw) -> dict[str, str]:
    rows = {name: _matrix(getattr(law, name)) for name in "ABCD"}
    return rows | {"E": _matrix(law.E[:, None])}


def _matrix(matrix: FloatArray) -> str:
    rows = (", ".join(map(repr, row)) for row in np.atleast_2d(matrix).tolist())
    return f"[{'; '.join(rows)}]"


def _cell(names: Sequence[str]) -> str:
    return "{" + ", ".join(f"'{name}'" for name in names) + "}"


def _state_names(law: ControlLaw) -> list[str]:
    """Names of the states of a law as identifiers."""
    words = (name.replace("-", " ").replace(",", " ").split() for name in law.names)
    return ["_".join(each) for each in words]


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
