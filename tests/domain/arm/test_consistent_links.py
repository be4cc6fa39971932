"""Consistent links: bodies near a prior that have given base parameters."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.domain import ArmDescription, Joint, Origin
from strainwave.domain.arm.base_parameters import base_parameters
from strainwave.domain.arm.consistent_links import consistent_links, is_consistent, priors_of

_ORIGINS = (
    Origin((0.0, 0.0, 0.3)),
    Origin((0.06, 0.02, 0.14), (-np.pi / 2, 0.0, 0.0)),
    Origin((0.4, 0.0, -0.05), (0.0, 0.0, 0.1)),
)
_ARM = ArmDescription(
    "serial",
    tuple(Joint("linear", 0.01, origin=origin) for origin in _ORIGINS),
    (0.0, 0.0, -9.81),
)


def _bodies(seed: int) -> np.ndarray:
    """Standard parameters of three bodies of random points."""
    random, links = np.random.default_rng(seed), []
    for _ in range(3):
        points = random.normal(scale=0.2, size=(8, 3)) + random.normal(scale=0.2, size=3)
        masses = random.uniform(0.1, 1.0, size=8)
        inertia = sum(
            m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True)
        )
        upper = inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        links.append([masses.sum(), *(masses @ points), *upper])
    return np.array(links).ravel()


@given(seed=st.integers(0, 2**31))
def test_base_parameters_of_any_bodies_are_kept(seed: int) -> None:
    truth, base = _bodies(seed), base_parameters(_ARM)
    rows = base.rows[:, :30]
    rows = rows[rows.any(axis=1)]  # not the motors
    std = 1e-5 * np.abs(rows) @ np.abs(truth)
    found = consistent_links(priors_of(_ARM), rows / std[:, None], rows @ truth / std)
    # the divergence pulls by a few standard deviations at most
    np.testing.assert_array_less(np.abs(rows @ (found - truth)) / std, 1.0)
    assert all(is_consistent(tuple(link)) for link in found.reshape(3, 10))


def test_the_prior_is_kept_without_data() -> None:
    priors = priors_of(_ARM)
    found = consistent_links(priors, np.zeros((1, 30)), np.zeros(1))
    np.testing.assert_allclose(found, np.ravel(priors), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("inertia", [0.0, -0.01])
def test_a_point_or_a_negative_inertia_is_no_body(inertia: float) -> None:
    assert not is_consistent((1.0, 0.0, 0.0, 0.0, inertia, 0.0, inertia, 0.0, 0.0, inertia))
