"""Time stamps of a table in seconds.

A time column may be a counter that overflows, a time of day that begins again at midnight, or be
split into two columns. Stamps may repeat or step back.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from strainwave.domain import Channel, Diagnostic, FloatArray, Place
from strainwave.errors import InvalidInput
from strainwave.io.logs.clocks import MAX_GAP_PERIODS, Track, cut
from strainwave.io.logs.tables import Clock

_DAY = 86400.0  # [s]
# values at which counters begin again: 8 to 32 bits, also of us or ms written in s; midnight in s,
# ms
_MODULI = (
    *(2.0**8, 2.0**16, _DAY, 2.0**24, 1e3 * _DAY, 2.0**32),
    *(2.0**32 * 1e-6, 2.0**32 * 1e-3),
)
_FRACTIONS = (1.0, 1e-3, 1e-6, 1e-9)  # [s] units of the fractions of a second
_RESTART_PAUSE_PERIODS = 1000.0  # [periods] pause in place of a step back, also of a slow bus
# maximum share of rows that repeat a stamp; more: the stamps are coarser than the sampling period
_MAX_REPEATED_SHARE = 0.05


def time_of(
    columns: Mapping[str, FloatArray], clocks: Mapping[str, Clock], channel: Channel
) -> FloatArray:
    """Time stamps [s] of a table, (n_samples,).

    The second column of a channel is added: fractions of a second, in the unit in which all are
    below one second, or the time of day of a date. Text and two columns count from the first row.
    Overflows are removed.
    """
    values = columns[channel.column]
    kinds = {clocks.get(name) for name in channel.columns}
    if channel.second_column is not None:
        second, unit = columns[channel.second_column], 1.0
        if not kinds & {"time", "date"}:
            largest = float(np.max(second, initial=0.0))
            unit = next((each for each in _FRACTIONS if largest * each < 1.0), _FRACTIONS[-1])
        values = (values - values[0]) + unit * (second - second[0])
    elif kinds != {None}:
        values = values - values[0]
    return channel.scale * _without_overflows(values) + channel.offset


def _without_overflows(values: FloatArray) -> FloatArray:
    """Remove the steps back of a counter at its overflow, or of a clock at midnight."""
    steps = np.diff(values)
    back = steps < 0.0
    if not back.any() or back.all():
        return values
    period = float(np.median(steps[~back]))
    for modulus in _MODULI:
        wraps = back & (steps + modulus > 0.0) & (steps + modulus <= MAX_GAP_PERIODS * period)
        if wraps.any() and np.ptp(values) < modulus:
            return np.asarray(values + modulus * np.concatenate([[0.0], np.cumsum(wraps)]))
    return values


def drop_repeats(track: Track, path: Path) -> tuple[Track, list[Diagnostic]]:
    """Drop rows that repeat the time stamp of the row before.

    Raises InvalidInput if so many different rows share their stamps that the stamps are too coarse.
    """
    steps = np.diff(track.time)
    repeated = np.flatnonzero(steps == 0.0) + 1
    if not len(repeated):
        return track, []
    differ = np.zeros(len(repeated), dtype=bool)
    for values in track.columns.values():
        differ |= values[repeated] != values[repeated - 1]
    if np.count_nonzero(differ) > _MAX_REPEATED_SHARE * len(track.time):
        raise InvalidInput(
            f"{np.count_nonzero(differ)} of {len(track.time)} rows repeat the time stamp of the row"
            " before: the stamps are coarser than the sampling period",
            where=f"{path}, {track.row_name(int(repeated[differ][0]))}",
            remedy="log finer stamps; or give sample_rate [Hz] in [channels] instead of t",
        )
    keep = np.ones(len(track.time), dtype=bool)
    keep[repeated] = False
    warning = Diagnostic("repeated-stamps", Place(file=path.name), count=len(repeated))
    return cut(track, keep), [warning]


def continue_time(time: FloatArray) -> FloatArray:
    """Time that continues after a pause where the stamps step back."""
    steps = np.diff(time)
    back = steps < 0.0
    if not back.any():
        return time
    forward = steps[~back]
    pause = _RESTART_PAUSE_PERIODS * float(np.median(forward)) if len(forward) else 1.0
    shifts = np.cumsum(np.where(back, pause - steps, 0.0))
    return np.asarray(time + np.concatenate([[0.0], shifts]))
