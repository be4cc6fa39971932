"""Excitation signals: PRBS, multisine, steps, chirp, smooth rigid motion.

Functions return one value per tick of the clock; the drive holds each value until the next tick.
Random signals take the generator as an argument.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain import BoolArray, ComplexArray, FloatArray, IntArray, Prbs
from strainwave.errors import InvalidInput

# Exponents of primitive polynomials by the length of the shift register: the positions that feed
# back in addition to the first.
_FEEDBACK: Mapping[int, tuple[int, ...]] = {
    **{2: (1,), 3: (2,), 4: (3,), 5: (3,), 6: (5,), 7: (6,), 8: (7, 6, 1), 9: (5,), 10: (7,)},
    **{11: (9,), 12: (11, 10, 4), 13: (12, 11, 8), 14: (13, 12, 2), 15: (14,), 16: (15, 13, 4)},
    **{17: (14,), 18: (11,), 19: (18, 17, 14), 20: (17,), 21: (19,), 22: (21,), 23: (18,)},
    **{24: (23, 22, 17), 25: (22,), 26: (25, 24, 20), 27: (26, 25, 22), 28: (25,), 29: (27,)},
    **{30: (29, 28, 7), 31: (28,), 32: (31, 30, 10)},
}
_N_CLIPPINGS = 300  # the crest factor has then converged to a few per cent
_CLIPPING_LEVEL = 0.85  # over the peak; a lower level converges faster to a higher crest factor
_LEAD_IN = 0.5  # [s] of a smooth motion


def prbs(sequence: Prbs) -> FloatArray:
    """Maximum-length binary sequence [V], repeated.

    A shift register of `order` bits runs through all its `2**order - 1` non-zero states. Over one
    period the autocorrelation is that of white noise, and the spectrum is flat up to the half-power
    point at about 0.44 / clock. Raises InvalidInput unless the order is 2 to 32.
    """
    if sequence.order not in _FEEDBACK:
        raise InvalidInput(
            f"a PRBS of order {sequence.order} is not available", remedy="choose 2 to 32"
        )
    bits = _maximum_length(sequence.order)
    return np.tile(sequence.amplitude * (2.0 * bits - 1.0), sequence.periods)


def _maximum_length(order: int) -> BoolArray:
    """Output of a shift register with all ones as initial state: (2**order - 1,).

    b[k + n] = b[k] xor b[k + t] xor ... for the feedback positions t. The square of a polynomial
    over bits has the same terms at twice the exponents, so the relation also holds for 2n and 2t,
    and so on. Each round therefore produces more bits at once. (SciPy has this sequence too, but
    importing it takes half a second.)
    """
    taps, period = _FEEDBACK[order], 2**order - 1
    bits = np.ones(order, dtype=bool)
    stride = 1
    while len(bits) < period:
        if 2 * stride * order <= len(bits):
            stride *= 2
        first, n = len(bits) - stride * order, stride * (order - max(taps))
        new = bits[first : first + n].copy()
        for tap in taps:
            new ^= bits[first + stride * tap :][:n]
        bits = np.concatenate([bits, new])
    return bits[:period]


def multisine(
    lines: FloatArray,
    *,
    period: float,
    clock: float,
    periods: int,
    peak: float,
    rng: np.random.Generator | None = None,
) -> FloatArray:
    """Sum of sines with a low crest factor at given lines (n_lines,), harmonics of 1/period.

        u(t) = c sum_k cos(2 pi l_k t / period - pi k (k - 1) / K)   (Schroeder 1970, flat spectrum)

    With `rng` the phases start at random. Then the peaks are clipped and the amplitudes of the
    lines restored, repeatedly (Van der Ouderaa, Schoukens, Renneboog 1988). `peak` [V] is the
    largest magnitude of the signal, `periods` the number of repetitions. Raises InvalidInput if the
    period [s] is not a multiple of the clock [s], or if a line is not below the Nyquist frequency.
    """
    n = round(period / clock)
    if n < 2 or abs(n * clock - period) > 1e-9 * period:
        raise InvalidInput(
            f"a period of {period:g} s is not a multiple of the clock of {clock:g} s",
            remedy="choose the period as a multiple of the clock",
        )
    lines = np.asarray(lines, dtype=float)
    if lines.size == 0 or lines.min() < 1 or lines.max() >= n / 2:
        raise InvalidInput(
            f"spectral lines must lie between 1 and {(n - 1) // 2}, got {lines.tolist()}",
            remedy="choose harmonics of the period below half the clock rate",
        )
    index = lines.astype(int)
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    if rng is None:
        k = np.arange(1, lines.size + 1)
        spectrum[index] = np.exp(-1j * np.pi * k * (k - 1) / lines.size)
    else:
        spectrum[index] = np.exp(2j * np.pi * rng.random(lines.size))
        spectrum = _with_low_crest(spectrum, index, n)
    wave = np.fft.irfft(spectrum, n)
    return np.tile(wave * (peak / np.abs(wave).max()), periods)


def _with_low_crest(spectrum: ComplexArray, index: IntArray, samples: int) -> ComplexArray:
    """Spectrum with the lowest peak among all iterations of clipping."""
    best, lowest = spectrum, np.inf
    for _ in range(_N_CLIPPINGS):
        wave = np.fft.irfft(spectrum, samples)
        top = float(np.abs(wave).max())
        if top < lowest:
            best, lowest = spectrum, top
        clipped = np.fft.rfft(np.clip(wave, -_CLIPPING_LEVEL * top, _CLIPPING_LEVEL * top))
        spectrum = np.zeros_like(spectrum)
        spectrum[index] = np.exp(1j * np.angle(clipped[index]))
    return best


def steps(levels: FloatArray, *, hold: float, clock: float) -> FloatArray:
    """Piecewise constant signal: each of the levels for `hold` seconds."""
    return np.repeat(np.asarray(levels, dtype=float), max(1, round(hold / clock)))


def chirp(
    *, start_hz: float, stop_hz: float, duration: float, clock: float, peak: float
) -> FloatArray:
    """Sine [V] whose frequency rises logarithmically from `start_hz` to `stop_hz`."""
    from scipy.signal import chirp as scipy_chirp

    time = clock * np.arange(round(duration / clock))
    value: FloatArray = peak * scipy_chirp(
        time, f0=start_hz, f1=stop_hz, t1=duration, method="logarithmic", phi=-90.0
    )
    return value


def smooth_motion(
    *,
    duration: float,
    clock: float,
    top_hz: float,
    excursion: float,
    speed: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Velocity reference [rad/s] of a rigid-motion record: a random Fourier series from standstill.

    Amplitudes fall with frequency, so that all harmonics contribute equally to the acceleration. A
    raised-cosine lead-in avoids a jump. The scale is the largest that satisfies `speed` [rad/s] and
    `excursion` [rad] of the integral. `top_hz` should be a small fraction of the lowest
    anti-resonance of the arm.
    """
    time = clock * np.arange(round(duration / clock))
    lines = np.arange(1, max(2, int(top_hz * duration)) + 1)
    phase = rng.uniform(0.0, 2.0 * np.pi, lines.size)
    amplitude = 1.0 / np.sqrt(lines)
    velocity = np.cos(2.0 * np.pi * np.outer(time / duration, lines) + phase) @ amplitude
    lead_in = 0.5 * (1.0 - np.cos(np.pi * np.clip(time / _LEAD_IN, 0.0, 1.0)))
    velocity *= lead_in
    velocity -= velocity.mean() * lead_in / lead_in.mean()  # returns to the start
    angle = np.cumsum(velocity) * clock
    scale = min(speed / np.abs(velocity).max(), excursion / np.abs(angle).max())
    return np.asarray(velocity * scale)
