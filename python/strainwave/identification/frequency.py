"""Nonparametric frequency responses of a joint with noise and distortion, and its resonances."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import (
    ComplexArray,
    Decoupled,
    FloatArray,
    FrequencyOptions,
    FrequencyResponse,
    Resonance,
)
from strainwave.errors import NotIdentifiable
from strainwave.numerics.spectra import window_spectra
from strainwave.signals.channels import check_alike

__all__ = ["FrequencyOptions", "by_periods", "by_welch", "estimate_response", "resonance"]

_MIN_PERIODS = 2  # minimum number of periods, so that their scatter can be computed
_OVERLAP = 0.5  # of Welch segments
# equivalent number of independent segments per Hann segment with 50 % overlap
_INDEPENDENT_SHARE = 0.95
_N_ITERATIONS = 20  # iterations of reweighting; a few suffice
# lower edge of the fit over the dip frequency, and upper edge over the peak frequency
_LOW_EDGE_TO_DIP, _HIGH_EDGE_TO_PEAK = 0.5, 1.6
_MIN_LINES = 12  # minimum number of lines, twice the number of coefficients
_MEDIAN_LINES = 5  # lines of the running median in which dip and peak are located


def estimate_response(
    records: Sequence[Decoupled], options: FrequencyOptions | None = None
) -> FrequencyResponse:
    """Nonparametric frequency response of one joint from one or several records.

    For periodic excitation with at least as many records as inputs: average the periods, solve Y =
    G U per line over the records, and compute the noise from the scatter of the periods. Otherwise:
    H1 = S_yu S_uu^-1 by Welch's method over all records. With more records than necessary, their
    difference in excess of the noise is distortion, caused by different amplitudes or postures.

    The records must belong to one joint and have one sampling period. The outputs are motor
    velocity and link velocity.

    Raises `InvalidInput` if there is no record or the records differ in joint, sampling period or
    inputs; `NotIdentifiable` if the records do not separate the inputs.
    """
    chosen = options or FrequencyOptions()
    check_alike(records)
    n_in = min(chosen.inputs or records[0].inputs.shape[1], records[0].inputs.shape[1])
    T = records[0].sample_time
    pairs = [(r.inputs[:, :n_in], r.outputs) for r in records]
    periods = {_period(r) for r in records}
    period = periods.pop() if len(periods) == 1 else None
    shortest = min(len(u) for u, _ in pairs)
    if period and shortest >= _MIN_PERIODS * period and len(pairs) >= n_in:
        return by_periods(pairs, T, period, chosen.transient_periods)
    segment = round(chosen.segment / T) if chosen.segment else (period or shortest // 4)
    return by_welch(pairs, T, min(segment, shortest))


def by_periods(
    pairs: Sequence[tuple[FloatArray, FloatArray]], sample_time: float, period: int, transient: int
) -> FrequencyResponse:
    """Frequency response from whole periods of periodic records.

    `pairs` has (n_samples, n_inputs) and (n_samples, n_outputs) per record, `period` is in samples,
    and `transient` is the number of periods left out at the start, so that at least two remain.
    Raises `NotIdentifiable` for fewer records than inputs.
    """
    n_in = pairs[0][0].shape[1]
    if len(pairs) < n_in:
        raise NotIdentifiable(
            f"{n_in} inputs need as many periodic records, and there are {len(pairs)}"
        )
    means: list[ComplexArray] = []
    scatters: list[ComplexArray] = []
    n_periods = 0
    for pair in pairs:
        n_skipped = min(transient, max(0, len(pair[0]) // period - _MIN_PERIODS))
        n_whole = len(pair[0]) // period - n_skipped
        columns = np.column_stack(pair)[n_skipped * period :][: n_whole * period]
        blocks = columns.reshape(n_whole, period, -1)
        lines = np.asarray(np.fft.rfft(blocks, axis=1)[:, 1:] / period)  # without the constant
        means.append(lines.mean(axis=0))
        scatters.append(lines - means[-1])
        n_periods += len(lines)
    mean = np.stack(means, axis=1)  # (n_frequencies, n_records, n_in + n_out)
    u: ComplexArray = np.swapaxes(mean[..., :n_in], 1, 2)
    y: ComplexArray = np.swapaxes(mean[..., n_in:], 1, 2)
    inverse = np.linalg.pinv(u, rcond=1e-6)
    response = y @ inverse
    # error of a period: its output minus the response to its own input
    variance = np.zeros(response.shape)
    noise_power = np.zeros((len(response), y.shape[1]))
    for k, scatter in enumerate(scatters):
        residual = scatter[..., n_in:] - np.einsum("foi,pfi->pfo", response, scatter[..., :n_in])
        mean_variance = (
            (np.abs(residual) ** 2).sum(axis=0) / max(1, len(scatter) - 1) / len(scatter)
        )
        variance += mean_variance[:, :, None] * (np.abs(inverse[:, k, :]) ** 2)[:, None, :]
        noise_power += mean_variance * len(scatter)
    output_power = (np.abs(y) ** 2).sum(axis=2)
    coherence = output_power / np.maximum(output_power + noise_power, 1e-300)
    frequency: FloatArray = np.asarray(np.fft.rfftfreq(period, sample_time)[1:], dtype=float)
    distortion = _distortion(y, u, response, variance) if len(pairs) > n_in else None
    return FrequencyResponse(
        frequencies_hz=frequency,
        response=response,
        coherence=coherence,
        noise_variance=variance,
        distortion_variance=distortion,
        method="periods",
        n_averages=n_periods,
    )


def by_welch(
    pairs: Sequence[tuple[FloatArray, FloatArray]], sample_time: float, segment: int
) -> FrequencyResponse:
    """H1 = S_yu S_uu^-1 with overlapping Hann windows over all records.

    `pairs` has (n_samples, n_inputs) and (n_samples, n_outputs) per record; `segment` is in
    samples. The coherence is the multiple coherence. The noise variance is that of the residual
    over n_averages S_uu. Raises `NotIdentifiable` if there are no more segments than inputs.
    """
    n_in = pairs[0][0].shape[1]
    window, step = np.hanning(segment), max(1, round(segment * (1.0 - _OVERLAP)))
    segments = [window_spectra(np.column_stack(pair), window, step)[:, 1:] for pair in pairs]
    lines = np.concatenate(segments)
    count = len(lines)
    if count <= n_in:
        raise NotIdentifiable(f"{count} segments cannot separate {n_in} inputs; record for longer")
    S = np.einsum("pfa,pfb->fab", lines, lines.conj()) / count
    S_uu, S_yu, S_yy = S[:, :n_in, :n_in], S[:, n_in:, :n_in], S[:, n_in:, n_in:]
    inverse = np.linalg.pinv(S_uu, rcond=1e-9, hermitian=True)
    response = S_yu @ inverse
    output_power = np.einsum("foo->fo", S_yy).real
    explained_power = np.einsum("foi,foi->fo", response, S_yu.conj()).real
    coherence = np.clip(explained_power / np.maximum(output_power, 1e-300), 0.0, 1.0)
    degrees_of_freedom = (count - n_in) * (1.0 if count == len(pairs) else _INDEPENDENT_SHARE)
    residual_power = output_power * (1.0 - coherence) / degrees_of_freedom
    variance = residual_power[:, :, None] * np.einsum("fii->fi", inverse).real[:, None, :]
    frequency: FloatArray = np.asarray(np.fft.rfftfreq(segment, sample_time)[1:], dtype=float)
    return FrequencyResponse(
        frequencies_hz=frequency,
        response=response,
        coherence=coherence,
        noise_variance=variance,
        method="welch",
        n_averages=count,
    )


def resonance(
    frequencies_hz: FloatArray,
    response: ComplexArray,
    variance: FloatArray | None = None,
    band_hz: tuple[float, float] | None = None,
) -> Resonance:
    """Anti-resonance and resonance from motor input to motor velocity, by a local complex fit.

    Fits G11 = (b0 + b1 s + b2 s^2) / (a0 + a1 s + a2 s^2 + a3 s^3) of (17) around the dip and the
    peak by iterated linear least squares, weighted by the last denominator (Sanathanan and
    Koerner).

    `frequencies_hz` [Hz], `response` and `variance` are (n_frequencies,); lines have the inverse
    variance as weight. `band_hz` limits the search for dip and peak.

    Raises `NotIdentifiable` if there is no dip below a peak, or the fit has no damped oscillating
    pair.
    """
    low, high = band_hz or (frequencies_hz[0], frequencies_hz[-1])
    dip, peak = _dip_and_peak(frequencies_hz, response, low, high)
    inside = (frequencies_hz >= max(low, _LOW_EDGE_TO_DIP * dip)) & (
        frequencies_hz <= _HIGH_EDGE_TO_PEAK * peak
    )
    if inside.sum() < _MIN_LINES:
        raise NotIdentifiable("too few spectral lines around the resonance; record longer periods")
    s = 1j * frequencies_hz[inside] / peak
    G = response[inside]
    floor = 1e-6 * float(np.median(np.abs(G)))
    weight = np.ones(len(G)) if variance is None else 1.0 / np.sqrt(variance[inside] + floor**2)
    scale = float(np.median(np.abs(G)))
    powers = s[:, None] ** np.arange(4)
    denominator = np.ones(len(s), dtype=complex)
    coefficients = np.zeros(6)
    for _ in range(_N_ITERATIONS):
        rows = np.column_stack([powers[:, :3], -(G / scale)[:, None] * powers[:, :3]])
        target = (G / scale) * powers[:, 3]
        row_weight = (weight / np.abs(denominator))[:, None]
        real_rows = np.concatenate([(rows * row_weight).real, (rows * row_weight).imag])
        real_target = np.concatenate(
            [(target * row_weight[:, 0]).real, (target * row_weight[:, 0]).imag]
        )
        column_norm = np.linalg.norm(real_rows, axis=0)
        coefficients = (
            np.linalg.lstsq(real_rows / column_norm, real_target, rcond=None)[0] / column_norm
        )
        denominator = powers @ np.r_[coefficients[3:], 1.0]
    zero = _pair(coefficients[:3], dip / peak)
    pole = _pair(np.r_[coefficients[3:], 1.0], 1.0)
    if min(-zero.real, -pole.real) <= 0.0:
        raise NotIdentifiable("the local fit grows in time: the response is too noisy there")
    return Resonance(
        anti_resonance_hz=float(abs(zero) * peak),
        anti_resonance_damping=float(-zero.real / abs(zero)),
        resonance_hz=float(abs(pole) * peak),
        resonance_damping=float(-pole.real / abs(pole)),
    )


def _period(record: Decoupled) -> int | None:
    """Period of the joint's excitation in samples, if it is an integer; otherwise None."""
    prbs = record.experiment.prbs
    if prbs is None:
        return None
    samples = prbs.clock * (2**prbs.order - 1) / record.sample_time
    rounded = round(samples)
    return rounded if abs(samples - rounded) < 1e-3 and rounded >= 16 else None


def _distortion(
    y: ComplexArray, u: ComplexArray, response: ComplexArray, variance: FloatArray
) -> FloatArray:
    """Variance between records of the single-record response, in excess of the noise.

    With one input, each record has a response of its own. With more inputs, the residual of the
    common response is divided by the power of the inputs.
    """
    n_in, n_records = u.shape[1:]
    residual = y - response @ u
    residual_power = (np.abs(residual) ** 2).sum(axis=2) / (n_records - n_in)
    input_power = (np.abs(u) ** 2).mean(axis=2)
    variance_per_record = residual_power[:, :, None] / np.maximum(input_power[:, None, :], 1e-300)
    return np.asarray(np.clip(variance_per_record - n_records * variance, 0.0, None))


def _dip_and_peak(
    frequency: FloatArray, response: ComplexArray, low: float, high: float
) -> tuple[float, float]:
    """Frequencies of the minimum and the following maximum of the response times frequency."""
    inside = np.flatnonzero((frequency >= low) & (frequency <= high))
    if inside.size < _MIN_LINES:
        raise NotIdentifiable("too few spectral lines in the band")
    normalised = np.abs(response[inside]) * frequency[inside]
    windows = np.lib.stride_tricks.sliding_window_view(
        np.log(np.maximum(normalised, 1e-300)), _MEDIAN_LINES
    )
    smoothed = np.median(windows, axis=1)
    frequencies = frequency[inside][_MEDIAN_LINES // 2 : -(_MEDIAN_LINES // 2)]
    largest_rise, dip_and_peak = 0.0, (0, 0)
    lowest = 0
    # largest increase from a minimum to a later maximum
    for k, value in enumerate(smoothed.tolist()):
        if value < smoothed[lowest]:
            lowest = k
        if value - smoothed[lowest] > largest_rise:
            largest_rise, dip_and_peak = value - smoothed[lowest], (lowest, k)
    if largest_rise < np.log(2.0):
        raise NotIdentifiable("the response has no dip below a peak; raise amplitude or bandwidth")
    return float(frequencies[dip_and_peak[0]]), float(frequencies[dip_and_peak[1]])


def _pair(coefficients: FloatArray, near: float) -> complex:
    """Root with positive imaginary part whose modulus is nearest to `near`."""
    roots = np.roots(coefficients[::-1])
    upper = roots[roots.imag > 1e-9]
    if not upper.size:
        raise NotIdentifiable("the local fit has no oscillating pair; record longer periods")
    return complex(upper[np.argmin(np.abs(np.abs(upper) - near))])
