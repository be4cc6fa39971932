"""Cases of virtual arms, which the worker draws by their number and records in memory."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from benchmarks.families import Family, draw, family_of, fields_of, record
from strainwave.fleet.campaign.study_files import Opened


@dataclass(frozen=True)
class DrawnArm:
    """One arm of a family, which any process can draw again."""

    name: str  # campaign.toml#number
    family: Mapping[str, Any]  # as in `[family]`
    number: int  # from 0
    options: ClassVar[Mapping[str, Any]] = MappingProxyType({})  # the campaign contains them

    def hashes(self) -> tuple[str, str]:
        """Hashes of the family without its number of arms, and of the number of this arm."""
        drawn_from = {key: value for key, value in self.family.items() if key != "arms"}
        return _sha256(drawn_from), _sha256([drawn_from, self.number])

    @contextmanager
    def opened(self) -> Iterator[Opened]:
        """Study, logs, true values and properties of the arm."""
        family = family_of(self.family, Path(self.name), "")
        arm = draw(family, self.number)
        recorded = record(arm)
        yield Opened(recorded.study, recorded.data, arm.truth, recorded.classes)


def arms_of(family: Family, path: Path) -> list[DrawnArm]:
    """One case per arm of the family that the campaign.toml at `path` describes."""
    table = fields_of(family)
    return [DrawnArm(f"{path}#{number}", table, number) for number in range(family.arms)]


def _sha256(values: object) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
