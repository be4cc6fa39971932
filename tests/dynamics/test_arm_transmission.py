"""An arm whose motors move several joints: conversions between motors and links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import ArmDescription, Joint, Origin
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm

COUPLING = ((1.0, 0.0), (-0.8, 1.0))


def planar_chain(ratios: tuple[float, float], coupling: tuple[tuple[float, ...], ...]) -> Arm:
    """Two links in a plane as a chain with a transmission."""
    first, second = (Joint("linear", ratio) for ratio in ratios)
    joints = (first, replace(second, origin=Origin((0.35, 0.0, 0.0))))
    return Arm.of(ArmDescription("serial", joints, coupling=coupling))


def values_of() -> Values:
    """Two rods with drives and gears."""
    values: Values = {}
    for i in (1, 2):
        known = {"link_mass": 3.0, "link_first_moment_x": 0.5}
        known |= {f"link_inertia_{axis}": 0.2 for axis in ("xx", "yy", "zz")}
        known |= {f"link_first_moment_{axis}": 0.0 for axis in "yz"}
        known |= {f"link_inertia_{axis}": 0.0 for axis in ("xy", "xz", "yz")}
        known |= {"motor_inertia": 5e-5, "gear_stiffness": 8e3}
        values |= {(name, i): value for name, value in known.items()}
    return values


def test_own_ratios_and_limits_of_a_transmission() -> None:
    arm = planar_chain((0.01, -0.02), COUPLING)
    assert arm.is_coupled
    assert not planar_chain((0.01, 0.02), ((2.0, 0.0), (0.0, 1.0))).is_coupled
    np.testing.assert_allclose(arm.gear_ratios, [0.01, -0.02])
    motors = np.array([300.0, 200.0])
    links = arm.link_velocity_limits(motors)
    for signs in ((1.0, 1.0), (1.0, -1.0)):
        assert (np.abs(arm.motor_accelerations(links * signs)) <= motors * (1.0 + 1e-12)).all()
    uncoupled = planar_chain((0.01, -0.02), ((1.0, 0.0), (0.0, 1.0)))
    np.testing.assert_allclose(uncoupled.link_velocity_limits(motors), [3.0, 4.0])


def test_the_fastest_resonance_of_a_transmission() -> None:
    """Two descriptions of one arm agree, and the modes are those of motors and links."""
    values = values_of()
    same = planar_chain((0.005, 0.04), ((2.0, 0.0), (0.0, 0.5)))
    plain = planar_chain((0.01, 0.02), ((1.0, 0.0), (0.0, 1.0)))
    assert same.fastest_resonance(values) == pytest.approx(plain.fastest_resonance(values))
    arm = planar_chain((0.01, 0.02), COUPLING)
    T, k, motor = arm.transmission, np.diag([8e3, 8e3]), np.diag([5e-5, 5e-5])
    stiffness = np.block([[k, -k @ T], [-T.T @ k, T.T @ k @ T]])
    base = np.array([values[key] for key in arm.base_names])
    fastest = []
    for bend in (0.0, np.pi):
        link = arm.inertia_matrix(base, np.array([0.0, bend]))
        inertia = np.block([[link, np.zeros((2, 2))], [np.zeros((2, 2)), motor]])
        fastest.append(np.max(np.linalg.eigvals(np.linalg.solve(inertia, stiffness)).real))
    expected = np.sqrt(max(fastest)) / (2.0 * np.pi)
    assert arm.fastest_resonance(values) == pytest.approx(expected)
