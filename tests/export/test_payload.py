"""Texts of a load for controllers and models, each read back by the syntax of its target."""

from __future__ import annotations

import ast
import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import load_records
from serial_chains import parameters_of, random_body
from strainwave.domain import FloatArray, LoadQuantities, Payload, PayloadEstimate
from strainwave.domain.arm.consistent_links import standard_parameters
from strainwave.export.payload import payload_document, payload_exports
from strainwave.io.urdf import read_urdf

NONE = (None,) * 3
PRECISION = 6e-7  # texts have seven digits
URDF = """<robot name="arm"><link name="base" /><link name="link3" />
<joint name="turn" type="continuous"><parent link="base" /><child link="link3" />
<axis xyz="0 0 1" /></joint>{load}</robot>"""


def estimate_of(mass: float, centre: FloatArray, inertia: FloatArray) -> PayloadEstimate:
    body = standard_parameters(mass, centre, inertia)
    return PayloadEstimate(
        quantities=LoadQuantities(None, NONE, NONE * 2, NONE, NONE * 2),
        standard=np.array(body),
        covariance=np.zeros((10, 10)),
        body=body,
        assumed=(),
        records=("l",),
        warnings=(),
        study=load_records.study(Path()),
        result=Path("result.json"),
    )


def drawn(seed: int) -> tuple[float, FloatArray, FloatArray]:
    body = random_body(np.random.default_rng(seed))
    return body["mass"], body["centre"], body["inertia"]


BODIES = [*map(drawn, range(6)), (2.0, np.array([0.0, -0.05, 0.1]), 0.01 * np.eye(3))]


@pytest.mark.parametrize("body", BODIES, ids=range(len(BODIES)))
def test_texts_read_back_to_the_load(
    body: tuple[float, FloatArray, FloatArray], tmp_path: Path
) -> None:
    mass, centre, inertia = body
    texts = payload_exports(estimate_of(*body))

    def assert_equal(actual: Any, expected: Any) -> None:
        np.testing.assert_allclose(actual, expected, rtol=PRECISION, atol=1e-9)

    m, cog, moments = ast.literal_eval(
        texts["ur_set_target_payload"].removeprefix("set_target_payload")
    )
    assert_equal(m, mass)
    assert_equal(cog, centre)
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    assert_equal(moments, [inertia[pair] for pair in pairs])

    arguments = re.fullmatch(r"robot\.setLoad(\(.*\));", texts["franka_set_load"])
    assert arguments
    lists = arguments[1].replace("{{", "[").replace("}}", "]")
    m, cog, columns = ast.literal_eval(lists)
    assert_equal(m, mass)
    assert_equal(cog, centre)
    assert_equal(np.reshape(columns, (3, 3), order="F"), inertia)

    quoted = re.sub(r"(\w+):", r'"\1":', texts["ros_ur_set_payload"])
    message = json.loads(quoted)
    assert_equal(message["mass"], mass)
    assert_equal([message["center_of_gravity"][axis] for axis in "xyz"], centre)

    table = tomllib.loads(texts["study"])["payload"]
    assert_equal(
        Payload(table["mass"], tuple(table["xyz"])).parameters[:4], [mass, *(mass * centre)]
    )

    (tmp_path / "arm.urdf").write_text(URDF.format(load=texts["urdf"]))
    (joint,) = read_urdf(tmp_path / "arm.urdf")
    expected = parameters_of({"mass": mass, "centre": centre, "inertia": inertia})
    np.testing.assert_allclose(joint.prior, expected, rtol=10.0 * PRECISION, atol=1e-6)


@pytest.mark.parametrize("body", BODIES, ids=range(len(BODIES)))
def test_kuka_has_principal_axes(body: tuple[float, FloatArray, FloatArray]) -> None:
    """$LOAD in kg, mm, degrees and kg m^2; the frame CM turns by R = Rz(A) Ry(B) Rx(C)."""
    mass, centre, inertia = body
    text = payload_exports(estimate_of(*body))["kuka_load"]
    load, frame, moments = re.fullmatch(  # type: ignore[union-attr]
        r"\$LOAD = \{M (\S+), CM \{(.*)\}, J \{(.*)\}\}", text
    ).groups()
    values, J = (dict(part.split() for part in each.split(", ")) for each in (frame, moments))
    assert float(load) == pytest.approx(mass, rel=PRECISION)
    np.testing.assert_allclose([float(values[k]) for k in "XYZ"], 1e3 * centre, rtol=PRECISION)
    a, b, c = (np.radians(float(values[k])) for k in "ABC")
    rz = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rx = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    R = rz @ ry @ rx
    principal = np.diag([float(J[k]) for k in "XYZ"])
    np.testing.assert_allclose(R @ principal @ R.T, inertia, atol=1e-6 * np.max(inertia))


def test_a_load_below_what_can_be_seen_has_no_texts() -> None:
    estimate = replace(estimate_of(*BODIES[0]), body=None)
    assert payload_exports(estimate) == {}
    assert payload_document(estimate)["export"] == {}


def test_the_urdf_names_the_link_of_the_last_joint(tmp_path: Path) -> None:
    """The link of the arm's own URDF, if it is at hand."""
    from strainwave.domain.arm.description import Urdf

    (tmp_path / "arm.urdf").write_text(URDF.format(load="").replace("link3", "wrist"))
    estimate = estimate_of(*BODIES[0])
    arm = estimate.study.arm.with_joint(3, name="turn")
    arm = replace(arm, urdf=Urdf(str(tmp_path / "arm.urdf"), (None,) * 3))  # type: ignore[arg-type]
    text = payload_exports(replace(estimate, study=replace(estimate.study, arm=arm)))["urdf"]
    assert '<parent link="wrist" />' in text
