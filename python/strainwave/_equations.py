"""Signals of one record -> filtered, decimated linear equations in the base parameters.

Friction enters as viscous * dq + Coulomb * sgn(dq) + offset where the motor slides. Where it may
stand, its Coulomb friction is an unknown of that stretch alone. Elastic joints are seen to first
order: the link lags behind the motor by its torque over the gear's stiffness, (1), (2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave import _regressor
from strainwave._filters import differentiate, low_pass
from strainwave._friction import free_friction
from strainwave.records import FloatArray, Signals, Study

_ROWS_PER_CUTOFF = 4.0  # sampling rate after decimation, in cut-offs; nothing is left at half of it
MOTOR_SHARE = 0.5
"""Share of joint 1's rigid inertia taken for its motor's.

The two only come apart through the gear's compliance. Designs match them within a factor of a few;
the compliance, which is fitted, takes up what is wrong with the share.
"""


@dataclass(frozen=True, slots=True)
class Column:
    """One parameter: its name, joint and unit."""

    name: str
    joint: int | None
    unit: str


def columns_of(study: Study) -> tuple[Column, ...]:
    """The rigid model's parameters of a study, inertial ones first, then friction by joint."""
    prismatic = study.joints[0].motion == "prismatic"
    gravity = study.arm.gravity is not None
    if study.arm.kind == "single-joint":
        body = [Column("inertia", 1, "kg" if prismatic else "kg m^2")]
        if gravity:
            body.append(Column("gravity_torque_1", None, "N" if prismatic else "N m"))
    else:
        body = [
            Column("rigid_inertia", 1, "kg m^2"),
            Column("motor_inertia", 2, "kg m^2"),
            Column("beta", None, "kg m^2"),
            Column("gamma", None, "kg m^2"),
        ]
        if gravity:
            body += [Column(f"gravity_torque_{i}", None, "N m") for i in (1, 2)]
    for number, joint in enumerate(study.joints, start=1):
        torque, viscous = ("N", "N s/m") if joint.motion == "prismatic" else ("N m", "N m s/rad")
        rigid_drive = study.arm.kind == "single-joint" and joint.spring == "rigid"
        name = "motor_viscous_friction" if rigid_drive else "total_viscous_friction"
        body += [
            Column(name, number, viscous),
            Column("motor_coulomb_friction", number, torque),
            Column("friction_offset", number, torque),
        ]
    return tuple(body)


def body_regressor(
    study: Study, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Motor torques per inertial and gravity parameter, at link-side motion.

    Parameters
    ----------
    study : Study
    angle, velocity, acceleration : (n_samples, n_joints)

    Returns
    -------
    (n_samples, n_joints, n_body)
    """
    n = np.array([joint.gear_ratio for joint in study.joints])
    if study.arm.kind == "single-joint":
        phi = _regressor.single_joint(angle, acceleration, float(n[0]))
        return phi if study.arm.gravity is not None else phi[:, :, :1]
    phi = _regressor.two_link(angle, velocity, acceleration, n)
    return phi if study.arm.gravity is not None else phi[:, :, :4]


@dataclass(frozen=True, slots=True)
class Stretch:
    """What of one record's equations does not depend on the parameters."""

    signals: Signals
    bandwidth_hz: float
    rows: FloatArray  # (n_rows,) samples kept
    keep: FloatArray  # (n_rows, n_joints) bool
    torque: FloatArray  # (n_rows, n_joints)
    friction: FloatArray  # (n_rows, n_joints, 3) per dq, sgn(dq), 1
    free: tuple[FloatArray, ...]  # per joint (n_rows, n_free)


def prepare(signals: Signals, bandwidth_hz: float) -> Stretch:
    """Filter and decimate one record's torque, friction columns and free friction.

    Parameters
    ----------
    signals : Signals
    bandwidth_hz : float [Hz]
        Of the filter that both sides of the equations pass.

    Returns
    -------
    Stretch
    """
    T = signals.sample_time
    reach = 1.0 / (bandwidth_hz * T)  # samples after which the filter has forgotten
    rows = np.arange(int(reach), len(signals.time) - int(reach), decimation(T, bandwidth_hz))
    sides = [signals.motor_velocity, signals.direction, np.ones_like(signals.motor_velocity)]
    friction = low_pass(np.stack(sides, axis=2), bandwidth_hz, T)[rows]
    keep = np.column_stack(
        [_clear_of(~signals.valid[:, i], int(reach / 2))[rows] for i in range(friction.shape[1])]
    )
    free = []
    for i in range(friction.shape[1]):
        shapes = free_friction(signals.direction[:, i], max(2, round(0.5 * reach)))
        free.append(_filtered_shapes(shapes, rows, len(signals.time), bandwidth_hz, T))
    return Stretch(
        signals=signals,
        bandwidth_hz=bandwidth_hz,
        rows=rows,
        keep=keep,
        torque=low_pass(signals.motor_torque, bandwidth_hz, T)[rows],
        friction=friction,
        free=tuple(free),
    )


def decimation(sample_time: float, bandwidth_hz: float) -> int:
    """Samples per equation kept."""
    return max(1, int(1.0 / (_ROWS_PER_CUTOFF * bandwidth_hz * sample_time)))


def elastic_body(
    study: Study, stretch: Stretch, link_torque: FloatArray | None, compliance: FloatArray
) -> FloatArray:
    """Filtered regressor of the body at the links' motion, Q - compliance * link torque.

    Motor inertias see the motors' acceleration, everything else the links'.

    Parameters
    ----------
    study : Study
    stretch : Stretch
    link_torque : (n_samples, n_joints) [N m] or None
        That the gears transmit, link side; None: rigid.
    compliance : (n_joints,) [rad/(N m)]
        Of the gears, link side.

    Returns
    -------
    (n_rows, n_joints, n_body)
    """
    signals = stretch.signals
    n = np.array([joint.gear_ratio for joint in study.joints])
    T = signals.sample_time
    Q, dQ = signals.motor_angle * n, signals.motor_velocity * n
    ddQ = signals.motor_acceleration * n
    if link_torque is not None and np.any(compliance):
        lag = link_torque * compliance
        dlag = differentiate(lag, T)
        ddlag = differentiate(dlag, T)
        phi = body_regressor(study, Q - lag, dQ - dlag, ddQ - ddlag)
        phi[:, 0, 0] += MOTOR_SHARE * body_regressor(study, Q, dQ, ddlag)[:, 0, 0]
        if study.arm.kind == "planar-two-link":
            phi[:, 1, 1] = signals.motor_acceleration[:, 1]
    else:
        phi = body_regressor(study, Q, dQ, ddQ)
    return low_pass(phi, stretch.bandwidth_hz, T)[stretch.rows]


def link_torque(study: Study, stretch: Stretch, value: FloatArray) -> FloatArray:
    """Torque through each gear, link side: motor torque less friction and the motor's inertia.

    Low-passed at twice the equations' bandwidth, for it is to be differentiated twice.

    Parameters
    ----------
    study : Study
    stretch : Stretch
    value : (n_parameters,)
        The current estimate.

    Returns
    -------
    (n_samples, n_joints) [N m]
    """
    signals = stretch.signals
    names = [(c.name, c.joint) for c in columns_of(study)]
    n_body = len(names) - 3 * study.n_joints
    result = np.empty_like(signals.motor_torque)
    for i, joint in enumerate(study.joints):
        viscous, coulomb, offset = value[n_body + 3 * i : n_body + 3 * i + 3]
        friction = viscous * signals.motor_velocity[:, i] + coulomb * signals.direction[:, i] + offset
        inertia = motor_inertias(study, value)[i]
        net = signals.motor_torque[:, i] - friction - inertia * signals.motor_acceleration[:, i]
        result[:, i] = net / joint.gear_ratio
    return low_pass(result, 2.0 * stretch.bandwidth_hz, signals.sample_time)


def motor_inertias(study: Study, value: FloatArray) -> FloatArray:
    """Inertia of each motor alone, motor side, as far as a rigid model can say."""
    n = study.joints[0].gear_ratio
    if study.arm.kind == "single-joint":
        return np.array([MOTOR_SHARE * value[0]])
    return np.array([MOTOR_SHARE * value[0] * n**2, value[1]])


def compliance_columns(
    study: Study, stretch: Stretch, torque: FloatArray, value: FloatArray
) -> FloatArray:
    """Filtered motor torque per compliance, -n_i M_ij ddT_j, the first order of the elasticity.

    Parameters
    ----------
    study : Study
    stretch : Stretch
    torque : (n_samples, n_joints) [N m]
        Through the gears, link side.
    value : (n_parameters,)

    Returns
    -------
    (n_rows, n_joints, n_joints)
        [motor joint, compliant joint]
    """
    signals = stretch.signals
    T = signals.sample_time
    n = np.array([joint.gear_ratio for joint in study.joints])
    jerk = differentiate(differentiate(torque, T), T)
    still = np.zeros_like(jerk)
    columns = np.empty((*jerk.shape, study.n_joints))
    inertial = np.array([not c.name.startswith("gravity") for c in columns_of(study)])
    n_body = len(value) - 3 * study.n_joints
    inertial = inertial[:n_body]
    body = value[:n_body].copy()
    body[0] *= 1.0 - MOTOR_SHARE
    if study.arm.kind == "planar-two-link":
        body[1] = 0.0
    for j in range(study.n_joints):
        one = still.copy()
        one[:, j] = jerk[:, j]
        phi = body_regressor(study, signals.motor_angle * n, still, one)[:, :, inertial]
        columns[:, :, j] = -phi @ body[inertial]
    return low_pass(columns, stretch.bandwidth_hz, T)[stretch.rows]


def column_noise(study: Study, stretch: Stretch) -> FloatArray:
    """Deviation of the noise that the angles' own noise leaves in each column.

    White noise s of the angle, sampled at T and low-passed at f, leaves s (2 pi f)^k sqrt(2 f T /
    (2 k + 1)) in the k-th derivative.

    Parameters
    ----------
    study : Study
    stretch : Stretch

    Returns
    -------
    (n_parameters,)
    """
    signals = stretch.signals
    f, T = stretch.bandwidth_hz, signals.sample_time
    n = np.array([joint.gear_ratio for joint in study.joints])
    first, second = (
        signals.angle_noise * (2.0 * np.pi * f) ** k * np.sqrt(min(1.0, 2.0 * f * T / (2 * k + 1)))
        for k in (1, 2)
    )
    at = slice(None, None, max(1, len(signals.time) // 200))
    angle = signals.motor_angle[at] * n
    still = np.zeros_like(angle)
    power = np.zeros(len(columns_of(study)))
    n_body = len(power) - 3 * study.n_joints
    still_phi = body_regressor(study, angle, still, still)
    for j in range(study.n_joints):
        noisy = still.copy()
        noisy[:, j] = second[j] * n[j]
        phi = body_regressor(study, angle, still, noisy) - still_phi
        power[:n_body] += np.mean(np.sum(phi**2, axis=1), axis=0) / study.n_joints
        power[n_body + 3 * j] = first[j] ** 2 / study.n_joints
    return np.asarray(np.sqrt(power))


def _clear_of(bad: FloatArray, reach: int) -> FloatArray:
    """Samples at least `reach` away from every bad one."""
    from scipy.ndimage import maximum_filter1d

    return np.asarray(maximum_filter1d(bad.astype(np.int8), 2 * max(1, reach) + 1) == 0)


def _filtered_shapes(
    shapes: list[tuple[int, FloatArray]],
    rows: FloatArray,
    n_samples: int,
    bandwidth_hz: float,
    T: float,
) -> FloatArray:
    """Each shape through the low-pass, at the kept rows; filtered within its reach only."""
    reach = int(3.0 / (bandwidth_hz * T))
    result = np.zeros((len(rows), len(shapes)))
    for k, (first, shape) in enumerate(shapes):
        begin, end = max(0, first - reach), min(n_samples, first + len(shape) + reach)
        window = np.zeros(end - begin)
        window[first - begin : first - begin + len(shape)] = shape
        inside = (rows >= begin) & (rows < end)
        result[inside, k] = low_pass(window, bandwidth_hz, T)[rows[inside] - begin]
    return result
