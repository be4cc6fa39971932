"""Zero-phase filters, differentiation, and how far up a record's spectrum there is signal.

One linear filter applied to both sides of an equation leaves the equation true; a zero-phase one
leaves it true at the same instants. Everything here acts along the first axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, Lag
from strainwave.numerics.linalg import exponential
from strainwave.numerics.spectra import cross_spectral_densities

Between = Literal["smooth", "held", "straight"]

_FLOOR_MARGIN = 4.0  # a Welch estimate of 8 averages stays below 4 times its mean
_LEAST_SAMPLES = 32
_SETTLED = 14.0  # periods of its cut-off after which a low-pass has forgotten all but rounding
_PIECE = 1 << 17  # samples that are transformed at once; caches hold more of them no better


def low_pass(
    signal: FloatArray,
    cutoff_hz: float,
    sample_time: float,
    *,
    decimated: int = 1,
    kept: slice = slice(None),
) -> FloatArray:
    """Forward-backward Butterworth low-pass of order 4: no phase, squared magnitude of one pass.

    |H|^2 = 1 / (1 + (tan(pi f T) / tan(pi cutoff_hz T))^8), so that H = 1/2 at the cut-off,
    applied to the spectrum of the signal continued at both ends by its own point reflection.
    Long signals pass piece by piece, with so much of its neighbours that only rounding differs.

    `signal` (n_samples, ...).
    `cutoff_hz` [Hz]: At or above 0.45 of the sampling rate the signal is returned as it is.
    `sample_time` [s].
    `decimated`: The signal is every k-th sample of those; it gets the very gain that they would.
    `kept`: The samples wanted, from the first wanted one on in equal steps.

    Returns: (n_kept, ...): The first and last 1/cutoff_hz seconds hold the filter's transients.
    """
    relative = cutoff_hz * sample_time
    if relative >= 0.45:
        return signal[kept]
    n = len(signal)
    margin = int(_SETTLED / (relative * decimated))
    piece = max(_PIECE, 8 * margin)
    if n <= 2 * piece:
        return _passed(signal, relative, decimated)[kept]
    wanted = np.arange(n)[kept]
    found = np.empty((len(wanted), *signal.shape[1:]))
    for start in range(0, n, piece):
        low, high = np.searchsorted(wanted, (start, start + piece))
        begin = max(0, start - margin)
        near = signal[begin : start + piece + margin]
        found[low:high] = _passed(near, relative, decimated)[wanted[low:high] - begin]
    return found


def _passed(signal: FloatArray, relative: float, decimated: int) -> FloatArray:
    """The low-pass of a whole signal; `relative` is its cut-off in sampling rates."""
    n = len(signal)
    pad = min(n - 1, int(4.0 / (relative * decimated)))
    longer = _continued(signal, pad)
    # a straight line passes as it is; without it, the ends meet where the spectrum joins them
    whole = len(longer)
    slope = (longer[-1] - longer[0]) / (whole - 1)
    line = longer[0] + np.multiply.outer(np.arange(whole), slope)
    size = fast_length(whole)
    turns = np.tan(np.pi / decimated * np.fft.rfftfreq(size)[:-1]) / np.tan(np.pi * relative)
    gain = np.zeros(size // 2 + 1)  # none at Nyquist
    gain[:-1] = 1.0 / (1.0 + _eighth_power(turns))
    longer -= line
    spectrum = np.fft.rfft(longer, size, axis=0)
    spectrum *= gain.reshape(-1, *(1,) * (signal.ndim - 1))
    passed: FloatArray = np.fft.irfft(spectrum, size, axis=0)[pad : pad + n]
    passed += line[pad : pad + n]
    return passed


def _continued(signal: FloatArray, pad: int) -> FloatArray:
    """A signal with its point reflections before and behind, `pad` samples each."""
    before = 2.0 * signal[:1] - signal[pad:0:-1]
    after = 2.0 * signal[-1:] - signal[-2 : -pad - 2 : -1]
    return np.concatenate([before, signal, after])


@lru_cache(maxsize=256)
def fast_length(least: int) -> int:
    """The next even length of small factors only, which the Fourier transform is quick at."""
    odd: list[int] = [3**i * 5**j for i in range(8) for j in range(4)]
    return min(each << max(1, (-(-least // each) - 1).bit_length()) for each in odd)


def differentiate(signal: FloatArray, sample_time: float) -> FloatArray:
    """Central differences of fourth order: x' = (8 (x_1 - x_-1) - (x_2 - x_-2)) / (12 T).

    The relative error at the frequency w is (w T)^4 / 30; two samples at either end are of second
    order.

    `signal` (n_samples, ...).
    `sample_time` [s].

    Returns: (n_samples, ...).
    """
    slope = np.empty_like(signal)
    ends = min(len(signal), 4)  # of as many samples are the two at an end
    slope[:2] = np.gradient(signal[:ends], sample_time, axis=0)[:2]
    slope[-2:] = np.gradient(signal[-ends:], sample_time, axis=0)[-2:]
    for start in range(2, len(signal) - 2, _PIECE):
        stop = min(start + _PIECE, len(signal) - 2)
        near = signal[start + 1 : stop + 1] - signal[start - 1 : stop - 1]
        far = signal[start + 2 : stop + 2] - signal[start - 2 : stop - 2]
        slope[start:stop] = (8.0 * near - far) / (12.0 * sample_time)
    return slope


def noise_deviation(signal: FloatArray) -> float:
    """Standard deviation of the white noise on a smooth signal, from the top of its spectrum.

    A smooth motion leaves the upper part of the band to the noise; sixth differences suppress what
    is left of the motion there. White noise of variance s^2 has sixth differences of variance
    924 s^2 (the sum of the squared binomials).

    `signal` (n_samples,).
    """
    sixth = np.diff(signal, 6)
    return float(np.sqrt(np.mean(sixth**2) / 924.0)) if sixth.size else 0.0


def signal_band(angle: FloatArray, sample_time: float) -> float:
    """Frequency up to which an angle is above its own noise.

    The encoder's noise is white, whether from its counts or from electronics, and the motion's
    spectrum falls steeply: the band ends where the power density meets the floor that the highest
    octave shows.

    `angle` (n_samples,).
    `sample_time` [s].

    Returns: [Hz]: At most a fifth of the sampling rate; a filter above this adds noise, not signal.
    """
    rate = 1.0 / sample_time
    if len(angle) < _LEAST_SAMPLES:
        return 0.2 * rate
    segment = min(len(angle) // 4, max(256, round(2.0 * rate)))
    frequency, density = cross_spectral_densities(
        np.diff(angle)[:, None], sample_time, segment, trend="line"
    )
    power = density[:, 0, 0].real
    # of the difference's spectrum back to the angle's, without the leakage of its trend
    power = power[1:] / (2.0 * np.sin(np.pi * frequency[1:] * sample_time)) ** 2
    frequency = frequency[1:]
    floor = np.median(power[frequency >= 0.25 * rate])
    above = np.flatnonzero(power > _FLOOR_MARGIN * floor)
    if not above.size:
        return float(frequency[0])
    # the first gap of some width ends the band: lines of interference above do not extend it
    gap = max(2, len(frequency) // 200)
    ends = np.flatnonzero(np.diff(above) > gap)
    last = above[ends[0]] if ends.size else above[-1]
    return float(min(frequency[last], 0.2 * rate))


def lagged(
    signal: FloatArray, lags: Sequence[Lag], sample_time: float, *, held: bool = False
) -> FloatArray:
    """A signal after sensors' or drives' low-pass filters, one behind the other.

    First order: 1 / (1 + s/w); second order, Butterworth: 1 / (1 + sqrt(2) s/w + (s/w)^2), with
    w = 2 pi cutoff_hz. The whole cascade is solved exactly between the samples.

    `signal` (n_samples, ...).
    `lags`: Without any, the signal is returned as it is.
    `sample_time` [s].
    `held`: The signal is constant until the next sample; otherwise it runs straight to it.

    Returns: (n_samples, ...): Steady at the first sample: what comes before is taken as equal to
    it.
    """
    if not lags:
        return signal
    n = len(signal)
    response, size = _lag_response(tuple(lags), sample_time, held, n)
    spectrum = np.fft.rfft(signal - signal[:1], size, axis=0)
    spectrum *= response.reshape(-1, *(1,) * (signal.ndim - 1))
    return np.asarray(signal[:1] + np.fft.irfft(spectrum, size, axis=0)[:n])


@lru_cache(maxsize=32)
def _lag_response(
    lags: tuple[Lag, ...], sample_time: float, held: bool, n: int
) -> tuple[ComplexArray, int]:
    """Response of the cascade at the lines of a transform, and that one's length.

    So many zeros stand behind n samples that the answer has died away where the ends meet. A
    record's channels share it.
    """
    numerator, denominator = _discrete(lags, sample_time, held)
    slowest = float(np.abs(np.roots(denominator)).max())
    settled = int(np.ceil(np.log(np.finfo(float).eps) / np.log(max(slowest, 1e-3))))
    size = fast_length(n + settled)
    z = np.exp(-2j * np.pi * np.fft.rfftfreq(size))
    response = np.polyval(numerator[::-1], z) / np.polyval(denominator[::-1], z)
    return np.asarray(response, dtype=np.complex128), size


def unaliased(
    signal: FloatArray, lags: Sequence[Lag], sample_time: float, between: Between
) -> FloatArray:
    """A signal after low-pass filters, below the Nyquist frequency only.

    What `lagged` gives at the samples holds what lies above the Nyquist frequency too, folded
    down: a held voltage has a good deal there, an angle nothing. Where one is differentiated and
    compared with the other, that must not be. Straight lines between the samples of an angle
    would make it smaller by (w T)^2 / 12. So each line of the spectrum is multiplied by

        H(jw) R(jw),   R = 1 (smooth), sinc(w T / 2) exp(-jwT/2) (held), sinc(w T / 2)^2 (straight)

    `signal` (n_samples, ...).
    `sample_time` [s].
    `between`: How the signal runs from sample to sample: as its spectrum says, constant, or
        straight.

    Returns: (n_samples, ...): Steady at the first sample: what comes before is taken as equal to
    it.
    """
    if not lags and between == "smooth":
        return signal
    n = len(signal)
    pad = min(n - 1, max(_LEAST_SAMPLES, round(_memory(lags) / sample_time)))
    before, after = np.repeat(signal[:1], pad, axis=0), np.repeat(signal[-1:], pad, axis=0)
    if between == "smooth":
        after = 2.0 * after - signal[-2 : -pad - 2 : -1]
    longer = np.concatenate([before, signal, after])
    # of a straight line the answer is the line, later; without it the ends meet
    whole = len(longer)
    slope = (longer[-1] - longer[0]) / (whole - 1)
    line = longer[0] + np.multiply.outer(np.arange(whole), slope)
    size = fast_length(whole)
    response, late = _analog(tuple(lags), sample_time, between, size)
    longer = longer - line
    spectrum = np.fft.rfft(longer, size, axis=0)
    spectrum *= response.reshape(-1, *(1,) * (signal.ndim - 1))
    passed = np.fft.irfft(spectrum, size, axis=0)[pad : pad + n]
    passed += line[pad : pad + n]
    return np.asarray(passed - slope * (late / sample_time))


def _memory(lags: Sequence[Lag]) -> float:
    """After how long the slowest of low-pass filters has forgotten all but rounding [s]."""
    return max((_SETTLED / lag.cutoff_hz for lag in lags), default=0.0)


@lru_cache(maxsize=32)
def _analog(
    lags: tuple[Lag, ...], sample_time: float, between: Between, size: int
) -> tuple[ComplexArray, float]:
    """Response at the lines of a transform, and by how much a straight line comes later [s]."""
    f = np.fft.rfftfreq(size, sample_time)
    response = np.ones(len(f), dtype=np.complex128)
    late = 0.0
    for lag in lags:
        s = 1j * f / lag.cutoff_hz
        first = 1.0 if lag.order == 1 else np.sqrt(2.0)
        response /= 1.0 + first * s + (s**2 if lag.order == 2 else 0.0)
        late += first / (2.0 * np.pi * lag.cutoff_hz)
    if between == "held":
        response *= np.sinc(f * sample_time) * np.exp(-1j * np.pi * f * sample_time)
        late += 0.5 * sample_time
    elif between == "straight":
        response *= np.sinc(f * sample_time) ** 2
    return response, late


def _discrete(
    lags: tuple[Lag, ...], sample_time: float, held: bool
) -> tuple[FloatArray, FloatArray]:
    """Numerator and denominator in z, highest power first.

    One matrix exponential solves x' = A x + B u between two samples (Van Loan, IEEE Trans. AC 23,
    1978), with u constant or, by one more block, running straight from sample to sample.
    """
    denominator: FloatArray = np.ones(1)
    for lag in lags:
        w = 2.0 * np.pi * lag.cutoff_hz * sample_time
        section = [1.0 / w, 1.0] if lag.order == 1 else [1.0 / w**2, np.sqrt(2.0) / w, 1.0]
        denominator = np.asarray(np.polymul(denominator, section), dtype=np.float64)
    n = len(denominator) - 1
    whole = np.zeros((n + 2, n + 2))
    whole[0, :n] = -denominator[1:] / denominator[0]
    whole[np.arange(1, n), np.arange(n - 1)] = 1.0
    whole[0, n] = whole[n, n + 1] = 1.0
    top = exponential(whole)[:n]
    A, B, C, D = top[:, :n], top[:, n], np.zeros(n), 0.0
    C[-1] = 1.0 / denominator[0]
    if not held:
        D = float(C @ top[:, n + 1])
        B = B - top[:, n + 1] + A @ top[:, n + 1]
    poles = np.poly(A)
    return np.real(np.poly(A - np.outer(B, C)) + (D - 1.0) * poles), np.real(poles)


def band_pass(
    signal: FloatArray, low_hz: float, high_hz: float, sample_time: float, *, integrals: int = 0
) -> FloatArray:
    """Zero-phase band-pass, and with it integrals over time, which are drift without it.

    H = 1 / ((1 + (low/f)^8) (1 + (f/high)^8)) times (2 pi j f)^-integrals, without phase, applied
    to the spectrum of the signal continued at both ends by its own point reflection.

    `signal` (n_samples, ...).
    `low_hz, high_hz` [Hz].
    `sample_time` [s].
    `integrals`: How often the signal is integrated over time.

    Returns: (n_samples, ...): Within about 1.5 / low_hz seconds of either end it holds transients.
    """

    def response(f: FloatArray) -> ComplexArray:
        gain = (2j * np.pi * f) ** -integrals
        return np.asarray(
            gain / ((1.0 + _eighth_power(low_hz / f)) * (1.0 + _eighth_power(f / high_hz)))
        )

    return by_spectrum(signal, response, sample_time, 3.0 / low_hz)


def band_passes(
    signals: FloatArray,
    wanted: Sequence[tuple[int, int]],
    low_hz: float,
    high_hz: float,
    sample_time: float,
) -> FloatArray:
    """Several signals, integrals and derivatives of them, through one `band_pass`.

    `signals` (n_samples, n_signals).
    `wanted`: What is to come back: how often which signal is integrated; differentiated, if
        negative.
    `low_hz, high_hz` [Hz].
    `sample_time` [s].

    Returns: (n_samples, n_wanted).
    """
    f, spectrum, inner = _spectrum_of(signals, sample_time, 3.0 / low_hz)
    gain = 1.0 / ((1.0 + _eighth_power(low_hz / f)) * (1.0 + _eighth_power(f / high_hz)))
    found = np.empty((len(signals), len(wanted)))
    for column, (k, integrals) in enumerate(wanted):
        response = gain if integrals == 0 else gain * (2j * np.pi * f) ** -integrals
        found[:, column] = _back((response * spectrum[:, k])[:, None], inner, len(signals))[:, 0]
    return found


def _eighth_power(x: FloatArray) -> FloatArray:
    return np.asarray(np.square(np.square(np.square(x))))  # `**` takes logarithms


def by_spectrum(
    signal: FloatArray,
    response: Callable[[FloatArray], ComplexArray],
    sample_time: float,
    reach: float,
) -> FloatArray:
    """A filter given by its frequency response, on the signal continued by point reflection.

    `signal` (n_samples, ...).
    `response`: (n_frequencies,) [Hz], all positive -> (n_frequencies,), the same for every column,
        or (n_frequencies, n_out, n_in) from columns to columns. The mean does not pass.
    `sample_time` [s].
    `reach` [s]: How far the signal is continued at either end.

    Returns: (n_samples, ...).
    """
    f, spectrum, inner = _spectrum_of(signal, sample_time, reach)
    gain = response(f)
    if gain.ndim == 3:
        spectrum = np.einsum("foi,fi->fo", gain, spectrum)
    else:
        spectrum = spectrum * gain.reshape(-1, *(1,) * (signal.ndim - 1))
    return _back(spectrum, inner, len(signal))


def _spectrum_of(
    signal: FloatArray, sample_time: float, reach: float
) -> tuple[FloatArray, ComplexArray, tuple[int, int]]:
    """Frequencies [Hz], lines without the mean, and (samples before the first, in all)."""
    n = len(signal)
    pad = min(n - 1, int(reach / sample_time))
    longer = _continued(signal, pad)
    size = fast_length(len(longer) + pad)
    f: FloatArray = np.asarray(np.fft.rfftfreq(size, sample_time)[1:], dtype=np.float64)
    return f, np.asarray(np.fft.rfft(longer, size, axis=0)[1:]), (pad, size)


def _back(spectrum: ComplexArray, inner: tuple[int, int], n: int) -> FloatArray:
    """The n samples of a signal from its lines without the mean."""
    pad, size = inner
    whole = np.concatenate([np.zeros_like(spectrum[:1]), spectrum])
    passed: FloatArray = np.fft.irfft(whole, size, axis=0)[pad : pad + n]
    return passed
