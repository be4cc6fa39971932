"""Predicted precision, from the Fisher information.

`predicted_parameters` predicts the confidence intervals of planned records, `sensor_gains` the
benefit of an additional link sensor in the records of a fit. Each record is simulated with the
missing sensors. The Fisher information requires only the derivatives of their readings with respect
to the unknowns and the sensor noise, not measurements.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, Log, Parameter, SensorGain
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.gear_laws import gear_parameters
from strainwave.domain.arm.link_sensors import (
    SensorAxis,
    SensorGroup,
    TypicalSensor,
    all_types,
    constant_of,
)
from strainwave.domain.arm.parameter_table import OFFSET, SETTLING
from strainwave.domain.arm.parameters import complete_values
from strainwave.domain.keys import Key, Row, Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.inference.covariance import (
    MIN_VARIANCE_SHARE,
    confidence_of,
    gradient_covariances,
    inverse_information,
)
from strainwave.identification.whole_arm.problem.objective import MIN_ERROR_SHARE
from strainwave.identification.whole_arm.problem.parameter_space import combination, reference_sizes
from strainwave.identification.whole_arm.problem.weighted_rows import (
    Evaluation,
    Rows,
    Weights,
    filtered_rows_per_error,
    noise_autocovariances,
)
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import (
    cutoff_of,
    dataset_of,
    select_usable_records,
)
from strainwave.identification.whole_arm.search import Fit
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.parallel import one_blas_thread, run_parallel

_RIGID_RELATIVE_STD = 0.002  # relative standard deviation of rigid-step estimates, as in a fit
_MEAN_CURVATURE = 0.565  # mean curvature (1 + r^2)^(-3/2) of the soft L1 loss, r standard normal
_MEAN_SQUARE_SLOPE = 0.344  # mean square of its slope r (1 + r^2)^(-1/2), r standard normal


def predicted_parameters(logs: Sequence[Log], arm: Arm, values: Values) -> tuple[Parameter, ...]:
    """Predict the parameters and confidence intervals of a whole-arm fit of planned records.

    The rows are those of a fit: filtered motor velocities and link sensor readings. The errors are
    sensor noise only, the unknowns of the records are estimated, and the standard deviation of the
    rigid-step estimates is 0.2 %.

    `logs` are simulated records with sensor noise; only the uses "frequency", "sweep" and "tuning"
    count. `values` maps (name, joint) to the assumed value, which is also the returned value.
    Returns an empty tuple if no record excites a gear.
    """
    used = select_usable_records(logs, arm)
    if not used:
        return ()
    known = complete_values(values, arm)
    cutoff = cutoff_of(used, arm, arm.fastest_resonance(known))
    keys: list[Key] = [  # all but settling times, as in a fit
        key
        for key in arm.core.parameter_names
        if key[0] != SETTLING and (key in known or key[0] == OFFSET)
    ]
    values = dict.fromkeys(keys, 0.0) | known
    sizes = reference_sizes(values)
    scale = np.array([sizes[key] or 1.0 for key in keys])
    with one_blas_thread():
        records = [dataset_of(log, arm, cutoff) for log in used]
        evidence = run_parallel(
            [partial(_information_of, record, values, keys, scale) for record in records]
        )
        prior = np.array(list(_rigid_rows(arm, keys, values))) * scale
        from_prior = prior.T @ prior
        information = sum((own for own, _ in evidence), from_prior)
        inverse = inverse_information(information)
        gradient_covariance = sum((own for _, own in evidence), from_prior)
        covariance = inverse @ gradient_covariance @ inverse + MIN_VARIANCE_SHARE * inverse
    return tuple(_parameters(arm, keys, values, covariance * np.outer(scale, scale)))


def _information_of(
    record: Dataset, values: Values, keys: Sequence[Key], scale: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fisher information of one record, and covariance of its gradient due to sensor noise."""
    channels, tangent = record.linearise(values, record.start(), keys, slope=np.diag(scale))
    n, n_own = len(keys), len(record.initial_states) + len(record.biased)
    exact = Evaluation(np.zeros_like(channels), tangent, np.zeros(n_own), record.biased)
    error = np.maximum(record.noise, MIN_ERROR_SHARE * np.std(channels, axis=0))
    repeats = filtered_rows_per_error(record)
    shared = exact.weigh(Weights(error, repeats)).shared_columns
    R = triangular_factor(np.ascontiguousarray(shared).reshape(-1, n))
    covariance = np.zeros((n, n))
    for k, filtered in enumerate(noise_autocovariances(record)):
        lags, noise_lags = np.zeros(len(shared)), filtered[: len(shared)]
        # the gradient is a product of rows and errors, both divided by sqrt(repetitions)
        lags[: len(noise_lags)] = noise_lags / noise_lags[0] * _MEAN_SQUARE_SLOPE / repeats[k]
        covariance += gradient_covariances(shared[:, k], (lags,))[0]
    return _MEAN_CURVATURE * R.T @ R, covariance


def _rigid_rows(arm: Arm, keys: Sequence[Key], values: Mapping[Key, float]) -> Iterator[FloatArray]:
    """Rigid-step estimates as rows (n_unknowns,), in standard deviations."""
    for column in arm.rigid_columns:
        magnitude = abs(value_of(column.parts, values))
        if magnitude > 0.0 and column.name != OFFSET:
            yield combination(keys, column.parts) / (_RIGID_RELATIVE_STD * magnitude)


def _parameters(
    arm: Arm, keys: Sequence[Key], values: Mapping[Key, float], covariance: FloatArray
) -> Iterator[Parameter]:
    """Unknowns and reported combinations with their 95 % confidence intervals.

    Parameters of links of which motion determines combinations only are omitted.
    """
    omitted = arm.base.links if arm.base.has_groups else ()
    rows: dict[Key, Row] = {key: {key: 1.0} for key in keys if key not in omitted}
    rows |= {key: row for key, row in arm.reported.items() if key not in arm.lumped_inertias}
    for key, parts in rows.items():
        weights = combination(keys, parts)
        value = float(weights @ np.array([values[one] for one in keys]))
        std = float(np.sqrt(np.maximum(0.0, weights @ covariance @ weights)))
        yield Parameter.estimated(key, value, std, unit_in(arm, key), "tuned")


_MEAN_ROBUST_WEIGHT = 0.79  # mean weight (1 + r^2)^(-1/2) of the soft L1 loss, r standard normal
_REPORTED = ("gear_damping", "motor_inertia", "link_inertia")  # in addition to those of gear laws


_AddedSensor = tuple[SensorAxis, TypicalSensor]
"""A sensor that a link lacks."""


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
    names = (*gear_parameters(), *_REPORTED)
    reported = [p for p in parameters if p.name in names and p.value and p.std]
    if not candidates or not reported:
        return []
    try:
        parts = _information(fit, arm, candidates)
    except (InvalidInput, NumericalFailure):
        return []
    space = fit.space
    slope = space.slope(fit.z)
    prior = space.linearise_prior(fit.z)[0]
    prior_information = prior.T @ prior
    W = np.array([_weights(p, space.keys, arm) for p in reported]) @ slope
    present, *extended = [sum(own, prior_information) for own in zip(*parts, strict=True)]
    own = np.linalg.inv(space.slope(fit.z))
    meat = present @ own @ confidence_of(fit).combined @ own.T @ present
    local = _variances(W, inverse_information(present))
    gains = []
    for (axis, typical), information in zip(candidates, extended, strict=True):
        inverse = inverse_information(information)
        stds = np.array([p.std for p in reported])
        sandwich = _variances(W, inverse @ (meat + information - present) @ inverse)
        shares = np.maximum(sandwich / stds**2, _variances(W, inverse) / local)
        shares = np.sqrt(np.minimum(1.0, shares))
        for parameter, share in zip(reported, shares.tolist(), strict=True):
            assert parameter.std is not None
            gains.append(
                SensorGain(
                    sensor=axis.sensor.name.replace("_", "-"),
                    link=axis.joint,
                    assumed=typical.specification,
                    name=parameter.name,
                    joint=parameter.joint,
                    std=parameter.std,
                    predicted_std=share * parameter.std,
                    value=parameter.value or 0.0,
                )
            )
    return gains


def _variances(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variances (n_rows,) of linear combinations, one per row."""
    return np.asarray(np.einsum("ij,jk,ik->i", rows, covariance, rows))


def _weights(parameter: Parameter, keys: Sequence[Key], arm: Arm) -> FloatArray:
    """Weights (n_unknowns,) of a parameter as a linear combination of the unknowns."""
    if parameter.key in keys or parameter.joint is None:
        return combination(keys, {parameter.key: 1.0})
    return combination(keys, arm.link_inertia(parameter.joint))


def _candidates(records: Sequence[Dataset], arm: Arm) -> Iterator[_AddedSensor]:
    """Candidate sensors of elastic joints whose link has no sensor in any record."""
    channels = (channel for record in records for channel in record.channels)
    sensed_joints = {c.joint for c in channels if c.sensor.group is not SensorGroup.MOTOR}
    for number, joint in enumerate(arm.joints, start=1):
        if number in sensed_joints or not joint.elastic:
            continue
        for kind in all_types():
            typical = kind.typical(joint, _length(arm))
            sensor = typical and kind.of_joint(typical.joint)
            if typical and sensor:
                (axis,) = sensor.axes(number)
                yield axis, typical


def _length(arm: Arm) -> float:
    """Length [m] of the first link; zero if it is unknown."""
    return math.hypot(*arm.joints[-1].origin.xyz)


def _information(fit: Fit, arm: Arm, candidates: Sequence[_AddedSensor]) -> list[list[FloatArray]]:
    """Fisher information (n_unknowns, n_unknowns) of each record, without and with each sensor."""
    # long steps are sufficient for derivatives
    objective, values = fit.objective.lengthen_steps(fit.z), fit.values
    keys, slope = objective.space.keys, objective.space.slope(fit.z)
    parameter_places = [k for k, key in enumerate(keys) if not constant_of(key)]

    def one(k: int, rows: Rows) -> list[FloatArray]:
        record = objective.records[k]
        extended = _with_candidates(record, arm, candidates)
        n_begin = len(record.initial_states)
        simulated = [keys[k] for k in parameter_places]
        initial = rows.record_parameters[:n_begin]
        readings, tangent = extended.linearise(
            values, initial, simulated, slope=slope[parameter_places]
        )
        scale = np.sqrt(_MEAN_ROBUST_WEIGHT / filtered_rows_per_error(extended))
        scale = scale / np.maximum(extended.noise, MIN_ERROR_SHARE * np.std(readings, axis=0))
        columns = rows.columns
        factor = triangular_factor(columns.reshape(-1, columns.shape[2]))
        information = [_shared_information(factor, n_begin)]
        for number, (axis, _) in enumerate(candidates):
            # columns: bias of the sensor, initial states, shared unknowns
            sensor_rows = np.zeros((len(readings), 1 + columns.shape[2]))
            sensor_rows[:, 0] = axis.sensor.has_bias
            sensor_rows[:, 1:] = tangent[:, number]
            sensor_rows *= scale[number]
            stacked = np.concatenate([np.pad(factor, ((0, 0), (1, 0))), sensor_rows])
            if not axis.sensor.has_bias:
                stacked = stacked[:, 1:]
            information.append(
                _shared_information(triangular_factor(stacked), n_begin + axis.sensor.has_bias)
            )
        return information

    return objective.map_rows(fit.z, one)


def _shared_information(factor: FloatArray, n_first: int) -> FloatArray:
    """Information R'R of the shared unknowns after elimination of the first columns."""
    R = factor[n_first:, n_first:]
    return np.asarray(R.T @ R)


def _with_candidates(record: Dataset, arm: Arm, candidates: Sequence[_AddedSensor]) -> Dataset:
    """Replace the channels of a record by the candidates, with their filtered noise."""
    missing_joints = {axis.joint for axis, _ in candidates}
    joints = list(record.arm.joints)
    for number in missing_joints:
        for kind in all_types():
            typical = kind.typical(joints[number - 1], _length(arm))
            joints[number - 1] = typical.joint if typical else joints[number - 1]
    channels = tuple(axis for axis, _ in candidates)
    T = record.log.sample_time
    noise = [
        typical.sample_std(T) * np.linalg.norm(record.kernels.taps(slope=axis.reads_angle))
        for axis, typical in candidates
    ]
    return replace(
        record,
        arm=record.arm.with_joints(joints),
        channels=channels,
        noise=np.array(noise),
        step_error_correction=np.zeros((len(record.time), len(channels))),
    )
