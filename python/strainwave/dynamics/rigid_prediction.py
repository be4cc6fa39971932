"""What the rigid model says the motor torques are, and how well that fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Parameter, Signals
from strainwave.domain.combinations import FRICTION_COLUMNS
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import low_pass

_PIECE = 1 << 16  # samples predicted at once
_MOSTLY = 0.5  # share of standing from which a fit says nothing of the model


@dataclass(frozen=True, slots=True)
class Band:
    """Measured and predicted motor torques through one filter, edges cut."""

    time: FloatArray  # (n_rows,)
    measured: FloatArray  # (n_rows, n_joints) [N m]
    predicted: FloatArray  # (n_rows, n_joints) [N m]
    fit_percent: FloatArray  # (n_joints,) NaN for a motor that mostly stands: nothing was predicted


def fit_percent(measured: FloatArray, predicted: FloatArray) -> FloatArray:
    """100 (1 - |y - yhat| / |y - mean(y)|), per column.

    `measured`, `predicted` (n_samples, n_channels). Returns (n_channels,): NaN for a channel that
    does not vary.
    """
    spread = np.linalg.norm(measured - measured.mean(axis=0), axis=0)
    error = np.linalg.norm(measured - predicted, axis=0)
    return np.asarray(
        100.0 * (1.0 - np.divide(error, spread, out=np.full_like(error, np.nan), where=spread > 0))
    )


def band_fit(
    arm: Arm,
    solution: FloatArray,
    signals: Signals,
    model_hz: float,
    load_friction: Sequence[Parameter] = (),
) -> FloatArray:
    """How well a model predicts a record's torques within its bandwidth, joint by joint.

    `arm`, `solution`, `signals`, `model_hz`, `load_friction`: As of `band_predictions`, whose first
    fit it is, in less memory. Returns (n_joints,) [%].
    """
    torque = predict_torque(
        arm, solution, signals, _bridge(model_hz, signals.sample_time), load_friction
    )
    T = signals.sample_time
    fits = []
    for i in range(torque.shape[1]):
        own = slice(i, i + 1)
        measured = low_pass(signals.motor_torque[:, own], model_hz, T)
        predicted = low_pass(torque[:, own], model_hz, T)
        fits.append(_fit(measured, predicted, signals.direction[:, own], model_hz, T))
    return np.concatenate(fits)


def band_predictions(
    arm: Arm,
    solution: FloatArray,
    signals: Signals,
    model_hz: float,
    load_friction: Sequence[Parameter] = (),
) -> tuple[Band, Band]:
    """Predict a record's torques from its motion, within a model's bandwidth and as logged.

    `solution` (n_parameters,): As in `Arm.rigid_columns`. `model_hz` [Hz]: Bandwidth in which the
    model was estimated. `load_friction`: Of the joints whose friction grows with the load. Returns:
    Both torques behind that band's filter. Returns: The measured torque as logged, the predicted
    one as wide as the signals are.
    """
    torque = predict_torque(
        arm, solution, signals, _bridge(model_hz, signals.sample_time), load_friction
    )
    T = signals.sample_time
    within = low_pass(signals.motor_torque, model_hz, T), low_pass(torque, model_hz, T)
    logged = signals.unfiltered_torque, torque
    first, second = (_compared(*pair, signals, model_hz) for pair in (within, logged))
    return first, second


def _bridge(model_hz: float, T: float) -> int:
    """Samples up to which an uncertain direction is a reversal: half a period of the band."""
    return int(0.5 / (model_hz * T))


def _compared(measured: FloatArray, torque: FloatArray, signals: Signals, model_hz: float) -> Band:
    """Measured and predicted torque without the filter's edges, and how well they agree."""
    T = signals.sample_time
    inside = _inside(measured, model_hz, T)
    fit = _fit(measured, torque, signals.direction, model_hz, T)
    return Band(signals.time[inside], measured[inside], torque[inside], fit)


def _fit(
    measured: FloatArray, torque: FloatArray, direction: FloatArray, model_hz: float, T: float
) -> FloatArray:
    """The fit inside the filter's edges, column by column; NaN for a motor that mostly stands."""
    inside = _inside(measured, model_hz, T)
    stands = standing(direction[inside], _bridge(model_hz, T)).mean(axis=0)
    return np.where(stands > _MOSTLY, np.nan, fit_percent(measured[inside], torque[inside]))


def _inside(signal: FloatArray, model_hz: float, T: float) -> slice:
    """Clear of the transients of the band's filter."""
    edge = int(1.0 / (model_hz * T))
    return slice(edge, len(signal) - edge)


def predict_torque(
    arm: Arm,
    solution: FloatArray,
    signals: Signals,
    longest_bridge: int,
    load_friction: Sequence[Parameter] = (),
) -> FloatArray:
    """Motor torques of the rigid model for a motion.

    In a brief reversal Coulomb friction runs straight from one direction to the other. A motor that
    stands for longer takes any torque within +-f of the rest: the model then predicts that set, and
    its member next to the measured torque is returned, so that the difference is the distance from
    the set.

    `solution` (n_parameters,). `longest_bridge`: Samples up to which a stretch of uncertain
    direction is a reversal. `load_friction`: Of the joints whose friction grows with the load.
    Returns (n_samples, n_joints) [N m].
    """
    share = np.zeros(arm.n_joints)
    for parameter in load_friction:
        share[(parameter.joint or 1) - 1] = parameter.value or 0.0
    direction = np.column_stack([_bridged(d) for d in signals.direction.T])
    stands = standing(signals.direction, longest_bridge)
    torque = np.empty_like(signals.motor_torque)
    for start in range(0, len(torque), _PIECE):  # a regressor of all samples is many times as large
        piece = slice(start, start + _PIECE)
        known = direction[piece], stands[piece]
        torque[piece] = _predicted(arm, solution, share, signals, piece, *known)
    return torque


def _predicted(
    arm: Arm,
    solution: FloatArray,
    load_friction: FloatArray,
    signals: Signals,
    piece: slice,
    direction: FloatArray,
    stands: BoolArray,
) -> FloatArray:
    """Motor torques of some samples, with the directions and standstills there."""
    n, first = arm.gear_ratios, arm.n_body
    angle, velocity, acceleration, measured = (
        x[piece]
        for x in (
            signals.motor_angle,
            signals.motor_velocity,
            signals.motor_acceleration,
            signals.motor_torque,
        )
    )
    phi = arm.rigid_regressor(angle * n, velocity * n, acceleration * n)
    viscous, coulomb, offset = solution[first:].reshape(arm.n_joints, FRICTION_COLUMNS).T
    body = phi @ solution[:first]
    rest = body + viscous * velocity + offset
    dry = coulomb + load_friction * np.abs(body)
    held = rest + np.clip(measured - rest, -np.abs(dry), np.abs(dry))
    return np.where(stands, held, rest + dry * direction)


def standing(direction: FloatArray, longest_bridge: int) -> BoolArray:
    """Samples in stretches of uncertain direction longer than a reversal.

    `direction` (n_samples, n_joints). `longest_bridge`: Samples. Returns (n_samples, n_joints).
    """
    result = np.zeros(direction.shape, dtype=bool)
    for i, column in enumerate(direction.T):
        edges = np.flatnonzero(np.diff(np.r_[False, column == 0.0, False].astype(np.int8)))
        for start, stop in edges.reshape(-1, 2).tolist():
            result[start:stop, i] = stop - start > longest_bridge
    return result


def _bridged(direction: FloatArray) -> FloatArray:
    """Directions with the uncertain stretches bridged by straight lines, zero if none is known."""
    known = np.flatnonzero(direction)
    if not known.size:
        return direction
    return np.interp(np.arange(len(direction)), known, direction[known])
