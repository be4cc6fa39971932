"""Records of servos that follow references: the rigid motion, and steps of one joint.

The rigid motion has a lead-in from standstill, a periodic motion and a lead-out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Experiment, FloatArray, Use
from strainwave.dynamics import excitation
from strainwave.errors import InvalidInput
from strainwave.excite.guessed_arm import (
    ExcitationBand,
    GuessedArm,
    followed_motion,
    predicted_motion,
    servo_drive,
    smallest_distance,
)
from strainwave.excite.plan import HELD_CONTROL, LimitBroken, Motion, Planned, clock_of
from strainwave.excite.rigid_motion import (
    N_HARMONICS,
    Fourier,
    MotionSearch,
    condition_number,
    optimise,
    predicted_rigid_parameters,
    reference_sizes,
    standard_deviations,
)

_MAX_MOTION_HZ = 1.0  # highest frequency of the motion
_MIN_RESONANCE_RATIO = 12.0  # anti-resonance over motion: the error of a rigid gear is 1/12^2
_MAX_PERIODS = 20  # 160 s or more, as a period takes at least 8 s
_TARGET_RELATIVE_STD = 0.002  # of each rigid parameter, due to the noise of the encoders
_WAYPOINTS_PER_CYCLE = 16  # of the highest harmonic; quintic splines then err by less than 1e-6
_LEAD_TIMES = np.arange(1.0, 10.5, 0.5)  # [s] candidates for lead-in and lead-out
_REDUCTION_FACTOR = 0.93  # per attempt, if the simulated arm violates a limit
_MAX_ATTEMPTS = 20  # reduce a motion to 1/4, steps to 1/8
_HOLD_PERIODS = 6.0  # of the anti-resonance per level, in which the vibration decays
_MIN_HOLD, _MAX_HOLD = 0.2, 2.0  # [s] per level
_STEP_LIMIT_SHARE = 0.9  # of each limit for the step; the rest is for overshoot
_MAX_STEP_VOLTAGE_SHARE = 0.98  # of the voltage limit; a saturated servo does not control
_STEP_REDUCTION_FACTOR = 0.9  # per attempt, if the simulated arm violates a limit
_PLANS: tuple[tuple[str, Use, tuple[float, ...], float], ...] = (
    # name, use, levels, size: validation starts in the other direction, with smaller steps
    ("step", "tuning", (0.0, 1.0, 0.0, -1.0, 0.0), 1.0),
    ("step-check", "check", (0.0, -1.0, 0.0, 1.0, 0.0), 0.7),
)


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
    search = MotionSearch(guess, tick * round(N_HARMONICS / top / tick))
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
    uses: tuple[tuple[str, Use], ...] = (("motion", "motion"), ("motion-check", "check"))
    return tuple(
        _record(search, series, *use, torque_errors, longest)
        for series, use in zip(optimise(search, starts, seed), uses, strict=False)
    )


def _record(
    search: MotionSearch,
    series: Fourier,
    name: str,
    use: Use,
    torque_errors: FloatArray,
    longest: float,
) -> Planned:
    """Record of one series, reduced until the simulated arm satisfies all limits."""
    arm, limits, tick = search.arm, search.limits, clock_of(search.arm)
    allowed = (longest - 2.0 * _LEAD_TIMES[-1]) / series.period
    periods, reason = _periods(search, series, int(np.clip(allowed, 1, _MAX_PERIODS)))
    for _ in range(_MAX_ATTEMPTS):
        links, lead = _links(search, series, periods)
        motor_angle = arm.motor_accelerations(links[0])
        # the servo differentiates the encoder reading: its reference is the difference of the angle
        reference = np.diff(motor_angle, axis=0, append=motor_angle[-1:]) / tick
        drive = servo_drive(search.guess, reference)
        if arm.servo is None:
            motion = followed_motion(search.guess, links)
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
    steady, top_hz = series.at(search.time), N_HARMONICS / series.period
    condition = float(condition_number(arm, limits, steady))
    std = standard_deviations(search, steady, top_hz, torque_errors) / np.sqrt(periods)
    rest = np.zeros(arm.n_joints)
    interval = series.period / (N_HARMONICS * _WAYPOINTS_PER_CYCLE)
    index = np.arange(0, len(links[0]), max(1, int(interval / tick)))
    ends = zip(links, (limits.centre, rest, rest), strict=True)
    angle, velocity, acceleration = (np.vstack([x[index], last]) for x, last in ends)
    return Planned(
        experiment=Experiment(name, f"{name}.csv", use, (HELD_CONTROL,) * arm.n_joints),
        drive=drive,
        motor_angle=motor_angle,
        band_hz=(1.0 / series.period, top_hz),
        predicted=motion,
        reasons=(
            f"{N_HARMONICS} harmonics of {1.0 / series.period:.3g} Hz, condition number "
            f"{condition:.1f} after scaling of columns",
            reason,
            f"{lead:g} s of lead-in and of lead-out",
        ),
        condition_number=condition,
        precision=tuple(predicted_rigid_parameters(arm, search.values, std)),
        waypoints=(tick * np.append(index, len(links[0])), (angle, velocity, acceleration)),
    )


def _links(search: MotionSearch, series: Fourier, periods: int) -> tuple[Motion, float]:
    """Motion of the links in a complete record, and the time [s] of lead-in and of lead-out."""
    tick, zero = clock_of(search.arm), np.zeros(search.arm.n_joints)
    rest = (search.limits.centre, zero, zero)
    begin = [x[0] for x in series.at(np.zeros(1))]
    for lead in _LEAD_TIMES.tolist():
        time = _ticks(lead, tick)
        lead_in, lead_out = quintic(rest, begin, time), quintic(begin, rest, time)
        if search.within(lead_in) and search.within(lead_out):
            break
    steady = series.at(_ticks(periods * series.period, tick))
    parts = zip(lead_in, steady, lead_out, strict=True)
    angle, velocity, acceleration = (np.concatenate(part) for part in parts)
    return (angle, velocity, acceleration), lead


def _ticks(duration: float, tick: float) -> FloatArray:
    time: FloatArray = tick * np.arange(round(duration / tick), dtype=np.float64)
    return time


def _periods(search: MotionSearch, series: Fourier, most: int) -> tuple[int, str]:
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
    count = f"{'' if required_periods == periods else 'the maximum of '}{periods} periods"
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


def step_records(guess: GuessedArm, band: ExcitationBand, joint: int) -> tuple[Planned, ...]:
    """Records of steps of one joint's velocity reference: one to fit, one for validation.

    The arm has a servo. Raises LimitBroken if no step of the guessed arm satisfies the limits.
    """
    arm, limits = guess.arm, guess.limits
    assert arm.servo is not None
    hold = float(np.clip(_HOLD_PERIODS / band.anti_resonance_hz, _MIN_HOLD, _MAX_HOLD))
    hold = clock_of(arm) * round(hold / clock_of(arm))
    i = joint - 1
    by_voltage = limits.voltage[i] / arm.servo.kp[i] if arm.servo.kp[i] > 0.0 else np.inf
    turns = np.abs(arm.transmission[:, i])  # of the links per turn of the motor
    moves = turns > 0.0
    by_angle = float(np.min(np.array(limits.angle)[moves] / (turns[moves] * hold)))
    largest = _STEP_LIMIT_SHARE * min(limits.velocity[i], by_voltage, by_angle)
    return tuple(
        _step_record(guess, joint, f"{name}-j{joint}", use, hold, size * largest * np.array(levels))
        for name, use, levels, size in _PLANS
    )


def _step_record(
    guess: GuessedArm, joint: int, name: str, use: Use, hold: float, levels: FloatArray
) -> Planned:
    """One record, reduced until the simulated arm satisfies all limits."""
    limits, tick, n_joints = guess.limits, clock_of(guess.arm), guess.arm.n_joints
    for _ in range(_MAX_ATTEMPTS):
        steps = excitation.steps(levels, hold=hold, clock=tick)
        reference = np.zeros((len(steps), n_joints))
        reference[:, joint - 1] = steps
        drive = servo_drive(guess, reference)
        motion = predicted_motion(guess, drive)
        share = float((motion.voltage / np.array(limits.voltage)).max())
        if share <= _MAX_STEP_VOLTAGE_SHARE and motion.use_of(limits) <= 1.0:
            break
        levels = _STEP_REDUCTION_FACTOR * levels
    else:
        raise LimitBroken(
            f"no step of joint {joint} keeps the guessed arm within the limits: even with a small "
            f"step {motion.broken(limits)}",
            where=name,
            remedy="widen the limit if the arm allows it, or check the servo gains",
        )
    moved = tick * np.concatenate([np.zeros((1, n_joints)), np.cumsum(reference, axis=0)[:-1]])
    purpose = "part of the fit" if use == "tuning" else "validation of the elastic model"
    return Planned(
        experiment=Experiment(name, f"{name}.csv", use, (HELD_CONTROL,) * n_joints, joint=joint),
        drive=drive,
        motor_angle=moved + guess.start,
        band_hz=(1.0 / (len(levels) * hold), 0.5 / drive.tick),
        predicted=motion,
        reasons=(
            f"steps of {levels.max():.3g} rad/s of the motor in both directions, {hold:.3g} s each",
            purpose,
        ),
    )
