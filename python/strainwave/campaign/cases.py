"""One case of a campaign: a study to identify, small enough to be sent to any worker.

A worker opens the case and gets a study with its logs. `kinds` lists the kinds of cases: a study
file is one, and a virtual arm drawn by its number may be another.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

from strainwave.domain import Study
from strainwave.io.logs.in_memory import Data


class Hashes(NamedTuple):
    """What a case's result depends on, but for options and version."""

    study_sha256: str | None  # None where the study file cannot be read
    inputs_sha256: str


@dataclass(frozen=True)
class Opened:
    """A case as `pipeline.identify` takes it, and what is known of it beforehand."""

    study: Study | Path
    data: Data | None = None
    truth: Mapping[tuple[str, int | None], float] = field(default_factory=dict)
    """(name, joint) -> true value, of a virtual arm."""
    classes: Mapping[str, Any] = field(default_factory=dict)
    """What the arm was drawn with: plain JSON values."""


class Case(Protocol):
    """One study of a campaign. A frozen dataclass of plain JSON values is one."""

    kind: ClassVar[str]

    @property
    def name(self) -> str:
        """As in the column `study`."""

    @property
    def options(self) -> Mapping[str, Mapping[str, Any]]:
        """Options of this case alone, over the campaign's: stage -> key -> value."""

    def hashes(self) -> Hashes:
        """Of the study and of its inputs.

        Raises
        ------
        InvalidInput
            The place cannot be read at all.
        """

    def opened(self) -> AbstractContextManager[Opened]:
        """What a worker identifies; leaving removes what was fetched for it.

        Raises
        ------
        InvalidInput
            The study or an input is at fault.
        """

    def fields(self) -> dict[str, Any]:
        """Plain JSON values from which the case is made again."""
