"""The articulation in USD, read back by usd-core."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import exports
from exports import SERVO_DAMPING as DAMPING
from strainwave.domain import FloatArray
from strainwave.domain.arm.link_sensors.link_space import attitude
from strainwave.export import export_arm
from strainwave.export.rigid_links import rigid_links
from strainwave.export.source import IdentifiedArm
from strainwave.export.usd import to_usd

SINGLE = 1e-6  # relative: USD has numbers of single precision


@pytest.fixture(scope="module")
def pxr() -> ModuleType:
    found: ModuleType = pytest.importorskip("pxr", reason="usd-core is not installed (extra: dev)")
    return found


def stage_of(arm: IdentifiedArm, folder: Path) -> Any:
    from pxr import Usd

    (folder / "arm.usda").write_bytes(to_usd(arm).data)
    return Usd.Stage.Open(str(folder / "arm.usda"))


def matrix_of(quaternion: Any) -> FloatArray:
    """Rotation matrix of a quaternion of USD."""
    w, (x, y, z) = quaternion.GetReal(), quaternion.GetImaginary()
    v = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray((w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross)


@pytest.mark.parametrize("motions", exports.MOTIONS)
def test_bodies_frames_and_joints_are_those_of_the_arm(
    motions: exports.Motions, pxr: ModuleType, tmp_path: Path
) -> None:
    from pxr import UsdGeom, UsdPhysics

    study, values = exports.limited_chain(tmp_path, motions)
    arm = exports.arm_of(study, values)
    stage, (links, _) = stage_of(arm, tmp_path), rigid_links(arm, has_rotors=True)
    turn, position = np.eye(3), np.zeros(3)
    for link in links:
        prim = stage.GetPrimAtPath(f"/arm/link{link.number}")
        mass = UsdPhysics.MassAPI(prim)
        assert mass.GetMassAttr().Get() == pytest.approx(link.body.mass, rel=SINGLE)
        centre = mass.GetCenterOfMassAttr().Get()
        np.testing.assert_allclose(centre, link.body.centre, atol=SINGLE)
        axes = matrix_of(mass.GetPrincipalAxesAttr().Get())
        inertia = axes @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ axes.T
        xx, yy, zz, xy, xz, yz = link.body.inertia
        wanted = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        np.testing.assert_allclose(inertia, wanted, atol=SINGLE * np.max(np.abs(wanted)) * 3.0)

        position = position + turn @ link.joint.origin.xyz
        turn = turn @ attitude(link.joint.origin.rpy)
        world = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0.0))
        np.testing.assert_allclose(world[:3, :3].T, turn, atol=1e-12)
        np.testing.assert_allclose(world[3, :3], position, atol=1e-12)

        name = f"/arm/joints/{link.name}"
        kind = {"revolute": UsdPhysics.RevoluteJoint, "prismatic": UsdPhysics.PrismaticJoint}
        joint = kind[link.joint.motion].Get(stage, name)
        parent = f"/arm/link{link.number - 1}" if link.number > 1 else "/arm/base"
        assert [str(path) for path in joint.GetBody0Rel().GetTargets()] == [parent]
        assert [str(path) for path in joint.GetBody1Rel().GetTargets()] == [str(prim.GetPath())]
        assert joint.GetAxisAttr().Get() == "Z"
        np.testing.assert_allclose(joint.GetLocalPos0Attr().Get(), link.joint.origin.xyz, atol=1e-7)
        of_parent, of_link = (
            matrix_of(each.Get()) for each in (joint.GetLocalRot0Attr(), joint.GetLocalRot1Attr())
        )
        axis = np.array(link.joint.axis) / np.linalg.norm(link.joint.axis)
        np.testing.assert_allclose(of_link[:, 2], axis, atol=1e-6)
        np.testing.assert_allclose(of_parent, attitude(link.joint.origin.rpy) @ of_link, atol=1e-6)
    gravity = UsdPhysics.Scene.Get(stage, "/gravity")
    vector = np.array(gravity.GetGravityDirectionAttr().Get())
    vector *= gravity.GetGravityMagnitudeAttr().Get() / np.linalg.norm(vector)
    np.testing.assert_allclose(vector, study.arm.gravity or (), rtol=SINGLE)


@pytest.mark.parametrize("motions", exports.MOTIONS)
def test_friction_limits_and_armature_are_those_of_the_arm(
    motions: exports.Motions, pxr: ModuleType, tmp_path: Path
) -> None:
    """Angles in degrees, also in the units of friction and velocity."""
    study, values = exports.limited_chain(tmp_path, motions)
    arm = exports.arm_of(study, values)
    stage, (links, _) = stage_of(arm, tmp_path), rigid_links(arm, has_rotors=True)
    for link in links:
        prim = stage.GetPrimAtPath(f"/arm/joints/{link.name}")
        is_turning = link.joint.motion == "revolute"
        axis, unit = ("angular", np.pi / 180.0) if is_turning else ("linear", 1.0)
        limits, friction = link.limits, f"physxJointAxis:{axis}"
        wanted = {
            "physxJoint:armature": values["motor_inertia", link.number] / link.joint.gear_ratio**2,
            f"{friction}:armature": link.armature,
            f"{friction}:staticFrictionEffort": 0.02 * link.number / abs(link.joint.gear_ratio),
            f"{friction}:dynamicFrictionEffort": link.dry_friction,
            f"{friction}:viscousFrictionCoefficient": link.viscous_friction * unit,
            f"{friction}:maxJointVelocity": limits.velocity and limits.velocity / unit,
            "physics:lowerLimit": limits.lower and limits.lower / unit,
            "physics:upperLimit": limits.upper and limits.upper / unit,
            f"drive:{axis}:physics:maxForce": limits.effort,
        }
        for name, value in wanted.items():
            attribute = prim.GetAttribute(name)
            assert attribute.HasAuthoredValue() == (value is not None), name
            if value is not None:
                assert attribute.Get() == pytest.approx(value, rel=1e-5), name


def test_the_validators_of_usd_accept_the_articulation(pxr: ModuleType, tmp_path: Path) -> None:
    from pxr import UsdPhysics, UsdValidation

    study, values = exports.limited_chain(tmp_path)
    stage = stage_of(exports.arm_of(study, values), tmp_path)
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetMessage() for error in errors] == []
    assert stage.GetDefaultPrim().HasAPI(UsdPhysics.ArticulationRootAPI)


def test_the_servo_is_a_drive(pxr: ModuleType, tmp_path: Path) -> None:
    from pxr import UsdPhysics

    stage = stage_of(exports.arm_of(*exports.position_servo(tmp_path)), tmp_path)
    drive = UsdPhysics.DriveAPI.Get(stage.GetPrimAtPath("/arm/joints/joint1"), "angular")
    per_degree = np.pi / 180.0
    assert drive.GetTypeAttr().Get() == "force"
    assert drive.GetStiffnessAttr().Get() == pytest.approx(4.8 * per_degree, rel=SINGLE)
    assert drive.GetDampingAttr().Get() == pytest.approx(DAMPING * per_degree, rel=SINGLE)
    assert drive.GetMaxForceAttr().Get() == pytest.approx(0.75)


def test_losses_and_renamed_joints_are_in_the_file(pxr: ModuleType, tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path)
    for number, name in ((1, 'shoulder "pan"'), (2, "shoulder__pan_"), (3, "7")):
        study = replace(study, arm=study.arm.with_joint(number, name=name))
    arm = exports.arm_of(study, values)
    stage, export = stage_of(arm, tmp_path), to_usd(arm)
    paths = ["shoulder__pan_", "shoulder__pan__2", "_7"]
    assert all(stage.GetPrimAtPath(f"/arm/joints/{path}") for path in paths)
    documentation = stage.GetRootLayer().documentation
    for text in ("gear", "friction_offset", "standard deviations", 'shoulder "pan" is shoulder'):
        assert text in documentation
        assert text in " ".join(export.notes)
    assert {loss.observation for loss in export.losses} >= {"gear", "torque_per_volt"}


def test_the_export_is_read_back(pxr: ModuleType, tmp_path: Path) -> None:
    """Value by value; a value that differs, and a file that USD rejects, are warnings."""
    out = tmp_path / "arm.txt"
    export = export_arm(exports.arm_of(*exports.limited_chain(tmp_path)), out, form="usd")
    assert export.read_back is not None
    assert export.read_back.n_values > 90
    assert export.read_back.differences == ()
    assert export.check is not None
    out.write_text(export.data.decode().replace("dynamicFrictionEffort = ", "staticEffort = "))
    read = export.check(out)
    assert read is not None
    assert len(read.differences) == 3
    assert "dynamicFrictionEffort: 2 in the file, nan read" in read.warnings[0].message
    out.write_text("#usda 1.0\ndef {")
    read = export.check(out)
    assert read is not None
    assert read.problem
