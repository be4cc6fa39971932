"""Exported files read by their target's own reader and compared value by value."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

from strainwave.domain import Diagnostic, FloatArray, LinkPrior, Origin, Place

TOLERANCE = 1e-9  # relative; files have all digits, and readers decompose and rotate inertias
_MAX_LISTED = 5  # differences in a message; more have one cause

Value = tuple[str, ArrayLike, ArrayLike]
"""Place of a value in the file, the value in the file, and the value that the reader has."""


@dataclass(frozen=True, slots=True)
class ReadBack:
    """What the reader of a format finds in a file."""

    reader: str  # with its version: "MuJoCo 4.0.0"
    n_values: int = 0  # numbers compared
    differences: tuple[str, ...] = ()  # "gear1 stiffness: 25000.0 in the file, 1.0 read"
    problem: str | None = None  # message of a reader that rejects the file

    @property
    def text(self) -> str:
        """One line for the terminal."""
        n = len(self.differences)
        state = f"{n} of {self.n_values} values differ" if n else f"{self.n_values} values agree"
        return f"read back by {self.reader}: {self.problem or state}"

    @property
    def warnings(self) -> tuple[Diagnostic, ...]:
        """A warning if the reader rejects the file or has other values."""
        if self.problem is None and not self.differences:
            return ()
        listed = self.problem or "; ".join(self.differences[:_MAX_LISTED])
        return (Diagnostic("read-back", Place(), reader=self.reader, differences=listed),)


Check = Callable[[Path], ReadBack | None]
"""Reads a written file; None if its reader is not installed."""


def compare(reader: str, values: Iterable[Value], tolerance: float = TOLERANCE) -> ReadBack:
    """Compare values of a file with those that a reader has; sizes of vectors are those read."""
    differences, n_values = list[str](), 0
    for place, written, read in values:
        a, b = (np.atleast_1d(np.asarray(x, dtype=float)).ravel() for x in (written, read))
        n_values += len(a)
        largest = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
        # also where a value is not a number
        if len(a) != len(b) or not np.abs(a - b).max(initial=0.0) <= tolerance * largest:
            differences.append(f"{place}: {_numbers(a)} in the file, {_numbers(b)} read")
    return ReadBack(reader, n_values, tuple(differences))


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{x:.6g}" for x in values.tolist())


# Attributes of MJCF elements and the arrays of a compiled model that hold them. Polynomials have a
# second array, which MuJoCo has had since 3.7.
_BODY = {"pos": ("body_pos",)}
_SITE = {"pos": ("site_pos",)}
_DOF = {
    "damping": ("dof_damping", "dof_dampingpoly"),
    "frictionloss": ("dof_frictionloss",),
    "armature": ("dof_armature",),
    "solreffriction": ("dof_solref",),
    "solimpfriction": ("dof_solimp",),
}
_JOINT = {"stiffness": ("jnt_stiffness", "jnt_stiffnesspoly"), "axis": ("jnt_axis",)}
_TENDON = {
    "stiffness": ("tendon_stiffness", "tendon_stiffnesspoly"),
    "damping": ("tendon_damping", "tendon_dampingpoly"),
    "springlength": ("tendon_lengthspring",),
    "springyield": ("tendon_springyield",),
    "frictionloss": ("tendon_frictionloss",),
    "armature": ("tendon_armature",),
    "solreffriction": ("tendon_solref_fri",),
    "solimpfriction": ("tendon_solimp_fri",),
}
_ACTUATOR = {
    "gear": ("actuator_gear",),
    "gainprm": ("actuator_gainprm",),
    "biasprm": ("actuator_biasprm",),
    "dynprm": ("actuator_dynprm",),
    "forcerange": ("actuator_forcerange",),
    "delay": ("actuator_delay",),
}


def by_mujoco(path: Path) -> ReadBack | None:
    """MJCF read by the installed MuJoCo; None without it."""
    if find_spec("mujoco") is None:
        return None
    import mujoco

    reader = f"MuJoCo {mujoco.__version__}"
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        return ReadBack(reader, problem=" ".join(str(error).split()))
    return compare(reader, _of_mjcf(model, ET.parse(path).getroot()))


def _of_mjcf(model: Any, root: ET.Element) -> Iterator[Value]:
    option = root.find("option")
    assert option is not None
    yield "timestep", _vector(option, "timestep"), model.opt.timestep
    yield "gravity", _vector(option, "gravity"), model.opt.gravity
    for body in root.iter("body"):
        name, number = body.attrib["name"], model.body(body.attrib["name"]).id
        yield from _attributes(model, body, number, _BODY)
        if "euler" in body.attrib:
            read = _rotation(model.body_quat[number])
            yield f"{name} euler", rotation_of(_vector(body, "euler")), read
        inertial = body.find("inertial")
        assert inertial is not None
        axes = _rotation(model.body_iquat[number])
        inertia = axes @ np.diag(model.body_inertia[number]) @ axes.T
        yield f"{name} mass", _vector(inertial, "mass"), model.body_mass[number]
        yield f"{name} centre", _vector(inertial, "pos"), model.body_ipos[number]
        six = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        yield f"{name} inertia", _vector(inertial, "fullinertia"), six
        for joint in body.findall("joint"):
            at = model.joint(joint.attrib["name"]).id
            yield from _attributes(model, joint, at, _JOINT)
            yield from _attributes(model, joint, model.jnt_dofadr[at], _DOF)
            if "springref" in joint.attrib:
                rest = model.qpos_spring[model.jnt_qposadr[at]]
                yield f"{joint.attrib['name']} springref", _vector(joint, "springref"), rest
        for site in body.findall("site"):
            at = model.site(site.attrib["name"]).id
            yield from _attributes(model, site, at, _SITE)
            if "euler" in site.attrib:
                place, read = f"{site.attrib['name']} euler", _rotation(model.site_quat[at])
                yield place, rotation_of(_vector(site, "euler")), read
    for fixed in root.iterfind("tendon/fixed"):
        at = model.tendon(fixed.attrib["name"]).id
        yield from _attributes(model, fixed, at, _TENDON)
        first, last = model.tendon_adr[at] + np.array([0, model.tendon_num[at]])
        coefficients = [float(joint.attrib["coef"]) for joint in fixed.findall("joint")]
        yield f"{fixed.attrib['name']} coef", coefficients, model.wrap_prm[first:last]
    for actuator in root.iterfind("actuator/*"):
        at = model.actuator(actuator.attrib["name"]).id
        yield from _attributes(model, actuator, at, _ACTUATOR)
        name = actuator.attrib["name"]
        if "ctrlrange" in actuator.attrib:  # MuJoCo 4 has actuators with several controls or none
            control = model.actuator_ctrladr[at] if hasattr(model, "actuator_ctrladr") else at
            read = model.actuator_ctrlrange[control]
            yield f"{name} ctrlrange", _vector(actuator, "ctrlrange"), read


def _attributes(
    model: Any, element: ET.Element, at: int, fields: Mapping[str, tuple[str, ...]]
) -> Iterator[Value]:
    for name in fields.keys() & element.attrib.keys():
        written = _vector(element, name)
        if name == "axis":
            written /= np.linalg.norm(written)
        present = [field for field in fields[name] if hasattr(model, field)]
        parts = [np.atleast_1d(getattr(model, field)[at]) for field in present]
        read = np.concatenate(parts)[: len(written)] if parts else np.zeros(0)
        if name == "springlength" and len(written) == 1:
            read = read[:1]
        yield f"{element.attrib['name']} {name}", written, read


def _vector(element: ET.Element, name: str) -> FloatArray:
    return np.array(element.attrib[name].split(), dtype=float)


def _rotation(quaternion: FloatArray) -> FloatArray:
    w, *vector = quaternion.tolist()
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + 2.0 * (w * cross + cross @ cross))


def rotation_of(angles: FloatArray) -> FloatArray:
    """Rotation of roll, pitch and yaw about fixed axes, as in URDF: `eulerseq` XYZ of MJCF."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(about_z @ about_y @ about_x)


_LIMITS = {
    "lower": "lowerPositionLimit",
    "upper": "upperPositionLimit",
    "velocity": "upperVelocityLimit",
    "effort": "upperEffortLimit",
}


@dataclass(frozen=True, slots=True)
class UrdfValues:
    """Values that a URDF has by joint: what Pinocchio must read from the file."""

    names: tuple[str, ...]
    links: tuple[LinkPrior, ...]  # moving link with those fixed to it, in the joint's frame
    friction: tuple[tuple[float, float], ...]  # damping and dry friction of the joint
    limits: tuple[Mapping[str, float], ...]  # attributes of `<limit>`; none: continuous
    origins: tuple[Origin, ...] | None = None  # of the joints; None: others move between them
    rotors: tuple[float, ...] | None = None  # armature; None: the file has no `rotor_params`


def by_pinocchio(path: Path, values: UrdfValues) -> ReadBack | None:
    """URDF read by the installed Pinocchio; None without it."""
    if find_spec("pinocchio") is None:
        return None
    import pinocchio

    reader = f"Pinocchio {pinocchio.__version__}"
    try:
        model = pinocchio.buildModelFromUrdf(str(path))
        if values.rotors is not None:
            pinocchio.loadRotorParameters(model, str(path))
    except (ValueError, RuntimeError) as error:
        return ReadBack(reader, problem=" ".join(str(error).split()))
    return compare(reader, _of_urdf(model, values))


def _of_urdf(model: Any, values: UrdfValues) -> Iterator[Value]:
    for i, name in enumerate(values.names):
        if not model.existJointName(name):
            yield f"{name} in the file", 1.0, 0.0
            continue
        number = model.getJointId(name)
        at = model.joints[number].idx_v
        yield f"{name} link", values.links[i], model.inertias[number].toDynamicParameters()
        damping, dry = values.friction[i]
        yield f"{name} damping", damping, model.damping[at]
        yield f"{name} friction", dry, model.upperDryFrictionLimit[at]
        for limit, field in _LIMITS.items():
            if limit in values.limits[i]:
                k = model.joints[number].idx_q if limit in ("lower", "upper") else at
                yield f"{name} {limit}", values.limits[i][limit], getattr(model, field)[k]
        if values.origins is not None:
            origin, placement = values.origins[i], model.jointPlacements[number]
            yield f"{name} xyz", origin.xyz, placement.translation
            yield f"{name} rpy", rotation_of(np.array(origin.rpy)), placement.rotation
        if values.rotors is not None:
            yield f"{name} rotor", values.rotors[i], model.armature[at]
