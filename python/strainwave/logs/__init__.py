"""Log files -> Log: the study's channels on a uniform time base, in SI units."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from strainwave.cores import side_by_side
from strainwave.errors import InvalidInput
from strainwave.logs.tables import Table, first_impossible, open_table, write_table
from strainwave.records import Caution, Channel, Experiment, FloatArray, Log, Study, channel_names

__all__ = ["read_log", "read_logs", "write_log"]

write_log = write_table

FEWEST_ROWS = 16
"""Fewer samples cannot even be filtered."""
LARGEST_GAP = 10.0
"""[periods] What was between two samples further apart cannot be told by interpolation."""
ROUNDING = 0.02
"""[periods] Stamps this close to a uniform grid are one, written with few digits."""
_HELD = ("u", "ref")  # commanded by a clock, constant between its ticks
_SENSORS = ("omega_m", "a", "theta_l", "deflection", "gyro")  # a dead one is constant


def read_logs(study: Study, experiments: Sequence[Experiment] | None = None) -> tuple[Log, ...]:
    """The logs of several experiments, of all by default.

    Parameters
    ----------
    study : Study
    experiments : sequence of Experiment, optional

    Returns
    -------
    tuple of Log

    Raises
    ------
    InvalidInput
        A log is at fault.
    """
    chosen = study.experiments if experiments is None else experiments
    return tuple(side_by_side([partial(read_log, study, each) for each in chosen]))


def read_log(study: Study, experiment: Experiment) -> Log:
    """One experiment's log: columns to channels, window, uniform time.

    A channel's value is scale * column + offset; a column that `add` names is taken in the
    channel's own unit: value = scale * (column + added) + offset.

    Parameters
    ----------
    study : Study
    experiment : Experiment

    Returns
    -------
    Log
        With a warning for every doubtful thing that was done or seen.

    Raises
    ------
    InvalidInput
        The file, a column or a value is at fault.
    """
    path = study.log_path(experiment)
    table = open_table(path)
    sources = _sources(study, experiment, table, path)
    wanted = {channel.column for channel in sources.values()} | set(experiment.add.values())
    columns = table.read(sorted(wanted))
    _check_values(columns, table, path)
    channels = {
        name: channel.scale * _with_added(name, channel, experiment, columns) + channel.offset
        for name, channel in sources.items()
    }
    time = channels.pop("t")
    _check_time(time, table, path)
    time, channels = _window(time, channels, experiment, path)
    _check_gaps(time, path)
    time, channels, warnings = _uniform(time, channels, path)
    warnings += _constants(channels, study, experiment, path)
    sample_time = float((time[-1] - time[0]) / (len(time) - 1))
    return Log(experiment, time, sample_time, channels, tuple(warnings))


def _sources(study: Study, experiment: Experiment, table: Table, path: Path) -> dict[str, Channel]:
    """Which column each channel comes from; the required ones must be there."""
    sources = {}
    for name in channel_names(study.n_joints):
        channel = study.channels.get(name)
        if channel is not None and channel.column not in table.names:
            raise _no_column(channel.column, f"which [channels] names for '{name}'", table, path)
        if channel is not None or name in table.names:
            sources[name] = channel or Channel(name)
    for channel_name, column in experiment.add.items():
        if column not in table.names:
            raise _no_column(column, f"which is to be added to '{channel_name}'", table, path)
        if channel_name not in sources:
            raise _no_column(channel_name, "to which another is to be added", table, path)
    required = ["t", *(f"theta_m{i}" for i in range(1, study.n_joints + 1))]
    for name in required:
        if name not in sources:
            raise _no_column(name, "which every log needs", table, path)
    for i, joint in enumerate(study.joints, start=1):
        if f"u{i}" not in sources and f"torque{i}" not in sources:
            raise _no_column(f"u{i}' or 'torque{i}", "the drive's input", table, path)
        if f"torque{i}" not in sources and joint.torque_per_volt is None:
            raise InvalidInput(
                f"joint {i} has a voltage log but no torque_per_volt",
                where=str(study.path),
                remedy=f"add torque_per_volt to [[joint]] {i}",
            )
    return sources


def _no_column(column: str, what: str, table: Table, path: Path) -> InvalidInput:
    near = difflib.get_close_matches(column, table.names, n=1, cutoff=0.6)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    shown = ", ".join(table.names[:20]) + (", ..." if len(table.names) > 20 else "")
    return InvalidInput(
        f"there is no column '{column}', {what}",
        where=str(path),
        remedy=f"map it in [channels] of the study; the file has: {shown}{hint}",
    )


def _with_added(
    name: str, channel: Channel, experiment: Experiment, columns: dict[str, FloatArray]
) -> FloatArray:
    values = columns[channel.column]
    if name in experiment.add:
        values = values + columns[experiment.add[name]]
    return values


def _check_values(columns: dict[str, FloatArray], table: Table, path: Path) -> None:
    for name, values in columns.items():
        row = first_impossible(values)
        if row is not None:
            raise InvalidInput(
                f"the value is {values[row]}",
                where=f"{path}, {table.row_name(row)}, column {name!r}",
                remedy="cut the log there, or set start and stop to leave it out",
            )


def _check_time(time: FloatArray, table: Table, path: Path) -> None:
    if len(time) < FEWEST_ROWS:
        raise _too_few(len(time), path, "the log")
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise InvalidInput(
            f"time does not increase: {time[row]:.9g} s after {time[row - 1]:.9g} s",
            where=f"{path}, {table.row_name(row)}",
            remedy="sort the log by time and leave out doubled rows",
        )


def _too_few(rows: int, path: Path, what: str) -> InvalidInput:
    return InvalidInput(
        f"{what} has {rows} row(s); at least {FEWEST_ROWS} are needed",
        where=str(path),
        remedy="record for longer, or widen start and stop",
    )


def _window(
    time: FloatArray, channels: dict[str, FloatArray], experiment: Experiment, path: Path
) -> tuple[FloatArray, dict[str, FloatArray]]:
    start = -np.inf if experiment.start is None else experiment.start
    stop = np.inf if experiment.stop is None else experiment.stop
    inside = slice(*np.searchsorted(time, [start, stop + 1e-12 * abs(stop)]))
    if len(time[inside]) == 0:
        raise InvalidInput(
            f"nothing lies in the window {start:g} to {stop:g} s: the log runs from {time[0]:g} to "
            f"{time[-1]:g} s",
            where=str(path),
            remedy=f"mend start and stop of experiment {experiment.name!r}",
        )
    if len(time[inside]) < FEWEST_ROWS:
        raise _too_few(len(time[inside]), path, "the window")
    return time[inside], {name: values[inside] for name, values in channels.items()}


def _check_gaps(time: FloatArray, path: Path) -> None:
    steps = np.diff(time)
    period = float(np.median(steps))
    widest = int(np.argmax(steps))
    if steps[widest] > LARGEST_GAP * period:
        raise InvalidInput(
            f"there is a gap from {time[widest]:.6g} to {time[widest + 1]:.6g} s, "
            f"{steps[widest] / period:.0f} samples long",
            where=str(path),
            remedy="set start and stop to one side of it",
        )


def _uniform(
    time: FloatArray, channels: dict[str, FloatArray], path: Path
) -> tuple[FloatArray, dict[str, FloatArray], list[Caution]]:
    """A uniform grid; interpolates where the stamps are not one already.

    Measured signals are interpolated by monotone cubics, which neither ring nor flatten; commanded
    ones are held, as the drive held them.
    """
    grid = np.linspace(time[0], time[-1], len(time))
    period = grid[1] - grid[0]
    away = float(np.max(np.abs(time - grid))) / period
    if away <= ROUNDING:
        return grid, channels, []
    from scipy.interpolate import PchipInterpolator

    period = float(np.median(np.diff(time)))
    grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-9) + 1)
    held = np.searchsorted(time, grid + 1e-9 * period, side="right") - 1
    resampled = {
        name: values[held] if name.startswith(_HELD) else PchipInterpolator(time, values)(grid)
        for name, values in channels.items()
    }
    steps = np.diff(time) / period
    message = (
        f"time stamps are not uniform (steps of {steps.min():.2f} to {steps.max():.2f} "
        f"periods): resampled to {len(grid)} samples every {period:.6g} s; what happens faster "
        "than the widest step is lost. Log with a fixed clock if you can"
    )
    return grid, resampled, [Caution("resampled", path.name, message)]


def _constants(
    channels: dict[str, FloatArray], study: Study, experiment: Experiment, path: Path
) -> list[Caution]:
    """A log in which nothing moves is an error; a sensor that never changes is doubtful."""
    joints = range(1, study.n_joints + 1)
    moved = [i for i in joints if np.ptp(channels[f"theta_m{i}"]) > 0.0]
    excited = experiment.joint
    if not moved or (excited is not None and excited not in moved):
        name = f"theta_m{excited or 1}"
        raise InvalidInput(
            f"the channel '{name}' never changes: the joint did not move",
            where=str(path),
            remedy="check the encoder's wiring, the channel map and the amplitude",
        )
    inputs = [
        channels[name] for i in joints for name in (f"u{i}", f"torque{i}") if name in channels
    ]
    if all(np.ptp(values) == 0.0 for values in inputs):
        raise InvalidInput(
            "the drive's input never changes in this log",
            where=str(path),
            remedy="check the channel map: the column may be another signal",
        )
    return [
        Caution(
            "constant-channel",
            path.name,
            f"the channel '{name}' never changes: it tells nothing. Check the sensor and the map",
        )
        for name, values in channels.items()
        if name.startswith(_SENSORS) and np.ptp(values) == 0.0
    ]
