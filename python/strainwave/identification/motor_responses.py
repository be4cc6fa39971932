"""Frequency response of the excited motor, measured and of the fitted arm.

The fitted arm is simulated with the voltages of the record, and both responses are computed in the
same way. Friction, stiffness curves and the window therefore affect both alike. The response
depends on the other joints: while they are free, it has more modes than while they are held.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

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
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.keys import Key
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Samples, plan_run, simulate_runs
from strainwave.identification.closed_loop import restrict_to_values, velocity_band
from strainwave.numerics.filters import differentiate
from strainwave.numerics.parallel import run_parallel
from strainwave.numerics.spectra import cross_spectral_densities
from strainwave.signals.prepared_record import prepare_record
from strainwave.signals.recorded_input import driven_by_voltage

_MAX_SEGMENT_SECONDS = 8.0  # [s] maximum duration of a Welch segment
_FIRST_LINE = 3.0  # first line; the window spreads a constant over the lines below
_MAX_DAMPING_RATIO = 0.5  # maximum damping ratio of a visible dip or peak
# share of the highest frequency below which a frequency is a rounding error
_MIN_FREQUENCY_SHARE = 1e-6
# minimum share of the largest torque density; lines without excitation are left out
_MIN_POWER_SHARE = 1e-4


def motor_responses(
    logs: Sequence[Log], model: ArmModel, joints: Sequence[JointModel], arm: Arm
) -> list[MotorResponse]:
    """Frequency responses from motor torque to motor velocity, of the rig and of the fitted arm.

    Cross-spectra S_uw / S_uu by Welch's method over segments of at most half the record. Each of
    `logs` must name its joint. `joints` gives the equivalent stiffness of nonlinear gears.

    Raises `InvalidInput` if a log lacks a motor angle or voltage, or names no joint;
    `NumericalFailure` if a simulated motion is not finite.
    """
    plans = []
    for log in logs:
        driven, drive = driven_by_voltage(arm, log)
        plan = plan_run(
            restrict_to_values(driven, model.values),
            dict(model.values),
            drive,
            sample_time=log.sample_time,
            samples=len(log),
            record=["motor_torque", "motor_angle"],
        )
        plans.append(plan)
    runs = simulate_runs(plans)
    of_logs = zip(logs, runs, strict=True)
    return run_parallel([partial(_response, log, run, model, joints, arm) for log, run in of_logs])


def _response(
    log: Log, run: Samples, model: ArmModel, joints: Sequence[JointModel], arm: Arm
) -> MotorResponse:
    """Response of one motor from its record and the simulated one."""
    number, T = log.experiment.joint or 1, log.sample_time
    motor_angle = prepare_record(log, arm).motor_angle
    angles = np.column_stack([motor_angle[:, number - 1], run["motor_angle"][:, number - 1]])
    columns = np.column_stack([run["motor_torque"][:, number - 1], differentiate(angles, T)])
    segment = min(len(log) // 2, round(_MAX_SEGMENT_SECONDS / T))
    frequency, density = cross_spectral_densities(columns, T, segment)
    power = density[:, 0, 0].real
    inside = (frequency >= _FIRST_LINE * frequency[1]) & (frequency <= velocity_band(log, arm))
    inside &= power > _MIN_POWER_SHARE * power[inside].max(initial=0.0)
    measured, fitted = (density[inside, 0, k] / power[inside] for k in (1, 2))
    coherence = np.abs(density[inside, 0, 1]) ** 2
    coherence = coherence / np.maximum(power[inside] * density[inside, 1, 1].real, 1e-300)
    condition = _condition(log, arm)
    posture = arm.links_of(motor_angle.mean(axis=0))
    values = dict(model.values)
    for joint in joints:  # equivalent stiffness of nonlinear gears at the records' amplitude
        key = (STIFFNESS, joint.joint)
        if key not in values or arm.joints[joint.joint - 1].law.is_curved:
            values[key] = joint.values[STIFFNESS]
    is_servoed = condition == "others-servoed"
    zeros, poles = modes_of_motor(values, arm, posture, number, servoed=is_servoed)
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
    values: Mapping[Key, float], arm: Arm, link_angle: FloatArray, joint: int, *, servoed: bool
) -> tuple[FloatArray, FloatArray]:
    """Anti-resonances and resonances [Hz] of one motor's response to its torque, about a posture.

    The zeros from torque to velocity are the modes of the arm with that motor held; the poles are
    the modes with it free. Servos of other joints act on their motors as a damper e kp and a spring
    e ki. An unknown servo is assumed to hold its motor.

    `values` maps (name, joint) to a value, with one `gear_stiffness` per joint. `link_angle` is
    (n_joints,) [rad]; `joint` counts from 1. `servoed` is True if the other motors are under servo
    control, False if they are free.

    Both results are (n,), ascending: moduli of the lightly damped pairs over 2 pi.
    """
    n, others = arm.n_joints, [i for i in range(arm.n_joints) if i != joint - 1]
    base = np.array([values.get(key, 0.0) for key in arm.base_names])

    def each(name: str) -> FloatArray:
        return np.array([values.get((name, i), 0.0) for i in range(1, n + 1)])

    inertia = np.zeros((2 * n, 2 * n))  # motors first, then links
    inertia[:n, :n] = np.diag(each("motor_inertia"))
    inertia[n:, n:] = arm.inertia_matrix(base, link_angle)
    springs = _coupling_matrix(arm.transmission, each("gear_stiffness"))
    dampers = _coupling_matrix(arm.transmission, each("gear_damping"))
    viscous = [each("motor_viscous_friction"), each("link_viscous_friction")]
    dampers += np.diag(np.concatenate(viscous))
    moving = np.ones(2 * n, dtype=bool)
    for i in others if servoed else ():
        per_volt = arm.joints[i].known_torque_per_volt
        if arm.servo is None or per_volt is None:
            moving[i] = False
        else:
            dampers[i, i] += per_volt * arm.servo.kp[i]
            # the integral action of a position loop is slower than any mode
            outer = 0.0 if arm.servo.position_gain is None else arm.servo.position_gain[i]
            springs[i, i] += per_volt * (arm.servo.ki[i] + outer * arm.servo.kp[i])
    others_moving = moving.copy()
    others_moving[joint - 1] = False
    return (
        _lightly_damped_frequencies(inertia, dampers, springs, others_moving),
        _lightly_damped_frequencies(inertia, dampers, springs, moving),
    )


def _coupling_matrix(transmission: FloatArray, gear: FloatArray) -> FloatArray:
    """Matrix (2 n, 2 n) of springs or dampers of the gears, by motors and links."""
    torsion = np.hstack([transmission, -np.eye(len(gear))])  # of each gear, by motors and links
    return np.asarray(torsion.T * gear @ torsion)


def _lightly_damped_frequencies(
    inertia: FloatArray, dampers: FloatArray, springs: FloatArray, moving: BoolArray
) -> FloatArray:
    """Frequencies [Hz] of the lightly damped modes of M s^2 + D s + K in the moving coordinates."""
    index, count = np.ix_(moving, moving), int(moving.sum())
    lower_rows = np.linalg.solve(inertia[index], np.hstack([-springs[index], -dampers[index]]))
    upper_rows = np.eye(count, 2 * count, count)
    roots = np.linalg.eigvals(np.vstack([upper_rows, lower_rows]))
    # excludes rigid-body modes
    is_oscillating = roots.imag > _MIN_FREQUENCY_SHARE * np.abs(roots).max()
    lightly_damped = roots[is_oscillating & (-roots.real < _MAX_DAMPING_RATIO * np.abs(roots))]
    return np.asarray(np.sort(np.abs(lightly_damped)) / (2.0 * np.pi))


def _condition(log: Log, arm: Arm) -> Condition:
    others = [c for i, c in enumerate(log.experiment.control, 1) if i != log.experiment.joint]
    if arm.n_joints == 1:
        return "alone"
    return "others-servoed" if "servo" in others else "others-free"
