"""Every arm's parameters over its visits: what changes by more than chance explains."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.monitoring.joint_tests import holm
from strainwave.monitoring.shapes import FEWEST, Change, change_of
from strainwave.monitoring.visits import ArmHistory, Histories, ParameterHistory


@dataclass(frozen=True, slots=True, eq=False)
class ParameterTrend:
    """What one parameter does over the visits of an arm."""

    history: ParameterHistory
    change: Change
    adjusted_p: float = 1.0  # among all parameters of the arm, by Holm

    @property
    def percent(self) -> float | None:
        """The change over the history, of the level before; None where that may be zero."""
        return self.of_level(self.change.size)

    def of_level(self, size: float) -> float | None:
        """A size in percent of the level; None where that may be zero."""
        level = abs(self.change.level)
        spread = float(np.median(self.history.series.std)) + self.change.repeatability
        return 100.0 * size / level if level > 2.0 * spread else None

    @property
    def is_likely_chance(self) -> bool:
        """Whether an arm that does not change shows as much in every other look."""
        return self.adjusted_p > 0.5

    @property
    def words(self) -> str:
        """What kind of change, and since when."""
        if self.is_likely_chance:
            return "none"
        kind, first = self.change.shape.kind, self.change.shape.first
        date = f"{self.history.visits[first].time:%Y-%m-%d}"
        return kind if kind == "drift" else f"{'step at' if kind == 'step' else kind} {date}"


@dataclass(frozen=True, slots=True, eq=False)
class ArmTrend:
    """One arm, its parameters in the order of concern."""

    history: ArmHistory
    parameters: tuple[ParameterTrend, ...]
    too_few: tuple[tuple[str, int], ...]  # parameters with too few visits, and their number

    @property
    def p(self) -> float:
        """Of the clearest change, adjusted for the number of parameters; 1 without any."""
        return min((one.adjusted_p for one in self.parameters), default=1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """A fleet, its arms in the order of concern."""

    level: float  # probability of a false alarm, per arm
    arms: tuple[ArmTrend, ...]
    covariates: tuple[str, ...]
    notes: tuple[str, ...]

    def concerns(self, arm: ArmTrend) -> tuple[ParameterTrend, ...]:
        """Parameters of an arm that change."""
        return tuple(one for one in arm.parameters if one.adjusted_p < self.level)

    @property
    def concern(self) -> bool:
        """Whether any arm changes."""
        return any(self.concerns(arm) for arm in self.arms)


def trend(histories: Histories, level: float = 0.01) -> Trend:
    """Look for changes in each parameter of each arm.

    The p-value of a parameter is that of any shape of `strainwave.monitoring.shapes`; those of an
    arm's parameters are adjusted by Holm, so that an arm that does not change is named with a
    probability of at most `level`, however its parameters depend on each other.

    Parameters
    ----------
    histories : Histories
    level : float
        Between 0 and 1.

    Returns
    -------
    Trend

    Raises
    ------
    InvalidInput
        The level is no probability.
    NotIdentifiable
        No parameter of any arm has visits enough.
    """
    if not 0.0 < level < 1.0:
        raise InvalidInput(f"the level {level:g} is no probability", remedy="give 0.01, say")
    arms = [_arm(history) for history in histories.arms]
    if not any(arm.parameters for arm in arms):
        most = max((len(h.visits) for h in histories.arms), default=0)
        needed = FEWEST + 1 + len(histories.covariates)
        raise NotIdentifiable(
            f"no arm has visits enough for a trend: {len(arms)} arm(s) of at most {most} visit(s), "
            f"and {needed} with different times are needed"
        )
    arms.sort(key=lambda arm: (arm.p, arm.history.arm))
    return Trend(level, tuple(arms), histories.covariates, histories.notes)


def _arm(history: ArmHistory) -> ArmTrend:
    found, too_few = [], []
    for own in history.parameters:
        change = change_of(own.series, _rng(history.arm, own.label))
        if change is None:
            too_few.append((own.label, len(own.visits)))
        else:
            found.append(ParameterTrend(own, change))
    ordered = sorted(_adjusted(found), key=lambda one: (one.adjusted_p, one.change.p))
    return ArmTrend(history, tuple(ordered), tuple(too_few))


def _adjusted(found: Sequence[ParameterTrend]) -> Iterator[ParameterTrend]:
    adjusted = holm([one.change.p for one in found])
    for one, p in zip(found, adjusted, strict=True):
        yield replace(one, adjusted_p=p)


def _rng(*names: str) -> np.random.Generator:
    """The same draws for the same parameter, whatever else is in the store."""
    digest = hashlib.sha256("\n".join(names).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "big"))
