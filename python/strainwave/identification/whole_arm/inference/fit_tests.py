"""Tests of a fit: its residuals, and its agreement with the rigid model, which is its prior.

Residuals have a level, a spectrum, whiteness, and correlations with the inputs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from math import erfc, sqrt
from statistics import NormalDist
from typing import Literal

import numpy as np

from strainwave.domain import (
    AgreementTest,
    BoolArray,
    Clause,
    Diagnostic,
    FloatArray,
    Place,
    ResidualCorrelation,
    ResidualTest,
    StageDifference,
)
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.parameter_table import family_of
from strainwave.domain.keys import JointNumber, Values
from strainwave.domain.results.distributions import chi_square_tail
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.inference.covariance import confidence_of, with_variances
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import reference_sizes
from strainwave.identification.whole_arm.problem.weighted_rows import Rows
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.search import Fit
from strainwave.numerics.parallel import run_parallel
from strainwave.numerics.spectra import correlate_residuals, cross_spectral_densities

_N_SEGMENTS = 8  # number of half-overlapping segments per record for averaged spectra
_MIN_SEGMENT_ROWS = 64  # minimum segment length [rows]
_MAX_BAND_SHARE = 0.8  # upper limit of the band for spectral comparison, relative to the cut-off
MIN_WARNING_RATIO = 3.0  # ratio of residual to sensor noise above which a warning is issued
_MIN_NOISE_RATIO = 1.5  # ratio above which more than half of the residual power is not noise
SIGNIFICANCE_LEVEL = 1e-3
"""Significance level of the tests of a residual."""


def residual_tests(objective: Objective, z: FloatArray) -> tuple[ResidualTest, ...]:
    """Test the residuals of every channel in every record.

    `z`, (n_unknowns,), is the final iterate of the fit.
    """

    def tested(record: Dataset, rows: Rows) -> list[ResidualTest]:
        inputs = record.kernels.rows(record.drive.voltage[: len(record.log)], slope=False)
        errors = rows.errors.T
        return [assess_channel(record, k, column, inputs) for k, column in enumerate(errors)]

    each = zip(objective.records, objective.rows(z), strict=True)
    return tuple(chain.from_iterable(run_parallel([partial(tested, *pair) for pair in each])))


def assess_channel(
    record: Dataset, k: int, residual: FloatArray, inputs: FloatArray
) -> ResidualTest:
    """Test the residual (n_rows,) of one channel against the inputs (n_rows, n_joints)."""
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
        if worst.input_probability < SIGNIFICANCE_LEVEL:
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


_Group = tuple[Literal["all", "inertias", "friction"], int | None]  # scope and joint of a test

RIGID_MODEL_ERROR = 5e-4
"""Relative error of the rigid model's values, because torsion moves the links by milliradians."""

# standard deviation of a difference, relative to the rigid step, below which the records add no
# information
_MIN_STD_RATIO = 0.05
_MIN_EIGENVALUE_RATIO = 1e-9  # relative eigenvalue below which the rigid correlations are singular
_BISECTIONS = 60  # of the variance of model errors
_MIN_TAIL_PROBABILITY = 1e-300  # lower limit of a tail probability; equals 37 standard deviations


def stage_differences(fit: Fit, arm: Arm) -> tuple[StageDifference, ...]:
    """Differences between rigid model and whole-arm fit, with their standard deviations.

    The rigid model is the prior of the fit; `covariance.residual_covariance` includes the resulting
    correlation. `fit` is at its minimum. Values without information in the fast records are
    omitted. The result is empty without a rigid model.
    """
    prior, confidence = fit.space.prior, confidence_of(fit)
    F = prior.factor
    difference = F @ confidence.prior_residual
    std = _standard_deviations([F @ part @ F.T for part in confidence.prior_covariance])
    rigid_std = _standard_deviations([F @ prior.errors @ F.T])
    differences = []
    for k, (name, joint) in enumerate(prior.names):
        if std[k] <= _MIN_STD_RATIO * rigid_std[k]:
            continue
        unit = unit_in(arm, (name, joint))
        rigid = float(prior.mean[k])
        whole_arm = rigid + float(difference[k])
        differences.append(StageDifference(name, joint, rigid, whole_arm, float(std[k]), unit))
    return tuple(differences)


def _standard_deviations(covariances: Sequence[FloatArray]) -> FloatArray:
    """Largest standard deviation of each row over the covariances: (n_rows,)."""
    variances = np.max([np.diag(part) for part in covariances], axis=0)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def agreement_tests(fit: Fit) -> tuple[tuple[AgreementTest, ...], Values]:
    """Chi-square tests of the differences: all values, inertias, and the friction of each joint.

    Also returns the squared model errors of the values in tests that fail. The covariance of the
    difference accounts for the errors that both stages share (Hausman, 1978), so only the excess is
    an error of the model. The test of all values tells nothing new if another fails.

    The statistic is d' C^-1 d with the differences d and their covariance C. C has the correlations
    of steady errors, which about 1,000 rows determine, and the larger of both variances, to which
    the squares of `RIGID_MODEL_ERROR` are added. Only directions in which the records add
    information to the rigid model are included.

    `fit` is at its minimum. The result is empty without a rigid model, or if the records contain no
    information on its values.
    """
    prior, confidence = fit.space.prior, confidence_of(fit)
    F = prior.factor
    _, steady = (F @ part @ F.T for part in confidence.prior_covariance)
    std = _standard_deviations([F @ part @ F.T for part in confidence.prior_covariance])
    covariance = with_variances(steady, std**2)
    rigid, difference = F @ prior.errors @ F.T, F @ confidence.prior_residual
    sizes = reference_sizes(dict(zip(prior.names, prior.mean.tolist(), strict=True)))
    size = np.maximum(list(sizes.values()), 1e-300)
    model_error = np.diag((RIGID_MODEL_ERROR * size) ** 2)
    groups: dict[_Group, list[int]] = {}
    for k, (name, joint) in enumerate(prior.names):
        group_key: _Group = ("inertias", None)
        if family_of(name) in ("dry friction", "damping"):
            group_key = ("friction", joint)
        for group in (("all", None), group_key):
            groups.setdefault(group, []).append(k)
    tests: list[AgreementTest] = []
    excess: dict[_Group, Values] = {}
    for (scope, joint), rows in groups.items():
        block, own = np.ix_(rows, rows), difference[rows]
        chi_square, degrees = _chi_square(own, covariance[block], rigid[block], model_error[block])
        if not degrees:
            continue
        largest = float(np.max(np.abs(own) / size[rows]))
        deviations = _as_normal(chi_square, degrees)
        tests.append(AgreementTest(scope, joint, chi_square, degrees, deviations, largest))
        if tests[-1].disagrees:
            variance, biases = (covariance + model_error)[block], prior.typical_biases[rows]
            errors = expected_model_error(own, variance, biases, degrees).tolist()
            excess[scope, joint] = {prior.names[k]: e**2 for k, e in zip(rows, errors, strict=True)}
    if len(excess) > 1:
        excess.pop(("all", None), None)
    return tuple(tests), {key: square for each in excess.values() for key, square in each.items()}


def expected_model_error(
    difference: FloatArray, covariance: FloatArray, sizes: FloatArray, degrees: int
) -> FloatArray:
    """Part of a difference d that is a model error, by its covariance C: (n_rows,).

    Model errors have variances t^2 S, with typical `sizes` as roots of S, and t explains the excess
    of the chi square, d' (C + t^2 S)^-1 d = `degrees` (Mandel and Paule, 1970). The expected error
    t^2 S (C + t^2 S)^-1 d is all of a difference far above its standard deviation, and little else.
    """
    variances, vectors = np.linalg.eigh(covariance / np.outer(sizes, sizes))
    variances = np.maximum(variances, np.finfo(float).eps * variances[-1])
    scaled = vectors.T @ (difference / sizes)
    low, high = 0.0, float(scaled @ scaled)
    for _ in range(_BISECTIONS):
        t2 = 0.5 * (low + high)
        is_small = np.sum(scaled**2 / (variances + t2)) > degrees
        low, high = (t2, high) if is_small else (low, t2)
    return np.asarray(sizes * (vectors @ (scaled * t2 / (variances + t2))))


def _chi_square(
    difference: FloatArray, covariance: FloatArray, rigid: FloatArray, added: FloatArray
) -> tuple[float, int]:
    """Statistic d' (C + added)^-1 d and its degrees of freedom.

    Directions in which C is negligible relative to the rigid covariance are omitted.
    """
    rigid_std = np.sqrt(np.diag(rigid))
    values, vectors = np.linalg.eigh(rigid / np.outer(rigid_std, rigid_std))
    is_regular = values > _MIN_EIGENVALUE_RATIO * values[-1]
    whiten = (vectors[:, is_regular] / np.sqrt(values[is_regular])).T / rigid_std
    ratios, directions = np.linalg.eigh(whiten @ covariance @ whiten.T)
    informative = directions.T[ratios > _MIN_STD_RATIO**2] @ whiten
    projection = informative @ difference
    total = informative @ (covariance + added) @ informative.T
    return float(projection @ np.linalg.solve(total, projection)), len(projection)


def _as_normal(chi_square: float, degrees: int) -> float:
    tail = max(chi_square_tail(chi_square, degrees), _MIN_TAIL_PROBABILITY)
    return max(0.0, -NormalDist().inv_cdf(0.5 * tail))


def disagreement(
    differences: Sequence[StageDifference], tests: Sequence[AgreementTest]
) -> Iterator[Diagnostic]:
    """Yield the warning that the stages disagree; at most one."""
    failed = [test for test in tests if test.disagrees]
    if not failed:
        return
    worst = max(failed, key=lambda test: test.deviations)
    largest = tuple(
        Clause(
            "stage-difference",
            parameter=Place(joint=d.joint, parameter=d.name),
            rigid=d.rigid,
            whole_arm=d.whole_arm,
            unit=d.unit,
        )
        for d in sorted(differences, key=lambda d: -abs(d.deviations))[:3]
    )
    yield Diagnostic(
        "stages-disagree",
        Place(part="rigid and whole-arm fit"),
        subject=worst.subject,
        deviations=worst.deviations,
        chi_square=worst.chi_square,
        degrees=worst.degrees,
        largest=largest,
    )
