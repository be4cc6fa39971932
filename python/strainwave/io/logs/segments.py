"""Segments of a record: stretches without pauses, restarts or long missing values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave.domain import Diagnostic, Experiment, Place
from strainwave.io.logs.clocks import (
    MIN_SAMPLES,
    Track,
    check_time,
    cut_between,
    find_gaps,
    window_of,
)
from strainwave.io.logs.stamps import continue_time, drop_repeats
from strainwave.io.logs.updates import Roles, drop_missing, separate_slow_columns

MIN_SEGMENT_SAMPLES = 50
"""Minimum number of samples of a segment; derivatives and filters lose both ends of each one."""


def segment_table(
    track: Track, roles: Roles, experiment: Experiment, path: Path
) -> tuple[list[list[Track]], list[Diagnostic]]:
    """Split a table into segments, each of one track per rate, the clock's first.

    Only the window of the experiment is used. Raises InvalidInput if a time stamp is no number, or
    if the stamps are too coarse.
    """
    check_time(track, path)
    track, warnings = drop_repeats(track, path)
    n_back = int(np.count_nonzero(np.diff(track.time) < 0.0))
    track = replace(track, time=continue_time(track.time))
    inside = cut_between(track, *window_of(experiment), ())
    if len(inside.time) < MIN_SAMPLES:
        return [[track]], warnings  # rejected with the window's message
    (track,), missing = drop_missing([inside], roles, path)
    tracks, slow = separate_slow_columns(track, roles, path.name)
    segments, split = segment_tracks(tracks, roles, experiment, path, n_back)
    return segments, [*warnings, *missing, *slow, *split]


def segment_tracks(
    tracks: Sequence[Track], roles: Roles, experiment: Experiment, path: Path, n_back: int = 0
) -> tuple[list[list[Track]], list[Diagnostic]]:
    """Split tracks at the pauses of all that are measured; the clock's track is first.

    Segments with too few samples in the window of the experiment are left out, unless all have too
    few.
    """
    tracks = sorted(tracks, key=lambda track: roles.clock not in track.columns)
    spans = [(-np.inf, np.inf)]
    longest = 0.0
    for track in tracks:
        if track.has_only(roles.commands) or len(track.time) < MIN_SAMPLES:
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
    parts = [[cut_between(track, *span, roles.commands) for track in tracks] for span in spans]
    sizes = []
    for part in parts:
        measured = [track.time for track in part if not track.has_only(roles.commands)]
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
