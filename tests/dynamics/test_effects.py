from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from strainwave import pipeline
from strainwave.domain import EffectName, FloatArray, Joint, Study
from strainwave.domain.arm.kinds import single_joint
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, sensitivities, simulate
from strainwave.errors import InvalidInput
from strainwave.io import logs
from strainwave.io.study import read_study
from strainwave.virtual import experiments as virtual
from strainwave.virtual import scara

RATIO = 0.01
VALUES: Values = {
    ("link_inertia", 1): 1.5,
    ("motor_inertia", 1): 1.5e-4,
    ("motor_viscous_friction", 1): 2e-4,
    ("motor_coulomb_friction", 1): 0.06,
    ("link_viscous_friction", 1): 0.5,
    ("gear_stiffness", 1): 20e3,
    ("gear_damping", 1): 20.0,
}
EFFECTS: Values = {
    ("stribeck_friction", 1): 0.02,
    ("stribeck_velocity", 1): 3.0,
    ("hysteresis_torque", 1): 2.5,
    ("hysteresis_twist", 1): 1.5e-4,
    ("kinematic_error_cos", 1): 1e-4,
    ("kinematic_error_sin", 1): -5e-5,
    ("kinematic_error_order", 1): 2.0,
}
ALL: tuple[EffectName, ...] = ("stribeck", "hysteresis", "kinematic-error")


def one_joint(effects: tuple[EffectName, ...] = ALL) -> Study:
    joint = Joint("linear", RATIO, torque_per_volt=0.1, effects=effects)
    arm = single_joint(joint)
    return Study(
        arm=arm, experiments=scara.STIFF.study(Path()).experiments, path=Path("study.toml")
    )


def drive(volts: FloatArray) -> Drive:
    voltage = volts[:, np.newaxis]
    return Drive(1e-3, voltage, np.zeros_like(voltage), (False,), (0.0,), (0.0,))


def by_scipy(volts: float, seconds: FloatArray, values: Values) -> FloatArray:
    """Motor and link velocity of one joint that slides forward from standstill, integrated by SciPy."""
    p = {name: value for (name, _), value in values.items()}

    def slope(_: float, x: FloatArray) -> list[float]:
        motor, speed, link, link_speed, z = x
        cos, sin = p["kinematic_error_cos"], p["kinematic_error_sin"]
        order = p["kinematic_error_order"]
        error = cos * np.cos(order * motor) + sin * np.sin(order * motor)
        lever = RATIO + order * (sin * np.cos(order * motor) - cos * np.sin(order * motor))
        torsion, rate = RATIO * motor + error - link, lever * speed - link_speed
        gear = p["gear_stiffness"] * torsion + p["gear_damping"] * rate
        gear += p["hysteresis_torque"] * z
        dry = p["motor_coulomb_friction"]
        dry += p["stribeck_friction"] * np.exp(-((speed / p["stribeck_velocity"]) ** 2))
        drag = p["motor_viscous_friction"] * speed
        return [
            speed,
            (0.1 * volts - dry - drag - lever * gear) / p["motor_inertia"],
            link_speed,
            (gear - p["link_viscous_friction"] * link_speed) / p["link_inertia"],
            (rate - abs(rate) * z) / p["hysteresis_twist"],
        ]

    start = [0.0, 0.0, p["kinematic_error_cos"], 0.0, 0.0]
    solution = solve_ivp(
        slope, (0.0, seconds[-1]), start, "DOP853", seconds, rtol=1e-11, atol=1e-13, max_step=1e-4
    )
    return np.asarray(solution.y[[1, 3]].T)


def test_effects_match_scipy() -> None:
    samples = 300
    run = simulate(
        Arm.of(one_joint().arm),
        VALUES | EFFECTS,
        drive(np.full(samples, 4.0)),
        sample_time=1e-3,
        samples=samples,
        record=["motor_velocity", "link_velocity"],
    )
    expected = by_scipy(4.0, run.time, VALUES | EFFECTS)
    assert expected[1:, 0].min() > 0.0  # the motor slides, as the SciPy model assumes
    swings = np.sign(
        RATIO * expected[:, 0] - expected[:, 1]
    )  # approximately the rate of the torsion
    assert np.sum(np.diff(swings) != 0.0) > 8
    for i, name in enumerate(("motor_velocity", "link_velocity")):
        simulated = run.quantities[name][:, 0]  # type: ignore[index]
        # tens of reversals of the torsion, each integrated with third order
        np.testing.assert_allclose(
            simulated, expected[:, i], atol=2e-6 * np.abs(expected[:, i]).max()
        )


@pytest.mark.parametrize("effect", ALL)
def test_effects_need_parameters_and_change_the_motion(effect: EffectName) -> None:
    study, volts = one_joint((effect,)), drive(np.full(200, 4.0))
    values = {key: value for key, value in EFFECTS.items() if key[0].startswith(effect[:9])}
    first, second, *_ = [name for name, _ in values]
    assert Arm.of(study.arm).parameter_names[-len(values) :] == tuple(values)
    with pytest.raises(InvalidInput, match=f"missing parameters: {first} of joint 1, {second}"):
        simulate(
            Arm.of(study.arm), VALUES, volts, sample_time=1e-3, samples=200, record=["encoder"]
        )
    with_it, without = (
        simulate(
            Arm.of(of.arm),
            VALUES | EFFECTS,
            volts,
            sample_time=1e-3,
            samples=200,
            record=["encoder"],
        )
        for of in (study, one_joint(()))
    )
    assert np.abs(with_it["encoder"] - without["encoder"]).max() > 1e-3


def test_the_default_order_of_the_kinematic_error_is_two() -> None:
    arm, volts = Arm.of(one_joint(("kinematic-error",)).arm), drive(np.full(200, 4.0))
    order = ("kinematic_error_order", 1)
    unnamed = VALUES | {key: value for key, value in EFFECTS.items() if key != order}
    runs = [
        simulate(arm, values, volts, sample_time=1e-3, samples=200, record=["encoder"])["encoder"]
        for values in (unnamed, unnamed | {order: 2.0}, unnamed | {order: 4.0})
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.abs(runs[2] - runs[1]).max() > 1e-3


def test_the_core_rejects_invalid_effects() -> None:
    study = one_joint()
    rigid = replace(
        study, arm=replace(study.arm, joints=(replace(study.arm.joints[0], spring="rigid"),))
    )
    with pytest.raises(ValueError, match="a rigid gear has no hysteresis"):
        _ = Arm.of(rigid.arm).core
    with pytest.raises(InvalidInput, match="no effect 'creep'"):
        _ = Arm.of(one_joint(("creep",)).arm).core


def test_sensitivities_to_effect_parameters_match_differences() -> None:
    study, values = one_joint(), VALUES | EFFECTS
    volts = drive(4.0 * np.sign(np.sin(2.0 * np.pi * 11.0 * 1e-3 * np.arange(200) + 0.1)))
    derivatives = sensitivities(
        Arm.of(study.arm),
        values,
        volts,
        list(EFFECTS),
        sample_time=1e-3,
        samples=200,
        record=["link_velocity"],
    )["link_velocity"][1]
    for k, key in enumerate(EFFECTS):
        size = 1e-4 * values[key]
        up, down = (
            simulate(
                Arm.of(study.arm),
                values | {key: values[key] + change},
                volts,
                sample_time=1e-3,
                samples=200,
                record=["link_velocity"],
            )["link_velocity"]
            for change in (size, -size)
        )
        slope = (up - down) / (2.0 * size)
        # central differences have second-order errors, and first-order errors at reversals
        np.testing.assert_allclose(derivatives[:, :, k], slope, atol=1e-3 * np.abs(slope).max())


def test_a_study_file_with_effects_is_simulated(tmp_path: Path) -> None:
    study = scara.STIFF.study(tmp_path)
    first = replace(study.arm.joints[0], effects=ALL)
    step = tuple(e for e in study.experiments if e.name == "step-j1")
    study = replace(
        study, arm=replace(study.arm, joints=(first, study.arm.joints[1])), experiments=step
    )
    with pytest.raises(InvalidInput, match="missing parameters: stribeck_friction of joint 1"):
        virtual.simulate_study(study, scara.STIFF.parameters(), tmp_path / "none")
    virtual.simulate_study(study, scara.STIFF.parameters() | EFFECTS, tmp_path / "with")
    plain = replace(study, arm=replace(study.arm, joints=scara.STIFF.study(tmp_path).arm.joints))
    virtual.simulate_study(plain, scara.STIFF.parameters(), tmp_path / "without")
    back = read_study(tmp_path / "with" / "study.toml")
    assert back.arm.joints == study.arm.joints
    with_them, without = (
        logs.read_logs(read_study(tmp_path / name / "study.toml"))[0].channels["theta_m1"]
        for name in ("with", "without")
    )
    assert not np.array_equal(with_them, without)


def test_the_rigid_step_accepts_effects(tmp_path: Path) -> None:
    study = scara.STIFF.study(tmp_path)
    first = replace(study.arm.joints[0], effects=ALL)
    motion = tuple(e for e in study.experiments if e.use == "motion")
    study = replace(
        study, arm=replace(study.arm, joints=(first, study.arm.joints[1])), experiments=motion
    )
    virtual.simulate_study(study, scara.STIFF.parameters() | EFFECTS, tmp_path)
    result = pipeline.identify(tmp_path / "study.toml", stages=pipeline.STAGES[:1])
    assert result.rigid is not None
    true = virtual.derived(scara.STIFF.parameters(), study.arm)
    for name, joint in (("rigid_inertia", 1), ("beta", None), ("gamma", None)):
        # a few per mille, as without effects, which slow motion hardly excites
        assert result.rigid.value(name, joint) == pytest.approx(true[name, joint], rel=0.01)
