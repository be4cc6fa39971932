"""Comparison of results: false-alarm rate, detection and input errors."""

from __future__ import annotations

import secrets
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import strainwave as sw
from compared_results import NAMES, covariance, drawn, estimates, write
from strainwave.domain import Parameter
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.fleet.monitoring.comparison import (
    AGREES,
    DIFFERS,
    ResultComparison,
    ResultEstimates,
    compare,
    degrees_of_freedom,
    estimates_of,
    read_estimates,
)
from virtual_arms import MOTION, motion_log, rigid_two_link, values_of

FAILURE_P = 1e-4  # probability that a test with a fresh seed fails by chance


def pair(rng: np.random.Generator, *, factor: float = 1.0, others: int = 1) -> ResultComparison:
    results = [estimates(drawn(rng, covariance(rng)), "first")]
    for k in range(others):
        changed = {"gear_stiffness 1": factor}
        results.append(estimates(drawn(rng, covariance(rng), changed), f"other {k}"))
    return compare(results)


@pytest.mark.parametrize("others", [1, 3])
def test_the_false_alarm_rate_is_the_level(others: int) -> None:
    seed = secrets.randbits(32)
    rng = np.random.default_rng(seed)
    runs = 600
    comparisons = [pair(rng, others=others) for _ in range(runs)]
    alarms = sum(one.differs for one in comparisons)
    assert alarms <= stats.binom.ppf(1.0 - FAILURE_P, runs, 0.05), seed
    assert alarms > 0, seed  # the expected rate is at least 2 %
    tests = [one.homogeneity if others > 1 else one.pairs[0].joint for one in comparisons]
    p_values = [test.p for test in tests if test is not None]
    assert len(p_values) == runs
    assert stats.kstest(p_values, "uniform").pvalue > FAILURE_P, seed
    single_p_values = [one.p for each in comparisons for one in each.pairs[0].parameters[:1]]
    assert stats.kstest(single_p_values, "uniform").pvalue > FAILURE_P, seed


def test_a_loss_of_two_percent_of_stiffness_is_detected() -> None:
    """The loss is ten standard deviations of a value, and seven of the difference."""
    comparison = pair(np.random.default_rng(5), factor=0.98)
    assert comparison.differs
    verdicts = {one.first.label: comparison.verdict(one) for one in comparison.pairs[0].parameters}
    assert verdicts == {name: DIFFERS if name == "gear_stiffness 1" else AGREES for name in NAMES}
    one = comparison.pairs[0].parameters[1]
    assert one.percent == pytest.approx(-2.0, abs=0.8)
    assert one.z == pytest.approx(one.change / one.std)


def test_changes_are_detected_by_their_sum() -> None:
    """Errors with correlation -0.999 and equal changes: only the joint test is significant."""
    S = np.diag([1.0, 1.0, 1.0, 1.0, 1.0])
    S[0, 1] = S[1, 0] = -0.999
    first, second = (drawn(np.random.default_rng(0), S) for _ in range(2))
    for one, two in zip(first["parameters"], second["parameters"], strict=True):
        one["value"], two["value"] = 10.0, 10.5
    comparison = compare([estimates(first, "a"), estimates(second, "b")])
    assert all(comparison.verdict(one) == AGREES for one in comparison.pairs[0].parameters)
    assert comparison.pairs[0].joint is not None
    assert comparison.verdict(comparison.pairs[0].joint) == DIFFERS
    assert comparison.differs


def test_the_joint_test_counts_independent_values() -> None:
    comparison = pair(np.random.default_rng(2), others=2)
    assert comparison.pairs[0].joint is not None
    assert comparison.homogeneity is not None
    assert (comparison.pairs[0].joint.rank, comparison.pairs[0].joint.n_values) == (4, 5)
    assert (comparison.homogeneity.rank, comparison.homogeneity.n_values) == (8, 10)


@given(st.permutations(range(3)), st.integers(0, 1000))
def test_homogeneity_does_not_depend_on_the_order(order: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    results = [estimates(drawn(rng, covariance(rng)), f"{k}") for k in range(3)]
    tests = [compare(each).homogeneity for each in (results, [results[k] for k in order])]
    assert tests[0] is not None
    assert tests[1] is not None
    assert tests[0].statistic == pytest.approx(tests[1].statistic, rel=1e-5)


def test_results_without_covariance_are_compared_by_their_stds() -> None:
    rng = np.random.default_rng(1)
    S = covariance(rng)
    old = {key: value for key, value in drawn(rng, S).items() if key != "covariance"}
    changed = drawn(rng, S, {"gear_stiffness 1": 0.98})
    comparison = compare([estimates(old, "old"), estimates(changed, "new")])
    assert comparison.pairs[0].joint is None
    assert comparison.differs
    assert any("old" in note and "standard deviations alone" in note for note in comparison.notes)


def test_parameters_of_one_result_only_are_left_out_with_the_reason() -> None:
    rng = np.random.default_rng(1)
    first, second = (drawn(rng, covariance(rng)) for _ in range(2))
    second["parameters"][0]["value"] = None
    second["parameters"][1]["std"] = None
    second["parameters"][2]["unit"] = "kg"
    del second["parameters"][3]
    (pair,) = compare([estimates(first, "a"), estimates(second, "b")]).pairs
    assert [one.first.label for one in pair.parameters] == ["sum 1"]
    assert dict(pair.left_out) == {
        "beta": "not identified in b",
        "gear_stiffness 1": "without standard deviation in b",
        "motor_inertia 1": "in kg m^2 and in kg",
        "motor_viscous_friction 1": "not identified in b",
    }


def test_parameters_of_one_record_are_not_compared() -> None:
    document = drawn(np.random.default_rng(0), np.eye(5))
    document["parameters"][0]["name"] = "accelerometer_drift"
    document["parameters"][1]["name"] = "friction_change[motion]"
    assert [p.label for p in estimates(document, "a").parameters] == list(NAMES[2:])


def test_a_value_near_zero_has_no_change_in_percent() -> None:
    S = np.diag([1.0, 1.0, 1.0, 1.0, 1.0])
    document = drawn(np.random.default_rng(0), S)
    document["parameters"][0]["value"] = 1.5
    (pair,) = compare([estimates(document, "a"), estimates(document, "b")]).pairs
    assert pair.parameters[0].percent is None
    assert pair.parameters[1].percent == 0.0


def test_refusals() -> None:
    result = estimates(drawn(np.random.default_rng(0), np.eye(5)), "a")
    with pytest.raises(InvalidInput, match="level"):
        compare([result, result], level=0.0)
    with pytest.raises(InvalidInput, match="two results"):
        compare([result])
    with pytest.raises(NotIdentifiable, match="no comparison is possible"):
        compare([result, replace(result, parameters=())])


def test_notes_on_undetermined_results_and_equal_logs() -> None:
    result = estimates(drawn(np.random.default_rng(0), np.eye(5)), "a")
    first = replace(result, study=("study.toml", "12ab"), status="partly-determined")
    notes = compare([first, replace(first, label="b")]).notes
    assert "a is partly-determined" in notes
    assert any("not independent" in note for note in notes)


def test_values_of_different_stages_are_noted() -> None:
    first, second = (drawn(np.random.default_rng(0), np.eye(5)) for _ in range(2))
    second["parameters"][0]["stage"] = "rigid"
    notes = compare([estimates(first, "a"), estimates(second, "b")]).notes
    assert len(notes) == 1
    assert "different systematic errors" in notes[0]
    assert "beta (tuned, rigid)" in notes[0]


def test_labels_distinguish_files(tmp_path: Path) -> None:
    document = drawn(np.random.default_rng(0), np.eye(5))
    folders = [write(document, tmp_path / year / "arm") for year in ("2025", "2026")]
    results = read_estimates([folders[0], folders[1] / "result.json"])
    assert [one.label for one in results] == [str(folder / "result.json") for folder in folders]
    assert results[0].covariance is not None
    other = write(document, tmp_path / "other")
    assert [one.label for one in read_estimates([folders[0], other])] == ["arm", "other"]


def test_invalid_files_are_named(tmp_path: Path) -> None:
    document = drawn(np.random.default_rng(0), np.eye(5))
    valid = write(document, tmp_path / "fine")
    broken = write(document | {"covariance": {"names": []}}, tmp_path / "broken")
    with pytest.raises(InvalidInput, match="broken"):
        read_estimates([valid, broken])
    with pytest.raises(InvalidInput, match="missing"):
        read_estimates([valid, tmp_path / "missing"])


@pytest.mark.parametrize("nu", [1.0, 2.0, 7.0, 19.0, 60.0])
def test_degrees_follow_from_the_interval(nu: float) -> None:
    half_width = 2.5 * float(stats.t.ppf(0.975, nu))
    p = Parameter("beta", None, 1.0, 2.5, "kg m^2", "rigid", (1.0 - half_width, 1.0 + half_width))
    assert degrees_of_freedom(p) == pytest.approx(nu, rel=1e-3)
    assert degrees_of_freedom(replace(p, ci95=(1.0 - 4.9, 1.0 + 4.9))) == float("inf")


def repeat(seed: int, rng: np.random.Generator, friction: float = 1.0) -> ResultEstimates:
    """Rigid step on a new motion record of the built-in arm with rigid gears."""
    study = rigid_two_link()
    values = values_of(study, 5)
    values["motor_coulomb_friction", 1] *= friction
    log = motion_log(study, values, seed)
    table = {"t": log.time, **log.channels}
    for name in ("u1", "u2"):
        table[name] = table[name] + rng.normal(scale=0.02, size=len(log.time))
    motion_study = replace(study, experiments=(MOTION,))
    result = sw.identify(motion_study, data={"motion": table}, stages=("rigid",), threads=1)
    return estimates_of(result.document, Path(f"{seed}/result.json"))


def test_visits_to_an_unchanged_arm_agree() -> None:
    """12 pairs of visits at a level of 5 %: half an alarm is expected."""
    pairs = 12
    seed = secrets.randbits(20)
    print(f"seed {seed}")  # of a visit without values, which ends the comparison
    rng = np.random.default_rng(seed)
    comparisons = [
        compare([repeat(seed + k, rng), repeat(seed + 100 + k, rng)]) for k in range(pairs)
    ]
    alarms = sum(one.differs for one in comparisons)
    assert alarms <= stats.binom.ppf(1.0 - FAILURE_P, pairs, 0.05), seed
    z_scores = [one.z for each in comparisons for one in each.pairs[0].parameters]
    assert 0.6 < float(np.std(z_scores)) < 1.5, seed  # standard deviations are realistic


def test_ten_percent_more_friction_is_detected() -> None:
    rng = np.random.default_rng(4)
    comparison = compare([repeat(1, rng), repeat(2, rng, friction=1.1)])
    differing = [
        one.first.label
        for one in comparison.pairs[0].parameters
        if comparison.verdict(one) == DIFFERS
    ]
    assert differing == ["motor_coulomb_friction 1"]
