"""Parameters of each arm over its visits: which change significantly."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.fleet.monitoring.comparison import (
    CommonFactor,
    adjust_p_values,
    common_factor,
    is_torque_like,
)
from strainwave.fleet.monitoring.shapes import MIN_VISITS, DetectedChange, fit_change
from strainwave.fleet.monitoring.visits import ArmHistory, Histories, ParameterHistory

_MIN_LEVEL_STDS = 2.0  # a level within two standard deviations of zero gives no percentages
_MIN_CHANCE_P = 0.5  # an unchanged arm exceeds it in half of all analyses
_MAX_SINGLE_VISIT_SHARE = 0.5  # share of arms with one visit; more suggests wrongly named arms


@dataclass(frozen=True, slots=True, eq=False)
class ParameterTrend:
    """The most significant change of one parameter over the visits of an arm."""

    history: ParameterHistory
    change: DetectedChange
    adjusted_p: float = 1.0  # by Holm, over all parameters of the arm

    @property
    def percent(self) -> float | None:
        """The change over the history in percent of the level before; None as `of_level`."""
        return self.of_level(self.change.size)

    def of_level(self, size: float) -> float | None:
        """A size in percent of the level; None if the level may be zero."""
        level = abs(self.change.level)
        spread = float(np.median(self.history.series.std)) + self.change.repeatability
        return 100.0 * size / level if level > _MIN_LEVEL_STDS * spread else None

    @property
    def is_likely_chance(self) -> bool:
        """Whether the change is more likely chance than not."""
        return self.adjusted_p > _MIN_CHANCE_P

    @property
    def words(self) -> str:
        """Kind and date of the change, or "none"."""
        if self.is_likely_chance:
            return "none"
        kind, first = self.change.shape.kind, self.change.shape.first
        date = f"{self.history.visits[first].time:%Y-%m-%d}"
        return kind if kind == "drift" else f"{'step at' if kind == 'step' else kind} {date}"


@dataclass(frozen=True, slots=True, eq=False)
class ArmTrend:
    """One arm with its parameters, most significant change first."""

    history: ArmHistory
    parameters: tuple[ParameterTrend, ...]
    too_few: tuple[tuple[str, int], ...]  # parameters with too few visits, number of visits
    factor: CommonFactor | None = None  # of all torque-like parameters

    @property
    def p(self) -> float:
        """Adjusted p-value of the most significant change; 1 if no parameter was tested."""
        return min((parameter.adjusted_p for parameter in self.parameters), default=1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """A fleet of arms, most significant change first."""

    level: float  # probability of a false alarm, per arm
    arms: tuple[ArmTrend, ...]
    covariates: tuple[str, ...]
    notes: tuple[str, ...]

    def concerns(self, arm: ArmTrend) -> tuple[ParameterTrend, ...]:
        """Parameters of an arm that change significantly."""
        return tuple(parameter for parameter in arm.parameters if parameter.adjusted_p < self.level)

    @property
    def concern(self) -> bool:
        """Whether any arm changes significantly."""
        return any(self.concerns(arm) for arm in self.arms)


def trend(histories: Histories, level: float = 0.01) -> Trend:
    """Test each parameter of each arm for a change.

    The p-value of a parameter is that of any shape of `shapes.py`. Those of one
    arm are adjusted by Holm, so that an unchanged arm is reported with a probability of at most
    `level`, under any dependence of its parameters. Raises `InvalidInput` if the level is not
    between 0 and 1, and `NotIdentifiable` if no arm has enough visits.
    """
    if not 0.0 < level < 1.0:
        raise InvalidInput(
            f"the level {level:g} is not a probability", remedy="give for example 0.01"
        )
    arms = [_test_arm(history, level) for history in histories.arms]
    if not any(arm.parameters for arm in arms):
        max_visits = max((len(h.visits) for h in histories.arms), default=0)
        n_required = MIN_VISITS + 1 + len(histories.covariates)
        raise NotIdentifiable(
            f"no arm has enough visits for a trend: {len(arms)} arm(s) with at most {max_visits} "
            f"visit(s), but {n_required} at different times are required; "
            f"{arm_naming_hint(histories)}"
        )
    arms.sort(key=lambda arm: (arm.p, arm.history.arm))
    notes = histories.notes
    notes += tuple(f"{arm.history.arm}: {arm.factor.sentence}" for arm in arms if arm.factor)
    n_single_visits = sum(len(arm.visits) == 1 for arm in histories.arms)
    if n_single_visits > _MAX_SINGLE_VISIT_SHARE * len(arms):
        notes += (
            f"{n_single_visits} of {len(arms)} arms have one visit; {arm_naming_hint(histories)}",
        )
    return Trend(level, tuple(arms), histories.covariates, notes)


def arm_naming_hint(histories: Histories) -> str:
    """Explain how to name arms, with a study of the store as an example."""
    study = next((arm.visits[0].study for arm in histories.arms if arm.visits), "")
    return (
        "an arm is the folder of its studies unless --arm names it, for example "
        f"--arm '([^/]+)/[^/]+/[^/]+$' for the folder above; the store has studies such as "
        f"{study!r}"
    )


def _test_arm(arm: ArmHistory, level: float) -> ArmTrend:
    tested, too_few = [], []
    for history in arm.parameters:
        change = fit_change(history.series, _rng(arm.arm, history.label))
        if change is None:
            too_few.append((history.label, len(history.visits)))
        else:
            tested.append(ParameterTrend(history, change))
    adjusted = adjust_p_values([parameter.change.p for parameter in tested])
    trends = [replace(t, adjusted_p=p) for t, p in zip(tested, adjusted, strict=True)]
    trends.sort(key=lambda parameter: (parameter.adjusted_p, parameter.change.p))
    changes = [each.change for each in trends if is_torque_like(each.history.unit)]
    factor = common_factor(
        ((one.level, 0.0, one.level + one.size, one.size_std) for one in changes), level
    )
    return ArmTrend(arm, tuple(trends), tuple(too_few), factor)


def _rng(*names: str) -> np.random.Generator:
    """A generator that depends on these names only, not on the rest of the store."""
    digest = hashlib.sha256("\n".join(names).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "big"))
