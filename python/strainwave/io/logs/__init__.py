"""Read log files: the study's channels on a uniform time base, in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import (
    BoolArray,
    Channel,
    Diagnostic,
    Experiment,
    FloatArray,
    Log,
    Place,
    Study,
    channel_names,
    channel_parts,
)
from strainwave.domain.arm.combinations import has_posture_free
from strainwave.domain.arm.description import UNKNOWN
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.link_sensors import link_channel_kinds
from strainwave.errors import InvalidInput, suggest_name
from strainwave.io.logs.arrays import Data, open_memory_table
from strainwave.io.logs.bags import Bag, is_bag
from strainwave.io.logs.clock_text import time_of
from strainwave.io.logs.clocks import Track, resample_tracks
from strainwave.io.logs.columns import open_log
from strainwave.io.logs.steps import (
    COMMAND_PREFIXES,
    MIN_FILLED_SHARE,
    apply_steps,
    cut_to_window,
    merge_tables,
)
from strainwave.io.logs.tables import LogTable, open_table, release_reader_memory, write_table
from strainwave.io.logs.updates import (
    drop_missing,
    fill_missing,
    segment_table,
    segment_tracks,
)
from strainwave.numerics.parallel import run_parallel

__all__ = ["read_log", "read_logs", "read_segments", "write_log"]

write_log = write_table

_MAX_REST_RANGE = 0.01  # [rad] range of the angle of a motor that stands still, with its noise
_SAME_ANGLE = 1e-9  # [rad] between two columns that are one signal


def read_logs(
    study: Study, experiments: Sequence[Experiment] | None = None, *, data: Data | None = None
) -> tuple[Log, ...]:
    """Read the logs of several experiments; all experiments by default.

    `data` maps the name of an experiment to a table in memory or a path that replaces the study's
    file. Raises InvalidInput if a log is invalid, if no log has a column that the study maps, or if
    `data` names an unknown experiment.
    """
    selected = study.experiments if experiments is None else experiments
    replacements = dict(data or {})
    names = [each.name for each in study.experiments]
    for name in replacements:
        if name not in names:
            raise InvalidInput(
                f"the study has no experiment {name!r}",
                where="data",
                remedy=f"use the name of an experiment: {', '.join(names)}",
            )
    jobs = [partial(read_segments, study, each, replacements.get(each.name)) for each in selected]
    logs = tuple(log for segments in run_parallel(jobs) for log in segments)
    _check_mapped(study, logs, replacements)
    return logs


def read_log(study: Study, experiment: Experiment, data: Any = None) -> Log:
    """Read the log of one experiment: channels in SI units, cut to its window, on uniform time.

    value = scale * (column + added) + offset, where `added` is the column that `add` names, if any.
    Then the steps of the experiment are applied, and then its window is cut.
    If the log lacks the column of an optional channel, the channel is absent. `data`, a table or a
    path, replaces the study's file. The log carries a warning for each correction and each
    doubtful value. Of a record with pauses, the longest segment is returned, under the name of the
    experiment. Raises InvalidInput if the file, a column or a value is invalid.
    """
    segments = read_segments(study, experiment, data)
    return replace(max(segments, key=len), experiment=experiment, warnings=segments[0].warnings)


def read_segments(study: Study, experiment: Experiment, data: Any = None) -> tuple[Log, ...]:
    """Read the segments of one experiment; one without pauses keeps its name.

    See `read_log`, which returns the longest.
    """
    table = _open(study, experiment, data)
    sources = _sources(study, experiment, table)
    if experiment.merges:
        table = _merged(study, experiment, table, sources)
    # steps act on the whole record
    read = replace(experiment, start=None, stop=None) if experiment.steps else experiment
    segments, warnings = _segments(table, sources, read, study.sample_rate)
    warnings += [
        Diagnostic("torque-sensor", Place(file=table.path.name), channel=name)
        for name, channel in sources.items()
        if channel.meaning == "sensor"
    ]
    whole = [
        _log(tracks, sources, read, table.path, is_continuation=number > 0)
        for number, tracks in enumerate(segments)
    ]
    del segments
    release_reader_memory()
    if experiment.steps:
        processed, notes = apply_steps(whole, experiment, table.path)
        whole, warnings = cut_to_window(processed, experiment, table.path), warnings + notes
    logs: list[Log] = []
    unusable: InvalidInput | None = None
    for log in whole:
        channels = dict(log.channels)
        found = _integrate_velocities(channels, study, log.time, table.path)
        try:
            found += _check_constants(channels, study, experiment, table.path)
        except InvalidInput as error:  # one segment at rest is no fault
            unusable = unusable or error
            continue
        each = replace(log, experiment=experiment, channels=channels)
        logs.append(replace(each, warnings=(*log.warnings, *found)))
    if unusable is not None and not logs:
        raise unusable
    logs[0] = replace(logs[0], warnings=(*warnings, *logs[0].warnings))
    if len(logs) == 1:
        return tuple(logs)
    return tuple(
        replace(log, experiment=replace(experiment, name=f"{experiment.name}/{k}"))
        for k, log in enumerate(logs, start=1)
    )


def _log(
    tracks: Sequence[Track],
    sources: Mapping[str, Channel],
    experiment: Experiment,
    path: Path,
    *,
    is_continuation: bool,
) -> Log:
    """The channels of one segment on uniform time, in SI units."""
    filled: dict[str, BoolArray] = {}
    dense = []
    for track in tracks:
        complete, mask = fill_missing(track)
        filled |= mask
        dense.append(complete)
    time, columns, warnings = resample_tracks(dense, experiment, path)
    channels = {}
    for name, channel in sources.items():
        if name != "t":
            added = columns[experiment.add[name]] if name in experiment.add else 0.0
            channels[name] = channel.scale * (columns[channel.column] + added) + channel.offset
    masked = {
        name: np.interp(time, track.time, filled[channel.column].astype(np.float64))
        > MIN_FILLED_SHARE
        for name, channel in sources.items()
        for track in dense
        if channel.column in filled and channel.column in track.columns
    }
    sample_time = float((time[-1] - time[0]) / (len(time) - 1))
    notes = tuple(warnings)
    return Log(experiment, time, sample_time, channels, notes, masked, is_continuation)


def _merged(
    study: Study,
    experiment: Experiment,
    table: LogTable | Bag,
    sources: Mapping[str, Channel],
) -> LogTable:
    """The table of a record that continues in further logs."""
    columns = [column for channel in sources.values() for column in channel.columns]
    for path in study.log_paths(experiment)[1:]:
        if isinstance(table, Bag) or is_bag(path) or study.sample_rate is not None:
            what = "logs without time stamps" if study.sample_rate is not None else "bags"
            raise InvalidInput(
                f"{what} cannot be merged",
                where=str(study.path),
                remedy=f"make {path.name} an experiment of its own",
            )
        table = merge_tables(table, open_table(path), [*columns, *experiment.add.values()])
    return table  # type: ignore[return-value]  # no bag


def _open(study: Study, experiment: Experiment, data: Any) -> LogTable | Bag:
    if data is not None and not isinstance(data, str | Path):
        return open_memory_table(data, f"data[{experiment.name!r}]")
    path = study.log_path(experiment) if data is None else Path(data)
    return open_log(path)


def _segments(
    table: LogTable | Bag,
    sources: dict[str, Channel],
    experiment: Experiment,
    sample_rate: float | None,
) -> tuple[list[list[Track]], list[Diagnostic]]:
    """Return the tracks of each segment; that of the first motor's angle or velocity is first."""
    columns_of = (column for channel in sources.values() for column in channel.columns)
    required = sorted({*columns_of, *experiment.add.values()})
    clock = sources.get("theta_m1") or sources["omega_m1"]
    torques, temperatures = (
        {channel.column for name, channel in sources.items() if channel_parts(name)[0] == kind}
        for kind in ("torque", "temperature")
    )
    columns_by_name = [(name, channel.column) for name, channel in sources.items()]
    columns_by_name += experiment.add.items()
    commands = {column for name, column in columns_by_name if name.startswith(COMMAND_PREFIXES)}
    if isinstance(table, Bag):
        tracks, warnings = table.tracks(required)
        tracks = [replace(track, commands=commands) for track in tracks]
        tracks, missing = drop_missing(tracks, table.path)
        segments, split = segment_tracks(tracks, clock.column, experiment, table.path)
        return segments, [*warnings, *missing, *split]
    columns = table.read(required)
    if sample_rate is None:
        time = time_of(columns, table.clocks, sources["t"])
        if "t" in experiment.add:
            time = time + sources["t"].scale * columns[experiment.add["t"]]
        others = {channel.column for name, channel in sources.items() if name != "t"}
        columns = {
            name: values
            for name, values in columns.items()
            if name in others or name in experiment.add.values()
        }
    else:
        time = np.arange(len(next(iter(columns.values())))) / sample_rate
    track = Track("", time, columns, table.row_name, commands, torques, temperatures)
    return segment_table(track, clock.column, experiment, table.path)


def _sources(study: Study, experiment: Experiment, table: LogTable | Bag) -> dict[str, Channel]:
    """Return the source column of each channel; required channels must have one."""
    sources = {}
    for name in channel_names(study.arm.n_joints):
        channel = study.channels.get(name)
        if name == "t" and study.sample_rate is not None:
            continue
        missing = [] if channel is None else [c for c in channel.columns if c not in table.names]
        if missing:
            # a recorded topic without the field, or a column of text, is no missing sensor
            if isinstance(table, Bag):
                misnamed = table.has_topic_of(missing[0])
            else:
                misnamed = missing[0] in table.omitted
            if name == "t" or name.startswith("theta_m") or misnamed:
                raise _missing_mapped_column(name, missing[0], table)
            continue  # absent in this log
        if channel is not None or name in table.names:
            sources[name] = channel or Channel(name)
    for channel_name, column in experiment.add.items():
        if column not in table.names:
            what = f"which the study adds to '{channel_name}'"
            raise table.missing_column_error(column, what)
        if channel_name not in sources:
            what = "to which the study adds another column"
            raise table.missing_column_error(channel_name, what)
    _check_required(sources, study, table)
    _check_inputs(sources, study, experiment, table)
    return sources


def _check_mapped(study: Study, read: Sequence[Log], data: Data) -> None:
    """Check that each mapped column is in at least one log."""
    for name, channel in study.channels.items():
        if name == "t" or not read or any(name in log.channels for log in read):
            continue
        first = read[0].experiment
        table = _open(study, first, data.get(first.name))
        if len(read) == 1 or isinstance(table, Bag):  # a bag's error lists its topics
            raise _missing_mapped_column(name, channel.column, table)
        raise InvalidInput(
            f"no log has the column '{channel.column}', which [channels] names for '{name}'",
            where=str(study.path),
            remedy=f"correct channels.{name}, or remove it"
            f"{suggest_name(channel.column, table.names)}",
        )


def _missing_mapped_column(name: str, column: str, table: LogTable | Bag) -> InvalidInput:
    return table.missing_column_error(column, f"which [channels] names for '{name}'")


def _check_required(sources: dict[str, Channel], study: Study, table: LogTable | Bag) -> None:
    required = [f"theta_m{i}" for i in range(1, study.arm.n_joints + 1)]
    if isinstance(table, Bag) and ("t" in sources or study.sample_rate is not None):
        name = "t" if "t" in sources else "sample_rate"
        raise InvalidInput(
            f"{name} is given, but the messages of a bag contain their time stamps",
            where=str(study.path),
            remedy=f"remove {name} from [channels]",
        )
    if not isinstance(table, Bag) and study.sample_rate is None:
        required = ["t", *required]
    for name in required:
        if name not in sources:
            number = channel_parts(name)[1]
            if f"omega_m{number}" in sources:
                if has_posture_free(study.arm, number):
                    continue
                raise InvalidInput(
                    f"motor {number} logs its velocity (omega_m{number}) but no angle, and gravity"
                    " or the inertia of the arm depends on the angle",
                    where=str(table.path),
                    remedy=f"log the angle of motor {number} and map it to theta_m{number} in "
                    f"[channels] of {study.path}",
                )
            used = {channel.column for channel in sources.values()}
            error = table.missing_column_error(name, "which every log must contain", used)
            if name != "t" and not kind_of(study.arm).places_joints:
                # a serial arm may also be described without the joint
                urdf = study.arm.urdf
                fixed = f' and set its type to "fixed" in {urdf.file}' if urdf else ""
                remedy = (
                    f"if joint {number} stands still in all logs, remove its [[joint]] table"
                    f"{fixed}; else {error.remedy}"
                )
                raise InvalidInput(error.problem, where=error.where, remedy=remedy)
            raise error


def _check_inputs(
    sources: dict[str, Channel], study: Study, experiment: Experiment, table: LogTable | Bag
) -> None:
    """Raise InvalidInput without a motor input.

    A sensor behind the gear suffices for rigid joints, and for slow motion of elastic ones.
    """
    if study.arm.position_servo is not None:
        for i in range(1, study.arm.n_joints + 1):
            if f"ref{i}" not in sources:
                what = "the commanded angle that every log of a position servo must contain"
                raise table.missing_column_error(f"ref{i}", what)
        return
    is_slow = experiment.use in ("motion", "check")
    is_rigid = not any(joint.elastic for joint in study.arm.joints)
    for i, joint in enumerate(study.arm.joints, start=1):
        if f"tau_l{i}" in sources and (is_slow or is_rigid):
            continue
        if f"u{i}" not in sources and f"torque{i}" not in sources:
            for name in (f"u{i}", f"torque{i}"):
                if name in study.channels:
                    raise _missing_mapped_column(name, study.channels[name].column, table)
            what = f"and no column 'torque{i}': the log has no motor input"
            raise table.missing_column_error(f"u{i}", what)
        if f"torque{i}" not in sources and joint.torque_per_volt is None:
            raise InvalidInput(
                f"joint {i} has a voltage log but no torque_per_volt",
                where=str(study.path),
                remedy=f"add torque_per_volt to [[joint]] {i}",
            )
        if f"torque{i}" in sources and joint.torque_per_volt == UNKNOWN:
            raise InvalidInput(
                f'the torque of joint {i} is logged, but its torque_per_volt is "unknown"',
                where=str(study.path),
                remedy=f"remove torque_per_volt from [[joint]] {i}; or, if the column holds a "
                f"current, map it to u{i} instead of torque{i}",
            )


def _integrate_velocities(
    channels: dict[str, FloatArray], study: Study, time: FloatArray, path: Path
) -> list[Diagnostic]:
    """Add the integral from zero of the velocity of each motor without an angle."""
    joints = [i for i in range(1, study.arm.n_joints + 1) if f"theta_m{i}" not in channels]
    for joint in joints:
        velocity = channels[f"omega_m{joint}"]
        steps = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time)
        channels[f"theta_m{joint}"] = np.concatenate([[0.0], np.cumsum(steps)])
    return [Diagnostic("integrated-velocity", Place(file=path.name), joint=i) for i in joints]


def _check_constants(
    channels: dict[str, FloatArray], study: Study, experiment: Experiment, path: Path
) -> list[Diagnostic]:
    """Raise InvalidInput if nothing moves; return a warning for each constant sensor channel."""
    joints = range(1, study.arm.n_joints + 1)
    moving = [i for i in joints if np.ptp(channels[f"theta_m{i}"]) > 0.0]
    excited = experiment.joint
    if not moving or (excited is not None and excited not in moving):
        name = f"theta_m{excited or 1}"
        problem = f"the channel '{name}' never changes: the joint did not move"
        remedy = "check the encoder wiring, the [channels] table and the amplitude"
        if moving:
            other = f"theta_m{moving[0]}"
            problem += f", but '{other}' changes, and the study excites joint {excited}"
            remedy = (
                f"exchange '{name}' and '{other}' in [channels], or correct joint; otherwise "
                f"{remedy}"
            )
        raise InvalidInput(problem, where=str(path), remedy=remedy)
    kinds: tuple[str, ...] = ("u", "torque", "tau_l")
    if study.arm.position_servo is not None:
        kinds = ("ref",)
        _check_commands(channels, study, path)
    inputs = [channels[f"{kind}{i}"] for i in joints for kind in kinds if f"{kind}{i}" in channels]
    if all(np.ptp(values) == 0.0 for values in inputs):
        raise InvalidInput(
            "no motor input changes in this log",
            where=str(path),
            remedy="check the [channels] table: the column may contain another signal",
        )
    return [
        Diagnostic("constant-channel", Place(file=path.name), channel=name)
        for name, values in channels.items()
        if np.ptp(values) == 0.0 and _has_failed(name, channels)
    ]


def _check_commands(channels: dict[str, FloatArray], study: Study, path: Path) -> None:
    """Raise InvalidInput if a commanded angle never differs from the measured one."""
    for i, joint in enumerate(study.arm.joints, start=1):
        command, angle = channels[f"ref{i}"], joint.gear_ratio * channels[f"theta_m{i}"]
        if np.ptp(command) > 0.0 and np.allclose(command, angle, rtol=0.0, atol=_SAME_ANGLE):
            raise InvalidInput(
                f"the command 'ref{i}' never differs from the position 'theta_m{i}', so that the "
                "log does not show what the servo does",
                where=str(path),
                remedy="map the goal that is sent to the servo; some drivers report the present "
                "position under both names",
            )


def _has_failed(name: str, channels: dict[str, FloatArray]) -> bool:
    """Whether a constant channel is that of a failed sensor, not of a motor at standstill."""
    kind, number = channel_parts(name)
    if kind == "omega_m":
        return float(np.ptp(channels[f"theta_m{number}"])) > _MAX_REST_RANGE
    return kind in link_channel_kinds()
