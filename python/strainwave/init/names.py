"""Parse column names: quantity, joint, unit, side of the gear, desired or actual.

The words and phrases of languages and robot systems are data: words.toml; units: units.toml.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from strainwave.domain import channel_kinds
from strainwave.domain.arm.kinds import KINDS
from strainwave.init.units import key_of, normalised, spellings

Quantity = Literal[
    "temperature",
    "deflection",
    "gyro",
    "acceleration",  # of an accelerometer
    "second_derivative",  # of a joint angle
    "current",
    "torque",
    "velocity",
    "voltage",
    "angle",
    "reference",
    "time",
]
"""Quantities; of several in a name, the first applies."""
Side = Literal["motor", "link"]
Role = Literal["desired", "actual"]

_TABLE: Mapping[str, Any] = tomllib.loads(
    Path(__file__).with_name("words.toml").read_text(encoding="utf-8")
)
_CJK = "\u3040-\u30ff\u3400-\u9fff"
_TOKEN = re.compile(rf"[{_CJK}]+|[A-Z]?[^\W\d_A-Z{_CJK}]+|[A-Z]+(?![^\W\d_A-Z{_CJK}])|\d+|[°%‰]")
_BRACKETS = re.compile(r"[\[({<]([^\])}>]*)[\])}>]")
_FACTOR = re.compile(r"(\d+(?:\.\d+)?)(?:/(\d+))?(?=[^\d.])")  # of a unit: 0.1%, 1/1000 s
_OBJECT = re.compile(r"\b(?:0x)?(6[01][0-9a-f]{2})(?:h|:\w+)?\b", re.IGNORECASE)
_SYMBOL_ROLE = re.compile("(q|dq|qd|ddq|qdd|tau|th|theta|u|i)([a-z]{3,})")
_MIN_COMPOUND_PART = 3  # letters of a Latin word inside another


MAX_JOINTS = max(kind.max_joints for kind in KINDS.values())
"""Most joints of an arm that study files can describe."""
AXIS = re.compile(r"(?<![A-Za-z])[xyz](?![A-Za-z])", re.IGNORECASE)  # of a sensor, in a name
_CHANNEL = re.compile(rf"({'|'.join(channel_kinds())})\d")


class Unit(NamedTuple):
    """A unit in a name or a units row."""

    text: str
    scale: float | None  # factor to SI; None: see `todo`
    todo: str = ""  # formula of the factor, which a data sheet gives


@dataclass(frozen=True, slots=True)
class ParsedName:
    """Parsed column name; None marks information that the name does not contain."""

    quantity: Quantity | None
    number: int | None = None  # joint number as written, from 0 or 1
    label: str = ""  # name of the joint in a bag
    rest: tuple[str, ...] = ()  # unrecognised words; in a table they may name the joint
    measure: Unit | None = None  # unit
    side: Side | None = None
    role: Role | None = None
    word: str = ""  # word that determined the quantity
    sure: bool = False  # whether the word is unambiguous
    placed: bool = True  # False: the joint is a guess

    @property
    def unit(self) -> str | None:
        """Text of the unit."""
        return None if self.measure is None else self.measure.text

    @property
    def todo(self) -> str:
        """Formula of the factor to SI units, which the user must fill in; empty if none."""
        return "" if self.measure is None else self.measure.todo

    def scale_or(self, default: float | None) -> float | None:
        """Factor to SI units, or a default if the name has no unit."""
        return default if self.measure is None else self.measure.scale


def _words_in(text: str) -> list[tuple[str, ...]]:
    return [tuple(phrase.split("_")) for phrase in text.split()]


def _vocabulary() -> dict[tuple[str, ...], set[tuple[str, str]]]:
    """Phrase -> its meanings: pairs of section and entry of the table."""
    entries = [
        (("quantity", quantity), " ".join(languages.values()))
        for quantity, languages in _TABLE["quantity"].items()
    ]
    for section in ("weak", "role", "side", "other"):
        entries += [((section, key), text) for key, text in _TABLE[section].items()]
    vocabulary: dict[tuple[str, ...], set[tuple[str, str]]] = {}
    for meaning, text in entries:
        for phrase in _words_in(text):
            vocabulary.setdefault(phrase, set()).add(meaning)
    return vocabulary


_VOCABULARY = _vocabulary()
_LONGEST_PHRASE = max(map(len, _VOCABULARY))
_SYMBOLS = set(_TABLE["derivative"]["symbols"].split())
_JOINT_ORDER = _TABLE["joint"]["order"].split()
_SIDED = set(_words_in(" ".join(_TABLE["side"].values())))
_PATHS = {"pos", "position", "x"}  # symbols of a travel as well, in m
_QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
_MOTIONS = ("angle", "velocity", "second_derivative", "torque")
_DERIVATIVES: tuple[Quantity, ...] = ("angle", "velocity", "second_derivative")
_ORDERS = {"d": 1, "dot": 1, "p": 1, "dd": 2, "ddot": 2, "dotdot": 2, "pp": 2}
_OF_IMU: Mapping[Quantity | None, Quantity] = {
    "velocity": "gyro",
    "second_derivative": "acceleration",
}
_COMMANDS = set(_TABLE["role"]["command"].split())

UNITS: dict[Quantity, dict[str, float]] = {
    quantity: {text: factor for group in groups.split() for text, factor in spellings(group)}
    for quantity, groups in _TABLE["quantity_units"].items()
}
"""Quantity -> unit -> factor to SI."""
UNITS["reference"] = UNITS["angle"] | UNITS["velocity"]
_OPEN = dict(spellings("open")) | {f"{t}/s": f for t, f in spellings("open")}
LINEAR = frozenset(
    text for group in ("length", "length/s", "force") for text, _ in spellings(group)
)
"""Units of a prismatic joint."""


def find_unit(text: str, quantity: Quantity | None, factor: float = 1.0) -> Unit | None:
    """The unit of a quantity in a text such as `deg/s`, `kgf.cm` or `0.1%`; None if it is none."""
    key = key_of(text)
    if quantity is None or not key:
        return None
    open_factors = _OPEN | UNITS["current"] if quantity == "current" else _OPEN
    if key in open_factors:
        formulas, factor = _TABLE["formulas"], factor * open_factors[key]
        formula = formulas.get(key) or formulas.get(quantity, f"SI value of one {key}")
        return Unit(key, None, formula + (f", times {factor:g}" if factor != 1.0 else ""))
    if key in UNITS[quantity]:
        return Unit(key, factor * UNITS[quantity][key])
    match = _FACTOR.match(key)
    factor = float(match[1]) / float(match[2] or 1.0) if match else 1.0
    unit = find_unit(key[match.end() :], quantity, factor) if match else None
    return unit and unit._replace(text=key)


def parse(name: str, joint_words: Sequence[str] = (), unit: str = "") -> ParsedName:
    """Parse a column name; `joint_words` are those of its words that name the joint.

    `unit` is the text of the column's unit in a units row.
    """
    text, label, number = name, "", None
    if name.startswith("/"):  # bag column: /topic.field[joint or index]
        if name.endswith("]"):
            text, _, label = name[:-1].rpartition("[")
        if label.isdecimal():
            label, number = "", int(label)
        if label:  # namespaces are names of robots
            text = text[text.rindex("/") :]
        text = text.removesuffix(".data")
    text = _OBJECT.sub(lambda m: f" {_TABLE['objects'].get(m[1].lower(), '')} ", text)
    bracketed = [content for content in _BRACKETS.findall(text) if not content.strip().isdecimal()]
    for content in _BRACKETS.findall(text):
        number = int(content) if content.strip().isdecimal() else number
    words = _compounds(words_of(_BRACKETS.sub(" ", text)))
    start = position(words, joint_words)
    if start is not None:
        del words[start : start + len(joint_words)]
    order, words = _derivative(words)
    each = _classify(words, order)
    if each is None:
        return ParsedName(None)
    stated = None
    for content in [unit, *reversed(bracketed)] if unit.strip(" -") else reversed(bracketed):
        with_unit = _with_unit(each, content)
        if with_unit is not None:
            each, stated = with_unit, content
            break
    else:
        each, words = _trailing_unit(each, words)
    labels = [
        w for content in bracketed if content != stated for w in _compounds(words_of(content))
    ]
    words += [word for word in labels if word not in words]
    number = last_number(words) if number is None else number
    return replace(_described(name, each, words), number=number, label=label)


def _with_unit(each: ParsedName, text: str) -> ParsedName | None:
    """Add the unit of a units row or of brackets, which precedes the word of the quantity."""
    named = find_unit(text, each.quantity) is not None
    quantity = each.quantity if named else _quantity_of_unit(text, each.quantity, sure=each.sure)
    if quantity is not None:
        return replace(each, quantity=quantity, measure=find_unit(text, quantity))
    if each.quantity and re.search(r"[/%^·²]", text):
        return replace(each, measure=Unit(text, None, f"SI value of the unit {text.strip()!r}"))
    return None


def _quantity_of_unit(text: str, named: Quantity | None, *, sure: bool = True) -> Quantity | None:
    """The quantity whose unit a text is, if it is one of these that a word may mean instead."""
    rivals: Sequence[Quantity] = _TABLE["rivals"].get(named if sure and named else "none", ())
    having = [q for q in rivals if (unit := find_unit(text, q)) and unit.text not in _OPEN]
    return having[0] if len(having) == 1 or (having and named and sure) else None


def _trailing_unit(each: ParsedName, words: list[str]) -> tuple[ParsedName, list[str]]:
    if len(each.word) > 1 and (measure := find_unit(each.word, each.quantity)):
        return replace(each, measure=measure), words  # counts, rpm
    is_symbol = each.word in _SYMBOLS - _PATHS and (each.word,) not in _SIDED
    for length in (4, 3, 2, 1):
        tail, before = "".join(words[-length:]), words[:-length]
        if not before or words[-length].isdecimal() or tail == each.word:
            continue
        if tail in ("m", "l") and is_symbol:
            continue  # motor and link
        if each.quantity is None and len(tail) > 1:
            each = replace(each, quantity=_quantity_of_unit(tail, None))
        measure = find_unit(tail, each.quantity)
        if measure and (not each.word or position(before, each.word.split("_")) is not None):
            return replace(each, measure=measure), before
    return each, words


def _described(name: str, each: ParsedName, words: list[str]) -> ParsedName:
    """Add the side, which settles what the quantity is, and the words that name the joint."""
    meanings = {word: _VOCABULARY.get((word,), set()) for word in words}
    own_words = each.word.split("_")
    sides = {
        value
        for word, of in meanings.items()
        if len(own_words) == 1 or word not in own_words
        for kind, value in of
        if kind == "side"
    }
    quantity = each.quantity
    is_sensor = quantity == "torque" and "sensor" in sides
    side: Side | None = (
        "link" if is_sensor or "link" in sides else "motor" if "motor" in sides else None
    )
    if "imu" in words:
        quantity = _OF_IMU.get(quantity, quantity)
    if quantity == "second_derivative" and (
        side == "link" or AXIS.search(name) or find_unit(each.unit or "", "acceleration")
    ):
        quantity = "acceleration"
    if each.role == "desired" and quantity in _DERIVATIVES:
        quantity = "reference"
    rest = tuple(
        word
        for word in words
        if {kind for kind, _ in meanings[word]} <= {"weak"}
        and not word.isdecimal()
        and word not in (*own_words, "d", "dot", "ddot")
    )
    if "joint" in sides:
        rest = (*rest, "arm")  # the arm of a motor is a link, that of a robot is not
    if words[:1] == ["l"] and side == "link":
        side, rest = None, ("l", *rest)  # the left arm
    sure = each.sure or _CHANNEL.fullmatch(name) is not None
    return replace(each, quantity=quantity, rest=rest, side=side, sure=sure)


def _classify(words: list[str], order: int) -> ParsedName | None:
    """Quantity and role of words; None if they are of no channel."""
    phrases = list(_phrases(words))
    meanings = [(*meaning, phrase) for phrase, of in phrases for meaning in of]
    if any((kind, value) == ("other", "ignored") for kind, value, _ in meanings):
        return None
    strong = [(value, phrase) for kind, value, phrase in meanings if kind == "quantity"]
    roles = {value for kind, value, _ in meanings if kind == "role"}
    current = next((k for k, each in enumerate(strong) if each[1] == ("current",)), len(strong))
    if any(value in _MOTIONS for value, _ in strong[current:]):  # current position: the actual one
        del strong[current]
        roles.add("actual")
    if "actual" not in roles and len(words) > 1 and words[-1] == "d":  # q_d, tau_J_d
        roles.add("desired")
    role: Role | None = next((each for each in get_args(Role) if each in roles), None)
    if strong:
        value, phrase = min(strong, key=lambda each: _QUANTITIES.index(each[0]))
        quantity = _raised(value, order)
        return quantity and ParsedName(quantity, role=role, word="_".join(phrase), sure=True)
    for kind, value, (word, *_) in meanings:
        is_unit = word == words[-1] and len(words) > 1 and word in "avimnf"
        is_long = word == "t" and len(words) > 2
        if kind == "weak" and not is_unit and not is_long:
            return ParsedName(_raised(value, order), role=role, word=word)
    commands = [word for word in words if word in _COMMANDS]
    desired = next((p[0] for k, v, p in meanings if (k, v) == ("role", "desired")), "")
    if desired and not commands:
        return ParsedName("reference", role=role, word=desired, sure=True)
    return ParsedName("voltage" if commands else None, role=role, word="".join(commands[:1]))


def _raised(name: str, order: int) -> Quantity | None:
    """The derivative of a quantity; None if it is no quantity of a joint."""
    quantity = _QUANTITIES[_QUANTITIES.index(name)]
    ladder: Sequence[Quantity] = (quantity,)
    if quantity in _DERIVATIVES:
        ladder = _DERIVATIVES[_DERIVATIVES.index(quantity) :]
    return ladder[order] if order < len(ladder) else None


def _phrases(words: Sequence[str]) -> Iterator[tuple[tuple[str, ...], set[tuple[str, str]]]]:
    """Known phrases in words, each with its meanings; of several at one place the longest."""
    start = 0
    while start < len(words):
        for length in range(min(_LONGEST_PHRASE, len(words) - start), 0, -1):
            phrase = tuple(words[start : start + length])
            if phrase in _VOCABULARY:
                yield phrase, _VOCABULARY[phrase]
                start += length - 1
                break
        start += 1


def _derivative(words: list[str]) -> tuple[int, list[str]]:
    """Return the order of the derivative that words such as d2q, qddot or q_dot name."""
    order, result, words = 0, list[str](), list(words)
    for k, word in enumerate(words):
        before = re.fullmatch(r"(d{1,2})(\w+?)(dt\d?)?", word)
        after = re.fullmatch(rf"(\w+?)({'|'.join(_ORDERS)})", word)
        following = words[k + 1] if k + 1 < len(words) else ""
        if word in ("dot", "ddot", "dotdot") or (word == "d" and following in _SYMBOLS):
            order += _ORDERS[word]
        elif word == "d" and following == "2" and k + 2 < len(words) and words[k + 2] in _SYMBOLS:
            order, words[k + 1] = order + 2, ""
        elif before and before[2] in _SYMBOLS:
            order, result = order + len(before[1]), [*result, before[2]]
        elif after and after[1] in _SYMBOLS and (word,) not in _VOCABULARY:
            order, result = order + _ORDERS[after[2]], [*result, after[1]]
        elif word:
            result.append(word)
    return order, result


def joint_rank(words: Sequence[str]) -> int:
    """Kinematic order of a joint whose name has these words; joints of unknown order are equal."""
    ranks = [_JOINT_ORDER.index(word) for word in words if word in _JOINT_ORDER]
    return min(ranks, default=0)


def names_accelerometer(word: str) -> bool:
    """Whether a word for an acceleration, joined by "_", is that of a sensor."""
    return ("quantity", "acceleration") in _VOCABULARY.get(tuple(word.split("_")), ())


def system_entry(names: Sequence[str], key: str) -> Mapping[Quantity, str]:
    """The entry `units` or `sides` of the robot system that the names show."""
    texts = [" ".join(_compounds(words_of(name))) for name in names]
    for system in _TABLE["system"]:
        if any(mark in text for mark in system["marks"] for text in texts):
            entry: Mapping[Quantity, str] = system.get(key, {})
            return entry
    return {}


def words_of(name: str) -> tuple[str, ...]:
    """Return the words and numbers of a name in lower case."""
    return tuple(token.lower() for token in _TOKEN.findall(normalised(name)))


def last_number(words: Sequence[str]) -> int | None:
    """The last number in words, or None."""
    return next((int(word) for word in reversed(words) if word.isdecimal()), None)


def position(words: Sequence[str], part: Sequence[str]) -> int | None:
    """Position at which `part` is in `words`, or None if it is empty or absent."""
    starts = range(len(words) - len(part) + 1) if part else ()
    return next((k for k in starts if tuple(words[k : k + len(part)]) == tuple(part)), None)


def _compounds(words: Sequence[str]) -> list[str]:
    """Split words that consist of known words: istposition, 関節角速度; and singular forms."""
    result: list[str] = []
    for word in words:
        singular = next((s for s in (word[:-3] + "y", word[:-1]) if (s,) in _VOCABULARY), word)
        if (word,) in _VOCABULARY or word.isdecimal():
            result.append(word)
        elif (parts := _SYMBOL_ROLE.fullmatch(word)) and ("role", "desired") in _VOCABULARY.get(
            (parts[2],), ()
        ):
            result += parts.groups()  # qdes, tauref
        elif word.endswith("s") and (singular,) in _VOCABULARY and len(singular) > 2:
            result.append(singular)
        else:
            result += _split(word) or [word]
    return result


def _split(word: str) -> list[str] | None:
    """Split a word into known words, the longest first; None if that is impossible."""
    is_cjk = re.match(f"[{_CJK}]", word) is not None
    minimum = 1 if is_cjk else _MIN_COMPOUND_PART
    if not word:
        return []
    for length in range(len(word), minimum - 1, -1):
        if (word[:length],) in _VOCABULARY:
            remainder = word[length:]
            tail = _split(remainder)
            if tail is None and remainder.startswith("s"):
                tail = _split(remainder[1:])  # Geschwindigkeitssollwert
            if tail is not None:
                return [word[:length], *tail]
    if is_cjk:  # an unknown character names the joint
        tail = _split(word[1:])
        return [word[0], *tail] if tail is not None else None
    return None
