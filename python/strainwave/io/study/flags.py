"""Options given elsewhere than in the file: `--set stage.key=value`, or by a caller."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from typing import Any

from strainwave.errors import InvalidInput
from strainwave.io.study.reader import Reader

_FLAG = re.compile(r"\s*(\w+)\.(\w+)\s*=\s*(.*\S)\s*", re.DOTALL)
_WORD = re.compile(r"[A-Za-z][\w-]*")


@dataclass(frozen=True)
class Flag(Reader):
    """A reader of a table that stands in no file: every place is the flag, its text."""

    def place(self, name: str = "", index: int | None = None, key: str | None = None) -> str:
        """The flag itself."""
        return self.text


def parsed(text: str) -> dict[str, dict[str, Any]]:
    """A flag as a table of tables.

    `text`: "stage.key=value", the value as in TOML; a bare word is a string. Returns: stage ->
    {key: value}. Raises `InvalidInput`: It is no such text, or the value is no TOML.
    """
    match = _FLAG.fullmatch(text)
    if match is None:
        raise InvalidInput(
            "is not of the form stage.key=value",
            where=f"--set {text}",
            remedy="write for example --set links.time_constant=0.1",
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
            remedy="write a number, true, a word, [a, b] or { name = [a, b] }, quoted",
        ) from error
    if set(document) != {"value"}:
        raise InvalidInput(
            "holds more than one value", where=f"--set {text}", remedy="repeat --set for each"
        )
    return {stage: {key: document["value"]}}
