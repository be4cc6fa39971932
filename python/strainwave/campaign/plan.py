"""Which cases still have to run: those that the store does not have at these hashes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from strainwave.campaign.cases import Case
from strainwave.campaign.store import Store
from strainwave.campaign.tasks import FAILED, Outcome, Task, merged


@dataclass(frozen=True)
class Plan:
    """What is done with every case of a campaign."""

    store: Store
    campaign: str  # its name in the runs' rows
    stages: tuple[str, ...]
    options: Mapping[str, Mapping[str, Any]]
    retry_failed: bool = False

    def next(self, case: Case) -> Task | Outcome:
        """A case's task, or how it ended where that is recorded.

        Parameters
        ----------
        case : Case

        Returns
        -------
        Task or Outcome
        """
        hashes = case.hashes()
        task = Task(
            case=case,
            study_sha256=hashes.study_sha256,
            inputs_sha256=hashes.inputs_sha256,
            stages=self.stages,
            options=merged([self.options, case.options]),
            store=str(self.store.place),
            campaign=self.campaign,
        )
        known = self.store.recorded(task.run)
        if known is None or (self.retry_failed and known.status == FAILED):
            return task
        return Outcome.of(task.run, case.name, known, skipped=True)
