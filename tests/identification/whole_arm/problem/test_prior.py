"""Reference sizes of the rigid step's values."""

from __future__ import annotations

from strainwave.domain.keys import Values
from strainwave.identification.whole_arm.problem.parameter_space import reference_sizes


def test_inertial_values_of_either_sign_have_the_size_of_the_largest_of_their_kind() -> None:
    values: Values = {
        ("grouped_link_inertia_zz", 1): 6.0,
        ("link_inertia_xy", 2): -1e-9,
        ("link_first_moment_x", 2): 0.0,
        ("grouped_link_first_moment_z", 2): -5.0,
        ("motor_inertia", 2): 3e-4,
        ("motor_coulomb_friction", 2): 0.1,
        ("friction_offset", 2): 1e-6,
    }
    assert reference_sizes(values) == {
        ("grouped_link_inertia_zz", 1): 6.0,
        ("link_inertia_xy", 2): 6.0,
        ("link_first_moment_x", 2): 5.0,
        ("grouped_link_first_moment_z", 2): 5.0,
        ("motor_inertia", 2): 3e-4,
        ("motor_coulomb_friction", 2): 0.1,
        ("friction_offset", 2): 0.1,
    }


def test_values_of_planar_arms_have_their_own_sizes() -> None:
    planar: Values = {("alpha", None): 1.5, ("beta", None): 0.6, ("gamma", None): -0.7}
    gravity: Values = {("gravity_torque_1", None): -40.0, ("gravity_torque_2", None): 12.0}
    expected = {key: abs(value) for key, value in (planar | gravity).items()}
    assert reference_sizes(planar | gravity) == expected
