"""Signals that identify an arm: PRBS, multisine, steps, chirp, smooth rigid motion.

Every function returns the values at the clock's ticks, one a row; the drive holds each until the
next tick. Randomness is an argument.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain import BoolArray, ComplexArray, FloatArray, IntArray, Prbs
from strainwave.errors import InvalidInput

# Places of a shift register that feed back beside its first, by its length: exponents of primitive
# polynomials.
_FEEDBACK: Mapping[int, tuple[int, ...]] = {
    **{2: (1,), 3: (2,), 4: (3,), 5: (3,), 6: (5,), 7: (6,), 8: (7, 6, 1), 9: (5,), 10: (7,)},
    **{11: (9,), 12: (11, 10, 4), 13: (12, 11, 8), 14: (13, 12, 2), 15: (14,), 16: (15, 13, 4)},
    **{17: (14,), 18: (11,), 19: (18, 17, 14), 20: (17,), 21: (19,), 22: (21,), 23: (18,)},
    **{24: (23, 22, 17), 25: (22,), 26: (25, 24, 20), 27: (26, 25, 22), 28: (25,), 29: (27,)},
    **{30: (29, 28, 7), 31: (28,), 32: (31, 30, 10)},
}
_CLIPPINGS = 300  # the crest has then settled within a few per cent
_CLIPPED_AT = 0.85  # of the peak; lower is faster at first and worse in the end


def prbs(sequence: Prbs) -> FloatArray:
    """Maximum-length binary sequence, repeated.

    A shift register of `order` bits runs through all its `2**order - 1` states but zero, so the
    autocorrelation is that of white noise over one period and the spectrum is flat up to about
    0.44 / clock (its half-power point).

    `sequence`: Order, clock [s], number of periods and amplitude [V]. Returns [V]: Values
    +-amplitude, one per clock. Raises `InvalidInput`: The order is not one that has a tabulated
    feedback polynomial (2 to 32).
    """
    if sequence.order not in _FEEDBACK:
        raise InvalidInput(
            f"a PRBS of order {sequence.order} is not available", remedy="choose 2 to 32"
        )
    bits = _maximum_length(sequence.order)
    return np.tile(sequence.amplitude * (2.0 * bits - 1.0), sequence.periods)


def _maximum_length(order: int) -> BoolArray:
    """What a shift register that begins full of ones gives out, (2**order - 1,).

    b[k + n] = b[k] xor b[k + t] xor ... for the places t that feed back. Squared, a polynomial over
    bits keeps its terms at twice their exponents: the same holds for 2n and 2t, and so on, so that
    each round makes more bits at once. (SciPy has this sequence too, but half a second is needed to
    import it.)
    """
    places, period = _FEEDBACK[order], 2**order - 1
    bits = np.ones(order, dtype=bool)
    apart = 1
    while len(bits) < period:
        if 2 * apart * order <= len(bits):
            apart *= 2
        first, n = len(bits) - apart * order, apart * (order - max(places))
        new = bits[first : first + n].copy()
        for place in places:
            new ^= bits[first + apart * place :][:n]
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
    """Sum of sines at chosen spectral lines with phases that keep the peaks low.

    u(t) = c sum_k cos(2 pi l_k t / period - pi k (k - 1) / K)   (Schroeder 1970, flat spectrum)

    With `rng` the phases are random, then swapped: what sticks out is clipped and the lines are
    given back their size, over and over (Van der Ouderaa, Schoukens, Renneboog 1988).

    `lines` (n_lines,): Harmonics of 1/period that are excited. `period`, `clock` [s]: Length of a
    period, and of a tick; their ratio must be a whole number. `periods`: Repetitions. `peak` [V]:
    Largest magnitude of the result. `rng`: Schroeder's phases without. Returns [V]. Raises
    `InvalidInput`: The period is no whole number of clocks, or a line lies at or above the clock's
    Nyquist frequency.
    """
    n = round(period / clock)
    if n < 2 or abs(n * clock - period) > 1e-9 * period:
        raise InvalidInput(
            f"a period of {period:g} s is no whole number of clocks of {clock:g} s",
            remedy="choose the period as a multiple of the clock",
        )
    lines = np.asarray(lines, dtype=float)
    if lines.size == 0 or lines.min() < 1 or lines.max() >= n / 2:
        raise InvalidInput(
            f"spectral lines must lie between 1 and {(n - 1) // 2}, got {lines.tolist()}",
            remedy="choose harmonics of the period below half the clock rate",
        )
    at = lines.astype(int)
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    if rng is None:
        k = np.arange(1, lines.size + 1)
        spectrum[at] = np.exp(-1j * np.pi * k * (k - 1) / lines.size)
    else:
        spectrum[at] = np.exp(2j * np.pi * rng.random(lines.size))
        spectrum = _with_low_peaks(spectrum, at, n)
    one = np.fft.irfft(spectrum, n)
    return np.tile(one * (peak / np.abs(one).max()), periods)


def _with_low_peaks(spectrum: ComplexArray, at: IntArray, samples: int) -> ComplexArray:
    """The phases, of all that the clipping goes through, whose peak is lowest."""
    best, lowest = spectrum, np.inf
    for _ in range(_CLIPPINGS):
        wave = np.fft.irfft(spectrum, samples)
        top = float(np.abs(wave).max())
        if top < lowest:
            best, lowest = spectrum, top
        clipped = np.fft.rfft(np.clip(wave, -_CLIPPED_AT * top, _CLIPPED_AT * top))
        spectrum = np.zeros_like(spectrum)
        spectrum[at] = np.exp(1j * np.angle(clipped[at]))
    return best


def steps(levels: FloatArray, *, hold: float, clock: float) -> FloatArray:
    """Piecewise constant reference: each level for `hold` seconds.

    `levels` (n_levels,). `hold`, `clock` [s]. Returns (n_levels * round(hold / clock).
    """
    return np.repeat(np.asarray(levels, dtype=float), max(1, round(hold / clock)))


def chirp(
    *, start_hz: float, stop_hz: float, duration: float, clock: float, peak: float
) -> FloatArray:
    """Sine whose frequency rises logarithmically from `start_hz` to `stop_hz`.

    `start_hz`, `stop_hz` [Hz]. `duration`, `clock` [s]. `peak` [V]. Returns [V].
    """
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
    """Velocity reference of a rigid-motion record: a random Fourier series from standstill.

    Amplitudes fall with frequency so that accelerations of all harmonics matter alike, phases are
    random; a raised-cosine lead-in of half a second avoids a jump. Scaled to whichever of the two
    limits is met first.

    `duration`, `clock` [s]. `top_hz` [Hz]: Highest frequency; keep it a few times below the arm's
    lowest anti-resonance. `excursion` [rad]: Largest magnitude of the integral of the result.
    `speed` [rad/s]: Largest magnitude of the result. Returns [rad/s].
    """
    time = clock * np.arange(round(duration / clock))
    lines = np.arange(1, max(2, int(top_hz * duration)) + 1)
    phase = rng.uniform(0.0, 2.0 * np.pi, lines.size)
    amplitude = 1.0 / np.sqrt(lines)
    velocity = np.cos(2.0 * np.pi * np.outer(time / duration, lines) + phase) @ amplitude
    lead_in = 0.5 * (1.0 - np.cos(np.pi * np.clip(time / 0.5, 0.0, 1.0)))
    velocity *= lead_in
    velocity -= velocity.mean() * lead_in / lead_in.mean()  # comes back to where it started
    angle = np.cumsum(velocity) * clock
    scale = min(speed / np.abs(velocity).max(), excursion / np.abs(angle).max())
    result: FloatArray = velocity * scale
    return result
