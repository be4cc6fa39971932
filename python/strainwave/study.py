"""study.toml -> Study, with every fault found here and told by file, line and key.

The records' own annotations are the constraints: pydantic checks each value against the type its
field has in `strainwave.records`. What one value cannot tell is checked after that: whether the
tables fit each other, and whether a number is of a size that its unit allows.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import re
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from strainwave.errors import InvalidInput
from strainwave.files import write_whole
from strainwave.records import Arm, Channel, Experiment, Joint, Servo, Study

T = TypeVar("T")

JOINTS = {"planar-two-link": 2, "single-joint": 1}
CHANNELS = ("u", "torque", "theta_m", "omega_m", "a", "theta_l", "deflection", "gyro", "ref")
"""Channels there is one of per joint; `t` stands alone."""

_TABLES = {
    "arm": Arm,
    "joint": Joint,
    "servo": Servo,
    "channels": Channel,
    "experiment": Experiment,
}


def read_study(path: Path | str, *, logs_exist: bool = True) -> Study:
    """Read and check a study file.

    Parameters
    ----------
    path : Path
    logs_exist : bool
        Whether every experiment's file must be there already.

    Returns
    -------
    Study

    Raises
    ------
    InvalidInput
        Anything in the file is at fault.
    """
    path = Path(path)
    data = read_bytes(path, "the study file")
    text = decode(data, path)
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InvalidInput(
            f"is not valid TOML ({error})", where=str(path), remedy="mend that line"
        ) from error
    reader = _Reader(path, text)
    study = reader.study(document, hashlib.sha256(data).hexdigest())
    _check_fit(study, reader)
    _check_sizes(study, reader)
    if logs_exist:
        _check_files(study, reader)
    return study


def write_study(study: Study, path: Path) -> None:
    """Write a study file that reads back equal.

    Parameters
    ----------
    study : Study
    path : Path

    Raises
    ------
    InvalidInput
        The file cannot be written.
    """
    import tomli_w

    document: dict[str, Any] = {
        "arm": _table(study.arm),
        "joint": [_table(joint) for joint in study.joints],
    }
    if study.servo is not None:
        document["servo"] = _table(study.servo)
    if study.channels:
        document["channels"] = {name: _table(channel) for name, channel in study.channels.items()}
    document["experiment"] = [_table(experiment) for experiment in study.experiments]
    write_whole(path.parent, {path.name: tomli_w.dumps(document).encode()})


def read_bytes(path: Path, what: str) -> bytes:
    """A file's bytes.

    Parameters
    ----------
    path : Path
    what : str
        What the file is, for the message.

    Returns
    -------
    bytes

    Raises
    ------
    InvalidInput
        There is no such file, or it cannot be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        near = _nearest(path.name, [p.name for p in path.parent.glob("*")])
        raise InvalidInput(
            f"{what} does not exist", where=str(path), remedy=f"check the name{near}"
        ) from error
    except IsADirectoryError as error:
        raise InvalidInput(
            f"{what} is a directory", where=str(path), remedy="name a file in it"
        ) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidInput(
            f"{what} cannot be read ({reason})", where=str(path), remedy="check its permissions"
        ) from error


def decode(data: bytes, path: Path) -> str:
    """Text of a UTF-8 file, with or without byte order mark.

    Parameters
    ----------
    data : bytes
    path : Path
        For the message.

    Returns
    -------
    str

    Raises
    ------
    InvalidInput
        The bytes are not UTF-8.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InvalidInput(
            f"is not UTF-8: byte 0x{data[error.start]:02x}",
            where=f"{path}, line {line}",
            remedy="save the file as UTF-8",
        ) from error


@dataclasses.dataclass(frozen=True)
class _Reader:
    """Turns tables into records, and knows where in the file things stand."""

    path: Path
    text: str

    def study(self, document: Mapping[str, Any], sha256: str) -> Study:
        self._known_keys(document, _TABLES, "")
        arm = self._one(document, "arm")
        joints = self._list(document, "joint")
        experiments = self._list(document, "experiment")
        if arm is None or not joints or not experiments:
            empty = "arm" if arm is None else "joint" if not joints else "experiment"
            name = "[arm]" if empty == "arm" else f"[[{empty}]]"
            raise InvalidInput(
                f"has no {name} table",
                where=str(self.path),
                remedy=f"add {name}; see docs/study.md",
            )
        servo = self._one(document, "servo")
        count = len(joints)
        return Study(
            path=self.path,
            sha256=sha256,
            arm=self.record(Arm, arm, "arm"),
            joints=tuple(self.record(Joint, table, "joint", i) for i, table in enumerate(joints)),
            servo=None if servo is None else self.record(Servo, servo, "servo"),
            channels=self._channels(self._one(document, "channels") or {}),
            experiments=tuple(
                self.record(Experiment, {"control": ["open"] * count} | table, "experiment", i)
                for i, table in enumerate(experiments)
            ),
        )

    def record(
        self, kind: type[T], table: Mapping[str, Any], name: str, index: int | None = None
    ) -> T:
        """One table as a record, each value checked against its field's annotation."""
        fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
        self._known_keys(table, fields, name, index)
        hints = get_type_hints(kind, include_extras=True)
        values = {}
        for key, field in fields.items():
            if key in table:
                values[key] = self._value(table[key], hints[key], name, index, key)
            elif (
                field.default is dataclasses.MISSING
                and field.default_factory is dataclasses.MISSING
            ):
                raise InvalidInput(
                    f"the key '{key}' is missing",
                    where=self.place(name, index),
                    remedy=f"add it: {key} = ...",
                )
        return kind(**values)

    def _value(self, value: Any, hint: Any, name: str, index: int | None, key: str) -> Any:
        from pydantic import ValidationError

        inner = [part for part in get_args(hint) if dataclasses.is_dataclass(part)]
        if inner and isinstance(value, dict):
            return self.record(inner[0], value, name, index)  # type: ignore[type-var]
        try:
            checked = _adapter(hint).validate_python(_tuples(value), strict=True)
        except (ValidationError, RecursionError) as error:
            said = error.errors()[0]["msg"] if isinstance(error, ValidationError) else "too deep"
            said = said.replace("Input should be ", "it should be ")
            raise InvalidInput(
                f"'{key}' is {_shown(value)}, but {said[0].lower() + said[1:]}",
                where=self.place(name, index, key),
                remedy="mend the value",
            ) from error
        if _not_finite(checked):
            raise InvalidInput(
                f"'{key}' is {_shown(value)}",
                where=self.place(name, index, key),
                remedy="give a finite number",
            )
        return checked

    def _channels(self, table: Mapping[str, Any]) -> dict[str, Channel]:
        channels = {}
        for name, entry in table.items():
            as_table = {"column": entry} if isinstance(entry, str) else entry
            if not isinstance(as_table, dict):
                raise InvalidInput(
                    f"'{name}' is {_shown(entry)}",
                    where=self.place("channels", None, name),
                    remedy='give a name, or { column = "...", scale = ..., offset = ... }',
                )
            channels[name] = self.record(Channel, as_table, "channels", None)
        return channels

    def _one(self, document: Mapping[str, Any], name: str) -> dict[str, Any] | None:
        table = document.get(name)
        if table is not None and not isinstance(table, dict):
            raise InvalidInput(
                f"[{name}] must stand once, as one table",
                where=self.place(name),
                remedy=f"write [{name}]",
            )
        return table

    def _list(self, document: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
        tables = document.get(name, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise InvalidInput(
                f"{name} must be a list of tables",
                where=self.place(name),
                remedy=f"write [[{name}]]",
            )
        return tables

    def _known_keys(
        self,
        table: Mapping[str, Any],
        known: Mapping[str, Any],
        name: str,
        index: int | None = None,
    ) -> None:
        for key in table:
            if key not in known:
                near = _nearest(key, known)
                listed = near or f"; known here: {', '.join(known)}"
                raise InvalidInput(
                    f"the key '{key}' is not known",
                    where=self.place(name, index, key),
                    remedy=f"remove or rename it{listed}",
                )

    def place(self, name: str = "", index: int | None = None, key: str | None = None) -> str:
        """File, line and table, as a person looks for it."""
        line = self._line(name, index, key)
        at = f", line {line}" if line else ""
        table = f", [[{name}]] {index + 1}" if index is not None else f", [{name}]" if name else ""
        return f"{self.path}{at}{table}"

    def _line(self, name: str, index: int | None, key: str | None) -> int | None:
        """The line of a table's header, or of a key under it."""
        seen, inside, header = -1, name == "", None
        for number, line in enumerate(self.text.splitlines(), start=1):
            stripped = line.strip()
            if stripped.startswith("["):
                if stripped.split("#")[0].strip().strip("[] ") == name:
                    seen += 1
                    inside = index is None or seen == index
                    header = number if inside else header
                else:
                    inside = name == ""
            elif inside and key and re.match(rf'["\']?{re.escape(key)}["\']?\s*[=.]', stripped):
                return number
        return header


@cache
def _adapter(hint: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(hint)


def _tuples(value: Any) -> Any:
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value


def _not_finite(value: Any) -> bool:
    values = value if isinstance(value, tuple) else (value,)
    return any(isinstance(v, float) and v - v != 0.0 for v in values)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _nearest(name: str, known: Any) -> str:
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return f"; did you mean '{near[0]}'?" if near else ""


def _table(record: Any) -> dict[str, Any]:
    """A record's values that differ from their defaults, as TOML can hold them."""
    table: dict[str, Any] = {}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if value in (None, {}, field.default):
            continue
        if dataclasses.is_dataclass(value):
            value = _table(value)
        elif isinstance(value, tuple):
            value = list(value)
        table[field.name] = value
    return table


# --- what one value cannot tell ---------------------------------------------------------------


def _check_fit(study: Study, reader: _Reader) -> None:
    count = JOINTS[study.arm.kind]
    if study.n_joints != count:
        raise InvalidInput(
            f"a {study.arm.kind} arm has {count} joint(s), but there are {study.n_joints} "
            "[[joint]] tables",
            where=reader.place("joint"),
            remedy="write one [[joint]] for each joint, from the base",
        )
    if study.arm.kind == "planar-two-link":
        if study.arm.link_length is None:
            raise InvalidInput(
                "the key 'link_length' is missing",
                where=reader.place("arm"),
                remedy="add the distance from joint 1's axis to joint 2's [m]",
            )
        for index, joint in enumerate(study.joints):
            if joint.motion == "prismatic":
                raise InvalidInput(
                    "a planar two-link arm has revolute joints only",
                    where=reader.place("joint", index, "motion"),
                    remedy='use kind = "single-joint" for a prismatic joint',
                )
    elif study.joints[0].motion == "prismatic" and study.arm.gravity:
        raise InvalidInput(
            "a prismatic joint moves along x, across gravity",
            where=reader.place("arm", None, "gravity"),
            remedy="leave gravity out; a constant force shows as friction_offset",
        )
    if study.servo is not None:
        for key in ("kp", "ki"):
            _check_count(getattr(study.servo, key), count, reader.place("servo", None, key), key)
    _check_channels(study, reader)
    _check_experiments(study, reader, count)


def _check_count(values: tuple[Any, ...], count: int, place: str, key: str) -> None:
    if len(values) != count:
        raise InvalidInput(
            f"'{key}' has {len(values)} value(s), but the arm has {count} joint(s)",
            where=place,
            remedy="give one value for each joint",
        )


def channel_names(count: int) -> tuple[str, ...]:
    """Every channel an arm of `count` joints can have.

    Parameters
    ----------
    count : int

    Returns
    -------
    tuple of str
    """
    return ("t", *(f"{name}{i}" for name in CHANNELS for i in range(1, count + 1)))


def _check_channels(study: Study, reader: _Reader) -> None:
    known = channel_names(study.n_joints)
    named = [("channels", None, name) for name in study.channels]
    for index, experiment in enumerate(study.experiments):
        named += [("experiment", index, name) for name in experiment.add]
    for table, at, name in named:
        if name not in known:
            raise InvalidInput(
                f"'{name}' is no channel of this arm",
                where=reader.place(table, at, name),
                remedy=f"use one of {', '.join(known)}{_nearest(name, known)}",
            )
    for name, channel in study.channels.items():
        if channel.scale == 0.0:
            raise InvalidInput(
                f"the scale of '{name}' is zero",
                where=reader.place("channels", None, name),
                remedy="give the factor from the column's unit to SI",
            )


def _check_experiments(study: Study, reader: _Reader, count: int) -> None:
    seen: set[str] = set()
    for index, experiment in enumerate(study.experiments):
        if experiment.name in seen:
            raise InvalidInput(
                f"there are two experiments named {experiment.name!r}",
                where=reader.place("experiment", index, "name"),
                remedy="give each its own name",
            )
        seen.add(experiment.name)
        _check_count(
            experiment.control, count, reader.place("experiment", index, "control"), "control"
        )
        if experiment.joint is not None and experiment.joint > count:
            raise InvalidInput(
                f"there is no joint {experiment.joint}: the arm has {count}",
                where=reader.place("experiment", index, "joint"),
                remedy="joints are numbered from 1, from the base",
            )
        start, stop = experiment.start, experiment.stop
        if start is not None and stop is not None and stop <= start:
            raise InvalidInput(
                f"the window is empty: stop = {stop:g} s is not after start = {start:g} s",
                where=reader.place("experiment", index, "stop"),
                remedy="give a stop after the start, or leave it out",
            )


def _check_files(study: Study, reader: _Reader) -> None:
    for index, experiment in enumerate(study.experiments):
        path = study.log_path(experiment)
        try:
            there = path.exists()
        except (OSError, ValueError):
            there = False
        if not there:
            siblings = [p.name for p in study.path.parent.glob("*")]
            raise InvalidInput(
                f"the log file {experiment.file!r} does not exist",
                where=reader.place("experiment", index, "file"),
                remedy="put it beside the study file, or mend the name"
                + _nearest(experiment.file, siblings),
            )


# Sizes that no rig has. The limits are wide: they are to catch a unit or a ratio upside down, not
# to doubt an unusual machine. (key, smallest, largest, unit, factor of the likely slip, its name)
_JOINT_SIZES = (
    ("gear_ratio", 1e-4, 1.0, "link turns per motor turn", None, ""),
    ("torque_per_volt", 1e-6, 1e4, "N m/V at the motor", 1e-3, "mN m/V"),
    ("current_loop_hz", 5.0, 1e6, "Hz", 1e3, "kHz"),
    ("encoder_counts", 4.0, 1e9, "counts per motor turn", None, ""),
    ("accelerometer_distance", 1e-3, 10.0, "m", 1e-3, "mm"),
    ("accelerometer_hz", 1.0, 1e6, "Hz", 1e3, "kHz"),
    ("gyro_hz", 0.05, 1e6, "Hz", 1e3, "kHz"),
)
_ARM_SIZES = (
    ("link_length", 5e-3, 10.0, "m", 1e-3, "mm"),
    ("gravity", 0.0, 30.0, "m/s^2", 1e-3, "mm/s^2"),
)
_SERVO_SIZES = (("period", 1e-6, 0.2, "s", 1e-3, "ms"), ("limit", 1e-3, 1e4, "V", 1e-3, "mV"))
_PRBS_SIZES = (("clock", 1e-6, 5.0, "s", 1e-3, "ms"), ("order", 2, 24, "bits", None, ""))


def _check_sizes(study: Study, reader: _Reader) -> None:
    _sizes(study.arm, _ARM_SIZES, lambda key: reader.place("arm", None, key))
    for index, joint in enumerate(study.joints):
        _sizes(joint, _JOINT_SIZES, lambda key, i=index: reader.place("joint", i, key))
    if study.servo is not None:
        _sizes(study.servo, _SERVO_SIZES, lambda key: reader.place("servo", None, key))
    for index, experiment in enumerate(study.experiments):
        if experiment.prbs is not None:
            place = reader.place("experiment", index, "prbs")
            _sizes(experiment.prbs, _PRBS_SIZES, lambda _, place=place: place)


def _sizes(record: Any, sizes: Any, place: Any) -> None:
    for key, least, most, unit, slip, slip_unit in sizes:
        value = getattr(record, key)
        if value is None or least <= value <= most:
            continue
        if key == "gear_ratio" and value > most:
            meant = f"{1.0 / value:g} was probably meant: {unit}"
        elif (slip and least <= value * slip <= most) or (
            slip and slip_unit.startswith("k") and value * slip <= most
        ):
            meant = f"{value * slip:g} was probably meant, if {value:g} is in {slip_unit}"
        else:
            meant = f"expected {least:g} to {most:g}"
        raise InvalidInput(
            f"'{key}' is {value:g} {unit}, which no rig has",
            where=place(key),
            remedy=meant,
        )
