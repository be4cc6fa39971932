"""What the stages of a run start from."""

from __future__ import annotations

from dataclasses import dataclass

from strainwave.domain import Log, Place, Stage, Study, Use
from strainwave.dynamics.arm import Arm


@dataclass(frozen=True, slots=True)
class Inputs:
    """A study, its arm, its usable records and the requested stages."""

    study: Study
    arm: Arm
    logs: tuple[Log, ...]
    stages: tuple[Stage, ...]

    def logs_of(self, *uses: Use) -> list[Log]:
        """Records of the given uses, in the order of the study."""
        return [log for log in self.logs if log.experiment.use in uses]

    @property
    def place(self) -> Place:
        """The study file."""
        return Place(file=str(self.study.path))
