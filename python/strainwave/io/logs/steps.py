"""Preprocessing steps of a study's experiment, applied to its logs in the order given.

Merged logs are read as one table. The other steps act on the channels in SI units, before the
window of the experiment is cut, so that the transients of a filter are at the ends of the record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave.domain import Clause, Diagnostic, Experiment, FloatArray, Log, Place
from strainwave.domain.steps import Detrend, LowPass, Resample
from strainwave.errors import InvalidInput
from strainwave.io.logs.clocks import MIN_SAMPLES, window_of
from strainwave.io.logs.tables import LogTable
from strainwave.io.logs.updates import MIN_SEGMENT_SAMPLES
from strainwave.numerics.filters import low_pass

COMMAND_PREFIXES = ("u", "ref")
"""Prefixes of commands, constant between the ticks of a clock."""

MIN_FILLED_SHARE = 1e-3
"""Smallest share of interpolated rows in an interpolated sample; rounding of stamps is below."""

_MIN_PERIODS = 10.0  # of the cut-off frequency in a record; one at each end is a transient
_MAX_CUTOFF_SHARE = 0.45  # of the sampling rate; from here on `low_pass` changes nothing
_ANTI_ALIAS_SHARE = 0.4  # of the new sampling rate
_MAX_PERIOD_ROUNDING = 1e-6  # relative distance of equal periods


def merge_tables(first: LogTable, second: LogTable, columns: Sequence[str]) -> LogTable:
    """A table with the rows of two, of which the second has the `columns` of the first.

    Raises InvalidInput if the second lacks one of them, or has another type of time stamps.
    """
    for name in columns:
        what = f"which {first.path.name} has, to which the log is merged"
        if name not in second.names:
            raise second.missing_column_error(name, what)
        if first.clocks.get(name) != second.clocks.get(name):
            raise InvalidInput(
                f"the time stamps in '{name}' are of another type than in {first.path.name}",
                where=str(second.path),
                remedy="write both logs with the same time stamps",
            )
    n_first = len(first.read(columns[:1])[columns[0]])

    def read(names: Sequence[str]) -> dict[str, FloatArray]:
        parts = first.read(names), second.read(names)
        return {name: np.concatenate([part[name] for part in parts]) for name in names}

    def row_name(row: int) -> str:
        if row < n_first:
            return first.row_name(row)
        return f"{second.path.name}, {second.row_name(row - n_first)}"

    return replace(first, read=read, row_name=row_name)


def apply_steps(
    logs: Sequence[Log], experiment: Experiment, path: Path
) -> tuple[list[Log], list[Diagnostic]]:
    """The segments of a record after all steps but merges, and a note on each step.

    Raises InvalidInput if a step does not fit the record.
    """
    notes = [
        Diagnostic("preprocessed", Place.in_records(experiment.name), "merge", file=step.file)
        for step in experiment.merges
    ]
    processed = list(logs)
    for step in experiment.steps:
        if isinstance(step, Detrend):
            processed, note = _detrend(processed, step, path)
        elif isinstance(step, LowPass):
            processed, note = _filter(processed, step, path)
        elif isinstance(step, Resample):
            processed, note = _resample(processed, step, path)
        else:
            continue
        notes.append(note)
    return processed, notes


def _detrend(logs: list[Log], step: Detrend, path: Path) -> tuple[list[Log], Diagnostic]:
    """Subtract one polynomial per channel from all segments."""
    missing = [name for name in step.channels if name not in logs[0].channels]
    if missing:
        raise InvalidInput(
            f"the step 'detrend' names '{missing[0]}', which the log does not have",
            where=str(path),
            remedy="remove it from channels of the step",
        )
    time = np.concatenate([log.time for log in logs])
    trends = {
        name: np.polynomial.Polynomial.fit(
            time, np.concatenate([log.channels[name] for log in logs]), step.degree
        )
        for name in step.channels
    }
    detrended = [
        replace(
            log,
            channels={
                name: values - trends[name](log.time) if name in trends else values
                for name, values in log.channels.items()
            },
        )
        for log in logs
    ]
    template = "removed-trend" if step.degree else "removed-trend/mean"
    removed = tuple(
        Clause(template, channel=name, first=float(trend(time[0])), last=float(trend(time[-1])))
        for name, trend in trends.items()
    )
    return detrended, Diagnostic(
        "preprocessed", Place.in_records(logs[0].name), "detrend", removed=removed
    )


def _filter(logs: list[Log], step: LowPass, path: Path) -> tuple[list[Log], Diagnostic]:
    """Filter all channels of each segment."""
    for log in logs:
        nyquist = _MAX_CUTOFF_SHARE / log.sample_time
        lowest = _MIN_PERIODS / (len(log) * log.sample_time)
        if not lowest < step.cutoff_hz < nyquist:
            raise InvalidInput(
                f"the step 'lowpass' has a cut-off of {step.cutoff_hz:g} Hz, but a record of "
                f"{len(log) * log.sample_time:.3g} s at {1.0 / log.sample_time:.4g} Hz can be "
                f"filtered from {lowest:.3g} to {nyquist:.4g} Hz",
                where=str(path),
                remedy="change cutoff_hz, or remove the step",
            )
    filtered = [_passed(log, step.cutoff_hz) for log in logs]
    place = Place.in_records(logs[0].name)
    return filtered, Diagnostic("preprocessed", place, "lowpass", cutoff_hz=step.cutoff_hz)


def _passed(log: Log, cutoff_hz: float) -> Log:
    channels = {
        name: low_pass(values, cutoff_hz, log.sample_time) for name, values in log.channels.items()
    }
    return replace(log, channels=channels)


def _resample(logs: list[Log], step: Resample, path: Path) -> tuple[list[Log], Diagnostic]:
    """Give all segments a longer period."""
    T = logs[0].sample_time
    if step.sample_time < T * (1.0 - _MAX_PERIOD_ROUNDING):
        raise InvalidInput(
            f"the step 'resample' has a period of {step.sample_time:g} s, but the record has a "
            f"longer one, {T:.6g} s",
            where=str(path),
            remedy="set a longer sample_time, or remove the step",
        )
    resampled = [_resampled(log, step.sample_time) for log in logs]
    if min(map(len, resampled)) < MIN_SAMPLES:
        raise InvalidInput(
            f"a period of {step.sample_time:g} s leaves less than {MIN_SAMPLES} samples",
            where=str(path),
            remedy="set a shorter sample_time in the step 'resample'",
        )
    note = Diagnostic(
        "preprocessed", Place.in_records(logs[0].name), "resample", before=T, after=step.sample_time
    )
    return resampled, note


def _resampled(log: Log, period: float) -> Log:
    """The log at a longer period, behind an anti-alias low-pass.

    A command is held between samples, which delays it by half a period and reduces its gain by
    sinc(w T / 2). So that the longer hold does not delay it more, it is read (T' - T) / 2 later,
    and the second difference d2 corrects the gain: v - (1 - (T / T')^2) d2 / 24.
    """
    from scipy.interpolate import CubicSpline

    T, lead = log.sample_time, 0.5 * (period - log.sample_time)
    if lead <= _MAX_PERIOD_ROUNDING * T:
        return log
    count = int((log.time[-1] - lead - log.time[0]) / period + 1e-9) + 1
    time = log.time[0] + period * np.arange(count)
    channels = {}
    for name, values in log.channels.items():
        passed = CubicSpline(log.time, low_pass(values, _ANTI_ALIAS_SHARE / period, T))
        if not name.startswith(COMMAND_PREFIXES):
            channels[name] = passed(time)
            continue
        around = passed(time[0] + lead + period * np.arange(-1, count + 1))
        around[[0, -1]] = around[[1, -2]]  # outside of the record
        channels[name] = around[1:-1] - (1.0 - (T / period) ** 2) / 24.0 * np.diff(around, 2)
    masked = {
        name: np.interp(time, log.time, mask.astype(np.float64)) > MIN_FILLED_SHARE
        for name, mask in log.masked.items()
    }
    return replace(log, time=time, sample_time=period, channels=channels, masked=masked)


def cut_to_window(logs: Sequence[Log], experiment: Experiment, path: Path) -> list[Log]:
    """The samples of each segment in the window; segments with too few are left out.

    Raises InvalidInput if all have too few.
    """
    start, stop = window_of(experiment)
    least = MIN_SEGMENT_SAMPLES if len(logs) > 1 else MIN_SAMPLES
    cut = []
    for log in logs:
        tolerance = _MAX_PERIOD_ROUNDING * log.sample_time
        first = int(np.searchsorted(log.time, start - tolerance))
        rows = slice(first, int(np.searchsorted(log.time, stop + tolerance, side="right")))
        if rows.stop - rows.start >= least:
            cut.append(log.cut(rows))
    if not cut:
        raise InvalidInput(
            f"less than {least} samples are in the window from {start:g} to {stop:g} s: the "
            f"log extends from {logs[0].time[0]:g} to {logs[-1].time[-1]:g} s",
            where=str(path),
            remedy=f"correct start and stop of experiment {experiment.name!r}",
        )
    return cut
