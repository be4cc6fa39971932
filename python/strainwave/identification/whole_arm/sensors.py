"""Constants of link sensors in the whole-arm fit: delays, scales, drifts by evidence only.

A score test says whether the residuals follow what a sensor's delay, scale or tilt would make of
its channel. A sensor without any costs nothing, and a clean rig's intervals stay as narrow as they
are: beside a free delay gear damping would be known less well. A late sensor whose bandwidth the
study does not have gets that as an unknown beside its delay: up to its own frequency a low-pass is
little else than a delay. Where a sensor sits, if that is not known, is an unknown from the start.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Parameter, TuningOptions
from strainwave.domain.parameter_table import base_name
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import (
    LARGEST_SCALE_ERROR,
    LONGEST_DELAY,
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
    DISTANCE,
    FROM_AXIS,
    PLACE,
    START,
    TILT,
    TURN,
    is_hidden,
    is_mounting,
)
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Evaluated, Objective, repeats_of
from strainwave.identification.whole_arm.parametrisation import Key, ParameterSpace, Unknown
from strainwave.identification.whole_arm.restricted import is_held
from strainwave.identification.whole_arm.selection import Selection
from strainwave.identification.whole_arm.solver import refined, resumed_coarse_search

_EVIDENT = 4.0  # deviations at which a constant joins: of eight candidates none by chance
_MATTERS_COARSELY = 0.1  # and share of the cost far from the minimum, where long steps err as well
_STANDS_OUT = 1.0  # deviations of the rest of the residuals, that a drift reaches by the end
_STAYS = 3.0  # and that it must keep, by the more cautious covariance

_AT_END = 0.99  # share of its range from which a constant is at its end
_SIZE = 0.1  # [m, or 1] of the parts of a mounting, at least
_NEAREST = 1e-3  # [m] from the axis, where a search for a distance may start
_FAR = 30.0  # of it, as far as they may go
_WIDE = float(np.log(30.0))  # and a bandwidth
_FASTEST = 1e4  # [m/s^3, or rad/s^2] of drifts
_LARGEST_TILT = 0.5  # [rad] of an accelerometer that is called tangential
_SHORTEST = 3e-5  # [s] of a delay that may be a low-pass: 7.5 kHz
_SHARE = 0.5  # of a delay that is first taken for a low-pass
_WORTH_DELAY = 1e-4  # [s] from which a rig is worth a look: half a sample of a usual logger
_WORTH_SCALE = 0.01  # what data sheets promise


def with_sensors(
    space: ParameterSpace, keys: Sequence[Key], starts: Values | None = None
) -> ParameterSpace:
    """The unknowns of some sensors' constants beside those there are.

    `starts`: Of a mounting and of bandwidths, which have no nominal value.
    """
    starts = starts or {}
    fixed = {key: value for key, value in starts.items() if key[0] in START}
    more = [_unknown(key, starts) for key in keys]
    rows = np.pad(space.prior.rows, ((0, 0), (0, len(more))))
    known = {**space.fixed, **fixed}
    return ParameterSpace((*space.unknowns, *more), known, replace(space.prior, rows=rows))


def _unknown(key: Key, starts: Values) -> Unknown:
    name, joint = key
    if is_mounting(key) and not is_optional(key):
        start = starts[key]
        if name == FROM_AXIS:
            start = max(start, _NEAREST)
            return Unknown(name, joint, "m", start, start, False, _WIDE)
        unit = "m" if name in (DISTANCE, FROM_AXIS, *PLACE) else "1" if is_hidden(key) else "rad"
        return Unknown(name, joint, unit, start, max(abs(start), _SIZE), True, _FAR)
    if is_bandwidth(key) or is_of_mount(key):
        unit = "1" if name.endswith("_damping") else "Hz"
        return Unknown(name, joint, unit, starts[key], starts[key], False, _WIDE)
    if name == TILT:
        return Unknown(name, joint, "rad", 0.0, _LARGEST_TILT, True, 1.0)
    if is_drift(key):
        unit = "m/s^3" if name.startswith(("accelerometer", "imu_a")) else "rad/s^2"
        return Unknown(name, joint, unit, 0.0, 1.0, True, _FASTEST)
    unit, scale = ("s", LONGEST_DELAY) if name.endswith("_delay") else ("1", LARGEST_SCALE_ERROR)
    return Unknown(name, joint, unit, nominal(key), scale, True, 1.0)


def with_bandwidths_apart(fit: Fit, selection: Selection, *, coarse: bool) -> Fit:
    """A fit with the bandwidths of late sensors beside their delays, where none is given.

    `coarse`: Whether the fit is only near the minimum, and may stay so.
    """
    arm, options = selection.arm, selection.options
    space = fit.objective.space
    values, starts = space.values(fit.z), {}
    for delay, bandwidth in _late(fit, arm):
        late = values[delay]
        if late > _SHORTEST and bandwidth not in values and not is_held(bandwidth, options):
            starts[bandwidth] = np.sqrt(2.0) / (2.0 * np.pi * _SHARE * late)
            values[delay] = (1.0 - _SHARE) * late
    if not starts or fit.iterations >= options.max_iterations:
        return fit
    wider = with_sensors(space, list(starts), starts)
    objective, begin = fit.objective.for_unknowns(wider), wider.coordinates(values | starts)
    if coarse:
        return resumed_coarse_search(objective, begin, fit.iterations, options)
    return _refined_from(fit, objective, begin, options)


def _late(fit: Fit, arm: Arm) -> Iterator[tuple[Key, Key]]:
    """Sensors whose delay is an unknown and whose bandwidth the study does not have."""
    keys, seen = fit.objective.space.keys, set()
    for channel in (c for record in fit.objective.records for c in record.channels):
        delay, bandwidth = (of(channel.sensor, channel.joint) for of in (delay_of, bandwidth_of))
        if delay is None or bandwidth is None or delay not in keys or delay in seen:
            continue
        seen.add(delay)
        drive = arm.joints[channel.joint - 1]
        sensor = channel.sensor
        given = getattr(drive, f"{sensor}_hz", None)
        if sensor.startswith("imu_"):
            given = getattr(drive.imu, f"{sensor[len('imu_') :]}_hz", None)
        if given is None:
            yield delay, bandwidth


def with_evident_sensors(fit: Fit, selection: Selection, *, coarse: bool) -> Fit:
    """A fit with those sensor constants besides that its residuals speak for.

    `coarse`: Whether the fit is only near the minimum, and may stay so.
    """
    options = selection.options
    while fit.iterations < options.max_iterations and not options.as_published:
        sizes = _evident(fit, options, _MATTERS_COARSELY * fit.cost if coarse else 0.0)
        sizes |= _evident_drifts(fit, options)
        if not sizes:
            break
        values = fit.objective.space.values(fit.z)
        space = with_sensors(fit.objective.space, list(sizes))
        begin = space.coordinates(values | sizes)
        objective = fit.objective.for_unknowns(space)
        if coarse:
            fit = resumed_coarse_search(objective, begin, fit.iterations, options)
        else:
            fit = _refined_from(fit, objective, begin, options)
    return fit


def _refined_from(fit: Fit, objective: Objective, z: FloatArray, options: TuningOptions) -> Fit:
    """The minimum near a point, by other unknowns than the fit's."""
    near = replace(fit, objective=objective, z=z, cost=np.inf, converged=False)
    return refined(near, options)


def without_idle_sensors(fit: Fit, selection: Selection) -> Fit:
    """Again without the sensor constants that are nothing as far as the records say."""
    while idle := _idle(fit):
        values = fit.objective.space.values(fit.z)
        space = fit.objective.space.holding(idle)
        fit = _refined_from(
            fit, fit.objective.for_unknowns(space), space.coordinates(values), selection.options
        )
    return fit


def _idle(fit: Fit) -> dict[Key, float]:
    """The least evident of those constants, at its nominal value; empty if there is none.

    One at the end of its range is wrong, whatever its deviation by a fit that it spoils.
    """
    space = fit.objective.space
    optional = [key for key in space.keys if is_optional(key) and not is_of_mount(key)]
    if not optional:
        return {}
    deviation = np.sqrt(np.diag(fit.confidence.cautious))
    inside = (fit.z > _AT_END * space.lower) & (fit.z < _AT_END * space.upper)
    rows = zip(space.keys, space.parameters(fit.z), deviation, inside, strict=True)
    apart = {
        key: (value if is_bandwidth(key) else abs(value - nominal(key))) / std
        for key, value, std, within in rows
        if key in optional and (within or is_bandwidth(key))
    }
    for key in [key for key in apart if _twin(key) in apart and _twin(key) != key]:
        # a delay and a low-pass that cannot be separated both stay, and say so
        if apart[key] < _STAYS and apart[_twin(key)] < _STAYS and not _ended(fit, key):
            del apart[key]
    least = min(apart, key=lambda key: apart[key], default=None)
    return {least: nominal(least)} if least is not None and apart[least] < _STAYS else {}


def _twin(key: Key) -> Key:
    """A sensor's delay by its bandwidth, and the other way round."""
    name, joint = key
    sensor, _, what = name.rpartition("_")
    other = {"delay": "bandwidth", "bandwidth": "delay"}.get(what, what)
    return f"{sensor}_{other}", joint


def _ended(fit: Fit, key: Key) -> bool:
    """Whether a bandwidth is as wide as it may be: there is no low-pass."""
    k = fit.objective.space.keys.index(key)
    return is_bandwidth(key) and bool(fit.z[k] > _AT_END * fit.objective.space.upper[k])


def _evident(fit: Fit, options: TuningOptions, least: float) -> dict[Key, float]:
    """Sensor constants that a linear step would give a value that is evident, with that value.

    One after the other, each beside those before it, as long as it gains at least so much.
    """
    known = set(fit.objective.space.keys)
    candidates = [
        key
        for key in dict.fromkeys(k for r in fit.objective.records for k in r.sensor_constants())
        if key not in known and not is_drift(key) and not is_held(key, options)
        if not _imitated(key, fit)
    ]
    if not candidates:
        return {}
    factor = _scores(fit, candidates)
    columns, target = factor[:, :-1], factor[:, -1]
    taken: list[int] = []
    left = float(target @ target)
    while len(taken) < len(candidates):
        costs = {k: _left(columns[:, [*taken, k]], target) for k in range(len(candidates))}
        best = min((k for k in costs if k not in taken), key=lambda k: costs[k])
        if left - costs[best] < max(_EVIDENT**2, least):
            break
        taken.append(best)
        left = costs[best]
    if not taken:
        return {}
    sizes = np.linalg.lstsq(columns[:, taken], -target)[0]
    return {
        candidates[k]: nominal(candidates[k]) + float(size)
        for k, size in zip(taken, sizes, strict=True)
    }


def _evident_drifts(fit: Fit, options: TuningOptions) -> dict[Key, float]:
    """Drifts that stand out of what their channels' residuals are without them, with their rates.

    By the fit's weights errors in a row say the same thing, and a drift is one long row of them:
    here the deviation of a rate is that of residuals less the drift.
    """
    objective, found = fit.objective, {}
    each = zip(objective.records, objective.weights, objective.rows(fit.z), strict=True)
    for record, weights, rows in each:
        since = record.since_middle
        residuals = rows.residual * weights.deviation
        for channel, residual in zip(record.channels, residuals.T, strict=True):
            key = drift_of(channel.scaled, channel.joint, record.log.name)
            wanted = channel.shifted and key is not None and not is_held(key, options)
            if key is None or not wanted or key in objective.space.keys:
                continue
            rate = float(-since @ residual / (since @ since))
            rest = residual + rate * since
            std = np.std(rest) * np.sqrt(repeats_of(rest) / (since @ since))
            if abs(rate) > max(_EVIDENT * std, _STANDS_OUT * np.std(rest) / np.max(since)):
                found[key] = rate
    return found


def _imitated(key: Key, fit: Fit) -> bool:
    """Whether a scale is what a tilt makes of two accelerometers."""
    name, joint = key
    if not name.startswith("imu_a") or not name.endswith("_scale"):
        return False
    axes = {c.axis for record in fit.objective.records for c in record.channels}
    count = sum(a.kind == "accelerometer" and a.joint == joint for a in axes if a is not None)
    return count == 2 and (TURN[0], joint) in fit.objective.space.keys


def _scores(fit: Fit, keys: Sequence[Key]) -> FloatArray:
    objective = fit.objective
    values, simulated = objective.space.values(fit.z), objective.simulated(fit.z)

    def tangent(k: int, _: Evaluated) -> FloatArray:
        record = objective.records[k]
        local = objective.memory.own[k][: len(record.local)]
        return record.sensor_tangent(simulated[k], values, local, keys)

    n = len(objective.space.unknowns)
    return objective.bordered(fit.z, len(keys), tangent)[n:, n:]


def _left(columns: FloatArray, target: FloatArray) -> float:
    """The least squares cost with some columns."""
    step = np.linalg.lstsq(columns, -target)[0]
    return float(np.sum((target + columns @ step) ** 2))


def sensor_warnings(parameters: Sequence[Parameter]) -> Iterator[Diagnostic]:
    """What a reader must know of a rig whose link sensors are late or out of scale."""
    for found in parameters:
        key = found.name, found.joint
        if is_drift(key) and found.value is not None:
            yield _drifts(found, found.value)
        if not found.name.endswith(("_delay", "_scale")) or found.value is None:
            continue
        if not is_optional(key):
            continue
        least = _WORTH_DELAY if found.name.endswith("_delay") else _WORTH_SCALE
        if abs(found.value - nominal(key)) < least:
            continue
        sensor = found.name.rsplit("_", 1)[0].replace("_", " ")
        half = 1.96 * (found.std or 0.0)
        if found.name.endswith("_delay"):
            side = "behind" if found.value > 0.0 else "ahead of"
            text = f"the {sensor} is {1e3 * abs(found.value):.3g} ± {1e3 * half:.2g} ms {side} the"
            text += (
                " motor encoder; estimated and corrected. Likely causes: its bandwidth is missing"
            )
            text += " from the study, latency of its converter or bus, time stamps"
            yield Diagnostic("sensor-delay", f"joint {found.joint}", text)
        else:
            text = f"the {sensor} reads {found.value:.4g} ± {half:.2g} times the motion; estimated"
            text += (
                " and corrected. Likely causes: its calibration, its distance from the axis in the"
            )
            text += " study, its direction"
            yield Diagnostic("sensor-scale", f"joint {found.joint}", text)


def _drifts(found: Parameter, rate: float) -> Diagnostic:
    name = base_name(found.name)
    sensor, record = name.removesuffix("_drift").replace("_", " "), found.name[len(name) + 1 : -1]
    half = 1.96 * (found.std or 0.0)
    text = f"in {record} the {sensor} drifts by {rate:.3g} ± {half:.2g} {found.unit}; estimated and"
    text += " corrected. Likely causes: it warms up, its supply, an amplifier that recovers"
    return Diagnostic("sensor-drift", f"joint {found.joint}", text)
