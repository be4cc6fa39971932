"""Record of the rigid motion: lead-in from standstill, periodic motion, lead-out.

Motions as trajectory_msgs/JointTrajectory, which ros2_control's controllers execute.

Simulation of a planned drive on the guessed arm.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from strainwave.domain import Experiment, FloatArray, Parameter, Use
from strainwave.domain.link_sensors.link_space import Quantity
from strainwave.dynamics.simulation import Drive, Trajectory, simulate
from strainwave.errors import InvalidInput
from strainwave.experiment_design.plan import (
    HELD_CONTROL,
    GuessedArm,
    LimitBroken,
    Planned,
    PredictedMotion,
    Waypoints,
    clock_of,
)
from strainwave.experiment_design.rigid_motion import (
    N_HARMONICS,
    Fourier,
    Motion,
    Search,
    condition_number,
    optimise,
    smallest_distance,
)
from strainwave.experiment_design.rigid_precision import (
    predicted_rigid_parameters,
    reference_sizes,
    standard_deviations,
)

_DISTANCE_INTERVAL = 0.01  # [s] between compared postures; links move by millimetres in it

_QUANTITIES: tuple[Quantity, ...] = (
    "link_angle",
    "motor_velocity",
    "voltage",
    "gear_torque",
    "sliding",
    "accelerometer",
)


def servo_drive(guess: GuessedArm, reference: FloatArray) -> Drive:
    """Drive of servos that follow references (n_ticks, n_joints), from rest."""
    control = (HELD_CONTROL,) * guess.arm.n_joints
    return guess.drive(clock_of(guess.arm), control, np.zeros_like(reference), reference)


def run(guess: GuessedArm, drive: Drive) -> Trajectory:
    """Response of the guessed arm to a drive: limited quantities and accelerometers."""
    clock = clock_of(guess.arm)
    samples = round(len(drive.voltage) * drive.tick / clock)
    return simulate(
        guess.arm, guess.values, drive, sample_time=clock, samples=samples, record=_QUANTITIES
    )


def followed_motion(guess: GuessedArm, motion: Motion) -> PredictedMotion:
    """Peak values of a motion of the links that a controller follows without error.

    The gears transmit what the motors give.
    """
    arm = guess.arm
    torque = arm.inverse_dynamics(arm.parameter_vector(guess.values), *motion)
    ratios = np.abs([joint.gear_ratio for joint in arm.joints])
    return PredictedMotion(
        **_reach(guess, motion[0]),
        velocity=np.asarray(np.abs(arm.motor_accelerations(motion[1])).max(axis=0)),
        voltage=np.asarray(np.abs(torque / arm.torque_per_volt).max(axis=0)),
        gear_torque=np.asarray(np.abs(torque / ratios).max(axis=0)),
        rest_share=np.zeros(arm.n_joints),
    )


def predicted_motion(guess: GuessedArm, drive: Drive) -> PredictedMotion:
    """Peak values of the guessed arm's response, and the share of time in which motors stick."""
    trajectory = run(guess, drive)

    def peak(name: Quantity) -> FloatArray:
        return np.asarray(np.abs(trajectory[name]).max(axis=0))

    return PredictedMotion(
        **_reach(guess, trajectory["link_angle"]),
        velocity=peak("motor_velocity"),
        voltage=peak("voltage"),
        gear_torque=peak("gear_torque"),
        rest_share=np.asarray((trajectory["sliding"] == 0.0).mean(axis=0)),
    )


def _reach(guess: GuessedArm, angle: FloatArray) -> dict[str, Any]:
    """Largest angles from the middle of the limits, and smallest distance of two links."""
    limits = guess.limits
    compared = angle[:: max(1, int(_DISTANCE_INTERVAL / clock_of(guess.arm)))]
    distance = smallest_distance(guess.arm, guess.values, compared, limits.distance)
    largest = np.asarray(np.abs(angle - limits.centre).max(axis=0))
    return {"angle": largest, "distance": float(distance.min())}


_MAX_MOTION_HZ = 1.0  # highest frequency of the motion
_MIN_RESONANCE_RATIO = 12.0  # anti-resonance over motion: the error of a rigid gear is 1/12^2
_MAX_PERIODS = 20  # 160 s or more, as a period takes at least 8 s
_TARGET_RELATIVE_STD = 0.002  # of each rigid parameter, due to the noise of the encoders
_WAYPOINTS_PER_CYCLE = 16  # of the highest harmonic; quintic splines then err by less than 1e-6
_LEAD_TIMES = np.arange(1.0, 10.5, 0.5)  # [s] candidates for lead-in and lead-out
_REDUCTION_FACTOR = 0.93  # per attempt, if the simulated arm violates a limit
_MAX_ATTEMPTS = 20  # reduce the motion to 1/4


def motion_records(
    guess: GuessedArm,
    *,
    anti_resonance_hz: float | None,
    starts: int,
    seed: int,
    torque_errors: FloatArray,
    longest: float = np.inf,
) -> tuple[Planned, ...]:
    """Record of the best motion, to be fitted, and of the second best, for validation.

    `anti_resonance_hz` is the lowest of the arm, None for rigid gears. `torque_errors` (n_joints,)
    are those of `standard_deviations`, for the predicted intervals. No record is longer than
    `longest` [s] if one period is not. Raises InvalidInput if the
    drives cannot hold the arm, and LimitBroken if no motion satisfies the limits.
    """
    top = _MAX_MOTION_HZ
    if anti_resonance_hz:
        top = min(top, anti_resonance_hz / _MIN_RESONANCE_RATIO)
    tick, limits = clock_of(guess.arm), guess.limits
    search = Search(guess, tick * round(N_HARMONICS / top / tick))
    posture = limits.centre[None]
    rest = np.zeros_like(posture)
    distance = float(smallest_distance(guess.arm, guess.values, posture, limits.distance)[0])
    if distance < limits.distance:
        raise InvalidInput(
            f"two links are {distance:.3g} m apart in the posture in which records begin",
            where="--limit-distance",
            remedy="lower the limit, or move the range of --limit-angle or of the URDF, whose "
            "middle is this posture",
        )
    if not search.within((posture, rest, rest)):
        raise InvalidInput(
            "the drives are too weak to hold the guessed arm at "
            f"{'the middle of the angle limits' if limits.posture else 'zero angles'}",
            where="--limit-voltage",
            remedy="check torque_per_volt, the gravity torques and the voltage limit",
        )
    motions = optimise(search, starts, seed)
    uses: tuple[tuple[str, Use], ...] = (("motion", "motion"), ("motion-check", "check"))
    return tuple(
        _record(search, series, *use, torque_errors, longest)
        for series, use in zip(motions, uses, strict=False)
    )


def _record(
    search: Search,
    series: Fourier,
    name: str,
    use: Use,
    torque_errors: FloatArray,
    longest: float,
) -> Planned:
    """Record of one series, reduced until the simulated arm satisfies all limits."""
    arm, limits = search.arm, search.limits
    allowed = (longest - 2.0 * _LEAD_TIMES[-1]) / series.period
    periods, reason = _periods(search, series, int(np.clip(allowed, 1, _MAX_PERIODS)))
    for _ in range(_MAX_ATTEMPTS):
        planned = _drive(search, series, periods)
        drive = planned.drive
        if arm.servo is None:
            motion = followed_motion(search.guess, planned.links)
        else:
            motion = predicted_motion(search.guess, drive)
        if motion.use_of(limits) <= 1.0:
            break
        centre = limits.centre
        offset = centre + _REDUCTION_FACTOR * (series.offset - centre)
        series = replace(series.scaled(_REDUCTION_FACTOR), offset=offset)
    else:
        raise LimitBroken(
            f"no motion of the guessed arm satisfies the limits: even in a small motion "
            f"{motion.broken(limits)}",
            where=name,
            remedy="widen the limit if the arm allows it, or check the servo gains and the "
            "parameters",
        )
    condition = float(condition_number(arm, limits, series.at(search.time)))
    return Planned(
        experiment=Experiment(name, f"{name}.csv", use, (HELD_CONTROL,) * arm.n_joints),
        drive=drive,
        motor_angle=planned.motor_angle,
        band_hz=(1.0 / series.period, N_HARMONICS / series.period),
        predicted=motion,
        reasons=(
            f"{N_HARMONICS} harmonics of {1.0 / series.period:.3g} Hz, condition number "
            f"{condition:.1f} after scaling of columns",
            reason,
            f"{planned.lead:g} s of lead-in and of lead-out",
        ),
        condition_number=condition,
        precision=_precision(search, series, periods, torque_errors),
        waypoints=planned.waypoints,
    )


def _precision(
    search: Search, series: Fourier, periods: int, torque_errors: FloatArray
) -> tuple[Parameter, ...]:
    """Predicted rigid parameters of a record."""
    motion, top_hz = series.at(search.time), N_HARMONICS / series.period
    std = standard_deviations(search, motion, top_hz, torque_errors)
    return tuple(predicted_rigid_parameters(search.arm, search.values, std / np.sqrt(periods)))


class _PlannedDrive(NamedTuple):
    drive: Drive
    motor_angle: FloatArray  # intended
    links: Motion  # intended
    lead: float  # [s] before and after the motion
    waypoints: Waypoints


def _drive(search: Search, series: Fourier, periods: int) -> _PlannedDrive:
    """References of a complete record."""
    arm = search.arm
    tick = clock_of(arm)
    zero = np.zeros(arm.n_joints)
    rest = (search.limits.centre, zero, zero)
    joint_state = [x[0] for x in series.at(np.zeros(1))]
    for lead in _LEAD_TIMES:
        time = _ticks(lead, tick)
        lead_in, lead_out = quintic(rest, joint_state, time), quintic(joint_state, rest, time)
        if search.within(lead_in) and search.within(lead_out):
            break
    steady = series.at(_ticks(periods * series.period, tick))
    parts = zip(lead_in, steady, lead_out, strict=True)
    angles, velocities, accelerations = (np.concatenate(x) for x in parts)
    angle = arm.motor_accelerations(angles)
    links = (angles, velocities, accelerations)
    interval = series.period / (N_HARMONICS * _WAYPOINTS_PER_CYCLE)
    index = np.arange(0, len(links[0]), max(1, int(interval / tick)))
    states = (np.vstack([x[index], last]) for x, last in zip(links, rest, strict=True))
    waypoints = Waypoints(tick * np.append(index, len(links[0])), *states)
    # the servo differentiates the encoder reading, so its reference is the difference of the angle
    reference = np.diff(angle, axis=0, append=angle[-1:]) / tick
    return _PlannedDrive(
        servo_drive(search.guess, reference),
        angle,
        (angles, velocities, accelerations),
        float(lead),
        waypoints,
    )


def _ticks(duration: float, tick: float) -> FloatArray:
    time: FloatArray = tick * np.arange(round(duration / tick), dtype=np.float64)
    return time


def _periods(search: Search, series: Fourier, most: int) -> tuple[int, str]:
    """Number of periods that the noise of the encoders requires, and its reason."""
    arm = search.arm
    single = "1 period, because a repetition only averages noise"
    if not all(joint.encoder_counts for joint in arm.joints):
        return 1, f"{single}; the encoder noise is unknown"
    std = standard_deviations(search, series.at(search.time), N_HARMONICS / series.period)
    sizes = reference_sizes(arm, search.values)
    worst = max(s / sizes[k] for k, s in enumerate(std) if k in sizes)
    required_periods = int(np.ceil((worst / _TARGET_RELATIVE_STD) ** 2))
    if required_periods == 1:
        text = f"{single}; the encoder noise causes a standard deviation of {100.0 * worst:.2g} %"
        return 1, f"{text} of the worst parameter"
    periods = min(required_periods, most)
    count = (
        f"{periods} periods" if required_periods == periods else f"the maximum of {periods} periods"
    )
    remaining = 100.0 * worst / np.sqrt(periods)
    text = f"{count}, for a standard deviation of {remaining:.2g} % of the worst parameter"
    return periods, f"{text} due to encoder noise"


def quintic(start: Sequence[FloatArray], stop: Sequence[FloatArray], time: FloatArray) -> Motion:
    """Polynomial of fifth degree between two states of angle, velocity and acceleration.

    The states are those at `time` 0 and one tick after its last entry. `time` (n_samples,) is
    uniform from zero.
    """
    from scipy.interpolate import BPoly

    end = time[-1] + time[1] - time[0]
    angle = BPoly.from_derivatives([0.0, end], [np.array(start), np.array(stop)])
    return angle(time), angle.derivative()(time), angle.derivative(2)(time)


_NANOSECONDS = 1_000_000_000
_DIGITS = 9  # significant digits of a number


def trajectory_name(experiment: Experiment) -> str:
    """File name of the trajectory of an experiment."""
    return f"trajectory-{experiment.name}.json"


def trajectory_text(joint_names: Sequence[str], waypoints: Waypoints) -> str:
    """The message as JSON, which is YAML as well, one point per line.

    Positions, velocities and accelerations are those of the links.
    """
    points = ",\n".join(
        f"    {json.dumps(_point(waypoints, k))}" for k in range(len(waypoints.time))
    )
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    return (
        f'{{\n  "header": {json.dumps(header)},\n'
        f'  "joint_names": {json.dumps(list(joint_names))},\n'
        f'  "points": [\n{points}\n  ]\n}}\n'
    )


def _point(waypoints: Waypoints, row: int) -> dict[str, Any]:
    """One trajectory_msgs/JointTrajectoryPoint."""
    seconds, nanoseconds = divmod(round(waypoints.time[row] * _NANOSECONDS), _NANOSECONDS)
    values = {
        "positions": waypoints.angle,
        "velocities": waypoints.velocity,
        "accelerations": waypoints.acceleration,
    }
    point: dict[str, Any] = {
        name: [float(f"{value:.{_DIGITS}g}") for value in np.asarray(array[row]).tolist()]
        for name, array in values.items()
    }
    return point | {"time_from_start": {"sec": int(seconds), "nanosec": int(nanoseconds)}}
