"""ROS 2 bags (directories, .mcap, .db3) and ROS 1 bags -> tracks: numbers with their stamps.

A number in a bag is named `/topic.field`, with `[index]` for an element of an array, or `[joint]`
where the message names its joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from strainwave.domain import Diagnostic, IntArray
from strainwave.errors import InvalidInput, nearest
from strainwave.io.logs.clocks import Track
from strainwave.io.logs.messages import number, numbers, parse, stamp

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

BAGS = (".mcap", ".db3", ".bag")
_LOOKED_AT = 20  # messages of a topic; several nodes may publish their joints on one
_SHOWN = 24  # names in a message of ours
_NANO = 1e-9
_OTHER_CLOCK = 1.0  # [s] between header and recorder that no network explains


def is_bag(path: Path) -> bool:
    """Whether a log is a bag: a directory, or a file with a bag's ending."""
    return path.is_dir() or path.name.lower().endswith(BAGS)


@dataclass(frozen=True, slots=True)
class _Topic:
    """What is known of a topic without reading all of it."""

    kind: str
    count: int
    names: tuple[str, ...]  # of its numbers; empty where there are no messages
    unreadable: str | None = None  # why


@dataclass(slots=True)
class _Found:
    """A topic's messages, as far as they were asked for."""

    headers: list[int] = field(default_factory=list)  # [ns], 0 where there is none
    recorded: list[int] = field(default_factory=list)  # [ns]
    values: dict[str, list[float]] = field(default_factory=dict)
    rows: dict[str, list[int]] = field(default_factory=dict)  # messages that have the number


class Bag:
    """A bag's numbers, by name, read when asked for.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InvalidInput
        It is no bag, it is damaged, or the library for bags is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._topics = self._look()
        self.names = tuple(name for topic in self._topics.values() for name in topic.names)

    def _look(self) -> dict[str, _Topic]:
        found = {}
        with _opened(self.path) as reader:
            for name, info in sorted(reader.topics.items()):
                names: dict[str, None] = {}
                unreadable = None
                try:
                    for raw, kind in _first(reader, info.connections):
                        names |= dict.fromkeys(numbers(reader.deserialize(raw, kind)))
                except Exception as error:  # another's definitions can be wrong in any way
                    unreadable = f"{type(error).__name__}: {error}".splitlines()[0][:100]
                columns = tuple(f"{name}.{each}" for each in names)
                found[name] = _Topic(info.msgtype or "mixed", info.msgcount, columns, unreadable)
        return found

    def tracks(self, wanted: Iterable[str]) -> tuple[list[Track], list[Diagnostic]]:
        """The numbers asked for; those that came together are one track.

        Stamps are those of the headers where all of a topic's messages have one, else the
        recorder's; zero is the earliest.

        Parameters
        ----------
        wanted : iterable of str

        Returns
        -------
        list of Track
        list of Diagnostic

        Raises
        ------
        InvalidInput
            The bag is damaged, or header and recorder keep different time.
        """
        topics: dict[str, list[str]] = {}
        for column in wanted:
            topics.setdefault(topic_of(column), []).append(column)
        with _opened(self.path) as reader:
            found = _collect(reader, topics)
        stamped = {name for name, each in found.items() if all(each.headers)}
        warnings = self._check_clocks(found, stamped)
        stamps = {
            name: np.array(each.headers if name in stamped else each.recorded, dtype=np.int64)
            for name, each in found.items()
        }
        zero = min(int(each.min()) for each in stamps.values())
        tracks = []
        for name, each in found.items():
            tracks += self._split(name, each, stamps[name] - zero, warnings)
        return tracks, warnings

    def _split(
        self, topic: str, found: _Found, stamps: IntArray, warnings: list[Diagnostic]
    ) -> list[Track]:
        """A topic's columns by the messages that have them, in the order of their stamps."""
        together: dict[tuple[int, ...], list[str]] = {}
        for column, having in found.rows.items():
            together.setdefault(tuple(having), []).append(column)
        tracks = []
        for shared, columns in together.items():
            rows = np.array(shared)
            order, said = _in_order(stamps[rows], topic)
            if said:
                warnings.append(Diagnostic("reordered", self.path.name, said))
            time = stamps[rows][order] * _NANO
            values = {column: np.array(found.values[column])[order] for column in columns}
            tracks.append(Track(topic, time, values, partial(_message_name, rows[order])))
        return tracks

    def _check_clocks(self, found: dict[str, _Found], stamped: set[str]) -> list[Diagnostic]:
        bare = sorted(set(found) - stamped)
        if not bare or not stamped:
            return []
        late = [np.median(np.subtract(found[n].recorded, found[n].headers)) for n in stamped]
        delay = float(np.median(late)) * _NANO
        names = ", ".join(bare)
        if abs(delay) > _OTHER_CLOCK:
            raise InvalidInput(
                f"headers and recorder keep different time, {delay:.6g} s apart, and the messages "
                f"of {names} have no stamp of their own",
                where=str(self.path),
                remedy="record with --use-sim-time where the stamps are simulated, or publish "
                f"{names} with a header",
            )
        message = (
            f"the messages of {names} have no header stamp: they count from when the recorder got "
            f"them, {1e3 * delay:.3g} ms after their stamp for the others. Publish a stamp with "
            "them if you can"
        )
        return [Diagnostic("recorder-stamps", self.path.name, message)]

    def has_topic_of(self, column: str) -> bool:
        """Whether the topic of a number is in the bag, be the number itself there or not.

        Parameters
        ----------
        column : str

        Returns
        -------
        bool
        """
        return topic_of(column) in self._topics

    def no_column(self, column: str, what: str) -> InvalidInput:
        """What to say where a number is not there.

        Parameters
        ----------
        column : str
        what : str
            What it is needed for.

        Returns
        -------
        InvalidInput
        """
        where = str(self.path)
        name = topic_of(column)
        topic = self._topics.get(name)
        if topic is None:
            shown = ", ".join(f"{n} ({t.kind}, {t.count})" for n, t in self._topics.items())
            problem = f"there is no topic '{name}'" if "." in column else f"there is no '{column}'"
            remedy = (
                'map it in [channels] of the study, as { topic = "/joint_states", field = '
                f'"position", name = "joint1" }}; the bag has: {shown or "nothing"}'
                + nearest(name, self._topics)
            )
        elif topic.unreadable:
            problem = f"the topic '{name}' cannot be read: {topic.kind}, {topic.unreadable}"
            remedy = "record the bag anew with the message's definition"
        elif not topic.count:
            problem = f"the topic '{name}' has no messages"
            remedy = "check that its node was running, and record again"
        else:
            wrong = column[len(name) + 1 :]
            known = [each[len(name) + 1 :] for each in topic.names]
            problem = f"there is no field '{wrong}' in the topic '{name}'"
            more = ", ..." if len(known) > _SHOWN else ""
            shown = ", ".join(known[:_SHOWN]) + more
            remedy = f"its messages have: {shown or 'no numbers'}{nearest(wrong, known)}"
        return InvalidInput(f"{problem}, {what}", where=where, remedy=remedy)


def topic_of(column: str) -> str:
    """The topic in a number's name; names of topics have no dots."""
    return column.partition(".")[0]


@contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InvalidInput(
            "reading bags needs rosbags, which is not installed",
            where=str(path),
            remedy="pip install 'strainwave[bags]'",
        ) from error
    if path.is_dir() and not (path / "metadata.yaml").exists():
        raise InvalidInput(
            "is a directory without metadata.yaml, so no bag",
            where=str(path),
            remedy="name the .mcap or .db3 file in it, or run `ros2 bag reindex`",
        )
    # bags from before ROS 2 Iron do not hold their messages' definitions
    known = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_HUMBLE)
    try:
        with AnyReader([path], default_typestore=known) as reader:
            yield reader
    except InvalidInput:
        raise
    except Exception as error:  # a damaged bag makes the readers below raise almost anything
        said = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        raise InvalidInput(
            f"is no bag, or a damaged one ({said})",
            where=str(path),
            remedy="if the recorder was stopped hard, run `mcap recover` or `ros2 bag reindex`",
        ) from error


def _first(reader: AnyReader, connections: Any) -> Iterator[tuple[bytes, str]]:
    for count, (connection, _, raw) in enumerate(reader.messages(connections)):
        if count == _LOOKED_AT:
            return
        yield raw, connection.msgtype


def _collect(reader: AnyReader, topics: dict[str, list[str]]) -> dict[str, _Found]:
    """Every message of the topics once; what a message does not have is left out."""
    paths = {
        name: {column: parse(column[len(name) + 1 :]) for column in columns}
        for name, columns in topics.items()
    }
    found = {
        name: _Found(values={c: [] for c in columns}, rows={c: [] for c in columns})
        for name, columns in topics.items()
    }
    connections = [each for each in reader.connections if each.topic in topics]
    for connection, recorded, raw in reader.messages(connections):
        message = reader.deserialize(raw, connection.msgtype)
        into = found[connection.topic]
        row = len(into.recorded)
        into.recorded.append(recorded)
        into.headers.append(stamp(message))
        for column, path in paths[connection.topic].items():
            value = number(message, path)
            if value is not None:
                into.values[column].append(value)
                into.rows[column].append(row)
    return found


def _message_name(rows: IntArray, sample: int) -> str:
    return f"message {rows[sample] + 1}"


def _in_order(stamps: IntArray, topic: str) -> tuple[IntArray, str]:
    """The rows by stamp, of several with one stamp the last; and what had to be done."""
    order = np.argsort(stamps, kind="stable")
    late = int(np.count_nonzero(np.diff(stamps) < 0))
    last = np.append(np.diff(stamps[order]) > 0, True)
    doubled = len(stamps) - int(np.count_nonzero(last))
    said = (
        f"{late} message(s) of {topic} came late and {doubled} had the stamp of another: they were "
        "put in order, and of several with one stamp only the last was taken"
    )
    return order[last], said if late or doubled else ""
