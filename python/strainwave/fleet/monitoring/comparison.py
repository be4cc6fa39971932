"""Two or more results of one arm: which parameters differ significantly.

A factor that all parameters with a force in their unit share.

The scale of the torques is not in the data: inertias, friction, gravity and stiffness that change
by one factor point to `torque_per_volt`, or to the scale of the torque channels.

Tests of several differences at once, and adjusted p-values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from strainwave.domain import FloatArray, Parameter
from strainwave.domain.messages import plus_minus
from strainwave.domain.results.distributions import CI95_STDS, chi_square_tail, f_tail, student_tail
from strainwave.errors import InvalidInput, NotIdentifiable, import_optional
from strainwave.fleet.monitoring.result_estimates import ResultEstimates, degrees_of_freedom

if TYPE_CHECKING:
    from pandas import DataFrame


_RANK_TOLERANCE = 1e-8  # of the largest eigenvalue of the correlation matrix; below: dependent


@dataclass(frozen=True, slots=True)
class JointTest:
    """Test statistic d' S^+ d of differences d with covariance S."""

    statistic: float
    rank: int  # of S: number of independent differences
    n_values: int
    degrees: float  # degrees of freedom of S; infinite: the statistic is chi-square distributed
    p: float
    adjusted_p: float = 1.0  # by Holm, over all tests of the comparison


def joint_test(
    difference: FloatArray, parts: Sequence[FloatArray], degrees: Sequence[float]
) -> JointTest | None:
    """Test that all differences, (n,), are zero.

    T = d' S^+ d with S the sum of the parts, (n, n) covariances of independent errors; the rank r
    of S is that of its correlation matrix. If all parts are known exactly, T is a chi-square of r
    degrees. If part i is known with nu_i degrees of freedom, T (nu - r + 1)/(nu r) is an F of r and
    nu - r + 1 degrees with nu = (r + r^2) / sum_i (tr G_i^2 + (tr G_i)^2)/nu_i, G_i the part in
    coordinates where S is the identity (Krishnamoorthy and Yu, 2004). None if nu <= r.
    """
    S = np.sum(parts, axis=0)
    scale = np.sqrt(np.diag(S))
    if not len(difference) or not (scale > 0.0).all():
        return None
    values, vectors = np.linalg.eigh(S / np.outer(scale, scale))
    independent = values > _RANK_TOLERANCE * values[-1]
    whiten = vectors[:, independent] / np.sqrt(values[independent]) / scale[:, None]
    r = int(independent.sum())
    statistic = float(np.sum((whiten.T @ difference) ** 2))
    spread = 0.0
    for part, nu_i in zip(parts, degrees, strict=True):
        G = whiten.T @ part @ whiten
        spread += float(np.sum(G * G) + np.trace(G) ** 2) / nu_i
    nu = (r + r * r) / spread if spread > 0.0 else float("inf")
    if not np.isfinite(nu):
        return JointTest(statistic, r, len(difference), nu, chi_square_tail(statistic, r))
    if nu <= r:
        return None
    p = f_tail(statistic * (nu - r + 1.0) / (nu * r), r, nu - r + 1.0)
    return JointTest(statistic, r, len(difference), nu, p)


def welch_test(
    difference: float, stds: Sequence[float], degrees: Sequence[float]
) -> tuple[float, float]:
    """z, the difference over its standard deviation, and the two-sided p-value of no difference.

    `stds` are those of its independent errors. Student's t with the degrees of freedom of Welch and
    Satterthwaite; a normal distribution if all degrees are infinite.
    """
    variances = [s * s for s in stds]
    total = sum(variances)
    z = float(difference / np.sqrt(total))
    spread = sum(v * v / nu for v, nu in zip(variances, degrees, strict=True))
    return z, student_tail(z, total * total / spread if spread > 0.0 else math.inf)


def adjust_p_values(p: Sequence[float]) -> list[float]:
    """p-values adjusted for their number, valid under any dependence (Holm, 1979).

    The smallest of m is multiplied by m, the next by m - 1, and so on; the result does not decrease
    in the order of p.
    """
    order = np.argsort(p, kind="stable")
    factors = np.arange(len(p), 0, -1)
    scaled = np.minimum(1.0, np.maximum.accumulate(factors * np.asarray(p, dtype=float)[order]))
    adjusted = np.empty(len(p))
    adjusted[order] = scaled
    return [float(value) for value in adjusted]


_MIN_PARAMETERS = 3  # that share a factor; two may do so by chance
_MAX_RELATIVE_STD = 0.3  # of a value whose logarithm has nearly Gaussian errors
_MIN_MISFIT_P = 0.01  # of a common factor, by a chi-square test


@dataclass(frozen=True, slots=True)
class CommonFactor:
    """Factor of all torque-like parameters, and its standard deviation."""

    value: float
    std: float

    @property
    def sentence(self) -> str:
        """What it means, as a clause."""
        factor = " +- ".join(plus_minus(self.value, self.std))
        return (
            f"all torque-like parameters differ by one factor, {factor}: compare torque_per_volt or"
            " the scales of the torque channels, with which inertias, friction and stiffness scale"
        )


def is_torque_like(unit: str) -> bool:
    """Whether a parameter scales with the torques: its unit contains N or kg."""
    return not {"N", "kg"}.isdisjoint(unit.replace("/", " ").split())


def common_factor(
    pairs: Iterable[tuple[float, float, float, float]], level: float
) -> CommonFactor | None:
    """The common factor of torque-like values (first, its std, second, its std); None without one.

    A factor other than one must be significant at the level, and explain all changes.
    """
    first, first_std, second, second_std = np.array(list(pairs)).reshape(-1, 4).T
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = second / first
        spread = np.hypot(first_std / first, second_std / second)
    usable = (ratio > 0.0) & (spread > 0.0) & (spread < _MAX_RELATIVE_STD)
    if usable.sum() < _MIN_PARAMETERS:
        return None
    change, weight = np.log(ratio[usable]), spread[usable] ** -2.0
    mean, std = float(weight @ change / weight.sum()), float(weight.sum() ** -0.5)
    misfit = float(weight @ (change - mean) ** 2)
    is_common = chi_square_tail(misfit, len(change) - 1) > _MIN_MISFIT_P
    if not is_common or student_tail(mean / std, np.inf) >= level:
        return None
    return CommonFactor(float(np.exp(mean)), float(np.exp(mean)) * std)


AGREES, DIFFERS = "agrees", "differs"


@dataclass(frozen=True, slots=True)
class ParameterDifference:
    """One parameter in two results."""

    first: Parameter
    second: Parameter
    z: float  # change divided by its standard deviation
    p: float  # two-sided p-value of no change
    adjusted_p: float = 1.0  # by Holm, over all tests of the comparison

    @property
    def change(self) -> float:
        """Second minus first."""
        return _estimate(self.second)[0] - _estimate(self.first)[0]

    @property
    def std(self) -> float:
        """Standard deviation of the change; the errors of the results are independent."""
        return float(np.hypot(_estimate(self.first)[1], _estimate(self.second)[1]))

    @property
    def percent(self) -> float | None:
        """The change in percent of the first value; None as `of_first`."""
        return self.of_first(self.change)

    def of_first(self, size: float) -> float | None:
        """A size in percent of the first value; None if zero is in its 95 % interval."""
        value, std = _estimate(self.first)
        return 100.0 * size / abs(value) if abs(value) > CI95_STDS * std else None


_Test = TypeVar("_Test", ParameterDifference, JointTest)


@dataclass(frozen=True, slots=True)
class Pair:
    """The first result and one of the others."""

    first: str  # label
    second: str
    parameters: tuple[ParameterDifference, ...]
    joint: JointTest | None  # of all parameters that are in both covariances
    left_out: tuple[tuple[str, str], ...]  # parameter, reason why it is not compared
    factor: CommonFactor | None = None  # of all torque-like parameters


@dataclass(frozen=True, slots=True, repr=False)
class ResultComparison:
    """Two or more results: the first with each of the others, and all together."""

    level: float  # probability of a false alarm between results of an unchanged arm
    results: tuple[ResultEstimates, ...]
    pairs: tuple[Pair, ...]
    homogeneity: JointTest | None  # over all results, if there are more than two
    notes: tuple[str, ...]

    def verdict(self, test: ParameterDifference | JointTest) -> str:
        """`DIFFERS` or `AGREES` for one test."""
        return DIFFERS if test.adjusted_p < self.level else AGREES

    @property
    def tests(self) -> tuple[ParameterDifference | JointTest, ...]:
        """All tests that share the probability of a false alarm."""
        joint = (*(pair.joint for pair in self.pairs), self.homogeneity)
        differences = [d for pair in self.pairs for d in pair.parameters]
        return (*differences, *(test for test in joint if test is not None))

    @property
    def differs(self) -> bool:
        """Whether any test is significant."""
        return any(test.adjusted_p < self.level for test in self.tests)

    @property
    def headline(self) -> str:
        """Verdict in one sentence."""
        level = f"{100.0 * self.level:g} %"
        if not self.differs:
            return f"no difference at the level of {level}"
        labels = dict.fromkeys(
            difference.first.label
            for pair in self.pairs
            for difference in pair.parameters
            if self.verdict(difference) == DIFFERS
        )
        listed = ", ".join(labels) or "no single parameter, but all parameters together"
        return f"the results differ at the level of {level}: {listed}"

    def to_frame(self) -> DataFrame:
        """The comparison as a pandas frame, one row per parameter and pair."""
        pandas = import_optional("pandas", "a data frame", "pandas")
        rows = [
            {
                "first": pair.first,
                "second": pair.second,
                "name": difference.first.name,
                "joint": difference.first.joint,
                "first_value": difference.first.value,
                "second_value": difference.second.value,
                "change_percent": difference.percent,
                "z": difference.z,
                "adjusted_p": difference.adjusted_p,
                "verdict": self.verdict(difference),
            }
            for pair in self.pairs
            for difference in pair.parameters
        ]
        frame: DataFrame = pandas.DataFrame(rows).astype({"joint": "Int64"})
        return frame

    def __repr__(self) -> str:
        return f"<ResultComparison: {self.headline}>"

    def __str__(self) -> str:
        """As `strainwave compare` prints it."""
        from io import StringIO

        from rich.console import Console

        from strainwave.fleet.monitoring.comparison_output import print_comparison

        text = StringIO()
        print_comparison(self, console=Console(file=text, width=120, highlight=False))
        return text.getvalue()


def compare(results: Sequence[ResultEstimates], level: float = 0.05) -> ResultComparison:
    """Compare results of one arm from independent data: the first with each of the others.

    Each change is tested against sqrt(s_a^2 + s_b^2), all changes together by d' S^+ d with
    S = S_a + S_b. All tests are one family, whose p-values are adjusted by Holm: if nothing
    changed, a difference is reported with a probability of at most `level`. Raises `InvalidInput`
    if the level is not between 0 and 1 or there are fewer than two results, and `NotIdentifiable`
    if no parameter has a value and a standard deviation in two of them.
    """
    if not 0.0 < level < 1.0:
        raise InvalidInput(
            f"the level {level:g} is not a probability", remedy="give for example 0.05"
        )
    if len(results) < 2:
        raise InvalidInput(
            "a comparison needs two results", remedy="give at least two result.json files"
        )
    first, *others = results
    pairs = [_compare_pair(first, other, level) for other in others]
    if not any(pair.parameters for pair in pairs):
        raise NotIdentifiable(
            "no comparison is possible: no parameter has a value and a standard deviation in "
            "both results"
        )
    homogeneity = None
    if len(others) > 1:
        known = [{p.label for p in r.parameters if p.value is not None and p.std} for r in results]
        homogeneity = _joint_test(results, set.intersection(*known))
    notes = tuple(_notes(results, pairs))
    return _adjust_tests(ResultComparison(level, tuple(results), tuple(pairs), homogeneity, notes))


def _adjust_tests(comparison: ResultComparison) -> ResultComparison:
    p_values = adjust_p_values([test.p for test in comparison.tests])
    adjusted = dict(zip(map(id, comparison.tests), p_values, strict=True))

    def adjust(test: _Test) -> _Test:
        return replace(test, adjusted_p=adjusted[id(test)])

    pairs = tuple(
        replace(
            pair,
            parameters=tuple(map(adjust, pair.parameters)),
            joint=pair.joint and adjust(pair.joint),
        )
        for pair in comparison.pairs
    )
    homogeneity = comparison.homogeneity and adjust(comparison.homogeneity)
    return replace(comparison, pairs=pairs, homogeneity=homogeneity)


def _compare_pair(first: ResultEstimates, second: ResultEstimates, level: float) -> Pair:
    first_by_label = {p.label: p for p in first.parameters}
    second_by_label = {p.label: p for p in second.parameters}
    omitted, differences = [], []
    for label in dict.fromkeys([*first_by_label, *second_by_label]):
        a, b = first_by_label.get(label), second_by_label.get(label)
        reason = _reason_to_omit(a, b, first.label, second.label)
        if reason or a is None or b is None:
            omitted.append((label, reason))
            continue
        (value_a, std_a), (value_b, std_b) = _estimate(a), _estimate(b)
        degrees = degrees_of_freedom(a), degrees_of_freedom(b)
        z, p = welch_test(value_b - value_a, (std_a, std_b), degrees)
        differences.append(ParameterDifference(a, b, z, p))
    joint = _joint_test((first, second), {d.first.label for d in differences})
    torque_like = [d for d in differences if is_torque_like(d.first.unit)]
    pairs = ((*_estimate(d.first), *_estimate(d.second)) for d in torque_like)
    factor = common_factor(pairs, level)
    return Pair(first.label, second.label, tuple(differences), joint, tuple(omitted), factor)


def _reason_to_omit(a: Parameter | None, b: Parameter | None, first: str, second: str) -> str:
    for parameter, result in ((a, first), (b, second)):
        if parameter is None or parameter.value is None:
            return f"not identified in {result}"
        if parameter.std is None or not parameter.std > 0.0:
            return f"without standard deviation in {result}"
    if a is not None and b is not None and a.unit != b.unit:
        return f"in {a.unit} and in {b.unit}"
    return ""


def _joint_test(results: Sequence[ResultEstimates], compared: set[str]) -> JointTest | None:
    """Test the differences from the first result over the parameters in every covariance.

    With d = (x_2 - x_1, x_3 - x_1, ...), every block contains the covariance of the first result.
    """
    covariances = [r.covariance for r in results if r.covariance is not None]
    if len(covariances) < len(results):
        return None
    shared = set.intersection(compared, *(set(c.names) for c in covariances))
    names = [name for name in covariances[0].names if name in shared]
    if not names:
        return None
    values = [np.array([_estimate(r.of(name))[0] for name in names]) for r in results]
    matrices = []
    for covariance in covariances:
        index = [covariance.names.index(name) for name in names]
        matrices.append(covariance.matrix[np.ix_(index, index)])
    others = len(results) - 1
    blocks = [np.ones((others, others)), *map(np.diag, np.eye(others))]
    parts = [np.asarray(np.kron(block, S)) for block, S in zip(blocks, matrices, strict=True)]
    difference = np.concatenate([value - values[0] for value in values[1:]])
    degrees = [min(degrees_of_freedom(r.of(name)) for name in names) for r in results]
    return joint_test(difference, parts, degrees)


def _notes(results: Sequence[ResultEstimates], pairs: Sequence[Pair]) -> Iterator[str]:
    for result in results:
        if result.covariance is None:
            yield (
                f"{result.label} has no joint covariance, as results of earlier versions; its "
                "parameters are compared by their standard deviations alone"
            )
        if result.status not in ("", "determined"):
            yield f"{result.label} is {result.status}"
    covariances = {result.label: result.covariance for result in results}
    for pair in pairs:
        unequal = [d for d in pair.parameters if d.first.stage != d.second.stage]
        if unequal:
            stages = (f"{d.first.label} ({d.first.stage}, {d.second.stage})" for d in unequal)
            listed = ", ".join(stages)
            yield f"{pair.second}: estimated by stages with different systematic errors: {listed}"
        if pair.factor is not None:
            yield f"{pair.second}: {pair.factor.sentence}"
        if pair.joint is None and None not in (covariances[pair.first], covariances[pair.second]):
            yield (
                f"{pair.second}: the covariances have too few degrees of freedom to test all "
                "parameters together"
            )
    first, *others = results
    for other in others:
        if first.study[1] and first.study == other.study:
            yield (
                f"{first.label} and {other.label} have the same study file; if they have the same "
                "logs, their errors are not independent"
            )


def _estimate(p: Parameter) -> tuple[float, float]:
    """Value and standard deviation of a parameter that has both."""
    if p.value is None or p.std is None:
        raise ValueError(p.label)
    return p.value, p.std
