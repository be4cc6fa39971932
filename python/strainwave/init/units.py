"""Units of the table units.toml: their spellings, factors to SI, and those that forms offer."""

from __future__ import annotations

import math
import re
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from strainwave.errors import InvalidInput

_TABLE: Mapping[str, Any] = tomllib.loads(
    Path(__file__).with_name("units.toml").read_text(encoding="utf-8")
)
_SIGN_OF_PRODUCT = re.compile(r"(?<!\d)\.|\.(?!\d)|[\s·⋅・*^_-]")
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_UNIT = r"(?![eE][+-]?\d)[^\d\s,:.+\[\]-][^,\[\]]*|1/[^,\[\]]+"
_QUANTITY = re.compile(rf"({_NUMBER})(?:\s*:\s*({_NUMBER}))?(?:\s*({_UNIT}))?")
_LAST_UNIT = re.compile(rf"[\d.\]]\s*({_UNIT})\s*$")


@dataclass(frozen=True, slots=True)
class FormUnit:
    """A unit of a form: SI value = factor * value**power, value = (SI value / factor)**power."""

    name: str
    factor: float
    power: int = 1  # or -1


def key_of(text: str) -> str:
    """The spelling of a unit in the table: `nm` for `N m`, `N·m` or `N*m`."""
    return _SIGN_OF_PRODUCT.sub("", normalised(text).lower())


def normalised(text: str) -> str:
    """Text without accents, in compatible characters; dots above a symbol become words."""
    text = unicodedata.normalize("NFKD", re.sub("[º˚]", "°", text).replace("℃", "°c"))
    text = re.sub("(?<=[qQθφ])\u0307", "dot", re.sub("(?<=[qQθφ])\u0308", "ddot", text))
    return unicodedata.normalize("NFC", re.sub("[\u0300-\u036f]", "", text)).replace("ß", "ss")


def spellings(group: str) -> Iterator[tuple[str, float]]:
    """The units of a group of the table, or of its rates: `rotation/s`, `length/s2`."""
    name, _, per = group.partition("/")
    endings = {
        "": ("",),
        "s": ("/s", "s", "ps", "pers", "s1", "/sec", "sec", "persec", "/秒"),
        "s2": ("/s2", "s2", "ps2", "pers2", "/s/s", "ss", "pss", "/sec2"),
    }[per]
    for texts, factor in _TABLE["units"][name].items():
        for text in texts.split():
            yield from ((text + ending, factor) for ending in endings)


@cache
def form_units(unit: str) -> tuple[FormUnit, ...]:
    """The units that forms offer for an SI unit, which is the first; empty if there are none."""
    menu, factors = _TABLE["menu"].get(key_of(unit), {}), _factors(unit)
    return tuple(
        FormUnit(name, factors[key_of(name)], power)
        for power, names in ((1, "names"), (-1, "reciprocals"))
        for name in menu.get(names, ())
    )


def _factors(unit: str) -> dict[str, float]:
    """All spellings of the units of an SI unit."""
    groups = _TABLE["menu"].get(key_of(unit), {}).get("groups", "")
    return {text: factor for group in groups.split() for text, factor in spellings(group)}


def in_si(text: str, unit: str, chosen: str = "") -> str:
    """A text with every number in an SI unit: `100:1`, `30 deg`, `10, 20, 30 mm`.

    Numbers without a unit have that of the last number, or else the chosen one. Raises InvalidInput
    if the field has no such unit.
    """
    last = _LAST_UNIT.search(text)
    if last:
        text, chosen = text[: last.start(1)], last[1]
    return _QUANTITY.sub(lambda match: _converted(match, unit, chosen), text)


def _converted(match: re.Match[str], unit: str, chosen: str) -> str:
    number, per, given = match.groups("")
    name, units = (given or chosen).strip(), form_units(unit)
    reciprocals = [key_of(each.name) for each in units if each.power < 0]
    if per and reciprocals:  # a:b of a gear, which reduces the speed
        sizes = sorted([abs(float(number)), abs(float(per))])
        value = math.copysign(sizes[0] / sizes[1], float(number)) if sizes[1] else 0.0
        return f"{value:.15g}"
    factor = _factors(unit).get(key_of(name)) if name else 1.0
    if per or factor is None:
        names = ", ".join(each.name for each in units)
        remedy = f"use {names}" if names else "write the number only"
        written = f"{number}:{per}" if per else name
        raise InvalidInput(f"{written!r} is no unit of the value", remedy=remedy)
    if key_of(name) not in reciprocals:
        return number if factor == 1.0 else f"{factor * float(number):.15g}"
    if not float(number):
        raise InvalidInput(
            "a ratio of zero has no reciprocal", remedy="write a ratio such as 100:1"
        )
    return f"{factor / float(number):.15g}"
