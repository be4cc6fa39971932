"""Unknowns of a fit of position servos, with their scales, ranges and priors."""

from __future__ import annotations

import numpy as np

from strainwave.domain.arm.description import UNKNOWN
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET
from strainwave.domain.keys import Key, Values
from strainwave.domain.results.estimates import physical_range
from strainwave.identification.position_servo.fit import Prior, Unknown
from strainwave.identification.position_servo.loop import (
    DELAY,
    GEAR_DAMPING,
    GEAR_EFFECTS,
    KD,
    KP,
    LIMIT,
    MOTOR_SHARE,
    SCALE,
    STIFFNESS,
    VELOCITY_LAG,
    VISCOUS,
    ServoLoop,
)
from strainwave.identification.position_servo.records import MAX_DELAY

_LEAST_SHARE = 1e-6  # of a positive base parameter, over the largest of its unit
# of Coulomb friction, over the torque limit: without friction a simulation has no derivative by it
_LEAST_FRICTION = 1e-4
_KD_SHARE_STD = 0.29  # of a uniform distribution on [0, 1]
_LAG_STD = 0.5  # of a servo's velocity, in periods: that of the law is at the reading
# of friction: its offset over Coulomb friction; it replaces gravity where the angle hardly changes
_ASYMMETRY = 0.38
_UNSEEN_FRICTION = 3.4e-3  # over the torque limit, of a start without friction
_MOTOR_SHARE_STD = 0.3  # designs match motor and link within a factor
USUAL_MOTOR_SHARE = 0.5
"""Share of the motor in the inertia of an elastic joint, before the data tell it."""
EFFECT_SCALES = dict(zip(GEAR_EFFECTS, (1e-3, 0.05), strict=True))
"""Usual sizes of effects of gears [rad], 1: their start and their scale."""


def unknowns_of(loop: ServoLoop, values: Values) -> tuple[list[Unknown], list[Prior]]:
    """Unknowns of a fit with scales from its start, and what is known of them.

    A servo has any share of the damping, and its velocity may be late by two periods.
    """
    servo, unknowns, priors = loop.servo, list[Unknown](), list[Prior]()
    for column in loop.arm.base.columns:
        size = max(
            abs(values[other.key]) for other in loop.arm.base.columns if other.unit == column.unit
        )
        least = -np.inf if physical_range(column.name) == "any" else _LEAST_SHARE * size
        unknowns.append(Unknown((column.key,), size + np.finfo(float).tiny, least))
    for i in loop.numbers:
        torque = values[LIMIT, i]
        kd, viscous = values[KD, i], values[VISCOUS, i]
        damping = kd + viscous
        size = 0.5 * damping + 3e-3 * torque
        dry = values[COULOMB, i] + _UNSEEN_FRICTION * torque
        keys: list[tuple[str, float, float, float]] = [
            (VISCOUS, size, 0.0, np.inf),
            (COULOMB, values[COULOMB, i] + 0.01 * torque, _LEAST_FRICTION * torque, np.inf),
            (OFFSET, 0.1 * torque, -dry, dry),  # friction dissipates in both directions
            (VELOCITY_LAG, 0.5, -1.0, 3.0),
            (LIMIT, 0.2 * torque, 0.02 * torque, np.inf),
        ]
        if servo.damping_gain(i) is None or servo.gain(1) is None:
            keys.append((KD, size, 0.0, np.inf))
            share: tuple[tuple[Key, float], ...] = (((KD, i), 1.0), ((VISCOUS, i), -1.0))
            # kd less viscous friction is (2 share - 1) times the damping
            priors.append(Prior(share, 0.0, 2.0 * _KD_SHARE_STD * damping + 1e-3 * torque))
        if i > 1 and servo.gain(i) is None:
            keys.append((KP, 0.3 * values[KP, i], 0.01 * values[KP, i], np.inf))
        if isinstance(servo.delay, tuple) and servo.delay_of(i) is None:
            keys.append((DELAY, 0.003, 0.0, 1.2 * MAX_DELAY))
        if loop.arm.joints[i - 1].elastic:
            keys.append((MOTOR_SHARE, 0.2, 0.02, 0.98))
            priors.append(Prior((((MOTOR_SHARE, i), 1.0),), USUAL_MOTOR_SHARE, _MOTOR_SHARE_STD))
            if not loop.has_stiff_gears:
                keys.append((STIFFNESS, 0.3 * values[STIFFNESS, i], 0.0, np.inf))
                keys.append((GEAR_DAMPING, values[GEAR_DAMPING, i], 0.0, np.inf))
            keys += [
                (name, scale, 0.0, np.inf)
                for name, scale in EFFECT_SCALES.items()
                if (name, i) in loop.plant_names
            ]
        unknowns += [Unknown(((name, i),), *of) for name, *of in keys]
        priors.append(Prior((((VELOCITY_LAG, i), 1.0),), 0.0, _LAG_STD))
        priors.append(Prior((((OFFSET, i), 1.0),), 0.0, _ASYMMETRY * dry))
    if servo.delay == UNKNOWN:
        together = tuple((DELAY, i) for i in loop.numbers)
        unknowns.append(Unknown(together, 0.003, 0.0, 1.2 * MAX_DELAY))
    if SCALE in values:
        unknowns.append(Unknown((SCALE,), 0.3 * values[SCALE], 0.01 * values[SCALE]))
    return unknowns, priors
