"""Actuator modules run with the fields of the packages' own classes, and have all values."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import exports
from exports import SERVO_DAMPING as DAMPING
from strainwave.errors import InvalidInput
from strainwave.export import IdentifiedArm, export_arm
from strainwave.export.actuators import to_actuators
from strainwave.export.rigid_links import rigid_links
from strainwave.io.joint_covariance import JointCovariance

FIELDS = Path(__file__).parents[1] / "data" / "actuator_fields.json"
"""Names of the configurations' fields, of the versions that the exported files name."""
CI95_STDS = 1.96


@pytest.fixture
def packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules that have the packages' classes with their fields, and accept no others."""
    for name, classes in json.loads(FIELDS.read_text()).items():
        module = ModuleType(name)
        for title, fields in classes.items():
            optional = [(field, Any, dataclasses.field(default=None)) for field in fields]
            setattr(module, title, dataclasses.make_dataclass(title, optional))
        monkeypatch.setitem(sys.modules, name.split(".", maxsplit=1)[0], ModuleType("package"))
        monkeypatch.setitem(sys.modules, name, module)


def module_of(arm: IdentifiedArm, form: str, folder: Path) -> dict[str, Any]:
    export_arm(arm, folder / "actuators.py", form=form)
    module: dict[str, Any] = {}
    exec((folder / "actuators.py").read_text(), module)
    return module


def elastic_arm(folder: Path) -> IdentifiedArm:
    return exports.arm_of(*exports.chain(folder, ("linear", "rigid", "linear")))


@pytest.mark.usefixtures("packages")
@pytest.mark.parametrize("form", ["isaaclab", "mjlab", "pace"])
def test_values_are_those_of_the_joints(form: str, tmp_path: Path) -> None:
    study, values = exports.limited_chain(tmp_path)
    arm = exports.arm_of(study, values)
    module, (links, _) = module_of(arm, form, tmp_path), rigid_links(arm, has_rotors=True)
    assert list(module["ACTUATORS"]) == ["joint1", "joint2", "joint3"]
    names = ("friction", "viscous_friction")
    dry, viscous_friction = ("frictionloss", "viscous_damping") if form == "mjlab" else names
    for link, config in zip(links, module["ACTUATORS"].values(), strict=True):
        n = abs(link.joint.gear_ratio)
        assert config.armature == pytest.approx(2e-4 / n**2, rel=1e-6)
        assert getattr(config, dry) == pytest.approx(0.02 * link.number / n)
        viscous = 3e-4 / n**2 + 0.4
        assert getattr(config, viscous_friction) == pytest.approx(viscous, rel=1e-5)
        limit = link.limits.effort
        name = "effort_limit_sim" if form == "isaaclab" else "effort_limit"
        assert getattr(config, name) == (limit or (None if form == "isaaclab" else 1e6))
        if form != "mjlab":
            assert (config.stiffness, config.damping) == (0.0, 0.0)
            assert config.dynamic_friction == config.friction
        if form == "isaaclab":
            assert config.velocity_limit_sim == link.limits.velocity
        if form == "pace":
            assert config.velocity_limit == (link.limits.velocity or 1e6)
            assert config.saturation_effort == config.effort_limit


@pytest.mark.usefixtures("packages")
@pytest.mark.parametrize("known_kp", [False, True])
@pytest.mark.parametrize("form", ["isaaclab", "mjlab", "pace"])
def test_servos_have_gains_limit_and_delay(form: str, known_kp: bool, tmp_path: Path) -> None:
    arm = exports.arm_of(*exports.position_servo(tmp_path, known_kp))
    module = module_of(arm, form, tmp_path)
    (config,) = module["ACTUATORS"].values()
    assert (config.stiffness, config.damping, config.effort_limit) == (4.8, DAMPING, 0.75)
    low, high = module["RANGES"]["delay"]["joint1"]
    assert (low + high) / 2 == pytest.approx(0.022, rel=1e-3)
    if form == "isaaclab":
        assert type(config).__name__ == "DelayedPDActuatorCfg"
        assert (config.min_delay, config.max_delay) == (4, 4)
    elif form == "mjlab":
        assert (config.delay_min_lag, config.delay_max_lag) == (4, 4)
    else:
        assert config.max_delay == 4
        assert module["BOUNDS_PARAMS"][-1] == (4, 4)
    assert ("stiffness" in module["RANGES"]) == (not known_kp)
    text = (
        (tmp_path / "actuators.py")
        .read_text()
        .replace("PHYSICS_STEP = 0.005", "PHYSICS_STEP = 0.001")
    )
    exec(text, module)
    (config,) = module["ACTUATORS"].values()
    assert 22 in (getattr(config, "max_delay", 0), getattr(config, "delay_max_lag", 0))


@pytest.mark.usefixtures("packages")
def test_damping_with_friction_is_the_gain_where_only_the_sum_is_known(tmp_path: Path) -> None:
    study, values = exports.position_servo(tmp_path)
    for name in ("servo_kd", "motor_viscous_friction", "link_viscous_friction"):
        del values[name, 1]
    (config,) = module_of(exports.arm_of(study, values), "isaaclab", tmp_path)["ACTUATORS"].values()
    assert config.damping == pytest.approx(0.04 - 0.5 * 0.002 * 4.8)
    assert config.viscous_friction == pytest.approx(0.0, abs=1e-6)  # of the search


@pytest.mark.usefixtures("packages")
def test_ranges_are_the_intervals_of_the_result(tmp_path: Path) -> None:
    """Standard deviations of 1 %; a joint's viscous friction is a sum of two estimates."""
    module = module_of(elastic_arm(tmp_path), "isaaclab", tmp_path)
    for joint, n in (("joint1", 0.01), ("joint3", 0.02)):
        for name, value, std in (
            ("armature", 2e-4 / n**2, 0.01 * 2e-4 / n**2),
            ("viscous_friction", 3e-4 / n**2 + 0.4, 0.01 * np.hypot(3e-4 / n**2, 0.4)),
        ):
            low, high = module["RANGES"][name][joint]
            # quantiles of 4000 draws are off by some per cent of the interval
            assert low == pytest.approx(value - CI95_STDS * std, abs=0.12 * std)
            assert high == pytest.approx(value + CI95_STDS * std, abs=0.12 * std)
    assert "friction" not in module["RANGES"]  # zero, without a standard deviation


@pytest.mark.usefixtures("packages")
def test_draws_have_the_correlations_of_the_result(tmp_path: Path) -> None:
    arm = elastic_arm(tmp_path)
    names = ("motor_inertia 1", "motor_viscous_friction 1")
    stds = 0.01 * np.array([2e-4, 3e-4])
    matrix = np.outer(stds, stds) * [[1.0, -0.8], [-0.8, 1.0]]
    arm = replace(arm, covariance=JointCovariance("tuned", names, matrix))
    module = module_of(arm, "mjlab", tmp_path)
    at = [module["NAMES"].index((name, "joint1")) for name in ("armature", "viscous_damping")]
    # the friction of the link, 0.4 of 3.4, is independent
    wanted = -0.8 * 3.0 / np.hypot(3.0, 0.4)
    assert module["CORRELATION"][at[0]][at[1]] == pytest.approx(wanted, abs=0.03)
    drawn = module["draw"](20_000)
    assert drawn.shape == (20_000, len(module["NAMES"]))
    assert np.corrcoef(drawn[:, at], rowvar=False)[0, 1] == pytest.approx(wanted, abs=0.03)
    np.testing.assert_allclose(drawn.mean(axis=0), module["MEAN"], rtol=2e-3)
    np.testing.assert_allclose(drawn.std(axis=0), module["STD"], rtol=0.05)
    assert np.any(module["draw"](5, seed=1) != module["draw"](5))


@pytest.mark.usefixtures("packages")
def test_the_bounds_of_pace_are_in_its_order(tmp_path: Path) -> None:
    """Armature, viscous friction, friction and encoder bias of all joints, then the delay."""
    module = module_of(elastic_arm(tmp_path), "pace", tmp_path)
    bounds = np.array(module["BOUNDS_PARAMS"])
    assert bounds.shape == (4 * 3 + 1, 2)
    configs = list(module["ACTUATORS"].values())
    for k, name in enumerate(("armature", "viscous_friction", "friction")):
        values = [getattr(config, name) for config in configs]
        np.testing.assert_allclose(bounds[3 * k : 3 * k + 3].mean(axis=1), values, rtol=2e-3)
    np.testing.assert_array_equal(bounds[9:12], [[-0.1, 0.1]] * 3)
    assert module["JOINT_ORDER"] == ["joint1", "joint2", "joint3"]


@pytest.mark.usefixtures("packages")
def test_a_name_is_an_expression_that_matches_itself_alone(tmp_path: Path) -> None:
    study, values = exports.limited_chain(tmp_path)
    study = replace(study, arm=study.arm.with_joint(2, name='a.b "c"'))
    module = module_of(exports.arm_of(study, values), "isaaclab", tmp_path)
    (expression,) = module["ACTUATORS"]['a.b "c"'].joint_names_expr
    assert re.fullmatch(expression, 'a.b "c"')
    assert not re.fullmatch(expression, 'a-b "c"')


@pytest.mark.usefixtures("packages")
def test_stribeck_friction_is_static_friction(tmp_path: Path) -> None:
    """Where the package has it: mjlab has Coulomb friction alone, and says so."""
    study, values = exports.limited_chain(tmp_path)
    arm = exports.arm_of(study, values | {("stribeck_friction", 2): 0.03})
    ratio = abs(study.arm.joints[1].gear_ratio)
    for form in ("isaaclab", "pace"):
        config = module_of(arm, form, tmp_path)["ACTUATORS"]["joint2"]
        assert config.friction == pytest.approx(0.07 / ratio)
        assert config.dynamic_friction == pytest.approx(0.04 / ratio)
    lost = [loss.observation for loss in to_actuators(arm, "mjlab").losses]
    assert "stribeck_friction" in lost
    assert "stribeck_friction" not in [x.observation for x in to_actuators(arm, "pace").losses]


def test_losses_and_versions_are_in_the_file(tmp_path: Path) -> None:
    export = to_actuators(elastic_arm(tmp_path), "isaaclab")
    assert [loss.observation for loss in export.losses][:1] == ["friction_offset"]
    text = export.data.decode()
    for part in (
        "Lost: friction_offset (",
        "gear (joint 1",
        "Isaac Lab 2.3.2",
        "commands are torques",
    ):
        assert part in text
    assert "standard deviations" not in text


def test_ratios_are_refused(tmp_path: Path) -> None:
    study, values = exports.position_servo(tmp_path)
    del values["servo_kp", 1]
    with pytest.raises(InvalidInput, match="gain of servo 1 is not determined"):
        to_actuators(exports.arm_of(study, values), "isaaclab")
