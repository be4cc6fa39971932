"""Predicted confidence intervals of planned records, from the Fisher information."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, Log, Parameter
from strainwave.domain.arm import unit_in
from strainwave.domain.combinations import value_of
from strainwave.domain.keys import Key, Row, Values
from strainwave.domain.parameter_table import OFFSET, SETTLING
from strainwave.domain.parameters import complete_values
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.inference.covariance import (
    MIN_VARIANCE_SHARE,
    inverse_information,
)
from strainwave.identification.whole_arm.inference.gradient_evidence import gradient_covariances
from strainwave.identification.whole_arm.problem.objective import MIN_ERROR_SHARE
from strainwave.identification.whole_arm.problem.prior import combination, reference_sizes
from strainwave.identification.whole_arm.problem.weighted_rows import (
    filtered_rows_per_error,
    noise_autocovariances,
)
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import (
    cutoff_of,
    dataset_of,
    select_usable_records,
)
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
    with one_blas_thread():
        return _predicted(used, arm, complete_values(values, arm))


def _predicted(used: Sequence[Log], arm: Arm, known: Values) -> tuple[Parameter, ...]:
    cutoff = cutoff_of(used, arm, arm.fastest_resonance(known))
    keys: list[Key] = [  # all but settling times, as in a fit
        key
        for key in arm.core.parameter_names
        if key[0] != SETTLING and (key in known or key[0] == OFFSET)
    ]
    values = dict.fromkeys(keys, 0.0) | known
    sizes = reference_sizes(values)
    scale = np.array([sizes[key] or 1.0 for key in keys])
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
    channels, tangent = record.linearise(values, record.start(), keys)
    n_rows, n_channels = channels.shape
    n_initial, n = len(record.initial_states), len(keys)
    biased = [k for k, channel in enumerate(record.channels) if channel.shifted]
    n_own = n_initial + len(biased)
    columns = np.zeros((n_rows, n_channels, n_own + n))
    columns[..., :n_initial] = tangent[..., n:]
    columns[:, biased, range(n_initial, n_own)] = 1.0
    columns[..., n_own:] = tangent[..., :n] * scale
    error = np.maximum(record.noise, MIN_ERROR_SHARE * np.std(channels, axis=0))
    repeats = filtered_rows_per_error(record)
    columns /= (error * np.sqrt(repeats))[:, None]
    flat = columns.reshape(-1, n_own + n)
    if n_own:  # project out the unknowns of the record
        coefficients = np.linalg.lstsq(flat[:, :n_own], flat[:, n_own:])[0]
        shared = columns[..., n_own:] - columns[..., :n_own] @ coefficients
    else:
        shared = columns
    R = triangular_factor(np.ascontiguousarray(shared).reshape(-1, n))
    covariance = np.zeros((n, n))
    for k, filtered in enumerate(noise_autocovariances(record)):
        lags, noise_lags = np.zeros(n_rows), filtered[:n_rows]
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
