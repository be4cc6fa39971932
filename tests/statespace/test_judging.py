"""Residual tests and order selection: correct decisions at the stated significance level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import InputOutput, StateSpace
from strainwave.errors import InvalidInput
from strainwave.statespace import check_model, pem, select_order, subspace_orders
from two_inertia import TwoInertia, excitation, simulate

ARM = TwoInertia()
GAIN = np.array([[0.0, 1e-3], [0.3, 0.5], [0.001, 0.3]])
NOISE = np.array([0.3, 0.005])
TRUTH = ARM.sampled(GAIN, np.diag(NOISE**2))


def noisy(seed: int, samples: int, truth: StateSpace = TRUTH) -> InputOutput:
    rng = np.random.default_rng(seed)
    return simulate(truth, excitation(rng, samples), NOISE * rng.standard_normal((samples, 2)))


def verdicts(model: StateSpace, data: InputOutput) -> dict[str, bool]:
    return {test.name: test.passed for test in check_model(model, data).tests}


def test_p_values_of_the_truth_are_uniform() -> None:
    from scipy.stats import kstest

    p_values: dict[str, list[float]] = {}
    for seed in range(60):
        for test in check_model(TRUTH, noisy(seed, 800)).tests:
            p_values.setdefault(test.name, []).append(test.p_value)
    assert len(p_values) == 3
    for name, values in p_values.items():
        assert kstest(values, "uniform").pvalue > 1e-3, name


def test_each_fault_fails_its_own_test() -> None:
    data = noisy(0, 3000)
    assert all(verdicts(TRUTH, data).values())
    no_gain = replace(TRUTH, K=np.zeros_like(GAIN))
    assert not verdicts(no_gain, data)["white"]
    wrong = replace(TRUTH, B=TRUTH.B * 1.05)
    assert not verdicts(wrong, data)["independent-of-past-inputs"]
    fed_back = replace(data, inputs=data.inputs + 0.5 * np.vstack([np.zeros(2), data.outputs[:-1]]))
    model = pem(data, 3)
    assert not verdicts(model, fed_back)["no-feedback"]


def test_fits_are_those_of_simulation_and_prediction() -> None:
    data = noisy(1, 2000)
    check = check_model(TRUTH, data)
    # Prediction leaves only the innovations unexplained.
    expected = 100.0 * (1.0 - NOISE / data.outputs.std(axis=0))
    np.testing.assert_allclose(check.prediction_fit_percent, expected, atol=0.1)
    assert all(p > s for p, s in zip(check.prediction_fit_percent, check.fit_percent, strict=True))
    assert check.autocorrelation.shape == (26, 2, 2)
    assert check.cross_correlation.shape == (51, 2, 2)
    np.testing.assert_allclose(np.diag(check.autocorrelation[0]), 1.0)
    assert len(check_model(TRUTH, data, lags=10).autocorrelation) == 11


def test_checks_of_other_data_are_refused() -> None:
    data = noisy(0, 100)
    with pytest.raises(InvalidInput, match="as the model has"):
        check_model(TRUTH, InputOutput(data.inputs[:, :1], data.outputs, data.sample_time))
    with pytest.raises(InvalidInput, match="the model's sample time"):
        check_model(TRUTH, replace(data, sample_time=2e-3))


def test_order_of_the_arm_is_three() -> None:
    for seed in range(3):
        selection = select_order(noisy(seed, 1000), orders=(1, 2, 3, 4))
        assert selection.chosen == 3, selection.rule
        assert selection.model.order == 3
        assert selection.model.n_samples == 1000
        assert selection.rule.startswith("order 3: ")
        assert [len(fit) for fit in selection.held_out_fit_percent] == [2] * 4


def test_orders_are_compared_by_the_fit_that_is_given() -> None:
    """Subspace estimates select the same order in a hundredth of the time."""
    selection = select_order(noisy(0, 2000), fit=subspace_orders)
    assert {model.method for model in selection.models} == {"subspace"}
    assert selection.chosen == 3


def test_held_out_data_decide_where_one_order_is_best() -> None:
    selection = select_order(noisy(0, 1000), orders=(2, 3))
    assert selection.chosen == 3
    assert selection.rule == "order 3: all others are worse on held-out data"


def test_records_too_short_to_hold_out_leave_it_to_bic() -> None:
    selection = select_order(noisy(0, 150), orders=(2, 3, 4))
    assert np.isnan(selection.held_out_fit_percent).all()
    assert "no data long enough" in selection.rule


def test_coloured_residuals_silence_bic() -> None:
    """An echo after 12 samples, which no model with so few states describes."""
    rng = np.random.default_rng(0)
    e = NOISE * rng.standard_normal((2000, 2))
    echo = e + 0.8 * np.vstack([np.zeros((12, 2)), e[:-12]])
    selection = select_order(simulate(TRUTH, excitation(rng, 2000), echo), orders=(2, 3, 4))
    assert selection.chosen == 3
    assert "BIC has no say" in selection.rule


def test_orders_that_make_no_sense_are_refused() -> None:
    for orders in ((), (0, 1)):
        with pytest.raises(InvalidInput, match="orders of at least 1"):
            select_order(noisy(0, 100), orders=orders)
