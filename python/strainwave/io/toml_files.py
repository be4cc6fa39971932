"""TOML documents that a user writes: read, or refused in one sentence."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import nearest


def parsed_toml(text: str, path: Path) -> dict[str, Any]:
    """The document that a file holds.

    Parameters
    ----------
    text : str
    path : Path
        For the message.

    Returns
    -------
    dict

    Raises
    ------
    InvalidInput
        It is no TOML.
    """
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InvalidInput(
            f"is not valid TOML ({error})", where=str(path), remedy="mend that line"
        ) from error


def check_keys(document: dict[str, Any], known: Sequence[str], path: Path) -> None:
    """Refuse a document with keys that nothing reads.

    Parameters
    ----------
    document : dict
    known : sequence of str
    path : Path
        For the message.

    Raises
    ------
    InvalidInput
        There is one.
    """
    for key in document:
        if key not in known:
            raise InvalidInput(
                f"unknown key '{key}'",
                where=str(path),
                remedy=f"use {', '.join(known)}{nearest(key, known)}",
            )
