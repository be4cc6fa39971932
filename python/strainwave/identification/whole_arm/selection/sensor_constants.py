"""Selection of link sensor constants: delays, scale factors, tilts, bandwidths and drifts.

The whole-arm fit estimates a constant only if a score test finds it significant. An unnecessary
delay would widen the confidence interval of the gear damping. A delayed sensor of unknown bandwidth
gets its bandwidth as a further unknown, because a low-pass is nearly a pure delay below its
bandwidth. Unknown mountings are estimated from the start.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Parameter, Place, WholeArmOptions
from strainwave.domain.arm.link_sensors import (
    ConstantKind,
    SensorGroup,
    constant_of,
    is_kind,
    nominal,
)
from strainwave.domain.arm.link_sensors.imu import (
    IMU_DISTANCE,
    IMU_ROTATION,
    IMU_START_ATTITUDE,
    ImuAccelerometers,
)
from strainwave.domain.arm.link_sensors.single_axis import MotorEncoder
from strainwave.domain.arm.parameter_table import record_of
from strainwave.domain.keys import Key, Values
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.dynamics.link_sensors import MAX_SCALE_ERROR, MAX_SENSOR_DELAY
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.problem.effect_unknowns import update_prior_trust
from strainwave.identification.whole_arm.problem.parameter_space import (
    ParameterSpace,
    Unknown,
    is_held,
)
from strainwave.identification.whole_arm.problem.weighted_rows import Evaluation
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.search import Fit, refine, resumed_coarse_search
from strainwave.identification.whole_arm.selection.candidate import Candidate, Selection
from strainwave.numerics.search import Linearised, full_step
from strainwave.numerics.spectra import estimate_rows_per_error
from strainwave.signals.prepared_record import prepare_record

# standard deviations from which a constant joins: no false alarm in 8 candidates
_MIN_SIGNIFICANCE = 4.0
# the same of a torque hold: it has no usual value, and intervals without it would be too narrow
_MIN_HOLD_SIGNIFICANCE = 2.0
# minimum cost reduction in long steps, relative: these have step errors
_MIN_COARSE_COST_SHARE = 0.1
# minimum drift at the ends of a record, in standard deviations of the residual
_MIN_DRIFT_RATIO = 1.0
_MIN_KEPT_SIGNIFICANCE = 3.0  # standard deviations below which the fine fit removes a constant

_BOUND_SHARE = 0.99  # share of its range from which a constant is at a bound
_MIN_MOUNTING_SCALE = 0.1  # [m or 1] minimum scale of the coordinates of a mounting
_MIN_START_DISTANCE = 1e-3  # [m] minimum starting distance from the axis
_MOUNTING_RANGE = 30.0  # range of mounting coordinates, in units of their scale
# range of the logarithm of a distance, bandwidth or mount constant
_LOG_RANGE = float(np.log(30.0))
# of a torque: 1 for a command; -10 behind a filter of a tenth of the sampling rate
_MAX_HOLD = 10.0
# scale of each constant that starts at its nominal value, and its range in units of the scale:
# those of drifts [m/s^3 or rad/s^2] and of tilts [rad] hardly limit them
_SCALES = {
    ConstantKind.DELAY: (MAX_SENSOR_DELAY, 1.0),
    ConstantKind.SCALE: (MAX_SCALE_ERROR, 1.0),
    ConstantKind.TILT: (0.5, 1.0),
    ConstantKind.DRIFT: (1.0, 1e4),
    ConstantKind.HOLD: (1.0, _MAX_HOLD),
}
_MIN_LOW_PASS_DELAY = 3e-5  # [s] minimum delay that a low-pass may explain, of 7.5 kHz
_LOW_PASS_DELAY_SHARE = 0.5  # share of a delay that the starting bandwidth explains
_MIN_REPORTED_DELAY = 1e-4  # [s] minimum delay of a warning: half a sample of a typical logger
_MIN_REPORTED_HOLD = 0.5  # of a warning: nearer to a command than to a smooth torque
# minimum scale error of a warning: typical tolerance of a data sheet
_MIN_REPORTED_SCALE_ERROR = 0.01


def constants_of(record: Dataset) -> list[Key]:
    """Constants of the sensors of a record: delays, scale factors, tilts and drifts."""
    kinds = (ConstantKind.DELAY, ConstantKind.SCALE)
    inputs = prepare_record(record.log, record.arm).driving_inputs
    constants: dict[Key | None, None] = {}
    for axis in record.channels:
        if axis.sensor.group is SensorGroup.MOTOR and inputs[axis.joint - 1].is_voltage:
            continue
        axes = [one for one in record.channels if one.joint == axis.joint]
        is_separate = axis.sensor.is_scale_identifiable(axis, axes)
        constants |= dict.fromkeys(axis.key(kind) for kind in kinds[: 1 + is_separate])
        if axis.sensor.group is SensorGroup.MOTOR and record.hold_change[:, axis.joint - 1].any():
            constants[axis.key(ConstantKind.HOLD)] = None
        if axis.is_mounted:
            constants[axis.key(ConstantKind.TILT)] = None
    drifts = (axis.key(ConstantKind.DRIFT, record.log.name) for axis in record.channels)
    return [key for key in (*constants, *drifts) if key is not None]


def add_sensor_constants(
    space: ParameterSpace, keys: Sequence[Key], starts: Values | None = None
) -> ParameterSpace:
    """Add sensor constants to the unknowns.

    `starts` gives the starting values of constants without a nominal value: those of mountings,
    bandwidths and mount resonances.
    """
    starts = starts or {}
    fixed = {key: value for key, value in starts.items() if key[0] in IMU_START_ATTITUDE}
    extended = space.add(_unknown_of(key, starts) for key in keys)
    return replace(extended, fixed={**space.fixed, **fixed})


def _unknown_of(key: Key, starts: Values) -> Unknown:
    """Unknown of a sensor constant, with its starting value, scale and range."""
    constant, (name, joint) = constant_of(key), key
    assert constant is not None
    if constant.kind in _SCALES:
        scale, reach = _SCALES[constant.kind]
        return Unknown(name, joint, constant.unit, constant.kind.nominal, scale, True, reach)
    start = starts[key]
    if constant.is_mounting and name != IMU_DISTANCE:
        scale = max(abs(start), _MIN_MOUNTING_SCALE)
        return Unknown(name, joint, constant.unit, start, scale, True, _MOUNTING_RANGE)
    start = max(start, _MIN_START_DISTANCE) if constant.is_mounting else start
    return Unknown(name, joint, constant.unit, start, start, False, _LOG_RANGE)


def _with_bandwidths(fit: Fit, selection: Selection) -> Fit | None:
    """The fit with bandwidths of delayed sensors for which the study gives none.

    The starting values attribute half of each delay to the low-pass.
    """
    values, starts = fit.values, Values()
    for delay, bandwidth in _delayed_sensors(fit):
        lag = values[delay]
        is_unknown = bandwidth not in values and not is_held(bandwidth, selection.options)
        if lag > _MIN_LOW_PASS_DELAY and is_unknown:
            starts[bandwidth] = np.sqrt(2.0) / (2.0 * np.pi * _LOW_PASS_DELAY_SHARE * lag)
            values[delay] = (1.0 - _LOW_PASS_DELAY_SHARE) * lag
    space = add_sensor_constants(fit.space, list(starts), starts)
    return fit.with_unknowns(space, values | starts) if starts else None


add_coarse_bandwidths = Candidate(_with_bandwidths, resumed_coarse_search)
add_fine_bandwidths = Candidate(_with_bandwidths, refine)


def _delayed_sensors(fit: Fit) -> Iterator[tuple[Key, Key]]:
    """Delay and bandwidth keys of sensors with an estimated delay and no bandwidth in the study."""
    keys, visited = fit.space.keys, set()
    for axis in (axis for record in fit.objective.records for axis in record.channels):
        delay, bandwidth = axis.key(ConstantKind.DELAY), axis.key(ConstantKind.BANDWIDTH)
        if delay in keys and delay not in visited and delay and bandwidth:
            visited.add(delay)
            if axis.sensor.hz is None:
                yield delay, bandwidth


def _with_significant_constants(
    fit: Fit, selection: Selection, min_cost_share: float = 0.0
) -> Fit | None:
    """The fit with the constants that reduce the cost significantly, and by a share of it."""
    min_gain = min_cost_share * fit.cost
    estimates, values = _significant_constants(fit, selection.options, min_gain)
    estimates |= significant_drifts(fit, selection.options, min_gain)
    space = update_prior_trust(add_sensor_constants(fit.space, list(estimates)), selection.arm)
    return fit.with_unknowns(space, values | estimates) if estimates else None


add_coarse_sensor_constants = Candidate(
    partial(_with_significant_constants, min_cost_share=_MIN_COARSE_COST_SHARE),
    resumed_coarse_search,
    is_repeated=True,
)
add_fine_sensor_constants = Candidate(_with_significant_constants, refine, is_repeated=True)


def with_evident_constants(fit: Fit, selection: Selection) -> Fit:
    """The fit with the constants that are significant already, and with weights for them."""
    start = _with_significant_constants(fit, selection)
    if start is None:
        return fit
    return replace(start, objective=start.objective.update_weights(start.z))


def _without_least_significant(fit: Fit, selection: Selection) -> Fit | None:
    """The fit without its least significant sensor constant; None if all are significant.

    Insignificant drifts, each of a record of its own, are removed together.
    A constant at a bound of its range stays, because its standard deviation is invalid there. A
    bandwidth is tested in any case.
    """
    space = fit.space
    ideal = {
        key: constant.kind.nominal
        for key in space.keys
        if (constant := constant_of(key)) and constant.is_optional and not constant.is_of_mount
    }
    if not ideal:
        return None
    stds = np.sqrt(np.diag(confidence_of(fit).cautious))
    is_low, is_high = fit.z <= _BOUND_SHARE * space.lower, fit.z >= _BOUND_SHARE * space.upper
    rows = zip(space.keys, space.parameters(fit.z), stds, ~(is_low | is_high), strict=True)
    distances = {
        key: (abs(value - ideal[key]) if np.isfinite(ideal[key]) else value) / std
        for key, value, std, within in rows
        if key in ideal and (within or not np.isfinite(ideal[key]))
    }
    weak = {
        key
        for key, distance in distances.items()
        if distance < min(_MIN_KEPT_SIGNIFICANCE, _min_significance(key))
    }
    # a delay and a low-pass that cannot be separated both stay, and their intervals show it;
    # a sensor whose bandwidth is at the upper bound has no low-pass
    inseparable = {key for key in weak if _counterpart(key) in weak}
    unlimited = {key for key, high in zip(space.keys, is_high, strict=True) if high}
    weak -= {k for k in inseparable if not (is_kind(k, ConstantKind.BANDWIDTH) and k in unlimited)}
    if not weak:
        return None
    drifts = {key for key in weak if is_kind(key, ConstantKind.DRIFT)}
    removed = drifts or {min(weak, key=distances.__getitem__)}
    reduced = space.fix_values({key: ideal[key] for key in removed})
    return fit.with_unknowns(update_prior_trust(reduced, selection.arm))


remove_insignificant_sensor_constants = Candidate(
    _without_least_significant, refine, is_addition=False, is_repeated=True
)


_COUNTERPARTS = {
    ConstantKind.DELAY: ConstantKind.BANDWIDTH,
    ConstantKind.BANDWIDTH: ConstantKind.DELAY,
}


def _counterpart(key: Key) -> Key | None:
    """Bandwidth key for a delay key and vice versa; None for other keys."""
    constant = constant_of(key)
    other = _COUNTERPARTS.get(constant.kind) if constant else None
    if constant is None or other is None or key[1] is None:
        return None
    return replace(constant, kind=other).key(key[1])


def _significant_constants(
    fit: Fit, options: WholeArmOptions, min_gain: float
) -> tuple[Values, Values]:
    """Significant sensor constants, and all other values, after one linear step.

    Forward selection: each constant must reduce the cost by `min_gain` and significantly, given the
    constants before it.
    """
    included = set(fit.space.keys)
    candidates = [
        key
        for key in dict.fromkeys(k for r in fit.objective.records for k in constants_of(r))
        if key not in included and not is_held(key, options)
        if not is_kind(key, ConstantKind.DRIFT)
        if not _is_collinear_with_tilt(key, fit)
    ]
    if not candidates:
        return Values(), fit.values
    objective, values, simulated = fit.objective, fit.values, fit.objective.simulate(fit.z)

    def tangent(k: int, _: Evaluation) -> list[FloatArray]:
        initial = objective.initial_states(k)
        return [objective.records[k].sensor_tangent(simulated[k], values, initial, candidates)]

    n, R = len(fit.z), objective.factor_with_columns(fit.z, len(candidates), tangent)
    columns, target = R[n:, n:-1], R[n:, -1]
    selected: list[int] = []
    cost = float(target @ target)
    while remaining := set(range(len(candidates))) - set(selected):
        costs = {}
        for k in sorted(remaining):
            chosen = columns[:, [*selected, k]]
            step = np.linalg.lstsq(chosen, -target)[0]
            costs[k] = float(np.sum((target + chosen @ step) ** 2))
        enough = [
            k
            for k, value in costs.items()
            if cost - value >= max(_min_significance(candidates[k]) ** 2, min_gain)
        ]
        if not enough:
            break
        best = min(enough, key=costs.__getitem__)
        selected.append(best)
        cost = costs[best]
    sizes = np.linalg.lstsq(columns[:, selected], -target)[0]
    pairs = zip(selected, sizes.tolist(), strict=True)
    estimates = Values({candidates[k]: nominal(candidates[k]) + size for k, size in pairs})
    residual = R[:n, -1] + R[:n, n:-1][:, selected] @ sizes
    others = full_step(Linearised(cost, np.column_stack([R[:n, :n], residual])), fit.z, fit.space)
    return estimates, fit.space.values(others)


def _min_significance(key: Key) -> float:
    """Standard deviations from which a constant joins."""
    return _MIN_HOLD_SIGNIFICANCE if is_kind(key, ConstantKind.HOLD) else _MIN_SIGNIFICANCE


def significant_drifts(fit: Fit, options: WholeArmOptions, min_gain: float) -> dict[Key, float]:
    """Significant drifts of sensor biases and their rates, if they reduce the cost by `min_gain`.

    The weights of the fit count a drift as correlated errors. The standard deviation of a rate
    therefore follows from the residuals minus the drift, and is at least that of the noise: the
    readings of a silent sensor do not even vary. Over a slow motion, the error of rounding imitates
    a drift of up to three quarters of the resolution at the ends of a record.
    """
    objective, rates, gain = fit.objective, {}, 0.0
    of_records = zip(objective.records, objective.rows(fit.z), objective.weights, strict=True)
    for record, rows, weights in of_records:
        time = record.since_middle
        powers = weights.stds**2 * weights.rows_per_error
        each = zip(record.channels, rows.errors.T, record.noise, record.counts, powers, strict=True)
        for channel, residual, noise, count, power in each:
            key = channel.key(ConstantKind.DRIFT, record.log.name)
            if key is None or not channel.sensor.has_bias or key in objective.space.keys:
                continue
            if is_held(key, options):
                continue
            rate = float(-time @ residual / (time @ time))
            remaining = residual + rate * time
            size = max(float(np.std(remaining)), noise)
            std = size * np.sqrt(estimate_rows_per_error(remaining) / (time @ time))
            least = max(_MIN_DRIFT_RATIO * size, count)
            if abs(rate) > max(_MIN_SIGNIFICANCE * std, least / np.max(time)):
                rates[key] = rate
                gain += rate**2 * (time @ time) / power
    return rates if gain >= min_gain else {}


def _is_collinear_with_tilt(key: Key, fit: Fit) -> bool:
    """Whether a scale factor is collinear with the tilt of an IMU with two accelerometer axes.

    It is on a link that turns about one direction only.
    """
    axes = {axis for record in fit.objective.records for axis in record.channels}
    accelerometers = [
        axis for axis in axes if axis.joint == key[1] and isinstance(axis.sensor, ImuAccelerometers)
    ]
    return (
        len(accelerometers) == 2
        and accelerometers[0].space.axis is not None
        and key in [axis.key(ConstantKind.SCALE) for axis in accelerometers]
        and (IMU_ROTATION[0], key[1]) in fit.space.keys
    )


def sensor_warnings(parameters: Sequence[Parameter]) -> Iterator[Diagnostic]:
    """Warn of sensors with delays, scale errors, drifts or mount resonances."""
    for p in parameters:
        constant = constant_of(p.key)
        if constant is None or p.value is None:
            continue
        place, error = Place(joint=p.joint), p.value - constant.kind.nominal
        sensor, half = constant.owner.replace("_", " "), CI95_STDS * (p.std or 0.0)
        warn = partial(Diagnostic, sensor=sensor, half=half)
        match constant.kind:
            case ConstantKind.DRIFT:
                record = record_of(p.name)
                yield warn("sensor-drift", place, record=record, rate=p.value, unit=p.unit)
            case ConstantKind.DELAY if abs(error) >= _MIN_REPORTED_DELAY:
                side = "behind" if error > 0.0 else "ahead of"
                of_motor = constant.owner == MotorEncoder.name
                detail = "torque" if of_motor else "fitted"
                yield warn("sensor-delay", place, detail, delay=abs(error), side=side)
            case ConstantKind.HOLD if p.value > _MIN_REPORTED_HOLD:
                yield Diagnostic("torque-hold", place, share=p.value, half=half, joint=p.joint)
            case ConstantKind.SCALE if abs(error) >= _MIN_REPORTED_SCALE_ERROR:
                yield warn("sensor-scale", place, scale=p.value)
            case ConstantKind.MOUNT_FREQUENCY:
                yield warn("sensor-mount", place, joint=p.joint, frequency_hz=p.value)
            case _:
                pass
