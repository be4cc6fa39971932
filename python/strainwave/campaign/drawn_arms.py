"""The case of a virtual arm, drawn by its number and recorded in memory where it is identified."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

from strainwave.campaign.cases import Hashes, Opened
from strainwave.virtual.families import Family, draw, family_of, fields_of, record


@dataclass(frozen=True)
class DrawnArm:
    """One arm of a family; no file is needed where it is drawn again."""

    name: str  # campaign.toml#number
    family: Mapping[str, Any]  # as in `[family]`
    number: int  # from 0
    kind: ClassVar[str] = "drawn-arm"

    @property
    def options(self) -> Mapping[str, Mapping[str, Any]]:
        """None: the campaign has them."""
        return {}

    def fields(self) -> dict[str, Any]:
        """Plain JSON values from which the case is made again."""
        return asdict(self)

    def hashes(self) -> Hashes:
        """Of the family but for its count of arms, and of the number within it.

        Returns
        -------
        Hashes
        """
        drawn_from = {key: value for key, value in self.family.items() if key != "arms"}
        return Hashes(_sha256(drawn_from), _sha256([drawn_from, self.number]))

    @contextmanager
    def opened(self) -> Iterator[Opened]:
        """The arm's study and logs, its true values, and what it was drawn with."""
        family = family_of(self.family, Path(self.name), "")
        arm = draw(family, self.number)
        recorded = record(arm)
        yield Opened(recorded.study, recorded.data, arm.truth, recorded.classes)


def arms_of(family: Family, path: Path) -> list[DrawnArm]:
    """A case per arm.

    Parameters
    ----------
    family : Family
    path : Path
        Of the campaign.toml, for names.

    Returns
    -------
    list of DrawnArm
    """
    table = fields_of(family)
    return [DrawnArm(f"{path}#{number}", table, number) for number in range(family.arms)]


def _sha256(values: object) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
