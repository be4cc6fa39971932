"""Predicted benefit of an additional link sensor, from the Fisher information of the fit.

Each record is simulated with the missing sensors. The Fisher information requires only the
derivatives of their readings with respect to the unknowns and the sensor noise, not measurements.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, Joint, LinkSensor, Parameter, SensorGain
from strainwave.domain.keys import Key
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import is_sensor_constant
from strainwave.dynamics.simulation import Quantity, SensorNoise
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.inference.covariance import (
    confidence_of,
    inverse_information,
)
from strainwave.identification.whole_arm.problem.error_correlation import filtered_rows_per_error
from strainwave.identification.whole_arm.problem.objective import MIN_ERROR_SHARE
from strainwave.identification.whole_arm.problem.prior import combination
from strainwave.identification.whole_arm.problem.weighted_rows import Rows
from strainwave.identification.whole_arm.records.dataset import Channel, Dataset
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.parallel import run_parallel

_ACCELEROMETER_HZ = 300.0  # [Hz] bandwidth of a typical accelerometer
_GYRO_HZ = 100.0  # [Hz] bandwidth of a typical gyro
_GYRO_DENSITY = float(np.radians(0.01))  # [rad/s/sqrt(Hz)] noise density of a typical gyro
_LINK_COUNTS = 2**17  # counts per turn of a typical link encoder
_DEFAULT_DISTANCE = 0.3  # [m] of an accelerometer from the axis if the study gives no length
_MEAN_ROBUST_WEIGHT = 0.79  # mean weight (1 + r^2)^(-1/2) of the soft L1 loss, r standard normal
# prefixes of the reported parameters
_REPORTED_PREFIXES = ("gear_", "motor_inertia", "link_inertia")


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A sensor that a link lacks."""

    sensor: LinkSensor
    channel: Channel
    assumed: str  # assumed specification, as text


def sensor_gains(fit: Fit, arm: Arm, parameters: Sequence[Parameter]) -> list[SensorGain]:
    """Predict the standard deviations with one additional link sensor in the same records.

    The predicted variance is the larger one of two. The first is that of the sandwich
    B (H C H + S) B, with C the covariance of the fit, H its information, S that of the sensor by
    its specification, and B = (H + S)^-1. It holds if the errors of the fit are noise. Model errors
    also affect the additional sensor, so the second is the variance of the fit times the ratio of
    the local variances, B over H^-1.

    Robust weights, repetitions and record parameters are those of the fit. Each sensor has an
    unknown bias, and its standard deviation is at least 1e-3 of that of its reading.

    `fit` is at its minimum, and `parameters` are its published parameters. Returns the gains of
    gear parameters and inertias for each candidate sensor of an elastic joint whose link has none
    in any record. The list is empty if there is no candidate or the simulation fails.
    """
    candidates = list(_candidates(fit.objective.records, arm))
    reported = [
        p for p in parameters if p.name.startswith(_REPORTED_PREFIXES) and p.value and p.std
    ]
    if not candidates or not reported:
        return []
    try:
        parts = _information(fit, arm, candidates)
    except (InvalidInput, NumericalFailure):
        return []
    space = fit.objective.space
    slope = space.slope(fit.z)
    prior = space.linearise_prior(fit.z)[0]
    prior_information = prior.T @ prior
    W = np.array([_weights(p, space.keys, arm) for p in reported]) @ slope
    present, *extended = [sum(own, prior_information) for own in zip(*parts, strict=True)]
    own = np.linalg.inv(space.slope(fit.z))
    meat = present @ own @ confidence_of(fit).combined @ own.T @ present
    local = _variances(W, inverse_information(present))
    gains = []
    for candidate, information in zip(candidates, extended, strict=True):
        inverse = inverse_information(information)
        stds = np.array([p.std for p in reported])
        sandwich = _variances(W, inverse @ (meat + information - present) @ inverse)
        shares = np.maximum(sandwich / stds**2, _variances(W, inverse) / local)
        shares = np.sqrt(np.minimum(1.0, shares))
        for parameter, share in zip(reported, shares.tolist(), strict=True):
            gains.append(_gain(candidate, parameter, share))
    return gains


def _variances(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variances (n_rows,) of linear combinations, one per row."""
    return np.asarray(np.einsum("ij,jk,ik->i", rows, covariance, rows))


def _gain(candidate: _Candidate, parameter: Parameter, share: float) -> SensorGain:
    """Gain of a candidate; `share` is the predicted over the present standard deviation."""
    assert parameter.std is not None
    return SensorGain(
        sensor=candidate.sensor,
        link=candidate.channel.joint,
        assumed=candidate.assumed,
        name=parameter.name,
        joint=parameter.joint,
        std=parameter.std,
        predicted_std=share * parameter.std,
        value=parameter.value or 0.0,
    )


def _weights(parameter: Parameter, keys: Sequence[Key], arm: Arm) -> FloatArray:
    """Weights (n_unknowns,) of a parameter as a linear combination of the unknowns."""
    key = (parameter.name, parameter.joint)
    if key in keys or parameter.joint is None:
        return combination(keys, {key: 1.0})
    return combination(keys, arm.link_inertia(parameter.joint))


def _candidates(records: Sequence[Dataset], arm: Arm) -> Iterator[_Candidate]:
    """Candidate sensors of elastic joints whose link has no sensor in any record."""
    sensed_joints = {c.joint for r in records for c in r.channels if c.quantity != "motor_angle"}
    for number, joint in enumerate(arm.joints, start=1):
        if number in sensed_joints or not joint.elastic:
            continue
        density = SensorNoise().accelerometer_density
        place = ""
        if joint.motion == "revolute":
            place = f", {_distance(joint, arm):.2g} m from the joint's axis"
        hz = joint.accelerometer_hz or _ACCELEROMETER_HZ
        yield _Candidate(
            "accelerometer",
            Channel(f"a{number}", number, "accelerometer", rate=False, shifted=True),
            f"{hz:g} Hz, {1e3 * density:.2g} mm/s^2/sqrt(Hz){place}",
        )
        if joint.motion == "prismatic":
            continue
        yield _Candidate(
            "link-encoder",
            Channel(f"theta_l{number}", number, "link_angle", rate=True, shifted=False),
            f"{_LINK_COUNTS} counts per turn",
        )
        yield _Candidate(
            "gyro",
            Channel(f"gyro{number}", number, "gyro", rate=False, shifted=True),
            f"{joint.gyro_hz or _GYRO_HZ:g} Hz, 0.01 deg/s/sqrt(Hz)",
        )


def _distance(joint: Joint, arm: Arm) -> float:
    """Distance [m] of the accelerometer from the axis: given, or the length of the first link."""
    length = math.hypot(*arm.joints[-1].origin.xyz)
    return joint.accelerometer_distance or length or _DEFAULT_DISTANCE


def _information(fit: Fit, arm: Arm, candidates: Sequence[_Candidate]) -> list[list[FloatArray]]:
    """Fisher information (n_unknowns, n_unknowns) of each record, without and with each sensor."""
    objective, values = fit.objective, fit.objective.space.values(fit.z)
    keys, slope = objective.space.keys, objective.space.slope(fit.z)
    parameter_places = [k for k, key in enumerate(keys) if not is_sensor_constant(key)]

    def one(record: Dataset, rows: Rows) -> list[FloatArray]:
        extended = _with_candidates(record, arm, candidates)
        n_begin, n_own = len(record.initial_states), len(rows.step)
        initial_states = (rows.evaluated.record_parameters + rows.step)[:n_begin]
        readings, tangent = extended.linearised(
            values, initial_states, [keys[k] for k in parameter_places]
        )
        scale = np.sqrt(_MEAN_ROBUST_WEIGHT / filtered_rows_per_error(extended))
        scale = scale / np.maximum(extended.noise, MIN_ERROR_SHARE * np.std(readings, axis=0))
        columns = rows.evaluated.columns * (rows.root / rows.stds)[..., None]
        factor = triangular_factor(columns.reshape(-1, columns.shape[2]))
        information = [_shared_information(factor, n_own)]
        for k, candidate in enumerate(candidates):
            # columns: bias of the sensor, record parameters, shared unknowns
            sensor_rows = np.zeros((len(readings), 1 + columns.shape[2]))
            sensor_rows[:, 0] = candidate.channel.shifted
            sensor_rows[:, 1 : 1 + n_begin] = tangent[:, k, len(parameter_places) :]
            sensor_rows[:, 1 + n_own :] = (
                tangent[:, k, : len(parameter_places)] @ slope[parameter_places]
            )
            stacked = np.concatenate([np.pad(factor, ((0, 0), (1, 0))), scale[k] * sensor_rows])
            if not candidate.channel.shifted:
                stacked = stacked[:, 1:]
            information.append(
                _shared_information(triangular_factor(stacked), n_own + candidate.channel.shifted)
            )
        return information

    pairs = zip(objective.records, objective.rows(fit.z), strict=True)
    return run_parallel([partial(one, *pair) for pair in pairs])


def _shared_information(factor: FloatArray, n_own: int) -> FloatArray:
    """Information R'R of the shared unknowns after elimination of the record parameters."""
    R = factor[n_own:, n_own:]
    return np.asarray(R.T @ R)


def _with_candidates(record: Dataset, arm: Arm, candidates: Sequence[_Candidate]) -> Dataset:
    """Replace the channels of a record by the candidates, with their filtered noise."""
    missing_joints = {candidate.channel.joint for candidate in candidates}
    joints = tuple(
        replace(
            joint,
            accelerometer_distance=_distance(joint, arm),
            accelerometer_hz=joint.accelerometer_hz or _ACCELEROMETER_HZ,
            gyro_hz=joint.gyro_hz or _GYRO_HZ,
        )
        if number in missing_joints
        else joint
        for number, joint in enumerate(record.arm.joints, start=1)
    )
    channels = tuple(candidate.channel for candidate in candidates)
    # standard deviation of a sample per unit noise density
    noise_per_density = np.sqrt(0.5 / record.log.sample_time)
    sample_std: dict[Quantity, float] = {
        "accelerometer": SensorNoise().accelerometer_density * noise_per_density,
        "gyro": _GYRO_DENSITY * noise_per_density,
        "link_angle": 2.0 * np.pi / _LINK_COUNTS / np.sqrt(12.0),
    }
    noise = [
        sample_std[c.quantity] * np.linalg.norm(record.kernels.taps(rate=c.rate)) for c in channels
    ]
    return replace(
        record,
        arm=record.arm.with_joints(joints),
        channels=channels,
        noise=np.array(noise),
        step_error_correction=np.zeros((len(record.time), len(channels))),
    )
