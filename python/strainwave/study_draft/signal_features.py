"""What a column's numbers say: clocks, derivatives, levels, pseudo-random sequences."""

from __future__ import annotations

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Prbs

_UNEVEN = 10.0  # longest over usual step of a clock; a counter or an angle has others
_FEW = 5  # levels
_SAME = 1e-6  # of the range: levels closer are one
_JUMP = 0.3  # of the range, within one sample
_ALIKE = 0.98  # share of a sequence's samples that come again
_WHOLE = 0.02  # of a unit: how far from a whole number
_FLAT = 2e-3  # share of a record that a drive is at its limit, to be worth a word
_USUAL = 2e-3  # how far from counts that are sold: digits of the log, and of pi in its scale
_LINES = (100, 125, 200, 250, 256, 300, 360, 400, 500, 512, 600, 625, 720, 800, 900)  # a decade of
_MOST_LOOKED_AT = 200_000


def is_clock(values: FloatArray) -> bool:
    """Whether values increase as stamps do: always, in steps of about one size."""
    steps = np.diff(values)
    if len(steps) < 2 or steps.min() <= 0.0:
        return False
    return bool(steps.max() <= _UNEVEN * np.median(steps))


def time_unit(period: float) -> tuple[str, float] | None:
    """The unit in which a clock's period is one of a drive's, 20 us to 50 ms.

    Parameters
    ----------
    period : float
        In the unknown unit.

    Returns
    -------
    (str, float) or None
        Its name, and the seconds it has.
    """
    for unit, seconds in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if 1.9e-5 <= period * seconds <= 0.051:
            return unit, seconds
    return None


def relation(rate: FloatArray, value: FloatArray, time: FloatArray) -> tuple[float, float]:
    """How well one column is the derivative of another.

    The value's changes over short windows against the rate's integrals over the same.

    Parameters
    ----------
    rate, value, time : (n_samples,)

    Returns
    -------
    float
        Correlation; 1 is a derivative.
    float
        The value's change per integral of the rate: 1 in matching units.
    """
    width = max(4, len(time) // 400)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])
    change = value[width::width] - value[:-width:width][: len(value[width::width])]
    summed = integral[width::width] - integral[:-width:width][: len(integral[width::width])]
    return proportion(summed, change)


def proportion(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Correlation of two columns, and y per x; without a constant."""
    norms = float(np.linalg.norm(x) * np.linalg.norm(y))
    if not norms > 0.0:
        return 0.0, 0.0
    product = float(x @ y)
    return product / norms, product / float(x @ x)


def levels(values: FloatArray) -> FloatArray | None:
    """The few values that a column takes; None where it takes more."""
    span = float(np.ptp(values))
    if span == 0.0:
        return values[:1]
    rounded = np.unique(np.round((values[:_MOST_LOOKED_AT] - values.min()) / (_SAME * span)))
    if len(rounded) > 4 * _FEW:
        return None
    apart = np.concatenate([[True], np.diff(rounded) > 10.0])
    found = values.min() + rounded[apart] * _SAME * span
    return found if len(found) <= _FEW else None


def switches(values: FloatArray) -> int:
    """How often a column jumps, by much of its range."""
    span = float(np.ptp(values))
    return int(np.count_nonzero(np.abs(np.diff(values)) > _JUMP * span)) if span else 0


def sequence_of(values: FloatArray, period: float) -> Prbs | None:
    """The maximum-length sequence that a column of two levels is, if it is one.

    The longest run of such a sequence is its order in clocks, and it comes again after
    2**order - 1 clocks.

    Parameters
    ----------
    values : (n_samples,)
    period : float [s]
        Between samples.

    Returns
    -------
    Prbs or None
    """
    found = levels(values)
    if found is None or len(found) != 2:
        return None
    high = values > found.mean()
    edges = np.flatnonzero(np.diff(high))
    if len(edges) < 8:
        return None
    runs = np.diff(edges)
    clock = float(np.percentile(runs, 5))
    whole = np.diff([-1, *edges, len(high) - 1])  # the first and last run may be cut short
    for longest in (runs.max(), whole.max()):
        order = round(float(longest) / clock)
        if 2 <= order <= 24 and _repeats(high, order, clock):
            length = (2**order - 1) * clock
            periods = max(1, round(len(high) / length))
            size = float(f"{np.ptp(found) / 2:.6g}")
            return Prbs(order, float(f"{clock * period:.6g}"), periods, size)
    return None


def _repeats(high: BoolArray, order: int, clock: float) -> bool:
    """Whether a sequence comes again after its length; of one period, whether it is balanced."""
    length = round((2**order - 1) * clock)
    if length > len(high):
        return False
    if len(high) > 1.5 * length:
        return float(np.mean(high[length:] == high[:-length])) > _ALIKE
    more = max(int(high[:length].sum()), length - int(high[:length].sum()))
    return bool(abs(more - 2 ** (order - 1) * clock) < 0.5 * clock)


def quantum(values: FloatArray) -> float | None:
    """The step of which a column's changes are whole multiples, as an encoder's; None without."""
    steps = np.abs(np.diff(values[:_MOST_LOOKED_AT]))
    steps = steps[steps > 1e-9 * max(float(np.ptp(values)), 1e-300)]
    if len(steps) < 20:
        return None
    least = float(steps.min())
    small = steps[steps < 50.0 * least]
    if len(small) < 20:
        return None
    by_all = float(np.median(small / np.maximum(np.round(small / least), 1.0)))
    by_single = float(np.mean(small[small < 1.5 * least]))  # rounded to few digits, the surer
    for step in (by_all, by_single):
        away = np.abs(small / step - np.round(small / step))
        if away.max() < _WHOLE * 5:
            return _refined(values[:_MOST_LOOKED_AT] - values[0], step)
    return None


def _refined(values: FloatArray, step: float) -> float:
    """A step from ever longer ways, whose number of steps the shorter ones give.

    Each way is ten times as long as the one before, over which the step was known to a twentieth
    of a count; where a column's values stop being whole multiples, the last step stays.
    """
    reach = 50.0
    while True:
        near = values[(np.abs(values) < reach * step) & (values != 0.0)]
        if len(near) >= 20:
            whole = np.round(near / step)
            if np.abs(near / step - whole).max() > 0.3:
                return step
            step = float(near @ whole / (whole @ whole))
        if reach * step > np.abs(values).max():
            return step
        reach *= 10.0


def usual_counts(counts: float) -> int | None:
    """The number of counts per turn that encoders are sold with, nearest to one that was found.

    Powers of two, and once, twice or four times the usual numbers of lines.

    Parameters
    ----------
    counts : float
        Per turn, as a column's steps give it.

    Returns
    -------
    int or None
        None: nothing usual lies near.
    """
    lines = [n * 10**decade for n in _LINES for decade in range(5)]
    known = {2**bits for bits in range(5, 25)} | {m * n for n in lines for m in (1, 2, 4)}
    nearest = min(known, key=lambda each: abs(each - counts))
    return nearest if abs(counts / nearest - 1.0) < _USUAL else None


def runs_alike(values: FloatArray) -> bool:
    """Whether a column stays at its levels for one length of time, as a square wave does."""
    edges = np.flatnonzero(np.abs(np.diff(values)) > _JUMP * float(np.ptp(values)))
    runs = np.diff(edges)
    return len(runs) > 1 and bool(runs.max() < 1.5 * np.median(runs))


def flat_top(values: FloatArray) -> float | None:
    """The magnitude at which a column stays now and then, as a drive at its limit does."""
    top = float(np.abs(values).max())
    at_top = np.abs(values) > (1.0 - 1e-6) * top
    stays = at_top[1:] & at_top[:-1]
    return top if top > 0.0 and stays.mean() > _FLAT else None


def wraps(values: FloatArray, turn: float) -> bool:
    """Whether an angle jumps by a turn, as one that is only known within a turn does."""
    return bool(np.any(np.abs(np.abs(np.diff(values)) - turn) < 0.1 * turn))


def smooth_share(values: FloatArray, period: float, top_hz: float) -> float:
    """Part of a column's power that lies below a frequency; the mean left out."""
    spectrum = np.abs(np.fft.rfft(values - values.mean())) ** 2
    frequency = np.fft.rfftfreq(len(values), period)
    whole = float(spectrum.sum())
    return float(spectrum[frequency <= top_hz].sum()) / whole if whole > 0.0 else 1.0
