"""Standard parameters of results agree with the base parameters and belong to bodies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import exports
from serial_chains import parameters_of, random_body
from strainwave.domain import FloatArray, RigidModel
from strainwave.domain.arm.base_parameters import BaseParameters, base_parameters
from strainwave.domain.arm.consistent_links import consistent_links, is_consistent, priors_of
from strainwave.domain.arm.description import ArmDescription, LinkPrior, Urdf
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import NumericalFailure
from strainwave.io import base_parameters as module
from strainwave.io.base_parameters import standard_name, standard_of_torques

ARM = exports.chain(Path("nowhere"), ("rigid",) * 3)[0].arm
MOTORS: list[Key] = [("motor_inertia", number) for number in (1, 2, 3)]


def vector(base: BaseParameters, values: Values) -> np.ndarray:
    return np.array([values[key] for key in (*base.links, *MOTORS)])


def near_prior(
    arm: ArmDescription, values: Values, *, with_motors: bool
) -> tuple[np.ndarray, np.ndarray, Values]:
    """Weights of base parameters in whitened torques, their exact values, and links with them."""
    base, dynamics = base_parameters(arm), Arm.of(arm)
    exact = base.rows @ vector(base, values)
    random = np.random.default_rng(1)
    links = random.normal(size=(3, 200, 3)) * [[[1.5]], [[1.0]], [[5.0]]]
    motion = np.stack([dynamics.motor_accelerations(part) for part in links])
    model = RigidModel(
        parameters=(),
        solution=np.concatenate([exact, np.zeros(9)]),
        covariance=np.zeros((0, 0)),
        condition_number=1.0,
        fit_percent={},
        bandwidth_hz=10.0,
        decimation=1,
        n_rows=200,
        status="determined",
        motion=motion,
    )
    motors = [values[motor] if with_motors else None for motor in MOTORS]
    found = standard_of_torques(arm, model, motors)
    assert found is not None
    regressor = dynamics.rigid_regressor(*links)
    scale = 0.03 * np.std(regressor @ exact, axis=0)
    return (regressor / scale[:, None]).reshape(600, -1), exact, found


def drawn_values(seed: int) -> Values:
    random = np.random.default_rng(seed)
    values: Values = {motor: float(random.uniform(1e-5, 5e-4)) for motor in MOTORS}
    for number in (1, 2, 3):
        body = zip(LINK_PARAMETERS, parameters_of(random_body(random)), strict=True)
        values |= {(f"link_{name}", number): float(value) for name, value in body}
    return values


def links_of(values: Values) -> list[tuple[float, ...]]:
    return [
        tuple(values[f"link_{name}", number] for name in LINK_PARAMETERS) for number in (1, 2, 3)
    ]


def divergence(arm: ArmDescription, values: Values) -> float:
    """Entropic divergence of links from those of the URDF (Lee, Wensing and Park, 2020)."""
    assert arm.urdf is not None
    total = 0.0
    for link, prior in zip(links_of(values), arm.urdf.priors, strict=True):
        assert prior is not None
        ratio = np.linalg.solve(pseudo_inertia(prior), pseudo_inertia(link))
        total += float(np.trace(ratio) - np.linalg.slogdet(ratio)[1] - 4.0)
    return total


def pseudo_inertia(link: tuple[float, ...]) -> np.ndarray:
    """[trace(I)/2 E - I, h; h', m] with the inertia I, the first moments h and the mass m."""
    mass, first, (xx, xy, yy, xz, yz, zz) = link[0], np.array(link[1:4]), link[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    upper = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return np.block([[upper, first[:, None]], [first, mass]])


@settings(max_examples=10)
@given(seed=st.integers(0, 2**31), with_motors=st.booleans())
def test_they_agree_with_the_base_parameters(seed: int, with_motors: bool) -> None:
    """Motors without estimate have the inertia that remains: it is not negative."""
    values = drawn_values(seed)
    arm = replace(ARM, urdf=Urdf("arm.urdf", tuple(links_of(drawn_values(seed + 1)))))
    weights, exact, found = near_prior(arm, values, with_motors=with_motors)
    assert all(is_consistent(link) for link in links_of(found))
    assert all(found[motor] >= 0.0 for motor in MOTORS)
    # the true links are consistent and have no residual: the minimum costs no more than they do
    base = base_parameters(arm)
    residual = weights @ (base.rows @ vector(base, found) - exact)
    cost = 0.5 * residual @ residual
    if all(found[motor] > 0.0 for motor in MOTORS):
        cost += divergence(arm, found)
    assert cost <= divergence(arm, values) * (1.0 + 1e-6)


def test_a_correct_prior_leaves_the_inertia_of_the_motors() -> None:
    values = drawn_values(3)
    arm = replace(ARM, urdf=Urdf("arm.urdf", tuple(links_of(values))))
    *_, found = near_prior(arm, values, with_motors=False)
    for key, value in values.items():
        assert found[key] == pytest.approx(value, rel=1e-3, abs=1e-5), standard_name(key)


def test_a_prior_that_is_too_heavy_leaves_no_motor() -> None:
    values = drawn_values(3)
    heavy = [tuple(20.0 * value for value in link) for link in links_of(values)]
    arm = replace(ARM, urdf=Urdf("arm.urdf", tuple(heavy)))
    weights, exact, found = near_prior(arm, values, with_motors=False)
    assert found["motor_inertia", 1] == 0.0
    assert is_consistent(links_of(found)[0])
    base = base_parameters(arm)
    residual = weights @ (base.rows @ vector(base, found) - exact)
    assert np.sqrt(np.mean(residual**2)) < 0.05 / 0.03  # 5 % of the torques


def torque_over_motion() -> tuple[FloatArray, FloatArray, FloatArray]:
    """A random motion, the torque of drawn bodies with friction [N m], and velocity columns."""
    links = np.random.default_rng(4).normal(size=(3, 120, 3)) * [[[1.5]], [[1.0]], [[5.0]]]
    motion = np.stack([Arm.of(ARM).motor_accelerations(part) for part in links])
    values = drawn_values(3)
    inertias = [values[motor] for motor in MOTORS]
    bodies = np.concatenate([*links_of(values), inertias])
    columns = motion[1][:, :, None] * np.eye(ARM.n_joints)
    return motion, module.motor_regressor(ARM, motion) @ bodies, columns


def test_torques_that_friction_explains_do_not_count() -> None:
    """No bodies have a damping torque: with columns of friction the rest is exact."""
    motion, torque, columns = torque_over_motion()
    friction = 0.2 * np.std(torque, axis=0) / np.std(motion[1], axis=0) * motion[1]
    damped = torque + friction
    size = np.std(damped, axis=0)
    motors = [None] * ARM.n_joints
    found = module.links_of_torques(ARM, motion, damped, 1e-4 * size, columns, motors)
    assert found is not None
    rest = damped - module.motor_regressor(ARM, motion) @ found
    np.testing.assert_allclose(rest / size, friction / size, atol=5e-3)


@pytest.mark.parametrize("n_failures", [0, 1, 3, 4])
def test_torques_weigh_less_until_the_search_for_links_converges(
    monkeypatch: pytest.MonkeyPatch, n_failures: int
) -> None:
    """Apart from friction at weights of 10, 1, 0.1 and 0.01; then no bodies."""
    motion, torque, columns = torque_over_motion()
    sizes, search = list[float](), consistent_links

    def failing(priors: list[LinkPrior], rows: FloatArray, target: FloatArray) -> FloatArray:
        sizes.append(float(np.linalg.norm(rows)))
        if len(sizes) <= n_failures:
            raise NumericalFailure("along the border")
        return search(priors, rows, target)

    monkeypatch.setattr(module, "consistent_links", failing)
    errors, known = 0.01 * np.std(torque, axis=0), [drawn_values(3)[motor] for motor in MOTORS]
    found = module.links_of_torques(ARM, motion, torque, errors, columns, known)
    assert (found is None) == (n_failures == 4)
    ratios = np.array(sizes[: n_failures + 1]) / sizes[0]
    np.testing.assert_allclose(ratios, [1.0, 0.1, 0.01, 1e-3][: len(ratios)])


def test_bodies_whose_torques_are_uncertain_are_nearer_to_the_prior() -> None:
    """No bodies have the torques of a negative rotor; those within the errors are no extremes."""
    motion, torque, _ = torque_over_motion()
    torque = torque - 0.3 * np.std(torque, axis=0) / np.std(motion[2], axis=0) * motion[2]
    no_friction = np.zeros((*torque.shape, 0))
    furthest = []
    for share in (1e-4, 0.1):
        errors = share * np.std(torque, axis=0)
        found = module.links_of_torques(ARM, motion, torque, errors, no_friction, [0.0] * 3)
        assert found is not None
        links = found[:30].reshape(3, 10).tolist()
        assert all(is_consistent(tuple(link)) for link in links)
        pairs = zip(priors_of(ARM), links, strict=True)
        furthest.append(max(abs(np.log(link[0] / prior[0])) for prior, link in pairs))
    assert furthest[1] < 0.5 * furthest[0]
