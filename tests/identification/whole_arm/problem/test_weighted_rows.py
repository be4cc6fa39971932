"""Factors of weighted rows against explicit columns of the record parameters."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.identification.whole_arm.problem.weighted_rows import Evaluation, Weights

SHAPE = (400, 5)  # rows and channels
BIASED = (0, 3, 4)
MIN_CURVATURE_RATIO = 0.1


@pytest.mark.parametrize("n_initial", [0, 3])
@pytest.mark.parametrize("is_masked", [False, True])
def test_factor_eliminates_biases_and_initial_states(n_initial: int, is_masked: bool) -> None:
    rng = np.random.default_rng(n_initial)
    counted = rng.uniform(size=SHAPE) > 0.3
    counted[:, 4] = False  # a channel without information
    size = 10.0 ** rng.uniform(-3.0, 3.0, n_initial + 7)
    columns = (3.0 + rng.normal(size=(*SHAPE, n_initial + 7))) * size
    difference = 2.0 + rng.normal(size=SHAPE)
    if is_masked:
        columns, difference = columns * counted[..., None], difference * counted
    own = np.zeros(n_initial + len(BIASED))
    evaluated = Evaluation(difference, columns, own, BIASED, counted if is_masked else None)
    rows = evaluated.weigh(Weights(rng.uniform(0.5, 2.0, SHAPE[1]), np.full(SHAPE[1], 4.0)))

    square = rows.root**2
    slope = np.sum(square / (1.0 + rows.residual**2), axis=0) / square.sum(axis=0)
    root_curvature = np.sqrt(np.maximum(slope, MIN_CURVATURE_RATIO))
    scale = rows.root * root_curvature / rows.stds
    table = [
        evaluated.record_columns[..., n_initial:] * scale[..., None],
        columns * scale[..., None],
        (rows.residual * rows.root / root_curvature)[..., None],
    ]
    flat = np.concatenate(table, axis=2).reshape(difference.size, -1)
    own_columns, others = np.split(flat, [len(own)], axis=1)
    expected = others - own_columns @ np.linalg.lstsq(own_columns, others)[0]

    R = rows.factor(MIN_CURVATURE_RATIO)
    assert R.shape == (8, 8)
    norms = np.linalg.norm(others, axis=0)
    R, expected = R / norms, expected / norms
    np.testing.assert_allclose(R.T @ R, expected.T @ expected, atol=1e-13)


def test_masked_rows_of_additional_columns_have_no_weight() -> None:
    rng = np.random.default_rng(5)
    counted = rng.uniform(size=SHAPE) > 0.3
    columns, difference = rng.normal(size=(*SHAPE, 4)), rng.normal(size=SHAPE) * counted
    weights, own = Weights(np.ones(SHAPE[1]), np.full(SHAPE[1], 4.0)), np.zeros(len(BIASED))
    masked, unmasked = (
        Evaluation(difference, each, own, BIASED, counted).weigh(weights)
        for each in (columns * counted[..., None], columns)
    )
    np.testing.assert_allclose(
        unmasked.factor(MIN_CURVATURE_RATIO), masked.factor(MIN_CURVATURE_RATIO), atol=1e-12
    )
