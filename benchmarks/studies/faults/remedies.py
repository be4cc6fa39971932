"""What follows if the printed corrections of a fault are obeyed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from benchmarks.studies.faults.comparison import EXACT, Tolerance, differences
from benchmarks.studies.faults.inputs import Case, Input
from strainwave.domain import Suspicion
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_logs
from strainwave.pipeline.inputs import check_input

MAX_ROUNDS = 4  # corrections that are obeyed one after the other

Remedy = Literal["right", "objects", "wrong", "no-op", "none"]
"""No suspicion and the values are right, or wrong; the check still objects; a correction changes
nothing; no correction is printed."""


@dataclass(frozen=True, slots=True)
class Obedience:
    """Class of the remedies of an input, the input in the end, and what differs from the truth."""

    remedy: Remedy
    given: Input
    differing: tuple[str, ...] = ()


def obey(case: Case, suspected: tuple[Suspicion, ...]) -> Obedience:
    """Obey the first correction that the check prints, check again, and so on.

    `suspected`: Result of the check of the case; not empty.
    """
    given = case.given
    for k in range(MAX_ROUNDS):
        corrections = next((each.corrections for each in suspected if each.corrections), ())
        if not corrections:
            return Obedience("objects" if k else "none", given)
        after = given.obeyed(corrections)
        try:
            if _is_same(after, given):
                return Obedience("no-op", given)
            given = after
            suspected = check_input(given.study, data=given.tables).suspected
        except InvalidInput:
            return Obedience("objects", given)
        if not suspected:
            differing = tuple(differences(given, case.truth or given, Tolerance()))
            return Obedience("wrong" if differing else "right", given, differing)
    return Obedience("objects", given)


def _is_same(after: Input, before: Input) -> bool:
    """Whether corrections change neither a constant nor a channel, and remove none."""
    names = [
        {
            (log.name, channel)
            for log in read_logs(each.study, data=each.tables)
            for channel in log.channels
        }
        for each in (after, before)
    ]
    return names[0] == names[1] and not differences(after, before, EXACT)
