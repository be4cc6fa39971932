"""Files of rigid links read by usd-core and by Drake, and compared with the links."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.arm.link_sensors.link_space import attitude
from strainwave.export.read_back import ReadBack, Value, compare
from strainwave.export.rigid_links import RigidLink

_SINGLE = 1e-6  # relative: most numbers of USD have single precision


def by_usd(path: Path, links: Mapping[str, RigidLink]) -> ReadBack | None:
    """USD read by the installed usd-core; None without it. `links` by the names of their prims."""
    if find_spec("pxr") is None:
        return None
    from pxr import Sdf, Tf, Usd

    reader = f"usd-core {'.'.join(map(str, Usd.GetVersion()[1:]))}"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    try:
        layer.ImportFromString(path.read_text("utf-8"))
        stage = Usd.Stage.Open(layer)
    except Tf.ErrorException as error:
        return ReadBack(reader, problem=" ".join(str(error).split()))
    return compare(reader, _of_usd(stage, links), _SINGLE)


def _of_usd(stage: Any, links: Mapping[str, RigidLink]) -> Iterator[Value]:
    for prim, link in links.items():
        body = stage.GetPrimAtPath(f"/arm/link{link.number}")
        moments, axes, mass, centre = (
            body.GetAttribute(f"physics:{name}").Get()
            for name in ("diagonalInertia", "principalAxes", "mass", "centerOfMass")
        )
        turn = rotation_of(axes)
        yield f"{body.GetName()} mass", link.body.mass, mass
        yield f"{body.GetName()} centre", link.body.centre, centre
        inertia = turn @ np.diag(moments) @ turn.T
        yield f"{body.GetName()} inertia", inertia_of(link), inertia
        joint = stage.GetPrimAtPath(f"/arm/joints/{prim}")
        of_parent, of_link, origin = (
            joint.GetAttribute(f"physics:local{name}").Get() for name in ("Rot0", "Rot1", "Pos0")
        )
        yield f"{prim} xyz", link.joint.origin.xyz, origin
        placement = rotation_of(of_parent) @ rotation_of(of_link).T
        yield f"{prim} rpy", attitude(link.joint.origin.rpy), placement
        yield f"{prim} axis", axis_of(link), rotation_of(of_link)[:, 2]
        is_turning = link.joint.motion == "revolute"
        axis, degree = ("angular", math.radians(1.0)) if is_turning else ("linear", 1.0)
        servo, limits = link.servo, link.limits
        for name, value, unit in (
            ("physxJoint:armature", link.armature, 1.0),
            (f"physxJointAxis:{axis}:armature", link.armature, 1.0),
            (f"physxJointAxis:{axis}:staticFrictionEffort", link.static_friction, 1.0),
            (f"physxJointAxis:{axis}:dynamicFrictionEffort", link.dry_friction, 1.0),
            (f"physxJointAxis:{axis}:viscousFrictionCoefficient", link.viscous_friction, degree),
            (f"physxJointAxis:{axis}:maxJointVelocity", limits.velocity, 1.0 / degree),
            ("physics:lowerLimit", limits.lower, 1.0 / degree),
            ("physics:upperLimit", limits.upper, 1.0 / degree),
            (f"drive:{axis}:physics:maxForce", link.effort_limit, 1.0),
            (f"drive:{axis}:physics:stiffness", servo.stiffness if servo else None, degree),
            (f"drive:{axis}:physics:damping", servo.damping if servo else None, degree),
        ):
            if value is not None:
                read = joint.GetAttribute(name).Get()
                yield f"{prim} {name}", value * unit, math.nan if read is None else read


def by_drake(path: Path, links: Sequence[RigidLink], *, has_rotors: bool) -> ReadBack | None:
    """SDF read by the installed Drake, by the library of SDFormat; None without it.

    Of Gazebo's SDF, without rotors, it reads all but dry friction and the servo.
    """
    if find_spec("pydrake") is None:
        return None
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    reader, plant = f"Drake {version('drake')}", MultibodyPlant(0.0)
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.ERROR)  # it warns of each element of Gazebo that it does not have
    try:
        Parser(plant).AddModelsFromString(path.read_text("utf-8"), "sdf")
        plant.Finalize()
    except RuntimeError as error:
        return ReadBack(reader, problem=" ".join(str(error).split()))
    finally:
        log.setLevel(level)
    return compare(reader, _of_plant(plant, links, has_rotors=has_rotors))


def _of_plant(plant: Any, links: Sequence[RigidLink], *, has_rotors: bool) -> Iterator[Value]:
    context = plant.CreateDefaultContext()
    for link, index in zip(links, plant.GetJointActuatorIndices(), strict=True):
        body, joint = (
            plant.GetBodyByName(f"link{link.number}"),
            plant.GetJointByName(link.name),
        )
        spatial = body.default_spatial_inertia()
        inertia = spatial.Shift(spatial.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        yield f"{link.name} mass", link.body.mass, spatial.get_mass()
        yield f"{link.name} centre", link.body.centre, spatial.get_com()
        yield f"{link.name} inertia", inertia_of(link), inertia
        frame = joint.frame_on_parent().GetFixedPoseInBodyFrame()
        yield f"{link.name} xyz", link.joint.origin.xyz, frame.translation()
        yield f"{link.name} rpy", attitude(link.joint.origin.rpy), frame.rotation().matrix()
        is_turning = link.joint.motion == "revolute"
        axis = joint.revolute_axis() if is_turning else joint.translation_axis()
        yield f"{link.name} axis", axis_of(link), axis
        yield f"{link.name} damping", link.viscous_friction, joint.GetDamping(context)
        limits, actuator = link.limits, plant.get_joint_actuator(index)
        for name, value, read in (
            ("lower", limits.lower, joint.position_lower_limits()),
            ("upper", limits.upper, joint.position_upper_limits()),
            ("velocity", limits.velocity, joint.velocity_upper_limits()),
            ("effort", link.effort_limit, actuator.effort_limit()),
        ):
            if value is not None:
                yield f"{link.name} {name}", value, read
        if has_rotors:
            ratio = actuator.default_gear_ratio()
            yield f"{link.name} gear_ratio", 1.0 / link.joint.gear_ratio, ratio
            reflected = ratio**2 * actuator.default_rotor_inertia()
            yield f"{link.name} armature", link.armature, reflected
        if has_rotors and link.servo:
            gains, servo = actuator.get_controller_gains(), link.servo
            yield f"{link.name} gains", (servo.stiffness, servo.damping), (gains.p, gains.d)


def inertia_of(link: RigidLink) -> FloatArray:
    """Inertia (3, 3) of a link about its centre of mass."""
    xx, yy, zz, xy, xz, yz = link.body.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def axis_of(link: RigidLink) -> FloatArray:
    """Axis of a joint with the length 1."""
    return np.array(link.joint.axis) / float(np.linalg.norm(link.joint.axis))


def rotation_of(quaternion: Any) -> FloatArray:
    """Rotation matrix of a quaternion of USD."""
    from scipy.spatial.transform import Rotation

    parts = [*quaternion.GetImaginary(), quaternion.GetReal()]
    return np.asarray(Rotation.from_quat(parts).as_matrix())
