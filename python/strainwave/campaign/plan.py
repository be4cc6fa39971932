"""The cases that still have to run: those without a recorded run with the same hashes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from strainwave.campaign.cases import Case
from strainwave.campaign.store import Store
from strainwave.campaign.tasks import FAILED_STATUS, Outcome, Task, merged
from strainwave.domain import Stage


@dataclass(frozen=True)
class Plan:
    """Stages and options of a campaign, and its store."""

    store: Store
    campaign: str  # its name in the rows of the runs
    stages: tuple[Stage, ...]
    options: Mapping[str, Mapping[str, Any]]
    retry_failed: bool = False

    def next(self, case: Case) -> Task | Outcome:
        """The task of a case, or its outcome if that is recorded."""
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
        recorded = self.store.recorded(task.run)
        if recorded is None or (self.retry_failed and recorded.status == FAILED_STATUS):
            return task
        return Outcome.of(recorded._asdict(), skipped=True)
