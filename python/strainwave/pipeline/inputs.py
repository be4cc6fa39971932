"""What the stages of a run start from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from strainwave.domain import Log, Place, Stage, Study, Use
from strainwave.domain.keys import Key, Values, label_of
from strainwave.domain.parameters import complete_values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.io.parameters import read_parameters


@dataclass(frozen=True, slots=True)
class Inputs:
    """A study, its arm, its usable records and the requested stages."""

    study: Study
    arm: Arm
    logs: tuple[Log, ...]
    stages: tuple[Stage, ...]
    start: Mapping[Key, float] = field(default_factory=dict)  # of the whole-arm fit, if given

    def logs_of(self, *uses: Use) -> list[Log]:
        """Records of the given uses, in the order of the study."""
        return [log for log in self.logs if log.experiment.use in uses]

    @property
    def place(self) -> Place:
        """The study file."""
        return Place(file=str(self.study.path))


def read_start(start: Path | Mapping[Key, float] | None, study: Study) -> Values:
    """Values at which the whole-arm fit starts, from a parameter file or as they are.

    Other values of a result.json, such as combinations and sensor constants, are left out. Raises
    InvalidInput if none of the values is a parameter of the arm.
    """
    if start is None:
        return {}
    values = read_parameters(start) if isinstance(start, Path) else dict(start)
    arm = study.arm.with_selected_laws(values.keys())
    given = complete_values(values, arm)
    known = set(Arm.of(arm).parameter_names)
    values = {key: value for key, value in given.items() if key in known}
    if not values:
        names = ", ".join(label_of(*key) for key in list(known)[:4])
        raise InvalidInput(
            "no value is a parameter of this arm",
            where=str(start) if isinstance(start, Path) else "start",
            remedy=f"give parameters such as {names}",
        )
    return values
