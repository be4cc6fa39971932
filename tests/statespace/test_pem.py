"""Prediction-error method: derivatives, optimum, options and errors."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from strainwave.domain import ContinuousStateSpace, FloatArray, InputOutput, StateSpace
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.statespace import PemOptions, modes, pem, propagate, subspace, to_continuous
from strainwave.statespace._evaluate import Evaluator
from strainwave.statespace._scaled import ModelMatrices, balance, rescale, stack
from strainwave.statespace.subspace import Method
from two_inertia import TwoInertia, excitation, simulate

ARM = TwoInertia()
GAIN = np.array([[0.0, 1e-3], [0.3, 0.5], [0.001, 0.3]])
NOISE = np.array([0.3, 0.005])
TRUTH = ARM.sampled(GAIN, np.diag(NOISE**2))


def noisy(seed: int, samples: int, truth: StateSpace = TRUTH) -> InputOutput:
    rng = np.random.default_rng(seed)
    noise = NOISE * rng.standard_normal((samples, 2))
    return simulate(truth, excitation(rng, samples), noise)


def physical(model: ContinuousStateSpace) -> FloatArray:
    """Parameters m_M, m_L, k, d_G, from quantities that are invariant to state coordinates.

    C B contains e / m_M and 1 / m_L. The zeros of the first channel depend on the link only.
    """
    CB = model.C @ model.B
    m_M, m_L = ARM.torque_per_volt / CB[0, 0], 1.0 / CB[1, 1]
    zero = modes(replace(model, covariance=None), 0, 0).anti_resonance
    assert zero is not None
    w = 2.0 * np.pi * zero.frequency_hz
    return np.array(
        [m_M, m_L, w * w * m_L, 2.0 * zero.damping * w * m_L - ARM.link_viscous_friction]
    )


PHYSICAL = np.array([ARM.motor_inertia, ARM.link_inertia, ARM.gear_stiffness, ARM.gear_damping])


def information_bound(data: InputOutput) -> FloatArray:
    """Cramer-Rao bound at the true values: the smallest covariance of an unbiased estimate.

    Inverse of sum psi' Lambda^-1 psi over directions that change the innovations. Only the
    interaction torque has feedthrough, as in the fit.
    """
    stacked = stack(data)
    n, m, p = 3, 2, 2
    true_matrices = ModelMatrices(TRUTH.A, TRUTH.B, TRUTH.C, TRUTH.D, TRUTH.K, TRUTH.initial_states)
    scaled = rescale(true_matrices, stacked).pack()
    J = Evaluator(stacked, n).core.jacobian(scaled)
    J = (J * (stacked.output_scale / NOISE)[:, None]).reshape(-1, J.shape[2])
    free = np.ones(J.shape[1], dtype=bool)
    start = n * (n + m + p)
    free[[start, start + m]] = False
    size = np.linalg.norm(J[:, free], axis=0)
    _, s, Vt = np.linalg.svd(J[:, free] / size, full_matrices=False)
    is_determined = s > 1e-9 * s[0]
    # All directions except changes of state coordinates.
    assert is_determined.sum() == free.sum() - n * n
    factor = np.zeros((len(free), int(is_determined.sum())))
    factor[free] = Vt[is_determined].T / s[is_determined] / size[:, None]
    u, y = stacked.input_scale, stacked.output_scale
    parts = [np.ones((n, n)), np.ones((n, 1)) / u, y[:, None] * np.ones((1, n))]
    parts += [y[:, None] / u, np.ones((n, 1)) / y]
    factor = factor[: start + p * m + n * p] * np.concatenate([np.ravel(x) for x in parts])[:, None]
    return np.asarray(factor @ factor.T)


# --- derivatives ------------------------------------------------------------------------------


def test_jacobian_is_the_derivative_to_second_order() -> None:
    """The error of a central difference is proportional to the square of the step."""
    first, second = noisy(1, 60), noisy(2, 35)
    data = stack([first, second])
    evaluator = Evaluator(data, 3)
    rng = np.random.default_rng(0)
    start = rescale(
        ModelMatrices(TRUTH.A, TRUTH.B, TRUTH.C, TRUTH.D, TRUTH.K, np.zeros((2, 3))), data
    )
    values = balance(start).pack() + 0.01 * rng.standard_normal(start.pack().shape)
    J = evaluator.core.jacobian(values)
    entries = J.shape[2] - 3
    exact = np.zeros((len(J), 2, len(values)))
    exact[:, :, :entries] = J[:, :, :entries]
    exact[:60, :, entries : entries + 3] = J[:60, :, entries:]
    exact[60:, :, entries + 3 :] = J[60:, :, entries:]
    direction = rng.standard_normal(len(values))
    errors = []
    for step in (1e-3, 1e-4):
        ahead = evaluator.core.residuals(values + step * direction)
        behind = evaluator.core.residuals(values - step * direction)
        errors.append(np.abs((ahead - behind) / (2.0 * step) - exact @ direction).max())
    assert errors[0] / errors[1] == pytest.approx(100.0, rel=0.02)


@pytest.mark.parametrize("feedthrough", [None, (True, True)])
def test_a_predictor_that_overflows_is_refused(
    feedthrough: tuple[bool, ...] | None, capfd: pytest.CaptureFixture[str]
) -> None:
    """An overflowing predictor raises an error and prints nothing."""
    data = stack(noisy(1, 2000))
    evaluator = Evaluator(data, 3)
    unstable = ModelMatrices(
        3.0 * TRUTH.A, TRUTH.B, TRUTH.C, TRUTH.D, 0.0 * TRUTH.K, np.zeros((1, 3))
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(np.linalg.LinAlgError, match="overflows"):
            evaluator.linear(rescale(unstable, data), feedthrough, gain=True)
    assert evaluator.cost(rescale(unstable, data)) == np.inf
    assert capfd.readouterr() == ("", "")


def test_every_entry_has_its_own_derivative() -> None:
    data = stack(noisy(1, 80))
    evaluator = Evaluator(data, 3)
    matrices = ModelMatrices(TRUTH.A, TRUTH.B, TRUTH.C, TRUTH.D, TRUTH.K, np.zeros((1, 3)))
    values = balance(rescale(matrices, data)).pack()
    whitener = evaluator.whitener(evaluator.unpack(values))
    J = evaluator.core.jacobian(values)
    hessian, gradient = evaluator.core.normal_equations(values, whitener)
    white = np.linalg.solve(whitener, J.transpose(1, 0, 2).reshape(2, -1)).reshape(2, 80, -1)
    e = np.linalg.solve(whitener, evaluator.core.residuals(values).T)
    np.testing.assert_allclose(hessian, np.einsum("oki,okj->ij", white, white), rtol=1e-9)
    np.testing.assert_allclose(gradient, np.einsum("oki,ok->i", white, e), rtol=1e-8)
    scores = evaluator.core.scores(values, whitener)
    np.testing.assert_allclose(scores.sum(axis=0), gradient, rtol=1e-8)
    for entry in range(len(values)):
        changed = values.copy()
        changed[entry] += 1e-6
        cost_plus = evaluator.cost(evaluator.unpack(changed))
        changed[entry] -= 2e-6
        # Rounding of the difference: a cost of 1e3 times 1e-13, divided by 1e-6.
        derivative = (cost_plus - evaluator.cost(evaluator.unpack(changed))) / 2e-6
        assert derivative == pytest.approx(gradient[entry], rel=1e-4, abs=1e-3)


# --- the optimum ------------------------------------------------------------------------------


def test_coordinates_of_the_start_do_not_matter() -> None:
    data = noisy(0, 600)
    rng = np.random.default_rng(5)
    T = rng.standard_normal((3, 3))
    matrices = ModelMatrices(TRUTH.A, TRUTH.B, TRUTH.C, TRUTH.D, TRUTH.K, np.zeros((1, 3)))
    changed = matrices.transformed(T)
    other = replace(TRUTH, A=changed.A, B=changed.B, C=changed.C, K=changed.K)
    fits = [pem(data, start=start) for start in (TRUTH, other)]
    assert fits[0].log_likelihood == pytest.approx(fits[1].log_likelihood, abs=1e-3)
    reference, estimate = (propagate(to_continuous(fit), physical) for fit in fits)
    assert reference[1] is not None
    assert estimate[1] is not None
    # Both iterations end within a few hundredths of a standard deviation of the optimum.
    std = np.sqrt(np.diag(reference[1]))
    assert np.abs((reference[0] - estimate[0]) / std).max() < 0.05
    np.testing.assert_allclose(np.diag(estimate[1]), np.diag(reference[1]), rtol=0.02)


def test_start_from_data_reaches_the_optimum_near_the_truth() -> None:
    for seed in range(6):
        data = noisy(seed, 1000)
        cold, warm = pem(data, 3), pem(data, start=TRUTH)
        assert cold.status == "converged"
        assert cold.log_likelihood > warm.log_likelihood - 0.01


def test_exact_data_give_the_exact_arm() -> None:
    rng = np.random.default_rng(0)
    data = simulate(ARM.sampled(), excitation(rng, 800), initial_state=np.array([1e-4, 5.0, 0.05]))
    model = pem(data, 3, options=PemOptions(disturbance="none"))
    np.testing.assert_allclose(physical(to_continuous(model)), PHYSICAL, rtol=1e-7)


def test_refines_a_subspace_estimate() -> None:
    for seed in range(5):
        data = noisy(seed, 1500)
        assert pem(data, 3).log_likelihood > subspace(data, 3).log_likelihood + 0.1


def test_errors_are_as_large_as_stated_and_as_small_as_possible() -> None:
    """Normalised errors are chi-square, and standard deviations reach the Cramer-Rao bound."""
    from scipy.stats import chi2

    seeds, samples = 60, 1500
    total, errors, reported_std = 0.0, [], []
    for seed in range(seeds):
        data = noisy(seed, samples)
        values, covariance = propagate(to_continuous(pem(data, 3)), physical)
        assert covariance is not None
        error = values - PHYSICAL
        total += float(error @ np.linalg.solve(covariance, error))
        errors.append(error)
        reported_std.append(np.sqrt(np.diag(covariance)))
    assert 1e-3 < chi2.sf(total, 4 * seeds) < 1.0 - 1e-3
    bound = propagate(
        to_continuous(replace(TRUTH, covariance=information_bound(noisy(0, samples)))), physical
    )[1]
    assert bound is not None
    bound_std = np.sqrt(np.diag(bound))
    np.testing.assert_allclose(np.mean(reported_std, axis=0), bound_std, rtol=0.1)
    # A standard deviation from 60 seeds has a standard error of 9 %; the tolerance is three of
    # them.
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors), axis=0)), bound_std, rtol=0.28)


def test_white_disturbances_have_no_gain_and_correct_standard_deviations() -> None:
    """With 512 samples, an estimated gain would increase chi-square by a factor of 1.2 to 1.35."""
    from scipy.stats import chi2

    white = ARM.sampled(np.zeros_like(GAIN), np.diag(NOISE**2))
    total, gains, seeds = 0.0, [], 40
    for seed in range(seeds):
        model = pem(noisy(seed, 512, white), 3)
        gains.append(bool(model.K.any()))
        values, covariance = propagate(to_continuous(model), physical)
        assert covariance is not None
        error = values - PHYSICAL
        total += float(error @ np.linalg.solve(covariance, error))
    assert sum(gains) <= 2
    assert all(pem(noisy(seed, 512), 3).K.any() for seed in range(5))
    assert 1e-3 < chi2.sf(total, 4 * seeds) < 1.0 - 1e-3


def test_two_records_have_the_information_of_one_of_double_length() -> None:
    whole = pem(noisy(7, 2000), 3)
    data = noisy(7, 2000)
    halves = pem([data.window(0, 1000), data.window(1000, 2000)], 3)
    assert halves.initial_states.shape == (2, 3)
    reference, estimate = (propagate(to_continuous(fit), physical) for fit in (whole, halves))
    assert reference[1] is not None
    assert estimate[1] is not None
    np.testing.assert_allclose(np.diag(estimate[1]), np.diag(reference[1]), rtol=0.05)


# --- closed loop ------------------------------------------------------------------------------


def closed_loop(seed: int, samples: int) -> InputOutput:
    """Record with a proportional servo on the noisy motor velocity, delayed by one sample."""
    rng = np.random.default_rng(seed)
    e = 5.0 * NOISE * rng.standard_normal((samples, 2))
    torque = 2.0 * rng.standard_normal(samples)
    reference = np.repeat(20.0 * np.sign(rng.standard_normal(samples // 20 + 1)), 20)
    inputs, outputs = np.zeros((samples, 2)), np.zeros((samples, 2))
    x, last_velocity = np.zeros(3), 0.0
    for k in range(samples):
        u = np.array([0.5 * (reference[k] - last_velocity), torque[k]])
        inputs[k], outputs[k] = u, TRUTH.C @ x + TRUTH.D @ u + e[k]
        x = TRUTH.A @ x + TRUTH.B @ u + TRUTH.K @ e[k]
        last_velocity = outputs[k, 0]
    return InputOutput(inputs, outputs, TRUTH.sample_time, TRUTH.hold)


def test_consistent_in_closed_loop() -> None:
    """With K estimated, errors match the standard deviations; an output-error model is biased."""
    scores: dict[str, list[FloatArray]] = {"innovations": [], "none": []}
    for seed in range(4):
        data = closed_loop(seed, 5000)
        for disturbance, errors in scores.items():
            fit = pem(data, 3, options=PemOptions(disturbance=disturbance))  # type: ignore[arg-type]
            values, covariance = propagate(to_continuous(fit), physical)
            assert covariance is not None
            errors.append((values - PHYSICAL) / np.sqrt(np.diag(covariance)))
    # The mean of four standard normal numbers exceeds 1.65 with a probability of 1e-3.
    assert np.abs(np.mean(scores["innovations"], axis=0)).max() < 1.65
    assert np.abs(np.mean(scores["none"], axis=0)).max() > 4.0


# --- options and diagnostics ------------------------------------------------------------------


def test_work_is_pinned() -> None:
    """Upper limits of iterations and evaluations, which detect a slower algorithm."""
    fits = [pem(noisy(seed, 800), 3) for seed in range(5)]
    assert sum(fit.iterations for fit in fits) <= 75
    assert sum(fit.evaluations for fit in fits) <= 90


def test_options_change_the_answer() -> None:
    data = noisy(3, 500)
    default = pem(data, 3)
    assert default.method == "pem"
    assert default.K.any()
    output_error = pem(data, 3, options=PemOptions(disturbance="none"))
    assert output_error.method == "output-error"
    assert not output_error.K.any()
    with_feedthrough = pem(data, 3, options=PemOptions(feedthrough=(True, True)))
    assert not default.D[:, 0].any()
    assert with_feedthrough.D.all()
    assert with_feedthrough.n_parameters == default.n_parameters + 2
    at_standstill = pem(data, 3, options=PemOptions(initial_state="zero"))
    assert default.initial_states.any()
    assert not at_standstill.initial_states.any()
    limited = pem(data, 3, options=PemOptions(max_iterations=1))
    assert limited.status == "iteration-limit"
    assert [warning.code for warning in limited.warnings] == ["pem-iteration-limit"]
    exact = pem(data, 3, options=PemOptions(tolerance=1e-9))
    assert exact.iterations > default.iterations
    kinds = {
        kind: pem(data, 3, options=PemOptions(covariance=kind)).covariance_kind
        for kind in ("white", "sandwich")
    }
    assert kinds == {"white": "white", "sandwich": "sandwich"}


def test_auto_covariance_asks_the_residuals() -> None:
    """An output-error fit of data with coloured noise has coloured residuals."""
    data = noisy(3, 3000)
    assert pem(data, 3).covariance_kind == "white"
    output_error = pem(data, 3, options=PemOptions(disturbance="none"))
    assert output_error.covariance_kind == "sandwich"


def test_sandwich_is_honest_where_white_is_not() -> None:
    seeds, scores = 15, {"white": 0.0, "sandwich": 0.0}
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        clean = simulate(ARM.sampled(), excitation(rng, 6000))
        noise = lfilter([1.0], [1.0, -0.9], NOISE * rng.standard_normal((6000, 2)), axis=0)
        data = replace(clean, outputs=clean.outputs + noise)
        for kind in scores:
            options = PemOptions(disturbance="none", covariance=kind)  # type: ignore[arg-type]
            values, covariance = propagate(to_continuous(pem(data, 3, options=options)), physical)
            assert covariance is not None
            scores[kind] += float(np.sum((values - PHYSICAL) ** 2 / np.diag(covariance)))
    mean = {kind: total / (4 * seeds) for kind, total in scores.items()}
    # The mean of 60 partly correlated squares has a standard error of about 30 %.
    assert 0.5 < mean["sandwich"] < 2.0, mean
    assert mean["white"] > 5.0, mean


def test_too_high_an_order_is_not_passed_off_as_known() -> None:
    rng = np.random.default_rng(0)
    data = simulate(ARM.sampled(), excitation(rng, 400))
    model = pem(data, 5)
    assert model.status == "not-determined"
    assert model.covariance is None
    assert "pem-not-determined" in [warning.code for warning in model.warnings]


def test_a_model_that_predicts_but_does_not_simulate_has_a_warning() -> None:
    """A drift that is independent of the input is predicted one step ahead but not simulated."""
    rng = np.random.default_rng(0)
    drift = np.cumsum(rng.standard_normal((600, 1)), axis=0)
    model = pem(InputOutput(rng.standard_normal((600, 1)), drift, 1e-3), 1)
    assert model.prediction_fit_percent[0] > 80.0
    assert model.fit_percent[0] < 0.0
    assert "negative-fit" in [warning.code for warning in model.warnings]
    assert "negative-fit" not in [warning.code for warning in pem(noisy(0, 400), 3).warnings]


def test_more_states_fit_better() -> None:
    data = noisy(0, 800)
    fits = [pem(data, order).log_likelihood for order in (1, 2, 3)]
    assert all(low < high for low, high in pairwise(fits))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"disturbance": "arma"}, "expected disturbance"),
        ({"initial_state": "free"}, "expected initial_state"),
        ({"covariance": "none"}, "expected covariance"),
        ({"feedthrough": (True,)}, "feedthrough for each of 2 inputs"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        pem(noisy(0, 100), 3, options=PemOptions(**options))  # type: ignore[arg-type]


def test_starts_that_do_not_fit_are_refused() -> None:
    data = noisy(0, 100)
    with pytest.raises(InvalidInput, match="an order or a start"):
        pem(data)
    with pytest.raises(InvalidInput, match="order of at least 1"):
        pem(data, 0)
    with pytest.raises(InvalidInput, match="a start of order 2, got 3"):
        pem(data, 2, start=TRUTH)
    with pytest.raises(InvalidInput, match="a start of 1 inputs and 2 outputs"):
        pem(InputOutput(data.inputs[:, :1], data.outputs, data.sample_time), start=TRUTH)


def test_no_start_has_a_stable_predictor(monkeypatch: pytest.MonkeyPatch) -> None:
    """All starting values have an unstable predictor: an error is raised."""
    unobservable = ModelMatrices(
        1.5 * TRUTH.A, TRUTH.B, 0.0 * TRUTH.C, TRUTH.D, TRUTH.K, np.zeros((1, 3))
    )
    module = sys.modules["strainwave.statespace.pem"]
    monkeypatch.setattr(module, "_starts", lambda *_: [unobservable])
    with pytest.raises(NumericalFailure, match="stable predictor"):
        pem(noisy(0, 600), 3)


def test_a_start_without_a_stable_predictor_is_passed_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    module = sys.modules["strainwave.statespace.pem"]
    starts = module._starts

    def first_unstable(*arguments: Any) -> list[ModelMatrices]:
        matrices: list[ModelMatrices] = starts(*arguments)
        return [replace(matrices[0], A=1.5 * matrices[0].A, K=0.0 * matrices[0].K), *matrices]

    data = noisy(0, 600)
    expected = pem(data, 3)
    monkeypatch.setattr(module, "_starts", first_unstable)
    assert pem(data, 3).log_likelihood == pytest.approx(expected.log_likelihood, abs=1e-6)


def drifting(seed: int) -> InputOutput:
    """A nearly integrating channel in coloured noise, too short to show that its pole is stable."""
    rng = np.random.default_rng(seed)
    u, e = rng.standard_normal((2, 120))
    y = lfilter([0.0, 0.1], [1.0, -0.999], u) + lfilter([1.0, -0.6], [1.0, -0.999], e)
    return InputOutput(inputs=u[:, None], outputs=y[:, None], sample_time=0.01)


def growth(model: StateSpace) -> float:
    return float(np.abs(np.linalg.eigvals(model.A)).max())


def test_stability_is_the_best_stable_model() -> None:
    """Constrained minimum of one state by scanning K at the limit A = 1, the active constraint.

    The barriers of A and A - K C cost at most half a unit of likelihood each.
    """
    n_unstable = 0
    for seed in range(20):
        data = drifting(seed)
        free, stable = pem(data, 1), pem(data, 1, options=PemOptions(focus="stability"))
        assert stable.status == "converged"
        assert growth(stable) < 1.0
        warned = any(warning.code == "stability-enforced" for warning in stable.warnings)
        assert warned == (growth(free) >= 1.0)
        if not warned:
            assert np.array_equal(stable.A, free.A)
            assert np.array_equal(stable.K, free.K)
            continue
        n_unstable += 1
        stacked = stack(data)
        evaluator = Evaluator(stacked, 1)
        one, zero = np.ones((1, 1)), np.zeros((1, 1))
        costs = [
            evaluator.cost(
                evaluator.linear(
                    ModelMatrices((1.0 - 1e-9) * one, one, one, zero, K * one, zero),
                    (False,),
                    gain=True,
                )
            )
            for K in np.linspace(0.05, 1.5, 146)
        ]
        limit = -min(costs) - 0.5 * stacked.n_samples * (
            1.0 + np.log(2.0 * np.pi) + 2.0 * np.log(stacked.output_scale[0])
        )
        assert limit - 1.0 < stable.log_likelihood < free.log_likelihood + 1.0
    assert n_unstable >= 3


@pytest.mark.parametrize("method", ["moesp", "n4sid", "predictor"])
def test_stability_of_a_subspace_estimate_reflects_its_pole(method: Method) -> None:
    estimates = [
        (subspace(data, 1, method=method), subspace(data, 1, method=method, focus="stability"))
        for data in map(drifting, range(20))
    ]
    assert {growth(free) >= 1.0 for free, _ in estimates} == {True, False}
    for free, stable in estimates:
        if growth(free) < 1.0:
            assert np.array_equal(stable.A, free.A)
        else:
            assert growth(stable) == pytest.approx(1.0 / growth(free), rel=1e-9)
            assert stable.warnings[0].code == "stability-enforced"
