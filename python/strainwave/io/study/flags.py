"""Options that are not in a file: `--set STAGE.KEY=VALUE`, or arguments of a function."""

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
    """Reader of a table that is not in a file. Every place is the flag itself."""

    def place(self, name: str = "", index: int | None = None, key: str | None = None) -> str:
        """The flag."""
        return self.text


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
