"""Stamped columns -> one uniform clock.

A table's columns share their stamps: one track. A bag's topics have each their own: several tracks,
of which the first, the motor angle's, sets the clock, because it is differentiated most.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from strainwave.domain import Diagnostic, Experiment, FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.tables import first_impossible
from strainwave.numerics.filters import noise_deviation

FEWEST_ROWS = 16
"""Fewer samples cannot even be filtered."""
LARGEST_GAP = 10.0
"""[periods] What was between two samples further apart is beyond interpolation."""
JITTER_STD = 0.2
"""[periods] Standard deviation of stamps about a clock's ticks, up to which each belongs to one."""
MOST_JITTER = 0.4
"""[periods] Distance by which a track's ends may miss those of the grid."""
NEARLY = 1e-3
"""Relative distance of a clock's estimated period from a round number that is tried for it."""
NOMINAL = 0.02
"""Relative distance of the median step from the nominal period; random walks gave up to 1 %."""
_SAME_PERIOD = 4.0  # deviations of a period that stamps give
_SMOOTHER = float(np.log(2.0))  # noise over noise; interpolation alone takes up to 0.3 of it
ROUNDING = 0.02
"""[periods] Stamps this close to a uniform grid are one, written with few digits."""


@dataclass(frozen=True, slots=True)
class Track:
    """Columns that share their stamps."""

    name: str  # the topic; empty for a table
    time: FloatArray  # (n_samples,) [s]
    columns: Mapping[str, FloatArray]  # name -> (n_samples,)
    row_name: Callable[[int], str]  # number of a sample, from 0 -> where a person finds it


def one_clock(
    tracks: Sequence[Track], held: Collection[str], experiment: Experiment, path: Path
) -> tuple[FloatArray, dict[str, FloatArray], list[Diagnostic]]:
    """All columns at the same, uniform instants, within the experiment's window.

    Measured columns are interpolated by monotone cubics, which neither ring nor flatten; commanded
    ones are held, as the drive held them.

    Parameters
    ----------
    tracks : sequence of Track
        The first sets the clock.
    held : collection of str
        Columns that are commanded.
    experiment : Experiment
    path : Path
        For the messages.

    Returns
    -------
    (n_samples,) [s]
    dict of str to (n_samples,)
    list of Diagnostic

    Raises
    ------
    InvalidInput
        Stamps or values are at fault.
    """
    for track in tracks:
        _check_time(track, path)
    windowed = [_window(track, held, experiment, path) for track in tracks]
    warnings = []
    for track in windowed:
        if not set(track.columns) <= set(held):
            _check_gaps(track, path)
    windowed = _overlap(windowed, held, path)
    grid, ticks, found = _grid(windowed[0].time)
    if found:
        warnings.append(Diagnostic("resampled", path.name, found))
    columns: dict[str, FloatArray] = {}
    foreign = []
    for track in windowed:
        rows = _rows_on(grid, track.time)
        if rows is None:
            foreign.append(track)
            own = ticks if track is windowed[0] else None
            columns |= _resampled(grid, track, held, own)
        else:
            columns |= _cut(track, rows).columns
    others = [track for track in foreign if track is not windowed[0]]
    if others:
        warnings.append(_foreign_found(windowed[0], others, path))
        warnings += _silence_found(others, held, grid, path)
    return grid, columns, warnings


def _check_values(track: Track, inside: slice, path: Path) -> None:
    for name, values in track.columns.items():
        row = first_impossible(values[inside])
        if row is not None:
            row += inside.start
            raise InvalidInput(
                f"the value is {values[row]}",
                where=f"{path}, {track.row_name(row)}, column {name!r}",
                remedy="cut the log there, or set start and stop to leave it out",
            )


def _check_time(track: Track, path: Path) -> None:
    time = track.time
    row = first_impossible(time)
    if row is not None:
        raise InvalidInput(
            f"the time is {time[row]}",
            where=f"{path}, {track.row_name(row)}",
            remedy="cut the log there",
        )
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise InvalidInput(
            f"time does not increase: {time[row]:.9g} s after {time[row - 1]:.9g} s",
            where=f"{path}, {track.row_name(row)}",
            remedy="sort the log by time and leave out doubled rows",
        )


def _too_few(rows: int, path: Path, what: str) -> InvalidInput:
    return InvalidInput(
        f"{what} has {rows} row(s); at least {FEWEST_ROWS} are needed",
        where=str(path),
        remedy="record for longer, or widen start and stop",
    )


def _window(track: Track, held: Collection[str], experiment: Experiment, path: Path) -> Track:
    """What lies between start and stop; of a command, also what was set before."""
    of = f" of {track.name}" if track.name else ""
    commanded = set(track.columns) <= set(held)
    time = track.time
    if len(time) < FEWEST_ROWS and not commanded:
        raise _too_few(len(time), path, track.name or "the log")
    start = -np.inf if experiment.start is None else experiment.start
    stop = np.inf if experiment.stop is None else experiment.stop
    first, last = np.searchsorted(time, [start, stop + 1e-12 * abs(stop)])
    inside = slice(max(int(first) - 1, 0) if commanded else int(first), int(last))
    if len(time[inside]) == 0:
        raise InvalidInput(
            f"nothing{of} lies in the window {start:g} to {stop:g} s: the log runs from "
            f"{time[0]:g} to {time[-1]:g} s",
            where=str(path),
            remedy=f"mend start and stop of experiment {experiment.name!r}",
        )
    if len(time[inside]) < FEWEST_ROWS and not commanded:
        raise _too_few(len(time[inside]), path, f"the window{of}")
    _check_values(track, inside, path)
    return _cut(track, inside)


def _cut(track: Track, inside: slice) -> Track:
    columns = {name: values[inside] for name, values in track.columns.items()}
    return replace(track, time=track.time[inside], columns=columns)


def _check_gaps(track: Track, path: Path) -> None:
    time = track.time
    steps = np.diff(time)
    period = float(np.median(steps))
    widest = int(np.argmax(steps))
    if steps[widest] > LARGEST_GAP * period:
        of = f" in {track.name}" if track.name else ""
        raise InvalidInput(
            f"there is a gap{of} from {time[widest]:.6g} to {time[widest + 1]:.6g} s, "
            f"{steps[widest] / period:.0f} samples long",
            where=str(path),
            remedy="set start and stop to one side of it",
        )


def _overlap(tracks: list[Track], held: Collection[str], path: Path) -> list[Track]:
    """The clock's track, cut to where every track has something to say."""
    clock, *others = tracks
    if not others:
        return tracks
    tolerance = ROUNDING * float(np.median(np.diff(clock.time)))
    start = max(track.time[0] for track in others) - tolerance
    ends = [track.time[-1] for track in others if not set(track.columns) <= set(held)]
    stop = min([clock.time[-1], *ends]) + tolerance
    inside = slice(*(int(k) for k in np.searchsorted(clock.time, [start, stop])))
    if inside.stop - inside.start < FEWEST_ROWS:
        spans = ", ".join(f"{t.name} {t.time[0]:.6g} to {t.time[-1]:.6g} s" for t in tracks)
        raise InvalidInput(
            f"the topics do not overlap: {spans}",
            where=str(path),
            remedy="record them together, or mend the clocks that stamp them",
        )
    return [_cut(clock, inside), *others]


def _rows_on(grid: FloatArray, time: FloatArray) -> slice | None:
    """The rows whose stamps are the grid's; None: they are not."""
    tolerance = ROUNDING * float(grid[1] - grid[0])
    first = int(np.searchsorted(time, grid[0] - tolerance))
    rows = slice(first, first + len(grid))
    if len(time[rows]) < len(grid) or np.max(np.abs(time[rows] - grid)) > tolerance:
        return None
    return rows


def _grid(time: FloatArray) -> tuple[FloatArray, FloatArray | None, str]:
    """A uniform grid, each stamp's tick where it has one, and what to say of uneven stamps."""
    grid = np.linspace(time[0], time[-1], len(time))
    if _rows_on(grid, time) is not None:
        start, period = _regressed(time, np.arange(len(time), dtype=np.float64))
        fine = start + period * np.arange(len(time), dtype=np.float64)
        return (fine if _rows_on(fine, time) is not None else grid), None, ""
    ticks: FloatArray | None = None
    jitter = _jitter(time)
    if jitter is None:
        # interpolation at the stamps allows any period: the nominal one is a servo's or a drive's
        period = _round_period(float(np.median(np.diff(time))), NOMINAL)
        grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-9) + 1)
        how = f"resampled to {len(grid)} samples every {period:.6g} s"
    else:
        start, period, number, off = jitter
        grid = start + period * np.arange(number[-1] + 1.0)
        ticks = start + period * number
        how = (
            f"they lie up to {100.0 * off:.2g} % of a period beside a clock of {period:.6g} s: "
            f"resampled to its {len(grid)} ticks"
        )
    steps = np.diff(time) / period
    message = (
        f"time stamps are not uniform (steps of {steps.min():.2f} to {steps.max():.2f} "
        f"periods): {how}; what happens faster than the widest step is lost. Log with a fixed "
        "clock if you can"
    )
    return grid, ticks, message


def _jitter(time: FloatArray) -> tuple[float, float, FloatArray, float] | None:
    """The clock about which stamps jitter, where they do by less than half a period.

    Stamps are regressed on the whole numbers of periods between them.

    Returns
    -------
    start, period, (n_samples,) numbers of the ticks, largest distance in periods; or None
    """
    steps = np.diff(time)
    counted = float(np.sum(np.round(steps / np.median(steps))))  # rows may be missing
    for ticks in (len(steps), counted):
        start, period = float(time[0]), float(time[-1] - time[0]) / ticks
        for _ in range(3):
            number = np.round((time - start) / period)
            number -= number[0]
            if not np.any(number):
                break
            start, period = _regressed(time, number)
        off = (time - start - period * number) / period
        is_white = float(off[1:] @ off[:-1]) < 0.5 * float(off @ off)  # else the rate varies
        if np.std(off) < JITTER_STD and is_white and np.all(np.diff(number) >= 1.0):
            return start, period, number, float(np.max(np.abs(off)))
    return None


def _regressed(time: FloatArray, number: FloatArray) -> tuple[float, float]:
    """Start and period of the clock that stamps follow, by least squares.

    A period that is a round number within its own uncertainty is taken as that: drives, loggers and
    servos have clocks of round numbers, and a simulation needs a step that all are multiples of.
    """
    centred = number - number.mean()
    weight = float(centred @ centred)
    period = float(centred @ (time - time.mean())) / weight
    off = time - time.mean() - period * centred
    uncertain = float(np.sqrt(off @ off / (len(time) * weight)))
    near = _round_period(period, NEARLY)
    if abs(near - period) < _SAME_PERIOD * uncertain:
        period = near
    return float(np.mean(time - period * number)), period


def _round_period(period: float, tolerance: float) -> float:
    """The period of fewest digits, or of a rate of fewest digits, within a relative tolerance."""
    for digits in range(3):
        near = float(f"{period:.{digits}e}"), 1.0 / float(f"{1.0 / period:.{digits}e}")
        best = min(near, key=lambda each: abs(each / period - 1.0))
        if abs(best / period - 1.0) < tolerance:
            return best
    return period


def _resampled(
    grid: FloatArray, track: Track, held: Collection[str], ticks: FloatArray | None
) -> dict[str, FloatArray]:
    """A track's columns on a grid.

    Where stamps jitter about a clock, either the samples do too, and are interpolated, or only the
    stamps do, written by a busy computer, and the samples are the ticks': interpolation would then
    add what it is to take away. The column that one of the two makes smoother by most decides.
    """
    rates = {name: np.diff(v) / np.diff(track.time) for name, v in track.columns.items()}
    # the stamps are a column as well, and smooth by themselves
    measured = [n for n, r in rates.items() if n not in held and np.ptp(r) > 1e-6 * abs(r.mean())]
    found = {name: _at(grid, track, name, name in held) for name in track.columns}
    if ticks is None:
        return found
    punctual = replace(track, time=ticks)
    on_ticks = {name: _at(grid, punctual, name, name in held) for name in track.columns}
    smoother = 0.0
    for name in measured:
        noise = noise_deviation(found[name]), noise_deviation(on_ticks[name])
        if min(noise) > 0.0:
            gain = float(np.log(noise[0] / noise[1]))
            smoother = gain if abs(gain) > abs(smoother) else smoother
    commands = {name: on_ticks[name] for name in track.columns if name in held}
    return found | commands if smoother < -_SMOOTHER else on_ticks


def _at(grid: FloatArray, track: Track, name: str, held: bool) -> FloatArray:
    values = track.columns[name]
    if held:
        slack = 1e-6 * (grid[1] - grid[0])
        rows = np.searchsorted(track.time, grid + slack, side="right") - 1
        return np.asarray(values[np.maximum(rows, 0)])
    from scipy.interpolate import PchipInterpolator

    # the track's ends may miss the grid's by what its stamps jitter or are rounded
    slack = MOST_JITTER * (grid[1] - grid[0])
    inside = np.clip(grid, track.time[0] - slack, track.time[-1] + slack)
    return np.asarray(PchipInterpolator(track.time, values)(inside))


def _foreign_found(clock: Track, others: list[Track], path: Path) -> Diagnostic:
    def rate(track: Track) -> str:
        return f"{1.0 / np.median(np.diff(track.time)):.4g} Hz" if len(track.time) > 1 else "once"

    listed = ", ".join(dict.fromkeys(f"{track.name} ({rate(track)})" for track in others))
    message = (
        f"{listed}: brought to the stamps of {clock.name} ({rate(clock)}), measured values by "
        "monotone cubics, commands held; what a slower topic missed is lost. Publish all from one "
        "clock if you can"
    )
    return Diagnostic("resampled", path.name, message)


def _silence_found(
    tracks: list[Track], held: Collection[str], grid: FloatArray, path: Path
) -> list[Diagnostic]:
    """Commands that stop coming: held may be meant, or a node that died."""
    found = []
    for track in tracks:
        if not set(track.columns) <= set(held):
            continue
        ends = np.append(track.time, max(grid[-1], track.time[-1]))
        steps = np.diff(ends)
        usual = float(np.median(steps[:-1])) if len(steps) > 1 else float(grid[1] - grid[0])
        k = int(np.argmax(steps))
        if steps[k] > LARGEST_GAP * usual:
            message = (
                f"{track.name} sends nothing from {ends[k]:.6g} to {ends[k + 1]:.6g} s: its last "
                "value is held. Check that this is what the drive did"
            )
            found.append(Diagnostic("silent-command", path.name, message))
    return found
