"""Unknowns of the whole-arm fit: coordinates, starting values, and the prior of the rigid step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import FloatArray, Joint, JointModel, RigidModel, Study
from strainwave.domain.arm.gear_laws import KNEES, SLOPES
from strainwave.domain.arm.kinds import change_arm_keys, single_joint
from strainwave.domain.arm.parameter_table import COULOMB, SETTLING, VISCOUS
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace
from strainwave.identification.whole_arm.problem.starting_values import (
    add_settling_unknowns,
    add_stiffness_curves,
    space_of,
    starting_values_of,
    warn_rejected_starts,
)
from strainwave.virtual import scara
from strainwave.virtual.experiments import derived
from tuning_runs import joint_model, joint_models, rigid_model, truth
from virtual_arms import values_of

NONE_OFF = np.zeros((2, 6))
LARGEST_TORQUE = (60.0, 15.0)
FLOOR = 0.002


def mixed_study() -> Study:
    """Arm under gravity with a three-slope gear and a linear gear."""
    study = scara.STIFF.study(Path("nowhere"), "three-slope")
    joints = (study.arm.joints[0], replace(study.arm.joints[1], spring="linear"))
    return replace(study, arm=change_arm_keys(study.arm.with_joints(joints), gravity=9.81))


def mixed_values(study: Study) -> Values:
    values = values_of(study, 7)
    for name in (*SLOPES, *KNEES):
        del values[name, 2]
    values["gear_stiffness", 2] = 6100.0
    return derived(values, study.arm)


def started(study: Study, known: Values, model: RigidModel | None) -> ParameterSpace:
    joints = joint_models(study, known, 0.05, NONE_OFF)
    return space_of(model, joints, Arm.of(study.arm), largest_voltage=[10.0, 10.0], floor=FLOOR)


def mixed(share: float = 0.01) -> tuple[Study, Values, ParameterSpace]:
    study = mixed_study()
    true_values = mixed_values(study)
    space = started(study, true_values, rigid_model(study, true_values, share))
    return (
        study,
        true_values,
        add_settling_unknowns(add_stiffness_curves(space, Arm.of(study.arm), LARGEST_TORQUE)),
    )


def somewhere(space: ParameterSpace, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.asarray(space.upper * rng.uniform(-1.0, 1.0, len(space.unknowns)))


@pytest.mark.parametrize("seed", range(4))
def test_slope_is_that_of_the_parameters(seed: int) -> None:
    _, _, space = mixed()
    z = somewhere(space, seed)
    h = 1e-5
    differences = [
        (space.parameters(z + step) - space.parameters(z - step)) / (2.0 * h)
        for step in h * np.eye(len(z))
    ]
    # the relative error of a central difference of an exponential is h^2 / 6
    np.testing.assert_allclose(space.slope(z), np.column_stack(differences), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_coordinates_undo_parameters(seed: int) -> None:
    _, _, space = mixed()
    z = somewhere(space, seed)
    np.testing.assert_allclose(space.coordinates(space.values(z)), z, atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_steps_are_straight_in_the_values(seed: int) -> None:
    """A step is straight in the parameter values, not in their logarithms."""
    _, _, space = mixed()
    z = 0.5 * somewhere(space, seed)
    rng = np.random.default_rng(seed)
    step = space.limit_step(z, rng.uniform(-0.5, 1.0, len(z)), 1.0)
    path = [space.parameters(space.move(z, t * step)) for t in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(path[1], 0.5 * (path[0] + path[2]), rtol=1e-12, atol=1e-15)
    # the direction at the start is that of the coordinates
    nearby = space.move(z, 1e-7 * step)
    np.testing.assert_allclose(nearby, z + 1e-7 * step, atol=1e-13)


@pytest.mark.parametrize("seed", range(4))
def test_trusted_steps_stay_in_reach(seed: int) -> None:
    _, _, space = mixed()
    z = somewhere(space, seed)
    large_step = np.random.default_rng(seed).uniform(-50.0, 50.0, len(z))
    step = space.limit_step(z, large_step, 1.0)
    values, after = space.parameters(z), space.parameters(space.move(z, step))
    assert np.all(np.abs(space.move(z, step)) <= space.upper)
    assert np.all(np.sign(step) * np.sign(large_step) >= 0.0)
    positive = [k for k, u in enumerate(space.unknowns) if not u.signed and u.name != KNEES[1]]
    assert np.all(after[positive] < 2.6 * values[positive])
    # limiting is idempotent
    np.testing.assert_array_equal(space.limit_step(z, step, 1.0), step)


def test_coordinates_stay_in_reach() -> None:
    _, _, space = mixed()
    outside = space.values(1.5 * space.upper)
    np.testing.assert_allclose(space.coordinates(outside), space.upper)
    # values that a positive parameter cannot have give the lower bound
    negative = dict.fromkeys(space.keys, -1.0)
    z = space.coordinates(negative)
    positive = [k for k, parameter in enumerate(space.unknowns) if not parameter.signed]
    np.testing.assert_array_equal(z[positive], -space.upper[positive])


def test_a_recentred_range_keeps_the_values() -> None:
    _, _, space = mixed()
    z = somewhere(space, 3)
    chosen = [k for k, unknown in enumerate(space.unknowns) if unknown.name in VISCOUS]
    recentred = space.recentre(z, chosen)
    values = space.values(z)
    at = recentred.coordinates(values)
    assert at[chosen] == pytest.approx(0.0, abs=1e-12)
    assert recentred.parameters(at) == pytest.approx(space.parameters(z), rel=1e-12)


def test_reach_is_a_factor() -> None:
    _, _, space = mixed()
    start = space.values(np.zeros(len(space.unknowns)))
    upper_values = space.values(space.upper)
    for name, factor in [("beta", 3.0), ("gamma", 3.0)]:
        assert upper_values[name, None] == pytest.approx(factor * start[name, None])
    for name, factor in [("motor_inertia", 3.0), ("gear_damping", 30.0), (VISCOUS[0], 30.0)]:
        assert upper_values[name, 1] == pytest.approx(factor * start[name, 1])


def test_signed_parameters_pass_zero() -> None:
    _, _, space = mixed()
    lowest, highest = space.values(-space.upper), space.values(space.upper)
    for key in [("friction_offset", 1), ("gravity_torque_1", None), ("gamma", None)]:
        assert lowest[key] < 0.0 < highest[key]
    positive = {u.key for u in space.unknowns if not u.signed}
    assert {("gear_stiffness", 2), ("motor_coulomb_friction", 1), ("alpha", None)} <= positive
    assert min(lowest[key] for key in positive) > 0.0


def test_a_first_moment_may_be_negative() -> None:
    """gamma is negative if the centre of link 2 lies behind its axis."""
    study, values, _ = mixed()
    values["gamma", None] = -0.5 * values["gamma", None]
    known = derived({k: v for k, v in values.items() if k[0] != "link_inertia"}, study.arm)
    space = started(study, known, rigid_model(study, known, 0.01))
    start = space.start_values
    assert start["gamma", None] == pytest.approx(known["gamma", None])
    np.testing.assert_allclose(space.coordinates(start), 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_second_knee_lies_above_the_first(seed: int) -> None:
    _, _, space = mixed()
    values = space.values(somewhere(space, seed))
    assert 0.0 < values[KNEES[0], 1] < values[KNEES[1], 1]
    assert (KNEES[0], 2) not in values


def test_the_fit_starts_from_the_estimates_of_the_earlier_stages() -> None:
    _, true_values, space = mixed()
    start = space.values(np.zeros(len(space.unknowns)))
    # inertias, friction, damping and gravity are exactly those of the models
    for key in start:
        if key[0] not in (*SLOPES, *KNEES, SETTLING):
            assert start[key] == pytest.approx(true_values[key], rel=1e-12, abs=1e-15), key
    mean_slope = 0.5 * (true_values[SLOPES[0], 1] + true_values[SLOPES[1], 1])
    slopes = [start[name, 1] for name in SLOPES]
    np.testing.assert_allclose(slopes, mean_slope * np.array([0.8, 1.0, 1.15]))
    knees = [start[name, 1] for name in KNEES]
    np.testing.assert_allclose(knees, LARGEST_TORQUE[0] * np.array([0.2, 0.6]))
    assert ("gear_stiffness", 1) not in start
    assert {u.joint for u in space.unknowns if u.name == SETTLING} == {1, 2}
    units = {u.key: u.unit for u in space.unknowns}
    assert units[KNEES[1], 1] == "N m"
    assert units[SLOPES[0], 1] == "N m/rad"
    assert units["alpha", None] == "kg m^2"
    assert units["gravity_torque_2", None] == "N m"
    assert units[SETTLING, 1] == "s"
    assert set(start) == set(space.keys)


def test_the_rigid_friction_is_preferred() -> None:
    study, true_values = truth()
    joints = joint_models(study, true_values, 0.05, NONE_OFF)
    wrong_joints = [
        replace(joint, values={**joint.values, "motor_coulomb_friction": 0.5}) for joint in joints
    ]
    model = rigid_model(study, true_values, 0.01)
    space = space_of(
        model, wrong_joints, Arm.of(study.arm), largest_voltage=[10.0, 10.0], floor=FLOOR
    )
    start = space.values(np.zeros(len(space.unknowns)))
    assert start["motor_coulomb_friction", 1] == pytest.approx(0.06)


def test_the_start_of_friction_is_positive() -> None:
    study, true_values = truth()
    model = rigid_model(study, true_values, 0.01)
    parameters = [
        replace(p, value=0.0) if p.name == "motor_coulomb_friction" else p for p in model.parameters
    ]
    space = started(study, true_values, replace(model, parameters=tuple(parameters)))
    start = space.values(np.zeros(len(space.unknowns)))
    # 1 % of the torque at 10 V
    assert start["motor_coulomb_friction", 1] == pytest.approx(0.01 * 10.0 * 0.08)


@pytest.mark.parametrize(("motor", "link"), [(-1e-4, 3.0), (2.6e-4, -0.1), (3e-4, 0.0), (0.0, 2.5)])
def test_a_viscous_friction_that_is_not_positive_is_mended(motor: float, link: float) -> None:
    study, true_values = truth()
    wrong_values = {**true_values, (VISCOUS[0], 1): motor, (VISCOUS[1], 1): link}
    space = started(study, wrong_values, rigid_model(study, true_values, 0.01))
    start = space.values(np.zeros(len(space.unknowns)))
    total = motor + 1e-4 * link
    parts = (start[VISCOUS[0], 1], 1e-4 * start[VISCOUS[1], 1])
    assert min(parts) >= 0.05 * total * (1.0 - 1e-12)
    assert sum(parts) == pytest.approx(total)


def test_holding_takes_unknowns_away() -> None:
    _, _, space = mixed()
    z = somewhere(space, 11)
    values = space.values(z)
    # the prior of the rigid step contains some of them
    keys = [("beta", None), ("motor_coulomb_friction", 2), (SETTLING, 1), (VISCOUS[1], 1)]
    reduced = space.fix_values({key: values[key] for key in keys})
    assert reduced.keys == [key for key in space.keys if key not in keys]
    coordinates = reduced.coordinates(values)
    assert reduced.values(coordinates) == pytest.approx(values, rel=1e-9)
    before = space.prior.rows @ space.parameters(z) - space.prior.target
    after = reduced.prior.rows @ reduced.parameters(coordinates) - reduced.prior.target
    np.testing.assert_allclose(after, before, atol=1e-8 * np.max(np.abs(before)))
    twice = reduced.fix_values({("gamma", None): 0.5})
    assert twice.values(np.zeros(len(twice.unknowns)))["gamma", None] == 0.5
    assert twice.values(np.zeros(len(twice.unknowns)))["beta", None] == values["beta", None]


@pytest.mark.parametrize("knee", KNEES)
def test_one_knee_can_be_held(knee: str) -> None:
    _, _, space = mixed()
    values = space.values(somewhere(space, 3))
    reduced = space.fix_values({(knee, 1): values[knee, 1]})
    assert reduced.values(reduced.coordinates(values)) == pytest.approx(values, rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_prior_rows_have_the_covariance_of_the_rigid_model(seed: int) -> None:
    """|rows p - target|^2 = e' C^-1 e, where e is the error of the rigid model's parameters."""
    rng = np.random.default_rng(seed)
    study = mixed_study()
    true_values = mixed_values(study)
    model = rigid_model(study, true_values, 0.01)
    n = len(model.parameters)
    mixing = np.eye(n) + 0.3 * rng.normal(size=(n, n))
    std = np.sqrt(np.diag(model.covariance))
    covariance = std[:, None] * (mixing @ mixing.T) * std
    model = replace(model, covariance=covariance)
    space = add_settling_unknowns(
        add_stiffness_curves(started(study, true_values, model), Arm.of(study.arm), LARGEST_TORQUE)
    )

    values = space.values(0.3 * somewhere(space, seed))
    reported = derived(values, study.arm)  # by the same sums as for the true values
    error = np.array([reported[p.name, p.joint] for p in model.parameters]) - model.solution
    total_covariance = covariance + np.diag((FLOOR * model.solution) ** 2)
    expected = error @ np.linalg.solve(total_covariance, error)
    p = np.array([values[key] for key in space.keys])
    residual = space.prior.rows @ p - space.prior.target
    assert np.sum(residual**2) == pytest.approx(expected, rel=1e-8)
    # e' C^-1 V C^-1 e is the variance from the reported errors, without the minimum deviation
    weighted_error = np.linalg.solve(total_covariance, error)
    residual_variance = residual @ space.prior.errors @ residual
    assert residual_variance == pytest.approx(
        weighted_error @ covariance @ weighted_error, rel=1e-8
    )


def test_the_floor_widens_the_prior() -> None:
    study, true_values = truth()
    joints = joint_models(study, true_values, 0.05, NONE_OFF)
    certain_model = rigid_model(study, true_values, 1e-9)
    for floor in (0.002, 0.05):
        space = space_of(
            certain_model, joints, Arm.of(study.arm), largest_voltage=[10.0, 10.0], floor=floor
        )
        z = np.zeros(len(space.unknowns))
        p = space.parameters(z)
        p[space.keys.index(("gamma", None))] *= 1.0 + floor
        residual = space.prior.rows @ p - space.prior.target
        # only gamma has an error, of one standard deviation
        assert np.sum(residual**2) == pytest.approx(1.0, rel=1e-6)


def test_a_missing_effect_loosens_the_prior_of_the_rigid_step() -> None:
    _, _, space = mixed()
    prior, coulomb = space.prior, (COULOMB, 1)
    index = prior.names.index(coulomb)
    loosened = prior.relax({coulomb})
    added = loosened.factor @ loosened.factor.T - prior.factor @ prior.factor.T
    expected = np.zeros_like(added)
    expected[index, index] = (0.03 * prior.mean[index]) ** 2
    np.testing.assert_allclose(added, expected, atol=1e-9 * expected[index, index])
    covariances = [
        each_prior.factor @ each_prior.errors @ each_prior.factor.T
        for each_prior in (prior, loosened)
    ]
    np.testing.assert_allclose(
        covariances[1] - covariances[0], expected, atol=1e-9 * expected[index, index]
    )
    for each_prior in (prior, loosened):
        np.testing.assert_allclose(each_prior.factor @ each_prior.target, prior.mean, rtol=1e-9)
        np.testing.assert_allclose(
            each_prior.factor @ each_prior.rows, prior.factor @ prior.rows, atol=1e-12
        )
    tightened = loosened.restore()
    for name in ("rows", "target", "errors", "factor"):
        np.testing.assert_allclose(getattr(tightened, name), getattr(prior, name), atol=1e-9)
    assert tightened.restore() is tightened
    assert prior.relax(set()) is prior
    (column,) = prior.by_shifts({coulomb}).T
    shifted = prior.mean + 0.03 * prior.mean[index] * np.eye(len(prior.mean))[index]
    np.testing.assert_allclose(column, np.linalg.solve(prior.factor, shifted) - prior.target)


def test_unidentified_rigid_parameters_have_no_prior_row() -> None:
    study, true_values = truth()
    model = rigid_model(study, true_values, 0.01)
    missing = [p.name for p in model.parameters].index("beta")
    parameters = list(model.parameters)
    parameters[missing] = replace(parameters[missing], value=None, std=None)
    covariance = model.covariance.copy()
    friction = [(p.name, p.joint) for p in parameters].index(("total_viscous_friction", 2))
    covariance[friction, friction] = np.inf
    model = replace(model, parameters=tuple(parameters), covariance=covariance)
    space = started(study, true_values, model)
    assert space.prior.rows.shape == (len(parameters) - 2, len(space.unknowns))
    columns = [space.keys.index(key) for key in [("beta", None), (VISCOUS[0], 2)]]
    assert not np.any(space.prior.rows[:, columns])


def alone(gravity: float | None) -> tuple[Study, Values, JointModel]:
    """Study, true values and joint model of a single joint."""
    joint = Joint(spring="linear", gear_ratio=0.01, torque_per_volt=0.08, encoder_counts=8192)
    study = Study(arm=single_joint(joint, gravity=gravity), experiments=())
    _, rig = truth()
    true_values: Values = {(name, 1): value for (name, number), value in rig.items() if number == 1}
    true_values["link_inertia", 1] = 2.0
    true_values["total_viscous_friction", 1] = (
        true_values[VISCOUS[0], 1] + 1e-4 * true_values[VISCOUS[1], 1]
    )
    if gravity is not None:
        true_values["gravity_torque_1", None] = 15.0
    values = {name: value for (name, number), value in true_values.items() if number == 1}
    return study, true_values, joint_model(study, 1, values, np.eye(7))


def test_a_single_joint() -> None:
    study, true_values, start = alone(9.81)
    model = rigid_model(study, true_values, 0.01)
    space = space_of(model, [start], Arm.of(study.arm), largest_voltage=[10.0], floor=FLOOR)
    p = space.parameters(np.zeros(len(space.unknowns)))
    np.testing.assert_allclose(space.prior.rows @ p, space.prior.target, rtol=1e-10)
    assert len(space.prior.target) == 5
    p[space.keys.index(("link_inertia", 1))] += 0.1
    residual = space.prior.rows @ p - space.prior.target
    # motor-side inertia of the joint: J_M + n^2 m_L
    inertia = true_values["motor_inertia", 1] + 1e-4 * 2.0
    std = np.hypot(0.01, FLOOR) * inertia
    assert np.sqrt(np.sum(residual**2)) == pytest.approx(1e-4 * 0.1 / std, rel=1e-6)


def test_a_single_joint_without_gravity_needs_no_rigid_model() -> None:
    study, true_values, start = alone(None)
    space = space_of(None, [start], Arm.of(study.arm), largest_voltage=[10.0], floor=FLOOR)
    assert space.prior.rows.shape == (0, len(space.unknowns))
    values = space.values(np.zeros(len(space.unknowns)))
    assert values["motor_inertia", 1] == true_values["motor_inertia", 1]
    study, true_values, start = alone(9.81)
    with pytest.raises(NotIdentifiable, match="needs gravity_torque_1, which"):
        space_of(None, [start], Arm.of(study.arm), largest_voltage=[10.0], floor=FLOOR)


def test_starts_that_are_missing_or_impossible() -> None:
    study, true_values = truth()
    model = rigid_model(study, true_values, 0.01)
    joints = joint_models(study, true_values, 0.05, NONE_OFF)
    voltage = [10.0, 10.0]
    with pytest.raises(NotIdentifiable, match="joint 2 has none"):
        space_of(model, joints[:1], Arm.of(study.arm), largest_voltage=voltage, floor=FLOOR)
    rigid = replace(
        study,
        arm=replace(
            study.arm, joints=(study.arm.joints[0], replace(study.arm.joints[1], spring="rigid"))
        ),
    )
    with pytest.raises(NotIdentifiable, match="joint 2 has none"):
        space_of(model, joints, Arm.of(rigid.arm), largest_voltage=voltage, floor=FLOOR)
    for name, value in [("gear_damping", -1.0), ("gear_stiffness", np.nan), ("motor_inertia", 0.0)]:
        wrong = replace(joints[1], values={**joints[1].values, name: value})
        starts = starting_values_of(model, [joints[0], wrong], Arm.of(study.arm))
        assert list(starts.rejected) == [(name, 2)]
        # default values are within the range of the space, a factor of three
        assert 1.0 / 3.0 < starts.values[name, 2] / true_values[name, 2] < 3.0
        (warning,) = warn_rejected_starts(starts, Arm.of(study.arm))
        assert warning.where == f"{name} of joint 2"
    # beta + 2 gamma exceeds the inertia of joint 1
    light = replace(joints[0], values={**joints[0].values, "link_inertia": 1.0})
    starts = starting_values_of(model, [light, joints[1]], Arm.of(study.arm))
    assert list(starts.rejected) == [("alpha", None)]
    assert starts.values["alpha", None] == pytest.approx(true_values["alpha", None], rel=0.1)
    negative_inertia = replace(joints[1], values={**joints[1].values, "link_inertia": -1.0})
    beta = tuple(replace(p, value=-1.0) if p.name == "beta" else p for p in model.parameters)
    solution = np.array([p.value for p in beta], dtype=float)
    with pytest.raises(NotIdentifiable, match="beta = -1"):
        starting_values_of(
            replace(model, parameters=beta, solution=solution),
            [joints[0], negative_inertia],
            Arm.of(study.arm),
        )
