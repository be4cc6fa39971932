"""Load-dependent Coulomb friction: estimated where present, zero elsewhere."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import virtual_arms
from strainwave.domain import FloatArray, RigidModel, RigidOptions, Signals, Study
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import gear_load
from strainwave.identification import rigid, validation
from strainwave.numerics.filters import differentiate

SHARES = np.array([0.08, 0.0])


def loaded(shares: FloatArray, seed: int = 1, arm: int = 1) -> tuple[Study, FloatArray, Signals]:
    """Arm under gravity with load-dependent friction, and a record with torque noise."""
    study = virtual_arms.rigid_two_link(9.81)
    of_arm = virtual_arms.values_of(study, arm)
    truth = virtual_arms.rigid_truth(study, of_arm)
    motion = virtual_arms.exact_motion(2, seed, duration=20.0)
    _, angle, velocity, acceleration = motion
    model = Arm.of(study.arm)
    n = model.gear_ratios
    values = np.array([truth[c.name, c.joint] for c in model.rigid_columns])
    phi = model.rigid_regressor(angle * n, velocity * n, acceleration * n)
    body = phi @ values[: model.n_body]
    viscous, coulomb, offset = values[model.n_body :].reshape(2, 3).T
    rotors = np.array([of_arm["motor_inertia", joint] for joint in (1, 2)])
    coulomb_friction = coulomb + shares * np.abs(body - rotors * acceleration)
    torque = body + viscous * velocity + coulomb_friction * np.sign(velocity) + offset
    noise = np.random.default_rng(seed).normal(0.0, 2e-3, torque.shape)
    return study, values, virtual_arms.exact_signals(motion, torque + noise)


@cache
def estimate() -> RigidModel:
    """Fit to the arm with load-dependent friction."""
    study, _, signals = loaded(SHARES)
    return rigid.fit_rigid([signals], Arm.of(study.arm))


def named(study: Study, *effects: str) -> Arm:
    """The arm with effects of both joints that the study names."""
    joints = tuple(replace(joint, effects=effects) for joint in study.arm.joints)
    return Arm.of(study.arm.with_joints(joints))


def test_the_load_friction_is_recovered() -> None:
    _, values, _ = loaded(SHARES)
    model = estimate()
    (share,) = [term.size for term in model.friction_terms]
    assert (share.name, share.joint, share.unit) == ("load_friction", 1, "1")
    # rigid motion does not show which part of the inertia of axis 1 the gear accelerates
    assert share.value == pytest.approx(SHARES[0], rel=0.2)
    assert share.ci95 is not None
    assert share.ci95[0] < SHARES[0] < share.ci95[1]
    assert [w.where for w in model.warnings if w.code == "load-friction"] == ["joint 1"]
    assert np.all(np.abs(model.solution - values) < 4.0 * np.sqrt(np.diag(model.covariance)))


def test_a_measured_torsion_leaves_inertias_and_friction_as_they_are() -> None:
    study, values, signals = loaded(SHARES)
    arm = Arm.of(study.arm)
    n, T = arm.gear_ratios, signals.sample_time
    viscous, coulomb, offset = values[arm.n_body :].reshape(2, 3).T
    motion = signals.motor_angle, signals.motor_velocity, signals.motor_acceleration
    links = [x * n for x in motion]
    gear = gear_load(arm, values, links)
    torsion = gear / n / np.array([4000.0, 2000.0])  # N m/rad
    speed = differentiate(torsion, T)
    angle, velocity, acceleration = (
        x + twist / n
        for x, twist in zip(motion, (torsion, speed, differentiate(speed, T)), strict=True)
    )
    rotors = arm.motors_of_rigid(0.5) @ values[: arm.n_body]
    friction = (coulomb + SHARES * np.abs(gear)) * np.sign(velocity) + viscous * velocity + offset
    noise = np.random.default_rng(1).normal(0.0, 2e-3, gear.shape)
    twisted = replace(
        signals,
        motor_angle=angle,
        motor_velocity=velocity,
        motor_acceleration=acceleration,
        direction=np.sign(velocity),
        motor_torque=gear + rotors * acceleration + friction + noise,
        torsion=torsion,
    )
    elastic = study.arm.with_joints(replace(joint, spring="linear") for joint in study.arm.joints)
    model = rigid.fit_rigid([twisted], Arm.of(elastic))
    assert [term.effect for term in model.friction_terms] == ["load-friction"]
    errors = np.abs(model.solution - values)
    assert np.all(errors < 4.0 * np.sqrt(np.diag(model.covariance)))
    without = rigid.fit_rigid([replace(twisted, torsion=None)], arm)
    assert np.any(np.abs(without.solution - values) > 10.0 * errors)


def test_the_load_friction_improves_the_prediction() -> None:
    study, _, signals = loaded(SHARES)
    _, _, other_signals = loaded(SHARES, seed=2)
    models = [estimate(), rigid.fit_rigid([signals], named(study))]
    fits = [
        validation.predict_rigid(m, other_signals, Arm.of(study.arm)).fit_percent["torque1"]
        for m in models
    ]
    assert models[1].friction_terms == ()
    assert fits[0] > 99.0 > fits[1]
    expected = validation.predict_rigid(models[0], signals, Arm.of(study.arm)).fit_percent
    assert models[0].fit_percent["motion"] == expected


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_arm_without_it_has_none(seed: int) -> None:
    study, _, signals = loaded(np.zeros(2), seed)
    assert rigid.fit_rigid([signals], Arm.of(study.arm)).friction_terms == ()
    forced = rigid.fit_rigid([signals], named(study, "load-friction")).friction_terms
    assert [term.joint for term in forced] == [1, 2]
    for p in (term.size for term in forced):
        assert p.value is not None
        assert p.std is not None
        assert abs(p.value) < min(4.0 * p.std, 0.01)


def test_behind_elastic_gears_friction_is_the_whole_arm_fits() -> None:
    study, _, signals = loaded(SHARES)
    joints = tuple(replace(joint, spring="linear") for joint in study.arm.joints)
    elastic = replace(study, arm=replace(study.arm, joints=joints))
    options = RigidOptions(bandwidth_hz=4.0)
    assert rigid.fit_rigid([signals], Arm.of(elastic.arm), options).friction_terms == ()
