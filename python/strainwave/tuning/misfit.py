"""What records and prior say against parameters: rows, their derivatives, their weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.closed_loop import Observed
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.parameters import Values
from strainwave.records import FloatArray, IntArray, Study
from strainwave.tuning.unknowns import Search

_STEP = 1e-4  # of the coordinates: far above rounding, and good to about as much of itself
_PER_PERIOD = 4.0  # rows in a period of the cut-off; more would only repeat each other
_LEAST = 2e-3  # of a channel's own spread: no model is better than that
_HUGE = 1e4  # a residual, in deviations, of parameters that no arm can have
_BLOCKS = 10  # a record


@dataclass(frozen=True, slots=True)
class Misfit:
    """Weighted differences between simulated and measured channels of all records."""

    study: Study  # with linear springs
    search: Search
    records: tuple[Observed, ...]
    # a record: (n_rows, n_channels), what the counts of the encoders change
    counts: tuple[FloatArray, ...] = ()
    weights: tuple[FloatArray, ...] = ()  # a record: (n_channels,), one over a row's deviation

    def residual(self, z: FloatArray) -> FloatArray:
        """All rows: (n_rows,), those of the prior last."""
        try:
            data = self._rows(self.differences(z))
        except (InvalidInput, NumericalFailure):
            data = np.full(len(self.block_of_rows()), _HUGE)
        return np.concatenate([data, self.search.prior_residual(z)])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """By forward differences, all arms in one run a record: (n_rows, n_unknowns)."""
        shifted = [self.search.values(one) for one in z + _STEP * np.eye(len(z))]
        data = self._change(z, shifted) / _STEP
        return np.concatenate([data, self.search.prior_jacobian(z)])

    def friction_effect(self, z: FloatArray) -> FloatArray:
        """What a deviation of each friction taken over does: (n_data_rows, n_frictions)."""
        values = self.search.values(z)
        deviations = self.search.fixed_deviation.items()
        shifted = [values | {key: values[key] + step} for key, step in deviations]
        return self._change(z, shifted)

    def _change(self, z: FloatArray, arms: Sequence[Values]) -> FloatArray:
        """Weighted differences of arms from the one at z: (n_data_rows, n_arms)."""
        parts = []
        for record, weight in zip(self.records, self.weights, strict=True):
            both = [self.search.values(z), *arms]
            seen = record.simulated(_countless(self.study), both)[:, :: decimation(record)]
            parts.append((weight * (seen[1:] - seen[0])).reshape(len(arms), -1))
        return np.concatenate(parts, axis=1).T

    def differences(self, z: FloatArray) -> list[FloatArray]:
        """Simulated less measured, a record: (n_rows, n_channels), unweighted."""
        values = self.search.values(z)
        found = [
            (record.simulated(_countless(self.study), [values])[0] - record.measured)
            for record in self.records
        ]
        return [
            (difference + counts)[:: decimation(record)]
            for difference, counts, record in zip(found, self.counts, self.records, strict=True)
        ]

    def around(self, z: FloatArray) -> Misfit:
        """With the counts' effect and the weights for parameters near z.

        The servo sees counts, and what they do to the motion is no smooth function of the
        parameters; it is found once and held. A channel's rows are divided by the robust deviation
        of its differences, and by the root of how many rows say the same thing, so that a coloured
        residual does not outvote the prior.
        """
        values = [self.search.values(z)]
        effects = tuple(
            record.simulated(self.study, values)[0]
            - record.simulated(_countless(self.study), values)[0]
            for record in self.records
        )
        counted = replace(self, counts=effects)
        weights = []
        for record, difference in zip(self.records, counted.differences(z), strict=True):
            spread = _LEAST * np.std(record.measured, axis=0)
            least = np.maximum(np.maximum(record.noise, spread), 1e-12)
            robust = 1.4826 * np.median(np.abs(difference), axis=0)
            size = np.maximum(np.maximum(robust, least), 0.5 * np.std(difference, axis=0))
            weights.append(1.0 / (size * np.sqrt([_repeats(column) for column in difference.T])))
        return replace(counted, weights=tuple(weights))

    def _rows(self, differences: Sequence[FloatArray]) -> FloatArray:
        pairs = zip(differences, self.weights, strict=True)
        return np.concatenate([(weight * difference).ravel() for difference, weight in pairs])

    def block_of_rows(self) -> IntArray:
        """The stretch of a record that each row of the data belongs to."""
        labels = []
        for number, record in enumerate(self.records):
            rows = len(range(0, len(record.time), decimation(record)))
            block = number * _BLOCKS + np.arange(rows) * _BLOCKS // rows
            labels.append(np.repeat(block, len(record.channels)))
        return np.concatenate(labels)


def _countless(study: Study) -> Study:
    """Encoders without counts: the simulation is then smooth in the parameters."""
    joints = tuple(replace(joint, encoder_counts=None) for joint in study.joints)
    return replace(study, joints=joints)


def decimation(record: Observed) -> int:
    """Samples between the rows that are used."""
    return max(1, int(1.0 / (_PER_PERIOD * record.cutoff_hz * record.log.sample_time)))


def _repeats(column: FloatArray) -> float:
    """1 + 2 sum of the autocorrelations up to the first negative one."""
    n = len(column)
    spectrum = np.fft.rfft(column - column.mean(), 2 * n)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: n // 2]
    if correlation[0] <= 0.0:
        return 1.0
    correlation /= correlation[0]
    negative = np.flatnonzero(correlation < 0.0)
    until = negative[0] if negative.size else len(correlation)
    return float(1.0 + 2.0 * np.sum(correlation[1:until]))


def covariance_of(
    residual: FloatArray, jacobian: FloatArray, block: IntArray, friction: FloatArray
) -> FloatArray:
    """Covariance of the coordinates, counting what goes on for longer than one row.

    The inverse of J'J, its deviations raised where the blocks' scores g_b = J_b' r_b scatter more
    than independent rows would: (J'J)^-1 (sum g_b g_b' + P) (J'J)^-1, P from the prior. To this
    comes what the uncertainty of the friction that was taken over makes.

    Parameters
    ----------
    residual : (n_rows,)
    jacobian : (n_rows, n_unknowns)
    block : (n_data_rows,)
        Of the data's rows, which come first.
    friction : (n_data_rows, n_frictions)
        From `Misfit.friction_effect`.

    Returns
    -------
    (n_unknowns, n_unknowns)
    """
    n_data = len(block)
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    products = jacobian[:n_data] * residual[:n_data, None]
    labels, at = np.unique(block, return_inverse=True)
    scores = np.zeros((len(labels), jacobian.shape[1]))
    np.add.at(scores, at, products)
    prior = jacobian[n_data:].T @ jacobian[n_data:]
    meat = len(labels) / (len(labels) - 1.0) * scores.T @ scores + prior
    sandwich = np.diag(inverse @ meat @ inverse)
    raised = np.sqrt(np.maximum(1.0, sandwich / np.diag(inverse)))
    moved = inverse @ jacobian[:n_data].T @ friction
    return np.asarray(inverse * np.outer(raised, raised) + moved @ moved.T)
