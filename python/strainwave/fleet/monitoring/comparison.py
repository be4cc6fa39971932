"""Two or more results of one arm: which parameters differ significantly."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from strainwave.domain import Parameter
from strainwave.domain.arm.link_sensors import ConstantKind, is_kind
from strainwave.domain.arm.parameter_table import record_of
from strainwave.domain.messages import plus_minus
from strainwave.domain.results.distributions import (
    CI95_STDS,
    student_degrees,
)
from strainwave.errors import InvalidInput, NotIdentifiable, import_optional
from strainwave.fleet.monitoring.significance import (
    CommonFactor,
    JointTest,
    adjust_p_values,
    common_factor,
    format_p,
    is_torque_like,
    joint_test,
    welch_test,
)
from strainwave.io.joint_covariance import JointCovariance
from strainwave.io.results import covariance_of, parameters_of, read_document, result_path

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import Console

_USUAL_NAMES = ("result.json", "study.toml")  # files whose folder is a better label
_QUANTILE_TOLERANCE = 1e-3  # beyond it an interval is Student's; nu is then below about 2,400


@dataclass(frozen=True, slots=True, eq=False)
class ResultEstimates:
    """Parameters and joint covariance of one result."""

    label: str
    path: str
    created: str
    status: str
    study: tuple[str, str]  # path and SHA-256
    parameters: tuple[Parameter, ...]
    covariance: JointCovariance | None

    def of(self, label: str) -> Parameter:
        """A parameter by name and joint, as in the verdict."""
        return next(p for p in self.parameters if p.label == label)


def read_estimates(paths: Sequence[Path]) -> tuple[ResultEstimates, ...]:
    """Read results from result.json files or directories that contain one.

    Labels are unique. Raises `InvalidInput` for fewer than two paths, or a file that is missing or
    is not a result.
    """
    if len(paths) < 2:
        raise InvalidInput(
            "a comparison needs two results", remedy="give at least two result.json files"
        )
    files = map(result_path, paths)
    estimates = [estimates_of(read_document(path), path) for path in files]
    labels = [one.label for one in estimates]
    return tuple(
        one if labels.count(one.label) == 1 else replace(one, label=one.path) for one in estimates
    )


def estimates_of(document: Mapping[str, Any], path: Path) -> ResultEstimates:
    """Estimates of a result document that was read from `path`.

    Parameters of one record, such as the drift of a sensor bias, are omitted.
    """
    study = document.get("study") or {}
    return ResultEstimates(
        label=path.parent.name if path.name in _USUAL_NAMES and path.parent.name else path.name,
        path=str(path),
        created=str(document.get("created", "")),
        status=str(document.get("status", "")),
        study=(str(study.get("path", "")), str(study.get("sha256", ""))),
        parameters=tuple(
            p for p in parameters_of(document, str(path)) if not is_record_parameter(p.name)
        ),
        covariance=covariance_of(document, str(path)),
    )


def is_record_parameter(name: str) -> bool:
    """Whether a parameter describes one record instead of the arm."""
    return bool(record_of(name)) or is_kind((name, None), ConstantKind.DRIFT)


def degrees_of_freedom(parameter: Parameter) -> float:
    """Degrees of freedom of a standard deviation, from the width of its 95 % interval.

    The rigid stage estimates variances from few segments of motion and gives Student's intervals.
    Infinite if the interval is that of a normal distribution, or missing.
    """
    if parameter.ci95 is None or not parameter.std:
        return float("inf")
    quantile = 0.5 * (parameter.ci95[1] - parameter.ci95[0]) / parameter.std
    if quantile <= CI95_STDS + _QUANTILE_TOLERANCE:
        return float("inf")
    return max(1.0, student_degrees(quantile))


AGREES, DIFFERS = "agrees", "differs"
ALL_PARAMETERS = "all parameters together"

_MAX_HEADER = 14  # characters of a label in the terminal, as wide as the values below it


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

    @property
    def cells(self) -> tuple[str, ...]:
        """Change [%], z and adjusted p-value as text."""
        percent = self.percent
        digits = 3 if percent is not None and abs(percent) < 1.0 else 2
        change = "" if percent is None else f"{percent:+.{digits}f}"
        return change, f"{self.z:+.1f}", format_p(self.adjusted_p)


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

    def describe(self, test: JointTest) -> str:
        """Statistic, its distribution, and verdict of a test of several parameters."""
        law = f"chi-square with {test.rank} degrees of freedom"
        if math.isfinite(test.degrees):
            law = f"rank {test.rank}, covariance with {test.degrees:.3g} degrees of freedom"
        return (
            f"{test.statistic:.1f} ({law}; {test.n_values} values), "
            f"adjusted p {format_p(test.adjusted_p)}: {self.verdict(test)}"
        )

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
        from rich.console import Console

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


def print_comparison(
    comparison: ResultComparison, folder: Path | None = None, *, console: Console | None = None
) -> None:
    """Print a table per pair, the joint tests, the verdict, and the files in `folder` if any."""
    from rich.console import Console
    from rich.text import Text

    from strainwave.fleet.monitoring import output
    from strainwave.report.document.blocks import Cell, Row, number, table

    console = console or Console(highlight=False)
    for pair in comparison.pairs:
        console.print(Text(f"{pair.second} against {pair.first}", style="bold"))
        labels = (pair.first, pair.second)
        is_short = all(len(label) <= _MAX_HEADER for label in labels)
        heads = (*(labels if is_short else ("first", "second")), "change %", "z", "adj. p")
        rows: list[Row] = []
        for difference in pair.parameters:
            verdict = comparison.verdict(difference)
            values = (plus_minus(p.value, p.std)[0] for p in (difference.first, difference.second))
            mark = Cell(verdict, mark="bad" if verdict == DIFFERS else "")
            rows.append((difference.first.label, *values, *difference.cells, mark))
        output.print_tables(
            console, table("Parameters", ("parameter", *map(number, heads), "verdict"), rows)
        )
        if pair.joint is not None:
            console.print(Text(f"{ALL_PARAMETERS}: {comparison.describe(pair.joint)}"))
        if pair.left_out:
            listed = "; ".join(f"{name} {reason}" for name, reason in pair.left_out)
            console.print(Text(f"not compared: {listed}"))
    if comparison.homogeneity is not None:
        sentence = comparison.describe(comparison.homogeneity)
        console.print(Text(f"all {len(comparison.results)} results, {ALL_PARAMETERS}: {sentence}"))
    output.print_end(
        console, "comparison", comparison.headline, comparison.notes, folder, bad=comparison.differs
    )
