"""Read the joints and the inertial values of an arm from a URDF file.

Fixed joints are merged into the link before them; meshes, transmissions and plugins are ignored.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.dom import minidom
from xml.etree import ElementTree

import numpy as np

from strainwave.domain import FloatArray, JointLimits, LinkPrior, Motion, Origin
from strainwave.domain.arm.consistent_links import is_consistent, standard_parameters
from strainwave.domain.arm.kinds.base import Body
from strainwave.domain.arm.link_sensors.link_space import angles, attitude
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import decode, read_bytes

_MOTIONS: Mapping[str, Motion] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
}

_XACRO_MARKS = ("xacro", "${", "$(")  # macros, expressions, arguments
_READ_ELEMENTS = ("link", "joint")  # others, such as plugins, may hold any text


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint that moves, and the link that it carries."""

    name: str
    motion: Motion
    origin: Origin  # in the frame of the previous moving joint
    axis: tuple[float, float, float]
    prior: LinkPrior  # of everything that is fixed to the joint's link
    limits: JointLimits | None = None


@dataclass(frozen=True)
class _Element:
    """One `<joint>`: its name, type, links and placement."""

    xml: ElementTree.Element
    name: str
    kind: str
    parent: str
    child: str
    held: bool  # at zero, as if it were fixed

    @property
    def moves(self) -> bool:
        return self.kind != "fixed" and not self.held


def read_urdf(path: Path, held: Collection[str] = ()) -> tuple[UrdfJoint, ...]:
    """The moving joints of a URDF file, from the base; joints named in `held` stay at zero.

    Raises InvalidInput if the file is not a URDF, if its joints are not one serial chain, or if it
    has no joint of a name in `held`.
    """
    return _LinkWalk(path, _root(path), held).chain()


def child_link(path: Path, joint: str) -> str | None:
    """Name of the link that a joint of a URDF file carries; None without such a joint."""
    elements = (each for each in _root(path).iter("joint") if each.get("name") == joint)
    children = (each.find("child") for each in elements)
    return next((child.get("link") for child in children if child is not None), None)


def patch_urdf(
    path: Path,
    held: Collection[str],
    links: Sequence[LinkPrior],
    friction: Sequence[tuple[float, float]],
    notes: Iterable[str],
) -> bytes:
    """The file with other inertial values, and damping and friction of the moving joints.

    `links` are the standard parameters of what each moving joint carries. Links that are fixed to
    another keep their own if the rest is a body; otherwise the first one has everything. All
    other contents stay; `notes` become comments.
    """
    reader = _LinkWalk(path, _root(path), held)
    document = minidom.parseString(read_bytes(path, "the URDF"))
    (robot,) = _children(document, "robot")
    elements = {each.getAttribute("name"): each for each in _children(robot, "link")}
    joints = {each.getAttribute("name"): each for each in _children(robot, "joint")}
    for (_, joint), link, values in zip(reader.moving(), links, friction, strict=True):
        fixed = reader.fixed_to(joint.child)
        rest = tuple((np.array(link) - reader.merged(fixed)).tolist())
        has_rest = is_consistent(rest)
        for name in () if has_rest else fixed:
            for inertial in _children(elements[name], "inertial"):
                elements[name].removeChild(inertial)
        body = Body.of_standard(rest if has_rest else link)
        entries = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), body.inertia, strict=True)
        inertial = _child(document, elements[joint.child], "inertial")
        for tag, attributes in (
            ("origin", {"xyz": _text(*body.centre), "rpy": "0 0 0"}),
            ("mass", {"value": _text(body.mass)}),
            ("inertia", {key: _text(value) for key, value in entries}),
        ):
            _set(document, inertial, tag, attributes)
        damping, dry = map(_text, values)
        _set(document, joints[joint.name], "dynamics", {"damping": damping, "friction": dry})
    for note in reversed(tuple(notes)):
        comment = document.createComment(f" {note.replace('--', '-')} ")
        robot.insertBefore(comment, robot.firstChild)
        robot.insertBefore(document.createTextNode("\n  "), comment)
    nodes = ['<?xml version="1.0" encoding="utf-8"?>', *(n.toxml() for n in document.childNodes)]
    return "\n".join([*nodes, ""]).encode()


def _children(parent: minidom.Element | minidom.Document, tag: str) -> list[minidom.Element]:
    nodes = (node for node in parent.childNodes if isinstance(node, minidom.Element))
    return [node for node in nodes if node.tagName == tag]


def _child(document: minidom.Document, parent: minidom.Element, tag: str) -> minidom.Element:
    """The child element of a name, which is added if there is none."""
    for child in _children(parent, tag):
        return child
    return parent.appendChild(document.createElement(tag))


def _set(
    document: minidom.Document, parent: minidom.Element, tag: str, values: Mapping[str, str]
) -> None:
    child = _child(document, parent, tag)
    for key, value in values.items():
        child.setAttribute(key, value)


def _text(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


def read_chains(path: Path) -> tuple[list[tuple[str, ...]], list[str]]:
    """Names of the moving joints of a robot, which may be a tree, and of its mimic joints.

    The chains go from the base to each end, without mimic joints. Raises InvalidInput if the file
    is not a URDF.
    """
    return _LinkWalk(path, _root(path), ()).chains()


def _root(path: Path) -> ElementTree.Element:
    """The outermost element of a URDF without xacro macros."""
    text = decode(read_bytes(path, "the URDF"), path)
    expand = InvalidInput(
        "this file contains xacro macros",
        where=str(path),
        remedy=f"expand them: xacro {path.name} > robot.urdf",
    )
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        if "<xacro:" in text:  # a prefix without a namespace
            raise expand from error
        raise InvalidInput(
            f"this is not XML: {error}", where=str(path), remedy="export the URDF again"
        ) from error
    if root.tag != "robot":
        raise InvalidInput(
            f"the outermost element is <{root.tag}>, not <robot>",
            where=str(path),
            remedy="give the URDF of the robot",
        )
    read = [each for element in root if element.tag in _READ_ELEMENTS for each in element.iter()]
    texts = [text for each in read for text in (each.tag, *each.attrib.values())]
    if any("xacro" in child.tag for child in root) or any(
        mark in text for text in texts for mark in _XACRO_MARKS
    ):
        raise expand
    return root


class _LinkWalk:
    """Walks the links of one file from the base."""

    def __init__(self, path: Path, root: ElementTree.Element, held: Collection[str]) -> None:
        self._path, self._held = path, held
        self._links = {link.get("name", ""): link for link in root.findall("link")}
        self._joints = [self._element(joint) for joint in root.findall("joint")]
        unknown = [name for name in held if name not in [joint.name for joint in self._joints]]
        if unknown:
            raise self._fault(f"there is no joint {unknown[0]!r} to hold", "correct its name")

    def chain(self) -> tuple[UrdfJoint, ...]:
        base = self._base()
        for name in self.mimics():
            raise self._fault(
                f"joint {name!r} mimics another joint",
                'set its type to "fixed", or hold it at zero: arm.held in the study',
            )
        self._merged(base)  # the base has no parameters, but its joints are checked
        joints = [
            self._moving(joint, frame, self._merged(joint.child)) for frame, joint in self.moving()
        ]
        if not joints:
            raise self._fault("no joint moves", "set the types of the moving joints")
        return tuple(joints)

    def moving(self) -> Iterator[tuple[FloatArray, _Element]]:
        """Yield the joints that move, from the base, and the frames in which they are placed."""
        link = self._base()
        while (placed := self._next(link)) is not None:
            yield placed
            link = placed[1].child

    def mimics(self) -> list[str]:
        """Names of the moving joints that follow another joint."""
        return [j.name for j in self._joints if j.moves and j.xml.find("mimic") is not None]

    def fixed_to(self, link: str) -> dict[str, FloatArray]:
        """Links that are fixed to a link, with their frames in its frame (4, 4)."""
        frames: dict[str, FloatArray] = {}
        for joint in self._joints:
            if joint.parent == link and not joint.moves:
                frame = self._placement(joint.xml)
                others = self.fixed_to(joint.child).items()
                frames |= {joint.child: frame, **{name: frame @ inner for name, inner in others}}
        return frames

    def merged(self, frames: Mapping[str, FloatArray]) -> FloatArray:
        """Sum of the inertial values of links with their frames in one frame: (10,)."""
        inertials = [self._inertial(link, frame) for link, frame in frames.items()]
        return np.asarray(np.sum([np.zeros(10), *map(np.array, inertials)], axis=0))

    def chains(self) -> tuple[list[tuple[str, ...]], list[str]]:
        mimics = self.mimics()
        links, chains = [(self._base(), tuple[str, ...]())], list[tuple[str, ...]]()
        while links:
            link, chain = links.pop(0)
            moving = [joint for _, joint in self._below(link) if joint.moves]
            moving = [joint for joint in moving if joint.name not in mimics]
            links += [(joint.child, (*chain, joint.name)) for joint in moving]
            if not moving:
                chains.append(chain)
        return chains, mimics

    def _element(self, xml: ElementTree.Element) -> _Element:
        name, kind = xml.get("name", ""), xml.get("type", "")
        parent, child = xml.find("parent"), xml.find("child")
        if parent is None or child is None:
            raise self._fault(f"joint {name!r} has no parent or child", "name both links")
        links = parent.get("link", ""), child.get("link", "")
        element = _Element(xml, name, kind, *links, held=name in self._held)
        for link in (element.parent, element.child):
            if link not in self._links:
                raise self._fault(
                    f"joint {name!r} names the link {link!r}, which does not exist",
                    "correct the name",
                )
        if kind not in (*_MOTIONS, "fixed") and not element.held:
            raise self._fault(
                f"joint {name!r} is of type {kind!r}",
                "use revolute, continuous, prismatic or fixed joints",
            )
        return element

    def _base(self) -> str:
        children: dict[str, str] = {}
        for joint in self._joints:
            if joint.child in children:
                raise self._fault(
                    f"link {joint.child!r} hangs on the joints {children[joint.child]!r} and "
                    f"{joint.name!r}: the arm is a closed loop",
                    "remove one of them; only serial chains can be identified",
                )
            children[joint.child] = joint.name
        bases = [name for name in self._links if name not in children]
        if len(bases) != 1:
            listed = ", ".join(map(repr, bases)) or "none"
            raise self._fault(
                f"one link must be the base, but the links without a parent are {listed}",
                "connect all links by joints in one chain",
            )
        return bases[0]

    def _below(self, link: str) -> list[tuple[FloatArray, _Element]]:
        """Joints on a link and on all links fixed to it, with the frames of their parents."""
        frames = {link: np.eye(4), **self.fixed_to(link)}
        return [(frames[j.parent], j) for j in self._joints if j.parent in frames]

    def _next(self, link: str) -> tuple[FloatArray, _Element] | None:
        """The joint that moves after a link, and the frame in which it is placed."""
        moving = [(frame, joint) for frame, joint in self._below(link) if joint.moves]
        if len(moving) > 1:
            first, second = (joint.name for _, joint in moving[:2])
            raise self._fault(
                f"the joints {first!r} and {second!r} both move on link {link!r}: the robot is a "
                "tree",
                'set the type of all joints outside one chain to "fixed", or hold them at zero: '
                "arm.held in the study",
            )
        return moving[0] if moving else None

    def _moving(self, joint: _Element, frame: FloatArray, prior: LinkPrior) -> UrdfJoint:
        axis = self._vector(joint.xml.find("axis"), "xyz", (1.0, 0.0, 0.0), joint.name)
        if not any(axis):
            raise self._fault(
                f"the axis of joint {joint.name!r} has length zero",
                'set its direction, such as <axis xyz="0 0 1"/>',
            )
        origin = self._origin(joint.xml)
        if not np.array_equal(frame, np.eye(4)):  # the file's angles are exact otherwise
            placed = frame @ self._placement(joint.xml)
            origin = Origin(_vector_of(placed[:3, 3]), _vector_of(angles(placed[:3, :3])))
        return UrdfJoint(joint.name, _MOTIONS[joint.kind], origin, axis, prior, self._limits(joint))

    def _limits(self, joint: _Element) -> JointLimits | None:
        """Limits of a joint; files write zero for an unknown velocity or effort."""
        limit = joint.xml.find("limit")
        if limit is None:
            return None
        lower, upper, velocity, effort = (
            self._number(limit, key, joint.name) for key in ("lower", "upper", "velocity", "effort")
        )
        if joint.kind == "continuous" or lower == upper:
            lower = upper = None
        return JointLimits(lower, upper, velocity or None, effort or None)

    def _merged(self, link: str) -> LinkPrior:
        """Inertial values of a link and of all links fixed to it, in the frame of the first."""
        return tuple(self.merged({link: np.eye(4), **self.fixed_to(link)}).tolist())

    def _inertial(self, link: str, frame: FloatArray) -> LinkPrior:
        """Mass, first moments and inertias of one link about the origin of `frame`'s base."""
        inertial = self._links[link].find("inertial")
        if inertial is None:
            return (0.0,) * 10
        mass = self._number(inertial.find("mass"), "value", link) or 0.0
        tensor, about_centre = inertial.find("inertia"), np.zeros((3, 3))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            entry = self._number(tensor, f"i{'xyz'[i]}{'xyz'[j]}", link) or 0.0
            about_centre[i, j] = about_centre[j, i] = entry
        placed = frame @ self._placement(inertial)
        axes = placed[:3, :3]
        return standard_parameters(mass, placed[:3, 3], axes @ about_centre @ axes.T)

    def _placement(self, xml: ElementTree.Element) -> FloatArray:
        """Frame of the `<origin>` of an element, as a matrix (4, 4)."""
        origin, frame = self._origin(xml), np.eye(4)
        frame[:3, :3], frame[:3, 3] = attitude(origin.rpy), origin.xyz
        return frame

    def _origin(self, xml: ElementTree.Element) -> Origin:
        name, origin, zero = xml.get("name", ""), xml.find("origin"), (0.0, 0.0, 0.0)
        return Origin(*(self._vector(origin, key, zero, name) for key in ("xyz", "rpy")))

    def _vector(
        self,
        xml: ElementTree.Element | None,
        key: str,
        default: tuple[float, float, float],
        name: str,
    ) -> tuple[float, float, float]:
        values = self._numbers(xml, key, name, 3)
        return default if values is None else (values[0], values[1], values[2])

    def _number(self, xml: ElementTree.Element | None, key: str, name: str) -> float | None:
        values = self._numbers(xml, key, name, 1)
        return None if values is None else values[0]

    def _numbers(
        self, xml: ElementTree.Element | None, key: str, name: str, count: Literal[1, 3]
    ) -> list[float] | None:
        text = None if xml is None else xml.get(key)
        if text is None:
            return None
        try:
            values = [float(part) for part in text.split()]
        except ValueError:
            values = []
        if len(values) != count or not np.isfinite(values).all():
            expected = "a number" if count == 1 else "three numbers"
            raise self._fault(f"{key}={text!r} of {name!r} is not {expected}", "correct it")
        return values

    def _fault(self, problem: str, remedy: str) -> InvalidInput:
        return InvalidInput(problem, where=str(self._path), remedy=remedy)


def _vector_of(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
