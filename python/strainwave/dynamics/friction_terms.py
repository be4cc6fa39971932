"""Terms of rigid joints in addition to inertia, viscous friction, Coulomb friction and offset.

Friction is a size times a law of motor velocity, load and one shape parameter, times the direction
of motion. A spring acts on the link. Encoder zeros and torque delays correct the signals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, FrictionTerm, Signals
from strainwave.dynamics.arm import Arm

SPRING, ZERO, DELAY = "ground-spring", "encoder-zero", "torque-delay"
CORRECTIONS = (ZERO, DELAY)
"""Effects that correct the signals; the others add torques."""

# of (S16), as in the core: velocity [rad/s] of the stated friction, and offset of its ratio
_POWER_VELOCITY, _POWER_OFFSET = 100.0, 0.01


def _load_friction(velocity: FloatArray, load: FloatArray, shape: float) -> FloatArray:
    """Magnitude of the load, (S15)."""
    return np.abs(load)


def _load_speed_friction(velocity: FloatArray, load: FloatArray, shape: float) -> FloatArray:
    """|load dq|."""
    return np.abs(load * velocity)


def _direction_friction(velocity: FloatArray, load: FloatArray, shape: float) -> FloatArray:
    """|dq| - w_a without the direction of motion: the offset is that at the speed w_a."""
    return np.asarray(velocity - shape * np.sign(velocity))


def _stribeck(velocity: FloatArray, load: FloatArray, shape: float) -> FloatArray:
    """exp(-(dq / w_s)^2), (S10)."""
    return np.asarray(np.exp(-((velocity / shape) ** 2)))


def _power_friction(velocity: FloatArray, load: FloatArray, shape: float) -> FloatArray:
    """(|dq| / w + s)^p - s^p, (S16)."""
    speed = np.abs(velocity) / _POWER_VELOCITY + _POWER_OFFSET
    return np.asarray(speed**shape - _POWER_OFFSET**shape)


_LAWS: Mapping[str, Callable[[FloatArray, FloatArray, float], FloatArray]] = {
    "load-friction": _load_friction,
    "load-speed-friction": _load_speed_friction,
    "direction-friction": _direction_friction,
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
        if term.effect in _LAWS and term.joint is not None:
            i = term.joint - 1
            per_size = friction_per_size(term.effect, term.shape, velocity[:, i], load[:, i])
            friction[:, i] += (term.size.value or 0.0) * per_size
    return friction


def spring_torque(arm: Arm, terms: Sequence[FrictionTerm], angle: FloatArray) -> FloatArray:
    """Motor torques of the springs between links and ground at link angles: (n, n_joints)."""
    stiffness = np.zeros(arm.n_joints)
    for term in terms:
        if term.effect == SPRING and term.joint is not None:
            stiffness[term.joint - 1] += term.size.value or 0.0
    return arm.motors_of(stiffness * angle)


def encoder_zeros(arm: Arm, terms: Sequence[FrictionTerm]) -> FloatArray:
    """Joint angle minus encoder reading of each joint [rad or m]: (n_joints,)."""
    zeros = np.zeros(arm.n_joints)
    for term in terms:
        if term.effect == ZERO and term.joint is not None:
            zeros[term.joint - 1] += term.size.value or 0.0
    return zeros


def corrected_signals(signals: Signals, arm: Arm, terms: Sequence[FrictionTerm]) -> Signals:
    """The signals with encoder zeros added to the angles and delays removed from the torques."""
    values = [
        (term.effect, (term.joint or 0) - 1, term.size.value or 0.0)
        for term in terms
        if term.effect in CORRECTIONS
    ]
    return correct(signals, arm, values)


def correct(signals: Signals, arm: Arm, values: Sequence[tuple[str, int, float]]) -> Signals:
    """The signals corrected by values of effects, the joints of encoder zeros from 0."""
    if not values:
        return signals
    zero, torque = np.zeros(arm.n_joints), signals.motor_torque
    for effect, i, value in values:
        if effect == ZERO:
            zero[i] += value
        else:
            late = signals.time + value
            columns = [np.interp(late, signals.time, column) for column in torque.T]
            torque = np.column_stack(columns)
    angle = signals.motor_angle + arm.motor_accelerations(zero)
    return replace(signals, motor_angle=angle, motor_torque=torque)
