"""Dry friction of rigid joints in addition to Coulomb friction, by the laws of the core's effects.

Each law is a size times a function of motor velocity, load and one shape parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from strainwave.domain import FloatArray, FrictionTerm

# of (S16), as in the core: velocity [rad/s] of the stated friction, and offset of its ratio
_POWER_VELOCITY, _POWER_OFFSET = 100.0, 0.01


def _load_friction(velocity: FloatArray, load: FloatArray, shape: float) -> FloatArray:
    """Magnitude of the load, (S15)."""
    return np.abs(load)


def _stribeck(velocity: FloatArray, load: FloatArray, shape: float) -> FloatArray:
    """exp(-(dq / w_s)^2), (S10)."""
    return np.asarray(np.exp(-((velocity / shape) ** 2)))


def _power_friction(velocity: FloatArray, load: FloatArray, shape: float) -> FloatArray:
    """(|dq| / w + s)^p - s^p, (S16)."""
    speed = np.abs(velocity) / _POWER_VELOCITY + _POWER_OFFSET
    return np.asarray(speed**shape - _POWER_OFFSET**shape)


_LAWS: Mapping[str, Callable[[FloatArray, FloatArray, float], FloatArray]] = {
    "load-friction": _load_friction,
    "stribeck": _stribeck,
    "power-friction": _power_friction,
}


def friction_per_size(
    effect: str, shape: float, velocity: FloatArray, load: FloatArray
) -> FloatArray:
    """Friction of an effect per unit of its size, against the motion: (n_samples,).

    `velocity` [rad/s] is that of the motor, `load` [N m] the torque of the bodies at the motor.
    """
    return _LAWS[effect](velocity, load, shape)


def additional_friction(
    terms: Sequence[FrictionTerm], velocity: FloatArray, load: FloatArray
) -> FloatArray:
    """Friction of all terms against the motion: (n_samples, n_joints)."""
    friction = np.zeros_like(velocity)
    for term in terms:
        i = term.joint - 1
        per_size = friction_per_size(term.effect, term.shape, velocity[:, i], load[:, i])
        friction[:, i] += (term.size.value or 0.0) * per_size
    return friction
