"""Logs -> a study file to complete: `strainwave init`.

`inspection` reads what can be read; `names`, `signal_features` and `units` say what a column is,
`joints` whose it is; `joint_columns` and `axes` join what they say of one joint, `channels` of the
arm; `experiment_type` proposes what each record is for, and `written` writes it down with reasons.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import write_whole
from strainwave.study_draft.candidates import Mapping
from strainwave.study_draft.channels import add_channels, map_channels
from strainwave.study_draft.experiment_type import Proposed, propose, unchecked_joints
from strainwave.study_draft.inspection import Record, in_common, look_at
from strainwave.study_draft.written import is_elastic, study_text, todos

__all__ = ["Started", "start_study"]


@dataclass(frozen=True, slots=True)
class Started:
    """What was written."""

    path: Path
    joints: int
    channels: tuple[str, ...]
    experiments: int
    todos: int  # values to be filled in
    limit: str  # what of the logs is beyond the arms that can be identified; empty: nothing
    warnings: tuple[str, ...]


def start_study(logs: Sequence[Path], out: Path) -> Started:
    """Look at logs and write a study file with guesses, their reasons, and what is to be filled in.

    Parameters
    ----------
    logs : sequence of Path
        Of one rig.
    out : Path
        Never overwritten.

    Returns
    -------
    Started

    Raises
    ------
    InvalidInput
        A log cannot be read or has no time, the logs name their columns differently, or `out` is
        there already.
    """
    if out.exists():
        raise InvalidInput(
            "is there already, and would be overwritten",
            where=str(out),
            remedy="name another file with --out, or move it away",
        )
    records = [look_at(path) for path in logs]
    fullest = in_common(records)
    mapping = map_channels(fullest)
    _check_alike(records, fullest, mapping)
    for record in records:
        add_channels(mapping, record, fullest)
    elastic = any(facts.link_sensors for facts in mapping.joints)
    experiments = propose(records, mapping, elastic)
    if not elastic and any(each.prbs for each in experiments):
        experiments = propose(records, mapping, True)
    text = study_text(
        [fullest, *(r for r in records if r is not fullest)], mapping, experiments, out
    )
    write_whole(out.parent, {out.name: text.encode()})
    return Started(
        path=out,
        joints=len(mapping.joints),
        channels=tuple(mapping.guesses),
        experiments=len(records),
        todos=todos(text),
        limit=mapping.limit,
        warnings=tuple(_warnings(records, mapping, experiments)),
    )


def _warnings(
    records: Sequence[Record], mapping: Mapping, experiments: Sequence[Proposed]
) -> Iterator[str]:
    """What a person should know before the study is filled in."""
    for record in records:
        for fault in record.faults:
            yield f"{record.path.name}: {fault}"
    unchecked = unchecked_joints(experiments, len(mapping.joints))
    if is_elastic(mapping, experiments) and unchecked:
        yield (
            f"no record checks the elastic model of joint {', '.join(map(str, unchecked))}: record "
            "steps of each joint alone, two or more (strainwave excite plans them)"
        )


def _check_alike(records: Sequence[Record], fullest: Record, mapping: Mapping) -> None:
    """One [channels] serves all logs of a study; angles and inputs must be in every one."""
    needed = [
        guess.column
        for guess in mapping.guesses.values()
        if guess.channel.startswith(("theta_m", "u", "torque"))
    ]
    for record in records:
        lacking = [column for column in needed if column not in record.columns]
        if record.time_column != fullest.time_column:
            lacking.append(str(fullest.time_column))
        if lacking:
            raise InvalidInput(
                f"has no {', '.join(lacking)}, as {fullest.path.name} has",
                where=str(record.path),
                remedy="run init for each kind of log, or rename the columns",
            )
