"""A load for robot controllers and models: UR, Franka, KUKA, ROS, URDF, study files.

All values are in the frame of the last link, that of the last joint as the study places it. Mass
and centre are the estimates; inertias are those of the nearest physically consistent body. Entries
of it that the data do not determine are listed as assumed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from strainwave.domain import ArmDescription, FloatArray, PayloadEstimate
from strainwave.domain.arm.kinds.base import Body
from strainwave.io.urdf import child_link
from strainwave.version import __version__

SCHEMA = "strainwave/payload/1"
FILE_NAME = "payload.json"


def payload_exports(estimate: PayloadEstimate) -> dict[str, str]:
    """The load as text for each target; empty if there is no load to be set."""
    if estimate.body is None:
        return {}
    body = Body.of_standard(estimate.body)
    m, (x, y, z) = number(body.mass), map(number, body.centre)
    moments = dict(zip(("xx", "yy", "zz", "xy", "xz", "yz"), body.inertia, strict=True))
    xx, yy, zz, xy, xz, yz = map(number, body.inertia)
    matrix = np.array([[moments["".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])
    by_columns = _array(matrix.T.ravel())
    return {
        "urdf": _urdf(body, estimate.study.arm),
        "ur_set_target_payload": f"set_target_payload({m}, [{x}, {y}, {z}], "
        f"[{xx}, {yy}, {zz}, {xy}, {xz}, {yz}])",
        "franka_set_load": f"robot.setLoad({m}, {_array(body.centre)}, {by_columns});",
        "kuka_load": _kuka(body, matrix),
        "ros_ur_set_payload": f"{{mass: {m}, center_of_gravity: {{x: {x}, y: {y}, z: {z}}}}}",
        "study": f"payload = {{ mass = {m}, xyz = [{x}, {y}, {z}] }}",
    }


def _array(values: Iterable[float]) -> str:
    """A `std::array` of C++."""
    return "{{" + ", ".join(map(number, values)) + "}}"


def number(value: float) -> str:
    """A value with seven digits and a decimal point, as all targets read it."""
    text = f"{round(value, 9) + 0.0:.7g}"  # neither rounding errors nor -0.0
    return text if any(c in text for c in ".e") else f"{text}.0"


def _urdf(body: Body, arm: ArmDescription) -> str:
    """A link that is fixed to the last one, in the frame of that link."""
    parent = f"link{arm.n_joints}"
    if arm.urdf is not None and (path := Path(arm.urdf.file)).is_file():
        parent = child_link(path, arm.joint_names[-1]) or parent
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    x, y, z = map(number, body.centre)
    inertia = " ".join(f'{n}="{number(v)}"' for n, v in zip(names, body.inertia, strict=True))
    return f"""\
<link name="payload">
  <inertial>
    <origin xyz="{x} {y} {z}" rpy="0 0 0" />
    <mass value="{number(body.mass)}" />
    <inertia {inertia} />
  </inertial>
</link>
<joint name="payload_mount" type="fixed">
  <parent link={quoteattr(parent)} />
  <child link="payload" />
  <origin xyz="0 0 0" rpy="0 0 0" />
</joint>"""


def _kuka(body: Body, inertia: FloatArray) -> str:
    """$LOAD: kg, mm, degrees, kg m^2; A, B, C turn to the principal axes, R = Rz(A) Ry(B) Rx(C)."""
    moments, axes = np.linalg.eigh(inertia)
    # of the axes of either sign in any order, those nearest to the axes of the link
    order = _nearest_order(axes)
    moments, axes = moments[order], axes[:, order]
    axes = axes * np.where(np.diag(axes) < 0.0, -1.0, 1.0)
    if np.linalg.det(axes) < 0.0:
        weakest = int(np.argmin(np.abs(np.diag(axes))))
        axes[:, weakest] *= -1.0
    a, c = math.atan2(axes[1, 0], axes[0, 0]), math.atan2(axes[2, 1], axes[2, 2])
    b = math.atan2(-axes[2, 0], math.hypot(axes[0, 0], axes[1, 0]))
    A, B, C = (number(math.degrees(angle)) for angle in (a, b, c))
    X, Y, Z = (number(1e3 * coordinate) for coordinate in body.centre)
    J = [number(float(moment)) for moment in moments]
    return (
        f"$LOAD = {{M {number(body.mass)}, CM {{X {X}, Y {Y}, Z {Z}, A {A}, B {B}, C {C}}}, "
        f"J {{X {J[0]}, Y {J[1]}, Z {J[2]}}}}}"
    )


def _nearest_order(axes: FloatArray) -> list[int]:
    """The order of principal axes, columns, in which they are nearest to x, y, z."""
    from itertools import permutations

    orders = map(list, permutations(range(3)))
    return max(orders, key=lambda order: float(np.sum(np.diag(axes[:, order]) ** 2)))


def payload_document(estimate: PayloadEstimate) -> dict[str, Any]:
    """payload.json: the load as plain JSON values."""
    quantities = asdict(estimate.quantities)
    stated = estimate.stated and {"mass": estimate.stated.mass, "xyz": estimate.stated.xyz}
    return {
        "schema": SCHEMA,
        "version": __version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "study": {"path": str(estimate.study.path), "sha256": estimate.study.sha256},
        "result": {"path": str(estimate.result)},
        "records": estimate.records,
        "frame": f"link {estimate.study.arm.n_joints}",
        **quantities,
        "stated": stated,
        "torque_scale": estimate.torque_scale and asdict(estimate.torque_scale),
        "warnings": [
            {"code": each.code, "where": each.where, "message": each.message}
            for each in estimate.warnings
        ],
        "export": payload_exports(estimate),
        "assumed": estimate.assumed,
    }
