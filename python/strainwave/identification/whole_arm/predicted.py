"""Which intervals planned records would give, by the Fisher information of a guessed arm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, Log, Parameter
from strainwave.domain.combinations import value_of
from strainwave.domain.kinds import Row
from strainwave.domain.parameters import Values, completed, unit_of
from strainwave.dynamics.arm import Arm
from strainwave.identification.closed_loop import velocity_band
from strainwave.identification.whole_arm.covariance import (
    LEAST_SHARE,
    gradient_covariances,
    inverse_information,
)
from strainwave.identification.whole_arm.dataset import Dataset
from strainwave.identification.whole_arm.objective import LEAST_ERROR, lagged, repetitions_of
from strainwave.identification.whole_arm.parametrisation import (
    COULOMB,
    OFFSET,
    SETTLING,
    Key,
    combination,
)
from strainwave.identification.whole_arm.preparation import dataset_of, usable
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.parallel import one_blas_thread, side_by_side

BAND = 5.0
"""Times the highest resonance: beyond, little is left of what the gears do."""
LEAST_BAND = 0.1
"""Of the sampling frequency, to which the low-pass may go up."""

_REACH = 1.96  # of a 95 % interval, in deviations
_RIGID = 0.002  # of a value: as well as the rigid step counts in a fit
_BEND = 0.565  # mean of (1 + r^2)^(-3/2) over normal errors: how the soft L1 loss bends
_SLOPE = 0.344  # mean square of its slope r (1 + r^2)^(-1/2)


def predicted_parameters(logs: Sequence[Log], arm: Arm, values: Values) -> tuple[Parameter, ...]:
    """What the whole-arm fit would say of a guessed arm after such records.

    Their rows are those of a fit: velocities of the motors and readings of those link sensors
    whose channels are there, behind one low-pass. Errors are the sensors' noise alone, the
    records' own unknowns are free, and the rigid step's values are known to 0.2 %.

    `logs`: As they would be recorded, with the noise of the sensors; those of other uses than
        "frequency", "sweep" and "tuning" are left out.
    `values`: (name, joint) -> value of the guessed arm.

    Returns: With the guess's values; empty where no record excites a gear.
    """
    used = usable(logs, arm)
    if not used:
        return ()
    with one_blas_thread():
        return _predicted(used, arm, completed(values, arm))


def _predicted(used: Sequence[Log], arm: Arm, known: Values) -> tuple[Parameter, ...]:
    shown = min(velocity_band(log, arm) for log in used)
    limit = LEAST_BAND / max(log.sample_time for log in used)
    fastest = arm.fastest_resonance(known)
    cutoff = min([shown, limit] + ([BAND * fastest] if fastest else []))
    keys: list[Key] = [k for k in arm.core.parameter_names if _is_unknown(k, known)]
    values = dict.fromkeys(keys, 0.0) | known
    scale = np.array([_scale(key, values) for key in keys])
    records = [dataset_of(log, arm, cutoff) for log in used]
    parts = side_by_side([partial(_evidence, record, values, keys, scale) for record in records])
    prior = np.array(list(_rigid_rows(arm, keys, values))) * scale
    from_prior = prior.T @ prior
    information = sum((own for own, _ in parts), from_prior)
    inverse = inverse_information(information)
    errors = sum((own for _, own in parts), from_prior)
    covariance = inverse @ errors @ inverse + LEAST_SHARE * inverse
    return tuple(_parameters(arm, keys, values, covariance * np.outer(scale, scale)))


def _is_unknown(key: Key, known: Values) -> bool:
    return key[0] != SETTLING and (key in known or key[0] == OFFSET)


def _scale(key: Key, values: Mapping[Key, float]) -> float:
    """Of a parameter's unit; an offset's is that of its joint's Coulomb friction."""
    size = abs(values[(COULOMB, key[1]) if key[0] == OFFSET else key])
    return size or 1.0


def _evidence(
    record: Dataset, values: Values, keys: Sequence[Key], scale: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Information of one record, and the covariance of its gradient by its sensors' noise."""
    seen, tangent = record.linearised(values, record.start(), keys)
    n_rows, n_channels = seen.shape
    n_begin, n = len(record.local), len(keys)
    shifted = [k for k, channel in enumerate(record.channels) if channel.shifted]
    n_own = n_begin + len(shifted)
    columns = np.zeros((n_rows, n_channels, n_own + n))
    columns[..., :n_begin] = tangent[..., n:]
    columns[:, shifted, range(n_begin, n_own)] = 1.0
    columns[..., n_own:] = tangent[..., :n] * scale
    error = np.maximum(record.noise, LEAST_ERROR * np.std(seen, axis=0))
    repeats = repetitions_of(record)
    columns /= (error * np.sqrt(repeats))[:, None]
    flat = columns.reshape(-1, n_own + n)
    if n_own:  # what the record's own unknowns cannot imitate
        own = np.linalg.lstsq(flat[:, :n_own], flat[:, n_own:])[0]
        shared = columns[..., n_own:] - columns[..., :n_own] @ own
    else:
        shared = columns
    R = triangular_factor(np.ascontiguousarray(shared).reshape(-1, n))
    covariance = np.zeros((n, n))
    for k, channel in enumerate(record.channels):
        lags = np.zeros(n_rows)
        own_lags = lagged(record.kernels.taps(rate=channel.rate), record.kernels.step)[:n_rows]
        # a gradient has rows and errors, both over the root of the repetitions
        lags[: len(own_lags)] = own_lags / own_lags[0] * _SLOPE / repeats[k]
        covariance += gradient_covariances(shared[:, k], (lags,))[0]
    return _BEND * R.T @ R, covariance


def _rigid_rows(arm: Arm, keys: Sequence[Key], values: Mapping[Key, float]) -> Iterator[FloatArray]:
    """What the rigid step knows, in its deviations: (n_unknowns,) each."""
    for column in arm.rigid_columns:
        size = abs(value_of(column.parts, values))
        if size > 0.0 and column.name != OFFSET:
            yield combination(keys, column.parts) / (_RIGID * size)


def _parameters(
    arm: Arm, keys: Sequence[Key], values: Mapping[Key, float], covariance: FloatArray
) -> Iterator[Parameter]:
    rows: dict[Key, Row] = {key: {key: 1.0} for key in keys}
    rows |= {key: row for key, row in arm.reported.items() if key not in arm.lumped_inertias}
    for (name, joint), parts in rows.items():
        weights = combination(keys, parts)
        value = float(weights @ np.array([values[key] for key in keys]))
        std = float(np.sqrt(np.maximum(0.0, weights @ covariance @ weights)))
        unit = unit_of(name, None if joint is None else arm.joints[joint - 1])
        interval = (value - _REACH * std, value + _REACH * std)
        yield Parameter(name, joint, value, std, unit, "tuned", interval)
