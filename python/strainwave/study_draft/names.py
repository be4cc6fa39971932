"""Parse column names: quantity, joint, unit, side of the gear."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Literal

from strainwave.domain import channel_kinds
from strainwave.domain.kinds import all_kinds

Quantity = Literal[
    "time",
    "angle",
    "velocity",
    "voltage",
    "torque",
    "current",
    "acceleration",
    "gyro",
    "deflection",
    "reference",
    "temperature",
]
Side = Literal["motor", "link"]

_WORDS: tuple[tuple[Quantity, str], ...] = (  # the first match applies
    ("temperature", "temperature temp"),
    ("deflection", "defl deflection twist torsion"),
    ("gyro", "gyro gyr gyros gyroscope angularvelocity angvel angrate"),
    ("acceleration", "a acc accel acceleration accelerometer accelero linearacceleration qdd ddq"),
    ("reference", "ref reference des desired target setpoint sp goal"),
    ("current", "i iq cur curr current amps amp"),
    ("torque", "tau torque trq effort force moment"),
    ("velocity", "vel velocity dq qd qdot omega w speed dtheta thetadot dphi rate"),
    ("voltage", "u volt voltage vin uin v pwm duty"),
    ("angle", "pos position q qm theta th angle ang enc encoder phi counts count motorangle"),
    ("voltage", "cmd command ctrl control input drive"),
    ("time", "t time timestamp stamp ts zeit elapsed clock seconds sec"),
)
# word -> side of the gear
_SIDES: dict[str, Side] = {
    **dict.fromkeys(["m", "mot", "motor", "rotor", "qm", "hs"], "motor"),
    **dict.fromkeys(["l", "link", "arm", "load", "output", "out", "secondary", "ls"], "link"),
}
# words of a commanded angle or velocity, which is a reference
_COMMAND_WORDS = {"cmd", "command", "commanded"}
# words that have other meanings too
_AMBIGUOUS_WORDS = (
    "v",
    "i",
    "a",
    "w",
    "th",
    "cmd",
    "command",
    "ctrl",
    "control",
    "input",
    "drive",
    "sp",
)
# words of columns that have no quantity
_IGNORED_WORDS = ("orientation", "quaternion", "status", "id", "seq")
# words of a torque that a sensor measures behind the gear
_TORQUE_SENSOR_WORDS = {"sensor", "jts"}

# words that do not distinguish joints
_GENERIC_WORDS = (
    *("joint", "axis", "j", "robot", "imu", "sensor"),
    *("meas", "measured", "act", "actual", "state", "data", "value"),
)

COUNTS = ("counts", "count", "cnt", "ticks", "tick", "inc", "incs")
"""Unit names of encoder counts, whose factor to SI the name does not give."""
# unit -> factor to SI
_ROTATION = {"rad": 1.0, "mrad": 1e-3, "deg": pi / 180, "degrees": pi / 180, "rev": 2 * pi}
_TRAVEL = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
_RATE = {
    "rads": 1.0,
    "radps": 1.0,
    "radpers": 1.0,
    "degs": pi / 180,
    "degps": pi / 180,
    "dps": pi / 180,
    "rpm": pi / 30,
    "rps": 2 * pi,
}
# quantity -> unit -> factor to SI
UNITS: dict[Quantity, dict[str, float]] = {
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6, "ns": 1e-9},
    "angle": _ROTATION | {"turns": 2 * pi} | _TRAVEL,
    "deflection": _ROTATION | _TRAVEL,
    "velocity": _RATE | {"ms": 1.0, "mps": 1.0, "mms": 1e-3},
    "reference": _ROTATION | _RATE | _TRAVEL | {"ms": 1.0, "mps": 1.0},
    "gyro": _RATE | {"mdps": pi / 180e3},
    "voltage": {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3},
    "torque": {"nm": 1.0, "mnm": 1e-3, "n": 1.0, "kn": 1e3},
    "current": {"a": 1.0, "amp": 1.0, "ma": 1e-3},
    "temperature": {"degc": 1.0, "celsius": 1.0},
    "acceleration": {"ms2": 1.0, "mps2": 1.0, "mss": 1.0, "g": 9.80665, "mg": 9.80665e-3},
}
LINEAR = (*_TRAVEL, "n", "kn", "mps", "mms")
"""Units of a prismatic joint."""
# words after which m and l mean motor and link, not units
_ROTATIONAL = ("theta", "th", "angle", "ang", "phi", "motorangle", "dtheta", "thetadot", "omega")


@dataclass(frozen=True, slots=True)
class ParsedName:
    """Parsed column name; None marks information that the name does not contain."""

    quantity: Quantity | None
    number: int | None = None  # joint number as written, from 0 or 1
    label: str = ""  # name of the joint in a bag
    unrecognised_word: str = ""  # unrecognised word; in a table it may be the name of the joint
    unit: str | None = None
    side: Side | None = None
    word: str = ""  # word that determined the quantity
    sure: bool = False  # whether the word is unambiguous
    placed: bool = True  # False: the joint is a guess


def max_joints() -> int:
    """Most joints of an arm that study files can describe."""
    return max(kind.max_joints for kind in all_kinds())


def parse(name: str, joint_words: Sequence[str] = ()) -> ParsedName:
    """Parse a column name; `joint_words` are those of its words that name the joint."""
    text, label, number = name, "", None
    if name.startswith("/"):  # bag column: /topic.field[joint or index]
        bracket = re.search(r"\[([^\]]*)\]$", name)
        text = name[: bracket.start()] if bracket else name
        label = bracket[1] if bracket and not bracket[1].isdecimal() else ""
        if label:  # namespaces are names of robots
            text = text[text.rindex("/") :]
        number = int(bracket[1]) if bracket and bracket[1].isdecimal() else None
        text = re.sub(r"\.data$", "", text)
    tokens = _tokens(text)
    start = position([token.lower() for token in tokens], joint_words)
    if start is not None:
        del tokens[start : start + len(joint_words)]
    if any(token.lower() in _IGNORED_WORDS for token in tokens):
        return ParsedName(None)
    quantity, word = _quantity(tokens)
    unit, words = _unit(tokens, quantity, word)
    if quantity is None and unit is not None:
        quantity = _quantity_of_unit(unit)
    number = _last_number(words) if number is None else number
    lowercase = [token.lower() for token in words]
    sides = [_SIDES[token] for token in lowercase if token in _SIDES]
    if quantity in ("angle", "velocity") and not _COMMAND_WORDS.isdisjoint(lowercase):
        quantity = "reference"
    if quantity == "torque" and not _TORQUE_SENSOR_WORDS.isdisjoint(lowercase):
        sides.append("link")
    side = sides[-1] if sides else None
    known_words = {
        word,
        *_GENERIC_WORDS,
        *_SIDES,
        *_COMMAND_WORDS,
        *(w for _, of in _WORDS for w in of.split()),
    }
    unknown_word = next(
        (token for token in lowercase if token not in known_words and not token.isdecimal()), ""
    )
    is_channel = re.fullmatch(rf"({'|'.join(channel_kinds())})\d", name) is not None
    sure = is_channel or (bool(word) and word not in _AMBIGUOUS_WORDS)
    return ParsedName(quantity, number, label, unknown_word, unit, side, word, sure)


def words_of(name: str) -> tuple[str, ...]:
    """Return the words and numbers of a name in lower case."""
    return tuple(token.lower() for token in _tokens(name))


def number_in(name: str) -> int | None:
    """Return the last number in a name, or None."""
    return _last_number(words_of(name))


def _last_number(words: Sequence[str]) -> int | None:
    return next((int(word) for word in reversed(words) if word.isdecimal()), None)


def position(words: Sequence[str], part: Sequence[str]) -> int | None:
    """Position at which `part` is in `words`, or None."""
    starts = range(len(words) - len(part) + 1)
    return next((k for k in starts if tuple(words[k : k + len(part)]) == tuple(part)), None)


def _tokens(text: str) -> list[str]:
    text = re.sub(r"linear_acceleration", "linearacceleration", text)
    text = re.sub(r"angular_velocity", "angularvelocity", text)
    return re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", text)


def _quantity(tokens: list[str]) -> tuple[Quantity | None, str]:
    lowercase = [token.lower() for token in tokens]
    for quantity, words in _WORDS:
        for token in lowercase:
            if token in words.split() and not (token == "t" and len(lowercase) > 2):
                is_unit = (
                    token == lowercase[-1] and len(lowercase) > 1 and token in ("a", "v", "i", "u")
                )
                if not is_unit:  # a trailing letter is a unit
                    return quantity, token
    return None, ""


def _unit(tokens: list[str], quantity: Quantity | None, word: str) -> tuple[str | None, list[str]]:
    """Return the unit at the end of a name and the preceding tokens."""
    for length in (4, 3, 2, 1):
        tail = "".join(token.lower() for token in tokens[-length:])
        if length >= len(tokens) or tail == word:
            continue
        motor_side = tail in ("m", "l") and word in _ROTATIONAL
        known = UNITS[quantity] if quantity else {u for of in UNITS.values() for u in of}
        if (tail in known and not motor_side) or (quantity == "angle" and tail in COUNTS):
            return tail, tokens[:-length]
    return (word if word in COUNTS else None), tokens


def _quantity_of_unit(unit: str) -> Quantity | None:
    having = [quantity for quantity, units in UNITS.items() if unit in units]
    return having[0] if len(having) == 1 else None
