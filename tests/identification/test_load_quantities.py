"""Quantities of a load: intervals of ratios and of bounded values, the scale of the torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import FloatArray, LoadQuantities, Payload, Quantity
from strainwave.domain.arm.consistent_links import is_consistent, standard_parameters
from strainwave.errors import NotIdentifiable
from strainwave.identification import load_quantities
from strainwave.identification.payload import LoadFit, central_parameters

INERTIA = np.array([[3e-3, 2e-4, -1e-4], [2e-4, 2.5e-3, 3e-4], [-1e-4, 3e-4, 2e-3]])
CENTRE = np.array([0.05, -0.02, 0.1])
BODY = np.array(standard_parameters(1.5, CENTRE, INERTIA))
SIZES = np.array([0.01, *(1e-3,) * 3, *(2e-4,) * 6])
N_DRAWS = 400


def fit_of(value: FloatArray, covariance: FloatArray | None = None) -> LoadFit:
    """A fit of many blocks, so that intervals are those of normal variables."""
    covariance = np.diag(SIZES**2) if covariance is None else covariance
    return LoadFit(value, covariance, np.ones(10, dtype=bool), 201, 0.0)


def known(quantity: Quantity | None) -> Quantity:
    assert quantity is not None
    return quantity


def test_the_parameters_about_the_centre_are_those_of_the_body() -> None:
    quantities = load_quantities.quantities_of(fit_of(BODY))
    assert known(quantities.mass).value == pytest.approx(1.5)
    for coordinate, true in zip(quantities.xyz, CENTRE, strict=True):
        assert known(coordinate).value == pytest.approx(true)
    for member, true in zip(
        quantities.inertia_about_centre, INERTIA[np.triu_indices(3)], strict=True
    ):
        assert known(member).value == pytest.approx(true)


def test_the_derivative_of_the_parameters_about_the_centre() -> None:
    """Against central differences, whose error is of second order."""
    for unit in np.eye(10):
        step = 1e-6
        ahead, behind = (
            central_parameters(BODY + s * unit, np.zeros(10))[0] for s in (step, -step)
        )
        _, exact = central_parameters(BODY, unit)
        np.testing.assert_allclose((ahead - behind) / (2.0 * step), exact, atol=1e-8)


@pytest.mark.parametrize("relative", [0.05, 0.25])
def test_intervals_of_the_centre_cover_it(relative: float) -> None:
    """Of a mass with a large error, too, where h/m is far from normal."""
    rng, inside = np.random.default_rng(0), []
    covariance = np.diag(np.r_[relative * 1.5, np.full(3, 0.01), np.full(6, 1e-4)] ** 2)
    for _ in range(N_DRAWS):
        fit = fit_of(rng.multivariate_normal(BODY, covariance), covariance)
        for coordinate, true in zip(load_quantities.quantities_of(fit).xyz, CENTRE, strict=True):
            if coordinate is not None:
                inside.append(coordinate.ci95[0] <= true <= coordinate.ci95[1])
    assert len(inside) > N_DRAWS
    assert 0.93 < np.mean(inside) < 0.97


def test_a_mass_near_zero_has_a_one_sided_interval() -> None:
    for value in (0.015, -0.005):
        mass = known(load_quantities.quantities_of(fit_of(np.r_[value, np.zeros(9)])).mass)
        assert mass.value == max(value, 0.0)
        assert mass.ci95[0] == 0.0
        assert mass.ci95[1] >= value + 1.95 * SIZES[0]


def test_wide_members_are_null() -> None:
    wide = replace(fit_of(BODY), covariance=np.diag((200.0 * SIZES * (np.arange(10) > 3)) ** 2))
    quantities = load_quantities.quantities_of(
        replace(wide, covariance=wide.covariance + np.diag(SIZES**2))
    )
    assert quantities.inertia_about_centre == (None,) * 6
    assert None not in quantities.xyz
    wide = fit_of(BODY, np.diag(np.r_[0.01, 0.1, 1e-3, 1e-3, np.full(6, 2e-4)] ** 2))
    assert [each is None for each in load_quantities.quantities_of(wide).xyz] == [
        True,
        False,
        False,
    ]


def test_nothing_determined_is_refused() -> None:
    with pytest.raises(NotIdentifiable, match="turn the last link about several axes"):
        load_quantities.quantities_of(replace(fit_of(BODY), is_determined=np.zeros(10, dtype=bool)))


@pytest.mark.parametrize("missing", [(), (4, 5, 6, 7, 8, 9), (3, 4, 5, 6, 7, 8)])
def test_the_body_for_controllers_is_consistent(missing: tuple[int, ...]) -> None:
    """It has the estimates that exist, and lists the others."""
    is_determined = np.ones(10, dtype=bool)
    is_determined[list(missing)] = False
    impossible = BODY - np.r_[np.zeros(4), 0.02, 0.0, 0.02, 0.0, 0.0, 0.02]
    covariance = np.diag((np.r_[SIZES[:4], np.full(6, 0.02)]) ** 2)
    fit = replace(fit_of(impossible, covariance), is_determined=is_determined)
    quantities = load_quantities.quantities_of(fit)
    body, assumed = load_quantities.body_of(fit, quantities)
    assert is_consistent(body)
    assert body[0] == known(quantities.mass).value
    members = (*quantities.xyz, *quantities.inertia_about_centre)
    assert len(assumed) == sum(each is None for each in members)
    for k, coordinate in enumerate(quantities.xyz, start=1):
        if coordinate is not None:
            assert body[k] / body[0] == pytest.approx(coordinate.value)


def test_impossible_inertias_leave_mass_and_centre_to_the_controller() -> None:
    """Inertias about the centre of -1 kg m^2 with small errors belong to no body."""
    fit = fit_of(BODY - np.r_[np.zeros(4), 1.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    quantities = load_quantities.quantities_of(fit)
    body, _ = load_quantities.body_of(fit, quantities)
    assert is_consistent(body)
    assert body[0] == pytest.approx(1.5)
    np.testing.assert_allclose(body[1:4], 1.5 * CENTRE)
    warnings = load_quantities.warnings_of(fit, quantities, scale_is_known=True)
    assert "load-impossible" in {each.code for each in warnings}


def test_one_factor_turns_the_estimated_load_into_the_stated_one() -> None:
    stated = Payload(1.5, tuple(CENTRE.tolist()))
    check = load_quantities.compare_with_stated(fit_of(BODY / 1.07), stated)
    scale = known(check.scale)
    assert scale.value == pytest.approx(1.07)
    assert scale.ci95[0] < 1.07 < scale.ci95[1]
    assert check.is_explained
    elsewhere = Payload(1.5, (0.05, -0.02, 0.2))
    check = load_quantities.compare_with_stated(fit_of(BODY / 1.07), elsewhere)
    assert not check.is_explained
    assert known(check.scale).value == pytest.approx(1.07)  # of the mass
    unseen = fit_of(np.zeros(10), np.eye(10))
    assert load_quantities.compare_with_stated(unseen, stated).scale is None


def test_errors_of_identified_torque_constants_scale_the_load() -> None:
    fit = load_quantities.with_gain_errors(fit_of(BODY), 0.1)
    mass = known(load_quantities.quantities_of(fit).mass)
    assert mass.std == pytest.approx(np.hypot(0.15, SIZES[0]))
    # the centre is a ratio: the common factor cancels
    assert known(load_quantities.quantities_of(fit).xyz[0]).std == pytest.approx(
        known(load_quantities.quantities_of(fit_of(BODY)).xyz[0]).std
    )


@pytest.mark.parametrize("scale_is_known", [False, True])
def test_the_scale_is_in_doubt_unless_a_known_load_gives_it(scale_is_known: bool) -> None:
    fit = fit_of(BODY)
    quantities: LoadQuantities = load_quantities.quantities_of(fit)
    warnings = load_quantities.warnings_of(fit, quantities, scale_is_known=scale_is_known)
    assert ("torque-scale" in {each.code for each in warnings}) is not scale_is_known
