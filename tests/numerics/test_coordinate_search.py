"""Search one coordinate at a time: minima, and evaluations linear in the number of coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import pytest

from strainwave.domain import FloatArray
from strainwave.numerics.search import Choice, CoordinateSearch

CANDIDATES = 56  # per joint: 14 anti-resonances and 4 shares of the motor


def chain_cost(target: FloatArray, choices: Sequence[Choice]) -> FloatArray:
    """Squared distance from a target, with neighbouring joints coupled; other ends are worse."""
    error = np.array(choices) - target
    coupling = 0.4 * np.sum(error[:, 1:] * error[:, :-1], axis=1)
    ripple = 20.0 * np.sum(1.0 - np.cos(error), axis=1)  # many minima along each coordinate
    return np.asarray(np.sum(error**2, axis=1) + coupling + ripple)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_the_minimum_takes_evaluations_linear_in_the_number_of_joints(n: int) -> None:
    target = np.random.default_rng(n).integers(0, CANDIDATES, n)
    search = CoordinateSearch(partial(chain_cost, target.astype(float)))
    counts = [CANDIDATES] * n
    best = search.minimise([(k,) * n for k in range(CANDIDATES)], counts)
    assert best == tuple(target)
    assert len(search.costs) <= 4 * n * CANDIDATES  # 56^6 is 3e10
    search.pairs(best, [range(14)] * n)
    assert len(search.costs) <= 4 * n * CANDIDATES + n * 14**2


def test_pairs_cover_the_product_of_two_joints() -> None:
    search = CoordinateSearch(partial(chain_cost, np.zeros(2)))
    (grid,) = search.pairs((1, 1), [range(3), range(4)])
    assert sorted(grid) == sorted(search.costs) == [(i, k) for i in range(3) for k in range(4)]


def test_a_choice_is_evaluated_once() -> None:
    evaluated: list[Choice] = []

    def cost_of(choices: Sequence[Choice]) -> FloatArray:
        evaluated.extend(choices)
        return chain_cost(np.array([2.0, 5.0]), choices)

    search = CoordinateSearch(cost_of)
    search.minimise([(0, 0), (0, 0), (7, 7)], [8, 8])
    assert len(evaluated) == len(set(evaluated)) == len(search.costs)
