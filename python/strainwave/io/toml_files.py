"""TOML documents that a user writes."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from strainwave.errors import InvalidInput, suggest_name


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """The parsed text; `InvalidInput` naming `path` if it is not valid TOML."""
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InvalidInput(
            f"is not valid TOML ({error})", where=str(path), remedy="correct that line"
        ) from error


def check_keys(document: dict[str, Any], known: Sequence[str], path: Path) -> None:
    """Raise `InvalidInput` if the document has an unknown key."""
    for key in document:
        if key not in known:
            raise InvalidInput(
                f"unknown key '{key}'",
                where=str(path),
                remedy=f"use {', '.join(known)}{suggest_name(key, known)}",
            )
