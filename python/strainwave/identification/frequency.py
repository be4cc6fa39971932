"""Decoupled records -> frequency responses, their noise and distortion, and resonances."""

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

__all__ = ["FrequencyOptions", "by_periods", "by_welch", "resonance", "respond"]

_FEWEST_PERIODS = 2
_OVERLAP = 0.5
_INDEPENDENT = 0.95  # segments that half overlap under a Hann window count for so many
_ROUNDS = 20  # of reweighting; it settles in a few
_BELOW, _ABOVE = 0.5, 1.6  # the fit's window around the dip and the peak
_FEW_LINES = 12
_SMOOTH = 5  # lines of the running median in which dip and peak are sought


def respond(
    records: Sequence[Decoupled], options: FrequencyOptions | None = None
) -> FrequencyResponse:
    """Nonparametric frequency response of one joint from one or several records.

    Periodic excitation, with at least as many records as inputs: period averages, line by line,
    Y = G U over the records; noise from the scatter of the periods. Otherwise H1 = S_yu S_uu^-1 by
    Welch's method over all records. The difference between records beyond the noise, where there
    are more than needed, is distortion: another amplitude or posture, another response.

    `records`: Of one joint, all with one sample time.

    Returns: Outputs: motor velocity, link velocity.

    Raises `InvalidInput`: there is no record, or they are of different joints, sample times or
    inputs; `NotIdentifiable`: the inputs cannot be separated in the records.
    """
    chosen = options or FrequencyOptions()
    check_alike(records)
    n_in = min(chosen.inputs or records[0].inputs.shape[1], records[0].inputs.shape[1])
    T = records[0].sample_time
    pairs = [(r.inputs[:, :n_in], r.outputs) for r in records]
    periods = {_period(r) for r in records}
    period = periods.pop() if len(periods) == 1 else None
    shortest = min(len(u) for u, _ in pairs)
    if period and shortest >= _FEWEST_PERIODS * period and len(pairs) >= n_in:
        return by_periods(pairs, T, period, chosen.transient_periods)
    wanted = round(chosen.segment / T) if chosen.segment else (period or shortest // 4)
    return by_welch(pairs, T, min(wanted, shortest))


def by_periods(
    pairs: Sequence[tuple[FloatArray, FloatArray]], sample_time: float, period: int, transient: int
) -> FrequencyResponse:
    """Response from whole periods of periodic records.

    `pairs` (n_samples, n_inputs) (n_samples, n_outputs).
    `sample_time` [s].
    `period`: Samples.
    `transient`: Periods left out at the start, as far as two are left.

    Raises `NotIdentifiable`: fewer records than inputs.
    """
    n_in = pairs[0][0].shape[1]
    if len(pairs) < n_in:
        raise NotIdentifiable(
            f"{n_in} inputs need as many periodic records, and there are {len(pairs)}"
        )
    means: list[ComplexArray] = []
    scatters: list[ComplexArray] = []
    count = 0
    for pair in pairs:
        kept = min(transient, max(0, len(pair[0]) // period - _FEWEST_PERIODS))
        lines = _lines(np.column_stack(pair)[kept * period :], period)
        means.append(lines.mean(axis=0))
        scatters.append(lines - means[-1])
        count += len(lines)
    mean = np.stack(means, axis=1)  # (n_frequencies, n_records, n_in + n_out)
    u: ComplexArray = np.swapaxes(mean[..., :n_in], 1, 2)
    y: ComplexArray = np.swapaxes(mean[..., n_in:], 1, 2)
    inverse = np.linalg.pinv(u, rcond=1e-6)
    response = y @ inverse
    # a period's error is what its output has beyond the response to its own input
    variance = np.zeros(response.shape)
    noise_power = np.zeros((len(response), y.shape[1]))
    for k, scatter in enumerate(scatters):
        residual = scatter[..., n_in:] - np.einsum("foi,pfi->pfo", response, scatter[..., :n_in])
        of_mean = (np.abs(residual) ** 2).sum(axis=0) / max(1, len(scatter) - 1) / len(scatter)
        variance += of_mean[:, :, None] * (np.abs(inverse[:, k, :]) ** 2)[:, None, :]
        noise_power += of_mean * len(scatter)
    power = (np.abs(y) ** 2).sum(axis=2)
    coherence = power / np.maximum(power + noise_power, 1e-300)
    frequency: FloatArray = np.asarray(np.fft.rfftfreq(period, sample_time)[1:], dtype=float)
    distortion = _distortion(y, u, response, variance) if len(pairs) > n_in else None
    return FrequencyResponse(
        frequencies_hz=frequency,
        response=response,
        coherence=coherence,
        noise_variance=variance,
        distortion_variance=distortion,
        method="periods",
        n_averages=count,
    )


def by_welch(
    pairs: Sequence[tuple[FloatArray, FloatArray]], sample_time: float, segment: int
) -> FrequencyResponse:
    """H1 = S_yu S_uu^-1 with overlapping Hann windows over all records.

    `pairs` (n_samples, n_inputs) (n_samples, n_outputs).
    `sample_time` [s].
    `segment`: Samples.

    Returns: Coherence is the multiple one. Noise variance is the residual's over n_averages S_uu.

    Raises `NotIdentifiable`: there are no more segments than inputs.
    """
    n_in = pairs[0][0].shape[1]
    blocks = [_segments(np.column_stack(pair), segment) for pair in pairs]
    lines = np.concatenate(blocks)
    count = len(lines)
    if count <= n_in:
        raise NotIdentifiable(f"{count} segments cannot separate {n_in} inputs; record for longer")
    S = np.einsum("pfa,pfb->fab", lines, lines.conj()) / count
    S_uu, S_yu, S_yy = S[:, :n_in, :n_in], S[:, n_in:, :n_in], S[:, n_in:, n_in:]
    inverse = np.linalg.pinv(S_uu, rcond=1e-9, hermitian=True)
    response = S_yu @ inverse
    power = np.einsum("foo->fo", S_yy).real
    explained = np.einsum("foi,foi->fo", response, S_yu.conj()).real
    coherence = np.clip(explained / np.maximum(power, 1e-300), 0.0, 1.0)
    freedom = (count - n_in) * (1.0 if count == len(pairs) else _INDEPENDENT)
    left = power * (1.0 - coherence) / freedom
    variance = left[:, :, None] * np.einsum("fii->fi", inverse).real[:, None, :]
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
    """Anti-resonance and resonance of motor input to motor velocity, by a local complex fit.

    G11 = (b0 + b1 s + b2 s^2) / (a0 + a1 s + a2 s^2 + a3 s^3) of (17) around the dip and the peak,
    by least squares on the numerator and denominator, reweighted with the last denominator
    (Sanathanan and Koerner) until it settles.

    `frequencies_hz` (n_frequencies,) [Hz].
    `response` (n_frequencies,).
    `variance` (n_frequencies,): Of the response; lines weigh by its inverse.
    `band_hz`: Where to look for dip and peak.

    Raises `NotIdentifiable`: there is no dip below a peak, or the fit has no damped oscillating
    pair.
    """
    low, high = band_hz or (frequencies_hz[0], frequencies_hz[-1])
    dip, peak = _dip_and_peak(frequencies_hz, response, low, high)
    inside = (frequencies_hz >= max(low, _BELOW * dip)) & (frequencies_hz <= _ABOVE * peak)
    if inside.sum() < _FEW_LINES:
        raise NotIdentifiable("too few spectral lines around the resonance; record longer periods")
    s = 1j * frequencies_hz[inside] / peak
    G = response[inside]
    floor = 1e-6 * float(np.median(np.abs(G)))
    weight = np.ones(len(G)) if variance is None else 1.0 / np.sqrt(variance[inside] + floor**2)
    scale = float(np.median(np.abs(G)))
    powers = s[:, None] ** np.arange(4)
    denominator = np.ones(len(s), dtype=complex)
    coefficients = np.zeros(6)
    for _ in range(_ROUNDS):
        rows = np.column_stack([powers[:, :3], -(G / scale)[:, None] * powers[:, :3]])
        target = (G / scale) * powers[:, 3]
        by = (weight / np.abs(denominator))[:, None]
        stacked = np.concatenate([(rows * by).real, (rows * by).imag])
        aim = np.concatenate([(target * by[:, 0]).real, (target * by[:, 0]).imag])
        size = np.linalg.norm(stacked, axis=0)
        coefficients = np.linalg.lstsq(stacked / size, aim, rcond=None)[0] / size
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
    """Samples of one period of the joint's excitation, where that is a whole number."""
    prbs = record.experiment.prbs
    if prbs is None:
        return None
    samples = prbs.clock * (2**prbs.order - 1) / record.sample_time
    whole = round(samples)
    return whole if abs(samples - whole) < 1e-3 and whole >= 16 else None


def _lines(columns: FloatArray, period: int) -> ComplexArray:
    """Spectra of whole periods, without the constant: (n_periods, n_frequencies, n_columns)."""
    whole = len(columns) // period
    blocks = columns[: whole * period].reshape(whole, period, -1)
    return np.asarray(np.fft.rfft(blocks, axis=1)[:, 1:] / period)


def _segments(columns: FloatArray, segment: int) -> ComplexArray:
    step = max(1, round(segment * (1.0 - _OVERLAP)))
    return window_spectra(columns, np.hanning(segment), step)[:, 1:]


def _distortion(
    y: ComplexArray, u: ComplexArray, response: ComplexArray, variance: FloatArray
) -> FloatArray:
    """Variance between records of the single-record response, beyond the noise.

    With one input each record has a response of its own; with more, the residual of the common one
    is brought to the inputs.
    """
    n_in, n_records = u.shape[1:]
    residual = y - response @ u
    spread = (np.abs(residual) ** 2).sum(axis=2) / (n_records - n_in)
    power = (np.abs(u) ** 2).mean(axis=2)
    found = spread[:, :, None] / np.maximum(power[:, None, :], 1e-300)
    return np.asarray(np.clip(found - n_records * variance, 0.0, None))


def _dip_and_peak(
    frequency: FloatArray, response: ComplexArray, low: float, high: float
) -> tuple[float, float]:
    """Where a response divided by that of a mere inertia has its least, and then its largest."""
    inside = np.flatnonzero((frequency >= low) & (frequency <= high))
    if inside.size < _FEW_LINES:
        raise NotIdentifiable("too few spectral lines in the band")
    rigid = np.abs(response[inside]) * frequency[inside]
    lines = np.lib.stride_tricks.sliding_window_view(np.log(np.maximum(rigid, 1e-300)), _SMOOTH)
    smooth = np.median(lines, axis=1)
    found = frequency[inside][_SMOOTH // 2 : -(_SMOOTH // 2)]
    best, pair = 0.0, (0, 0)
    least = 0
    # the largest rise from a least value to a later one
    for k, value in enumerate(smooth.tolist()):
        if value < smooth[least]:
            least = k
        if value - smooth[least] > best:
            best, pair = value - smooth[least], (least, k)
    if best < np.log(2.0):
        raise NotIdentifiable("the response has no dip below a peak; raise amplitude or bandwidth")
    return float(found[pair[0]]), float(found[pair[1]])


def _pair(coefficients: FloatArray, near: float) -> complex:
    """The root of positive imaginary part nearest to a frequency."""
    roots = np.roots(coefficients[::-1])
    upper = roots[roots.imag > 1e-9]
    if not upper.size:
        raise NotIdentifiable("the local fit has no oscillating pair; record longer periods")
    return complex(upper[np.argmin(np.abs(np.abs(upper) - near))])
