"""Convert tables of a study file to records and check each value.

Pydantic checks each value against the annotation of its field in `strainwave.domain`.

Options that are not in a file: `--set STAGE.KEY=VALUE`, or arguments of a function.
"""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_args, get_type_hints

from annotated_types import MinLen

from strainwave.domain import (
    ArmDescription,
    Channel,
    Experiment,
    Joint,
    Options,
    Origin,
    PositionServo,
    Servo,
    Study,
    Urdf,
)
from strainwave.domain.arm import effects, gear_laws
from strainwave.domain.arm.description import POSITION, SERVOS, Matrix, Positive
from strainwave.domain.arm.kinds import KINDS, Kind
from strainwave.domain.messages import fault_codes
from strainwave.domain.steps import STEPS, Step
from strainwave.errors import InvalidInput, suggest_name
from strainwave.io.urdf import UrdfJoint, read_urdf

T = TypeVar("T")

_Text = Annotated[str, MinLen(1)]
_OF_TOPIC: Mapping[str, Any] = {"topic": _Text, "field": _Text, "name": str | None}
_PLACED_BY_KIND: Mapping[str, Any] = {"origin": Origin(), "axis": (0.0, 0.0, 1.0)}

PLACED_BY_URDF = ("origin", "axis", "name", "limits")
"""Keys of a joint that a URDF determines."""

_TABLES = ("arm", "joint", "transmission", "servo", "channels", "experiment", "options")


@dataclasses.dataclass(frozen=True)
class Reader:
    """Converts tables to records and finds the place of a key in the file."""

    path: Path
    text: str
    is_result: bool = False  # tables of result.json, with keys that identification adds
    flag: str = ""  # place of a table that is not in a file: "--set links.order=1"

    def study(
        self, document: Mapping[str, Any], sha256: str, *, experiments_exist: bool = True
    ) -> Study:
        """The study of a parsed file. `sha256` is the hash of the file.

        Raises InvalidInput if a table or key is missing or unknown, or if a value has an invalid
        type or range.
        """
        self._check_keys(document, _TABLES, "")
        arm = self._one(document, "arm")
        joints = self._list(document, "joint")
        experiments = self._list(document, "experiment")
        if arm is None or not joints or (experiments_exist and not experiments):
            empty = "arm" if arm is None else "joint" if not joints else "experiment"
            name = "[arm]" if empty == "arm" else f"[[{empty}]]"
            raise InvalidInput(
                f"there is no {name} table",
                where=str(self.path),
                remedy=f"add {name}; see docs/study.md",
            )
        count = len(joints)
        channels = dict(self._one(document, "channels") or {})
        rate = channels.pop("sample_rate", None)
        if rate is not None:
            rate = self._value(rate, Positive, "channels", None, "sample_rate")
        return Study(
            path=self.path,
            sha256=sha256,
            arm=self._arm(arm, joints, document),
            channels=self._channels(channels),
            sample_rate=rate,
            experiments=tuple(
                self._experiment({"control": ["open"] * count} | table, i)
                for i, table in enumerate(experiments)
            ),
            options=self.options(self._one(document, "options") or {}, Options()),
        )

    def _experiment(self, table: dict[str, Any], index: int) -> Experiment:
        """One `[[experiment]]`; each of its steps is a record by its kind."""
        tables, steps = table.pop("steps", []), list[Step]()
        place = "experiment", index, "steps"
        if not isinstance(tables, list) or not all(isinstance(each, dict) for each in tables):
            raise InvalidInput(
                f"'steps' is {_abbreviated(tables)}, but it should be a list of tables",
                where=self.place(*place),
                remedy='write, for example, steps = [{ kind = "lowpass", cutoff_hz = 80.0 }]',
            )
        for each in tables:
            kind = each.get("kind")
            self._check_registered([kind], [*STEPS], kind, "experiment", index, "kind")
            rest = {key: value for key, value in each.items() if key != "kind"}
            try:
                steps.append(self.record(STEPS[kind], rest, "experiment", index))
            except InvalidInput as error:
                problem = f"step {len(steps) + 1} ({kind}): {error.problem}"
                where = self.place(*place)
                raise InvalidInput(problem, where=where, remedy=error.remedy) from error
        experiment = self.record(Experiment, table, "experiment", index, steps=())
        return dataclasses.replace(experiment, steps=tuple(steps))

    def options(self, table: Mapping[str, Any], previous: Options) -> Options:
        """Options from tables by stage, on top of previous options.

        Raises InvalidInput if a stage or option is unknown, or if a value has an invalid type or
        range.
        """
        stages = {f.name: getattr(previous, f.name) for f in dataclasses.fields(previous)}
        self._check_keys(table, stages, "options")
        for stage, changes in table.items():
            if stage == "accept":
                stages[stage] = self._accepted(changes)
                continue
            if not isinstance(changes, dict):
                raise InvalidInput(
                    f"'{stage}' is {_abbreviated(changes)}",
                    where=self.place("options", None, stage),
                    remedy=f"write a table of options: {stage} = {{ ... }}",
                )
            checked = self.record(type(stages[stage]), changes, f"options.{stage}")
            given = {key: getattr(checked, key) for key in changes}
            stages[stage] = dataclasses.replace(stages[stage], **given)
        return Options(**stages)

    def _accepted(self, codes: Any) -> tuple[str, ...]:
        for code in codes if isinstance(codes, list | tuple) else [codes]:
            if code not in fault_codes():
                raise InvalidInput(
                    f"'accept' has the code {code!r}, which no suspected fault has",
                    where=self.place("options", None, "accept"),
                    remedy=f"write a list of codes: {', '.join(fault_codes())}",
                )
        return tuple(codes)

    def record(
        self,
        kind: type[T],
        table: Mapping[str, Any],
        name: str,
        index: int | None = None,
        /,
        **elsewhere: Any,
    ) -> T:
        """One table as a record, each value checked against the annotation of its field.

        `elsewhere` holds fields that come from other tables.
        """
        all_fields = dataclasses.fields(kind)  # type: ignore[arg-type]
        fields = {f.name: f for f in all_fields if f.name not in elsewhere}
        self._check_keys(table, fields, name, index)
        hints = get_type_hints(kind, include_extras=True)
        values = {}
        for key, field in fields.items():
            if key in table:
                values[key] = self._value(table[key], hints[key], name, index, key)
            elif (
                field.default is dataclasses.MISSING
                and field.default_factory is dataclasses.MISSING
            ):
                raise self._missing(key, name, index)
        return kind(**values, **elsewhere)

    def _missing(self, key: str, name: str, index: int | None = None) -> InvalidInput:
        return InvalidInput(
            f"the key '{key}' is missing",
            where=self.place(name, index),
            remedy=f"add it: {key} = ...",
        )

    def _arm(
        self,
        arm: Mapping[str, Any],
        joints: Sequence[Mapping[str, Any]],
        document: Mapping[str, Any],
    ) -> ArmDescription:
        """The arm from `[arm]`, its `[[joint]]` tables, `[transmission]` and `[servo]`."""
        if "kind" not in arm:
            raise self._missing("kind", "arm")
        name = arm["kind"]
        self._check_registered([name], [*KINDS], name, "arm", None, "kind")
        kind = KINDS[name]
        table = self.record(kind.table, {k: v for k, v in arm.items() if k != "kind"}, "arm")
        file: str = getattr(table, "urdf", None) or ""
        held: tuple[str, ...] = getattr(table, "held", ())
        urdf = self._urdf(file, held, len(joints)) if file else ()
        described = []
        for index, joint in enumerate(joints):
            placed = self._placed(kind, joint, index, urdf)
            motion = {"motion": self._motion(joint, index, urdf[index])} if urdf else {}
            described.append(self._joint({**joint, **motion}, index, placed))
        self._check_names(described)
        for fault in kind.faults(table, described):
            raise InvalidInput(
                fault.problem,
                where=self.place(fault.table, fault.index, fault.key),
                remedy=fault.remedy,
            )
        servo = self._servo(self._one(document, "servo"))
        velocity = servo if isinstance(servo, Servo) else None
        description = kind.construct(table, described, velocity)
        coupling = self._coupling(kind, self._one(document, "transmission"))
        return dataclasses.replace(
            description,
            coupling=coupling or description.coupling,
            urdf=Urdf(file, tuple(joint.prior for joint in urdf), held) if file else None,
            position_servo=servo if isinstance(servo, PositionServo) else None,
        )

    def _servo(self, table: Mapping[str, Any] | None) -> Servo | PositionServo | None:
        if table is None:
            return None
        name = table.get("kind")
        if name is not None:
            self._check_registered([name], [*SERVOS], name, "servo", None, "kind")
        if name == POSITION:
            return self.record(PositionServo, table, "servo")
        return self.record(Servo, table, "servo")

    def _check_names(self, joints: Sequence[Joint]) -> None:
        for index, joint in enumerate(joints):
            if joint.name in [other.name for other in joints[:index] if other.name]:
                raise InvalidInput(
                    f"two joints have the name {joint.name!r}",
                    where=self.place("joint", index, "name"),
                    remedy="rename one of them",
                )

    def _placed(
        self, kind: Kind[Any], joint: Mapping[str, Any], index: int, urdf: Sequence[UrdfJoint]
    ) -> Mapping[str, Any]:
        """Values of the keys of a joint that its kind or the URDF places."""
        placed: Mapping[str, Any] = {}
        if kind.places_joints:
            placed = _PLACED_BY_KIND
        elif urdf:
            placed = {key: getattr(urdf[index], key) for key in PLACED_BY_URDF}
        for key in placed.keys() & joint.keys():
            placer = "the URDF" if urdf else f"the kind {kind.name}"
            raise InvalidInput(
                f"'{key}' is given, but {placer} determines it",
                where=self.place("joint", index, key),
                remedy=f"remove {key}" if urdf else 'remove it, or use kind = "serial"',
            )
        return placed

    def _motion(self, joint: Mapping[str, Any], index: int, urdf: UrdfJoint) -> str:
        """The motion of a joint in the URDF, which the study may repeat."""
        if joint.get("motion", urdf.motion) != urdf.motion:
            raise InvalidInput(
                f"'motion' is {_abbreviated(joint['motion'])}, but the joint {urdf.name!r} of the "
                f"URDF is {urdf.motion}",
                where=self.place("joint", index, "motion"),
                remedy="remove motion, or correct the URDF",
            )
        return urdf.motion

    def _coupling(self, kind: Kind[Any], table: Mapping[str, Any] | None) -> Matrix | None:
        """Coupling of `[transmission]`, which kinds that place their joints do not have."""
        if table is None:
            return None
        if kind.places_joints:
            raise InvalidInput(
                f"motors of a {kind.name} arm are not coupled",
                where=self.place("transmission"),
                remedy='remove [transmission], or describe the arm with kind = "serial"',
            )
        self._check_keys(table, ("coupling",), "transmission")
        if "coupling" not in table:
            raise self._missing("coupling", "transmission")
        coupling: Matrix = self._value(table["coupling"], Matrix, "transmission", None, "coupling")
        return coupling

    def _urdf(self, file: str, held: Sequence[str], count: int) -> tuple[UrdfJoint, ...]:
        """The joints of the URDF file, which must be as many as there are `[[joint]]` tables."""
        joints = read_urdf(self.path.parent / file, held)
        if len(joints) != count:
            names = ", ".join(joint.name for joint in joints)
            raise InvalidInput(
                f"{len(joints)} joints move in {file} ({names}), but there are {count} [[joint]] "
                "tables",
                where=self.place("arm", None, "urdf"),
                remedy="write one table for each of them, from the base, or set the types of "
                'joints that stand still in all logs to "fixed" in the URDF; held lists those at '
                "zero",
            )
        return joints

    def _joint(self, table: Mapping[str, Any], index: int, placed: Mapping[str, Any]) -> Joint:
        """One `[[joint]]` whose spring and effects are registered.

        `placed` has the values of the keys that the kind or a URDF places.
        """
        spring, names = table.get("spring"), table.get("effects")
        if spring is not None:
            known = (gear_laws.AUTO, *gear_laws.LAWS)
            self._check_registered([spring], known, spring, "joint", index, "spring")
        if isinstance(names, str) and names != "auto":
            raise InvalidInput(
                f"'effects' is {_abbreviated(names)}, but it should be a list of effects or "
                '"auto"',
                where=self.place("joint", index, "effects"),
                remedy='write a list such as effects = ["stribeck"], or effects = "auto"',
            )
        if isinstance(names, list):
            self._check_registered(names, effects.study_names(), names, "joint", index, "effects")
        if not self.is_result:
            placed = {**placed, "torque_at_link": False}
        return self.record(Joint, table, "joint", index, **placed)

    def _check_registered(
        self, names: Sequence[Any], known: Sequence[str], value: Any, *place: Any
    ) -> None:
        """Raise InvalidInput if a value contains a name that is not registered."""
        *others, last = [repr(name) for name in known]
        for unknown in (name for name in names if name not in known):
            near = suggest_name(unknown, known) if isinstance(unknown, str) else ""
            raise InvalidInput(
                f"'{place[-1]}' is {_abbreviated(value)}, but it should be "
                f"{', '.join(others)} or {last}",
                where=self.place(*place),
                remedy=f"correct the value{near}",
            )

    def _value(self, value: Any, hint: Any, name: str, index: int | None, key: str) -> Any:
        from pydantic import ValidationError

        kinds: tuple[Any, ...] = (hint, *get_args(hint))
        inner = [kind for kind in kinds if dataclasses.is_dataclass(kind)]
        if inner and isinstance(value, dict):
            return self.record(cast(type, inner[0]), value, name, index)
        if dataclasses.is_dataclass(hint):
            raise InvalidInput(
                f"'{key}' is {_abbreviated(value)}, but it should be a table",
                where=self.place(name, index, key),
                remedy=f"write {key} = {{ ... }}",
            )
        try:
            checked = _adapter(hint).validate_python(_lists_to_tuples(value))
            if isinstance(value, bool) and not isinstance(checked, bool):
                raise TypeError("it should be a number")  # Python compares True equal to 1
        except (ValidationError, RecursionError, TypeError) as error:
            reason = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
            if isinstance(error, ValidationError):
                reason = error.errors()[0]["msg"].replace("Input should be ", "it should be ")
            raise InvalidInput(
                f"'{key}' is {_abbreviated(value)}, but {reason[0].lower() + reason[1:]}",
                where=self.place(name, index, key),
                remedy="correct the value",
            ) from error
        return checked

    def _channels(self, table: Mapping[str, Any]) -> dict[str, Channel]:
        channels = {}
        for name, entry in table.items():
            as_table = {"column": entry} if isinstance(entry, str) else entry
            if not isinstance(as_table, dict):
                raise InvalidInput(
                    f"'{name}' is {_abbreviated(entry)}",
                    where=self.place("channels", None, name),
                    remedy='write a name, or { column = "...", scale = ..., offset = ... }',
                )
            columns, second = as_table.get("column"), None
            if name == "t" and isinstance(columns, list) and len(columns) == 2:
                as_table = as_table | {"column": columns[0]}
                second = self._value(columns[1], str, "channels", None, name)
            if "topic" in as_table:
                as_table = self._column_of_topic(as_table)
            channel = self.record(Channel, as_table, "channels", second_column=second)
            is_sensor = channel.meaning == "sensor"
            if channel.meaning != "motor" and not name.startswith(("torque", "tau_l")):
                raise InvalidInput(
                    f"'{name}' has a meaning, but only torque channels have one",
                    where=self.place("channels", None, name),
                    remedy="remove meaning",
                )
            channels[name.replace("torque", "tau_l") if is_sensor else name] = channel
        return channels

    def _column_of_topic(self, table: Mapping[str, Any]) -> dict[str, Any]:
        """The table of a channel in a bag, with the column name that the bag's reader assigns.

        `field` is the path of one number in each message of `topic`: "position", "data[0]",
        "a.b.c". If it has one number per joint, `name` is that of the joint.
        """
        self._check_keys(table, (*_OF_TOPIC, "scale", "offset", "meaning"), "channels")
        if "field" not in table:
            raise self._missing("field", "channels")
        topic, field, name = (
            self._value(table.get(key), hint, "channels", None, key)
            for key, hint in _OF_TOPIC.items()
        )
        column = f"{topic}.{field}" + ("" if name is None else f"[{name}]")
        return {"column": column, **{k: v for k, v in table.items() if k not in _OF_TOPIC}}

    def _one(self, document: Mapping[str, Any], name: str) -> dict[str, Any] | None:
        table = document.get(name)
        if table is not None and not isinstance(table, dict):
            raise InvalidInput(
                f"[{name}] must be one table", where=self.place(name), remedy=f"write [{name}]"
            )
        return table

    def _list(self, document: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
        tables = document.get(name, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise InvalidInput(
                f"[[{name}]] must be a list of tables",
                where=self.place(name),
                remedy=f"write [[{name}]]",
            )
        return tables

    def _check_keys(
        self,
        table: Mapping[str, Any],
        known: Collection[str],
        name: str,
        index: int | None = None,
    ) -> None:
        for key in table:
            if key not in known:
                near = suggest_name(key, known)
                hint = near or f"; the known keys are {', '.join(known)}"
                raise InvalidInput(
                    f"the key '{key}' is unknown",
                    where=self.place(name, index, key),
                    remedy=f"remove or rename it{hint}",
                )

    def place(self, name: str = "", index: int | None = None, key: str | None = None) -> str:
        """File, line and table of a key, as text; or the flag."""
        if self.flag:
            return self.flag
        line = self._line(name, index, key)
        line_text = f", line {line}" if line else ""
        table = f", [[{name}]] {index + 1}" if index is not None else f", [{name}]" if name else ""
        return f"{self.path}{line_text}{table}"

    def _line(self, name: str, index: int | None, key: str | None) -> int | None:
        """Line of a table's header, or of a key in the table."""
        outer, _, inner = name.rpartition(".")
        if outer and self._header(name, index, None) is None:  # an inline table
            return self._line(outer, index, inner)
        return self._header(name, index, key)

    def _header(self, name: str, index: int | None, key: str | None) -> int | None:
        count, inside, header = -1, name == "", None
        for number, line in enumerate(self.text.splitlines(), start=1):
            stripped = line.strip()
            if stripped.startswith("["):
                if stripped.split("#")[0].strip().strip("[] ") == name:
                    count += 1
                    inside = index is None or count == index
                    header = number if inside else header
                else:
                    inside = name == ""
            elif inside and key and re.match(rf'["\']?{re.escape(key)}["\']?\s*[=.]', stripped):
                return number
        return header


@cache
def _adapter(hint: Any) -> Any:
    from pydantic import ConfigDict, TypeAdapter

    return TypeAdapter(hint, config=ConfigDict(strict=True, allow_inf_nan=False))


def _lists_to_tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _lists_to_tuples(entry) for name, entry in value.items()}
    return tuple(_lists_to_tuples(v) for v in value) if isinstance(value, list) else value


def _abbreviated(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


_FLAG = re.compile(r"\s*(\w+)\.(\w+)\s*=\s*(.*\S)\s*", re.DOTALL)
_WORD = re.compile(r"[A-Za-z][\w-]*")


def parse_flag(text: str) -> dict[str, Any]:
    """Table by stage and key of a flag "STAGE.KEY=VALUE" with a TOML value or a bare word.

    Raises InvalidInput if the text has another form or the value is not valid TOML.
    """
    if text.startswith("accept="):
        return {"accept": text.removeprefix("accept=").split(",")}
    match = _FLAG.fullmatch(text)
    if match is None:
        raise InvalidInput(
            "the option does not have the form STAGE.KEY=VALUE",
            where=f"--set {text}",
            remedy="write, for example, --set links.time_constant=0.1",
        )
    stage, key, value = match.groups()
    if _WORD.fullmatch(value) and value not in ("true", "false", "inf", "nan"):
        return {stage: {key: value}}
    try:
        document = tomllib.loads(f"value = {value}")
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InvalidInput(
            f"{value!r} is not a TOML value ({error})",
            where=f"--set {text}",
            remedy="write a number, true, a word, [a, b] or { name = [a, b] }, in shell quotes",
        ) from error
    if set(document) != {"value"}:
        raise InvalidInput(
            "the option has more than one value",
            where=f"--set {text}",
            remedy="repeat --set for each value",
        )
    return {stage: {key: document["value"]}}
