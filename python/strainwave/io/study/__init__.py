"""Read and write study files. Errors name file, line and key.

`reader` checks each value, `checks` checks the consistency of the tables.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
import tomllib
from collections.abc import Collection, Container, Mapping, Sequence
from pathlib import Path
from typing import Any

from strainwave.domain import Options, Study
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.steps import Step
from strainwave.domain.study import PUBLISHED_OPTIONS
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import decode, parse_toml, read_bytes, write_whole
from strainwave.io.study.checks import (
    check_consistency,
    check_files,
    check_options,
    check_sizes,
    detrendable_channels,
    without_gravity,
)
from strainwave.io.study.reader import PLACED_BY_URDF, Reader, parse_flag

__all__ = [
    "check_study",
    "copy_to",
    "detrendable_channels",
    "document_of",
    "read_study",
    "step_table",
    "with_options",
    "with_steps",
    "write_study",
]

AS_PUBLISHED = "as-published"
"""Text that stands for all options of the source."""

_TODO = re.compile(r'\s*(\w+)\s*=\s*(?:"?TODO\b|\[\s*TODO\b|\{[^#]*=\s*"?TODO\b)')


def read_study(
    path: Path | str,
    *,
    logs_exist: bool = True,
    experiments_exist: bool = True,
    of_load: bool = False,
) -> Study:
    """Read and check a study file.

    `logs_exist` states whether the log files must exist, `experiments_exist` whether there must be
    an experiment, `of_load` whether the records carry a load that is to be estimated. Raises
    InvalidInput if the file has a fault.
    """
    path = Path(path)
    data = read_bytes(path, "the study file")
    text = decode(data, path)
    _check_placeholders(text, path)
    document = parse_toml(text, path)
    reader = Reader(path, text)
    sha256 = hashlib.sha256(data).hexdigest()
    study = reader.study(document, sha256, experiments_exist=experiments_exist)
    check_consistency(study, reader, of_load=of_load)
    check_sizes(study, reader)
    if logs_exist:
        check_files(study, reader)
    return without_gravity(study, reader)


def with_options(
    study: Study, options: Options | Mapping[str, Mapping[str, Any]] | Sequence[str] | str
) -> Study:
    """A study with other options of the stages.

    `options` is a complete set of options, the changed options by stage and key, or texts
    "stage.key=value" with TOML values as on the command line. The text "as-published" selects the
    options and the gears of the source; options of the study that differ from the defaults, and
    later texts, override it. Raises InvalidInput if an option is unknown or has an invalid type or
    value.
    """
    if isinstance(options, Options):  # checked as those of a file are
        reader = Reader(study.path, "", flag="options")
        checked = reader.options(_table(options), Options())
        changed = dataclasses.replace(study, options=checked)
        check_options(changed, reader)
        return changed
    texts = [options] if isinstance(options, str) else list(options)
    if AS_PUBLISHED in texts:
        study = _as_published(study)
    given: dict[str, Mapping[str, Any]]
    if isinstance(options, Mapping):
        given = {f"options.{stage}": {stage: table} for stage, table in options.items()}
    else:
        given = {f"--set {text}": parse_flag(text) for text in texts if text != AS_PUBLISHED}
    for place, table in given.items():
        reader = Reader(study.path, "", flag=place)
        study = dataclasses.replace(study, options=reader.options(table, study.options))
        check_options(study, reader)
    return study


def _as_published(study: Study) -> Study:
    """The study with the options of the source, one stiffness per gear and no selected effects."""
    reader = Reader(study.path, "", flag=f"--{AS_PUBLISHED}")
    if not study.arm.has_planar_program:
        raise InvalidInput(
            f"the published method is for two-link arms and single joints, and the kind is "
            f"{study.arm.kind!r}",
            where=f"{study.path}, --{AS_PUBLISHED}",
            remedy=f"identify the arm without --{AS_PUBLISHED}",
        )
    arm = study.arm.with_joints(
        dataclasses.replace(
            joint, spring="linear" if joint.elastic else joint.spring, effects=joint.named_effects
        )
        for joint in study.arm.joints
    )
    options = reader.options(_table(study.options), PUBLISHED_OPTIONS)
    published = dataclasses.replace(study, arm=arm, options=options)
    check_options(published, reader)
    return published


def _check_placeholders(text: str, path: Path) -> None:
    """Raise InvalidInput if a TODO of `strainwave init` is left in the file."""
    placeholders = [
        (number, match[1])
        for number, line in enumerate(text.splitlines(), start=1)
        if (match := _TODO.match(line))
    ]
    if placeholders:
        listed = ", ".join(f"{key} (line {number})" for number, key in placeholders)
        raise InvalidInput(
            f"{len(placeholders)} value(s) are still TODO: {listed}",
            where=f"{path}, line {placeholders[0][0]}",
            remedy="enter the values; the comments next to them name the source",
        )


def check_study(study: Study, given: Collection[str] = (), *, of_load: bool = False) -> Study:
    """Check a study that was built or changed in memory as a study file is checked.

    `given` names the experiments whose data are passed in memory and need no file; `of_load` is
    that of `read_study`. A study that was
    not read from a file gets the SHA-256 of its text. Raises InvalidInput if a value has an invalid
    type or range, if the tables contradict each other, or if a log file does not exist.
    """
    import tomli_w

    named = tuple(
        dataclasses.replace(each, file=each.file or each.name) for each in study.experiments
    )
    text = tomli_w.dumps(document_of(dataclasses.replace(study, experiments=named)))
    reader = Reader(study.path, "")
    checked = reader.study(tomllib.loads(text), study.sha256)
    check_consistency(checked, reader, of_load=of_load)
    check_sizes(checked, reader)
    others = tuple(each for each in study.experiments if each.name not in given)
    for each in others:
        if not each.file:
            raise InvalidInput(
                f"the experiment {each.name!r} has no log",
                where=str(study.path),
                remedy="pass its data, or set its file",
            )
    check_files(dataclasses.replace(study, experiments=others), reader)
    sha256 = study.sha256 or hashlib.sha256(text.encode()).hexdigest()
    return dataclasses.replace(study, sha256=sha256)


def with_steps(study: Study, name: str, steps: Sequence[Any]) -> Study:
    """The study with other preprocessing steps of an experiment, as tables of a study file.

    Raises InvalidInput as `read_study` does.
    """
    document = document_of(study)
    for table in document["experiment"]:
        if table["name"] == name:
            table["steps"] = list(steps)
    reader = Reader(study.path, "")
    changed = reader.study(document, study.sha256)
    check_consistency(changed, reader)
    check_sizes(changed, reader)
    check_files(changed, reader)
    return changed


def write_study(study: Study, path: Path) -> None:
    """Write a study file that reads back equal.

    Raises InvalidInput if the file cannot be written.
    """
    import tomli_w

    write_whole(path.parent, {path.name: tomli_w.dumps(document_of(study)).encode()})


def copy_to(study: Study, folder: Path) -> Study:
    """The study with its file in another folder, to which the URDF of its arm is copied.

    Raises InvalidInput if the URDF cannot be read or written.
    """
    copy = dataclasses.replace(study, path=folder / "study.toml")
    urdf = study.arm.urdf
    if urdf is None:
        return copy
    name = Path(urdf.file).name
    write_whole(folder, {name: read_bytes(study.path.parent / urdf.file, "the URDF")})
    arm = dataclasses.replace(study.arm, urdf=dataclasses.replace(urdf, file=name))
    return dataclasses.replace(copy, arm=arm)


def document_of(study: Study) -> dict[str, Any]:
    """A study as tables of a study file, without values that equal their defaults."""
    placed: tuple[str, ...] = ("origin", "axis") if kind_of(study.arm).places_joints else ()
    if study.arm.urdf is not None:
        placed = PLACED_BY_URDF
    document: dict[str, Any] = {
        "arm": {"kind": study.arm.kind, **_table(kind_of(study.arm).table_of(study.arm))},
        "joint": [_table(joint, without=placed) for joint in study.arm.joints],
    }
    if study.arm.coupling is not None:
        document["transmission"] = {"coupling": [list(row) for row in study.arm.coupling]}
    servo = study.arm.servo or study.arm.position_servo
    if servo is not None:
        document["servo"] = _table(servo)
    if study.channels or study.sample_rate is not None:
        document["channels"] = {
            name: _table(each, without=("second_column",))
            | ({"column": list(each.columns)} if each.second_column else {})
            for name, each in study.channels.items()
        }
    if study.sample_rate is not None:
        document["channels"]["sample_rate"] = study.sample_rate
    document["experiment"] = [_table(experiment) for experiment in study.experiments]
    options = _table(study.options)
    if options:
        document["options"] = options
    return document


def step_table(step: Step) -> dict[str, Any]:
    """A preprocessing step as a table of a study file."""
    return {"kind": step.kind, **_table(step)}


def _table(record: Any, without: Container[str] = ()) -> dict[str, Any]:
    """Values of a record that differ from their defaults, as TOML values."""
    table: dict[str, Any] = {}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if field.name in without or value in (None, {}, field.default):
            continue
        if field.name == "steps":
            value = list(map(step_table, value))
        elif dataclasses.is_dataclass(value):
            value = _table(value)
        elif isinstance(value, tuple):
            value = list(value)
        table[field.name] = value
    return table
