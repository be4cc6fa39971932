"""Two or more results of one arm: which parameters differ by more than their errors explain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Parameter
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.monitoring.estimates import Estimates, degrees_of
from strainwave.monitoring.joint_tests import JointTest, holm, joint_test, welch_test

SAME, DIFFERS = "agrees", "differs"

_REACH = 1.96  # deviations within which a value is zero, so that no change is a share of it


@dataclass(frozen=True, slots=True)
class ParameterDifference:
    """One parameter in two results."""

    first: Parameter
    second: Parameter
    z: float  # change over its standard deviation
    p: float  # two-sided, if nothing changed
    adjusted_p: float = 1.0  # among all tests of the comparison, by Holm

    @property
    def change(self) -> float:
        """Second less first."""
        return _value(self.second) - _value(self.first)

    @property
    def std(self) -> float:
        """Of the change: the results' errors are independent."""
        return float(np.hypot(_std(self.first), _std(self.second)))

    @property
    def percent(self) -> float | None:
        """The change, of the first value; None where that is zero within its 95 % interval."""
        first = self._reference
        return 100.0 * self.change / first if first else None

    @property
    def std_percent(self) -> float | None:
        """Standard deviation of the change, of the first value; None as for `percent`."""
        first = self._reference
        return 100.0 * self.std / first if first else None

    @property
    def _reference(self) -> float:
        """Size of the first value; zero where it may be zero."""
        size = abs(_value(self.first))
        return size if size > _REACH * _std(self.first) else 0.0


@dataclass(frozen=True, slots=True)
class Pair:
    """A result against the first one."""

    first: str  # label
    second: str
    parameters: tuple[ParameterDifference, ...]
    joint: JointTest | None  # of all parameters that both results have in their covariances
    left_out: tuple[tuple[str, str], ...]  # parameter, and why it is not compared


@dataclass(frozen=True, slots=True)
class ResultComparison:
    """Two or more results, the first against each other one, and all at once."""

    level: float  # probability of a difference named where nothing changed
    results: tuple[Estimates, ...]
    pairs: tuple[Pair, ...]
    homogeneity: JointTest | None  # over all results, where there are more than two
    notes: tuple[str, ...]

    def verdict(self, test: ParameterDifference | JointTest) -> str:
        """Whether one test names a difference."""
        return DIFFERS if test.adjusted_p < self.level else SAME

    @property
    def tests(self) -> tuple[ParameterDifference | JointTest, ...]:
        """All that share the probability of a false alarm."""
        joint = (*(pair.joint for pair in self.pairs), self.homogeneity)
        each = [one for pair in self.pairs for one in pair.parameters]
        return (*each, *(test for test in joint if test is not None))

    @property
    def differs(self) -> bool:
        """Whether any test names a difference."""
        return any(test.adjusted_p < self.level for test in self.tests)


def compare(results: Sequence[Estimates], level: float = 0.05) -> ResultComparison:
    """Compare results of one arm from independent data.

    Each change is tested against sqrt(s_a^2 + s_b^2), all changes at once by d' S^+ d with
    S = S_a + S_b. All tests are one family, whose p-values are adjusted by Holm: where nothing
    changed, a difference is named with a probability of at most `level`.

    Parameters
    ----------
    results : sequence of Estimates
        Two or more; the first is compared with each other one.
    level : float
        Between 0 and 1.

    Returns
    -------
    ResultComparison

    Raises
    ------
    InvalidInput
        The level is no probability, or there are fewer than two results.
    NotIdentifiable
        No parameter has a value and a standard deviation in two of them.
    """
    if not 0.0 < level < 1.0:
        raise InvalidInput(f"the level {level:g} is no probability", remedy="give 0.05, say")
    if len(results) < 2:
        raise InvalidInput("a comparison needs two results", remedy="name two result.json or more")
    first, *others = results
    pairs = [_pair(first, other) for other in others]
    if not any(pair.parameters for pair in pairs):
        raise NotIdentifiable(
            "there is nothing to compare: no parameter has a value and a standard deviation in "
            "both results"
        )
    homogeneity = _homogeneity(results) if len(others) > 1 else None
    found = ResultComparison(
        level, tuple(results), tuple(pairs), homogeneity, tuple(_notes(results, pairs))
    )
    return _adjusted(found)


def _adjusted(found: ResultComparison) -> ResultComparison:
    """With p-values of the whole family."""
    adjusted = iter(holm([test.p for test in found.tests]))
    each = [
        tuple(replace(one, adjusted_p=next(adjusted)) for one in pair.parameters)
        for pair in found.pairs
    ]
    joint = [
        None if pair.joint is None else replace(pair.joint, adjusted_p=next(adjusted))
        for pair in found.pairs
    ]
    pairs = tuple(
        replace(pair, parameters=own, joint=test)
        for pair, own, test in zip(found.pairs, each, joint, strict=True)
    )
    whole = found.homogeneity and replace(found.homogeneity, adjusted_p=next(adjusted))
    return replace(found, pairs=pairs, homogeneity=whole)


def _pair(first: Estimates, second: Estimates) -> Pair:
    of_second = {p.label: p for p in second.parameters}
    of_first = {p.label: p for p in first.parameters}
    left_out, found = [], []
    for label in dict.fromkeys([*of_first, *of_second]):
        a, b = of_first.get(label), of_second.get(label)
        why = _why_not(a, b, first.label, second.label)
        if why or a is None or b is None:
            left_out.append((label, why))
            continue
        z, p = welch_test(_value(b) - _value(a), (_std(a), _std(b)), (degrees_of(a), degrees_of(b)))
        found.append(ParameterDifference(a, b, z, p))
    compared = {one.first.label for one in found}
    joint = _joint_of((first, second), compared)
    return Pair(first.label, second.label, tuple(found), joint, tuple(left_out))


def _why_not(a: Parameter | None, b: Parameter | None, first: str, second: str) -> str:
    """Why two entries are not compared; empty if they are."""
    for own, where in ((a, first), (b, second)):
        if own is None or own.value is None:
            return f"not identified in {where}"
        if own.std is None or not own.std > 0.0:
            return f"without standard deviation in {where}"
    if a is not None and b is not None and a.unit != b.unit:
        return f"in {a.unit} and in {b.unit}"
    return ""


def _homogeneity(results: Sequence[Estimates]) -> JointTest | None:
    common = set.intersection(*(_usable(one) for one in results))
    return _joint_of(results, common)


def _usable(one: Estimates) -> set[str]:
    return {p.label for p in one.parameters if p.value is not None and p.std}


def _joint_of(results: Sequence[Estimates], compared: set[str]) -> JointTest | None:
    """Of the differences from the first result, of the parameters in every result's covariance.

    With d = (x_2 - x_1, x_3 - x_1, ...) the first result's covariance is in every block.
    """
    known = [one.covariance for one in results]
    if any(one is None for one in known):
        return None
    covariances = [one for one in known if one is not None]
    shared = set.intersection(compared, *(set(one.names) for one in covariances))
    names = [name for name in covariances[0].names if name in shared]
    if not names:
        return None
    values = [np.array([_value(one.of(name)) for name in names]) for one in results]
    matrices = []
    for one in covariances:
        at = [one.names.index(name) for name in names]
        matrices.append(one.matrix[np.ix_(at, at)])
    others = len(results) - 1
    where = [np.ones((others, others)), *(_unit(others, k) for k in range(others))]
    parts = [np.asarray(np.kron(at, S)) for at, S in zip(where, matrices, strict=True)]
    difference = np.concatenate([value - values[0] for value in values[1:]])
    degrees = [min(degrees_of(one.of(name)) for name in names) for one in results]
    return joint_test(difference, parts, degrees)


def _unit(n: int, k: int) -> FloatArray:
    found = np.zeros((n, n))
    found[k, k] = 1.0
    return found


def _notes(results: Sequence[Estimates], pairs: Sequence[Pair]) -> Iterator[str]:
    """What a reader must know of the comparison."""
    for one in results:
        if one.covariance is None:
            yield (
                f"{one.label} holds no joint covariance, as files of earlier versions: its "
                "parameters are compared by their standard deviations alone"
            )
        if one.status not in ("", "determined"):
            yield f"{one.label} is {one.status}"
    for pair in pairs:
        unlike = [one for one in pair.parameters if one.first.stage != one.second.stage]
        if unlike:
            listed = ", ".join(
                f"{one.first.label} ({one.first.stage}, {one.second.stage})" for one in unlike
            )
            yield f"{pair.second}: of different stages, whose systematic errors differ: {listed}"
        if pair.joint is None and _with_covariance(results, pair):
            yield (
                f"{pair.second}: too few degrees of freedom behind the covariances to test all "
                "parameters at once"
            )
    first, *others = results
    for other in others:
        if first.study[1] and first.study == other.study:
            yield (
                f"{first.label} and {other.label} are of one study file: with the same logs their "
                "errors are not independent"
            )


def _with_covariance(results: Sequence[Estimates], pair: Pair) -> bool:
    """Whether both results of a pair hold a joint covariance."""
    by_label = {one.label: one.covariance for one in results}
    return by_label[pair.first] is not None and by_label[pair.second] is not None


def _value(p: Parameter) -> float:
    if p.value is None:
        raise ValueError(p.label)
    return p.value


def _std(p: Parameter) -> float:
    if p.std is None:
        raise ValueError(p.label)
    return p.std
