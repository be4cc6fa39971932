"""Parameters of a whole-arm fit with confidence intervals, and their warnings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import (
    FloatArray,
    Parameter,
)
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.gear_laws import is_by_load
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors import constant_of
from strainwave.domain.parameter_table import VISCOUS
from strainwave.domain.units import unit_of
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.problem.prior import combination
from strainwave.identification.whole_arm.search.fit import Fit

# maximum relative standard deviation of a published viscous friction, slope or knee
_MAX_RELATIVE_STD = 0.3
_MOUNTING_STEP = 1e-6  # step of mounting unknowns for central differences [m or rad]


def parameters_of(
    fit: Fit, arm: Arm, largest_torque: Sequence[float]
) -> tuple[tuple[Parameter, ...], FloatArray]:
    """Compute the unknowns and derived parameters, with their covariance.

    `largest_torque` [N m] is the largest torque of each gear in the records. The covariance is
    (n_parameters, n_parameters).
    """
    space = fit.space
    keys = space.keys
    names = list(keys)
    units = [unknown.unit for unknown in space.unknowns]
    identified = _identified_curves(fit, confidence_of(fit).combined, arm, largest_torque)
    weights = [combination(keys, {identified.get(key) or key: 1.0}) for key in keys]
    constants = [0.0] * len(keys)
    for (name, number), parts in arm.reported.items():
        if number is None or not any(key in keys for key in parts):
            continue  # all parts are fixed
        names.append((name, number))
        units.append(unit_of(name, arm.joints[number - 1]))
        weights.append(combination(keys, parts))
        constants.append(sum(w * space.fixed.get(key, 0.0) for key, w in parts.items()))
    for name, number in vanished_parameters(fit, arm):
        names.append((name, number))
        units.append(unit_of(name, arm.joints[number - 1]))
        weights.append(combination(keys, {}))
        constants.append(0.0)
        identified[name, number] = None
    W = np.array(weights)
    values = W @ space.parameters(fit.z) + np.array(constants)
    mountings = mountings_of(fit)
    if mountings.names:
        names += mountings.names
        units += mountings.units
        W = np.vstack([W, mountings.slopes])
        values = np.concatenate([values, mountings.values])
    covariance = W @ confidence_of(fit).combined @ W.T
    variance = np.diag(covariance)
    stds = np.sqrt(np.where(variance >= 0.0, variance, np.inf))  # negative only by rounding
    stds[[identified.get(name, name) is None for name in names]] = np.inf
    parameters = tuple(
        _parameter(name, joint, unit, float(value), float(std))
        for (name, joint), unit, value, std in zip(names, units, values, stds, strict=True)
    )
    return parameters, covariance


@dataclass(frozen=True, slots=True)
class Mountings:
    """Positions and attitudes of IMUs, as functions of the unknowns."""

    names: list[Key]
    units: list[str]
    values: FloatArray  # (n,)
    slopes: FloatArray  # (n, n_unknowns)


def mountings_of(fit: Fit) -> Mountings:
    """Position and attitude of IMUs with unknown mounting, linearised at the minimum.

    Empty without such an IMU.
    """
    space = fit.space
    keys, fitted_values = space.keys, space.values(fit.z)
    channels = (channel for record in fit.objective.records for channel in record.channels)
    axes = dict.fromkeys(channel for channel in channels if channel.is_mounted)
    hidden = [k for k, key in enumerate(keys) if (one := constant_of(key)) and one.is_mounting]
    mountings = Mountings([], [], np.zeros(0), np.zeros((0, len(keys))))
    for joint in dict.fromkeys(axis.joint for axis in axes):
        sensor_axes = [axis for axis in axes if axis.joint == joint]
        sensor = sensor_axes[0].sensor
        positions = sensor.report(sensor_axes, fitted_values)
        slopes = np.zeros((len(positions), len(keys)))
        for k in hidden:
            ends = [
                sensor.report(
                    sensor_axes, {**fitted_values, keys[k]: fitted_values[keys[k]] + step}
                )
                for step in (_MOUNTING_STEP, -_MOUNTING_STEP)
            ]
            for row, (name, (_, unit)) in enumerate(positions.items()):
                difference = ends[0][name][0] - ends[1][name][0]
                if unit == "rad":
                    difference = float(np.arctan2(np.sin(difference), np.cos(difference)))
                slopes[row, k] = difference / (2.0 * _MOUNTING_STEP)
        mountings = Mountings(
            [*mountings.names, *((name, joint) for name in positions)],
            [*mountings.units, *(unit for _, unit in positions.values())],
            np.concatenate([mountings.values, [value for value, _ in positions.values()]]),
            np.vstack([mountings.slopes, slopes]),
        )
    return mountings


def vanished_parameters(fit: Fit, arm: Arm) -> Iterator[tuple[str, int]]:
    """Yield gear parameters that the fit fixes to zero."""
    for number, joint in enumerate(arm.joints, start=1):
        for name in joint.law.may_vanish:
            if fit.space.fixed.get((name, number)) == 0.0:
                yield name, number


def _identified_curves(
    fit: Fit, covariance: FloatArray, arm: Arm, largest_torque: Sequence[float]
) -> dict[Key, Key | None]:
    """Map each curve parameter to its unknown, or to None if no record reaches its torque."""
    space = fit.space
    at = {key: k for k, key in enumerate(space.keys)}
    values = space.values(fit.z)
    identified: dict[Key, Key | None] = {}
    pairs = zip(arm.joints, largest_torque, strict=True)
    for number, (joint, largest) in enumerate(pairs, start=1):
        columns = [at[name, number] for name in joint.law.names if (name, number) in at]
        if len(columns) < len(joint.law.names):
            continue
        curve = joint.law.of_joint(values, number)
        sources = joint.law.identified(curve, covariance[np.ix_(columns, columns)], largest)
        identified |= {
            (name, number): None if source is None else (source, number)
            for name, source in sources.items()
        }
    return identified


def _parameter(name: str, joint: int | None, unit: str, value: float, std: float) -> Parameter:
    may_be_vague = name in VISCOUS or is_by_load(name)
    is_vague = may_be_vague and std > _MAX_RELATIVE_STD * abs(value)
    if is_vague or not np.isfinite(std):
        return Parameter(name, joint, None, None, unit, "tuned")
    half_width = CI95_STDS * std
    return Parameter(
        name, joint, value, std, unit, "tuned", (value - half_width, value + half_width)
    )
