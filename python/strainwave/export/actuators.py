"""Configurations of actuators for Isaac Lab, mjlab and PACE, with ranges for randomisation.

A configuration is a Python module with one entry per joint in the target's own classes. The ranges
and their correlations are those of arms drawn from the joint covariance of the result.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA
from strainwave.domain.arm.combinations import is_rigid_drive
from strainwave.domain.keys import Values
from strainwave.export import source
from strainwave.export.randomisation import drawn_values
from strainwave.export.rigid_links import (
    DELAY,
    STICTION,
    RigidLink,
    held_parts,
    no_torques,
    rigid_links,
)
from strainwave.export.source import Export, IdentifiedArm
from strainwave.export.urdf import NO_LIMIT
from strainwave.io.templates import fill_text

Attribute = Callable[[RigidLink], float | None]


def _of_servo(name: str) -> Attribute:
    return lambda link: None if link.servo is None else getattr(link.servo, name)


_QUANTITIES: Mapping[str, Attribute] = {
    "armature": lambda link: link.armature,
    "dry friction": lambda link: link.dry_friction,
    "viscous friction": lambda link: link.viscous_friction,
    "stiffness": _of_servo("stiffness"),
    "damping": _of_servo("damping"),
    "effort limit": lambda link: link.effort_limit,
    "delay": _of_servo("delay"),
}
"""Quantities of an actuator that have ranges."""
_N_DRAWS = 4000  # 2.5 % quantiles of them are within 4 % of the width of the interval
_TAIL_PERCENT = (2.5, 97.5)
_MIN_SPREAD = 1e-9  # relative; of a quantity that is not drawn, rounding
_STEP_S = 0.005  # [s] of a simulation, the default of these packages


def to_actuators(arm: IdentifiedArm, form: str) -> Export:
    """Module of actuators for "isaaclab", "mjlab" or "pace".

    That for PACE has the intervals as bounds of its search. Raises `InvalidInput` if the gain of a
    servo is unknown.
    """
    links, notes = rigid_links(arm, has_rotors=True)
    for link in links:
        if link.servo and link.servo.is_relative:  # other bodies have no such unit
            raise no_torques(arm, link.number)
    further = () if form == "mjlab" else (STICTION,)
    losses = source.losses(arm, held_parts(arm, DELAY, "gravity", source.ERRORS, *further))
    notes += (*_notes(arm, links), *source.loss_note(losses))
    quantities, drawn = _drawn(arm, links)
    ends = np.maximum(np.percentile(drawn, _TAIL_PERCENT, axis=0), 0.0).T.tolist()
    intervals = {
        (name, link.number): tuple(pair)
        for (name, link), pair in zip(quantities, ends, strict=True)
    }

    def interval(name: str, link: RigidLink) -> tuple[float, ...]:
        return intervals.get((name, link.number), (_QUANTITIES[name](link) or 0.0,) * 2)

    text = fill_text(
        Path(__file__).with_name("actuators.py.j2"),
        form=form,
        links=links,
        notes=notes,
        quantities=quantities,
        intervals=intervals,
        interval=interval,
        delays=[interval("delay", link) for link in links],
        mean=[_QUANTITIES[name](link) for name, link in quantities],
        std=np.std(drawn, axis=0).tolist(),
        correlation=_correlation(drawn).round(4).tolist(),
        step=_STEP_S,
        no_limit=NO_LIMIT,
        expression=lambda name: json.dumps(re.escape(name)),
        sentence_of=source.sentence_of,
    )
    return Export(text.encode(), arm.assumed(), notes, losses)


def _notes(arm: IdentifiedArm, links: Sequence[RigidLink]) -> Iterator[str]:
    """What values that are zero mean."""
    if is_rigid_drive(arm.study.arm):
        inertia = arm.values.get(("inertia", 1))
        total = "" if inertia is None else f"; inertia 1 = {inertia:.4g} has motor and link"
        yield f"the link of a single rigid joint includes its motor: armature is zero{total}"
    if links[0].servo is None:
        yield "without position servos stiffness and damping are zero, and commands are torques"


def _drawn(
    arm: IdentifiedArm, links: Sequence[RigidLink]
) -> tuple[list[tuple[str, RigidLink]], FloatArray]:
    """Quantities with an interval, and their values in drawn arms: (n_draws, n_quantities).

    A value is the exported one plus the difference of the draw from the estimate.
    """
    quantities = [(name, link) for link in links for name in _QUANTITIES]
    exported = np.array([_QUANTITIES[name](link) or 0.0 for name, link in quantities])
    draws = drawn_values(arm, arm.covariance, _N_DRAWS, np.random.default_rng(0))[1:]
    table = np.array([list(_at_joints(arm, values, links)) for values in draws])
    changes = table - list(_at_joints(arm, arm.values | arm.identified, links))
    is_drawn = np.std(changes, axis=0) > _MIN_SPREAD * np.abs(exported)
    kept = [entry for entry, is_kept in zip(quantities, is_drawn, strict=True) if is_kept]
    return kept, (exported + changes)[:, is_drawn]


def _correlation(drawn: FloatArray) -> FloatArray:
    centred = drawn - np.mean(drawn, axis=0)
    centred /= np.linalg.norm(centred, axis=0)
    return np.asarray(centred.T @ centred)


def _at_joints(arm: IdentifiedArm, values: Values, links: Sequence[RigidLink]) -> Iterator[float]:
    """The quantities of all joints, from the parameters of their own motors, links and servos."""
    servo = arm.study.arm.position_servo
    for link in links:
        n = abs(link.joint.gear_ratio)
        of = {name: value for (name, joint), value in values.items() if joint == link.number}
        of = defaultdict(float, of)
        viscous = of["motor_viscous_friction"] + n**2 * of["link_viscous_friction"]
        late = 0.5 * servo.period if servo else 0.0
        yield 0.0 if is_rigid_drive(arm.study.arm) else of[MOTOR_INERTIA] / n**2
        yield of["motor_coulomb_friction"] / n
        yield of.get("total_viscous_friction", viscous) / n**2
        yield of["servo_kp"]
        yield of.get("servo_kd", of["servo_damping"]) - late * of["servo_kp"]
        yield of["torque_limit"]
        yield of["servo_delay"]
