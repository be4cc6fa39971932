"""Gears, effects and servos of exported arms move in MuJoCo as in the simulation."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import exports
from mujoco_runs import frictionless, largest_difference
from strainwave.domain import FloatArray, PositionServo, Spring, Study
from strainwave.domain.keys import Values
from strainwave.errors import InvalidInput
from strainwave.export import export_arm
from strainwave.export.completion import completed
from strainwave.export.mjcf import to_mjcf
from strainwave.export.mjcf_drives import Target
from strainwave.export.read_back import by_mujoco


@pytest.fixture(scope="module")
def mujoco() -> ModuleType:
    found: ModuleType = pytest.importorskip(
        "mujoco", reason="MuJoCo is not installed (extra: bench)"
    )
    return found


CURVED = {("gear_stiffness", j): k for j, k in ((1, 2e4), (2, 5e3))} | {
    ("gear_stiffness_cubic", j): k for j, k in ((1, 3e9), (2, 1e9))
}
# effects with sizes that change the velocities clearly, and the agreement reached: exact ones
# differ by the corners of the law, which the simulation rounds or MuJoCo meets between steps
EFFECTS: dict[str, tuple[dict[str, float], float]] = {
    "backlash": ({"backlash": 2e-4}, 2e-3),
    "ground-spring": ({"ground_stiffness": 400.0, "ground_preload": 30.0}, 1e-6),
    "drive-gain": ({"drive_gain": 0.1}, 1e-6),
    "torque-ripple": (
        {"torque_ripple_cos": 0.1, "torque_ripple_sin": -0.05, "torque_ripple_order": 4.0},
        1e-6,
    ),
    "drive-limit": ({"drive_limit": 6.0, "drive_limit_loss": 1.0}, 1e-6),
    "drive-lag": ({"drive_lag": 1e-3}, 1e-3),
    "hysteresis": ({"hysteresis_torque": 4.0, "hysteresis_twist": 1.5e-4}, 0.05),
}


def with_effects(study: Study, names: tuple[str, ...]) -> Study:
    joints = tuple(replace(joint, effects=names) for joint in study.arm.joints)
    return replace(study, arm=replace(study.arm, joints=joints))


def test_a_cubic_gear_is_exact(mujoco: ModuleType, tmp_path: Path) -> None:
    """A stiffness polynomial, as by Runge-Kutta of order four; linearised it differs clearly."""
    study = exports.two_links(tmp_path, "cubic")
    values = frictionless(exports.values_of(exports.two_links(tmp_path))) | CURVED
    assert largest_difference(mujoco, study, values, 10.0) < 1e-7
    straight = values | {("gear_stiffness_cubic", j): 0.0 for j in (1, 2)}
    linear = to_mjcf(completed(exports.arm_of(study, straight), "mjcf")).data
    assert linear != to_mjcf(completed(exports.arm_of(study, values), "mjcf")).data


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_move_as_in_the_simulation(mujoco: ModuleType, name: str, tmp_path: Path) -> None:
    sizes, tolerance = EFFECTS[name]
    plain = exports.two_links(tmp_path)
    values = frictionless(exports.values_of(plain))
    study = with_effects(plain, (name,))
    with_sizes: Values = values | {(key, j): x for key, x in sizes.items() for j in (1, 2)}
    difference = largest_difference(mujoco, study, with_sizes, 10.0)
    assert difference < tolerance
    # the effect matters: without it in the file the difference is at least three times as large
    without = largest_difference(mujoco, study, with_sizes, 10.0, exported=values)
    assert without > max(3.0 * difference, 0.003)


@pytest.mark.parametrize(
    ("version", "needed", "lost"),
    [
        ("3", "3", {"curvature of the gear", "hysteresis", "torque-ripple"}),
        ("3.7", "3.7", {"hysteresis", "torque-ripple"}),
        ("3.12.0", "3.12", {"hysteresis"}),
        ("4", "4.0", set()),
    ],
)
def test_the_version_decides_what_is_lost(
    version: str, needed: str, lost: set[str], tmp_path: Path
) -> None:
    study = with_effects(exports.two_links(tmp_path, "cubic"), ("hysteresis", "torque-ripple"))
    values = exports.values_of(exports.two_links(tmp_path)) | CURVED
    for name in ("hysteresis", "torque-ripple"):
        values |= {(key, 2): x for key, x in EFFECTS[name][0].items()}
    target = Target.of(version)
    export = to_mjcf(completed(exports.arm_of(study, values), "mjcf", target.effects), target)
    losses = {dict(x.clause.values)["part"]: x.where for x in export.losses_of_version}
    assert set(losses) == lost
    assert losses.get("hysteresis", "joint 2") == "joint 2"
    text = export.data.decode()
    assert ('springyield="' in text) == ("hysteresis" not in lost)
    assert ("<dcmotor" in text) == ("torque-ripple" not in lost)
    assert all(part in text for part in lost)  # in the comment of the file
    assert f"The file needs MuJoCo {needed} or later" in text or needed == "3"
    codes = [warning.code for warning in export.warnings]
    assert ("linearised" in codes) == ("curvature of the gear" in lost)


@pytest.mark.parametrize("text", ["2.3", "x", "", "4.0.0.1"])
def test_other_versions_are_refused(text: str) -> None:
    with pytest.raises(InvalidInput, match="version of MuJoCo"):
        Target.of(text)


def position_study(folder: Path, spring: Spring, delay: float) -> tuple[Study, Values]:
    """One joint under a position servo of 20 N m/rad at the joint, 2 kHz."""
    study, values = exports.single(folder, "revolute", spring, 9.81)
    servo = PositionServo("position", 0.0005, (2e3,), (120.0,), delay, (150.0,))
    arm = replace(study.arm, position_servo=servo)
    experiment = replace(exports.MOTION, control=("servo",))
    return replace(study, arm=arm, experiments=(experiment,)), values


@pytest.mark.parametrize("spring", ["rigid", "linear"])
def test_a_position_servo_moves_as_its_sampled_law(
    mujoco: ModuleType, spring: Spring, tmp_path: Path
) -> None:
    """The law sampled and held at 2 kHz on the exported arm with a torque motor, within 0.1 %.

    Without the inertia of the hold the elastic arm differs by 0.4 %.
    """
    delay = 0.008
    study, values = position_study(tmp_path, spring, delay)
    arm = completed(exports.arm_of(study, values), "mjcf")
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm).data.decode())
    bare = replace(study, arm=replace(study.arm, position_servo=None))
    torque = mujoco.MjModel.from_xml_string(
        to_mjcf(completed(exports.arm_of(bare, values), "mjcf")).data.decode()
    )
    n, joint = study.arm.joints[0].gear_ratio, "joint1" if spring == "rigid" else "motor_joint1"
    ratio = 1.0 if spring == "rigid" else n

    servo = study.arm.position_servo
    assert servo is not None
    held = round(servo.period / model.opt.timestep)

    def command(time: float) -> float:
        parts = ((0.05, 2.0), (0.03, 7.0), (0.01, 19.0))  # [rad], [Hz]
        return sum(x * math.sin(math.tau * hz * max(time, 0.0)) for x, hz in parts)

    def by_law() -> FloatArray:
        data, found = mujoco.MjData(torque), []
        while data.time < 1.0 - 1e-9:
            q, dq = (ratio * x[0] for x in (data.joint(joint).qpos, data.joint(joint).qvel))
            output = 2e3 * (command(data.time - delay) - q) - 120.0 * dq
            data.ctrl[:] = n * np.clip(output, -150.0, 150.0)
            found.append(dq)
            mujoco.mj_step(torque, data, held)
        return np.array(found)

    data, found = mujoco.MjData(model), []
    while data.time < 1.0 - 1e-9:
        found.append(ratio * data.joint(joint).qvel[0])
        for _ in range(held):
            data.ctrl[:] = command(data.time)
            mujoco.mj_step(model, data)
    wanted = by_law()
    assert np.linalg.norm(np.array(found) - wanted) < 0.001 * np.linalg.norm(wanted)
    assert np.abs(wanted).max() > 0.1


def test_a_servo_without_scale_has_a_gain_of_one(tmp_path: Path) -> None:
    study, values = position_study(tmp_path, "rigid", 0.0)
    unknown = PositionServo("position", 0.001, ("unknown",), ("unknown",))
    study = replace(study, arm=replace(study.arm, position_servo=unknown))
    values |= {(name, 1): 0.0 for name in ("motor_viscous_friction", "link_viscous_friction")}
    identified = exports.arm_of(study, values)
    of_servo = {"servo_damping": 0.5, "torque_limit": 0.3, "servo_delay": 0.01}
    first = identified.parameters[0]
    added = (replace(first, name=name, value=value) for name, value in of_servo.items())
    identified = replace(identified, parameters=(*identified.parameters, *added))
    export = to_mjcf(completed(identified, "mjcf"))
    text = export.data.decode()
    assert 'forcerange="-0.3 0.3"' in text
    # half a period of the hold: less damping, more delay; more gain in place of less inertia
    assert f'delay="{0.01 + 0.0005!r}"' in text
    servo = ET.fromstring(text).find("actuator/general")
    assert servo is not None
    bias = [float(x) for x in servo.attrib["biasprm"].split()]
    inertia = 3.0 + 0.02 / study.arm.joints[0].gear_ratio ** 2
    share = inertia / (inertia - 0.5 * 0.5 * 0.001)
    assert np.isclose(float(servo.attrib["gainprm"]), share, rtol=1e-9)
    assert np.allclose(bias, [0.0, -share, -share * (0.5 - 0.5 * 0.001)], rtol=1e-9)
    old = to_mjcf(completed(identified, "mjcf"), Target.of("3.2"))
    assert [x.where for x in old.losses_of_version] == ["joint 1"]
    assert "nsample" not in old.data.decode()


def test_mujoco_reads_every_value_back(mujoco: ModuleType, tmp_path: Path) -> None:
    names = ("backlash", "ground-spring", "torque-ripple", "hysteresis", "drive-limit")
    study = with_effects(exports.two_links(tmp_path, "cubic", 9.81), names)
    values = exports.values_of(exports.two_links(tmp_path, "linear", 9.81)) | CURVED
    for name in names:
        values |= {(key, j): x for key, x in EFFECTS[name][0].items() for j in (1, 2)}
    out = tmp_path / "arm.xml"
    export = export_arm(exports.arm_of(study, values), out)
    assert export.read_back is not None
    assert export.read_back.differences == ()
    assert export.read_back.n_values > 140
    # a reader that has another value is noticed
    wrong = out.read_text().replace('springyield="', 'frictionloss="0.5" springyield="', 1)
    out.write_text(wrong.replace('integrator="RK4"', 'integrator="RK4" wrong="1"'))
    rejected = by_mujoco(out)
    assert rejected is not None
    assert rejected.warnings[0].code == "read-back"


def test_the_command_takes_a_version(tmp_path: Path) -> None:
    from command_line import run_here

    study = exports.two_links(tmp_path, "cubic")
    result = exports.write(study, exports.values_of(exports.two_links(tmp_path)) | CURVED)
    out = tmp_path / "arm.xml"
    arguments = ["export", str(result), "--out", str(out), "--mujoco"]
    assert run_here(*arguments, "4").returncode == 0
    old = run_here(*arguments, "3.2")
    assert old.returncode == 3
    assert "joint 1, 2: MuJoCo 3.2 lacks an element for curvature of the gear" in old.stderr
    assert "MuJoCo 3.7" in old.stderr
    bad = run_here(*arguments, "2")
    assert bad.returncode == 2
    assert "--mujoco" in bad.stderr
    other = run_here("export", str(result), "--out", str(tmp_path / "arm.h"), "--mujoco", "4")
    assert other.returncode == 2
