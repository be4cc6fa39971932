"""Result of the input check: relations between channels and study, and suspected faults."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

from strainwave.domain.estimates import Diagnostic, Suspicion
from strainwave.domain.link_sensors import link_channel_kinds
from strainwave.domain.messages import Clause, Place, places_text, text_of
from strainwave.domain.study import Study, channel_parts

Bound = Literal["equal", "least", "most"]
"""What the expected value of a relation is."""

_LINK_GEOMETRY = ("accelerometer_distance", "link_length")
"""Keys of the study that affect only predictions of link sensors."""


@dataclass(frozen=True, slots=True)
class Relation:
    """A number that the channels and the study determine, and its value for consistent input."""

    kind: str
    place: Place
    measured: float
    std: float  # standard deviation; 0: not estimated
    expected: float | None  # None: any positive value
    is_consistent: bool
    accuracy: float  # largest difference from the expected value of consistent input
    bound: Bound = "equal"

    @property
    def text(self) -> str:
        """The kind of the relation, as the terminal names it."""
        return text_of(Clause(f"relation/{self.kind}"))

    @property
    def where(self) -> str:
        """Text of the place."""
        return places_text((self.place,))


@dataclass(frozen=True, slots=True)
class Consistency:
    """Result of the input check: relations, and faults suspected before any fit."""

    suspected: tuple[Suspicion, ...] = ()
    relations: tuple[Relation, ...] = ()
    warnings: tuple[Diagnostic, ...] = ()
    unchecked: tuple[str, ...] = ()  # channels that occur in no relation

    @property
    def deciding(self) -> tuple[Suspicion, ...]:
        """Suspected faults that decide the status: those that are not accepted."""
        return tuple(each for each in self.suspected if not each.accepted)

    @property
    def motors_agree(self) -> bool:
        """Whether all deciding faults concern link sensors, their positions or the link length."""
        return all(_is_on_link(place) for suspicion in self.deciding for place in suspicion.places)

    def suspecting(self, *further: Suspicion, accept: Collection[str]) -> Consistency:
        """With further suspicions; those with a code in `accept` are marked as accepted."""
        all_faults = (*self.suspected, *further)
        marked = (replace(f, accepted=f.accepted or f.code in accept) for f in all_faults)
        return replace(self, suspected=tuple(marked))


def _is_on_link(place: Place) -> bool:
    is_link_channel = (
        place.channel is not None and channel_parts(place.channel)[0] in link_channel_kinds()
    )
    return is_link_channel or place.key in _LINK_GEOMETRY


CheckStatus = Literal["consistent", "inconsistent-input"]


@dataclass(frozen=True, slots=True)
class InputCheck:
    """Consistency of the input of a study, without any identification."""

    study: Study
    relations: tuple[Relation, ...]
    suspected: tuple[Suspicion, ...]
    warnings: tuple[Diagnostic, ...]
    unchecked: tuple[str, ...]  # channels that occur in no relation
    seconds: float  # for reading and checking

    @property
    def status(self) -> CheckStatus:
        """Whether a fault of the input is suspected and not accepted."""
        is_decided = all(each.accepted for each in self.suspected)
        return "consistent" if is_decided else "inconsistent-input"

    @property
    def exit_code(self) -> int:
        """0 if the input is consistent, otherwise 3."""
        return 0 if self.status == "consistent" else 3
