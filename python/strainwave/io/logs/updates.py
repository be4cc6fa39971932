"""Columns that update more slowly than the rows of their table.

A logger that runs faster than a bus repeats each value until the next one arrives; a table merged
from several sources has empty cells in between. Both are reduced to their updates.

Segments of a record: stretches without pauses, restarts or long missing values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from strainwave.domain import BoolArray, Diagnostic, Experiment, FloatArray, Place
from strainwave.io.logs.clock_text import continue_time, drop_repeats
from strainwave.io.logs.clocks import (
    MAX_GAP_PERIODS,
    MIN_SAMPLES,
    Track,
    check_time,
    cut,
    cut_between,
    find_gaps,
    window_of,
)

_MIN_UPDATES = 20  # of a column that can be recognised as held
# maximum share of values that a held column keeps for one row; motion above one count per row
# gives far more
_MAX_SHORT_SHARE = 0.1
# minimum share of changes above 1.5 times a small one. A slow or quantised signal and a
# command of two levels change by one quantum at a time (at most 5 % of the changes in the measured
# records are larger), a held one by the motion during the hold (at least 40 %)
_MIN_LARGE_SHARE = 0.25
_QUANTUM_MARGIN = 1.5  # changes of at least two quanta exceed it
# of the changes below the small one: a command of two levels starts with a smaller one, from zero
_SMALLEST_SHARE = 0.1
_MIN_SUBSET_SHARE = 0.95  # minimum share of updates that columns of one source have in common
_LONG_RUN = 2.0  # times the 90 % quantile of the holds: updates without a change lie within
# minimum share of values in a column whose missing cells are interpolated; below, it is slow
_MIN_VALUE_SHARE = 0.8
# [s] a torque that alone is held for less is the command of a servo clock, not late telemetry
_MAX_SERVO_PERIOD = 0.005


class _UpdatedColumns(NamedTuple):
    """Columns with common updates."""

    names: list[str]
    updates: BoolArray  # (n_samples,)
    is_held: bool  # otherwise the cells between the updates are empty


def separate_slow_columns(track: Track, file: str) -> tuple[list[Track], list[Diagnostic]]:
    """Reduce a track to its updates; if only some columns are slow, move them to separate tracks.

    Commands are held by nature and excluded.
    """
    sources: list[_UpdatedColumns] = []
    fast: list[str] = []
    for name, values in track.columns.items():
        valid = ~np.isnan(values)
        if name in track.commands or not valid.any():
            continue
        is_held = bool(valid.all())
        updates: BoolArray | None = None
        if not is_held and valid.mean() <= _MIN_VALUE_SHARE:
            updates = valid
        elif is_held and name not in track.covariates:
            updates = find_updates(values)
        if updates is not None:
            sources.append(_UpdatedColumns([name], updates, is_held))
        elif name not in track.covariates and np.ptp(values[valid]) > 0.0:
            fast.append(name)
    sources = _merge(sources)
    period = float(np.median(np.diff(track.time)))
    if fast:
        sources = [
            each
            for each in sources
            if not each.is_held
            or not set(each.names) <= set(track.torques)
            or period * len(each.updates) > _MAX_SERVO_PERIOD * np.count_nonzero(each.updates)
        ]
    if not sources:
        return [track], []
    is_whole = not fast and len(sources) == 1
    warnings = []
    for each in sources:
        rows = len(each.updates) / np.count_nonzero(each.updates)
        warnings.append(
            Diagnostic(
                "held-samples",
                Place(file=file),
                "" if is_whole else "some",
                columns=", ".join(each.names),
                rows=float(rows),
                rate_hz=1.0 / (rows * period),
            )
        )
    if is_whole:
        return [cut(track, sources[0].updates)], warnings
    slow = {name for each in sources for name in each.names}
    rest = {name: values for name, values in track.columns.items() if name not in slow}
    tracks = [replace(track, columns=rest)] if rest else []
    for each in sources:
        columns = {name: track.columns[name] for name in each.names}
        part = replace(track, name=", ".join(each.names), columns=columns)
        tracks.append(cut(part, each.updates))
    return tracks, warnings


def find_updates(values: FloatArray) -> BoolArray | None:
    """Rows (n_samples,) in which a held column updates; None if it is not held.

    A held column keeps each value for two rows or more and then changes by the motion in that time.
    """
    changed = values[1:] != values[:-1]
    if np.count_nonzero(changed[1:] & changed[:-1]) > _MAX_SHORT_SHARE * np.count_nonzero(changed):
        return None
    steps = np.abs(np.diff(values))
    changes = np.flatnonzero(steps) + 1
    if len(changes) < _MIN_UPDATES:
        return None
    sizes = steps[changes - 1]
    small = np.quantile(sizes, _SMALLEST_SHARE)
    if np.mean(sizes > _QUANTUM_MARGIN * small) < _MIN_LARGE_SHARE:
        return None
    updates = np.zeros(len(values), dtype=bool)
    updates[changes] = updates[0] = True
    return updates


def _with_rest(updates: BoolArray) -> BoolArray:
    """Add updates, at their usual distance, where nothing changes for long."""
    rows = np.append(np.flatnonzero(updates), len(updates))
    runs = np.diff(rows)
    usual, longest = int(np.median(runs)), _LONG_RUN * float(np.quantile(runs, 0.9))
    updates = updates.copy()
    for k in np.flatnonzero(runs > longest):
        updates[rows[k] : rows[k + 1] : usual] = True
    return updates


def _merge(sources: list[_UpdatedColumns]) -> list[_UpdatedColumns]:
    """Merge columns with common updates; one with fewer changes keeps its value at the others'."""
    merged: list[_UpdatedColumns] = []
    for each in sorted(sources, key=lambda s: -np.count_nonzero(s.updates)):
        count = np.count_nonzero(each.updates)
        for other in merged:
            common = np.count_nonzero(each.updates & other.updates)
            if each.is_held == other.is_held and common >= _MIN_SUBSET_SHARE * count:
                other.names.extend(each.names)
                break
        else:
            merged.append(each)
    return [s._replace(updates=_with_rest(s.updates)) if s.is_held else s for s in merged]


def drop_missing(tracks: Sequence[Track], path: Path) -> tuple[list[Track], list[Diagnostic]]:
    """Drop the rows in which a column has no value for long, and warn of missing values.

    A column that begins late or ends early narrows the record. A command keeps its last value.
    """
    complete, missing = [], dict[str, int]()
    for track in tracks:
        keep = np.ones(len(track.time), dtype=bool)
        for name, values in track.columns.items():
            rows = np.flatnonzero(~np.isnan(values))
            if len(rows) in (0, len(values)):
                continue
            keep[: rows[0]] = False
            if name in track.commands:
                continue
            missing[name] = len(values) - len(rows)
            keep[rows[-1] + 1 :] = False
            runs = np.diff(rows)
            for k in np.flatnonzero(runs > MAX_GAP_PERIODS * float(np.median(runs))):
                keep[rows[k] + 1 : rows[k + 1]] = False
        complete.append(track if keep.all() else cut(track, keep))
    if not missing:
        return complete, []
    names, count = ", ".join(missing), sum(missing.values())
    return complete, [
        Diagnostic("missing-values", Place(file=path.name), columns=names, count=count)
    ]


def fill_missing(track: Track) -> tuple[Track, dict[str, BoolArray]]:
    """Interpolate single missing values, and hold those of commands; returns what was filled."""
    columns, filled = dict(track.columns), {}
    for name, values in track.columns.items():
        rows = np.flatnonzero(~np.isnan(values))
        if len(rows) in (0, len(values)):
            continue
        if name in track.commands:
            last = np.maximum(np.searchsorted(rows, np.arange(len(values)), side="right") - 1, 0)
            columns[name] = values[rows[last]]
        else:
            columns[name] = np.interp(track.time, track.time[rows], values[rows])
            filled[name] = np.isnan(values)
    return replace(track, columns=columns), filled


MIN_SEGMENT_SAMPLES = 50
"""Minimum number of samples of a segment; derivatives and filters lose both ends of each one."""


def segment_table(
    track: Track, clock: str, experiment: Experiment, path: Path
) -> tuple[list[list[Track]], list[Diagnostic]]:
    """Split a table into segments, each of one track per rate, the first with the column `clock`.

    Only the window of the experiment is used. Raises InvalidInput if a time stamp is no number, or
    if the stamps are too coarse.
    """
    check_time(track, path)
    track, warnings = drop_repeats(track, path)
    n_back = int(np.count_nonzero(np.diff(track.time) < 0.0))
    track = replace(track, time=continue_time(track.time))
    inside = cut_between(track, *window_of(experiment))
    if len(inside.time) < MIN_SAMPLES:
        return [[track]], warnings  # rejected with the window's message
    (track,), missing = drop_missing([inside], path)
    tracks, slow = separate_slow_columns(track, path.name)
    segments, split = segment_tracks(tracks, clock, experiment, path, n_back)
    return segments, [*warnings, *missing, *slow, *split]


def segment_tracks(
    tracks: Sequence[Track], clock: str, experiment: Experiment, path: Path, n_back: int = 0
) -> tuple[list[list[Track]], list[Diagnostic]]:
    """Split tracks at the pauses of all that are measured; that with the column `clock` is first.

    Segments with too few samples in the window of the experiment are left out, unless all have too
    few.
    """
    tracks = sorted(tracks, key=lambda track: clock not in track.columns)
    spans = [(-np.inf, np.inf)]
    longest = 0.0
    for track in tracks:
        if track.is_command or len(track.time) < MIN_SAMPLES:
            continue
        gaps = find_gaps(track.time)
        longest = max(longest, float(np.max(np.diff(track.time)[gaps], initial=0.0)))
        starts, stops = [-np.inf, *track.time[gaps + 1]], [*track.time[gaps], np.inf]
        spans = [
            (max(start, a), min(stop, b))
            for start, stop in spans
            for a, b in zip(starts, stops, strict=True)
            if max(start, a) < min(stop, b)
        ]
    if len(spans) == 1:
        return [tracks], []
    low, high = window_of(experiment)
    parts = [[cut_between(track, *span) for track in tracks] for span in spans]
    sizes = []
    for part in parts:
        measured = [track.time for track in part if not track.is_command]
        inside = [np.count_nonzero((time >= low) & (time <= high)) for time in measured]
        sizes.append(int(inside[0]) if min(inside) >= MIN_SAMPLES else 0)
    segments = [
        part for part, size in zip(parts, sizes, strict=True) if size >= MIN_SEGMENT_SAMPLES
    ] or [parts[int(np.argmax(sizes))]]
    warning = Diagnostic(
        "split",
        Place(file=path.name),
        n_gaps=len(spans) - 1 - n_back,
        longest=longest,
        n_back=n_back,
        n_segments=len(segments),
        n_rows=len(tracks[0].time) - sum(len(part[0].time) for part in segments),
    )
    return segments, [warning]
