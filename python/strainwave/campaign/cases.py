"""Cases of a campaign: studies to identify, small enough to be sent to any worker.

A worker opens a case and gets a study with its logs. `strainwave.campaign.tasks` lists the kinds:
study files, and virtual arms of a family.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

from strainwave.domain import Study
from strainwave.domain.keys import Key
from strainwave.io.logs.in_memory import Data


class Hashes(NamedTuple):
    """Hashes of the inputs of a case."""

    study_sha256: str | None  # None: the study file cannot be read
    inputs_sha256: str


@dataclass(frozen=True)
class Opened:
    """A case as `pipeline.identify` takes it."""

    study: Study | Path
    data: Data | None = None
    truth: Mapping[Key, float] = field(default_factory=dict)
    """(name, joint) -> true value of a virtual arm."""
    classes: Mapping[str, Any] = field(default_factory=dict)
    """Properties with which a virtual arm was drawn, as plain JSON values."""


class Case(Protocol):
    """One study of a campaign: a frozen dataclass of plain JSON values."""

    kind: ClassVar[str]

    @property
    def name(self) -> str:
        """Value of the column `study`."""

    @property
    def options(self) -> Mapping[str, Mapping[str, Any]]:
        """Options of this case, which override those of the campaign: stage -> key -> value."""

    def hashes(self) -> Hashes:
        """Hashes of the study and its inputs; `InvalidInput` if the place cannot be read at all."""

    def opened(self) -> AbstractContextManager[Opened]:
        """The study to identify; temporary copies are removed on exit.

        Raises `InvalidInput` if the study or an input is invalid.
        """
