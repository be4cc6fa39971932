"""Zero-phase filters, differentiation, sensor lags, and the bandwidth of a recorded signal.

If the same linear filter is applied to both sides of an equation, the equation still holds. A
zero-phase filter also keeps the time axis. All functions act along the first axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np

from strainwave import _core
from strainwave.domain import ComplexArray, FloatArray, Lag
from strainwave.numerics.linalg import exponential
from strainwave.numerics.spectra import cross_spectral_densities

Between = Literal["smooth", "held", "straight"]

# Ratio of density to noise floor above which a line is signal. A Welch estimate of 8 averages stays
# below 4 times its mean.
_MIN_SIGNAL_TO_FLOOR = 4.0
_MIN_SAMPLES = 32  # shortest record for a spectral estimate, and shortest padding
# periods of the cut-off frequency after which a transient is below rounding
_SETTLING_PERIODS = 14.0
# periods of the cut-off frequency after which the impulse response of the low-pass is below 1e-11
_RESPONSE_PERIODS = 11.0
_SUMS_PER_VECTOR = 16  # sums over impulse responses that take the time of one
# Products of such vectors per number of a signal up to which they take less time than a transform.
_MAX_VECTORS = 30
# samples per transform; longer transforms do not fit the processor cache
_MAX_TRANSFORM_SAMPLES = 1 << 17


def low_pass(
    signal: FloatArray,
    cutoff_hz: float,
    sample_time: float,
    *,
    decimated: int = 1,
    kept: slice = slice(None),
) -> FloatArray:
    """Zero-phase Butterworth low-pass of order 4, applied forward and backward.

        |H|^2 = 1 / (1 + (tan(pi f T) / tan(pi cutoff_hz T))^8)

    is the squared magnitude of one pass, so the gain at the cut-off is 1/2. The filter multiplies
    the spectrum of the signal, extended at both ends by point reflection. Long signals are filtered
    in overlapping pieces, which changes the result by rounding errors only. Few samples of a signal
    are sums over the impulse response, up to where it is below 1e-11.

    `signal` (n_samples, ...).
    `cutoff_hz` [Hz]: From 0.45 of the sampling rate on, the signal is returned unchanged.
    `sample_time` [s]: Sampling period before decimation.
    `decimated`: The signal holds every k-th sample; the filter has the gain of the original rate.
    `kept`: Samples to return, as a slice with positive step.

    Returns (n_kept, ...). The first and last 1/cutoff_hz seconds contain transients.
    """
    relative = cutoff_hz * sample_time
    if relative >= 0.45:
        return signal[kept]
    n, indices = len(signal), range(len(signal))[kept]
    reach = int(_RESPONSE_PERIODS / (relative * decimated))
    run = signal[0].size * (len(indices) if indices.step == 1 else 1)  # successive sums
    n_runs = len(indices) * signal[0].size // max(run, 1)
    n_vectors = n_runs * -(-run // _SUMS_PER_VECTOR)
    if 0 < reach < n and 0 < n_vectors * reach < _MAX_VECTORS * signal.size:
        response = _half_response(reach, relative, decimated)
        place = indices.start, indices.step, len(indices)
        flat = np.ascontiguousarray(signal).reshape(n, -1)
        sums = _core.symmetric_filter(flat, response, *place)
        return sums.reshape(-1, *signal.shape[1:])
    margin = int(_SETTLING_PERIODS / (relative * decimated))
    piece = max(_MAX_TRANSFORM_SAMPLES, 8 * margin)
    if n <= 2 * piece:
        return _passed(signal, relative, decimated)[kept]
    kept_indices = np.arange(n)[kept]
    filtered = np.empty((len(kept_indices), *signal.shape[1:]))
    for start in range(0, n, piece):
        low, high = np.searchsorted(kept_indices, (start, start + piece))
        begin = max(0, start - margin)
        passed = _passed(signal[begin : start + piece + margin], relative, decimated)
        filtered[low:high] = passed[kept_indices[low:high] - begin]
    return filtered


def _passed(signal: FloatArray, relative: float, decimated: int) -> FloatArray:
    """Low-pass of a complete signal; `relative` is the cut-off divided by the sampling rate."""
    n = len(signal)
    pad = min(n - 1, int(4.0 / (relative * decimated)))
    extended = _point_reflected(signal, pad)
    gain = _gain(fast_length(len(extended)), relative, decimated)
    # the filter does not change a straight line
    return _filter_about_line(extended, gain, slice(pad, pad + n))[0]


def impulse_response(reach: int, cutoff_hz: float, sample_time: float) -> FloatArray:
    """Impulse response of `low_pass` for a signal of `reach` samples on both sides of the impulse.

    Shape (2 reach + 1,). It is zero at both ends, because the impulse is reflected there.
    """
    half = _half_response(3 * reach, cutoff_hz * sample_time, 1)
    at = np.abs(np.arange(-reach, reach + 1))
    return np.asarray(half[at] - half[2 * reach - at] - half[2 * reach + at])


@lru_cache(maxsize=32)
def _half_response(reach: int, relative: float, decimated: int) -> FloatArray:
    """Impulse response of the low-pass from the impulse on, (reach + 1,)."""
    size = fast_length(2 * max(reach, int(_SETTLING_PERIODS / (relative * decimated))))
    response = np.fft.irfft(_gain(size, relative, decimated), size)[: reach + 1]
    response.setflags(write=False)
    return response


@lru_cache(maxsize=8)
def _gain(size: int, relative: float, decimated: int) -> FloatArray:
    """Gain of the low-pass, (size / 2 + 1,); iterations repeat the same filters."""
    warped = np.tan(np.pi / decimated * np.fft.rfftfreq(size)[:-1]) / np.tan(np.pi * relative)
    gain = np.zeros(size // 2 + 1)  # zero at the Nyquist frequency
    gain[:-1] = 1.0 / (1.0 + _eighth_power(warped))
    gain.setflags(write=False)
    return gain


def _filter_about_line(
    extended: FloatArray, response: FloatArray | ComplexArray, inside: slice
) -> tuple[FloatArray, FloatArray]:
    """Filter a signal minus the line through its ends, and add the line; the slope of the line.

    Without the line both ends are equal, as a transform requires. `response` (n_frequencies,).
    """
    n = len(extended)
    slope = (extended[-1] - extended[0]) / (n - 1)
    line = np.multiply.outer(np.arange(n, dtype=np.float64), slope)
    line += extended[0]
    extended -= line
    size = fast_length(n)
    spectrum = np.fft.rfft(extended, size, axis=0)
    spectrum *= _along_rows(response, extended)
    passed: FloatArray = np.fft.irfft(spectrum, size, axis=0)[inside]
    passed += line[inside]
    return passed, slope


def _along_rows(response: FloatArray | ComplexArray, signal: FloatArray) -> ComplexArray:
    """A response (n_frequencies,) in a shape that multiplies the spectrum of a signal."""
    return np.asarray(response.reshape(-1, *(1,) * (signal.ndim - 1)))


def _point_reflected(signal: FloatArray, pad: int) -> FloatArray:
    """Signal extended by `pad` samples of its point reflection at both ends."""
    before = 2.0 * signal[:1] - signal[pad:0:-1]
    after = 2.0 * signal[-1:] - signal[-2 : -pad - 2 : -1]
    return np.concatenate([before, signal, after])


@lru_cache(maxsize=256)
def fast_length(least: int) -> int:
    """Smallest even length of at least `least` with prime factors 2, 3 and 5, for a fast FFT."""
    odd: list[int] = [3**i * 5**j for i in range(8) for j in range(4)]
    return min(each << max(1, (-(-least // each) - 1).bit_length()) for each in odd)


def differentiate(signal: FloatArray, sample_time: float) -> FloatArray:
    """Central differences of fourth order: x' = (8 (x_1 - x_-1) - (x_2 - x_-2)) / (12 T).

    The relative error at the angular frequency w is (w T)^4 / 30. The two samples at each end use
    second-order differences.

    `signal` (n_samples, ...).
    `sample_time` [s].
    """
    if len(signal) < 3:
        return np.asarray(np.gradient(signal, sample_time, axis=0), dtype=np.float64)
    derivative = np.empty_like(signal)
    derivative[0] = (signal[1] - signal[0]) / sample_time
    derivative[1] = (signal[2] - signal[0]) / (2.0 * sample_time)
    derivative[-2] = (signal[-1] - signal[-3]) / (2.0 * sample_time)
    derivative[-1] = (signal[-1] - signal[-2]) / sample_time
    for start in range(2, len(signal) - 2, _MAX_TRANSFORM_SAMPLES):
        stop = min(start + _MAX_TRANSFORM_SAMPLES, len(signal) - 2)
        inner_difference = signal[start + 1 : stop + 1] - signal[start - 1 : stop - 1]
        outer_difference = signal[start + 2 : stop + 2] - signal[start - 2 : stop - 2]
        derivative[start:stop] = (8.0 * inner_difference - outer_difference) / (12.0 * sample_time)
    return derivative


def noise_std(signal: FloatArray) -> float:
    """Standard deviation of the white noise on a smooth signal (n_samples,).

    Sixth differences suppress a smooth motion. White noise of variance s^2 has sixth differences of
    variance 924 s^2 (the sum of the squared binomial coefficients).
    """
    sixth = np.diff(signal, 6)
    return float(np.sqrt(np.mean(sixth**2) / 924.0)) if sixth.size else 0.0


def signal_band(angle: FloatArray, sample_time: float) -> float:
    """Frequency [Hz] up to which an angle exceeds its measurement noise.

    The noise of an encoder is white, and the spectrum of the motion falls steeply. The band ends
    where the power spectral density reaches the median above a quarter of the sampling rate.

    `angle` (n_samples,).
    `sample_time` [s].

    Returns at most a fifth of the sampling rate: at higher frequencies, a filter passes mainly
    noise.
    """
    rate = 1.0 / sample_time
    if len(angle) < _MIN_SAMPLES:
        return 0.2 * rate
    segment = min(len(angle) // 4, max(256, round(2.0 * rate)))
    frequency, density = cross_spectral_densities(
        np.diff(angle)[:, None], sample_time, segment, trend="line"
    )
    power = density[:, 0, 0].real
    # convert the spectrum of the differences to that of the angle; differencing avoids leakage of
    # trends
    power = power[1:] / (2.0 * np.sin(np.pi * frequency[1:] * sample_time)) ** 2
    frequency = frequency[1:]
    floor = np.median(power[frequency >= 0.25 * rate])
    above_floor = np.flatnonzero(power > _MIN_SIGNAL_TO_FLOOR * floor)
    if not above_floor.size:
        return float(frequency[0])
    # the first wide gap ends the band, so interference lines above it do not extend it
    gap = max(2, len(frequency) // 200)
    ends = np.flatnonzero(np.diff(above_floor) > gap)
    last = above_floor[ends[0]] if ends.size else above_floor[-1]
    return float(min(frequency[last], 0.2 * rate))


def apply_lags(
    signal: FloatArray, lags: Sequence[Lag], sample_time: float, *, held: bool = False
) -> FloatArray:
    """Signal after a cascade of low-pass filters of sensors or drives.

    First order: 1 / (1 + s/w). Second order, Butterworth: 1 / (1 + sqrt(2) s/w + (s/w)^2). w = 2 pi
    cutoff_hz. The cascade is discretised exactly.

    `signal` (n_samples, ...).
    `lags`: If empty, the signal is returned unchanged.
    `sample_time` [s].
    `held`: Zero-order hold between samples; otherwise linear interpolation.

    Returns (n_samples, ...). The initial state is the steady state of the first sample.
    """
    if not lags:
        return signal
    n = len(signal)
    response, size = _lag_response(tuple(lags), sample_time, held, n)
    spectrum = np.fft.rfft(signal - signal[:1], size, axis=0)
    spectrum *= _along_rows(response, signal)
    return np.asarray(signal[:1] + np.fft.irfft(spectrum, size, axis=0)[:n])


@lru_cache(maxsize=32)
def _lag_response(
    lags: tuple[Lag, ...], sample_time: float, held: bool, n: int
) -> tuple[ComplexArray, int]:
    """Frequency response of the cascade for a zero-padded transform, and the transform length.

    The padding lets the response decay, so it does not wrap around. The result is cached for the
    channels of a record.
    """
    # One matrix exponential integrates x' = A x + B u over a sampling period (Van Loan, IEEE Trans.
    # AC 23, 1978), for constant u or, with one more block, for linear u.
    polynomial: FloatArray = np.ones(1)
    for lag in lags:
        w = 2.0 * np.pi * lag.cutoff_hz * sample_time
        section = [1.0 / w, 1.0] if lag.order == 1 else [1.0 / w**2, np.sqrt(2.0) / w, 1.0]
        polynomial = np.asarray(np.polymul(polynomial, section), dtype=np.float64)
    order = len(polynomial) - 1
    block = np.zeros((order + 2, order + 2))
    block[0, :order] = -polynomial[1:] / polynomial[0]
    block[np.arange(1, order), np.arange(order - 1)] = 1.0
    block[0, order] = block[order, order + 1] = 1.0
    block_exponential = exponential(block)[:order]
    A, B, C, D = block_exponential[:, :order], block_exponential[:, order], np.zeros(order), 0.0
    C[-1] = 1.0 / polynomial[0]
    if not held:
        D = float(C @ block_exponential[:, order + 1])
        B = B - block_exponential[:, order + 1] + A @ block_exponential[:, order + 1]
    poles = np.poly(A)
    numerator = np.real(np.poly(A - np.outer(B, C)) + (D - 1.0) * poles)
    denominator = np.real(poles)
    max_pole_modulus = float(np.abs(np.roots(denominator)).max())
    n_settling = int(np.ceil(np.log(np.finfo(float).eps) / np.log(max(max_pole_modulus, 1e-3))))
    size = fast_length(n + n_settling)
    z = np.exp(-2j * np.pi * np.fft.rfftfreq(size))
    response = np.polyval(numerator[::-1], z) / np.polyval(denominator[::-1], z)
    return np.asarray(response, dtype=np.complex128), size


def apply_lags_without_aliases(
    signal: FloatArray, lags: Sequence[Lag], sample_time: float, between: Between
) -> FloatArray:
    """Signal after low-pass filters, without aliases of components above the Nyquist frequency.

    The samples that `apply_lags` returns contain aliases. A held voltage has significant components
    above the Nyquist frequency, an angle has none, so aliases would bias a comparison of the two.
    Linear interpolation of an angle would reduce it by (w T)^2 / 12. This function multiplies the
    spectrum by

        H(jw) R(jw),   R = 1 (smooth), sinc(w T / 2) exp(-jwT/2) (held), sinc(w T / 2)^2 (straight)

    `signal` (n_samples, ...).
    `sample_time` [s].
    `between`: Signal between samples: band-limited ("smooth"), constant ("held") or linear
        ("straight").

    Returns (n_samples, ...). The initial state is the steady state of the first sample.
    """
    if not lags and between == "smooth":
        return signal
    n = len(signal)
    slowest = min((lag.cutoff_hz for lag in lags), default=np.inf)
    pad = min(n - 1, max(_MIN_SAMPLES, round(_SETTLING_PERIODS / slowest / sample_time)))
    before, after = np.repeat(signal[:1], pad, axis=0), np.repeat(signal[-1:], pad, axis=0)
    if between == "smooth":
        after = 2.0 * after - signal[-2 : -pad - 2 : -1]
    extended = np.concatenate([before, signal, after])
    size = fast_length(len(extended))
    response, delay = _analog_response(tuple(lags), sample_time, between, size)
    passed, slope = _filter_about_line(extended, response, slice(pad, pad + n))
    # the response to a straight line is a delayed line
    return np.asarray(passed - slope * (delay / sample_time))


@lru_cache(maxsize=32)
def _analog_response(
    lags: tuple[Lag, ...], sample_time: float, between: Between, size: int
) -> tuple[ComplexArray, float]:
    """Frequency response at the frequencies of a transform, and delay of a straight line [s]."""
    f = np.fft.rfftfreq(size, sample_time)
    response = np.ones(len(f), dtype=np.complex128)
    delay = 0.0
    for lag in lags:
        s = 1j * f / lag.cutoff_hz
        damping_term = 1.0 if lag.order == 1 else np.sqrt(2.0)
        response /= 1.0 + damping_term * s + (s**2 if lag.order == 2 else 0.0)
        delay += damping_term / (2.0 * np.pi * lag.cutoff_hz)
    if between == "held":
        response *= np.sinc(f * sample_time) * np.exp(-1j * np.pi * f * sample_time)
        delay += 0.5 * sample_time
    elif between == "straight":
        response *= np.sinc(f * sample_time) ** 2
    return response, delay


def band_pass(signal: FloatArray, low_hz: float, high_hz: float, sample_time: float) -> FloatArray:
    """Zero-phase band-pass of one signal (n_samples,); see `band_passes`."""
    return band_passes(signal[:, None], [(0, 0)], low_hz, high_hz, sample_time)[:, 0]


def band_passes(
    signals: FloatArray,
    requests: Sequence[tuple[int, int]],
    low_hz: float,
    high_hz: float,
    sample_time: float,
) -> FloatArray:
    """Zero-phase band-pass of several signals, their integrals and their derivatives.

    H = 1 / ((1 + (low/f)^8) (1 + (f/high)^8)) (2 pi j f)^-integrals multiplies the spectra of the
    signals, extended at both ends by point reflection. Integration without a high-pass would drift.

    `signals` (n_samples, n_signals).
    `requests`: For each result, the column of the signal and the number of integrations; negative
        numbers are differentiations.
    `low_hz, high_hz` [Hz].
    `sample_time` [s].

    Returns (n_samples, n_requests). The first and last 1.5 / low_hz seconds contain transients.
    """
    f, spectrum, inverse = _padded_spectrum(signals, sample_time, 3.0 / low_hz)
    gain = 1.0 / ((1.0 + _eighth_power(low_hz / f)) * (1.0 + _eighth_power(f / high_hz)))
    filtered = np.empty((len(signals), len(requests)))
    for column, (k, integrals) in enumerate(requests):
        response = gain if integrals == 0 else gain * (2j * np.pi * f) ** -integrals
        filtered[:, column] = inverse(response * spectrum[:, k])
    return filtered


def _eighth_power(x: FloatArray) -> FloatArray:
    return np.asarray(np.square(np.square(np.square(x))))  # `**` uses slow logarithms


def by_spectrum(
    signal: FloatArray,
    response: Callable[[FloatArray], ComplexArray],
    sample_time: float,
    reach: float,
) -> FloatArray:
    """Filter with a given frequency response, for a signal extended by point reflection.

    `signal` (n_samples, ...).
    `response`: Function of frequency (n_frequencies,) [Hz], all positive. It returns
        (n_frequencies,), the same response for every column, or (n_frequencies, n_out, n_in). The
        mean of the signal is removed.
    `sample_time` [s].
    `reach` [s]: Length of the extension at each end.

    Returns (n_samples, ...).
    """
    f, spectrum, inverse = _padded_spectrum(signal, sample_time, reach)
    gain = response(f)
    if gain.ndim == 3:
        return inverse(np.einsum("foi,fi->fo", gain, spectrum))
    return inverse(spectrum * _along_rows(gain, signal))


def _padded_spectrum(
    signal: FloatArray, sample_time: float, reach: float
) -> tuple[FloatArray, ComplexArray, Callable[[ComplexArray], FloatArray]]:
    """Positive frequencies [Hz] and spectrum of an extended signal without its mean.

    Also a function from such a spectrum to the samples of the signal.
    """
    n = len(signal)
    pad = min(n - 1, int(reach / sample_time))
    extended = _point_reflected(signal, pad)
    size = fast_length(len(extended) + pad)

    def inverse(spectrum: ComplexArray) -> FloatArray:
        full_spectrum = np.concatenate([np.zeros_like(spectrum[:1]), spectrum])
        return np.asarray(np.fft.irfft(full_spectrum, size, axis=0)[pad : pad + n])

    f = np.asarray(np.fft.rfftfreq(size, sample_time)[1:], dtype=np.float64)
    return f, np.asarray(np.fft.rfft(extended, size, axis=0)[1:]), inverse
