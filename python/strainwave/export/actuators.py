"""Configurations of actuators for Isaac Lab, mjlab and PACE, with ranges for randomisation.

A configuration is a Python module with one entry per joint in the target's own classes. The ranges
and their correlations are those of arms drawn from the joint covariance of the result.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA
from strainwave.domain.arm.combinations import is_rigid_drive
from strainwave.domain.keys import Values
from strainwave.export import source
from strainwave.export.randomisation import drawn_values
from strainwave.export.rigid_links import DELAY, STICTION, RigidLink, held_parts, rigid_links
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


@dataclass(frozen=True, slots=True)
class Target:
    """A package with configurations of actuators."""

    title: str
    checked: str  # versions whose configurations were read back
    module: str
    of_servo: str  # class of a position servo
    of_torque: str  # class of a motor whose torque is the command
    dry_friction: str
    viscous_friction: str
    holds: tuple[str, ...] = ()  # parts in addition to those of rigid links


_ISAAC = ("friction", "viscous_friction", (STICTION,))
TARGETS = {
    "isaaclab": Target(
        "Isaac Lab",
        "Isaac Lab 2.3.2",
        "isaaclab.actuators",
        "DelayedPDActuatorCfg",
        "ImplicitActuatorCfg",
        *_ISAAC,
    ),
    "mjlab": Target(
        "mjlab",
        "mjlab 1.6.0",
        "mjlab.actuator",
        "BuiltinPositionActuatorCfg",
        "BuiltinMotorActuatorCfg",
        "frictionloss",
        "viscous_damping",
    ),
    "pace": Target(
        "PACE",
        "PACE of December 2025, Isaac Lab 2.3.2",
        "pace_sim2real.utils",
        "PaceDCMotorCfg",
        "PaceDCMotorCfg",
        *_ISAAC,
    ),
}


def to_isaaclab(arm: IdentifiedArm) -> Export:
    """Module of actuators for Isaac Lab."""
    return _module(arm, "isaaclab")


def to_mjlab(arm: IdentifiedArm) -> Export:
    """Module of actuators for mjlab."""
    return _module(arm, "mjlab")


def to_pace(arm: IdentifiedArm) -> Export:
    """Module of actuators for PACE, with the intervals as bounds of its search."""
    return _module(arm, "pace")


def _module(arm: IdentifiedArm, form: str) -> Export:
    target, (links, notes) = TARGETS[form], rigid_links(arm, has_rotors=True)
    losses = source.losses(arm, held_parts(arm, DELAY, "gravity", source.ERRORS, *target.holds))
    if is_rigid_drive(arm.study.arm):
        notes = (*notes, "the link of a single rigid joint includes its motor: armature is zero")
    if not all(link.servo for link in links):
        notes = (
            *notes,
            "joints without a position servo: stiffness and damping are zero, the "
            "command is the torque",
        )
    notes = (*notes, *source.loss_note(losses))
    quantities, drawn = _drawn(arm, links)
    low, high = np.maximum(np.percentile(drawn, _TAIL_PERCENT, axis=0), 0.0).tolist()
    intervals = {
        (name, link.number): pair for (name, link), *pair in zip(quantities, low, high, strict=True)
    }

    def interval(name: str, link: RigidLink) -> list[float]:
        return intervals.get((name, link.number), [_QUANTITIES[name](link) or 0.0] * 2)

    names = {
        "dry friction": target.dry_friction,
        "viscous friction": target.viscous_friction,
    }
    text = fill_text(
        Path(__file__).with_name("actuators.py.j2"),
        form=form,
        target=target,
        links=links,
        notes=notes,
        classes=sorted({target.of_servo if link.servo else target.of_torque for link in links}),
        names={name: names.get(name, name.replace(" ", "_")) for name in _QUANTITIES},
        quantities=quantities,
        intervals=intervals,
        interval=interval,
        delays=[interval("delay", link) for link in links],
        tuple_of=lambda pair: str(tuple(pair)),
        mean=[_QUANTITIES[name](link) for name, link in quantities],
        std=np.std(drawn, axis=0).tolist(),
        correlation=_correlation(drawn).round(4).tolist(),
        step=_STEP_S,
        no_limit=NO_LIMIT,
        expression=lambda name: json.dumps(re.escape(name)),
        sentence_of=source.sentence_of,
    )
    return Export(text.encode(), arm.assumed(), notes, losses)


def _drawn(
    arm: IdentifiedArm, links: Sequence[RigidLink]
) -> tuple[list[tuple[str, RigidLink]], FloatArray]:
    """Quantities with an interval, and their values in drawn arms: (n_draws, n_quantities).

    A value is the exported one plus the difference of the draw from the estimate.
    """
    quantities = [(name, link) for link in links for name in _QUANTITIES]
    exported = np.array([_QUANTITIES[name](link) or 0.0 for name, link in quantities])
    draws = drawn_values(arm, arm.covariance, _N_DRAWS, np.random.default_rng(0))
    table = np.array([list(_at_joints(arm, values, links)) for values in draws])
    changes = table[1:] - table[0]
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
