"""Texts of the arguments and options of the commands, which help, forms and documentation show."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any


@cache
def command_texts() -> dict[str, dict[str, dict[str, Any]]]:
    """By command, or "shared", the texts of `commands.toml` of each argument and option."""
    return tomllib.loads(Path(__file__).with_name("commands.toml").read_text(encoding="utf-8"))
