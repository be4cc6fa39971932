"""The fit of the torques of all joints is weighted least squares of any rank."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.input_check.evidence import HypothesisCache
from strainwave.input_check.torque_fit import (
    TorqueSystem,
    fit_torques,
    predict_stretches,
)

N_ROWS, N_LINKS, JOINTS = 80, 12, (1, 2)


def system_of(rng: np.random.Generator, rank: int, noise: float) -> TorqueSystem:
    """Equations of two joints with columns of any length, of which `rank` are independent."""
    n = len(JOINTS) * N_ROWS
    lengths = 10.0 ** rng.uniform(-2.0, 2.0, N_LINKS)
    columns = rng.normal(size=(n, rank)) @ rng.normal(size=(rank, N_LINKS)) * lengths
    joint = np.repeat((0, 1), N_ROWS)
    torque = columns @ rng.normal(size=N_LINKS) + noise * (joint + 1) * rng.normal(size=n)
    total = np.asarray(np.bincount(joint, torque**2), dtype=np.float64)
    fold = np.tile(np.repeat((0, 1), N_ROWS // 2), len(JOINTS))
    n_rows = np.full(len(JOINTS), float(N_ROWS))
    return TorqueSystem(columns, torque, joint, fold, ("a", "b"), JOINTS, total, n_rows)


@given(st.integers(0, 2**32 - 1), st.integers(1, N_LINKS), st.sampled_from([0.1, 3.0]))
def test_the_fit_is_weighted_least_squares(seed: int, rank: int, noise: float) -> None:
    system = system_of(np.random.default_rng(seed), rank, noise)
    fit = fit_torques(system)
    assert fit.basis.shape[1] == rank
    np.testing.assert_allclose(fit.basis.T @ fit.basis, np.eye(rank), atol=1e-6)
    rows, target = fit.weight[:, None] * system.columns, fit.weight * system.torque
    solution = np.linalg.lstsq(rows / np.linalg.norm(rows, axis=0), target, rcond=1e-9)[0]
    expected = target - rows / np.linalg.norm(rows, axis=0) @ solution
    np.testing.assert_allclose(fit.residual, expected, atol=1e-6 * np.abs(target).max())
    for i in (0, 1):
        error = fit.residual[system.joint == i] / fit.weight[system.joint == i]
        assert fit.unexplained[i] == pytest.approx(error @ error / system.total[i], rel=1e-9)


def test_each_stretch_is_predicted_by_the_links_fitted_to_the_others() -> None:
    system = system_of(np.random.default_rng(5), N_LINKS, 0.1)
    predicted, fit = predict_stretches(system), fit_torques(system)
    for k in (0, 1):
        rows, others = system.fold == k, system.fold != k
        weighted = fit.weight[:, None] * system.columns
        links = np.linalg.lstsq(weighted[others], (fit.weight * system.torque)[others], rcond=None)[
            0
        ]
        error = system.torque[rows] - system.columns[rows] @ links
        expected = np.bincount(system.joint[rows], error**2)
        np.testing.assert_allclose(predicted.shares[k] * system.total, expected, rtol=1e-2)


def test_a_record_with_other_torques_is_predicted_better_without_it() -> None:
    system = system_of(np.random.default_rng(6), N_LINKS, 0.01)
    wrong = replace(system, torque=np.where(system.fold == 1, -2.0, 1.0) * system.torque)
    # the first stretch is predicted by the second; without it, by the prior alone
    assert (
        predict_stretches(wrong).shares[0].sum() > predict_stretches(wrong, ["b"]).shares[0].sum()
    )


def test_a_result_is_computed_once_per_object() -> None:
    memory, calls = HypothesisCache(), []
    first, second = np.zeros(3), np.zeros(3)
    for source in (first, second, first):
        memory.recall("sum", (source,), lambda: calls.append("sum"))
    memory.recall("other", (first,), lambda: calls.append("other"))
    assert calls == ["sum", "sum", "other"]
