"""The exported bodies have the base parameters of the arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import exports
from strainwave.domain import JointLimits, Parameter
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS, Body
from strainwave.domain.arm.kinds.planar import about_axis
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.export import IdentifiedArm
from strainwave.export.completion import link_bodies
from strainwave.export.urdf import to_urdf
from strainwave.io.urdf import read_urdf

LENGTH, GRAVITY = 0.35, 9.81


def number(root: ET.Element, path: str, attribute: str) -> float:
    found = root.find(path)
    assert found is not None, path
    return float(found.attrib[attribute])


def parsed(arm: IdentifiedArm) -> ET.Element:
    return ET.fromstring(to_urdf(arm).data)


def body_of(robot: ET.Element, link: int) -> Body:
    place = f"link[@name='link{link}']/inertial/"
    centre = robot.find(f"{place}origin")
    assert centre is not None
    return Body.in_plane(
        number(robot, f"{place}mass", "value"),
        float(centre.attrib["xyz"].split()[0]),
        number(robot, f"{place}inertia", "izz"),
    )


def about_its_axis(body: Body) -> float:
    """Inertia of a link in the plane about its joint."""
    return body.inertia[2] + body.mass * body.centre[0] ** 2


def base_parameters(first: Body, second: Body) -> Values:
    """(3) and (S1) by their definitions."""
    moment, of_first = (body.mass * body.centre[0] for body in (second, first))
    return {
        ("alpha", None): about_its_axis(first) + second.mass * LENGTH**2,
        ("beta", None): about_its_axis(second),
        ("gamma", None): LENGTH * moment,
        ("gravity_torque_1", None): GRAVITY * (of_first + second.mass * LENGTH),
        ("gravity_torque_2", None): GRAVITY * moment,
    }


def without_rotors(values: Values) -> Values:
    """The links alone are exact; rotors in them are approximate, apart from the first."""
    return {key: 0.0 if key[0] == "motor_inertia" else value for key, value in values.items()}


def test_the_file_has_the_base_parameters(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path, "rigid", gravity=GRAVITY)
    values = without_rotors(exports.values_of(study))
    values["gravity_torque_2", None] = GRAVITY * values["gamma", None] / LENGTH
    robot = parsed(exports.arm_of(study, values))
    for name, found in base_parameters(body_of(robot, 1), body_of(robot, 2)).items():
        assert found == pytest.approx(values[name], rel=1e-12), name
    assert robot.findall("joint/origin")[1].attrib["xyz"] == f"{LENGTH} 0.0 0.0"


def size(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))


@given(size(1e-3, 1e2), size(1e-3, 1e2), st.floats(-0.999, 0.999), st.floats(-200.0, 200.0))
def test_every_arm_with_a_definite_inertia_matrix_has_bodies(
    alpha: float, beta: float, coupling: float, torque: float
) -> None:
    gamma = coupling * float(np.sqrt(alpha * beta))
    base: Values = {
        ("alpha", None): alpha,
        ("beta", None): beta,
        ("gamma", None): gamma,
        ("gravity_torque_1", None): torque,
        ("gravity_torque_2", None): GRAVITY * gamma / LENGTH,
    }
    parameters = tuple(Parameter(n, j, v, None, "", "tuned") for (n, j), v in base.items())
    study = exports.two_links(Path("nowhere"), gravity=GRAVITY)
    bodies = link_bodies(IdentifiedArm(study, parameters, "nowhere"), GRAVITY)
    assert all(body.mass > 0.0 and body.inertia[2] > 0.0 for body in bodies)
    first, second = bodies
    # the first moment of a heavy counterweight is a small difference of large numbers
    scale = {"gravity_torque_1": abs(torque) + GRAVITY * second.mass * LENGTH}
    for (name, _), found in base_parameters(first, second).items():
        size = scale.get(name, alpha + beta)
        assert found == pytest.approx(base[name, None], rel=1e-9, abs=1e-9 * size), name


@given(size(1e-3, 1e2), st.floats(-50.0, 50.0), size(0.05, 3.0))
def test_a_body_has_the_requested_moments(inertia: float, moment: float, length: float) -> None:
    body = about_axis(inertia, moment, length)
    assert body.mass > 0.0
    assert body.inertia[2] > 0.0
    assert body.mass * body.centre[0] == pytest.approx(moment, rel=1e-12)
    assert about_its_axis(body) == pytest.approx(inertia, rel=1e-9)


def test_an_indefinite_inertia_matrix_is_refused(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    values = exports.values_of(study) | {("gamma", None): 1.1}
    with pytest.raises(InvalidInput, match="not positive definite"):
        to_urdf(exports.arm_of(study, values))


def test_friction_and_gear_ratio_refer_to_the_link(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    values = exports.values_of(study)
    robot = parsed(exports.arm_of(study, values))
    n = study.arm.joints[1].gear_ratio
    viscous = values["motor_viscous_friction", 2] / n**2 + values["link_viscous_friction", 2]
    place = "joint[@name='joint2']/dynamics"
    assert number(robot, place, "damping") == pytest.approx(viscous)
    coulomb = values["motor_coulomb_friction", 2] / n
    assert number(robot, place, "friction") == pytest.approx(coulomb)
    reductions = [e.text for e in robot.iterfind("transmission/actuator/mechanicalReduction")]
    assert reductions == ["100.0", "100.0"]


def test_a_single_link_behind_a_rigid_gear_includes_its_motor(tmp_path: Path) -> None:
    study, values = exports.single(tmp_path, gravity=GRAVITY)
    body = body_of(parsed(exports.arm_of(study, values)), 1)
    total = values["link_inertia", 1] + values["motor_inertia", 1] / 0.1**2
    assert about_its_axis(body) == pytest.approx(total)
    assert GRAVITY * body.mass * body.centre[0] == pytest.approx(11.0)


def test_a_prismatic_joint_has_limits(tmp_path: Path) -> None:
    study, values = exports.single(tmp_path, "prismatic", "linear")
    robot = parsed(exports.arm_of(study, values))
    total = values["link_inertia", 1] + values["motor_inertia", 1] / 0.1**2
    assert body_of(robot, 1).mass == pytest.approx(total, rel=1e-5)  # weights of torques are finite
    joint = robot.find("joint[@type='prismatic']")
    assert joint is not None
    assert joint.find("limit") is not None
    arm = exports.arm_of(study, values)
    empty = replace(arm, parameters=tuple(replace(p, value=None) for p in arm.parameters))
    with pytest.raises(InvalidInput, match="link_inertia of joint 1 is null"):
        to_urdf(empty)


def test_all_parts_that_urdf_cannot_hold_are_noted(tmp_path: Path) -> None:
    """On the terminal, and in comments of the file; every parameter is held or noted."""
    study = exports.two_links(tmp_path, "three-slope", gravity=GRAVITY)
    values = exports.values_of(study) | {
        ("friction_settling_time", 1): 5e-5,
        ("hysteresis_torque", 2): 1.0,
    }
    export = to_urdf(exports.arm_of(study, values))
    for note in export.notes:
        assert f"<!-- {note[:1].upper()}{note[1:]}. -->" in export.data.decode()
    text = " ".join(export.notes)
    for name in ("gear (joint 1, 2)", "friction_settling_time (joint 1)", "hysteresis_torque"):
        assert name in text
    for name in ("torque_per_volt", "sensors", "servo", "standard deviations"):
        assert name in text
    assert export.notes[0].startswith("the links include the rotors (joint 1: 1.5 kg m^2")


def test_a_motor_that_the_link_includes_is_not_noted(tmp_path: Path) -> None:
    study, values = exports.single(tmp_path, gravity=GRAVITY)
    assert not any("rotors" in note for note in to_urdf(exports.arm_of(study, values)).notes)


@pytest.mark.parametrize("motions", exports.MOTIONS)
def test_pinocchio_has_inertia_and_gravity_of_a_chain(
    motions: exports.Motions, tmp_path: Path
) -> None:
    pinocchio = pytest.importorskip("pinocchio", reason="Pinocchio is not installed (extra: bench)")
    study, values = exports.chain(tmp_path, ("rigid",) * 3, motions)
    values = without_rotors(values)
    model = pinocchio.buildModelFromXML(to_urdf(exports.arm_of(study, values)).data.decode())
    model.gravity.linear = np.array(study.arm.gravity)
    data, arm = model.createData(), Arm.of(study.arm)
    base, rest = np.array([values[key] for key in arm.base_names]), np.zeros((1, 3))
    for angle in np.random.default_rng(3).uniform(-2.0, 2.0, (10, 3)):
        # a continuous joint has cosine and sine as coordinates
        q = pinocchio.integrate(model, pinocchio.neutral(model), angle)
        M = np.triu(pinocchio.crba(model, data, q))
        np.testing.assert_allclose(M, np.triu(arm.inertia_matrix(base, angle)), atol=1e-12)
        torque = arm.link_torques(base, angle[None], rest, rest)[0]
        gravity = pinocchio.computeGeneralizedGravity(model, data, q)
        np.testing.assert_allclose(gravity, torque, atol=1e-11)


def test_pinocchio_has_the_limits_of_the_joints(tmp_path: Path) -> None:
    pinocchio = pytest.importorskip("pinocchio", reason="Pinocchio is not installed (extra: bench)")
    study, values = exports.chain(tmp_path, motions=("revolute", "prismatic", "revolute"))
    limits = JointLimits(-1.5, 2.0, 3.0, 80.0), JointLimits(0.1, 0.6), JointLimits(None, None, 2.5)
    joints = (replace(j, limits=each) for j, each in zip(study.arm.joints, limits, strict=True))
    study = replace(study, arm=study.arm.with_joints(joints))
    export = to_urdf(exports.arm_of(study, values))
    model = pinocchio.buildModelFromXML(export.data.decode())
    # the third joint is continuous: cosine and sine
    np.testing.assert_allclose(model.lowerPositionLimit[:2], [-1.5, 0.1])
    np.testing.assert_allclose(model.upperPositionLimit[:2], [2.0, 0.6])
    np.testing.assert_allclose(model.upperVelocityLimit, [3.0, 1e6, 2.5])
    np.testing.assert_allclose(model.upperEffortLimit, [80.0, 1e6, 1e6])
    (tmp_path / "arm.urdf").write_bytes(export.data)
    read = [joint.limits for joint in read_urdf(tmp_path / "arm.urdf")]
    assert read[0] == limits[0]
    assert read[2] == JointLimits(None, None, 2.5, 1e6)


def test_the_reader_of_studies_reads_an_exported_chain(tmp_path: Path) -> None:
    """Frames, axes, names and inertial values, to rounding."""
    study, values = exports.chain(tmp_path, ("rigid",) * 3)
    values = without_rotors(values)
    study = replace(study, arm=study.arm.with_joint(2, name="elbow & wrist"))
    export = to_urdf(exports.arm_of(study, values))
    (tmp_path / "arm.urdf").write_bytes(export.data)
    read = read_urdf(tmp_path / "arm.urdf")
    assert [joint.name for joint in read] == ["joint1", "elbow & wrist", "joint3"]
    for number, (joint, wanted) in enumerate(zip(read, study.arm.joints, strict=True), start=1):
        assert (joint.origin, joint.axis, joint.motion) == (
            wanted.origin, wanted.axis, wanted.motion
        )  # fmt: skip
        prior = dict(zip(core_order(number), joint.prior, strict=True))
        for key, value in prior.items():
            assert value == pytest.approx(values[key], rel=1e-9, abs=1e-12), key


def core_order(number: int) -> list[tuple[str, int]]:
    return [(f"link_{name}", number) for name in LINK_PARAMETERS]


def test_coupled_motors_are_seen_from_each_joint(tmp_path: Path) -> None:
    """Motor 2 turns with joints 1 and 2, so joint 1 has its friction and inertia in addition."""
    study, values = exports.chain(tmp_path, coupling=exports.COUPLING)
    export = to_urdf(exports.arm_of(study, values))
    speeds = np.linalg.inv(Arm.of(study.arm).transmission)[:, 0]
    damping = number(ET.fromstring(export.data), "joint[@name='joint1']/dynamics", "damping")
    # friction due to other joints is no function of this joint's velocity
    assert damping == pytest.approx(0.4 + 3e-4 * float(speeds @ speeds), rel=0.1)
    assert any("transmission" in note for note in export.notes)


def test_bodies_without_identified_base_parameters_are_reported(tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path)
    (warning,) = to_urdf(exports.arm_of(study, values)).warnings
    assert "not identified: grouped_link_inertia_zz 1" in warning.message


def test_a_chain_without_consistent_links_is_refused(tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path)
    for name in LINK_PARAMETERS:
        del values[f"link_{name}", 2]
    with pytest.raises(InvalidInput, match="m2 is missing"):
        to_urdf(exports.arm_of(study, values))
    arm = replace(exports.arm_of(*exports.chain(tmp_path)), standard={})
    with pytest.raises(InvalidInput, match="link_mass of joint 1 is missing"):
        to_urdf(arm)
