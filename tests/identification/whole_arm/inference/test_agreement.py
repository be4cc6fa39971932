"""Agreement of rigid step and whole-arm fit: distribution of the statistic, and faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import (
    AgreementTest,
    FloatArray,
    Identification,
    Log,
    Prbs,
    StageDifference,
    Study,
)
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm.inference.covariance import residual_covariance
from strainwave.identification.whole_arm.inference.fit_tests import (
    _as_normal,
    _chi_square,
    disagreement,
    expected_model_error,
)
from strainwave.io.logs import write_log
from strainwave.io.study import write_study
from strainwave.pipeline import identify
from strainwave.virtual import scara
from tuning_runs import simulated_logs

N_RUNS = 4000


def problem(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened prior rows, covariance of their errors, and information of the records."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(4, 6))
    # Relative to unit variance, which includes a minimum standard deviation.
    errors = np.diag(rng.uniform(0.2, 1.0, 4))
    columns = rng.normal(size=(30, 6))
    return rows, errors, columns.T @ columns


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_differences_scatter_as_their_covariance_predicts(seed: int) -> None:
    """Normalised squares of fits to simulated priors and records are chi-square."""
    rows, errors, information = problem(seed)
    rng = np.random.default_rng(100 + seed)
    gain = rows @ np.linalg.inv(information + rows.T @ rows)
    expected = residual_covariance(errors, gain, rows, information)
    prior = rng.multivariate_normal(np.zeros(4), errors, N_RUNS)
    gradient = rng.multivariate_normal(np.zeros(6), information, N_RUNS)
    # the minimum of |rows x - prior|^2 + (x - g)' information (x - g), g = information^-1 gradient
    x = np.linalg.solve(information + rows.T @ rows, (prior @ rows + gradient).T).T
    residual = x @ rows.T - prior
    squares = np.einsum("ki,ij,kj->k", residual, np.linalg.inv(expected), residual)
    # mean and variance of chi-square with four degrees of freedom, within four standard errors
    assert squares.mean() == pytest.approx(4.0, abs=4.0 * np.sqrt(8.0 / N_RUNS))
    assert squares.var() == pytest.approx(8.0, abs=4.0 * np.sqrt(640.0 / N_RUNS))


def test_of_an_efficient_fit_it_is_the_rigid_variance_less_that_of_the_combination() -> None:
    rows, _, information = problem(3)
    combined = rows @ np.linalg.inv(information + rows.T @ rows) @ rows.T
    gain = rows @ np.linalg.inv(information + rows.T @ rows)
    covariance = residual_covariance(np.eye(4), gain, rows, information)
    np.testing.assert_allclose(covariance, np.eye(4) - combined, atol=1e-12)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_clean_arms_statistic_is_chi_square(seed: int) -> None:
    """Directions to which the records add no information do not enter the statistic."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4))
    rigid = root @ root.T
    # Shares of the rigid covariance; the last one is zero to rounding.
    shares = np.diag([1.0, 0.3, 0.01, 1e-8])
    covariance, none = root @ shares @ root.T, np.zeros((4, 4))
    draws = rng.multivariate_normal(np.zeros(4), covariance, N_RUNS)
    statistics = [_chi_square(draw, covariance, rigid, none) for draw in draws]
    assert {degrees for _, degrees in statistics} == {3}
    squares = np.array([q for q, _ in statistics])
    assert squares.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / N_RUNS))
    normal_scores = np.array([_as_normal(q, 3) for q in squares])
    assert np.mean(normal_scores > 1.96) == pytest.approx(0.05, abs=4.0 * np.sqrt(0.05 / N_RUNS))
    assert _as_normal(1e5, 3) > 30.0


def test_stages_disagree_by_the_probability_of_the_joint_test() -> None:
    small_difference = StageDifference("beta", None, 0.6, 0.601, 0.01, "kg m^2")
    large_difference = StageDifference("motor_inertia", 2, 5e-5, 5.8e-5, 1e-6, "kg m^2")
    quiet = AgreementTest("all", None, 29.0, 10, 3.2)  # probability 0.0012
    high_variance = AgreementTest("inertias", None, 70.0, 4, 7.4)
    assert list(disagreement((small_difference, large_difference), ())) == []
    assert list(disagreement((small_difference, large_difference), (quiet,))) == []
    (warning,) = disagreement((small_difference, large_difference), (quiet, high_variance))
    assert warning.code == "stages-disagree"
    assert (
        "taken together, inertias and gravity torques differ by 7.4 standard deviations"
        in warning.message
    )
    assert "chi-square 70 of 4 degrees" in warning.message
    largest = "motor_inertia of joint 2 5e-05 by the rigid and 5.8e-05"
    assert warning.message.index(largest) < warning.message.index("beta")
    causes = ("motor constant", "clock", "dead zone", "friction")
    assert sorted(causes, key=warning.message.index) == list(causes)


@cache
def records() -> tuple[Study, tuple[Log, ...]]:
    """Slow motion, and a PRBS on each joint, of the built-in arm with noise."""
    study = scara.STIFF.study(Path(), "linear")
    motion = next(e for e in study.experiments if e.use == "motion")
    fast = [e for e in study.experiments if e.use == "frequency"]
    fast = [replace(e, prbs=Prbs(10, 1e-3, 1, 10.0)) for e in fast]
    short_study = replace(study, experiments=(motion, *fast))
    return simulated_logs(short_study, scara.STIFF.parameters(5, "linear"), noise=SensorNoise())


Change = Callable[[str, FloatArray], FloatArray]


def altered(folder: Path, change: Change, link_length: float | None = None) -> Identification:
    """Result of `identify` for these records after a change of channels and time."""
    study, logs = records()
    if link_length is not None:
        study = replace(study, arm=change_arm_keys(study.arm, link_length=link_length))
    for log in logs:
        columns = {"t": log.time, **log.channels}
        write_log(folder / log.experiment.file, {k: change(k, x) for k, x in columns.items()})
    copy = replace(study, path=folder / "study.toml")
    write_study(copy, copy.path)
    return identify(copy.path)


def weakening(name: str, x: FloatArray) -> FloatArray:
    """Voltage required by a motor whose torque constant decreases by 10 % at 10 V.

    The arm itself receives v = u (1 - 0.01 |u|).
    """
    if not name.startswith("u"):
        return x
    return np.asarray(50.0 * np.sign(x) * (1.0 - np.sqrt(1.0 - 0.04 * np.abs(x))))


def fast_clock(name: str, x: FloatArray) -> FloatArray:
    return 1.01 * x if name == "t" else x


def test_on_a_clean_arm_the_stages_agree(tmp_path: Path) -> None:
    result = altered(tmp_path, lambda _, x: x)
    assert result.whole_arm is not None
    tests = result.whole_arm.agreement
    scopes = [(test.scope, test.joint) for test in tests]
    assert scopes == [("all", None), ("inertias", None), ("friction", 1), ("friction", 2)]
    assert not any(test.disagrees for test in tests), tests
    assert result.verdict.status == "determined"


def test_the_intervals_contain_the_error_of_a_motor_that_weakens(tmp_path: Path) -> None:
    """At full voltage the torque falls by 10 %: the stages disagree, far above the noise."""
    result = altered(tmp_path, weakening)
    assert result.whole_arm is not None
    by_scope = {test.scope: test.deviations for test in result.whole_arm.agreement}
    assert by_scope["inertias"] > 8.0
    assert "stages-disagree" in [w.code for w in result.warnings]
    assert (result.verdict.status, result.verdict.exit_code) == ("partly-determined", 3)
    true = scara.STIFF.parameters(5, "linear")
    for key in (("alpha", None), ("beta", None), ("gamma", None), ("motor_inertia", 1)):
        (p,) = [p for p in result.parameters if p.key == key]
        assert p.ci95 is not None
        assert p.ci95[0] < true[key] < p.ci95[1], key
    assert any(p.model_std for p in result.parameters)  # the excess of the stages' difference


def test_a_link_length_that_is_wrong_is_named_before_any_fit(tmp_path: Path) -> None:
    """With an error of 8 %, the input check names the length, and its remedy states the true one."""
    length = records()[0].arm.joints[1].origin.xyz[0]
    assert length is not None
    result = altered(tmp_path, lambda _, x: x, 1.08 * length)
    assert result.whole_arm is None
    assert result.verdict.status == "inconsistent-input"
    (suspicion,) = result.verdict.suspected
    assert suspicion.code == "wrong-geometry"
    (correction,) = suspicion.corrections
    assert correction.value == pytest.approx(length, rel=0.01)


def test_the_excess_of_a_difference_is_an_error_of_the_model() -> None:
    """All of a clear difference, and nothing of one that the error of a poor estimate explains."""
    difference, sizes = np.array([0.05, 0.5]), np.array([0.06, 0.06])
    covariance = np.diag([0.001, 0.4]) ** 2
    clear, explained = expected_model_error(difference, covariance, sizes, 2)
    assert clear == pytest.approx(0.05, rel=1e-2)
    assert abs(explained) < 0.03
    np.testing.assert_allclose(
        expected_model_error(np.array([0.001, 0.4]), covariance, sizes, 2), 0.0, atol=1e-4
    )


def test_the_excess_of_a_sum_is_an_error_of_both_parts() -> None:
    """Motion in one direction shows only the sum of Coulomb friction and offset."""
    along, across = np.array([[1.0, -1.0]]).T, np.array([[1.0, 1.0]]).T
    covariance = along @ along.T + 1e-6 * across @ across.T
    error = expected_model_error(np.array([0.05, 0.05]), covariance, np.full(2, 0.03), 2)
    np.testing.assert_allclose(error, 0.05, rtol=1e-3)


def test_a_clock_that_is_fast_is_named(tmp_path: Path) -> None:
    """The PRBS is the only clock of the records: its stated clock may be wrong as well."""
    result = altered(tmp_path, fast_clock)
    assert [fault.code for fault in result.suspected] == ["wrong-prbs-clock", "clock-drift"]
    assert result.verdict.status == "inconsistent-input"


def test_a_sure_difference_that_nobody_would_mind_is_no_finding() -> None:
    """A significant difference of 0.3 % is too small to be reported."""
    significant = AgreementTest("friction", 1, 80.0, 3, 8.0, largest=0.003)
    assert not list(disagreement((), [significant]))
    assert list(disagreement((), [replace(significant, largest=0.03)]))
