"""Resample time-stamped columns to one uniform clock.

The columns of a table share their time stamps and form one track. Each topic of a bag has separate
time stamps; the first track, with the motor angle, sets the clock, because the motor angle is
differentiated most often.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from strainwave.domain import BoolArray, Clause, Diagnostic, Experiment, FloatArray, IntArray, Place
from strainwave.errors import InvalidInput
from strainwave.io.logs.tables import find_invalid_value
from strainwave.numerics.filters import noise_std

MIN_SAMPLES = 16
"""Minimum number of samples that the filters need."""
MAX_GAP_PERIODS = 10.0
"""[periods] Largest distance of two samples across which values are interpolated."""
MAX_JITTER_STD_PERIODS = 0.2
"""[periods] Largest standard deviation of stamps about the ticks of a clock."""
MAX_END_OFFSET_PERIODS = 0.4
"""[periods] Largest distance between the ends of a track and of the grid."""
MAX_PERIOD_ROUNDING = 1e-3
"""Largest relative distance of an estimated period from a round number that may replace it."""
MAX_NOMINAL_PERIOD_ERROR = 0.02
"""Largest relative distance of the median step from the nominal period; random walks: 1 %."""
_MAX_PERIOD_STDS = 4.0  # standard deviations of a period estimated from stamps
# log of a noise ratio; interpolation alone explains up to 0.3 of it
_MIN_LOG_NOISE_RATIO = float(np.log(2.0))
MAX_STAMP_ERROR_PERIODS = 0.02
"""[periods] Largest distance of rounded stamps from a uniform grid."""


@dataclass(frozen=True, slots=True)
class Track:
    """Columns that share their time stamps."""

    name: str  # the topic; empty for a table
    time: FloatArray  # (n_samples,) [s]
    columns: Mapping[str, FloatArray]  # name -> (n_samples,)
    row_name: Callable[[int], str]  # index of a sample, from 0 -> its location for messages
    commands: Collection[str] = ()  # columns that are constant between their ticks
    torques: Collection[str] = ()  # columns that may be commands
    covariates: Collection[str] = ()  # columns that are slow by nature

    @property
    def is_command(self) -> bool:
        """Whether all columns are commands."""
        return set(self.columns) <= set(self.commands)


def resample_tracks(
    tracks: Sequence[Track], experiment: Experiment, path: Path
) -> tuple[FloatArray, dict[str, FloatArray], list[Diagnostic]]:
    """Resample all columns to one uniform time base within the experiment's window.

    The first track sets the clock. Measured columns are interpolated by monotone cubics, which
    neither overshoot nor flatten; commands are held constant between samples. Returns time
    (n_samples,) [s], columns (n_samples,) and warnings. Raises InvalidInput if time stamps or
    values are invalid.
    """
    windowed = _overlap([_window(track, experiment, path) for track in tracks], path)
    grid, ticks, warnings = _grid(windowed[0].time, Place(file=path.name))
    columns: dict[str, FloatArray] = {}
    others = []  # tracks off the grid that do not set it
    for track in windowed:
        rows = _rows_on(grid, track.time)
        if rows is not None:
            columns |= cut(track, rows).columns
        elif track is windowed[0]:
            columns |= _resample(grid, track, ticks)
        else:
            others.append(track)
            columns |= _sample_at(grid, track)
    if others:
        warnings.append(_resampling_warning(windowed[0], others, path))
        warnings += _silence_warnings(others, grid, path)
    return grid, columns, warnings


def _check_values(track: Track, path: Path) -> None:
    for name, values in track.columns.items():
        row = find_invalid_value(values)
        if row is not None:
            if np.isnan(values).all():
                raise InvalidInput(
                    f"the column {name!r} has no values",
                    where=str(path),
                    remedy="remove its channel from [channels], or rename the column",
                )
            raise InvalidInput(
                f"the value is {values[row]}",
                where=f"{path}, {track.row_name(row)}, column {name!r}",
                remedy="truncate the log there, or exclude the sample with start and stop",
            )


def check_time(track: Track, path: Path) -> None:
    """Raise InvalidInput unless all time stamps are finite numbers."""
    time = track.time
    row = find_invalid_value(time)
    if row is not None:
        raise InvalidInput(
            f"the time is {time[row]}",
            where=f"{path}, {track.row_name(row)}",
            remedy="truncate the log there",
        )


def _window(track: Track, experiment: Experiment, path: Path) -> Track:
    """Return the samples between start and stop; for a command, also the last before start."""
    of = f" of {track.name}" if track.name else ""
    time = track.time
    start, stop = window_of(experiment)
    inside = cut_between(track, start, stop)
    if len(time) and not len(inside.time):
        raise InvalidInput(
            f"no sample{of} is in the window from {start:g} to {stop:g} s: the log extends from "
            f"{time[0]:g} to {time[-1]:g} s",
            where=str(path),
            remedy=f"correct start and stop of experiment {experiment.name!r}",
        )
    if len(inside.time) < MIN_SAMPLES and not track.is_command:
        source = f"the window{of}" if len(time) >= MIN_SAMPLES else track.name or "the log"
        raise InvalidInput(
            f"{source} has {len(inside.time)} row(s); at least {MIN_SAMPLES} are required",
            where=str(path),
            remedy="record a longer experiment, or widen start and stop",
        )
    _check_values(inside, path)
    return inside


def window_of(experiment: Experiment) -> tuple[float, float]:
    """Start and stop of an experiment [s]; infinite if not given."""
    start = -np.inf if experiment.start is None else experiment.start
    return start, np.inf if experiment.stop is None else experiment.stop


def cut_between(track: Track, start: float, stop: float) -> Track:
    """Samples from start to stop; of a command also the last one before."""
    first = int(np.searchsorted(track.time, start))
    if track.is_command:
        first = max(first - 1, 0)
    last = np.searchsorted(track.time, stop + 1e-12 * abs(stop), side="right")
    return cut(track, slice(first, int(last)))


def cut(track: Track, rows: slice | BoolArray) -> Track:
    """Some rows of a track."""
    columns = {name: values[rows] for name, values in track.columns.items()}
    index, row_name = np.arange(len(track.time))[rows], track.row_name
    return replace(
        track, time=track.time[rows], columns=columns, row_name=lambda k: row_name(int(index[k]))
    )


def find_gaps(time: FloatArray) -> IntArray:
    """Indices of the samples before a pause, across which values are not interpolated."""
    steps = np.diff(time)
    return np.flatnonzero(steps > MAX_GAP_PERIODS * float(np.median(steps)))


def _overlap(tracks: list[Track], path: Path) -> list[Track]:
    """Cut the first track to the time span that all tracks cover."""
    clock, *others = tracks
    if not others:
        return tracks
    tolerance = MAX_STAMP_ERROR_PERIODS * float(np.median(np.diff(clock.time)))
    start = max(track.time[0] for track in others) - tolerance
    ends = [track.time[-1] for track in others if not track.is_command]
    stop = min([clock.time[-1], *ends]) + tolerance
    inside = slice(*(int(k) for k in np.searchsorted(clock.time, [start, stop])))
    if inside.stop - inside.start < MIN_SAMPLES:
        spans = ", ".join(f"{t.name} {t.time[0]:.6g} to {t.time[-1]:.6g} s" for t in tracks)
        raise InvalidInput(
            f"the topics do not overlap: {spans}",
            where=str(path),
            remedy="record the topics together, or synchronise the clocks of their publishers",
        )
    return [cut(clock, inside), *others]


def _rows_on(grid: FloatArray, time: FloatArray) -> slice | None:
    """Return the rows whose time stamps coincide with the grid, or None."""
    tolerance = MAX_STAMP_ERROR_PERIODS * float(grid[1] - grid[0])
    first = int(np.searchsorted(time, grid[0] - tolerance))
    rows = slice(first, first + len(grid))
    if len(time[rows]) < len(grid) or np.max(np.abs(time[rows] - grid)) > tolerance:
        return None
    return rows


def _grid(time: FloatArray, place: Place) -> tuple[FloatArray, FloatArray | None, list[Diagnostic]]:
    """Return a uniform grid, the tick of each stamp if available, and warnings of uneven stamps."""
    grid = np.linspace(time[0], time[-1], len(time))
    if _rows_on(grid, time) is not None:
        start, period = _fit_clock(time, np.arange(len(time), dtype=np.float64))
        regressed_grid = start + period * np.arange(len(time), dtype=np.float64)
        return (regressed_grid if _rows_on(regressed_grid, time) is not None else grid), None, []
    ticks: FloatArray | None = None
    jitter = _estimate_jittered_clock(time)
    if jitter is None:
        # interpolation allows any period; use the nominal period of the servo or drive
        period = _round_period(float(np.median(np.diff(time))), MAX_NOMINAL_PERIOD_ERROR)
        grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-9) + 1)
        variant, share = "grid", 0.0
    else:
        start, period, number, offset = jitter
        grid = start + period * np.arange(number[-1] + 1.0)
        ticks = start + period * number
        variant, share = "ticks", offset
    steps = np.diff(time) / period
    warning = Diagnostic(
        "resampled",
        place,
        variant,
        shortest=float(steps.min()),
        longest=float(steps.max()),
        n_samples=len(grid),
        period=float(period),
        offset=float(share),
    )
    return grid, ticks, [warning]


def _estimate_jittered_clock(time: FloatArray) -> tuple[float, float, FloatArray, float] | None:
    """Estimate the clock about which stamps jitter by less than half a period.

    Regresses the stamps on integer numbers of periods. Returns start, period, tick numbers
    (n_samples,) and the largest distance in periods, or None if there is no such clock.
    """
    steps = np.diff(time)
    counted_ticks = float(np.sum(np.round(steps / np.median(steps))))  # rows may be missing
    for ticks in (len(steps), counted_ticks):
        start, period = float(time[0]), float(time[-1] - time[0]) / ticks
        for _ in range(3):
            number = np.round((time - start) / period)
            number -= number[0]
            if not np.any(number):
                break
            start, period = _fit_clock(time, number)
        offsets = (time - start - period * number) / period
        # otherwise the rate varies
        is_white = float(offsets[1:] @ offsets[:-1]) < 0.5 * float(offsets @ offsets)
        if np.std(offsets) < MAX_JITTER_STD_PERIODS and is_white and np.all(np.diff(number) >= 1.0):
            return start, period, number, float(np.max(np.abs(offsets)))
    return None


def _fit_clock(time: FloatArray, number: FloatArray) -> tuple[float, float]:
    """Estimate start and period of a clock from its stamps by least squares.

    The period is rounded to a round number within its uncertainty: drives, loggers and servos use
    round clock periods, and a simulation needs a time step of which all periods are multiples.
    """
    centred = number - number.mean()
    weight = float(centred @ centred)
    period = float(centred @ (time - time.mean())) / weight
    residuals = time - time.mean() - period * centred
    period_std = float(np.sqrt(residuals @ residuals / (len(time) * weight)))
    rounded = _round_period(period, MAX_PERIOD_ROUNDING)
    if abs(rounded - period) < _MAX_PERIOD_STDS * period_std:
        period = rounded
    return float(np.mean(time - period * number)), period


def _round_period(period: float, tolerance: float) -> float:
    """Round a period within a relative tolerance.

    Returns the period or rate with the fewest digits, or the period itself if none is near.
    """
    for digits in range(3):
        candidates = float(f"{period:.{digits}e}"), 1.0 / float(f"{1.0 / period:.{digits}e}")
        best = min(candidates, key=lambda each: abs(each / period - 1.0))
        if abs(best / period - 1.0) < tolerance:
            return best
    return period


def _resample(grid: FloatArray, track: Track, ticks: FloatArray | None) -> dict[str, FloatArray]:
    """Resample the columns of the track that sets the clock to its grid.

    Jittering stamps have two causes. If the samples jitter too, they are interpolated. If only the
    stamps jitter, because a busy computer wrote them, the samples belong to the ticks, and
    interpolation would add noise. The column with the largest noise ratio decides.
    """
    interpolated = _sample_at(grid, track)
    if ticks is None:
        return interpolated
    on_ticks = _sample_at(grid, replace(track, time=ticks))
    max_gain = 0.0
    for name, values in track.columns.items():
        rate = np.diff(values) / np.diff(track.time)
        # a column of stamps is smooth by itself and is excluded
        if name in track.commands or np.ptp(rate) <= 1e-6 * abs(rate.mean()):
            continue
        noise = noise_std(interpolated[name]), noise_std(on_ticks[name])
        if min(noise) > 0.0:
            gain = float(np.log(noise[0] / noise[1]))
            max_gain = gain if abs(gain) > abs(max_gain) else max_gain
    commands = {name: on_ticks[name] for name in track.columns if name in track.commands}
    return interpolated | commands if max_gain < -_MIN_LOG_NOISE_RATIO else on_ticks


def _sample_at(grid: FloatArray, track: Track) -> dict[str, FloatArray]:
    """Columns of a track on a grid: commands held, measured values interpolated."""
    from scipy.interpolate import PchipInterpolator

    period = grid[1] - grid[0]
    rows = np.searchsorted(track.time, grid + 1e-6 * period, side="right") - 1
    # jitter or rounding of stamps can move the track's ends off the grid's
    slack = MAX_END_OFFSET_PERIODS * period
    inside = np.clip(grid, track.time[0] - slack, track.time[-1] + slack)
    return {
        name: values[np.maximum(rows, 0)]
        if name in track.commands
        else np.asarray(PchipInterpolator(track.time, values)(inside))
        for name, values in track.columns.items()
    }


def _resampling_warning(clock: Track, others: list[Track], path: Path) -> Diagnostic:
    def topic(track: Track) -> Clause:
        if len(track.time) < 2:
            return Clause("topic/once", name=track.name)
        rate = 1.0 / float(np.median(np.diff(track.time)))
        return Clause("topic", name=track.name, rate_hz=rate)

    topics = tuple(dict.fromkeys(map(topic, others)))
    place = Place(file=path.name)
    return Diagnostic("resampled", place, "topics", topics=topics, clock=topic(clock))


def _silence_warnings(tracks: list[Track], grid: FloatArray, path: Path) -> list[Diagnostic]:
    """Warn of commands that stop: the value may be held on purpose, or a node failed."""
    warnings = []
    for track in tracks:
        if not track.is_command:
            continue
        ends = np.append(track.time, max(grid[-1], track.time[-1]))
        steps = np.diff(ends)
        usual_step = float(np.median(steps[:-1])) if len(steps) > 1 else float(grid[1] - grid[0])
        k = int(np.argmax(steps))
        if steps[k] > MAX_GAP_PERIODS * usual_step:
            start, stop = float(ends[k]), float(ends[k + 1])
            place = Place(file=path.name)
            warnings.append(
                Diagnostic("silent-command", place, topic=track.name, start=start, stop=stop)
            )
    return warnings
