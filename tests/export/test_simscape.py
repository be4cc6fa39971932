"""The parameter file for Simscape, read back value by value."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exports
from strainwave.domain.arm.link_sensors.link_space import attitude
from strainwave.export import IdentifiedArm, export_arm
from strainwave.export.completion import link_bodies
from strainwave.export.simscape import to_simscape

Fields = dict[str, Any]


def assigned(arm: IdentifiedArm) -> Fields:
    """Left sides and values of the assignments of the script: every line is one or a comment."""
    fields: Fields = {}
    for line in to_simscape(arm).data.decode().splitlines():
        found = re.fullmatch(r"arm\.(\S+) = (.*?);( %.*)?", line)
        if found is None:
            assert not line or line.startswith("%") or line == "clear arm", line
            continue
        name, value = found[1], found[2]
        if value.startswith("'"):
            fields[name] = value[1:-1].replace("''", "'")
        else:
            rows = [[float(x) for x in row.split()] for row in value.strip("[]").split(";")]
            fields[name] = np.squeeze(rows)
    return fields


def test_every_value_of_a_chain_is_assigned(tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path, motions=exports.MOTIONS[1], coupling=exports.COUPLING)
    arm = exports.arm_of(study, values)
    fields = assigned(arm)
    np.testing.assert_allclose(fields["gravity"], study.arm.gravity or (), rtol=1e-12)
    np.testing.assert_array_equal(fields["coupling"], exports.COUPLING)
    gravity = study.arm.gravity_size
    for i, (joint, body) in enumerate(
        zip(study.arm.joints, link_bodies(arm, gravity), strict=True)
    ):
        of_joint = {name: values[name, i + 1] for name, number in values if number == i + 1}
        wanted: Fields = {
            "type": joint.motion,
            "name": f"joint{i + 1}",
            "translation": joint.origin.xyz,
            "rotation": attitude(joint.origin.rpy),
            "axis": joint.axis,
            "gear_ratio": joint.gear_ratio,
            "torque_per_volt": 0.1,
            "std.gear_stiffness": 0.01 * of_joint["gear_stiffness"],
        }
        wanted |= {k: v for k, v in of_joint.items() if "link" not in k or "viscous" in k}
        xx, yy, zz, xy, xz, yz = body.inertia
        bodies: Fields = {
            "mass": body.mass,
            "center_of_mass": body.centre,
            "moments_of_inertia": (xx, yy, zz),
            "products_of_inertia": (yz, xz, xy),
        }
        for kind, entries in (("joints", wanted), ("links", bodies)):
            for name, value in entries.items():
                read = fields[f"{kind}({i + 1}).{name}"]
                if isinstance(value, str):
                    assert read == value
                else:
                    np.testing.assert_allclose(read, value, rtol=1e-12, err_msg=name)


def test_a_piecewise_linear_spring_has_a_table(tmp_path: Path) -> None:
    """Its ends continue the last slope."""
    study = exports.two_links(tmp_path, "three-slope")
    values = exports.values_of(study)
    fields = assigned(exports.arm_of(study, values))
    torsion, torque = (np.array(fields[f"joints(1).gear_{x}"]) for x in ("torsion", "torque"))
    slopes = [values[f"gear_stiffness_k{k}", 1] for k in (3, 2, 1, 1, 2, 3)]
    np.testing.assert_allclose(np.diff(torque) / np.diff(torsion), slopes, rtol=1e-9)
    knees = [values[f"gear_knee_t{k}", 1] for k in (1, 2)]
    np.testing.assert_allclose(torque[4:6], knees, rtol=1e-9)


def test_servos_are_assigned(tmp_path: Path) -> None:
    for known in (False, True):
        study, values = exports.position_servo(tmp_path, known)
        fields = assigned(exports.arm_of(study, values))
        wanted = {"stiffness": 4.8, "damping": exports.SERVO_DAMPING, "delay": 0.022}
        for name, value in wanted.items():
            assert fields[f"joints(1).servo_{name}"] == pytest.approx(value)
        assert fields["joints(1).torque_limit"] == 0.75


def test_ratios_have_a_gain_of_one_and_a_note(tmp_path: Path) -> None:
    """Without the gain of the servo the result has no torques; the motion is the same."""
    study, values = exports.position_servo(tmp_path)
    del values["servo_kp", 1]
    export = export_arm(exports.arm_of(study, values), tmp_path / "arm.m", form="simscape")
    assert "per N m/rad of servo 1's gain, which is not determined" in export.notes[0]
    assert b"servo_stiffness = 1.0;" in export.data


def test_losses_are_comments(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    values = exports.values_of(study) | {("hysteresis_torque", 2): 1.0}
    export = to_simscape(exports.arm_of(study, values))
    for part in ("hysteresis_torque", "sensors", "correlations"):
        assert part in export.notes[-1]
    assert f"% {export.notes[-1][:1].upper()}{export.notes[-1][1:]}." in export.data.decode()
