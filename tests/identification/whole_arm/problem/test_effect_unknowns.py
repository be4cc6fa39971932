"""Effects of real gears as unknowns: estimated where present, removed where absent.

The simulated arm has the same equations as the fitted one. The tests check the parameter space and
the results, not whether real gears obey these laws.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from effect_runs import ALL, EVERY, OF_THE_CORE, SIZES, records, rig, single_tuned, whole_arm
from strainwave.domain import ArmModel
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.arm.parameter_table import COULOMB
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.closed_loop import keep_known_effects, restrict_to_values
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    add_effects,
    insignificant_effects,
    named_effects,
    remove_effects,
    set_record_effects,
)
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace, Prior
from strainwave.identification.whole_arm.problem.starting_values import Loads
from strainwave.identification.whole_arm.records.preparation import dataset_of
from tuning_runs import linear_search, truth

LOADS = Loads(torque=(30.0, 8.0), voltage=(10.0, 10.0))


def reported_out(model: ArmModel) -> list[str]:
    return [c.message.split()[0] for c in model.warnings if c.code == "effect-left-out"]


def test_effects_that_are_there_come_back() -> None:
    model = whole_arm(ALL, ALL)
    assert model.status == "converged"
    assert reported_out(model) == []
    reported = {(p.name, p.joint): p for p in model.parameters}
    for key, true in SIZES.items():
        parameter = reported[key]
        assert parameter.value is not None
        assert parameter.std is not None
        assert parameter.value == pytest.approx(true, rel=0.05), key
        assert abs(parameter.value - true) < 4.0 * parameter.std, key
    for name in ("motor_inertia", "motor_coulomb_friction", "gear_stiffness"):
        true_value = truth()[1][name, 1]
        assert model.values[name, 1] == pytest.approx(true_value, rel=0.005), name


def test_without_them_other_parameters_take_their_place() -> None:
    model = whole_arm(ALL, ())
    known_values = truth()[1]
    errors = [model.values[name, 1] / known_values[name, 1] - 1.0 for name in ("gear_stiffness",)]
    assert np.abs(errors).max() > 0.02
    with_them = whole_arm(ALL, ALL)
    for name, fits in with_them.fit_percent.items():
        assert all(fits[channel] > model.fit_percent[name][channel] for channel in fits)


def test_an_arm_without_effects_gets_none() -> None:
    model, reference = whole_arm((), ALL), whole_arm((), ())
    assert reported_out(model) == list(ALL)
    assert not any(key in model.values for key in SIZES)
    assert model.values == reference.values
    assert model.iterations > reference.iterations  # the effects were fitted first


def test_a_truncated_search_for_effects_has_the_status_iteration_limit() -> None:
    model = whole_arm(ALL, ALL, most=8)
    assert model.status == "iteration-limit"
    assert 8 < model.iterations <= 2 * 8


def test_only_the_true_effects_remain() -> None:
    model = whole_arm(("hysteresis",), ALL)
    assert reported_out(model) == ["stribeck", "kinematic-error"]
    for name in effect_named("hysteresis").names:
        assert model.values[name, 1] == pytest.approx(SIZES[name, 1], rel=0.05)
    assert ("stribeck_friction", 1) not in model.values


def test_the_unknowns_of_effects_start_small() -> None:
    study = rig(ALL)
    base = linear_search(2, Prior(np.ones((1, 2)), np.ones(1), np.eye(1)))
    values: Values = {("p0", None): 1.0, ("p1", None): 2.0, (COULOMB, 1): 0.05, (STIFFNESS, 1): 2e4}
    space, z = add_effects(base, named_effects(Arm.of(study.arm)), Arm.of(study.arm), values, LOADS)
    assert space.keys[2:] == list(SIZES)
    np.testing.assert_allclose(
        space.parameters(z), [1.0, 2.0, 0.01, 3.0, 0.6, 1.5e-4, 0.0, 0.0, 2.0]
    )
    np.testing.assert_array_equal(space.prior.rows, [[1.0, 1.0, *np.zeros(7)]])
    units = ["N m", "rad/s", "N m", "rad", "rad", "rad", "1"]
    assert [parameter.unit for parameter in space.unknowns[2:]] == units
    assert named_effects(Arm.of(study.arm)) == [(1, effect) for effect in ALL]
    reduced = remove_effects(space, {(1, "stribeck"), (1, "kinematic-error")}, Arm.of(study.arm))
    assert reduced.keys == [*base.keys, ("hysteresis_torque", 1), ("hysteresis_twist", 1)]
    assert reduced.prior.rows.shape == (1, 4)


def test_slow_motion_shows_a_link_with_its_flexible_part() -> None:
    arm = Arm.of(rig(("flexible-link",)).arm)
    base = linear_search(2, Prior(np.array([[3.0, 5.0]]), np.ones(1), np.eye(1)))
    alpha = replace(base.unknowns[0], name="alpha")
    base = replace(base, unknowns=(alpha, base.unknowns[1]))
    values: Values = {("alpha", None): 1.0, ("p1", None): 2.0, (COULOMB, 1): 0.05}
    values[STIFFNESS, 1] = 2e4
    space, _ = add_effects(base, named_effects(arm), arm, values, LOADS)
    by_key = dict(zip(space.keys, space.prior.rows[0].tolist(), strict=True))
    assert by_key["flexible_inertia", 1] == by_key["alpha", None] == 3.0
    assert by_key["flexible_frequency", 1] == 0.0


def test_an_effect_within_three_standard_deviations_of_zero_is_insignificant() -> None:
    empty = ParameterSpace((), {}, Prior.empty(0))
    arm = Arm.of(rig(ALL).arm)
    values_of_joint: Values = {(COULOMB, 1): 0.05, (STIFFNESS, 1): 2e4}
    space, z = add_effects(empty, named_effects(arm), arm, values_of_joint, LOADS)
    z[-3:-1] = 2.0  # both coefficients of the kinematic error are 2e-4 rad
    values = space.parameters(z)
    small_covariance = np.diag((values / 5.0) ** 2)
    assert list(insignificant_effects(space, z, small_covariance)) == []
    large_covariance = small_covariance.copy()
    large_covariance[2, 2] *= 4.0  # the hysteresis torque is now 2.5 standard deviations
    # The Stribeck velocity does not decide whether the friction is present.
    large_covariance[1, 1] *= 100.0
    assert list(insignificant_effects(space, z, large_covariance)) == [(1, "hysteresis")]
    # one insignificant coefficient does not matter if the other is significant
    large_covariance[4, 4] *= 100.0
    assert list(insignificant_effects(space, z, large_covariance)) == [(1, "hysteresis")]
    large_covariance[5, 5] *= 100.0
    assert list(insignificant_effects(space, z, large_covariance)) == [
        (1, "hysteresis"),
        (1, "kinematic-error"),
    ]


def test_an_arm_is_known_as_far_as_its_values_go() -> None:
    arm, some_arm = Arm.of(rig(ALL).arm), Arm.of(rig(("hysteresis", "kinematic-error")).arm)
    assert keep_known_effects(arm, SIZES) == arm
    assert keep_known_effects(arm, ()) == Arm.of(rig(()).arm)
    some = [key for key in SIZES if key != ("stribeck_velocity", 1)]
    assert keep_known_effects(arm, some) == some_arm
    values = {key: SIZES[key] for key in some}
    assert restrict_to_values(arm, values) == some_arm


def test_records_are_run_with_the_effects_that_are_known() -> None:
    study, _, logs = records(ALL)
    without_effects = keep_known_effects(Arm.of(study.arm), ())
    record = dataset_of(logs[0], without_effects, 100.0)
    assert set_record_effects([record], Arm.of(study.arm), ())[0] == record
    (record_with_effects,) = set_record_effects([record], Arm.of(study.arm), SIZES)
    assert [joint.effects for joint in record_with_effects.arm.joints] == [ALL, ()]
    assert record_with_effects.arm.joints[0].encoder_counts is None


@pytest.mark.parametrize("name", OF_THE_CORE)
def test_a_named_effect_is_recovered_and_removes_the_bias_of_the_others(name: str) -> None:
    model = whole_arm((name,), (name,))
    assert model.status == "converged"
    reported = {(p.name, p.joint): p for p in model.parameters}
    for size in effect_named(name).names:
        parameter = reported[size, 1]
        assert parameter.value is not None
        assert parameter.std is not None
        assert abs(parameter.value - EVERY[size, 1]) < 4.0 * parameter.std, size
        assert parameter.value == pytest.approx(EVERY[size, 1], rel=0.1), size
    for parameter_name in ("motor_inertia", "motor_coulomb_friction", STIFFNESS, "gear_damping"):
        assert model.values[parameter_name, 1] == pytest.approx(
            truth()[1][parameter_name, 1], rel=0.005
        ), parameter_name


def test_a_gain_of_a_single_joint_is_neither_evident_nor_fitted() -> None:
    model = single_tuned(("drive-gain",), ())
    assert model.criticism is not None
    assert "drive-gain" not in {cause.effect for cause in model.criticism.causes}
    assert reported_out(single_tuned(("drive-gain",), ("drive-gain",))) == ["drive-gain"]


def test_a_tilt_of_an_upright_joint_is_one_with_its_gravity() -> None:
    model = single_tuned(("tilt",), ("tilt",), effort=0.0)
    torque = model.values["gravity_torque_1", None] + model.values.get(("tilt_cos", 1), 0.0)
    # 0.5 s of motion within 0.2 rad determines the torque to 7 % or worse
    assert torque == pytest.approx(15.0 + EVERY["tilt_cos", 1], rel=0.1)
    (gravity,) = (p for p in model.parameters if p.name == "gravity_torque_1")
    assert gravity.std is not None
    assert abs(torque - 15.0 - EVERY["tilt_cos", 1]) < 2.0 * gravity.std
