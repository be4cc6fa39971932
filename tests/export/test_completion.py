"""Missing values and unknown friction laws in exports, against MuJoCo and by construction."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.studies.exported import by_mujoco, by_pinocchio
from hypothesis import given
from hypothesis import strategies as st

import exports
from strainwave.domain import FloatArray, FrictionTerm, Parameter, RigidModel, Study
from strainwave.domain.arm.combinations import rigid_columns, value_of
from strainwave.domain.keys import Values
from strainwave.domain.results.stage_results import ASSUMED_TORQUE_ERROR
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import inverse_dynamics
from strainwave.export import IdentifiedArm, export_arm, export_file
from strainwave.export.completion import completed, project_friction
from strainwave.export.urdf import to_srdf, to_urdf

SPEEDS = np.concatenate([np.linspace(-80.0, -1.0, 60), np.linspace(1.0, 80.0, 60)])
coefficient = st.floats(0.01, 10.0)


@given(coefficient, coefficient, st.floats(-3.0, 3.0))
def test_a_law_that_the_format_has_is_recovered(d: float, f: float, offset: float) -> None:
    torque = d * SPEEDS + f * np.sign(SPEEDS) + offset
    found = project_friction(torque, SPEEDS)
    np.testing.assert_allclose(found, [d, f, offset, 0.0, 0.0], rtol=1e-7, atol=1e-7)


@given(st.floats(0.2, 3.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_friction_dissipates_at_all_velocities(power: float, a: float, b: float) -> None:
    speed = np.abs(SPEEDS) / 80.0
    torque = np.sign(SPEEDS) * (a + b * speed + speed**power)
    d, f, _, d2, d3 = project_friction(torque, SPEEDS, is_polynomial=True)
    v = np.linspace(0.0, 1e3, 5000)
    slope = d + 2.0 * d2 * v + 3.0 * d3 * v**2
    assert f >= 0.0
    assert slope.min() >= -1e-9 * np.abs(slope).max()


def test_powers_follow_laws_of_the_velocity_only() -> None:
    root = np.sign(SPEEDS) * np.sqrt(np.abs(SPEEDS))
    assert project_friction(root, SPEEDS, is_polynomial=True)[3] < 0.0
    load = np.sign(SPEEDS) * np.abs(np.random.default_rng(0).normal(size=len(SPEEDS)))
    assert not project_friction(load, SPEEDS, is_polynomial=True)[3:].any()


def test_motors_that_stand_have_no_friction() -> None:
    assert not project_friction(np.ones(5), np.zeros(5)).any()


def rigid_arm(folder: Path, *terms: FrictionTerm) -> tuple[IdentifiedArm, Values]:
    """A chain with rigid gears, its rigid model, and terms of friction that no format has."""
    study, values = exports.chain(folder, ("rigid",) * 3)
    values |= {("motor_coulomb_friction", i): 0.05 for i in (1, 2, 3)}
    arm = exports.arm_of(study, values)
    return replace(arm, rigid=model_of(study, values, terms)), values


def model_of(study: Study, values: Values, terms: tuple[FrictionTerm, ...] = ()) -> RigidModel:
    """The rigid model with given values, and a random motion."""
    columns, arm = rigid_columns(study.arm), Arm.of(study.arm)
    random = np.random.default_rng(2).normal(size=(3, 150, arm.n_joints))
    links = random * [[[1.5]], [[1.0]], [[5.0]]]
    return RigidModel(
        parameters=(),
        solution=np.array([value_of(column.parts, values) for column in columns]),
        covariance=np.zeros((0, 0)),
        condition_number=1.0,
        fit_percent={},
        bandwidth_hz=10.0,
        decimation=1,
        n_rows=150,
        status="determined",
        friction_terms=terms,
        motion=np.stack([arm.motor_accelerations(part) for part in links]),
    )


def in_mujoco(arm: IdentifiedArm, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Joint torques of a motion by the rigid model, and by the exported arm in MuJoCo."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra: bench)")
    export_arm(arm, folder / "arm.xml")
    assert arm.rigid is not None
    dynamics = Arm.of(arm.study.arm)
    motion = [dynamics.links_of(part) for part in arm.rigid.motion]
    expected = dynamics.joints_of(inverse_dynamics(dynamics, arm.rigid, arm.rigid.motion))
    return expected, by_mujoco(folder / "arm.xml", dynamics)(*motion)


@pytest.mark.parametrize("missing", [(), ("motor_coulomb_friction", "friction_offset")])
def test_inverse_dynamics_in_mujoco_are_those_of_the_model(
    missing: tuple[str, ...], tmp_path: Path
) -> None:
    """Null values are those of the rigid model; friction is a stiff constraint in MuJoCo."""
    arm, _ = rigid_arm(tmp_path)
    nulls = [replace(p, value=None) if p.name in missing else p for p in arm.parameters]
    arm = replace(arm, parameters=tuple(nulls))
    expected, found = in_mujoco(arm, tmp_path)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    (*_, note) = completed(arm).assumptions or ("",)
    assert ("motor_coulomb_friction 1 = 0.05 N m" in note) == bool(missing)


def test_friction_laws_are_projected_over_the_motion(tmp_path: Path) -> None:
    """Power friction becomes damping with powers: 2 % of the torque, and 4 times less than omitted."""
    size = Parameter("power_friction", 2, 0.2, 0.01, "N m", "rigid")
    arm, _ = rigid_arm(tmp_path, FrictionTerm("power-friction", 2, size, 0.5))
    expected, found = in_mujoco(arm, tmp_path)
    assert any("projected: power-friction (joint 2)" in note for note in completed(arm).assumptions)
    omitted, _ = rigid_arm(tmp_path)
    without, _ = in_mujoco(omitted, tmp_path)
    error, gain = (np.linalg.norm(x - expected) for x in (found, without))
    assert error < 0.02 * np.linalg.norm(expected[:, 1])
    assert error < 0.25 * gain


def test_the_note_has_the_loss_of_the_fits(tmp_path: Path) -> None:
    """Load friction becomes constant: residual and difference of the torques are independent."""
    size = Parameter("load_friction", 2, 0.3, 0.01, "1", "rigid")
    arm, _ = rigid_arm(tmp_path, FrictionTerm("load-friction", 2, size, 1.0))
    expected, found = (Arm.of(arm.study.arm).motors_of(x) for x in in_mujoco(arm, tmp_path))
    residual = ASSUMED_TORQUE_ERROR * np.sqrt(np.mean(expected**2, axis=0))
    difference = np.sqrt(np.mean((found - expected) ** 2, axis=0))
    losses = 100.0 * (np.hypot(residual, difference) - residual) / np.std(expected, axis=0)
    assert losses[1] > 1.0
    (note,) = (x for x in completed(arm, "mjcf").assumptions if x.startswith("expected loss"))
    noted = [float(x) for x in re.findall(r"([\d.]+) \(motor", note)]
    np.testing.assert_allclose(noted, losses, atol=0.06)  # rounded to 0.1; stiff constraints


def test_a_gear_without_stiffness_is_rigid(tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path)
    del values["gear_stiffness", 2]
    del values["gear_damping", 1]
    arm = completed(exports.arm_of(study, values))
    assert [joint.elastic for joint in arm.study.arm.joints] == [True, False, True]
    assert arm.need("gear_damping", 1) == 0.0
    assert arm.assumptions[0] == "assumed: joint 2 is rigid: gear_stiffness not identified"
    for ending in ("xml", "urdf", "m", "mat", "h", "json"):
        export = export_file(exports.write(study, values), tmp_path / f"arm.{ending}")
        assert any("gear_damping 1 = 0 " in note for note in export.notes)


def test_impossible_links_become_the_nearest_bodies(tmp_path: Path) -> None:
    """An arm whose gamma no bodies have: bodies of the rigid model's torques replace it."""
    study = exports.two_links(tmp_path, "rigid")
    values = exports.values_of(study)
    arm = replace(exports.arm_of(study, values), rigid=model_of(study, values))
    wrong = [replace(p, value=1.1) if p.name == "gamma" else p for p in arm.parameters]
    arm = replace(arm, parameters=tuple(wrong))
    expected, found = in_mujoco(arm, tmp_path)
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())
    assert any("not positive definite" in note for note in completed(arm).assumptions)


def test_rotors_in_links_have_the_nearest_torques(tmp_path: Path) -> None:
    """Exact for the first joint; the note has the error of the others."""
    pinocchio = pytest.importorskip("pinocchio", reason="Pinocchio is not installed (extra: bench)")
    arm, values = rigid_arm(tmp_path)
    export = to_urdf(arm)
    model = pinocchio.buildModelFromXML(export.data.decode())
    M = pinocchio.crba(model, model.createData(), pinocchio.neutral(model))
    links = Arm.of(arm.study.arm)
    base = np.array([values[key] for key in links.base_names])
    expected = links.inertia_matrix(base, np.zeros(3))[0, 0] + 2e-4 / 0.01**2
    assert M[0, 0] == pytest.approx(expected, rel=0.05)
    assert "joint 1: 2 kg m^2" in export.notes[0]


def test_srdf_has_the_rotors_apart_from_the_links(tmp_path: Path) -> None:
    """Inverse dynamics of the one file, as URDF with its `rotor_params`, are those of the model."""
    pytest.importorskip("pinocchio", reason="Pinocchio is not installed (extra: bench)")
    arm, values = rigid_arm(tmp_path)
    values |= {("friction_offset", i): 0.0 for i in (1, 2, 3)}  # URDF has none
    study = arm.study
    arm = replace(exports.arm_of(study, values), rigid=model_of(study, values))
    export_arm(arm, tmp_path / "arm.srdf")
    assert arm.rigid is not None
    dynamics = Arm.of(arm.study.arm)
    expected = dynamics.joints_of(inverse_dynamics(dynamics, arm.rigid, arm.rigid.motion))
    motion = [dynamics.links_of(part) for part in arm.rigid.motion]
    found = by_pinocchio(tmp_path / "arm.srdf", dynamics)(*motion)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    assert not any("rotors" in note for note in to_srdf(arm).notes)
