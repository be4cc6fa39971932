"""URDF files: chains, fixed joints, inertial values, and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from strainwave import InvalidInput
from strainwave.domain import JointLimits
from strainwave.domain.arm.consistent_links import is_consistent, standard_parameters
from strainwave.io.urdf import patch_urdf, read_urdf

pinocchio = pytest.importorskip("pinocchio")

_INERTIAL = (
    '<inertial><origin xyz="0.1 0.02 -0.05" rpy="0.3 -0.2 0.5"/><mass value="{mass}"/>'
    '<inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.04" iyz="0.003" izz="0.02"/></inertial>'
)


def _link(name: str, mass: float | None = None) -> str:
    return f'<link name="{name}">{_INERTIAL.format(mass=mass) if mass else ""}</link>'


def _joint(name: str, parent: str, child: str, kind: str = "revolute", extra: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 -0.2 0.3" rpy="0.4 0.1 -0.6"/><axis xyz="0 1 0"/>{extra}</joint>'
    )


_LIMIT = '<limit lower="0" upper="0.5" effort="10" velocity="1"/>'
_ARM = "".join(
    [
        _link("world"),
        _link("base", 5.0),
        _link("upper", 3.0),
        _link("flange", 0.4),
        _link("lower", 2.0),
        _link("tool", 1.0),
        _joint("mount", "world", "base", "fixed"),
        _joint("shoulder", "base", "upper", extra=_LIMIT),
        _joint("bolt", "upper", "flange", "fixed"),
        _joint("slide", "flange", "lower", "prismatic", _LIMIT),
        _joint("grip", "lower", "tool", "fixed"),
    ]
)


def _write(folder: Path, content: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{content}</robot>')
    return path


def test_fixed_joints_are_merged_as_in_pinocchio(tmp_path: Path) -> None:
    path = _write(tmp_path, _ARM)
    joints = read_urdf(path)
    model = pinocchio.buildModelFromUrdf(str(path))
    assert [joint.name for joint in joints] == list(model.names)[1:]
    assert [joint.motion for joint in joints] == ["revolute", "prismatic"]
    assert joints[1].limits == JointLimits(0.0, 0.5, 1.0, 10.0)
    for k, joint in enumerate(joints, start=1):
        placed = model.jointPlacements[k]
        np.testing.assert_allclose(joint.origin.xyz, placed.translation, atol=1e-14)
        rotation = pinocchio.rpy.rpyToMatrix(*joint.origin.rpy)
        np.testing.assert_allclose(rotation, placed.rotation, atol=1e-14)
        assert is_consistent(joint.prior)
        # both have mass, first moments, and xx, xy, yy, xz, yz, zz about the joint's frame
        dynamic = model.inertias[k].toDynamicParameters()
        np.testing.assert_allclose(joint.prior, dynamic, atol=1e-14)


def test_a_right_angle_of_pitch_keeps_the_angles_of_the_file(tmp_path: Path) -> None:
    joint = _joint("a", "base", "b").replace('rpy="0.4 0.1 -0.6"', 'rpy="0.2 1.5707963267948966 0"')
    assert read_urdf(_write(tmp_path, _link("base") + _link("b") + joint))[0].origin.rpy == (
        0.2,
        1.5707963267948966,
        0.0,
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (_ARM + _link("finger") + _joint("f", "tool", "finger"), None),
        (_ARM + _link("finger") + _joint("f", "flange", "finger"), "is a tree"),
        (_ARM + _joint("loop", "tool", "upper"), "closed loop"),
        (_ARM.replace(_LIMIT, _LIMIT + '<mimic joint="slide"/>', 1), "mimics"),
        (_ARM.replace('"revolute"', '"floating"'), "'floating'"),
        (_ARM.replace('axis xyz="0 1 0"', 'axis xyz="0 0 0"'), "length zero"),
        (_ARM.replace('child link="tool"', 'child link="hand"'), "does not exist"),
        (_ARM.replace('rpy="0.4 0.1 -0.6"', 'rpy="0.4 0.1"'), "three numbers"),
        (_ARM.replace('mass value="2.0"', 'mass value="two"'), "not a number"),
        (_link("alone"), "no joint moves"),
        ("<xacro:macro/>", "xacro robot.urdf"),
        (_ARM.replace("0.4 0.1 -0.6", "${pi/2} 0 0"), "xacro robot.urdf"),
    ],
)
def test_refusals_name_file_and_remedy(tmp_path: Path, content: str, message: str | None) -> None:
    path = _write(tmp_path, content)
    if message is None:
        assert len(read_urdf(path)) == 3
        return
    with pytest.raises(InvalidInput) as caught:
        read_urdf(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_fixed_joint_may_mimic_another(tmp_path: Path) -> None:
    """The remedy for a joint that mimics another is to fix it."""
    finger = _joint("f", "tool", "finger", "fixed", '<mimic joint="slide"/>')
    assert len(read_urdf(_write(tmp_path, _ARM + _link("finger") + finger))) == 2


def test_a_file_that_is_not_a_urdf_is_refused(tmp_path: Path) -> None:
    for content, message in (("<sdf/>", "<sdf>"), ("no xml", "not XML")):
        (tmp_path / "robot.urdf").write_text(content)
        with pytest.raises(InvalidInput, match=message):
            read_urdf(tmp_path / "robot.urdf")


PATCHED = """<?xml version="1.0"?>
<!-- drawn by a colleague -->
<robot name="two" xmlns:drake="http://drake.mit.edu">
  <material name="grey"/>
  <link name="base"/>
  <link name="upper"><visual><geometry><mesh filename="package://upper.stl"/></geometry></visual></link>
  <link name="lower"><inertial><mass value="9"/></inertial></link>
  <!-- the tool -->
  <link name="tool"><inertial>
    <mass value="0.5"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
  </inertial></link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="2" effort="9" velocity="3"/>
    <dynamics damping="7" drake:extra="1"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="lower"/><child link="tool"/><origin xyz="0.2 0 0.1" rpy="0 1 0"/>
  </joint>
</robot>
"""


@pytest.mark.parametrize("mass", [3.0, 0.2])
def test_a_patched_file_changes_inertial_values_and_friction_only(
    mass: float, tmp_path: Path
) -> None:
    """The tool keeps its own inertial values if the rest of the link is a body."""
    path = tmp_path / "arm.urdf"
    path.write_text(PATCHED)
    links = [
        standard_parameters(m, np.array([0.1, 0.02, 0.0]), m * np.diag([0.1, 0.2, 0.25]))
        for m in (4.0, mass)
    ]
    data = patch_urdf(path, (), links, [(1.5, 0.25), (2.0, 0.0)], ["identified -- here"])
    (tmp_path / "patched.urdf").write_bytes(data)
    joints, before = read_urdf(tmp_path / "patched.urdf"), read_urdf(path)
    for joint, link in zip(joints, links, strict=True):
        np.testing.assert_allclose(joint.prior, link, rtol=1e-12, atol=1e-14)
    for new, old in zip(joints, before, strict=True):
        assert replace(new, prior=old.prior) == old
    text = data.decode()
    kept = ("drawn by a colleague", "the tool", "package://upper.stl", 'drake:extra="1"')
    assert all(part in text for part in (*kept, "identified - here", 'name="flange"'))
    assert ('<mass value="0.5"/>' in text) == (mass > 0.5)
    tree = ElementTree.fromstring(text)
    dynamics = [each.attrib for each in tree.iterfind("joint/dynamics")]
    assert [(d["damping"], d["friction"]) for d in dynamics] == [("1.5", "0.25"), ("2.0", "0.0")]
    rest, kept_rest = (_without_values(ElementTree.fromstring(each)) for each in (PATCHED, text))
    assert rest == kept_rest


def _without_values(robot: ElementTree.Element) -> list[tuple[str, dict[str, str]]]:
    """Tags and attributes apart from inertial values and dynamics."""
    for parent in [*robot.iter("link"), *robot.iter("joint")]:
        for tag in ("inertial", "dynamics"):
            for child in parent.findall(tag):
                parent.remove(child)
    return [(each.tag, dict(each.attrib)) for each in robot.iter()]
