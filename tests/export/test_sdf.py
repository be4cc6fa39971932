"""Gazebo's SDF and Drake's, read back by Drake's parser, which is that of SDFormat."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import exports
from exports import SERVO_DAMPING as DAMPING
from strainwave.domain import JointLimits
from strainwave.dynamics.arm import Arm
from strainwave.export import export_arm
from strainwave.export.rigid_links import rigid_links
from strainwave.export.sdf import to_drake, to_sdf


@pytest.fixture(scope="module")
def drake() -> ModuleType:
    found: ModuleType = pytest.importorskip(
        "pydrake.multibody.plant", reason="Drake is not installed (pip install drake)"
    )
    return found


def plant_of(drake: ModuleType, data: bytes, gravity: Any = None) -> Any:
    parsing = pytest.importorskip("pydrake.multibody.parsing")
    plant = drake.MultibodyPlant(0.0)
    parsing.Parser(plant).AddModelsFromString(data.decode(), "sdf")
    if gravity is not None:
        plant.mutable_gravity_field().set_gravity_vector(np.array(gravity))
    plant.Finalize()
    return plant


def text_of(element: ET.Element, path: str) -> str:
    found = element.find(path)
    assert found is not None
    assert found.text is not None, path
    return found.text


@pytest.mark.parametrize("motions", exports.MOTIONS)
def test_drake_has_inertia_gravity_and_friction_of_a_chain(
    motions: exports.Motions, drake: ModuleType, tmp_path: Path
) -> None:
    """Rotors are apart from the links: the inertia matrix is that of the arm with its motors."""
    study, values = exports.limited_chain(tmp_path, motions)
    plant = plant_of(drake, to_drake(exports.arm_of(study, values)).data, study.arm.gravity)
    arm, context = Arm.of(study.arm), plant.CreateDefaultContext()
    base, rest = np.array([values[key] for key in arm.base_names]), np.zeros((1, 3))
    rotors = np.diag([values["motor_inertia", i + 1] for i in range(3)]) @ np.diag(
        [1.0 / joint.gear_ratio**2 for joint in study.arm.joints]
    )
    for angle in np.random.default_rng(3).uniform(-2.0, 2.0, (10, 3)):
        plant.SetPositions(context, angle)
        wanted = arm.inertia_matrix(base, angle) + rotors
        np.testing.assert_allclose(plant.CalcMassMatrix(context), wanted, atol=1e-11)
        gravity = -plant.CalcGravityGeneralizedForces(context)
        torque = arm.link_torques(base, angle[None], rest, rest)[0]
        np.testing.assert_allclose(gravity, torque, atol=1e-11)
    for number, joint in enumerate(study.arm.joints, start=1):
        actuator = plant.get_joint_actuator(plant.GetJointActuatorIndices()[number - 1])
        assert actuator.default_gear_ratio() == pytest.approx(1.0 / joint.gear_ratio)
        assert actuator.default_rotor_inertia() == pytest.approx(values["motor_inertia", number])
        viscous = values["motor_viscous_friction", number] / joint.gear_ratio**2 + 0.4
        read = plant.GetJointByName(f"joint{number}")
        assert read.default_damping() == pytest.approx(viscous, rel=1e-6)
        limits = joint.limits or JointLimits()
        given = (limits.lower, limits.upper, limits.velocity)
        for value, read_as in zip(
            given,
            (
                read.position_lower_limit(),
                read.position_upper_limit(),
                read.velocity_upper_limit(),
            ),
            strict=True,
        ):
            assert read_as == (pytest.approx(value) if value is not None else read_as)
            assert np.isfinite(read_as) == (value is not None)
        assert actuator.effort_limit() == (limits.effort or np.inf)


def test_drake_has_the_servo(drake: ModuleType, tmp_path: Path) -> None:
    export = to_drake(exports.arm_of(*exports.position_servo(tmp_path)))
    plant = plant_of(drake, export.data)
    actuator = plant.get_joint_actuator(plant.GetJointActuatorIndices()[0])
    gains = actuator.get_controller_gains()
    assert (gains.p, gains.d, actuator.effort_limit()) == (4.8, DAMPING, 0.75)
    text = " ".join(export.notes)
    for name in ("servo_delay", "motor_coulomb_friction"):
        assert name in text


def test_every_value_of_the_links_is_in_sdf(drake: ModuleType, tmp_path: Path) -> None:
    """The links include the rotors; Drake's parser accepts the file and has its bodies."""
    study, values = exports.limited_chain(tmp_path, exports.MOTIONS[1])
    arm = exports.arm_of(study, values)
    export = to_sdf(arm)
    links, _ = rigid_links(arm, has_rotors=False)
    plant, root = plant_of(drake, export.data), ET.fromstring(export.data)
    context = plant.CreateDefaultContext()
    for link in links:
        read = plant.GetBodyByName(f"link{link.number}")
        about_origin = read.CalcSpatialInertiaInBodyFrame(context)
        body = about_origin.Shift(about_origin.get_com())
        assert body.get_mass() == pytest.approx(link.body.mass)
        np.testing.assert_allclose(about_origin.get_com(), link.body.centre, atol=1e-12)
        moments = body.CalcRotationalInertia()
        xx, yy, zz, xy, xz, yz = link.body.inertia
        np.testing.assert_allclose(moments.get_moments(), [xx, yy, zz], atol=1e-12)
        np.testing.assert_allclose(moments.get_products(), [xy, xz, yz], atol=1e-12)
        joint = root.find(f".//joint[@name='{link.name}']")
        assert joint is not None
        friction = [text_of(joint, f"axis/dynamics/{key}") for key in ("damping", "friction")]
        assert [*map(float, friction)] == [link.viscous_friction, link.dry_friction]
        assert link.dry_friction > 0.0
        assert link.armature == 0.0
    assert "drake" not in export.data.decode()
    for name in ("friction_offset (joint 1, 2, 3)", "gravity", "standard deviations"):
        assert name in export.notes[-1]
        assert name in export.data.decode()


def test_the_servo_is_a_plugin_of_gazebo(tmp_path: Path) -> None:
    root = ET.fromstring(to_sdf(exports.arm_of(*exports.position_servo(tmp_path))).data)
    plugin = root.find(".//plugin")
    assert plugin is not None
    read = {child.tag: child.text for child in plugin}
    assert read == {
        **{"joint_name": "joint1", "p_gain": "4.8", "i_gain": "0", "d_gain": str(DAMPING)},
        **{"cmd_max": "0.75", "cmd_min": "-0.75"},
    }


@pytest.mark.parametrize("form", ["sdf", "drake"])
def test_the_export_is_read_back(form: str, drake: ModuleType, tmp_path: Path) -> None:
    """Value by value; a value that differs, and a file that Drake rejects, are warnings."""
    out = tmp_path / "arm.txt"
    export = export_arm(exports.arm_of(*exports.limited_chain(tmp_path)), out, form=form)
    assert export.read_back is not None
    assert export.read_back.n_values > 80
    assert export.read_back.differences == ()
    assert export.check is not None
    out.write_text(export.data.decode().replace("<damping>", "<damping>1"))
    read = export.check(out)
    assert read is not None
    assert len(read.differences) == 3
    assert "joint1 damping" in read.warnings[0].message
    out.write_text("<sdf>")
    read = export.check(out)
    assert read is not None
    assert read.problem
