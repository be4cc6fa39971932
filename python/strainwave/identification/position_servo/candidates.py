"""Choices that residuals decide: torque limits, courses of the commands, effects of gears."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain.arm.parameter_table import COULOMB
from strainwave.domain.keys import JointNumber, Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.position_servo.fit import Guess, ServoFit, cost_of, fit_segments
from strainwave.identification.position_servo.loop import (
    DELAY,
    GEAR_DAMPING,
    GEAR_EFFECTS,
    KD,
    KP,
    LIMIT,
    MOTOR_SHARE,
    STIFFNESS,
    VELOCITY_LAG,
    VISCOUS,
    ServoLoop,
)
from strainwave.identification.position_servo.records import MAX_DELAY, ReferenceHold, Segment
from strainwave.identification.position_servo.states import deviations, initial_state
from strainwave.identification.position_servo.unknowns import (
    EFFECT_SCALES,
    USUAL_MOTOR_SHARE,
    unknowns_of,
)

_CALM_RATIO = 2.0  # of residuals over their median
_LIMITS = np.geomspace(0.1, 1.6, 16)  # of a torque limit, over the largest torque of the start
LIMIT_UNREACHED = 3.0
"""Factor on the largest torque of the fitted records, beyond which a limit has no effect."""

# Decrease of the cost below which residuals do not decide: a likelihood ratio of e^20, because
# errors of the model correlate over tens of samples.
_DECISIVE_COST = 40.0
# Cost per sample up to which another course of commands is plausible: residuals of the size of the
# resolution do not tell courses whose root mean squares differ by less than 0.5 %.
_PLAUSIBLE_COST = 0.01
_PLAUSIBLE_SHARE = 0.5  # of what is unexplained, up to which another course may be the true one
_DELAY_STEP = 5e-3  # [s], about half of the distance of minima
_DELAYS = np.arange(0.0, MAX_DELAY + 0.5 * _DELAY_STEP, _DELAY_STEP).tolist()
_PROMISING_COST = 0.1  # per sample, of a delay before the fit of the other values
_MAX_REFITS = 4
_GEAR_HZ = 100.0  # resonance of a gear that is stiff beside a servo, which is below 20 Hz
_STIFF_GEAR_HZ = 400.0  # inertias are off by (f / 400 Hz)^2 at f
_RESONANCES_HZ = (8.0, 16.0, 32.0, 64.0)  # where the search of a stiffness starts
_OTHER_SHARES = (0.2, 0.8)  # where the fit of an effect starts again
_GEAR_DAMPING_RATIO = 0.02
_MAX_JOINTS_WITH_EFFECTS = 1  # with couplings, effects of one joint hide in those of others


def fit_from(
    loop: ServoLoop, values: Values, segments: Sequence[Segment], floor: float, *, passes: int
) -> ServoFit | None:
    """Fit from values, with states from the measured angles; None if a simulation diverges."""
    states = tuple(initial_state(loop, segment) for segment in segments)
    try:
        sizes = np.maximum(deviations(loop, values, segments, states), floor)
    except (InvalidInput, NumericalFailure):  # of an arm that cannot exist
        return None
    guess = Guess(values, tuple(segments), states, sizes)
    return fit_segments(loop, guess, *unknowns_of(loop, values), floor, passes=passes)


def refined(fit: ServoFit) -> ServoFit:
    """The fit continued while its cost decreases enough to decide a choice."""
    for _ in range(_MAX_REFITS):
        unknowns, priors = unknowns_of(fit.loop, fit.values)
        more = fit_segments(fit.loop, fit.as_guess(), unknowns, priors, fit.resolution, passes=2)
        if more is None or more.cost >= fit.cost:
            break
        before, fit = fit, more
        if more.cost > before.cost - 0.5 * _DECISIVE_COST:
            break
    return fit


def calm_segments(
    loop: ServoLoop, values: Values, segments: Sequence[Segment], floor: float
) -> tuple[Segment, ...]:
    """Segments that a start predicts about as well as most; all if its simulation diverges.

    Beyond a torque limit that a start does not know, simulation and measurement part.
    """
    states = [initial_state(loop, segment) for segment in segments]
    try:
        sizes = np.max(np.maximum(deviations(loop, values, segments, states), floor), axis=1)
    except (InvalidInput, NumericalFailure):  # of an arm that cannot exist
        return tuple(segments)
    is_calm = sizes <= _CALM_RATIO * np.median(sizes)
    return tuple(s for s, calm in zip(segments, is_calm, strict=True) if calm)


def choose_limits(fit: ServoFit, segments: Sequence[Segment]) -> ServoFit | None:
    """Fit of more segments, with the torque limits that they show, joint by joint.

    Residuals beyond a limit do not show where it is, so it is searched on a grid. A limit that
    explains little stands in for another effect: the joint then has none. None if no simulation
    follows the segments.
    """
    loop, floor = fit.loop, fit.resolution
    states = [initial_state(loop, segment) for segment in segments]
    tops = {i: fit.values[LIMIT, i] for i in loop.numbers}
    values = fit.values
    for i, top in tops.items():
        costs = dict[float, float]()
        for limit in (_LIMITS * top).tolist():
            sizes = deviations(loop, values | {(LIMIT, i): limit}, segments, states)
            costs[limit] = float(np.sum(np.log(np.maximum(sizes, floor))))
        values = values | {(LIMIT, i): min(costs, key=costs.__getitem__)}
    best = fit_from(loop, values, segments, floor, passes=2)
    for i, top in tops.items():
        start = values if best is None else best.values
        unlimited = start | {(LIMIT, i): LIMIT_UNREACHED * top}
        if best is not None and not best.saturated[i - 1]:
            best = replace(best, values=unlimited)
            continue
        free = fit_from(loop, unlimited, segments, floor, passes=2)
        if free is not None and (best is None or free.cost < best.cost + _DECISIVE_COST):
            best = free
    return best


Changes = list[Values]
"""Changes of values by rivals: choices that explain a record as well as the best one."""


def with_reached_limits(fit: ServoFit) -> ServoFit:
    """The fit with the torque limits of segments that were not in their search."""
    typical = np.median(fit.deviations, axis=0)
    if np.all(fit.deviations < _CALM_RATIO * typical):
        return fit
    limited = choose_limits(fit, fit.segments)
    return limited if limited is not None and limited.cost < fit.cost - _DECISIVE_COST else fit


def without_needless_limits(fit: ServoFit) -> ServoFit:
    """The fit without torque limits that explain little: they stand in for another effect."""
    for i in fit.loop.numbers:
        if fit.saturated[i - 1]:
            unlimited = fit.values | {(LIMIT, i): LIMIT_UNREACHED * fit.values[LIMIT, i]}
            free = fit_from(fit.loop, unlimited, fit.segments, fit.resolution, passes=2)
            if free is not None and free.cost < fit.cost + _DECISIVE_COST:
                fit = free
    return fit


def choose_hold(start: ServoFit) -> tuple[ServoFit, Changes]:
    """The fit with the course of commands that the residuals show, and changes by rivals.

    Logs usually hold the commands as they were sent.
    """
    half = 0.5 * float(np.mean([segment.record.sample_time for segment in start.segments]))
    lead = {hold: half * (hold is not ReferenceHold.HELD) for hold in ReferenceHold}
    fits = []
    for hold in ReferenceHold:
        loop, shift = replace(start.loop, hold=hold), lead[hold] - lead[start.loop.hold]
        values = dict(start.values)
        for i in loop.numbers:
            values[VELOCITY_LAG, i] = 0.0  # that of another course stands in for it
            if loop.servo.delay_of(i) is None:
                values[DELAY, i] = min(max(values[DELAY, i] + shift, 0.0), MAX_DELAY)
        alike = [start] if hold is start.loop.hold else []
        fit = fit_from(loop, values, start.segments, start.resolution, passes=2)
        alike += [fit] if fit is not None else []
        fits += [refined(min(alike, key=lambda each: each.cost))] if alike else []
    rows = sum(segment.angle.size for segment in start.segments)
    least = min(fits, key=lambda each: each.cost)
    most = least.cost + _PLAUSIBLE_COST * rows
    best = next(fit for fit in fits if fit.cost <= most)
    # other effects than the course of the commands leave this per sample
    unexplained = 2.0 * np.log(least.misfit)
    most = max(most, least.cost + max(_DECISIVE_COST, _PLAUSIBLE_SHARE * unexplained * rows))
    rivals = [fit for fit in fits if fit is not best and fit.cost <= most]
    best = replace(best, has_rival_effect=start.has_rival_effect)
    return best, [_change(best, rival) for rival in rivals]


def choose_delay(fit: ServoFit) -> tuple[ServoFit, Changes]:
    """The fit with the delay of the least residuals, and changes by rivals, one on each side.

    In slow motions a delay acts as the damping kp times delay, and residuals have several minima.
    """
    rows = sum(segment.angle.size for segment in fit.segments)
    free = [i for i in fit.loop.numbers if fit.loop.servo.delay_of(i) is None]
    fits = [fit]
    for delay in _DELAYS if free else ():
        shift = delay - fit.values[DELAY, free[0]]
        values = _with_later_command(fit, free, shift)
        if values is None or abs(shift) < 0.5 * _DELAY_STEP:
            continue
        try:
            sizes = deviations(fit.loop, values, fit.segments, fit.states)
        except (InvalidInput, NumericalFailure):  # the loop is not stable with this delay
            continue
        cost = cost_of(fit.segments, np.maximum(sizes, fit.resolution))
        if cost < fit.cost + _PROMISING_COST * rows:
            rival = fit_from(fit.loop, values, fit.segments, fit.resolution, passes=2)
            fits += [rival] if rival is not None else []
    best = min(fits, key=lambda each: each.cost)
    plausible = [each for each in fits if each.cost < best.cost + _DECISIVE_COST]
    plausible.sort(key=lambda each: each.values[DELAY, free[0]] if free else 0.0)
    ends = dict.fromkeys((plausible[0], plausible[-1]))
    best = replace(best, has_rival_effect=fit.has_rival_effect)
    return best, [_change(best, each) for each in ends if each.cost > best.cost]


def _with_later_command(
    fit: ServoFit, joints: Sequence[JointNumber], shift: float
) -> Values | None:
    """Values with later commands and the damping that makes up for them; None if it is negative."""
    values = dict(fit.values)
    for i in joints:
        values[DELAY, i] += shift
        names = (KD, VISCOUS) if fit.loop.servo.damping_gain(i) is None else (VISCOUS,)
        own = sum(values[name, i] for name in names)
        left = own - shift * values[KP, i]
        if left < 0.0 or not 0.0 <= values[DELAY, i] <= MAX_DELAY:
            return None
        for name in names:
            values[name, i] = left * values[name, i] / own if own > 0.0 else left / len(names)
    return values


def choose_gear_effects(fit: ServoFit) -> tuple[ServoFit, Changes]:
    """The fit with the effect of a gear that the residuals show, and changes by others.

    Friction that grows with the load hides in Coulomb friction unless the load changes, so that it
    is a rival even where it explains nothing.
    """
    arm = fit.loop.arm
    is_small = arm.has_planar_program and arm.n_joints <= _MAX_JOINTS_WITH_EFFECTS
    if fit.loop.has_gears or not is_small:
        return fit, []
    plain, effects, changes = fit, list[tuple[ServoFit, Changes]](), Changes()
    for i in plain.loop.numbers:
        for name in _tried_effects(plain.loop.arm, i):
            rival = _with_effect(plain, i, name, _GEAR_HZ, _DAMPING_RATIOS[name])
            if rival is None:
                continue
            is_decisive, errors = rival.cost < plain.cost - _DECISIVE_COST, Changes()
            if is_decisive and rival.values[name, i] >= _LEAST_SIZES[name]:
                rival, errors = _stiffened(rival, i, name)
            if rival.values[name, i] >= _LEAST_SIZES[name]:
                effects.append((rival, errors))
            elif is_decisive:
                plain = _restarted(plain, rival)
            if name == "load_friction":
                changes += _changes(plain, rival, i)
    best, errors = min(effects, key=lambda each: each[0].cost, default=(plain, []))
    if best.cost < plain.cost - _DECISIVE_COST:  # others that explain a part are its rivals
        others = [each for each, _ in effects if each is not best and each.cost < plain.cost]
        rivals = [_change(best, each) for each in others]
        return replace(best, has_rival_effect=bool(rivals)), [*errors, *rivals]
    return plain, changes


def _with_effect(
    fit: ServoFit, joint: JointNumber, name: str, hz: float, damping_ratio: float
) -> ServoFit | None:
    """Fit of a joint with an effect and a stiff gear of a resonance [Hz]."""
    loop, values = _with_gears(fit, [joint], hz, damping_ratio)
    geared = loop.arm.with_joint(joint, effects=(GEAR_EFFECTS[name],))
    loop = replace(loop, arm=Arm.of(geared), has_stiff_gears=True)
    values = {(name, joint): EFFECT_SCALES[name]} | values
    return fit_from(loop, values, fit.segments, fit.resolution, passes=2)


def _stiffened(fit: ServoFit, joint: JointNumber, name: str) -> tuple[ServoFit, Changes]:
    """The fit with a gear as good as rigid, and errors of its values that remain.

    These are changes by other minima, which the share of the motor tells apart, and the effect of
    a finite resonance f: it is of order 1 / f^2, so that a third of the last change remains.
    """
    softer, ratio = [], _DAMPING_RATIOS[name]
    for share in (fit.values[MOTOR_SHARE, joint], *_OTHER_SHARES):
        start = replace(fit, values=fit.values | {(MOTOR_SHARE, joint): share})
        each = _with_effect(start, joint, name, 0.5 * _STIFF_GEAR_HZ, ratio)
        softer += [each] if each is not None else []
    best = min(softer, key=lambda each: each.cost, default=fit)
    stiff = _with_effect(best, joint, name, _STIFF_GEAR_HZ, ratio) or best
    plausible = [each for each in softer if each.cost < best.cost + _DECISIVE_COST]
    others = [_change(best, each) for each in plausible if each is not best]
    last = {key: change / 3.0 for key, change in _change(best, stiff).items()}
    return stiff, [last, *others]


def _restarted(plain: ServoFit, rival: ServoFit) -> ServoFit:
    """The fit without an effect, from the values of a fit whose effect vanished."""
    shared = {key: rival.values[key] for key in plain.values}
    again = fit_from(plain.loop, shared, plain.segments, plain.resolution, passes=2)
    return again if again is not None and again.cost < plain.cost else plain


def _tried_effects(arm: Arm, joint: JointNumber) -> Iterator[str]:
    """Parameters of effects that a joint may have, by those that the study names."""
    effects = arm.joints[joint - 1].effects
    for name, effect in GEAR_EFFECTS.items():
        if effects == "auto" or effect in effects:
            yield name


def choose_stiffness(fit: ServoFit, joints: Sequence[JointNumber]) -> ServoFit | None:
    """The fit with elastic gears in joints, from the resonance with the least residuals."""
    rivals = []
    for hz in _RESONANCES_HZ:
        loop, values = _with_gears(fit, joints, hz, _GEAR_DAMPING_RATIO)
        rival = fit_from(loop, values, fit.segments, fit.resolution, passes=2)
        rivals += [rival] if rival is not None else []
    return min(rivals, key=lambda each: each.cost, default=None)


def _with_gears(
    fit: ServoFit, joints: Sequence[JointNumber], hz: float, damping_ratio: float
) -> tuple[ServoLoop, Values]:
    """The loop with elastic gears of a resonance [Hz] in joints, and its start."""
    arm, values = fit.loop.arm, dict(fit.values)
    omega, n_links = 2.0 * np.pi * hz, len(arm.base.links)
    shares = [values.get((MOTOR_SHARE, i), USUAL_MOTOR_SHARE) for i in fit.loop.numbers]
    particular = arm.base.particular(np.array(shares))
    body = particular @ np.array([values[column.key] for column in arm.base.columns])
    links = arm.link_inertias(body[:n_links])
    motors = body[n_links:] / arm.gear_ratios**2
    geared = arm
    for joint in joints:
        link, motor = float(links[joint - 1]), float(motors[joint - 1])
        stiffness = (link * motor / (link + motor) if motor > 0.0 else link) * omega**2
        values |= {
            (MOTOR_SHARE, joint): shares[joint - 1],
            (STIFFNESS, joint): stiffness,
            (GEAR_DAMPING, joint): 2.0 * damping_ratio * stiffness / omega,
        }
        geared = Arm.of(geared.with_joint(joint, spring="linear", effects=()))
    return replace(fit.loop, arm=geared), values


# sizes below which an effect is none: a tenth of a count of 12 bits, and of usual friction of teeth
_LEAST_SIZES = dict(zip(GEAR_EFFECTS, (1.5e-4, 5e-3), strict=True))
# Of the stiff gear of an effect. Teeth in contact hardly ring; but the damping acts between teeth
# without contact too, where a larger one would close the gap.
_DAMPING_RATIOS = dict(zip(GEAR_EFFECTS, (0.1, 0.5), strict=True))


def _change(fit: ServoFit, rival: ServoFit) -> Values:
    """Change of the unknowns by a rival that has them."""
    keys = [unknown.keys[0] for unknown in fit.unknowns]
    return {key: rival.values[key] - fit.values[key] for key in keys if key in rival.values}


def _changes(plain: ServoFit, rival: ServoFit, joint: JointNumber) -> Changes:
    """Change of the unknowns by a rival, and its wider deviation of Coulomb friction."""
    table = np.vstack([*(rows.jacobian for rows in rival.rows), rival.prior_rows()])
    norms = np.linalg.norm(table, axis=0)
    norms[norms == 0.0] = np.inf
    inverse = np.linalg.pinv(table / norms)
    coulomb: Key = (COULOMB, joint)
    at = [unknown.keys for unknown in rival.unknowns].index((coulomb,))
    deviation = float(np.linalg.norm(inverse[at])) / norms[at] * rival.misfit
    return [_change(plain, rival), {coulomb: deviation}]
