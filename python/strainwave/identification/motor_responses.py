"""Log, ArmModel -> MotorResponse: how the excited motor answers its torque, measured and fitted.

The fitted arm goes through the record again under its voltages, and one estimate is made of both:
so friction, knees and the window do to one what they do to the other. What the other joints do is
part of the answer: while they are free to move, a motor sees more modes than while they are held.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from strainwave.domain import (
    ArmModel,
    BoolArray,
    Condition,
    FloatArray,
    JointModel,
    Log,
    MotorResponse,
)
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate_arms
from strainwave.identification.closed_loop import as_known, velocity_band
from strainwave.numerics.filters import differentiate
from strainwave.numerics.spectra import cross_spectral_densities
from strainwave.signals.recorded_input import driven_by_voltage

_SEGMENT = 8.0  # [s] at most of a record in one spectrum
_LOWEST = 3.0  # lines that the window makes of a constant
_DAMPED = 0.5  # ratio up to which a mode shows as a dip or a peak
_ROUNDING = 1e-6  # of the highest frequency, below which there is none
_SEEN = 1e-4  # of the largest torque density: lines that the excitation leaves out are left out


def motor_response(
    log: Log, model: ArmModel, joints: Sequence[JointModel], arm: Arm
) -> MotorResponse:
    """Motor torque to motor velocity in one record, of the rig and of the fitted arm.

    Cross-spectra S_uw / S_uu by Welch's method over windows of half the record.

    `log`: Of an experiment that names its joint.
    `joints`: For the equivalent stiffness of curves.

    Raises `InvalidInput`: the log lacks a motor's angle or voltage, or names no joint;
    `NumericalFailure`: the motion left the finite numbers.
    """
    driven, drive = driven_by_voltage(arm, log)
    runs = simulate_arms(
        as_known(driven, model.values),
        [dict(model.values)],
        drive,
        sample_time=log.sample_time,
        samples=len(log),
        record=["motor_torque", "motor_angle"],
    )
    number, T = log.experiment.joint or 1, log.sample_time
    angles = np.column_stack(
        [log.channels[f"theta_m{number}"], runs["motor_angle"][0, :, number - 1]]
    )
    columns = np.column_stack([runs["motor_torque"][0, :, number - 1], differentiate(angles, T)])
    segment = min(len(log) // 2, round(_SEGMENT / T))
    frequency, density = cross_spectral_densities(columns, T, segment)
    power = density[:, 0, 0].real
    inside = (frequency >= _LOWEST * frequency[1]) & (frequency <= velocity_band(log, arm))
    inside &= power > _SEEN * power[inside].max(initial=0.0)
    measured, fitted = (density[inside, 0, k] / power[inside] for k in (1, 2))
    coherence = np.abs(density[inside, 0, 1]) ** 2
    coherence = coherence / np.maximum(power[inside] * density[inside, 1, 1].real, 1e-300)
    condition = _condition(log, arm)
    posture = arm.gear_ratios * np.array(
        [np.mean(log.channels[f"theta_m{i}"]) for i in range(1, arm.n_joints + 1)]
    )
    values, servoed = _one_stiffness(model.values, joints, arm), condition == "others-servoed"
    zeros, poles = modes_of_motor(values, arm, posture, number, servoed=servoed)
    return MotorResponse(
        experiment=log.name,
        joint=number,
        condition=condition,
        frequencies_hz=frequency[inside],
        measured=measured,
        fitted=fitted,
        coherence=np.asarray(coherence),
        anti_resonances_hz=tuple(zeros.tolist()),
        resonances_hz=tuple(poles.tolist()),
    )


def modes_of_motor(
    values: Mapping[tuple[str, int | None], float],
    arm: Arm,
    link_angle: FloatArray,
    joint: int,
    *,
    servoed: bool,
) -> tuple[FloatArray, FloatArray]:
    """Anti-resonances and resonances of one motor's response to its torque, about a posture.

    Zeros of torque to velocity are the arm's modes with that motor held, poles those with it free.
    Servos of other joints act on their motors as a damper e kp and a spring e ki; of an unknown
    servo it is assumed that it holds its motor.

    `values`: (name, joint) -> value, with one `gear_stiffness` a joint.
    `link_angle` (n_joints,) [rad].
    `joint`: Whose motor is driven, from 1.
    `servoed`: Whether the other motors are under their servos, rather than free.

    Returns: `anti_resonances, resonances` (n,) [Hz]: Moduli of the lightly damped pairs over 2 pi,
    ascending.
    """
    n, others = arm.n_joints, [i for i in range(arm.n_joints) if i != joint - 1]
    base = np.array([values.get(key, 0.0) for key in arm.base_names])

    def each(name: str) -> FloatArray:
        return np.array([values.get((name, i), 0.0) for i in range(1, n + 1)])

    inertia = np.zeros((2 * n, 2 * n))  # motors first, then links
    inertia[:n, :n] = np.diag(each("motor_inertia"))
    inertia[n:, n:] = arm.inertia_matrix(base, link_angle)
    springs = _across(arm.gear_ratios, each("gear_stiffness"))
    dampers = _across(arm.gear_ratios, each("gear_damping"))
    viscous = [each("motor_viscous_friction"), each("link_viscous_friction")]
    dampers += np.diag(np.concatenate(viscous))
    moving = np.ones(2 * n, dtype=bool)
    for i in others if servoed else ():
        per_volt = arm.joints[i].torque_per_volt
        if arm.servo is None or per_volt is None:
            moving[i] = False
        else:
            dampers[i, i] += per_volt * arm.servo.kp[i]
            # a position loop's own integral is slower than any mode
            outer = 0.0 if arm.servo.position_gain is None else arm.servo.position_gain[i]
            springs[i, i] += per_volt * (arm.servo.ki[i] + outer * arm.servo.kp[i])
    without = moving.copy()
    without[joint - 1] = False
    return (
        _rings(inertia, dampers, springs, without),
        _rings(inertia, dampers, springs, moving),
    )


def _across(ratio: FloatArray, gear: FloatArray) -> FloatArray:
    """A spring or damper between every motor and its link: (2 n, 2 n)."""
    motor, between = np.diag(ratio**2 * gear), -np.diag(ratio * gear)
    return np.block([[motor, between], [between, np.diag(gear)]])


def _rings(
    inertia: FloatArray, dampers: FloatArray, springs: FloatArray, moving: BoolArray
) -> FloatArray:
    """Frequencies [Hz] of the modes of M s^2 + D s + K that ring, of the coordinates that move."""
    at, count = np.ix_(moving, moving), int(moving.sum())
    blocks = np.linalg.solve(inertia[at], np.hstack([-springs[at], -dampers[at]]))
    upper = np.eye(count, 2 * count, count)
    roots = np.linalg.eigvals(np.vstack([upper, blocks]))
    sure = roots.imag > _ROUNDING * np.abs(roots).max()  # not what turns without being held
    ringing = roots[sure & (-roots.real < _DAMPED * np.abs(roots))]
    return np.asarray(np.sort(np.abs(ringing)) / (2.0 * np.pi))


def _condition(log: Log, arm: Arm) -> Condition:
    others = [c for i, c in enumerate(log.experiment.control, 1) if i != log.experiment.joint]
    if arm.n_joints == 1:
        return "alone"
    return "others-servoed" if "servo" in others else "others-free"


def _one_stiffness(
    values: Mapping[tuple[str, int | None], float], joints: Sequence[JointModel], arm: Arm
) -> dict[tuple[str, int | None], float]:
    """Of gears with curves the stiffness that stands for them at the records' amplitude."""
    found = dict(values)
    for joint in joints:
        key = (STIFFNESS, joint.joint)
        if key not in found or arm.joints[joint.joint - 1].law.is_curved:
            found[key] = joint.values[STIFFNESS]
    return found
