"""The rigid motion as a record: from standstill through the series and back to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Experiment, FloatArray, Use
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive
from strainwave.errors import InvalidInput
from strainwave.experiment_design.plan import HELD, LimitBroken, Limits, Planned, clock_of
from strainwave.experiment_design.predicted_motion import predicted_motion, run
from strainwave.experiment_design.rigid_motion import (
    HARMONICS,
    Fourier,
    Motion,
    Search,
    condition_number,
    full_regressor,
    optimised,
)

_TOP_HZ = 1.0  # of the motion; slower where the gears ring low
_BELOW_RINGING = 12.0  # a rigid gear's error goes with the square of this: 0.7 %
# Rows that come again make the residuals out look like certainty: the rigid step, asked
# with two periods, now and then took far too narrow a band.
_MOST_PERIODS = 20
_WANTED = 0.002  # deviation of each rigid parameter, of its size, from the encoders' noise alone
_HEARD = 5.0  # the rigid step's low-pass over the motion's highest frequency
_LEADS = np.arange(1.0, 10.5, 0.5)  # [s] of the way in and the way out
_SMALLER = 0.93  # where the simulated arm breaks a limit after all
_TRIES = 20


def motion_records(
    arm: Arm,
    values: Values,
    limits: Limits,
    *,
    anti_resonance_hz: float | None,
    starts: int,
    seed: int,
) -> tuple[Planned, ...]:
    """The best motion, to be fitted, and the second best, to be predicted.

    `values`: (name, joint) -> value of the guessed arm. `anti_resonance_hz`: Lowest of the arm;
    None: its gears are rigid. `starts`: Of the search, two or more. Raises `InvalidInput`: The
    drives cannot hold the arm. Raises `LimitBroken`: No motion keeps to the limits.
    """
    top = min(_TOP_HZ, anti_resonance_hz / _BELOW_RINGING) if anti_resonance_hz else _TOP_HZ
    tick = clock_of(arm)
    period = tick * round(HARMONICS / top / tick)
    search = Search(arm, values, limits, period)
    still = np.zeros((1, arm.n_joints))
    if not search.within((still, still, still)):
        raise InvalidInput(
            "the drives can hardly hold the guessed arm at zero angles",
            where="--limit-voltage",
            remedy="check torque_per_volt, the gravity torques and the limit",
        )
    found = optimised(arm, values, limits, period=period, starts=starts, seed=seed)
    uses: tuple[tuple[str, Use], ...] = (("motion", "motion"), ("motion-check", "check"))
    return tuple(
        _record(search, values, series, *use) for series, use in zip(found, uses, strict=False)
    )


def _record(search: Search, values: Values, series: Fourier, name: str, use: Use) -> Planned:
    """The record of one series, made smaller until the simulated arm keeps to all limits."""
    arm, limits = search.arm, search.limits
    periods, reason = _periods(search, values, series)
    for _ in range(_TRIES):
        drive, angle, lead = _drive(search, values, series, periods)
        seen = predicted_motion(run(arm, values, drive, drive.tick))
        if seen.use_of(limits) <= 1.0:
            break
        series = replace(series.scaled(_SMALLER), offset=_SMALLER * series.offset)
    else:
        raise LimitBroken(
            f"no motion of the guessed arm keeps to the limits: even of a small one "
            f"{seen.broken(limits)}",
            where=name,
            remedy="give a wider limit if the arm bears it, or check the servo's gains and the "
            "parameters",
        )
    condition = float(condition_number(arm, limits, series.at(search.time)))
    return Planned(
        experiment=Experiment(name, f"{name}.csv", use, (HELD,) * arm.n_joints),
        drive=drive,
        motor_angle=angle,
        band_hz=(1.0 / series.period, HARMONICS / series.period),
        predicted=seen,
        reasons=(
            f"{HARMONICS} harmonics of {1.0 / series.period:.3g} Hz, condition number "
            f"{condition:.1f} after scaling of columns",
            reason,
            f"{lead:g} s each to begin and end at standstill",
        ),
        condition_number=condition,
    )


def _drive(
    search: Search, values: Values, series: Fourier, periods: int
) -> tuple[Drive, FloatArray, float]:
    """References of a whole record, the motor angles meant, and the seconds of the way in."""
    arm = search.arm
    tick = clock_of(arm)
    still = np.zeros(arm.n_joints)
    rest = (still, still, still)
    joint_state = [x[0] for x in series.at(np.zeros(1))]
    for lead in _LEADS:
        time = _ticks(lead, tick)
        into, out = quintic(rest, joint_state, time), quintic(joint_state, rest, time)
        if search.within(into) and search.within(out):
            break
    steady = series.at(_ticks(periods * series.period, tick))
    ratio = arm.gear_ratios
    angle = np.concatenate([into[0], steady[0], out[0]]) / ratio
    # the servo counts the encoder's steps, so what it receives is the angle's difference
    reference = np.diff(angle, axis=0, append=angle[-1:]) / tick
    start = tuple(0.0 for _ in ratio)
    drive = Drive(
        tick=tick,
        voltage=np.zeros_like(angle),
        reference=reference,
        servo=(True,) * arm.n_joints,
        motor_angle=start,
        initial_voltage=arm.holding_voltage(values, start),
    )
    return drive, angle, float(lead)


def _ticks(duration: float, tick: float) -> FloatArray:
    time: FloatArray = tick * np.arange(round(duration / tick), dtype=np.float64)
    return time


def _periods(search: Search, values: Values, series: Fourier) -> tuple[int, str]:
    """How often to go round, and why.

    The encoder's rounding, q^2/12 at each tick, becomes an error of the acceleration behind the
    rigid step's low-pass B of variance (2 pi)^4 B^5/5 S, S = 2 tick q^2/12; with the rigid
    inertia it is an error of the torque, independent 2 B times a second.
    """
    arm = search.arm
    once = "1 period, as a repetition shows noise but no new motion"
    counts = [joint.encoder_counts for joint in arm.joints]
    if not all(counts):
        return 1, f"{once}; the encoders' noise is not known"
    motion = series.at(search.time)
    phi = full_regressor(arm, motion)
    heard = _HEARD * HARMONICS / series.period
    rounding = np.array([2.0 * np.pi / count for count in counts if count])
    density = 2.0 * clock_of(arm) * rounding**2 / 12.0
    acceleration = np.sqrt((2.0 * np.pi) ** 4 * heard**5 / 5.0 * density)
    rows = phi / (_inertia_at_motor(search) * acceleration)[:, None]
    rows = rows.reshape(-1, rows.shape[2]) * np.sqrt(2.0 * heard * series.period / len(motion[0]))
    deviation = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    sizes = _sizes(arm, values)
    worst = max(d / sizes[k] for k, d in enumerate(deviation) if k in sizes)
    needed = int(np.ceil((worst / _WANTED) ** 2))
    if needed == 1:
        return 1, f"{once}, and the encoders' leaves {100.0 * worst:.2g} % of the worst parameter"
    periods = min(needed, _MOST_PERIODS)
    many = f"{periods} periods" if needed == periods else f"{periods} periods at most"
    left = 100.0 * worst / np.sqrt(periods)
    return periods, f"{many}, as the encoders' noise leaves {left:.2g} % of the worst parameter"


def _inertia_at_motor(search: Search) -> FloatArray:
    """What each motor has to turn with the arm stretched, friction left out: (n_joints,)."""
    n = search.arm.n_joints
    still = np.zeros((n, n))
    moved = search.arm.inverse_dynamics(search.vector, still, still, np.eye(n))
    unmoved = search.arm.inverse_dynamics(search.vector, still, still, still)
    return np.asarray(np.diag(moved - unmoved) * search.arm.gear_ratios)


def _sizes(arm: Arm, values: Values) -> dict[int, float]:
    """Column of the regressor -> size of its parameter, where the guess has one."""
    sizes = {}
    for k, column in enumerate(arm.rigid_columns):
        size = abs(values.get((column.name, column.joint), 0.0))
        if size > 0.0:
            sizes[k] = size
    return sizes


def quintic(start: Sequence[FloatArray], stop: Sequence[FloatArray], time: FloatArray) -> Motion:
    """The polynomial of fifth degree between two states of angle, velocity and acceleration.

    `start`, `stop`: Angle, velocity, acceleration at `time` 0 and one tick after its last entry.
    `time` (n_samples,) [s]: Uniform from zero.
    """
    T = float(time[-1] + time[1] - time[0])
    powers = np.arange(6.0)
    rows = []
    for at in (0.0, T):
        for order in range(3):
            rows.append(_power_rows(np.array([at]), powers, order)[0])
    coefficients = np.linalg.solve(np.array(rows), np.array([*start, *stop]))
    angle, velocity, acceleration = (
        _power_rows(time, powers, order) @ coefficients for order in range(3)
    )
    return angle, velocity, acceleration


def _power_rows(time: FloatArray, powers: FloatArray, order: int) -> FloatArray:
    """Derivatives of t^p: (n_samples, n_powers)."""
    factor = np.ones(len(powers))
    for k in range(order):
        factor = factor * np.maximum(powers - k, 0)
    rows: FloatArray = factor * time[:, None] ** np.maximum(powers - order, 0)
    return rows
