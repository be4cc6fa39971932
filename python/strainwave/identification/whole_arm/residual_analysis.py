"""What a fit leaves: how much beside noise, at which frequencies, and what inputs predict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain
from math import erfc, sqrt

import numpy as np

from strainwave.domain import BoolArray, Diagnostic, FloatArray, ResidualTest
from strainwave.identification.whole_arm.dataset import Dataset
from strainwave.identification.whole_arm.objective import Objective, Rows, Weights, lagged_products
from strainwave.numerics.correlations import correlate_residuals
from strainwave.numerics.parallel import side_by_side
from strainwave.numerics.spectra import cross_spectral_densities

_SEGMENTS = 8  # of a record, half of each in common with the next, over which spectra are averaged
_LEAST_SEGMENT = 64  # rows
_BELOW = 0.8  # of the cut-off: the band in which colours are compared
_DELAYS = 0.1  # [s] by which an input may come before what it explains
_HIGH_VARIANCE = 3.0  # times the sensor's noise from which residuals are worth a word
_EXCEEDS = 1.5  # times that noise from which more than half of the residuals' power is not noise
_SURELY = 1e-3  # probability below which chance is no explanation


def residual_tests(objective: Objective, z: FloatArray) -> tuple[ResidualTest, ...]:
    """Every channel of every record.

    Parameters
    ----------
    objective : Objective
    z : (n_unknowns,)
        Where the fit ended.

    Returns
    -------
    tuple of ResidualTest
    """

    def tested(record: Dataset, rows: Rows, weights: Weights) -> list[ResidualTest]:
        left = rows.residual * weights.deviation
        inputs = record.kernels.rows(record.drive.voltage[: len(record.log)], rate=False)
        return [_tested(record, k, left[:, k], inputs) for k in range(len(record.channels))]

    each = zip(objective.records, objective.rows(z), objective.weights, strict=True)
    return tuple(chain.from_iterable(side_by_side([partial(tested, *one) for one in each])))


def _tested(record: Dataset, k: int, left: FloatArray, inputs: FloatArray) -> ResidualTest:
    channel, kernels = record.channels[k], record.kernels
    T = record.log.sample_time
    frequency, density = spectral_density(left, kernels.step * T)
    taps = kernels.taps(rate=channel.rate)
    # the low-pass at the same frequencies: its taps lie closer, a row's time in all the segment's
    gain = np.abs(np.fft.rfft(taps, round(1.0 / (frequency[1] * T))))[: len(frequency)]
    raw = record.noise[k] / np.linalg.norm(taps)
    noise_density = 2.0 * T * raw**2 * gain**2
    band = (frequency > 0.0) & (frequency < _BELOW * record.cutoff_hz)
    beside = density[band] / np.maximum(noise_density[band], 1e-300)
    joint, correlation, delay, probability = follows(left, inputs, kernels.step * T)
    return ResidualTest(
        experiment=record.log.name,
        channel=channel.name.replace("theta", "omega"),
        deviation=float(np.std(left)),
        noise=float(record.noise[k]),
        frequency_hz=frequency,
        density=density,
        noise_density=noise_density,
        worst_hz=float(frequency[band][np.argmax(beside)]),
        whiteness=coloured_alike(left, kernels.step * T, taps, T, _BELOW * record.cutoff_hz),
        input_joint=joint,
        input_correlation=correlation,
        input_delay=delay,
        input_probability=probability,
        correlation=correlate_residuals(left, inputs, kernels.step * T),
    )


def spectral_density(x: FloatArray, sample_time: float) -> tuple[FloatArray, FloatArray]:
    """One-sided power spectral density of residuals, averaged over the windows of a record.

    Parameters
    ----------
    x : (n_samples,)
    sample_time : float [s]

    Returns
    -------
    frequency : (n_frequencies,) [Hz]
    density : (n_frequencies,) [unit^2/Hz]
    """
    segment = min(len(x), max(_LEAST_SEGMENT, 2 * len(x) // (_SEGMENTS + 1)))
    frequency, density = cross_spectral_densities(x[:, None], sample_time, segment)
    return frequency, density[:, 0, 0].real


def coloured_alike(
    left: FloatArray, row_time: float, taps: FloatArray, sample_time: float, below_hz: float
) -> float:
    """Whether residuals have the colour of white noise behind the low-pass.

    Bartlett's test: the cumulative periodogram, each line divided by the noise's, against a
    straight line, by Kolmogorov and Smirnov's statistic.

    Parameters
    ----------
    left : (n_rows,)
    row_time : float [s]
    taps : (n_taps,)
        Of the low-pass.
    sample_time : float [s]
        Between taps.
    below_hz : float [Hz]
        Of the band that is looked at.

    Returns
    -------
    float
        Probability that noise looks no more like it.
    """
    frequency = np.fft.rfftfreq(len(left), row_time)
    band = (frequency > 0.0) & (frequency < below_hz)
    power = np.abs(np.fft.rfft(left - left.mean()))[band] ** 2
    gain = np.abs(np.fft.rfft(taps, 8192))
    gain = np.interp(frequency[band], np.fft.rfftfreq(8192, sample_time), gain)
    power = power / np.maximum(gain**2, 1e-300)
    m = len(power)
    if m < 2 or not np.sum(power) > 0.0:
        return 1.0
    share = np.cumsum(power)[:-1] / np.sum(power)
    line = np.arange(1, m) / m
    apart = float(np.max(np.abs(share - line)))
    root = sqrt(m - 1.0)
    x = (root + 0.12 + 0.11 / root) * apart
    k = np.arange(1, 101)
    return float(np.clip(2.0 * np.sum((-1.0) ** (k - 1) * np.exp(-2.0 * (k * x) ** 2)), 0.0, 1.0))


def follows(
    left: FloatArray, inputs: FloatArray, row_time: float
) -> tuple[int, float, float, float]:
    """Which input residuals follow most, how closely and how late, and the odds of chance.

    By chance a correlation at one delay has the variance (1/n) sum of the products of both sides'
    autocorrelations (Bartlett).

    Parameters
    ----------
    left : (n_rows,)
    inputs : (n_rows, n_joints)
    row_time : float [s]

    Returns
    -------
    joint : int
        From 1.
    correlation : float
    delay : float [s]
    probability : float
    """
    n = len(left)
    delays = min(n // 4, max(1, round(_DELAYS / row_time)))
    own, own_lagged = lagged_products(left)
    found = (1, 0.0, 0.0, 1.0)
    for j in range(inputs.shape[1]):
        given, lagged = lagged_products(inputs[:, j])
        if not (own_lagged[0] > 0.0 and lagged[0] > 0.0):
            continue
        cross = np.fft.irfft(own * given.conj(), 2 * n)[:delays]
        correlation = cross / np.sqrt(own_lagged[0] * lagged[0])
        products = own_lagged / own_lagged[0] * lagged / lagged[0]
        variance = max(1.0, 1.0 + 2.0 * float(np.sum(products[1 : n // 2]))) / n
        at = int(np.argmax(np.abs(correlation)))
        deviations = abs(float(correlation[at])) / sqrt(variance)
        odds = min(1.0, delays * inputs.shape[1] * erfc(deviations / sqrt(2.0)))
        if odds < found[3] or (odds == found[3] and abs(correlation[at]) > abs(found[1])):
            found = (j + 1, float(correlation[at]), at * row_time, odds)
    return found


def exceed_noise(objective: Objective, z: FloatArray) -> bool:
    """Whether the residuals of any channel are more than its sensor's noise, most by power.

    Less than what `residual_warnings` speaks of: an effect may be significant well below that.

    Parameters
    ----------
    objective : Objective
    z : (n_unknowns,)
        Where the fit ended.

    Returns
    -------
    bool
    """
    return any(bool(np.any(beyond)) for beyond in beyond_noise(objective, z))


def beyond_noise(objective: Objective, z: FloatArray) -> list[BoolArray]:
    """Of each record, which channels have residuals that are more than their sensors' noise.

    Parameters
    ----------
    objective : Objective
    z : (n_unknowns,)
        Where the fit ended.

    Returns
    -------
    list of (n_channels,)
    """
    found = []
    each = zip(objective.records, objective.rows(z), objective.weights, strict=True)
    for record, rows, weights in each:
        deviation = np.std(rows.residual * weights.deviation, axis=0)
        found.append((deviation >= _EXCEEDS * record.noise) & (record.noise > 0.0))
    return found


def residual_warnings(tests: Sequence[ResidualTest], *, explained: bool) -> Iterator[Diagnostic]:
    """For each kind of channel the one of whose motion most is left unexplained.

    Parameters
    ----------
    tests : sequence of ResidualTest
    explained : bool
        Whether an effect that the model lacks would explain them.

    Yields
    ------
    Diagnostic
    """
    for name in dict.fromkeys(test.channel for test in tests):
        own = [test for test in tests if test.channel == name and test.noise > 0.0]
        worst = max(own, key=lambda test: test.deviation / test.noise, default=None)
        if worst is None or worst.deviation < _HIGH_VARIANCE * worst.noise:
            continue
        text = f"the residuals of {name} are {worst.deviation / worst.noise:.2g} times its sensor's"
        text += f" noise, most near {worst.worst_hz:.3g} Hz"
        if worst.input_probability < _SURELY:
            text += f", and follow joint {worst.input_joint}'s input by"
            text += (
                f" {1e3 * worst.input_delay:.3g} ms: the model lacks something of the motion, or"
            )
            text += " the study has a wrong constant"
        else:
            text += (
                ", without linear dependence on an input: friction or a gear that the model does"
            )
            text += (
                " not describe, a wrong constant in the study and an outside disturbance look so"
            )
        if not explained:
            text += "; none of the effects that the program knows explains them"
        text += "; intervals were widened for it"
        yield Diagnostic("residual-not-noise", worst.experiment, text)
