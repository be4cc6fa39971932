"""Covariance of the whole-arm fit: closed forms, repeated draws, and groups of parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from strainwave.domain import FloatArray
from strainwave.identification.whole_arm.inference import covariance
from strainwave.identification.whole_arm.inference.covariance import Confidence, confidence_at
from strainwave.identification.whole_arm.inference.parameter_estimates import only_together
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import (
    ParameterSpace,
    Prior,
    Unknown,
)
from strainwave.identification.whole_arm.problem.weighted_rows import Weights
from strainwave.identification.whole_arm.records.dataset import Kernels
from tuning_runs import linear_record, linear_search

N = 600
TRUTH = np.array([2.0, -1.0, 0.5])
FAR = 50.0  # standard deviations; the loss is then quadratic


def table_of(seed: int, rows: int = N, channels: int = 1) -> FloatArray:
    """Regressor with low-pass columns, as in filtered motion."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(rows + 200, channels, 3))
    return np.asarray(lfilter([0.4], [1.0, -0.9], white, axis=0)[200:])


def coloured(rng: np.random.Generator, rows: int, pole: float, size: float) -> FloatArray:
    white = rng.normal(0.0, size * np.sqrt(1.0 - pole**2), (rows + 300, 1))
    return np.asarray(lfilter([1.0], [1.0, -pole], white, axis=0)[300:])


def objective_of(
    tables: Sequence[FloatArray],
    errors: Sequence[FloatArray],
    deviation: float,
    *,
    noise: float = 1e9,
    prior: Prior | None = None,
    shifted: bool = False,
) -> Objective:
    """Objective of linear records with the given errors; by default the noise explains them."""
    records = [
        linear_record(table, table @ TRUTH + error, noise=noise, shifted=shifted)
        for table, error in zip(tables, errors, strict=True)
    ]
    widths = [table.shape[1] for table in tables]
    weights = tuple(Weights(np.full(n, deviation), np.ones(n)) for n in widths)
    return replace(Objective.of(linear_search(3, prior), records), weights=weights)


def solved(objective: Objective) -> FloatArray:
    """Minimum of a linear objective with fixed weights."""
    z = np.zeros(len(objective.space.unknowns))
    for _ in range(40):
        linearised = objective.linearise(z)
        assert linearised is not None
        R = linearised.factor
        step = np.linalg.lstsq(R[:, :-1], -R[:, -1])[0]
        z = z + step
        if np.max(np.abs(step)) < 1e-12:
            break
    return np.asarray(z)


def test_errors_of_simulations_widen_the_intervals_of_positive_parameters(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    objective = objective_of(
        [table_of(1)], [np.random.default_rng(2).normal(0.0, 0.1, (N, 1))], FAR
    )
    positive, *signed = objective.space.unknowns
    space = replace(objective.space, unknowns=(replace(positive, signed=False), *signed))
    z = solved(objective)
    value = abs(space.parameters(z)[0])
    stds = []
    for share in (0.0, 0.5):
        monkeypatch.setattr(covariance, "SIMULATION_ERROR", share)
        combined = confidence_at(objective.replace_unknowns(space), z).combined
        stds.append(np.sqrt(np.diag(combined)))
    assert stds[1][0] == pytest.approx(np.hypot(stds[0][0], 0.5 * value))
    assert np.array_equal(stds[1][1:], stds[0][1:])


def least_squares(table: FloatArray, error: FloatArray) -> FloatArray:
    flat = table.reshape(-1, 3)
    return np.asarray(np.linalg.lstsq(flat, flat @ TRUTH + error.ravel())[0])


def test_the_local_covariance_is_the_closed_form() -> None:
    tables = [table_of(0), table_of(1, 400)]
    prior = Prior(np.array([[30.0, 10.0, 0.0]]), np.array([50.0]), np.eye(1))
    errors = [np.zeros((N, 1)), np.zeros((400, 1))]
    confidence = confidence_at(objective_of(tables, errors, 0.1, prior=prior), TRUTH)
    information = sum(t.reshape(-1, 3).T @ t.reshape(-1, 3) for t in tables) / 0.1**2
    information = information + prior.rows.T @ prior.rows
    np.testing.assert_allclose(confidence.local, np.linalg.inv(information), rtol=1e-9)


def test_a_records_own_constants_cost_certainty() -> None:
    """The constants of a record act like additional unknowns."""
    table = table_of(2) + np.array([1.0, 0.0, 0.3])
    confidence = confidence_at(objective_of([table], [np.zeros((N, 1))], 0.1, shifted=True), TRUTH)
    regressor = np.column_stack([np.ones(N), table.reshape(-1, 3)]) / 0.1
    expected = np.linalg.inv(regressor.T @ regressor)[1:, 1:]
    np.testing.assert_allclose(confidence.local, expected, rtol=1e-8)


def test_weights_and_scales_are_taken_into_account() -> None:
    """Logarithmic coordinates, and rows with small robust weights."""
    rng = np.random.default_rng(3)
    table = np.abs(table_of(3))
    unknowns = tuple(
        Unknown(f"p{k}", None, "1", s, s, False, 10.0) for k, s in enumerate((1.0, 5.0, 0.1))
    )
    space = ParameterSpace(unknowns, {}, Prior.empty(3))
    z = np.array([0.2, -0.1, 0.4])
    p = space.parameters(z)
    error = rng.normal(0.0, 0.2, (N, 1))
    record = linear_record(table, table @ p + error, noise=1e9)
    weights = Weights(np.array([0.1]), np.array([3.0]))
    objective = replace(Objective.of(space, [record]), weights=(weights,))
    confidence = confidence_at(objective, z)
    weight = 1.0 / np.sqrt(1.0 + (error / 0.1) ** 2) / 3.0 / 0.1**2
    flat = table.reshape(-1, 3)
    np.testing.assert_allclose(confidence.local, np.linalg.inv(flat.T @ (weight * flat)), rtol=1e-8)


def draws(pole: float, n: int, deviation: float, size: float) -> tuple[FloatArray, FloatArray]:
    """Covariance of fits over draws of the errors, and mean of their sandwich covariances."""
    rng = np.random.default_rng(4)
    table = table_of(4, 3 * N)
    fits, sandwiches = [], []
    for _ in range(n):
        objective = objective_of([table], [coloured(rng, 3 * N, pole, size)], deviation)
        z = solved(objective)
        fits.append(z)
        sandwiches.append(confidence_at(objective, z).sandwich)
    return np.cov(np.array(fits).T), np.mean(sandwiches, axis=0)


def test_the_sandwich_knows_of_errors_that_go_on() -> None:
    true, sandwich = draws(0.9, 150, FAR * 0.1, 0.1)
    # 150 draws, ten sections: correlation across their borders is neglected
    ratio = np.sqrt(np.diag(sandwich) / np.diag(true))
    assert np.all((ratio > 0.75) & (ratio < 1.15)), ratio
    objective = objective_of([table_of(4, 3 * N)], [np.zeros((3 * N, 1))], 0.1)
    local_variance = np.diag(confidence_at(objective, TRUTH).local)
    # slow errors affect slow columns: the closed form for independent rows is far too small
    assert np.all(np.diag(true) > 4.0 * local_variance)


def test_the_sandwich_in_deviations() -> None:
    """Errors as large as their standard deviation, where the robust loss is not quadratic."""
    true, sandwich = draws(0.0, 150, 0.1, 0.1)
    ratio = np.sqrt(np.diag(sandwich) / np.diag(true))
    assert np.all((ratio > 0.85) & (ratio < 1.15)), ratio


def quick(rng: np.random.Generator, rows: int, size: float) -> FloatArray:
    """High-frequency errors, like those of a differentiated angle."""
    return np.diff(rng.normal(0.0, size / np.sqrt(2.0), (rows + 1, 1)), axis=0)


def test_the_steady_covariance_knows_how_quick_errors_are() -> None:
    """High-frequency errors hardly affect slow columns, and affect a sum less than its terms."""
    rng = np.random.default_rng(14)
    table = table_of(14)
    table[..., 1] = table[..., 0] + 0.3 * rng.normal(size=(N, 1))
    total = np.array([1.0, 1.0, 0.0])
    fits, confidences = [], []
    for _ in range(150):
        objective = objective_of([table], [quick(rng, N, 0.1)], 0.1)
        fits.append(solved(objective))
        confidences.append(confidence_at(objective, fits[-1]))
    true = np.cov(np.array(fits).T)
    steady = np.mean([confidence.steady for confidence in confidences], axis=0)
    ratio = np.sqrt(np.diag(steady) / np.diag(true))
    assert np.all((ratio > 0.85) & (ratio < 1.15)), ratio
    assert confidences[0].local[2, 2] > 4.0 * true[2, 2]
    combined = np.mean([confidence.combined for confidence in confidences], axis=0)
    ratio_of_total = np.sqrt(total @ combined @ total / (total @ true @ total))
    assert 0.85 < ratio_of_total < 1.3, ratio_of_total
    assert total @ confidences[0].local @ total > 4.0 * (total @ true @ total)


def test_errors_count_as_no_smaller_than_the_sensors_noise() -> None:
    """The sensor noise is the lower limit of the error, independently of the weights."""
    error = quick(np.random.default_rng(15), N, 0.1)

    def steady(noise: float, deviation: float = FAR * 0.1) -> FloatArray:
        confidence = confidence_at(
            objective_of([table_of(15)], [error], deviation, noise=noise), TRUTH
        )
        return confidence.steady - 1e-3 * confidence.local

    reference = steady(0.05)
    for steady_covariance, factor in (
        (steady(0.01), 1.0),
        (steady(0.05, 2.0 * FAR * 0.1), 1.0),
        (steady(0.4), (0.4 / np.std(error)) ** 2),
    ):
        size = factor * np.max(reference)
        np.testing.assert_allclose(
            steady_covariance, factor * reference, rtol=1e-3, atol=1e-3 * size
        )


def test_at_standstill_errors_are_the_sensors_noise() -> None:
    """Without residuals, the noise counts as white, which gives the closed form."""
    table = table_of(19)
    confidence = confidence_at(objective_of([table], [np.zeros((N, 1))], 0.5, noise=0.1), TRUTH)
    flat = table.reshape(-1, 3)
    expected = 0.1**2 * np.linalg.inv(flat.T @ flat)
    np.testing.assert_allclose(confidence.steady - 1e-3 * confidence.local, expected, rtol=1e-6)


def test_rigid_estimates_are_weighted_by_their_reported_errors() -> None:
    """The covariance uses the reported errors of the rigid step, not the weights of the fit."""
    table = table_of(16)
    table[..., 2] = 0.0
    assumed, errors = 0.1, np.array([[0.25]])
    prior = Prior(np.array([[0.0, 0.0, 1.0 / assumed]]), TRUTH[2:] / assumed, errors)
    confidence = confidence_at(objective_of([table], [np.zeros((N, 1))], 0.1, prior=prior), TRUTH)
    assert np.sqrt(confidence.local[2, 2]) == pytest.approx(assumed)
    assert np.sqrt(confidence.combined[2, 2]) == pytest.approx(0.5 * assumed, rel=0.01)


def test_a_rigid_step_that_the_records_contradict_counts_for_less() -> None:
    """A residual of ten standard deviations increases the covariance of the rigid step."""
    rng = np.random.default_rng(17)
    table, error = table_of(17), rng.normal(0.0, 0.01, (N, 1))
    table[..., 2] = 0.0
    assumed, reported = np.array([0.1, 0.1]), np.array([0.02, 0.02])
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) / assumed[:, None]
    confidences = []
    for prior_error in (0.0, 0.2):
        target = (TRUTH[[0, 2]] + [prior_error, 0.0]) / assumed
        prior = Prior(rows, target, np.diag((reported / assumed) ** 2))
        objective = objective_of([table], [error], 0.01, prior=prior)
        confidences.append(confidence_at(objective, solved(objective)))
    assert np.sqrt(confidences[0].combined[2, 2]) == pytest.approx(reported[1], rel=0.05)
    # one of two residuals is ten standard deviations: the rms value is sqrt(50)
    assert np.sqrt(confidences[1].combined[2, 2]) == pytest.approx(
        np.sqrt(50.0) * reported[1], rel=0.05
    )


def test_local_deviations_hold_for_white_errors() -> None:
    rng = np.random.default_rng(5)
    table = table_of(5)
    fits = []
    for _ in range(200):
        objective = objective_of([table], [rng.normal(0.0, 0.1, (N, 1))], 0.1)
        fits.append(solved(objective))
    local = confidence_at(objective, fits[-1]).local
    ratio = np.sqrt(np.diag(local)) / np.std(fits, axis=0)
    # the robust weights make the interval slightly too wide
    assert np.all((ratio > 0.9) & (ratio < 1.25)), ratio


def test_records_with_errors_of_their_own_scatter() -> None:
    """The scatter covariance is that of fits to new records; the local one is too small."""
    rng = np.random.default_rng(6)
    tables = [table_of(10 + k, 200) for k in range(6)]
    fits, scatters = [], []
    for _ in range(80):
        errors = [0.1 * (t @ rng.normal(size=3)) + rng.normal(0.0, 0.01, (200, 1)) for t in tables]
        objective = objective_of(tables, errors, FAR)
        fits.append(solved(objective))
        scatters.append(np.diag(confidence_at(objective, fits[-1]).scatter))
    ratio = np.sqrt(np.mean(scatters, axis=0)) / np.std(fits, axis=0)
    assert np.all((ratio > 0.8) & (ratio < 1.2)), ratio
    local = np.diag(confidence_at(objective, fits[-1]).local) * (0.01 / FAR) ** 2
    assert np.all(local < 0.01 * np.var(fits, axis=0))


def test_records_of_the_true_model_scatter_as_the_local_covariance() -> None:
    """Valid also if a single record identifies a parameter, for which a jackknife would fail."""
    rng = np.random.default_rng(7)
    tables = [table_of(30 + k, 200) for k in range(5)]
    for table in tables[1:]:
        table[..., 2] = 0.0
    ratios = []
    for _ in range(40):
        objective = objective_of(tables, [rng.normal(0.0, 0.01, (200, 1)) for _ in tables], 0.01)
        confidence = confidence_at(objective, solved(objective))
        ratios.append(np.diag(confidence.scatter) / np.diag(confidence.local))
    ratio = np.sqrt(np.mean(ratios, axis=0))
    assert np.all(ratio < 1.2), ratio
    assert np.all(ratio[:2] > 0.7), ratio


def test_two_records_do_not_scatter() -> None:
    tables = [table_of(k) for k in (1, 2)]
    confidence = confidence_at(objective_of(tables, [np.zeros((N, 1))] * 2, 0.1), TRUTH)
    assert np.all(np.isnan(confidence.scatter))
    assert np.all(np.isfinite(confidence.combined))


def deviations(found: Confidence) -> FloatArray:
    parts = [found.local, found.sandwich, found.scatter]
    return np.sqrt([np.diag(part) for part in parts])


def test_deviations_count_stretches_and_scatter() -> None:
    rng = np.random.default_rng(8)
    tables = [table_of(20 + k, 200) for k in range(4)]
    for pole in (0.0, 0.97):
        errors = [coloured(rng, 200, pole, 0.1) for _ in tables]
        objective = objective_of(tables, errors, 0.1)
        confidence = confidence_at(objective, solved(objective))
        local_std, sandwich_std, scatter_std = deviations(confidence)
        reported = np.sqrt(np.diag(confidence.combined))
        assert np.all(reported**2 >= 0.5 * local_std**2)
        assert np.all(reported >= 0.999 * sandwich_std)
        # scatter beyond the noise is included, with an allowance for only four records
        if np.max(scatter_std / local_std) > 3.0:
            assert np.all(reported**2 >= 0.6 * scatter_std**2)
        if pole == 0.0:
            assert np.all(reported < 1.6 * local_std)
        # the correlations are those of the steady covariance
        correlations = [
            part / np.sqrt(np.outer(np.diag(part), np.diag(part)))
            for part in (confidence.combined, confidence.steady)
        ]
        np.testing.assert_allclose(correlations[0], correlations[1], atol=1e-9)


def test_intervals_hold_where_few_records_have_errors_of_their_own() -> None:
    """Coverage of 95 % intervals for four records with slightly different parameters."""
    rng = np.random.default_rng(13)
    tables = [table_of(40 + k, 200) for k in range(4)]
    is_inside = []
    for _ in range(80):
        errors = [0.1 * (t @ rng.normal(size=3)) + rng.normal(0.0, 0.01, (200, 1)) for t in tables]
        objective = objective_of(tables, errors, 0.1, noise=1e9).update_weights(TRUTH)
        z = solved(objective)
        half_width = 1.96 * np.sqrt(np.diag(confidence_at(objective, z).combined))
        is_inside.append(np.abs(z - TRUTH) < half_width)
    coverage = np.mean(is_inside, axis=0)
    assert np.all((coverage > 0.88) & (coverage <= 1.0)), coverage


def test_errors_beyond_the_sensors_noise_raise_deviations() -> None:
    rng = np.random.default_rng(9)
    table = table_of(9)
    error = rng.normal(0.0, 0.1, (N, 1))
    explained = objective_of([table], [error], 0.1, noise=0.1)
    z = solved(explained)
    quiet = confidence_at(explained, z)
    larger = np.maximum(np.diag(quiet.sandwich), np.diag(quiet.steady))
    np.testing.assert_allclose(np.diag(quiet.combined), larger)
    unexplained = replace(
        explained, records=(replace(explained.records[0], noise=np.ones(1) / 40.0),)
    )
    high_variance = confidence_at(unexplained, z)
    raised = np.sqrt(np.diag(high_variance.combined) / larger)
    # noise explains 1 / 40^2 of the variance; 0.8 of the unexplained share is added
    residual = (table @ z)[:, :, None] - (table @ TRUTH)[:, :, None] - error[..., None]
    share = 0.8 - 1.0 / 40.0**2 / (1.4826 * np.median(np.abs(residual))) ** 2
    # the spectrum of 600 rows is white to a few per cent of this share
    by_local = 1.0 + share * np.maximum(np.diag(quiet.local) / larger - 1.0, 0.0)
    np.testing.assert_allclose(raised, np.sqrt(by_local * (1.0 + share)), rtol=5e-3)


def test_an_error_below_the_noise_counts_in_the_band_of_a_parameter() -> None:
    """Slow errors of a tenth of the noise affect slow columns, but not fast ones."""
    rng = np.random.default_rng(21)
    rows = 4 * N
    table = table_of(21, rows)  # slow columns
    table[..., 2] = np.diff(rng.normal(size=(rows + 1, 1)), axis=0)  # as fast as the noise
    clean, wrong = [], []
    for _ in range(4):
        noise = quick(rng, rows, 0.1)
        clean.append(noise)
        wrong.append(noise + coloured(rng, rows, 0.98, 0.03))
    kernels = Kernels(np.array([1.0, -1.0]), np.array([1.0, -1.0]), 1)

    def shares(errors: Sequence[FloatArray]) -> FloatArray:
        objective = objective_of([table] * 4, errors, 0.1, noise=0.1)
        records = tuple(replace(record, kernels=kernels) for record in objective.records)
        confidence = confidence_at(replace(objective, records=records), TRUTH)
        variance = np.maximum(np.diag(confidence.sandwich), np.diag(confidence.steady))
        variance = np.maximum(variance, np.diag(confidence.scatter))
        return np.asarray(np.diag(confidence.combined) / variance)

    assert np.all(shares(clean) < 1.3), shares(clean)
    ratios = shares(wrong)
    assert np.all(ratios[:2] > 2.5), ratios
    assert ratios[2] < 1.5, ratios


@pytest.mark.parametrize("n", [1, 4, 9])
def test_a_common_error_of_all_records_is_not_reduced_by_averaging(n: int) -> None:
    """More records reduce the effect of noise, but not that of a common model error."""
    rng = np.random.default_rng(12)
    error = rng.normal(0.0, 1.0, (200, 1))
    tables, errors = [table_of(12, 200)] * n, [0.1 * error / np.std(error)] * n
    confidences = [
        confidence_at(objective_of(tables, errors, 0.1, noise=noise), TRUTH)
        for noise in (0.0999, 1e-9)
    ]
    within = np.diag(confidences[0].combined)
    raised = within + 0.8 * np.maximum(np.diag(confidences[0].local) - within, 0.0)
    expected = raised * (1.0 + 0.8 * n)
    np.testing.assert_allclose(np.diag(confidences[1].combined), expected, rtol=1e-9)


def test_a_parameter_without_information_has_a_large_variance() -> None:
    table = table_of(10)
    table[..., 2] = 0.0
    confidence = confidence_at(objective_of([table], [np.zeros((N, 1))], 0.1), TRUTH)
    flat = table.reshape(-1, 3)[:, :2] / 0.1
    np.testing.assert_allclose(confidence.local[:2, :2], np.linalg.inv(flat.T @ flat), rtol=1e-8)
    assert not confidence.combined[2, 2] < 1e12
    assert abs(confidence.local[0, 2]) <= 1e-3 * np.sqrt(
        confidence.local[0, 0] * confidence.local[2, 2]
    )


def test_a_pair_that_is_reported_only_together() -> None:
    rng = np.random.default_rng(11)
    table = table_of(11)
    # the second column is nearly equal to the third
    table[..., 1] = table[..., 2] + 1e-3 * rng.normal(size=(N, 1))
    confidence = confidence_at(objective_of([table], [np.zeros((N, 1))], 0.2), TRUTH)
    groups = list(only_together(["a", "b", "c"], TRUTH, confidence.combined))
    assert [names for names, _ in groups] == [("b", "c")]
    # the direction increases b and decreases c by the same amount
    relative = confidence.combined / np.outer(TRUTH, TRUTH)
    relative_std = np.sqrt(np.linalg.eigvalsh(relative)[-1])
    assert groups[0][1] == pytest.approx(relative_std)
    # a prior on their sum removes the group
    prior = Prior(np.array([[0.0, 1.0, 0.0]]) * 1e3, np.array([-1e3]), np.eye(1))
    with_prior = confidence_at(objective_of([table], [np.zeros((N, 1))], 0.2, prior=prior), TRUTH)
    assert list(only_together(["a", "b", "c"], TRUTH, with_prior.combined)) == []


def test_a_single_uncertain_parameter_is_no_group() -> None:
    covariance = np.diag([1e-6, 0.25, 1e-6])
    assert list(only_together(["a", "b", "c"], np.ones(3), covariance)) == []
    # two uncertain, uncorrelated parameters are no group either
    mixed = np.diag([0.25, 0.25, 1e-6])
    assert list(only_together(["a", "b", "c"], np.ones(3), mixed)) == []


def test_well_identified_correlated_ones_are_no_group() -> None:
    pair = np.array([[1.0, 0.9999], [0.9999, 1.0]])
    assert list(only_together(["a", "b"], np.ones(2), 1e-4 * pair)) == []
    (names, relative_std), *others = only_together(["a", "b"], np.ones(2), pair)
    assert (names, others) == (("a", "b"), [])
    assert relative_std == pytest.approx(np.sqrt(1.9999))


def test_evidence_is_never_surer_than_the_local_covariance() -> None:
    """Each variance is the larger of two; correlations are those of the combined covariance."""
    combined = np.array([[4.0, 0.6], [0.6, 1.0]])
    local = np.diag([1.0, 9.0])
    empty = np.zeros((0, 0))
    confidence = Confidence(
        combined, local, combined, combined, combined, np.zeros(0), (empty, empty)
    )
    cautious = confidence.cautious
    np.testing.assert_allclose(np.diag(cautious), [4.0, 9.0])
    assert cautious[0, 1] / np.sqrt(4.0 * 9.0) == pytest.approx(0.6 / np.sqrt(4.0 * 1.0))
