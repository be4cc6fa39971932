"""Zero-phase filters, differentiation, and how far up a record's spectrum there is signal.

One linear filter applied to both sides of an equation leaves the equation true; a zero-phase one
leaves it true at the same instants. Everything here acts along the first axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from strainwave.records import ComplexArray, FloatArray, Lag

BUTTERWORTH_ORDER = 4
"""Of one pass; forward and backward the roll-off is that of order 8."""

_FLOOR_MARGIN = 4.0  # a Welch estimate of 8 averages stays below 4 times its mean
_LEAST_SAMPLES = 32


def low_pass(signal: FloatArray, cutoff_hz: float, sample_time: float) -> FloatArray:
    """Forward-backward Butterworth low-pass: no phase, squared magnitude of one pass.

    |H|^2 = 1 / (1 + (f / cutoff_hz)^(2 order)), so that H = 1/2 at the cut-off.

    Parameters
    ----------
    signal : (n_samples, ...)
    cutoff_hz : float [Hz]
        At or above 0.45 of the sampling rate the signal is returned as it is.
    sample_time : float [s]

    Returns
    -------
    (n_samples, ...)
        The first and last 1/cutoff_hz seconds hold the filter's transients.
    """
    if cutoff_hz * sample_time >= 0.45:
        return signal
    from scipy.signal import sosfiltfilt

    sections = _sections(2.0 * cutoff_hz * sample_time)
    pad = min(len(signal) - 1, int(3.0 / (cutoff_hz * sample_time)))
    filtered: FloatArray = sosfiltfilt(sections, signal, axis=0, padlen=pad)
    return filtered


@lru_cache(maxsize=64)
def _sections(relative_cutoff: float) -> FloatArray:
    from scipy.signal import butter

    sections: FloatArray = butter(BUTTERWORTH_ORDER, relative_cutoff, output="sos")
    return sections


def differentiate(signal: FloatArray, sample_time: float) -> FloatArray:
    """Central differences of fourth order: x' = (8 (x_1 - x_-1) - (x_2 - x_-2)) / (12 T).

    The relative error at the frequency w is (w T)^4 / 30; two samples at either end are of second
    order.

    Parameters
    ----------
    signal : (n_samples, ...)
    sample_time : float [s]

    Returns
    -------
    (n_samples, ...)
    """
    slope: FloatArray = np.gradient(signal, sample_time, axis=0)
    if len(signal) > 4:
        near = signal[3:-1] - signal[1:-3]
        far = signal[4:] - signal[:-4]
        slope[2:-2] = (8.0 * near - far) / (12.0 * sample_time)
    return slope


def noise_deviation(signal: FloatArray) -> float:
    """Standard deviation of the white noise on a smooth signal, from the top of its spectrum.

    A smooth motion leaves the upper part of the band to the noise; sixth differences suppress what
    is left of the motion there. White noise of variance s^2 has sixth differences of variance
    924 s^2 (the sum of the squared binomials).

    Parameters
    ----------
    signal : (n_samples,)

    Returns
    -------
    float
    """
    sixth = np.diff(signal, 6)
    return float(np.sqrt(np.mean(sixth**2) / 924.0)) if sixth.size else 0.0


def signal_band(angle: FloatArray, sample_time: float) -> float:
    """Frequency up to which an angle is above its own noise.

    The encoder's noise is white, whether from its counts or from electronics, and the motion's
    spectrum falls steeply: the band ends where the power density meets the floor that the highest
    octave shows.

    Parameters
    ----------
    angle : (n_samples,)
    sample_time : float [s]

    Returns
    -------
    float [Hz]
        At most a fifth of the sampling rate; a filter above this adds noise, not signal.
    """
    from scipy.signal import welch

    rate = 1.0 / sample_time
    if len(angle) < _LEAST_SAMPLES:
        return 0.2 * rate
    segment = min(len(angle) // 4, max(256, round(2.0 * rate)))
    frequency, power = welch(np.diff(angle), rate, nperseg=segment, detrend="linear")
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

    Parameters
    ----------
    signal : (n_samples, ...)
    lags : sequence of Lag
        Without any, the signal is returned as it is.
    sample_time : float [s]
    held : bool
        The signal is constant until the next sample; otherwise it runs straight to it.

    Returns
    -------
    (n_samples, ...)
        At rest at the first sample: what comes before is taken as equal to it.
    """
    if not lags:
        return signal
    from scipy.signal import lfilter, lfilter_zi

    numerator, denominator = _discrete(tuple(lags), sample_time, held)
    at_rest = lfilter_zi(numerator, denominator)
    at_rest = at_rest.reshape(-1, *(1,) * (signal.ndim - 1)) * signal[:1]
    passed, _ = lfilter(numerator, denominator, signal, axis=0, zi=at_rest)
    return np.asarray(passed)


@lru_cache(maxsize=64)
def _discrete(
    lags: tuple[Lag, ...], sample_time: float, held: bool
) -> tuple[FloatArray, FloatArray]:
    from scipy.signal import cont2discrete

    denominator = np.ones(1)
    for lag in lags:
        w = 2.0 * np.pi * lag.cutoff_hz
        section = [1.0 / w, 1.0] if lag.order == 1 else [1.0 / w**2, np.sqrt(2.0) / w, 1.0]
        denominator = np.polymul(denominator, section)
    # in samples, so that the coefficients are of like size
    scale = sample_time ** np.arange(len(denominator) - 1, -1, -1)
    system = (np.ones(1), denominator / scale)
    numerator, denominator, _ = cont2discrete(system, 1.0, method="zoh" if held else "foh")
    return np.ravel(numerator), np.asarray(denominator)


def band_pass(
    signal: FloatArray, low_hz: float, high_hz: float, sample_time: float, *, integrals: int = 0
) -> FloatArray:
    """Zero-phase band-pass, and with it integrals over time, which are drift without it.

    H = 1 / ((1 + (low/f)^8) (1 + (f/high)^8)) times (2 pi j f)^-integrals, without phase, applied
    to the spectrum of the signal continued at both ends by its own point reflection.

    Parameters
    ----------
    signal : (n_samples, ...)
    low_hz, high_hz : float [Hz]
    sample_time : float [s]
    integrals : int
        How often the signal is integrated over time.

    Returns
    -------
    (n_samples, ...)
        Within about 1.5 / low_hz seconds of either end it holds transients.
    """

    def response(f: FloatArray) -> ComplexArray:
        gain = (2j * np.pi * f) ** -integrals
        return np.asarray(gain / ((1.0 + (low_hz / f) ** 8) * (1.0 + (f / high_hz) ** 8)))

    return by_spectrum(signal, response, sample_time, 3.0 / low_hz)


def by_spectrum(
    signal: FloatArray,
    response: Callable[[FloatArray], ComplexArray],
    sample_time: float,
    reach: float,
) -> FloatArray:
    """A filter given by its frequency response, on the signal continued by point reflection.

    Parameters
    ----------
    signal : (n_samples, ...)
    response : callable
        (n_frequencies,) [Hz], all positive -> (n_frequencies,), the same for every column, or
        (n_frequencies, n_out, n_in) from columns to columns. The mean does not pass.
    sample_time : float [s]
    reach : float [s]
        How far the signal is continued at either end.

    Returns
    -------
    (n_samples, ...)
    """
    from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

    n = len(signal)
    pad = min(n - 1, int(reach / sample_time))
    before = 2.0 * signal[:1] - signal[pad:0:-1]
    after = 2.0 * signal[-1:] - signal[-2 : -pad - 2 : -1]
    longer = np.concatenate([before, signal, after])
    size = next_fast_len(len(longer) + pad)
    f = rfftfreq(size, sample_time)[1:]
    spectrum = rfft(longer, size, axis=0)[1:]
    gain = response(f)
    if gain.ndim == 3:
        spectrum = np.einsum("foi,fi->fo", gain, spectrum)
    else:
        spectrum = spectrum * gain.reshape(-1, *(1,) * (signal.ndim - 1))
    whole = np.concatenate([np.zeros_like(spectrum[:1]), spectrum])
    passed: FloatArray = irfft(whole, size, axis=0)[pad : pad + n]
    return passed
