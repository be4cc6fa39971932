"""Selection of link sensor constants: delays, scale factors, tilts, bandwidths and drifts.

The whole-arm fit estimates a constant only if a score test finds it significant. An unnecessary
delay would widen the confidence interval of the gear damping. A delayed sensor of unknown bandwidth
gets its bandwidth as a further unknown, because a low-pass is nearly a pure delay below its
bandwidth. Unknown mountings are estimated from the start.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import (
    Diagnostic,
    FloatArray,
    Parameter,
    Place,
    WholeArmOptions,
)
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.keys import Key, Values
from strainwave.domain.parameter_table import base_name
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import (
    MAX_SCALE_ERROR,
    MAX_SENSOR_DELAY,
    bandwidth_of,
    delay_of,
    drift_of,
    is_bandwidth,
    is_drift,
    is_of_mount,
    is_optional,
    nominal,
)
from strainwave.dynamics.mounting import (
    ACCELEROMETER_DISTANCE,
    ACCELEROMETER_TILT,
    IMU_DISTANCE,
    IMU_POSITION,
    IMU_ROTATION,
    IMU_START_ATTITUDE,
    is_hidden,
    is_mounting,
)
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.problem.error_correlation import estimate_rows_per_error
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace, Unknown
from strainwave.identification.whole_arm.problem.restrictions import is_held
from strainwave.identification.whole_arm.problem.weighted_rows import Evaluation
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import refine, resumed_coarse_search
from strainwave.identification.whole_arm.selection.candidate import Selection

# standard deviations from which a constant joins: no false alarm in 8 candidates
_MIN_SIGNIFICANCE = 4.0
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
_DRIFT_RANGE = 1e4  # [m/s^3 or rad/s^2] range of drifts
_TILT_RANGE = 0.5  # [rad] range of the tilt of a tangential accelerometer
_MIN_LOW_PASS_DELAY = 3e-5  # [s] minimum delay that a low-pass may explain, of 7.5 kHz
_LOW_PASS_DELAY_SHARE = 0.5  # share of a delay that the starting bandwidth explains
_MIN_REPORTED_DELAY = 1e-4  # [s] minimum delay of a warning: half a sample of a typical logger
# minimum scale error of a warning: typical tolerance of a data sheet
_MIN_REPORTED_SCALE_ERROR = 0.01


def add_sensor_constants(
    space: ParameterSpace, keys: Sequence[Key], starts: Values | None = None
) -> ParameterSpace:
    """Add sensor constants to the unknowns.

    `starts` gives the starting values of constants without a nominal value: those of mountings,
    bandwidths and mount resonances.
    """
    starts = starts or {}
    fixed = {key: value for key, value in starts.items() if key[0] in IMU_START_ATTITUDE}
    added = [_unknown_of(key, starts) for key in keys]
    rows = np.pad(space.prior.rows, ((0, 0), (0, len(added))))
    known_values = {**space.fixed, **fixed}
    return ParameterSpace((*space.unknowns, *added), known_values, replace(space.prior, rows=rows))


def _unknown_of(key: Key, starts: Values) -> Unknown:
    """Unknown of a sensor constant, with its starting value, scale and range."""
    name, joint = key
    if is_mounting(key) and not is_optional(key):
        start = starts[key]
        if name == IMU_DISTANCE:
            start = max(start, _MIN_START_DISTANCE)
            return Unknown(name, joint, "m", start, start, False, _LOG_RANGE)
        unit = (
            "m"
            if name in (ACCELEROMETER_DISTANCE, IMU_DISTANCE, *IMU_POSITION)
            else "1"
            if is_hidden(key)
            else "rad"
        )
        return Unknown(
            name, joint, unit, start, max(abs(start), _MIN_MOUNTING_SCALE), True, _MOUNTING_RANGE
        )
    if is_bandwidth(key) or is_of_mount(key):
        unit = "1" if name.endswith("_damping") else "Hz"
        return Unknown(name, joint, unit, starts[key], starts[key], False, _LOG_RANGE)
    if name == ACCELEROMETER_TILT:
        return Unknown(name, joint, "rad", 0.0, _TILT_RANGE, True, 1.0)
    if is_drift(key):
        unit = "m/s^3" if name.startswith(("accelerometer", "imu_a")) else "rad/s^2"
        return Unknown(name, joint, unit, 0.0, 1.0, True, _DRIFT_RANGE)
    unit, scale = ("s", MAX_SENSOR_DELAY) if name.endswith("_delay") else ("1", MAX_SCALE_ERROR)
    return Unknown(name, joint, unit, nominal(key), scale, True, 1.0)


def add_sensor_bandwidths(fit: Fit, selection: Selection, *, coarse: bool) -> Fit:
    """Add the bandwidths of delayed sensors whose bandwidth the study does not give.

    The starting values attribute half of each delay to the low-pass. `coarse` selects the search
    that follows.
    """
    arm, options = selection.arm, selection.options
    space = fit.objective.space
    values, starts = space.values(fit.z), {}
    for delay, bandwidth in _delayed_sensors(fit, arm):
        lag = values[delay]
        if (
            lag > _MIN_LOW_PASS_DELAY
            and bandwidth not in values
            and not is_held(bandwidth, options)
        ):
            starts[bandwidth] = np.sqrt(2.0) / (2.0 * np.pi * _LOW_PASS_DELAY_SHARE * lag)
            values[delay] = (1.0 - _LOW_PASS_DELAY_SHARE) * lag
    if not starts or fit.iterations >= options.max_iterations:
        return fit
    extended = add_sensor_constants(space, list(starts), starts)
    objective, start = (
        fit.objective.replace_unknowns(extended),
        extended.coordinates(values | starts),
    )
    if coarse:
        return resumed_coarse_search(objective, start, fit.iterations, options)
    return _refine_from(fit, objective, start, options)


def _delayed_sensors(fit: Fit, arm: Arm) -> Iterator[tuple[Key, Key]]:
    """Delay and bandwidth keys of sensors with an estimated delay and no bandwidth in the study."""
    keys, visited = fit.objective.space.keys, set()
    for channel in (c for record in fit.objective.records for c in record.channels):
        delay, bandwidth = (of(channel.sensor, channel.joint) for of in (delay_of, bandwidth_of))
        if delay is None or bandwidth is None or delay not in keys or delay in visited:
            continue
        visited.add(delay)
        joint_data = arm.joints[channel.joint - 1]
        sensor = channel.sensor
        given = getattr(joint_data, f"{sensor}_hz", None)
        if sensor.startswith("imu_"):
            given = getattr(joint_data.imu, f"{sensor[len('imu_') :]}_hz", None)
        if given is None:
            yield delay, bandwidth


def add_significant_sensor_constants(fit: Fit, selection: Selection, *, coarse: bool) -> Fit:
    """Add significant sensor constants until none is left.

    `coarse` selects the search that follows and raises the required cost reduction.
    """
    options = selection.options
    while fit.iterations < options.max_iterations and not options.as_published:
        estimates = _significant_constants(
            fit, options, _MIN_COARSE_COST_SHARE * fit.cost if coarse else 0.0
        )
        estimates |= _significant_drifts(fit, options)
        if not estimates:
            break
        values = fit.objective.space.values(fit.z)
        space = add_sensor_constants(fit.objective.space, list(estimates))
        start = space.coordinates(values | estimates)
        objective = fit.objective.replace_unknowns(space)
        if coarse:
            fit = resumed_coarse_search(objective, start, fit.iterations, options)
        else:
            fit = _refine_from(fit, objective, start, options)
    return fit


def _refine_from(fit: Fit, objective: Objective, z: FloatArray, options: WholeArmOptions) -> Fit:
    """Refine from `z` (n_unknowns,) with the changed unknowns of `objective`."""
    start = replace(fit, objective=objective, z=z, cost=np.inf, converged=False)
    return refine(start, options)


def remove_insignificant_sensor_constants(fit: Fit, selection: Selection) -> Fit:
    """Remove sensor constants that are not significant, one by one."""
    while insignificant := _least_significant(fit):
        values = fit.objective.space.values(fit.z)
        space = fit.objective.space.fix_values(insignificant)
        fit = _refine_from(
            fit, fit.objective.replace_unknowns(space), space.coordinates(values), selection.options
        )
    return fit


def _least_significant(fit: Fit) -> dict[Key, float]:
    """Least significant sensor constant and its nominal value; empty if all are significant.

    A constant at a bound of its range stays, because its standard deviation is invalid there. A
    bandwidth is tested in any case.
    """
    space = fit.objective.space
    optional = [key for key in space.keys if is_optional(key) and not is_of_mount(key)]
    if not optional:
        return {}
    stds = np.sqrt(np.diag(confidence_of(fit).cautious))
    within_range = (fit.z > _BOUND_SHARE * space.lower) & (fit.z < _BOUND_SHARE * space.upper)
    rows = zip(space.keys, space.parameters(fit.z), stds, within_range, strict=True)
    distances = {
        key: (value if is_bandwidth(key) else abs(value - nominal(key))) / std
        for key, value, std, within in rows
        if key in optional and (within or is_bandwidth(key))
    }
    for key in [
        key for key in distances if _counterpart(key) in distances and _counterpart(key) != key
    ]:
        # a delay and a low-pass that cannot be separated both stay; their intervals show it
        if (
            distances[key] < _MIN_KEPT_SIGNIFICANCE
            and distances[_counterpart(key)] < _MIN_KEPT_SIGNIFICANCE
            and not _is_at_upper_bound(fit, key)
        ):
            del distances[key]
    weakest = min(distances, key=lambda key: distances[key], default=None)
    return (
        {weakest: nominal(weakest)}
        if weakest is not None and distances[weakest] < _MIN_KEPT_SIGNIFICANCE
        else {}
    )


def _counterpart(key: Key) -> Key:
    """Bandwidth key for a delay key and vice versa; other keys are unchanged."""
    name, joint = key
    sensor, _, quantity = name.rpartition("_")
    other = {"delay": "bandwidth", "bandwidth": "delay"}.get(quantity, quantity)
    return f"{sensor}_{other}", joint


def _is_at_upper_bound(fit: Fit, key: Key) -> bool:
    """Whether a bandwidth is at its upper bound, so that the sensor has no low-pass."""
    k = fit.objective.space.keys.index(key)
    return is_bandwidth(key) and bool(fit.z[k] > _BOUND_SHARE * fit.objective.space.upper[k])


def _significant_constants(fit: Fit, options: WholeArmOptions, min_gain: float) -> dict[Key, float]:
    """Significant sensor constants and their values after one linear step.

    Forward selection: each constant must reduce the cost by `min_gain` and significantly, given the
    constants before it.
    """
    included = set(fit.objective.space.keys)
    candidates = [
        key
        for key in dict.fromkeys(k for r in fit.objective.records for k in r.sensor_constants())
        if key not in included and not is_drift(key) and not is_held(key, options)
        if not _is_collinear_with_tilt(key, fit)
    ]
    if not candidates:
        return {}
    factor = _score_factor(fit, candidates)
    columns, target = factor[:, :-1], factor[:, -1]
    selected: list[int] = []
    cost = float(target @ target)
    while len(selected) < len(candidates):
        costs = {
            k: _residual_cost(columns[:, [*selected, k]], target) for k in range(len(candidates))
        }
        best = min((k for k in costs if k not in selected), key=lambda k: costs[k])
        if cost - costs[best] < max(_MIN_SIGNIFICANCE**2, min_gain):
            break
        selected.append(best)
        cost = costs[best]
    if not selected:
        return {}
    estimates = np.linalg.lstsq(columns[:, selected], -target)[0]
    return {
        candidates[k]: nominal(candidates[k]) + float(size)
        for k, size in zip(selected, estimates, strict=True)
    }


def _significant_drifts(fit: Fit, options: WholeArmOptions) -> dict[Key, float]:
    """Significant drifts of sensor biases and their rates.

    The weights of the fit count a drift as correlated errors. The standard deviation of a rate
    therefore follows from the residuals minus the drift.
    """
    objective, rates = fit.objective, {}
    evaluated = zip(objective.records, objective.weights, objective.rows(fit.z), strict=True)
    for record, weights, rows in evaluated:
        time = record.since_middle
        residuals = rows.residual * weights.stds
        for channel, residual in zip(record.channels, residuals.T, strict=True):
            key = drift_of(channel.scaled, channel.joint, record.log.name)
            is_candidate = channel.shifted and key is not None and not is_held(key, options)
            if key is None or not is_candidate or key in objective.space.keys:
                continue
            rate = float(-time @ residual / (time @ time))
            remaining = residual + rate * time
            std = np.std(remaining) * np.sqrt(estimate_rows_per_error(remaining) / (time @ time))
            if abs(rate) > max(
                _MIN_SIGNIFICANCE * std, _MIN_DRIFT_RATIO * np.std(remaining) / np.max(time)
            ):
                rates[key] = rate
    return rates


def _is_collinear_with_tilt(key: Key, fit: Fit) -> bool:
    """Whether a scale factor is collinear with the tilt of an IMU with two accelerometer axes."""
    name, joint = key
    if not name.startswith("imu_a") or not name.endswith("_scale"):
        return False
    axes = {c.axis for record in fit.objective.records for c in record.channels}
    count = sum(a.kind == "accelerometer" and a.joint == joint for a in axes if a is not None)
    return count == 2 and (IMU_ROTATION[0], joint) in fit.objective.space.keys


def _score_factor(fit: Fit, keys: Sequence[Key]) -> FloatArray:
    """R of [sensor constants, residual] after projection on the complement of the unknowns."""
    objective = fit.objective
    values, simulated = objective.space.values(fit.z), objective.simulated(fit.z)

    def tangent(k: int, _: Evaluation) -> FloatArray:
        record = objective.records[k]
        local = objective.memory.record_parameters[k][: len(record.initial_states)]
        return record.sensor_tangent(simulated[k], values, local, keys)

    n = len(objective.space.unknowns)
    return objective.factor_with_columns(fit.z, len(keys), tangent)[n:, n:]


def _residual_cost(columns: FloatArray, target: FloatArray) -> float:
    """Residual sum of squares after regression on the columns."""
    step = np.linalg.lstsq(columns, -target)[0]
    return float(np.sum((target + columns @ step) ** 2))


def sensor_warnings(parameters: Sequence[Parameter]) -> Iterator[Diagnostic]:
    """Warn of link sensors with delays, scale errors or drifts."""
    for parameter in parameters:
        key = parameter.name, parameter.joint
        if is_drift(key) and parameter.value is not None:
            yield _drift_warning(parameter, parameter.value)
        if not parameter.name.endswith(("_delay", "_scale")) or parameter.value is None:
            continue
        if not is_optional(key):
            continue
        threshold = (
            _MIN_REPORTED_DELAY if parameter.name.endswith("_delay") else _MIN_REPORTED_SCALE_ERROR
        )
        if abs(parameter.value - nominal(key)) < threshold:
            continue
        sensor = parameter.name.rsplit("_", 1)[0].replace("_", " ")
        half = CI95_STDS * (parameter.std or 0.0)
        if parameter.name.endswith("_delay"):
            side = "behind" if parameter.value > 0.0 else "ahead of"
            text = (
                f"the {sensor} is {1e3 * abs(parameter.value):.3g} ± {1e3 * half:.2g} ms {side} the"
            )
            text += (
                " motor encoder. The fit corrects the delay. Likely causes are a bandwidth that is"
            )
            text += " missing from the study, latency of the converter or bus, and time stamps"
            yield Diagnostic.at("sensor-delay", Place(joint=parameter.joint), text)
        else:
            text = (
                f"the {sensor} reads {parameter.value:.4g} ± {half:.2g} times the motion. The fit"
            )
            text += (
                " corrects the scale. Likely causes are the calibration, the distance from the axis"
            )
            text += " in the study and the direction of the sensor"
            yield Diagnostic("sensor-scale", f"joint {parameter.joint}", text)


def _drift_warning(estimate: Parameter, rate: float) -> Diagnostic:
    """Warn about the drift of a sensor."""
    name = base_name(estimate.name)
    sensor, record = (
        name.removesuffix("_drift").replace("_", " "),
        estimate.name[len(name) + 1 : -1],
    )
    half = CI95_STDS * (estimate.std or 0.0)
    text = f"in {record} the {sensor} drifts by {rate:.3g} ± {half:.2g} {estimate.unit}. The fit"
    text += " corrects the drift. Likely causes are warm-up, the supply, and the recovery of an"
    text += " amplifier"
    return Diagnostic("sensor-drift", f"joint {estimate.joint}", text)
