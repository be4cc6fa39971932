"""Draft a study file from logs: `strainwave init`.

`inspection` reads the logs, and `robot` the joints of a URDF. `names` and `signal_features`
classify a column, `joints` assigns it to a joint, and `joint_columns` (angles) and `channels`
(inputs, sensors) map columns to channels. `experiment_type` proposes the use of each record. The
study file has a reason for each guess; unknown values are TODO.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from strainwave.errors import InvalidInput
from strainwave.init.channels import add_channels, map_channels
from strainwave.init.draft import TODO
from strainwave.init.experiment_type import ExperimentProposal, propose_uses
from strainwave.init.inspection import InspectedLog, read_record
from strainwave.init.joint_columns import Guess, Mapping
from strainwave.init.joints import find_logged_joints
from strainwave.init.robot import Robot
from strainwave.io.atomic_files import write_whole
from strainwave.io.system import relative_path
from strainwave.io.templates import fill_text

__all__ = ["StudyDraft", "draft_study", "start_study"]

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
    text: str  # of the file


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
    draft = draft_study(logs, out, urdf)
    write_whole(out.parent, {out.name: draft.text.encode()})
    return draft


def draft_study(logs: Sequence[Path], out: Path, urdf: Path | None = None) -> StudyDraft:
    """The draft that `start_study` writes; the paths in it are relative to the folder of `out`."""
    records = [read_record(path) for path in logs]
    # the record with the most varying columns classifies the columns of all
    fullest = max(records, key=lambda r: sum(np.ptp(v) > 0.0 for v in r.columns.values()))
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
        text=text,
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
                remedy="draft a study for each kind of log, or rename the columns",
            )


_WIDTH = 100  # [characters] maximum length of a line
_MAX_LISTED = 4  # names in a sentence


def study_text(
    records: Sequence[InspectedLog],
    mapping: Mapping,
    experiments: Sequence[ExperimentProposal],
    out: Path,
) -> str:
    """Return the text of a draft study file.

    `out` is the path of the study file; log paths are relative to its folder. A column that has the
    name of its channel needs no line in [channels] and may be missing in a log. [servo] is required
    if step records are compared with a simulation, else optional.
    """
    elastic = is_elastic(mapping, experiments)
    steps = [
        each.record.name
        for each in experiments
        if each.use in ("tuning", "check") and each.joint is not None and "servo" in each.control
    ]
    faults = (f"{each.path.name}: {fault}" for each in records for fault in each.faults)
    notes = dict.fromkeys(
        (mapping.limit, *mapping.notes, *mapping.warnings, *records[0].notes, *faults)
    )
    body = fill_text(
        Path(__file__).with_name("study.toml.j2"),
        mapping=mapping,
        kind=_kind(mapping),
        experiments=experiments,
        record=records[0],
        elastic=elastic,
        servo_steps=steps if elastic else [],
        direct=[
            g.channel for g in mapping.guesses.values() if g.column == g.channel and g.scale == 1.0
        ],
        notes=[note for note in notes if note],
        logs_without=lambda guess: [r.path.name for r in records if guess.column not in r.columns],
        of_bag=lambda guess: any(r.source is None and guess.column in r.columns for r in records),
        path_of=lambda path: relative_path(path, out.parent),
        entry=_entry,
        line=_line,
        listed=_listed,
        optional=lambda code, comment: f"# {code}".ljust(26) + f"  # {comment}",
        quoted=_quoted,
        quoted_list=lambda names: ", ".join(map(_quoted, names)),
        wrapped=_wrapped,
    )
    count = count_todos(body)
    todo = f"Complete it: {count} value(s) are {TODO}." if count else f"Nothing is {TODO}."
    head = _wrapped(
        f"Written by `strainwave init` from {_listed([r.path.name for r in records])}. {todo} All"
        " other values are guesses; each comment states the reason, and whether the guess is sure,"
        " likely or unsure. docs/study.md describes every key. When the file is complete, run"
    )
    commands = (f"check {out.name}", f"identify {out.name} --out results")
    return "\n".join([head, *(f"#     strainwave {each}" for each in commands), "", body])


def _kind(mapping: Mapping) -> str:
    """The simplest kind of arm for the joints; two axes are likely parallel."""
    n_joints = len(mapping.joints)
    slides = any(facts.prismatic for facts in mapping.joints)
    is_chain = mapping.urdf is not None or n_joints > 2 or (n_joints == 2 and slides)
    return "serial" if is_chain else "planar-two-link" if n_joints == 2 else "single-joint"


def count_todos(text: str) -> int:
    """Count the lines of a study file that have a TODO value, as its reader does."""
    return sum(TODO in line.split("#")[0] for line in text.splitlines())


def list_todos(text: str) -> tuple[str, ...]:
    """The lines of a study file with TODO values, each with its comment, in order."""
    todos, above = list[str](), ""
    for number, line in enumerate(text.splitlines(), start=1):
        code, _, comment = line.partition("#")
        if TODO in code:
            hint = textwrap.shorten(
                (comment or above).removeprefix(" TODO: "), _WIDTH - 30, placeholder=" ..."
            )
            todos.append(f"line {number:<3} {code.partition('=')[0].strip():16}  {hint}")
        above = f"{above} {comment.strip()}" if not code.strip() and comment else ""
    return tuple(todos)


def is_elastic(mapping: Mapping, experiments: Sequence[ExperimentProposal]) -> bool:
    """Whether the logs identify gear stiffness: a link sensor or a pseudo-random input exists."""
    if all(facts.joint_side for facts in mapping.joints):
        return False
    return mapping.shows_elasticity or any(each.prbs for each in experiments)


def _line(key: str, value: object, comment: str) -> str:
    """Return one line with its comment, or the comment above if the line is too long."""
    code = f"{key} = {value}"
    if len(code) + len(comment) + 4 <= _WIDTH:
        return f"{code:<26}  # {comment}"
    return f"{_wrapped(comment)}\n{code}"


def _wrapped(text: str) -> str:
    return textwrap.fill(text, _WIDTH, initial_indent="# ", subsequent_indent="# ")


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MAX_LISTED
    return ", ".join(names[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def _entry(column: str, scale: float | None, of_bag: bool, meaning: str = "") -> str:
    """Return the value of a channel in [channels]; a bag column is /topic.field[joint or index]."""
    value = TODO if scale is None else repr(float(scale))
    scaled = "" if scale == 1.0 else f", scale = {value}"
    scaled += f", meaning = {_quoted(meaning)}" if meaning else ""
    if not of_bag:
        name = _quoted(column)
        return f"{{ column = {name}{scaled} }}" if scaled else name
    topic, _, rest = column.partition(".")
    text = f"{{ topic = {_quoted(topic)}, "
    if rest.endswith("]") and not rest[rest.rindex("[") + 1 : -1].isdecimal():
        at = rest.rindex("[")
        name = _quoted(rest[at + 1 : -1])
        return text + f"field = {_quoted(rest[:at])}, name = {name}{scaled} }}"
    return text + f"field = {_quoted(rest)}{scaled} }}"


def _quoted(text: str) -> str:
    """Return a TOML string; JSON escapes do not suffice, because TOML forbids a raw DEL."""
    import tomli_w

    return tomli_w.dumps({"text": text}).removeprefix("text = ").removesuffix("\n")
