"""Whether the rigid and the whole-arm fit agree: the statistic's distribution, and faults."""

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
    SuspectConstant,
)
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm.agreement import (
    MAX_NOISE_DEVIATIONS,
    _as_normal,
    _chi_square,
    disagreement,
)
from strainwave.identification.whole_arm.covariance import residual_covariance
from strainwave.io.logs import write_log
from strainwave.io.study import write_study
from strainwave.pipeline import identify
from strainwave.virtual import scara
from tuning_runs import written_logs

N_RUNS = 4000


def problem(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Prior rows whitened, their errors' covariance, and the records' information."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(4, 6))
    errors = np.diag(rng.uniform(0.2, 1.0, 4))  # less than one by a least deviation
    columns = rng.normal(size=(30, 6))
    return rows, errors, columns.T @ columns


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_differences_scatter_as_their_covariance_says(seed: int) -> None:
    """Fits of simulated priors and records: normalised squares are chi-square."""
    rows, errors, information = problem(seed)
    rng = np.random.default_rng(100 + seed)
    answer = rows @ np.linalg.inv(information + rows.T @ rows)
    expected = residual_covariance(errors, answer, rows, information)
    prior = rng.multivariate_normal(np.zeros(4), errors, N_RUNS)
    gradient = rng.multivariate_normal(np.zeros(6), information, N_RUNS)
    # the minimum of |rows x - prior|^2 + (x - g)' information (x - g), g = information^-1 gradient
    x = np.linalg.solve(information + rows.T @ rows, (prior @ rows + gradient).T).T
    left = x @ rows.T - prior
    squares = np.einsum("ki,ij,kj->k", left, np.linalg.inv(expected), left)
    # mean and variance of a chi-square of four degrees, to four standard errors
    assert squares.mean() == pytest.approx(4.0, abs=4.0 * np.sqrt(8.0 / N_RUNS))
    assert squares.var() == pytest.approx(8.0, abs=4.0 * np.sqrt(640.0 / N_RUNS))


def test_of_an_efficient_fit_it_is_the_rigid_variance_less_that_of_the_combination() -> None:
    rows, _, information = problem(3)
    combined = rows @ np.linalg.inv(information + rows.T @ rows) @ rows.T
    answer = rows @ np.linalg.inv(information + rows.T @ rows)
    found = residual_covariance(np.eye(4), answer, rows, information)
    np.testing.assert_allclose(found, np.eye(4) - combined, atol=1e-12)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_clean_arms_statistic_is_chi_square(seed: int) -> None:
    """Of the directions in which records add something; of the others nothing can be said."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4))
    rigid = root @ root.T
    new = np.diag([1.0, 0.3, 0.01, 1e-8])  # shares of the rigid covariance, the last one is nothing
    covariance = root @ new @ root.T
    draws = rng.multivariate_normal(np.zeros(4), covariance, N_RUNS)
    found = [_chi_square(draw, covariance, rigid) for draw in draws]
    assert {degrees for _, degrees in found} == {3}
    squares = np.array([q for q, _ in found])
    assert squares.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / N_RUNS))
    deviations = np.array([_as_normal(q, 3) for q in squares])
    assert np.mean(deviations > 1.96) == pytest.approx(0.05, abs=4.0 * np.sqrt(0.05 / N_RUNS))
    assert _as_normal(1e5, 3) > 30.0


def test_it_is_a_finding_from_three_deviations_on() -> None:
    near = StageDifference("beta", None, 0.6, 0.601, 0.01, "kg m^2")
    far = StageDifference("motor_inertia", 2, 5e-5, 5.8e-5, 1e-6, "kg m^2")
    quiet = AgreementTest("all", None, 20.0, 10, 0.99 * MAX_NOISE_DEVIATIONS)
    high_variance = AgreementTest("inertias", None, 70.0, 4, 7.4)
    assert list(disagreement((near, far), ())) == []
    assert list(disagreement((near, far), (quiet,))) == []
    (said,) = disagreement((near, far), (quiet, high_variance))
    assert said.code == "stages-disagree"
    assert (
        "taken together, inertias and gravity torques differ by 7.4 standard deviations"
        in said.message
    )
    assert "chi-square 70 of 4 degrees" in said.message
    largest = "motor_inertia of joint 2 5e-05 by the rigid and 5.8e-05"
    assert said.message.index(largest) < said.message.index("beta")
    causes = ("motor constant", "clock", "dead zone", "friction")
    assert sorted(causes, key=said.message.index) == list(causes)


@cache
def records() -> tuple[Study, tuple[Log, ...]]:
    """A slow motion and a PRBS on either joint of the built-in arm, with noise."""
    study = scara.study(Path(), "linear")
    motion = next(e for e in study.experiments if e.use == "motion")
    fast = [e for e in study.experiments if e.use == "frequency"]
    fast = [replace(e, prbs=Prbs(10, 1e-3, 1, 10.0)) for e in fast]
    wanted = replace(study, experiments=(motion, *fast))
    return written_logs(wanted, scara.parameters(5, "linear"), noise=SensorNoise())


Change = Callable[[str, FloatArray], FloatArray]


def altered(folder: Path, change: Change, link_length: float | None = None) -> Identification:
    """The whole of `identify` on these records, every channel and the time changed."""
    study, logs = records()
    if link_length is not None:
        study = replace(study, arm=replace(study.arm, link_length=link_length))
    for log in logs:
        columns = {"t": log.time, **log.channels}
        write_log(folder / log.experiment.file, {k: change(k, x) for k, x in columns.items()})
    copy = replace(study, path=folder / "study.toml")
    write_study(copy, copy.path)
    return identify(copy.path)


def weakening(name: str, x: FloatArray) -> FloatArray:
    """The voltage that a motor would need whose constant falls by 10 % at 10 V.

    v = u (1 - 0.01 |u|) is what the arm was given.
    """
    if not name.startswith("u"):
        return x
    return np.asarray(50.0 * np.sign(x) * (1.0 - np.sqrt(1.0 - 0.04 * np.abs(x))))


def fast_clock(name: str, x: FloatArray) -> FloatArray:
    return 1.01 * x if name == "t" else x


def test_on_a_clean_arm_the_stages_agree(tmp_path: Path) -> None:
    found = altered(tmp_path, lambda _, x: x)
    assert found.tuned is not None
    tests = found.tuned.agreement
    scopes = [(test.scope, test.joint) for test in tests]
    assert scopes == [("all", None), ("inertias", None), ("friction", 1), ("friction", 2)]
    assert all(test.deviations < MAX_NOISE_DEVIATIONS for test in tests), tests
    assert found.verdict.status == "determined"


def test_a_motor_that_weakens_at_full_voltage_is_a_contradiction(tmp_path: Path) -> None:
    """Fits alone do not show it: inertias come out a tenth off. No inertia is published."""
    found = altered(tmp_path, weakening)
    assert found.tuned is not None
    deviations = {test.scope: test.deviations for test in found.tuned.agreement}
    assert deviations["inertias"] > 8.0
    assert "stages-disagree" in [w.code for w in found.warnings]
    assert (found.verdict.status, found.verdict.exit_code) == ("not-determined", 3)
    assert all(p.value is None for p in found.parameters)


def test_a_link_length_that_is_wrong_is_the_first_suspect(tmp_path: Path) -> None:
    """By 8 %: the run is not determined, and the reason says what to measure."""
    length = records()[0].arm.link_length
    assert length is not None
    found = altered(tmp_path, lambda _, x: x, 1.08 * length)
    assert found.tuned is not None
    assert found.verdict.status == "partly-determined"
    first = found.tuned.suspects[0]
    assert first.name == "link_length"
    assert first.value == pytest.approx(length, rel=0.04)  # by one linear step
    reason = found.verdict.reasons[0]
    assert "likely causes in this order: link_length" in reason
    assert "measure the distance between the axes" in reason


def test_suspects_stand_in_order_with_their_experiments() -> None:
    far = AgreementTest("inertias", None, 70.0, 4, 7.4)
    suspects = (
        SuspectConstant("link_length", None, 0.7, 0.35, "m", "measure it"),
        SuspectConstant("payload", None, 0.4, experiment="repeat the motion"),
    )
    (warning,) = disagreement((), (far,), suspects)
    expected = "link_length (then 0.35 m), which would explain 70 %: measure it, or payload"
    assert expected in warning.message
    assert "dead zone" not in warning.message


def test_a_clock_that_is_fast_is_named(tmp_path: Path) -> None:
    found = altered(tmp_path, fast_clock)
    assert [one.code for one in found.suspected] == ["clock-drift"]
    assert found.verdict.status == "inconsistent-input"


def test_a_sure_difference_that_nobody_would_mind_is_no_finding() -> None:
    """Both fits may know a friction to a thousandth, and differ by as little with certainty."""
    sure = AgreementTest("friction", 1, 80.0, 3, 8.0, largest=0.003)
    assert not list(disagreement((), [sure]))
    assert list(disagreement((), [replace(sure, largest=0.03)]))
