"""The servo as equations for people, C99, and models of MATLAB and python-control."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.arm.control_law import INPUTS, ControlLaw
from strainwave.errors import import_optional
from strainwave.export.flat import HEADER_PREFIX
from strainwave.export.source import sentence_of
from strainwave.io.templates import fill_text
from strainwave.tune.closed_loop import Gains
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
