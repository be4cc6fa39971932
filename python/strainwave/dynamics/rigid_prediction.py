"""Torques predicted by the rigid model: of the motors, with their fit, and between the links.

Terms of rigid joints in addition to inertia, viscous friction, Coulomb friction and offset.

Friction is a size times a law of motor velocity, load and one shape parameter, times the direction
of motion. A spring acts on the link. Encoder zeros, torque delays and torsions correct the signals.

The interaction torque is that of the other links and of gravity on each link, (13), (14).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import (
    BoolArray,
    FloatArray,
    FrictionTerm,
    LinkSignals,
    Payload,
    RigidModel,
    Signals,
)
from strainwave.domain.arm.combinations import total_inertia
from strainwave.domain.arm.kinds.base import MOTOR_SHARE
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.numerics.filters import differentiate, low_pass

Motion = Sequence[FloatArray]
"""An angle and its first two derivatives, each (n_samples, n_joints)."""

SPRING, ZERO = "ground-spring", "encoder-zero"
DELAY, TORSION = "torque-delay", "gear-torsion"
CORRECTIONS = (ZERO, DELAY, TORSION)
"""Effects that correct the signals; the others add torques."""

# of (S16), as in the core: velocity [rad/s] of the stated friction, and offset of its ratio
_POWER_VELOCITY, _POWER_OFFSET = 100.0, 0.01


_LAWS: Mapping[str, Callable[[FloatArray, FloatArray, float], FloatArray]] = {
    "load-friction": lambda velocity, load, shape: np.abs(load),  # (S15)
    "load-speed-friction": lambda velocity, load, shape: np.abs(load * velocity),
    # without the direction of motion: the offset is that at the speed of the shape
    "direction-friction": lambda velocity, load, shape: velocity - shape * np.sign(velocity),
    "stribeck": lambda velocity, load, shape: np.exp(-((velocity / shape) ** 2)),  # (S10)
    "power-friction": lambda velocity, load, shape: (  # (S16)
        (np.abs(velocity) / _POWER_VELOCITY + _POWER_OFFSET) ** shape - _POWER_OFFSET**shape
    ),
}
"""Friction over velocity, load and shape, without the direction of motion, per unit of its size."""


def friction_per_size(
    effect: str, shape: float, velocity: FloatArray, load: FloatArray
) -> FloatArray:
    """Friction of an effect per unit of its size, against the motion: (n_samples,).

    `velocity` [rad/s] is that of the motor, `load` [N m] the torque of the gear at the motor.
    """
    return _LAWS[effect](velocity, load, shape)


LOAD_TERMS = "load-friction", "load-speed-friction"
"""Friction that grows with the load of the gear."""


def gear_load(
    arm: Arm,
    solution: FloatArray,
    links: Motion,
    payload: Payload | None = None,
    motor_share: float | FloatArray = MOTOR_SHARE,
) -> FloatArray:
    """Torque that the gears transmit, at the motor: (n_samples, n_joints) [N m].

    That of the bodies without the rotors, which accelerate on the motor's side of the gear.
    `motor_share` is the rotors' share of inertias that rigid motion does not separate from
    theirs; `links` are angle, velocity and acceleration of the links.
    """
    base = arm.links_of_rigid(motor_share) @ solution[: arm.n_body] + arm.payload_vector(payload)
    return arm.motors_of(arm.link_torques(base, *links))


def link_motion(arm: Arm, motors: Motion, torsion: Motion = ()) -> list[FloatArray]:
    """Motion of the links for that of the motors, behind gears with a measured torsion."""
    links = [arm.links_of(x) for x in motors]
    return [q - twist for q, twist in zip(links, torsion, strict=True)] if torsion else links


def body_regressor(
    arm: Arm, links: Motion, torsion: Motion = (), motor_share: float | FloatArray = MOTOR_SHARE
) -> FloatArray:
    """Motor torques per parameter of the bodies: (n_samples, n_joints, n_body).

    The rotors accelerate before the gears, whose `torsion` may be measured.
    """
    phi = arm.rigid_regressor(*links)
    if len(torsion):
        arm.add_rotor_torques(phi, torsion[2], arm.motors_of_rigid(motor_share))
    return phi


def torsion_motion(signals: Signals) -> tuple[FloatArray, ...]:
    """Measured torsion of the gears and its derivatives, at every sample; empty without one."""
    if signals.torsion is None:
        return ()
    velocity = differentiate(signals.torsion, signals.sample_time)
    return signals.torsion, velocity, differentiate(velocity, signals.sample_time)


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


def _sizes_of(effect: str, arm: Arm, terms: Sequence[FrictionTerm]) -> FloatArray:
    """Sum of the sizes of an effect in each joint: (n_joints,)."""
    sizes = np.zeros(arm.n_joints)
    for term in terms:
        if term.effect == effect and term.joint is not None:
            sizes[term.joint - 1] += term.size.value or 0.0
    return sizes


def corrected_signals(signals: Signals, arm: Arm, terms: Sequence[FrictionTerm]) -> Signals:
    """The signals with encoder zeros added to angles, torques without delays, and torsions."""
    values = [
        (term.effect, (term.joint or 0) - 1, term.size.value or 0.0)
        for term in terms
        if term.effect in CORRECTIONS
    ]
    return correct(signals, arm, values)


def correct(signals: Signals, arm: Arm, values: Sequence[tuple[str, int, float]]) -> Signals:
    """The signals corrected by values of effects, the joints from 0."""
    if not values:
        return signals
    zero, compliance, torque = np.zeros(arm.n_joints), np.zeros(arm.n_joints), signals.motor_torque
    for effect, i, value in values:
        if effect == ZERO:
            zero[i] += value
        elif effect == TORSION:
            compliance[i] += value
        else:
            late = signals.time + value
            columns = [np.interp(late, signals.time, column) for column in torque.T]
            torque = np.column_stack(columns)
    angle = signals.motor_angle + arm.motor_accelerations(zero)
    torsion = signals.torsion
    if compliance.any():
        torsion = compliance * arm.joints_of(torque) + (0.0 if torsion is None else torsion)
    return replace(signals, motor_angle=angle, motor_torque=torque, torsion=torsion)


_BLOCK_SIZE = 1 << 16  # samples per regressor, which limits its memory
MAX_STICTION_SHARE = 0.5
"""Share of a record in possible stiction above which a motor does not count as moving."""


@dataclass(frozen=True, slots=True)
class FilteredTorques:
    """Measured and predicted motor torques after one filter, without its transients."""

    time: FloatArray  # (n_rows,)
    measured: FloatArray  # (n_rows, n_joints) [N m]
    predicted: FloatArray  # (n_rows, n_joints) [N m]
    fit_percent: FloatArray  # (n_joints,); NaN for a motor that mostly sticks


def fit_percent(measured: FloatArray, predicted: FloatArray) -> FloatArray:
    """100 (1 - |y - yhat| / |y - mean(y)|) for each channel; NaN for a constant channel.

    `measured` and `predicted` have shape (n_samples, n_channels).
    """
    # contiguous channels are summed in one order, however many there are
    y, y_hat = (np.ascontiguousarray(x.T) for x in (measured, predicted))
    spread = np.linalg.norm(y - y.mean(axis=1, keepdims=True), axis=1)
    error = np.linalg.norm(y - y_hat, axis=1)
    ratio = np.divide(error, spread, out=np.full_like(error, np.nan), where=spread > 0)
    return np.asarray(100.0 * (1.0 - ratio))


def band_fit(
    arm: Arm,
    solution: FloatArray,
    signals: Signals,
    model_hz: float,
    friction_terms: Sequence[FrictionTerm],
) -> FloatArray:
    """Fit [%] of a model to a record's torques within its bandwidth: (n_joints,).

    Equal to the fit of `band_prediction`, with less memory.
    """
    T, signals = signals.sample_time, corrected_signals(signals, arm, friction_terms)
    torque = predict_torque(arm, solution, signals, _bridge(model_hz, T), friction_terms)
    fits = []
    for i in range(torque.shape[1]):
        column = slice(i, i + 1)
        measured = low_pass(signals.motor_torque[:, column], model_hz, T)
        predicted = low_pass(torque[:, column], model_hz, T)
        fits.append(_fit(measured, predicted, signals.direction[:, column], model_hz, T))
    return np.concatenate(fits)


def band_prediction(
    arm: Arm,
    solution: FloatArray,
    signals: Signals,
    model_hz: float,
    friction_terms: Sequence[FrictionTerm],
) -> FilteredTorques:
    """Predict a record's torques from its motion, within a model's bandwidth.

    `solution` (n_parameters,) has the order of `Arm.rigid_columns`. `model_hz` is the bandwidth in
    which the model was estimated.
    """
    T, signals = signals.sample_time, corrected_signals(signals, arm, friction_terms)
    torque = predict_torque(arm, solution, signals, _bridge(model_hz, T), friction_terms)
    measured, predicted = (low_pass(x, model_hz, T) for x in (signals.motor_torque, torque))
    inside = _inside(measured, model_hz, T)
    fit = _fit(measured, predicted, signals.direction, model_hz, T)
    return FilteredTorques(signals.time[inside], measured[inside], predicted[inside], fit)


def _bridge(model_hz: float, T: float) -> int:
    """Samples in half a period of the band: the longest uncertain direction in a reversal."""
    return int(0.5 / (model_hz * T))


def _fit(
    measured: FloatArray, torque: FloatArray, direction: FloatArray, model_hz: float, T: float
) -> FloatArray:
    """Fit inside the filter's transients for each joint; NaN for a motor that mostly sticks."""
    inside = _inside(measured, model_hz, T)
    mostly_sticks = (
        standing(direction[inside], _bridge(model_hz, T)).mean(axis=0) > MAX_STICTION_SHARE
    )
    return np.where(mostly_sticks, np.nan, fit_percent(measured[inside], torque[inside]))


def _inside(signal: FloatArray, model_hz: float, T: float) -> slice:
    """Samples outside the transients of the band's filter."""
    edge = int(1.0 / (model_hz * T))
    return slice(edge, len(signal) - edge)


def predict_torque(
    arm: Arm,
    solution: FloatArray,
    signals: Signals,
    longest_bridge: int,
    friction_terms: Sequence[FrictionTerm],
) -> FloatArray:
    """Motor torques of the rigid model for a corrected motion: (n_samples, n_joints) [N m].

    In a brief reversal, of up to `longest_bridge` samples, Coulomb friction changes linearly from
    one direction to the other. A motor that sticks for longer has a set of possible torques, +-f
    around the other terms. The result is then the member of the set closest to the measured torque,
    so that the residual is the distance from the set.
    """
    direction = np.column_stack([_bridge_gaps(d) for d in signals.direction.T])
    sticks = standing(signals.direction, longest_bridge)
    motion = signals.motor_angle, signals.motor_velocity, signals.motor_acceleration
    torsion = torsion_motion(signals)
    torque, payload = np.empty_like(signals.motor_torque), signals.experiment.payload
    for start in range(0, len(torque), _BLOCK_SIZE):
        block = slice(start, start + _BLOCK_SIZE)
        motors, twist = ([x[block] for x in each] for each in (motion, torsion))
        parts = torque_parts(arm, solution, motors, friction_terms, payload, twist)
        smooth, limit = parts.body + parts.smooth_friction, np.abs(parts.dry_friction)
        sticking = smooth + np.clip(signals.motor_torque[block] - smooth, -limit, limit)
        sliding = smooth + parts.dry_friction * direction[block]
        torque[block] = np.where(sticks[block], sticking, sliding)
    return torque


@dataclass(frozen=True, slots=True)
class TorqueParts:
    """Motor torques of a rigid model, each (n_samples, n_joints) [N m]."""

    body: FloatArray  # that moves links and motors, and bends springs
    smooth_friction: FloatArray  # viscous friction and offset
    dry_friction: FloatArray  # to be multiplied by the direction of the motion

    def friction(self, direction: FloatArray) -> FloatArray:
        """Torque of all friction for directions -1, 0 or 1."""
        return np.asarray(self.smooth_friction + self.dry_friction * direction)


def torque_parts(
    arm: Arm,
    solution: FloatArray,
    motion: Motion | FloatArray,
    friction_terms: Sequence[FrictionTerm],
    payload: Payload | None = None,
    torsion: Motion = (),
) -> TorqueParts:
    """Parts of the motor torque for a motion of the motors and of the gears."""
    velocity, links = motion[1], link_motion(arm, list(motion), torsion)
    viscous, coulomb, offset = arm.joint_friction(solution).T
    load = gear_load(arm, solution, links, payload)
    body = load + arm.motors_of_rigid(MOTOR_SHARE) @ solution[: arm.n_body] * motion[2]
    smooth = viscous * velocity + offset
    if arm.n_shared:
        smooth += arm.shared_friction_regressor(velocity) @ solution[-arm.n_shared :]
    dry = coulomb + additional_friction(friction_terms, velocity, load)
    springs = arm.motors_of(_sizes_of(SPRING, arm, friction_terms) * links[0])
    return TorqueParts(body + springs, smooth, dry)


def inverse_dynamics(arm: Arm, model: RigidModel, motion: Motion | FloatArray) -> FloatArray:
    """Motor torques of a rigid model for a motion of the motors: (n_samples, n_joints) [N m].

    Dry friction is zero where the velocity is exactly zero. Angles are those of the encoders.
    """
    zero = arm.motor_accelerations(_sizes_of(ZERO, arm, model.friction_terms))
    corrected = [motion[0] + zero, *motion[1:]]
    parts = torque_parts(arm, model.solution, corrected, model.friction_terms)
    return np.asarray(parts.body + parts.friction(np.sign(motion[1])))


def standing(direction: FloatArray, longest_bridge: int) -> BoolArray:
    """Samples at which the direction is uncertain for longer than `longest_bridge` samples."""
    result = np.zeros(direction.shape, dtype=bool)
    for i, column in enumerate(direction.T):
        edges = np.flatnonzero(np.diff(np.r_[False, column == 0.0, False].astype(np.int8)))
        for start, stop in edges.reshape(-1, 2).tolist():
            result[start:stop, i] = stop - start > longest_bridge
    return result


def _bridge_gaps(direction: FloatArray) -> FloatArray:
    """Directions, linearly interpolated over uncertain sections; zero if none is known."""
    known = np.flatnonzero(direction)
    if not known.size:
        return direction
    return np.interp(np.arange(len(direction)), known, direction[known])


def base_parameters(model: RigidModel, arm: Arm) -> FloatArray:
    """Base parameters (n_base,) of the arm from the rigid model.

    An inertia that rigid motion does not separate, such as alpha + m_M1/n1^2, counts as the link's;
    see `interaction_torques`. Raises NotIdentifiable if a parameter is unknown.
    """
    rows = arm.links_of_rigid()
    solution = [
        known(model, *column.key) if row.any() else 0.0
        for column, row in zip(arm.rigid_columns[: arm.n_body], rows.T, strict=True)
    ]
    return np.asarray(rows @ np.array(solution))


def interaction_torques(
    arm: Arm,
    base: FloatArray,
    angle: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    postures: FloatArray | None = None,
) -> FloatArray:
    """Torque of the other links, of velocities and of gravity on each link, (13), (14).

        tau_i = mbar_i ddq_i - [M(q) ddq + c(q, dq) + g(q)]_i,   mbar_i = M(postures_i)_ii

    For two links mbar_1 = alpha + beta + 2 gamma cos q2 and mbar_2 = beta, so that tau_1 does not
    depend on alpha, which is part of both mbar_1 and M_11: alpha + m_M1/n1^2 can replace it.
    Motions are those of the links, relative: (n_samples, n_joints). Row i of `postures` (n_joints,
    n_joints) has the link angles at which mbar_i is taken; None: all are zero. `base` is from
    `base_parameters`.
    """
    at = np.zeros((arm.n_joints, arm.n_joints)) if postures is None else postures
    own = [arm.inertia_matrix(base, posture)[i, i] for i, posture in enumerate(at)]
    return np.asarray(own * acceleration - arm.link_torques(base, angle, velocity, acceleration))


def mean_postures(records: Sequence[LinkSignals]) -> FloatArray:
    """Posture of each joint in the records that excite it, (n_joints, n_joints) [rad].

    Row i is the mean of the link angles over the full-amplitude records that excite joint i, over
    its other records if there are none, or over all records.
    """
    postures = []
    for number in range(1, records[0].link_angle.shape[1] + 1):
        own = [r for r in records if r.experiment.joint in (None, number)]
        full = [r for r in own if r.experiment.use == "frequency"]
        chosen = full or own or records
        postures.append(np.mean([r.link_angle.mean(axis=0) for r in chosen], axis=0))
    return np.array(postures)


def base_variations(model: RigidModel, arm: Arm) -> FloatArray:
    """Derivatives of the base parameters with respect to the rigid model's solution.

    Shape (n_links, n_parameters). Lumped inertias cancel in `interaction_torques` and have zero
    derivatives.
    """
    derivatives = np.zeros((len(arm.base_names), len(model.parameters)))
    derivatives[:, : arm.n_body] = arm.links_of_rigid(motor_share=1.0)
    return derivatives


def total_inertias(model: RigidModel, arm: Arm, postures: FloatArray | None = None) -> FloatArray:
    """c_1 = m_M + n^2 m_L of (18), motor side: (n_joints,) [kg m^2].

    m_L is that of each joint in its posture; None: all angles are zero. Raises NotIdentifiable if
    a parameter is unknown.
    """
    at = np.zeros((arm.n_joints, arm.n_joints)) if postures is None else postures
    rows = [total_inertia(arm, joint, posture) for joint, posture in enumerate(at, start=1)]
    return np.array([sum(w * known(model, *key) for key, w in row.items()) for row in rows])


def known(model: RigidModel, name: str, joint: int | None) -> float:
    """Value of a parameter that decoupling needs.

    Raises NotIdentifiable if the motion records do not identify it.
    """
    value = model.value(name, joint)
    if value is None:
        place = f" of joint {joint}" if joint else ""
        raise NotIdentifiable(
            f"the decoupled step needs {name}{place}, which the motion records do not identify"
        )
    return value
