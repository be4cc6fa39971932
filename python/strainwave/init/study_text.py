"""Write a study file from guesses, each with its reason; unknown values are TODO."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Sequence
from pathlib import Path

from strainwave.init.experiment_type import ExperimentProposal
from strainwave.init.inspection import InspectedLog
from strainwave.init.joint_columns import Mapping
from strainwave.io.templates import fill_text

TODO = "TODO"
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
        path_of=lambda path: os.path.relpath(path, out.parent).replace(os.sep, "/"),
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
    """Count the TODO values of a study file, without comments."""
    lines = [line.split("#")[0] for line in text.splitlines()]
    return sum(line.count(TODO) for line in lines)


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
