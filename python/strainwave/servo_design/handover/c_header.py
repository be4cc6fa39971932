"""The servo and its input shaper as a C99 header for a task of fixed period."""

from __future__ import annotations

from pathlib import Path

from strainwave.domain import FloatArray
from strainwave.export.flat import HEADER_PREFIX
from strainwave.export.source import Export
from strainwave.io.templates import fill_text
from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.handover.json_document import Units

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
    observers = [
        (one.joint, one.system, {name: _initializer(getattr(one.system, name)) for name in "ABCD"})
        for one in design.observers
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
        n_observed=max((len(system.A) for _, system, _ in observers), default=0),
        n_inputs=max((len(system.inputs) for _, system, _ in observers), default=0),
        shaper=next(iter(design.shapers), None),
        notes=_NOTES,
        comment=lambda text: text.replace("*/", "* /"),  # which would end it
    )
    return Export(text.encode(), design.arm.warnings, _NOTES)


def _initializer(values: FloatArray) -> str:
    """Nested braces."""
    if values.ndim == 0:
        return repr(values.item())
    return "{" + ", ".join(_initializer(row) for row in values) + "}"
