"""Values of parameters that the data do not determine, so that an arm can be simulated.

Links are the bodies nearest to typical ones that have the known inertias and gravity torques
(`consistent_links`). Motors match their links, gears have the usual anti-resonance and damping, and
friction is zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from strainwave.domain.arm.base_parameters import MOTOR_INERTIA, base_parameters, link_inertia
from strainwave.domain.arm.combinations import LINK_INERTIA, reported, value_of
from strainwave.domain.arm.consistent_links import consistent_links, priors_of
from strainwave.domain.arm.description import ArmDescription, Joint, unit_in
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS, MOTOR_SHARE
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET, VISCOUS, family_of
from strainwave.domain.arm.parameters import complete_values
from strainwave.domain.keys import FloatArray, JointNumber, Key, Row, Values
from strainwave.errors import NumericalFailure

TYPICAL_ANTI_RESONANCE_HZ = 15.0
"""Typical of strain-wave gears: 10 to 30 Hz, small arms up to 60 Hz."""

TYPICAL_DAMPING_RATIO = 0.03
"""Typical of strain-wave gears."""

# of known inertias in the bodies, relative to the largest of unit and joint: the first one with
# which there are bodies
_TOLERANCES = (1e-3, 1e-2, 0.1)
_MATCH_TOLERANCE = 0.5  # relative, of inertias of links that match their motors
_KNEE_RATIO = 2.0  # of two knees of which one is unknown

OF_SUM = "follows from other values that the data determine"
OF_LINKS = "from the bodies nearest to typical ones that have the known inertias"
OF_MOTOR = "the remaining inertia of the joint, or that of the link as the motor carries it"
OF_GEAR = f"the usual value of a gear: an anti-resonance at {TYPICAL_ANTI_RESONANCE_HZ:g} Hz"
OF_CURVE = "continues the known part of the stiffness curve"
OF_DAMPING = f"the usual value of a gear: {100.0 * TYPICAL_DAMPING_RATIO:g} % of critical damping"
OF_FRICTION = "zero, because nothing is known about it"


@dataclass(frozen=True, slots=True)
class AssumedValues:
    """Values of all parameters of an arm, and why some of them have theirs."""

    values: Values
    reasons: Mapping[Key, str]  # noun phrase for each value that is assumed


def assume_missing(values: Values, arm: ArmDescription) -> AssumedValues:
    """Values that a simulation of the arm needs; those of `values` do not change."""
    known = complete_values(values, arm)
    reasons: dict[Key, str] = dict.fromkeys(known.keys() - values.keys(), OF_SUM)

    def assume(key: Key, value: float, reason: str) -> None:
        if key not in known:
            known[key], reasons[key] = value, reason

    base = base_parameters(arm)
    # arms without gravity have no gravity torques
    missing = [key for key in base.links if key not in known]
    links = [k for k in missing if k in base.effective or family_of(k[0]) != "gravity"]
    if links:
        nearest = _nearest_links(known, arm)
        for key in links:
            assume(key, nearest[key], OF_LINKS)
    for number, joint in enumerate(arm.joints, start=1):
        link = value_of(link_inertia(arm, number), known)
        if (MOTOR_INERTIA, number) not in known:
            assume((MOTOR_INERTIA, number), _motor_inertia(known, arm, number, link), OF_MOTOR)
        for name in (*VISCOUS, COULOMB, OFFSET):
            assume((name, number), 0.0, OF_FRICTION)
        if joint.elastic:
            stiffness = (2.0 * np.pi * TYPICAL_ANTI_RESONANCE_HZ) ** 2 * link
            for name, value, reason in _gear(joint, joint.law.of_joint(known, number), stiffness):
                assume((name, number), value, reason)
            lowest = joint.law.stiffness_range(joint.law.of_joint(known, number))[0]
            critical = 2.0 * float(np.sqrt(max(lowest * link, 0.0)))
            assume(("gear_damping", number), TYPICAL_DAMPING_RATIO * critical, OF_DAMPING)
    return AssumedValues(known, reasons)


def _gear(
    joint: Joint, known: Mapping[str, float], stiffness: float
) -> Iterator[tuple[str, float, str]]:
    """Parameters of the gear's law: name, value and reason."""
    law, reason = joint.law, OF_CURVE if known else OF_GEAR
    slopes = [known[name] for name in law.slopes if name in known]
    last = slopes[0] if slopes else stiffness
    usual = law.straight(last)
    for parameter in law.parameters:
        value = usual[parameter.name]
        if parameter.is_slope:
            value = last = known.get(parameter.name, last)
        value = max(value, _KNEE_RATIO * known.get(parameter.above or "", 0.0))
        for other in law.parameters:
            if other.above == parameter.name and other.name in known:
                value = min(value, known[other.name] / _KNEE_RATIO)
        yield parameter.name, value, reason


def _motor_inertia(known: Values, arm: ArmDescription, number: JointNumber, link: float) -> float:
    """What the links leave of a known sum with the motor's inertia, or as much as the link's."""
    key: Key = (MOTOR_INERTIA, number)
    for column in base_parameters(arm).columns:
        others = {part: weight for part, weight in column.parts.items() if part != key}
        if column.key in known and key in column.parts and others.keys() <= known.keys():
            rest = (known[column.key] - value_of(others, known)) / column.parts[key]
            if rest > 0.0 or not arm.joints[number - 1].elastic:
                return max(rest, 0.0)
    return MOTOR_SHARE / (1.0 - MOTOR_SHARE) * arm.joints[number - 1].gear_ratio ** 2 * link


def _nearest_links(known: Values, arm: ArmDescription) -> Values:
    """Parameters of the links from the bodies nearest to typical ones with the known parameters."""
    base, standard = base_parameters(arm), kind_of(arm).standard_rows(arm)
    numbers = range(1, arm.n_joints + 1)
    parts: list[Key] = [(f"link_{name}", i) for i in numbers for name in LINK_PARAMETERS]

    def over_bodies(row: Row) -> FloatArray:
        """A combination of link parameters over the standard parameters."""
        dense = np.zeros(len(parts))
        for key, weight in row.items():
            for part, share in standard.get(key, {key: 1.0}).items():
                dense[parts.index(part)] += weight * share
        return dense

    matching = {  # inertia of the motor that the link matches, at the motor
        i: MOTOR_SHARE
        / (1.0 - MOTOR_SHARE)
        * arm.joints[i - 1].gear_ratio ** 2
        * over_bodies(link_inertia(arm, i))
        for i in numbers
    }
    facts: dict[Key, Row] = {key: {key: 1.0} for key in base.links}
    facts |= {key: row for key, row in reported(arm).items() if key[0] == LINK_INERTIA}
    facts |= {column.key: column.parts for column in base.columns}
    rows, targets, sizes = list[FloatArray](), list[float](), list[tuple[str, int | None]]()
    loose, loose_targets = list[FloatArray](), list[float]()  # with the share of a motor
    for key in (key for key in facts if key in known):
        motors = {k: w for k, w in facts[key].items() if k[0] == MOTOR_INERTIA}
        row = over_bodies({k: w for k, w in facts[key].items() if k not in motors})
        target = known[key] - sum(w * known.get(motor, 0.0) for motor, w in motors.items())
        unknown = motors.keys() - known.keys()
        if unknown:
            loose.append(row + sum(motors[k] * matching[k[1] or 1] for k in unknown))
            loose_targets.append(target)
        else:
            rows.append(row)
            targets.append(target)
            sizes.append((unit_in(arm, key), key[1]))
    for i in numbers:
        inertia = known.get((MOTOR_INERTIA, i), 0.0)
        if inertia > 0.0:
            loose.append(matching[i])
            loose_targets.append(inertia)
    largest: dict[tuple[str, int | None], float] = {}
    for size, target in zip(sizes, targets, strict=True):
        largest[size] = max(largest.get(size, 0.0), abs(target))
    stds = np.array([largest[size] or 1.0 for size in sizes])
    loose_stds = _MATCH_TOLERANCE * np.maximum(np.abs(loose_targets), np.finfo(float).tiny)
    table, right = np.array([*rows, *loose]), np.array([*targets, *loose_targets])
    bodies = np.concatenate(priors_of(arm))
    for tolerance in _TOLERANCES if len(table) else ():
        weights = 1.0 / np.concatenate([tolerance * stds, loose_stds])
        with suppress(NumericalFailure):
            bodies = consistent_links(priors_of(arm), table * weights[:, None], right * weights)
            break
    return {key: float(over_bodies({key: 1.0}) @ bodies) for key in base.links}
