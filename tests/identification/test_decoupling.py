"""Decoupling: with the interaction torque, each joint is a two-inertia system."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from elastic_runs import log_of, prbs_run, rig, rig_values, true_model
from strainwave.domain import Decoupled, Joint, LinkSignals, Study
from strainwave.domain.arm.kinds import single_joint
from strainwave.domain.study import Use
from strainwave.dynamics import rigid_prediction as interaction
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Trajectory
from strainwave.errors import NotIdentifiable
from strainwave.identification import decoupling, rigid
from strainwave.io.logs import read_log
from strainwave.io.study import read_study
from strainwave.signals import link_motion as links
from strainwave.signals import motor as signals


@cache
def run_of(gravity: float | None, both: bool = False) -> tuple[Study, Trajectory]:
    study = rig(gravity)
    return study, prbs_run(study, both=both)


@pytest.mark.parametrize("gravity", [None, 9.81])
@pytest.mark.parametrize("bend", [0.0, 0.8, np.pi])
def test_every_joint_alone_obeys_its_two_inertias(gravity: float | None, bend: float) -> None:
    """m_L ddq = T + D_G ddelta - d_L dq + tau holds to rounding, with m_L of any posture."""
    study, run = run_of(gravity)
    values = rig_values(study)
    base = interaction.base_parameters(true_model(study, values), Arm.of(study.arm))
    motion = (run["link_angle"], run["link_velocity"], run["link_acceleration"])
    postures = np.array([[0.3, bend], [0.3, bend]])
    tau = interaction.interaction_torques(Arm.of(study.arm), base, *motion, postures)
    alpha, beta, gamma = (values[name, None] for name in ("alpha", "beta", "gamma"))
    for i, inertia in enumerate((alpha + beta + 2.0 * gamma * np.cos(bend), beta)):
        viscous = values["link_viscous_friction", i + 1]
        applied_torque = run["gear_torque"][:, i] - viscous * run["link_velocity"][:, i] + tau[:, i]
        inertia_torque = inertia * run["link_acceleration"][:, i]
        assert inertia_torque == pytest.approx(
            applied_torque, abs=1e-9 * np.abs(inertia_torque).max()
        )


def test_alpha_cancels() -> None:
    study, run = run_of(None)
    base = interaction.base_parameters(true_model(study, rig_values(study)), Arm.of(study.arm))
    motion = (run["link_angle"], run["link_velocity"], run["link_acceleration"])
    changed = base.copy()
    changed[0] += 7.0
    first, second = (
        interaction.interaction_torques(Arm.of(study.arm), b, *motion) for b in (base, changed)
    )
    assert first == pytest.approx(second, abs=1e-10 * np.abs(first).max())


def test_the_closed_form_of_a_two_link_arm() -> None:
    study = rig(None)
    rng = np.random.default_rng(5)
    q, dq, ddq = (rng.normal(size=(50, 2)) for _ in range(3))
    values = rig_values(study)
    beta, gamma = values["beta", None], values["gamma", None]
    tau = interaction.interaction_torques(
        Arm.of(study.arm),
        interaction.base_parameters(true_model(study, values), Arm.of(study.arm)),
        q,
        dq,
        ddq,
    )
    c2, s2 = np.cos(q[:, 1]), np.sin(q[:, 1])
    first = 2.0 * gamma * (1.0 - c2) * ddq[:, 0] - (beta + gamma * c2) * ddq[:, 1]
    first += gamma * s2 * (2.0 * dq[:, 0] * dq[:, 1] + dq[:, 1] ** 2)
    second = -(beta + gamma * c2) * ddq[:, 0] - gamma * s2 * dq[:, 0] ** 2
    assert tau == pytest.approx(np.column_stack([first, second]), abs=1e-12)


@cache
def decoupled(gravity: float | None = None, both: bool = False) -> tuple[Decoupled, ...]:
    study, run = run_of(gravity, both)
    link_signals = links.prepare_link_signals(log_of(run, seed=2), Arm.of(study.arm))
    return decoupling.decouple(
        link_signals, true_model(study, rig_values(study)), Arm.of(study.arm)
    )


@pytest.mark.parametrize("gravity", [None, 9.81])
def test_inputs_explain_the_motor_and_the_link(gravity: float | None) -> None:
    """The sum of motor and link equation holds for noisy sensors, on the motor side:

    m_M ddtheta_M + n m_L ddq + d_M dtheta_M + n d_L dq = u + n tau
    """
    study, _ = run_of(gravity)
    values = rig_values(study)
    for joint in decoupled(gravity):
        n = study.arm.joints[joint.joint - 1].gear_ratio
        motor_inertia = values["motor_inertia", joint.joint]
        assert joint.total_inertia is not None
        link_inertia = (joint.total_inertia - motor_inertia) / n**2
        # momenta require no derivative of velocities
        momentum = joint.outputs @ np.array([motor_inertia, n * link_inertia])
        viscous = np.array(
            [
                values["motor_viscous_friction", joint.joint],
                n * values["link_viscous_friction", joint.joint],
            ]
        )
        force = joint.inputs @ np.array([1.0, n]) - joint.outputs @ viscous
        impulse = np.cumsum(force) * joint.sample_time
        inner = slice(400, 8000)
        line = np.polynomial.Polynomial.fit(joint.time[inner], (momentum - impulse)[inner], 1)
        residual = (momentum - impulse)[inner] - line(joint.time[inner])
        # one encoder count is 3 rad/s between two samples, a tenth of the motor's part
        momentum_scale = momentum[inner].std() + motor_inertia * 3.0
        assert residual.std() < (0.05 if joint.joint == 1 else 0.12) * momentum_scale, joint.joint


def test_the_decoupled_record_contains_the_data_of_the_rigid_model() -> None:
    study, _ = run_of(None)
    values = rig_values(study)
    first, second = decoupled()
    alpha, beta, gamma = (values[name, None] for name in ("alpha", "beta", "gamma"))
    total_inertia = values["motor_inertia", 1] + 1e-4 * (alpha + beta + 2.0 * gamma)
    assert first.total_inertia == pytest.approx(total_inertia)
    assert second.total_inertia == pytest.approx(values["motor_inertia", 2] + 1e-4 * beta)
    assert first.total_viscous_friction == pytest.approx(2.5e-4)
    assert first.inputs.shape == first.outputs.shape
    assert not first.held
    assert first.fusion is not None
    assert first.valid[1000]
    assert not first.valid[0]


def test_checks_have_verdicts() -> None:
    verdicts = {c.name: c for c in decoupled()[0].checks}
    assert set(verdicts) == {
        "sliding",
        "constant-inertia",
        "interaction-amplitude",
        "interaction-spectrum",
        "input-richness",
    }
    assert all(verdicts[name].passed for name in ("sliding", "interaction-amplitude"))
    for check in verdicts.values():
        assert check.passed == (
            (check.value <= check.limit)
            if check.name == "constant-inertia"
            else (check.value >= check.limit)
        )
        assert check.message


def test_two_sequences_show_more_than_one() -> None:
    single_richness, joint_richness = (
        next(c.value for c in decoupled(None, both)[0].checks if c.name == "input-richness")
        for both in (False, True)
    )
    assert joint_richness > 10.0 * single_richness


def test_a_band_may_be_set() -> None:
    study, run = run_of(None)
    link_signals = links.prepare_link_signals(log_of(run), Arm.of(study.arm))
    model = true_model(study, rig_values(study))
    joints = decoupling.decouple(
        link_signals, model, Arm.of(study.arm), decoupling.DecouplingOptions((8.0, 25.0))
    )
    assert joints[0].richness_hz[0] >= 8.0
    assert joints[0].richness_hz[-1] <= 25.0


def test_much_swing_is_reported() -> None:
    study, run = run_of(None)
    link_signals = links.prepare_link_signals(log_of(run), Arm.of(study.arm))
    swing = link_signals.link_angle.copy()
    swing[:, 1] += np.linspace(0.0, 2.0, len(swing))
    model = true_model(study, rig_values(study))
    joints = decoupling.decouple(replace(link_signals, link_angle=swing), model, Arm.of(study.arm))
    assert "constant-inertia" in {w.code for w in joints[0].warnings}
    assert all(c.passed for c in joints[1].checks if c.name == "constant-inertia")


@pytest.mark.parametrize(("gravity", "inputs"), [(None, 1), (9.81, 2)])
def test_a_single_joint_has_gravity_or_nothing_beside_its_motor(
    gravity: float | None, inputs: int
) -> None:
    joint = Joint(spring="linear", gear_ratio=0.5)
    two_link = rig()
    study = Study(arm=single_joint(joint, gravity=gravity), experiments=())
    run = prbs_run(two_link)
    sensor_signals = links.prepare_link_signals(log_of(run), Arm.of(two_link.arm))
    columns = {
        name: getattr(sensor_signals, name)[:, :1]
        for name in (
            "motor_torque",
            "motor_angle",
            "motor_velocity",
            "direction",
            "link_angle",
            "link_velocity",
            "link_acceleration",
            "valid",
        )
    }
    sensor_signals = replace(
        sensor_signals, **columns, held=(False,), links=sensor_signals.links[:1]
    )
    model = true_model(two_link, rig_values(two_link))
    parameters = tuple(
        replace(model.parameters[0], name=name, joint=number, value=value)
        for name, number, value in (
            ("inertia", 1, 0.2),
            ("gravity_torque_1", None, 3.0),
            ("total_viscous_friction", 1, 0.1),
            ("motor_coulomb_friction", 1, 0.05),
            ("friction_offset", 1, 0.01),
        )
    )
    (decoupled_joint,) = decoupling.decouple(
        sensor_signals, replace(model, parameters=parameters), Arm.of(study.arm)
    )
    assert decoupled_joint.inputs.shape[1] == inputs
    assert decoupled_joint.total_inertia == pytest.approx(0.2)
    assert decoupled_joint.gear_ratio == 0.5
    if gravity is not None:
        assert decoupled_joint.inputs[:, 1] == pytest.approx(
            -3.0 * np.cos(sensor_signals.link_angle[:, 0])
        )
    friction = sensor_signals.motor_torque[:, 0] - decoupled_joint.inputs[:, 0]
    assert friction == pytest.approx(0.05 * sensor_signals.direction[:, 0] + 0.01)


def test_only_a_single_joint_without_gravity_needs_no_rigid_model() -> None:
    study, run = run_of(None)
    link_signals = links.prepare_link_signals(log_of(run), Arm.of(study.arm))
    with pytest.raises(NotIdentifiable, match="rigid model"):
        decoupling.decouple(link_signals, None, Arm.of(study.arm))


def test_a_bare_joint_keeps_its_friction(shared_data: Path) -> None:
    study = read_study(shared_data / "real" / "ist-flexible-arm" / "study.toml")
    link_signals = links.prepare_link_signals(
        read_log(study, study.experiments[0]), Arm.of(study.arm)
    )
    (decoupled_joint,) = decoupling.decouple(link_signals, None, Arm.of(study.arm))
    assert decoupled_joint.inputs == pytest.approx(link_signals.motor_torque)
    assert decoupled_joint.total_inertia is None
    assert decoupled_joint.total_viscous_friction is None


def test_an_unknown_parameter_is_refused_by_name() -> None:
    study, run = run_of(None)
    model = true_model(study, rig_values(study))
    missing = tuple(replace(p, value=None) if p.name == "gamma" else p for p in model.parameters)
    with pytest.raises(NotIdentifiable, match="gamma"):
        decoupling.decouple(
            links.prepare_link_signals(log_of(run), Arm.of(study.arm)),
            replace(model, parameters=missing),
            Arm.of(study.arm),
        )


def test_lab_records_pass_their_checks(shared_data: Path) -> None:
    study = read_study(shared_data / "lab" / "scara-linear-5kg" / "study.toml")
    named = {e.name: e for e in study.experiments}
    model = rigid.fit_rigid(
        [signals.prepare_motor_signals(read_log(study, named["motion"]), Arm.of(study.arm))],
        Arm.of(study.arm),
    )
    joints = decoupling.decouple(
        links.prepare_link_signals(read_log(study, named["prbs-j1"]), Arm.of(study.arm)),
        model,
        Arm.of(study.arm),
    )
    assert all(check.passed for check in joints[0].checks)
    # 1.5e-4 + 1e-4 * 3.82895 from truth.json
    assert joints[0].total_inertia == pytest.approx(5.32895e-4, rel=2e-3)


def test_the_posture_is_that_of_the_records_that_excite_a_joint() -> None:
    study, run = run_of(None)
    side = links.prepare_link_signals(log_of(run, seed=2), Arm.of(study.arm))

    def record(joint: int, use: Use, bend: float) -> LinkSignals:
        experiment = replace(side.experiment, joint=joint, use=use)
        return replace(side, experiment=experiment, link_angle=np.full_like(side.link_angle, bend))

    records = [record(1, "frequency", 0.2), record(1, "frequency", 0.4), record(1, "sweep", 2.0)]
    postures = interaction.mean_postures([*records, record(2, "sweep", 1.0)])
    np.testing.assert_allclose(postures, [[0.3, 0.3], [1.0, 1.0]])
    model = true_model(study, rig_values(study))
    first = decoupling.decouple(records[0], model, Arm.of(study.arm))[0]
    bent, stretched = (
        decoupling.decouple(records[0], model, Arm.of(study.arm), postures=np.full((2, 2), q))[0]
        for q in (0.2, 0.0)
    )
    np.testing.assert_allclose(first.inputs, bent.inputs, atol=1e-12)
    np.testing.assert_allclose(first.posture, (0.2, 0.2))
    gamma, ratio = rig_values(study)["gamma", None], study.arm.joints[0].gear_ratio
    change = 2.0 * gamma * (1.0 - np.cos(0.2))
    assert stretched.total_inertia is not None
    assert bent.total_inertia == pytest.approx(stretched.total_inertia - ratio**2 * change)
    np.testing.assert_allclose(
        stretched.inputs[:, 1] - bent.inputs[:, 1],
        change * records[0].link_acceleration[:, 0],
        atol=1e-9,
    )
