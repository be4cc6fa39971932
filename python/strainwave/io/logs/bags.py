"""Read ROS 2 bags (directories, .mcap, .db3) and ROS 1 bags into tracks.

A column of a bag is named `/topic.field`, with `[index]` for an element of an array, or `[joint]`
if the message contains joint names.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from strainwave.domain import Diagnostic, IntArray, Place
from strainwave.errors import InvalidInput, import_optional, suggest_name
from strainwave.io.logs.clocks import Track

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


_FieldPath = tuple[str, ...]  # in a message: field names, and indices or joint names after `[`

_MAX_ARRAY_ELEMENTS = 64  # maximum number of array elements that become columns
_IGNORED_FIELDS = ("header", "layout")  # fields that are not columns
_STEP = re.compile(r"([^.\[\]]+)|\[([^\]]*)\]")
_ELEMENT = "["  # prefix of an index or joint name in a path


def _parse_field(text: str) -> _FieldPath:
    """Parse a field such as "position[joint1]", "data[0]" or "linear_acceleration.y"."""
    return tuple(name or _ELEMENT + inside for name, inside in _STEP.findall(text))


def _read_number(message: Any, path: _FieldPath) -> float | None:
    """Return the number at a path, or None if the message has none."""
    value = message
    try:
        for step in path:
            if not step.startswith(_ELEMENT):
                value = getattr(value, step)
                continue
            inside, names = step[1:], _joint_names(message) if isinstance(value, np.ndarray) else []
            value = value[names.index(inside) if inside in names else int(inside)]
        return float(value)
    except (IndexError, ValueError, AttributeError, TypeError):
        return None


def _joint_names(message: Any) -> list[str]:
    names = getattr(message, "name", None) or getattr(message, "joint_names", None) or []
    return [str(name) for name in names] if isinstance(names, (list, tuple)) else []


def _read_stamp(message: Any) -> int:
    """Return the stamp of the header [ns], or 0 if it is missing or not set."""
    header = getattr(message, "header", None)
    if header is None:
        return 0
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _number_names(value: Any, prefix: str, joints: list[str]) -> Iterator[str]:
    if isinstance(value, (bool, int, float)):
        yield prefix
    elif isinstance(value, np.ndarray):
        if value.dtype.kind in "fiub":
            indices = range(min(len(value), _MAX_ARRAY_ELEMENTS))
            named = joints if len(joints) == len(value) else indices
            yield from (f"{prefix}[{each}]" for each in named)
    elif isinstance(value, list):
        if len(value) <= _MAX_ARRAY_ELEMENTS:
            for k, each in enumerate(value):
                yield from _number_names(each, f"{prefix}[{k}]", [])
    elif dataclasses.is_dataclass(value):
        for name in (each.name for each in dataclasses.fields(value)):
            if name not in _IGNORED_FIELDS and not name.endswith("covariance"):
                inner = f"{prefix}.{name}" if prefix else name
                yield from _number_names(getattr(value, name), inner, joints)


BAG_SUFFIXES = (".mcap", ".db3", ".bag")
"""Suffixes of bag files."""
# messages per topic that are inspected; several nodes may share a topic
_MAX_INSPECTED_MESSAGES = 20
_MAX_LISTED_NAMES = 24  # maximum number of names in an error message
_SECONDS_PER_NS = 1e-9  # [s] per ns
_MAX_CLOCK_DIFFERENCE = 1.0  # [s] between header and recorder stamps; network delay is shorter


def is_bag(path: Path) -> bool:
    """Whether a log is a bag: a directory, or a file with a suffix in BAGS."""
    return path.is_dir() or path.name.lower().endswith(BAG_SUFFIXES)


@dataclass(frozen=True, slots=True)
class _Topic:
    """Summary of a topic from its first messages."""

    kind: str  # message type
    count: int  # number of messages
    names: tuple[str, ...]  # names of columns; empty if the topic has no messages
    unreadable: str | None = None  # reason


@dataclass(slots=True)
class _TopicContent:
    """Requested content of a topic's messages."""

    headers: list[int] = field(default_factory=list)  # [ns], 0 if a message has no stamp
    recorded: list[int] = field(default_factory=list)  # [ns]
    values: dict[str, list[float]] = field(default_factory=dict)
    rows: dict[str, list[int]] = field(default_factory=dict)  # indices of messages with a value


class Bag:
    """Columns of a bag by name, read on demand.

    Raises InvalidInput if the path is not a bag, if the bag is damaged, or if rosbags is not
    installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._topics = self._inspect_topics()
        self.names = tuple(name for topic in self._topics.values() for name in topic.names)

    def _inspect_topics(self) -> dict[str, _Topic]:
        topics = {}
        with _opened(self.path) as reader:
            for name, info in sorted(reader.topics.items()):
                names: dict[str, None] = {}
                unreadable = None
                try:
                    first = islice(reader.messages(info.connections), _MAX_INSPECTED_MESSAGES)
                    for connection, _, raw in first:
                        message = reader.deserialize(raw, connection.msgtype)
                        names |= dict.fromkeys(_number_names(message, "", _joint_names(message)))
                # foreign definitions can be invalid in any way
                except Exception as error:
                    unreadable = f"{type(error).__name__}: {error}".splitlines()[0][:100]
                columns = tuple(f"{name}.{each}" for each in names)
                topics[name] = _Topic(info.msgtype or "mixed", info.msgcount, columns, unreadable)
        return topics

    def tracks(self, column_names: Iterable[str]) -> tuple[list[Track], list[Diagnostic]]:
        """Return the requested columns; columns of the same messages form one track.

        Time stamps are those of the headers if all messages of a topic have one, else the
        recorder's; zero is the earliest. Raises InvalidInput if the bag is damaged or if header and
        recorder clocks differ.
        """
        topics: dict[str, list[str]] = {}
        for column in column_names:
            topics.setdefault(topic_of(column), []).append(column)
        with _opened(self.path) as reader:
            contents = _read_messages(reader, topics)
        stamped = {name for name, each in contents.items() if all(each.headers)}
        warnings = self._check_clocks(contents, stamped)
        stamps = {
            name: np.array(each.headers if name in stamped else each.recorded, dtype=np.int64)
            for name, each in contents.items()
        }
        zero = min(int(each.min()) for each in stamps.values())
        tracks = []
        for name, each in contents.items():
            tracks += self._split(name, each, stamps[name] - zero, warnings)
        return tracks, warnings

    def _split(
        self, topic: str, contents: _TopicContent, stamps: IntArray, warnings: list[Diagnostic]
    ) -> list[Track]:
        """Split a topic into tracks of columns that share their messages, sorted by time stamp."""
        columns_by_rows: dict[tuple[int, ...], list[str]] = {}
        for column, message_rows in contents.rows.items():
            columns_by_rows.setdefault(tuple(message_rows), []).append(column)
        tracks = []
        for row_tuple, columns in columns_by_rows.items():
            rows = np.array(row_tuple)
            order, n_late, n_equal = _sort_stamps(stamps[rows])
            if n_late or n_equal:
                place, counts = Place(file=self.path.name), {"n_late": n_late, "n_equal": n_equal}
                warnings.append(Diagnostic("reordered", place, topic=topic, **counts))
            time = stamps[rows][order] * _SECONDS_PER_NS
            values = {column: np.array(contents.values[column])[order] for column in columns}
            tracks.append(Track(topic, time, values, partial(_message_name, rows[order])))
        return tracks

    def _check_clocks(
        self, contents: dict[str, _TopicContent], stamped: set[str]
    ) -> list[Diagnostic]:
        unstamped = sorted(set(contents) - stamped)
        if not unstamped or not stamped:
            return []
        delays = [
            np.median(np.subtract(contents[n].recorded, contents[n].headers)) for n in stamped
        ]
        delay = float(np.median(delays)) * _SECONDS_PER_NS
        names = ", ".join(unstamped)
        if abs(delay) > _MAX_CLOCK_DIFFERENCE:
            raise InvalidInput(
                f"the clocks of headers and recorder differ by {delay:.6g} s, and the messages of "
                f"{names} have no time stamp",
                where=str(self.path),
                remedy="record with --use-sim-time if the time stamps are simulated, or publish "
                f"{names} with a header",
            )
        place = Place(file=self.path.name)
        return [Diagnostic("recorder-stamps", place, topics=tuple(unstamped), delay=delay)]

    def has_topic_of(self, column: str) -> bool:
        """Whether the bag has the topic of a column."""
        return topic_of(column) in self._topics

    def missing_column_error(
        self, column: str, what: str, used: Collection[str] = ()
    ) -> InvalidInput:
        """The error for a missing column; `what` states its purpose, `used` are other channels'."""
        name = topic_of(column)
        topic = self._topics.get(name)
        if topic is None:
            available = ", ".join(f"{n} ({t.kind}, {t.count})" for n, t in self._topics.items())
            problem = f"there is no topic '{name}'" if "." in column else f"there is no '{column}'"
            remedy = (
                'map it in [channels] of the study, as { topic = "/joint_states", field = '
                f'"position", name = "joint1" }}; the bag has: {available or "nothing"}'
                + suggest_name(name, self._topics)
            )
        elif topic.unreadable:
            problem = f"the topic '{name}' cannot be read: {topic.kind}, {topic.unreadable}"
            remedy = "record the bag again with the message definition"
        elif not topic.count:
            problem = f"the topic '{name}' has no messages"
            remedy = "check that its node was running, and record again"
        else:
            missing_field = column[len(name) + 1 :]
            fields = [each[len(name) + 1 :] for each in topic.names]
            problem = f"there is no field '{missing_field}' in the topic '{name}'"
            more = ", ..." if len(fields) > _MAX_LISTED_NAMES else ""
            available = ", ".join(fields[:_MAX_LISTED_NAMES]) + more
            remedy = (
                f"its messages have: {available or 'no numbers'}"
                f"{suggest_name(missing_field, fields)}"
            )
        return InvalidInput(f"{problem}, {what}", where=str(self.path), remedy=remedy)


def topic_of(column: str) -> str:
    """Return the topic in a column name; topic names contain no dots."""
    return column.partition(".")[0]


@contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    import_optional("rosbags.highlevel", "reading bags", "rosbags", str(path))
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if path.is_dir() and not (path / "metadata.yaml").exists():
        raise InvalidInput(
            "is a directory without metadata.yaml, and therefore not a bag",
            where=str(path),
            remedy="use the path of the .mcap or .db3 file in it, or run `ros2 bag reindex`",
        )
    # bags from before ROS 2 Iron do not contain message definitions
    typestore = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_HUMBLE)
    try:
        with AnyReader([path], default_typestore=typestore) as reader:
            yield reader
    except InvalidInput:
        raise
    except Exception as error:  # damaged bags raise arbitrary exceptions
        cause = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        raise InvalidInput(
            f"is not a bag, or is damaged ({cause})",
            where=str(path),
            remedy="if the recorder was killed, run `mcap recover` or `ros2 bag reindex`",
        ) from error


def _read_messages(reader: AnyReader, topics: dict[str, list[str]]) -> dict[str, _TopicContent]:
    """Read every message of the topics once; missing values are skipped."""
    paths = {
        name: {column: _parse_field(column[len(name) + 1 :]) for column in columns}
        for name, columns in topics.items()
    }
    contents = {
        name: _TopicContent(values={c: [] for c in columns}, rows={c: [] for c in columns})
        for name, columns in topics.items()
    }
    connections = [each for each in reader.connections if each.topic in topics]
    for connection, recorded, raw in reader.messages(connections):
        message = reader.deserialize(raw, connection.msgtype)
        content = contents[connection.topic]
        row = len(content.recorded)
        content.recorded.append(recorded)
        content.headers.append(_read_stamp(message))
        for column, path in paths[connection.topic].items():
            value = _read_number(message, path)
            if value is not None:
                content.values[column].append(value)
                content.rows[column].append(row)
    return contents


def _message_name(rows: IntArray, sample: int) -> str:
    return f"message {rows[sample] + 1}"


def _sort_stamps(stamps: IntArray) -> tuple[IntArray, int, int]:
    """Return the rows sorted by time stamp, and the numbers of late and of repeated stamps.

    Of several rows with the same stamp, the last is kept.
    """
    order = np.argsort(stamps, kind="stable")
    n_late = int(np.count_nonzero(np.diff(stamps) < 0))
    is_last = np.append(np.diff(stamps[order]) > 0, True)
    n_equal = len(stamps) - int(np.count_nonzero(is_last))
    return order[is_last], n_late, n_equal
