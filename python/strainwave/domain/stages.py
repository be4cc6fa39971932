"""The stages of an identification."""

from __future__ import annotations

from typing import Literal, get_args

Stage = Literal["rigid", "decoupled", "tuned"]
STAGES: tuple[Stage, ...] = get_args(Stage)
"""All stages in order; a run executes a prefix of them."""
