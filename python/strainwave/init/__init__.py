"""Draft a study file from logs: `strainwave init`.

`inspection` reads the logs, and `robot` the joints of a URDF. `names` and `signal_features`
classify a column, `joints` assigns it to a joint, and `joint_columns` (angles) and `channels`
(inputs, sensors) map columns to channels. `experiment_type` proposes the use of each record, and
`study_text` writes the study file with a reason for each guess.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from strainwave.errors import InvalidInput
from strainwave.init.channels import add_channels, map_channels
from strainwave.init.experiment_type import ExperimentProposal, propose_uses
from strainwave.init.inspection import InspectedLog, find_fullest_record, read_record
from strainwave.init.joint_columns import Guess, Mapping
from strainwave.init.joints import find_logged_joints
from strainwave.init.robot import Robot
from strainwave.init.study_text import (
    count_todos,
    is_elastic,
    list_todos,
    study_text,
)
from strainwave.io.atomic_files import write_whole

__all__ = ["StudyDraft", "start_study"]

_RATE_CHANNELS = ("omega_m", "gyro", "gx", "gy", "gz", "ref")  # scaled by derivatives of angles
_MIN_MOTION = 0.01  # [rad, m] of an angle; the noise of one that stands still is below


@dataclass(frozen=True, slots=True)
class StudyDraft:
    """Summary of a drafted study file."""

    path: Path
    joints: int
    channels: tuple[str, ...]
    experiments: int
    n_todos: int  # number of values that the user must fill in
    limit: str  # why the arm exceeds the supported models; empty if it does not
    warnings: tuple[str, ...]
    guesses: tuple[Guess, ...]  # of the channels
    todos: tuple[str, ...]  # what the user must fill in, in the order of the file


def start_study(logs: Sequence[Path], out: Path, urdf: Path | None = None) -> StudyDraft:
    """Write a draft study file from logs of one arm, whose joints `urdf` may place.

    Each guess has a comment with its reason; values that cannot be guessed are TODO. Raises
    InvalidInput if a log cannot be read or has no time column, if the logs name their columns
    differently, if they lack a joint of the URDF, or if `out` exists.
    """
    if out.exists():
        raise InvalidInput(
            "exists already",
            where=str(out),
            remedy="choose another file with --out, or move the existing file",
        )
    records = [read_record(path) for path in logs]
    fullest = find_fullest_record(records)
    logged = partial(find_logged_joints, records, fullest)
    robot = None if urdf is None else Robot.read(urdf, logged)
    mapping = map_channels(fullest, fullest, robot, records)
    _check_alike(records, fullest, mapping)
    for record in records:
        add_channels(mapping, record, fullest, robot)
    if any(record.source is not None and record.source.scale is None for record in records):
        for name, guess in mapping.guesses.items():
            if name.startswith(_RATE_CHANNELS):
                todo = "the factor depends on the sampling rate"
                mapping.guesses[name] = replace(guess, scale=None, todo=todo)
    experiments = propose_uses(records, mapping)
    text = study_text(
        [fullest, *(r for r in records if r is not fullest)], mapping, experiments, out
    )
    write_whole(out.parent, {out.name: text.encode()})
    return StudyDraft(
        path=out,
        joints=len(mapping.joints),
        channels=tuple(mapping.guesses),
        experiments=len(records),
        n_todos=count_todos(text),
        limit=mapping.limit,
        warnings=tuple(_warnings(records, mapping, experiments)),
        guesses=tuple(mapping.guesses.values()),
        todos=list_todos(text),
    )


def _warnings(
    records: Sequence[InspectedLog], mapping: Mapping, experiments: Sequence[ExperimentProposal]
) -> Iterator[str]:
    """Yield the warnings that the user needs before completing the study."""
    for record in records:
        for fault in record.faults:
            yield f"{record.path.name}: {fault}"
    yield from mapping.warnings
    for channel, description in mapping.missing.items():
        yield f"no column was found for {channel}, {description}"
    for number, facts in enumerate(mapping.joints, start=1):
        guess = mapping.guesses.get(f"theta_m{number}")
        if guess is None or guess.scale is None:
            continue
        largest = max(float(np.ptp(record.columns[guess.column])) for record in records)
        if guess.scale * largest < _MIN_MOTION:
            name = f" ({facts.name})" if facts.name else ""
            yield f"joint {number}{name} stands still in all logs: record a motion of it"
    checked = {each.joint for each in experiments if each.use == "check"}
    joints = range(1, len(mapping.joints) + 1)
    unchecked = ", ".join(str(joint) for joint in joints if joint not in checked)
    if is_elastic(mapping, experiments) and unchecked:
        yield (
            f"no record validates the elastic model of joint {unchecked}: "
            "record two or more step responses of each joint alone (strainwave excite plans them)"
        )


def _check_alike(records: Sequence[InspectedLog], fullest: InspectedLog, mapping: Mapping) -> None:
    """Check that every log has the time, motor angle and input columns of [channels]."""
    required_columns = [
        guess.column
        for guess in mapping.guesses.values()
        if guess.channel.startswith(("theta_m", "u", "torque"))
    ]
    for record in records:
        missing_columns = [column for column in required_columns if column not in record.columns]
        if record.source != fullest.source:
            channel = fullest.source and fullest.source.channel
            missing_columns.append(channel.column if channel else "counter of rows")
        if missing_columns:
            raise InvalidInput(
                f"has no {', '.join(missing_columns)}, but {fullest.path.name} has",
                where=str(record.path),
                remedy="run init for each kind of log, or rename the columns",
            )
