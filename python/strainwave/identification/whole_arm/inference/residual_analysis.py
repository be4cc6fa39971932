"""Residual analysis: level, spectrum, whiteness and correlation with the inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from math import erfc, sqrt

import numpy as np

from strainwave.domain import (
    BoolArray,
    Clause,
    Diagnostic,
    FloatArray,
    Place,
    ResidualCorrelation,
    ResidualTest,
)
from strainwave.domain.keys import JointNumber
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.weighted_rows import Rows
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.numerics.parallel import run_parallel
from strainwave.numerics.spectra import correlate_residuals, cross_spectral_densities

_N_SEGMENTS = 8  # number of half-overlapping segments per record for averaged spectra
_MIN_SEGMENT_ROWS = 64  # minimum segment length [rows]
_MAX_BAND_SHARE = 0.8  # upper limit of the band for spectral comparison, relative to the cut-off
MIN_WARNING_RATIO = 3.0  # ratio of residual to sensor noise above which a warning is issued
_MIN_NOISE_RATIO = 1.5  # ratio above which more than half of the residual power is not noise
_SIGNIFICANCE_LEVEL = 1e-3  # significance level of the input correlation


def residual_tests(objective: Objective, z: FloatArray) -> tuple[ResidualTest, ...]:
    """Test the residuals of every channel in every record.

    `z`, (n_unknowns,), is the final iterate of the fit.
    """

    def tested(record: Dataset, rows: Rows) -> list[ResidualTest]:
        inputs = record.kernels.rows(record.drive.voltage[: len(record.log)], slope=False)
        errors = rows.errors.T
        return [_test_channel(record, k, column, inputs) for k, column in enumerate(errors)]

    each = zip(objective.records, objective.rows(z), strict=True)
    return tuple(chain.from_iterable(run_parallel([partial(tested, *pair) for pair in each])))


def _test_channel(
    record: Dataset, k: int, residual: FloatArray, inputs: FloatArray
) -> ResidualTest:
    channel, kernels = record.channels[k], record.kernels
    T = record.log.sample_time
    frequency, density = spectral_density(residual, kernels.step * T)
    taps = kernels.taps(slope=channel.reads_angle)
    # response of the low-pass on the frequency grid of the density; its taps have the period T
    gain = np.abs(np.fft.rfft(taps, round(1.0 / (frequency[1] * T))))[: len(frequency)]
    raw = record.noise[k] / np.linalg.norm(taps)
    noise_density = 2.0 * T * raw**2 * gain**2
    band = (frequency > 0.0) & (frequency < _MAX_BAND_SHARE * record.cutoff_hz)
    ratio = density[band] / np.maximum(noise_density[band], 1e-300)
    correlation = correlate_residuals(residual, inputs, kernels.step * T)
    by_input = strongest_input(correlation)
    return ResidualTest(
        experiment=record.log.name,
        channel=record.channel_names[k],
        deviation=float(np.std(residual)),
        noise=float(record.noise[k]),
        frequency_hz=frequency,
        density=density,
        noise_density=noise_density,
        worst_hz=float(frequency[band][np.argmax(ratio)]),
        whiteness=has_noise_spectrum(
            residual, kernels.step * T, taps, T, _MAX_BAND_SHARE * record.cutoff_hz
        ),
        input_joint=by_input.joint,
        input_correlation=by_input.correlation,
        input_delay=by_input.delay,
        input_probability=by_input.probability,
        correlation=correlation,
        sample_noise=float(raw),
    )


def spectral_density(x: FloatArray, sample_time: float) -> tuple[FloatArray, FloatArray]:
    """One-sided power spectral density of a residual, averaged over overlapping segments.

    `x` is (n_samples,), `sample_time` in s. Returns frequency [Hz] and density [unit^2/Hz], both
    (n_frequencies,).
    """
    segment = min(len(x), max(_MIN_SEGMENT_ROWS, 2 * len(x) // (_N_SEGMENTS + 1)))
    frequency, density = cross_spectral_densities(x[:, None], sample_time, segment)
    return frequency, density[:, 0, 0].real


def has_noise_spectrum(
    residual: FloatArray, row_time: float, taps: FloatArray, sample_time: float, below_hz: float
) -> float:
    """Test whether a residual has the spectrum of low-pass filtered white noise.

    Bartlett's test: the Kolmogorov-Smirnov statistic of the cumulative periodogram, divided by the
    power response of the low-pass, against a straight line.

    `residual`, (n_rows,), has the period `row_time` [s]; `taps`, (n_taps,), are those of the
    low-pass, with period `sample_time` [s]. Only frequencies below `below_hz` are used. Returns
    the p-value.
    """
    frequency = np.fft.rfftfreq(len(residual), row_time)
    band = (frequency > 0.0) & (frequency < below_hz)
    power = np.abs(np.fft.rfft(residual - residual.mean()))[band] ** 2
    gain = np.abs(np.fft.rfft(taps, 8192))
    gain = np.interp(frequency[band], np.fft.rfftfreq(8192, sample_time), gain)
    power = power / np.maximum(gain**2, 1e-300)
    m = len(power)
    if m < 2 or not np.sum(power) > 0.0:
        return 1.0
    cumulative = np.cumsum(power)[:-1] / np.sum(power)
    line = np.arange(1, m) / m
    distance = float(np.max(np.abs(cumulative - line)))
    root = sqrt(m - 1.0)
    x = (root + 0.12 + 0.11 / root) * distance
    k = np.arange(1, 101)
    return float(np.clip(2.0 * np.sum((-1.0) ** (k - 1) * np.exp(-2.0 * (k * x) ** 2)), 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class InputCorrelation:
    """Most significant correlation of a residual with an input."""

    joint: JointNumber  # of the input
    correlation: float
    delay: float  # [s] of the residual
    probability: float  # p-value: residual and input are independent


def strongest_input(correlation: ResidualCorrelation) -> InputCorrelation:
    """The input and delay with the most significant correlation with a residual."""
    lags = len(correlation.autocorrelation)
    delayed = correlation.cross_correlation[lags - 1 :]
    z_scores = np.abs(delayed) / correlation.cross_std
    lag, joint = divmod(int(np.argmax(z_scores)), delayed.shape[1])
    probability = min(1.0, z_scores.size * erfc(float(z_scores[lag, joint]) / sqrt(2.0)))
    delay = lag * correlation.lag_time
    return InputCorrelation(joint + 1, float(delayed[lag, joint]), delay, probability)


def has_excess_residuals(
    objective: Objective, z: FloatArray, ratio: float = _MIN_NOISE_RATIO
) -> bool:
    """Whether the residual of any channel exceeds a multiple of the noise.

    By default, more than half of its power is then not sensor noise. This limit is lower than that
    of `residual_warnings`, because an effect can be significant below the latter. `z`,
    (n_unknowns,), is the final iterate of the fit.
    """
    return any(bool(np.any(beyond)) for beyond in channels_above_noise(objective, z, ratio))


def channels_above_noise(
    objective: Objective, z: FloatArray, ratio: float = _MIN_NOISE_RATIO
) -> list[BoolArray]:
    """Channels whose residual exceeds a multiple of the noise: (n_channels,) for each record.

    `z`, (n_unknowns,), is the final iterate of the fit.
    """
    exceeding = []
    for record, rows in zip(objective.records, objective.rows(z), strict=True):
        stds = np.std(rows.errors, axis=0)
        exceeding.append((stds >= ratio * record.noise) & (record.noise > 0.0))
    return exceeding


def residual_warnings(tests: Sequence[ResidualTest], *, explained: bool) -> Iterator[Diagnostic]:
    """Yield one warning per channel name, on the record with the largest ratio to sensor noise.

    `explained` states whether a likely effect explains the residuals.
    """
    for name in dict.fromkeys(test.channel for test in tests):
        candidates = [test for test in tests if test.channel == name and test.noise > 0.0]
        worst = max(candidates, key=lambda test: test.deviation / test.noise, default=None)
        if worst is None or worst.deviation < MIN_WARNING_RATIO * worst.noise:
            continue
        dependence = Clause("follows-no-input")
        if worst.input_probability < _SIGNIFICANCE_LEVEL:
            joint, delay = worst.input_joint, worst.input_delay
            dependence = Clause("follows-input", joint=joint, delay=delay)
        yield Diagnostic(
            "residual-not-noise",
            Place.in_records(worst.experiment),
            channel=name,
            ratio=worst.deviation / worst.noise,
            worst_hz=worst.worst_hz,
            dependence=dependence,
            unexplained=None if explained else Clause("no-effect-explains"),
        )
