"""Gears with `spring = "auto"`: the law that the data support, with the values of the stated law."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from strainwave.domain import (
    ArmModel,
    LawChoice,
    Parameter,
    Study,
    WholeArmOptions,
)
from strainwave.domain.arm.gear_laws import AUTO, CUBIC
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import fit_whole_arm
from strainwave.identification.whole_arm.inference import score_tests
from strainwave.identification.whole_arm.search import Fit
from strainwave.identification.whole_arm.selection.candidate import Selection
from strainwave.identification.whole_arm.selection.gear_laws import equivalent_stiffnesses
from strainwave.virtual import scara
from strainwave.virtual.experiments import derived
from tuning_runs import joint_models, rigid_model, shaken_study, simulated_logs

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
STIFFENING = {1: 6e8, 2: 2e8}  # k_3 [N m/rad^3], as in test_cubic_gears.py


@cache
def run(truth: str, stated: str, amplitude: float = 10.0) -> tuple[Values, ArmModel]:
    """True values, and the fit of open-loop records of 0.5 s of each joint with a stated law."""
    spring = "linear" if truth == "mixed" else truth
    study = scara.STIFF.study(Path("nowhere"), spring)
    values = scara.STIFF.parameters(5, spring)
    if truth == "mixed":
        study = replace(study, arm=study.arm.with_joint(2, spring="three-slope"))
        values |= scara.STIFF.parameters(5, "three-slope")
    if truth == "cubic":
        values |= {(CUBIC, joint): cubic for joint, cubic in STIFFENING.items()}
    written, logs = simulated_logs(shaken_study(study, amplitude), values, noise=SensorNoise())
    known = derived(values, study.arm)
    joints = joint_models(written, known, 0.05, FACTORS)
    wanted = with_spring(written, stated)
    rigid = rigid_model(written, known, 0.01, 1.0)
    return known, fit_whole_arm(logs, rigid, joints, Arm.of(wanted.arm))


def with_spring(study: Study, spring: str) -> Study:
    joints = (replace(joint, spring=spring) for joint in study.arm.joints)
    return replace(study, arm=study.arm.with_joints(joints))


def estimates(model: ArmModel) -> dict[Key, Parameter]:
    return {p.key: p for p in model.parameters}


@pytest.mark.parametrize("law", ["linear", "cubic", "three-slope"])
def test_the_law_of_the_gears_is_selected(law: str) -> None:
    _, model = run(law, AUTO)
    assert model.status == "converged"
    assert [choice.law for choice in model.gear_laws] == [law, law]
    for choice in model.gear_laws:
        if law == "linear":
            assert choice.gain < choice.limit or not choice.margins
            continue
        assert choice.gain > choice.limit
        margins = {margin.law: margin for margin in choice.margins}
        assert set(margins) == {"linear", "cubic", "three-slope"} - {law}
        assert margins["linear"].weight > 0.95


@pytest.mark.parametrize("law", ["linear", "cubic", "three-slope"])
def test_the_values_are_those_of_the_stated_law(law: str) -> None:
    """The starts differ, so that curves agree within the end of the search only."""
    true, model = run(law, AUTO)
    stated = estimates(run(law, law)[1])
    assert estimates(model).keys() == stated.keys()
    for key, p in estimates(model).items():
        other = stated[key]
        assert (p.value is None) == (other.value is None), key
        if p.value is None or p.std is None or other.value is None:
            continue
        assert abs(p.value - other.value) <= (0.0 if law == "linear" else 0.5 * p.std), key
        if key in true:
            assert abs(p.value - true[key]) < 5.0 * p.std, key


def test_each_gear_has_its_own_law() -> None:
    _, model = run("mixed", AUTO)
    assert [choice.law for choice in model.gear_laws] == ["linear", "three-slope"]


def test_a_stated_line_on_a_curved_gear_names_the_curve() -> None:
    _, model = run("three-slope", "linear")
    assert model.criticism is not None
    assert model.criticism.causes[0].effect == "stiffness-curve"
    (warning,) = [w for w in model.warnings if w.code == "stiffness-curve-likely"]
    assert 'spring = "auto" or "three-slope"' in warning.message
    assert not [w for w in model.warnings if w.code == "backlash-likely"]
    assert not model.gear_laws


def test_a_stated_line_on_a_linear_gear_names_no_cause() -> None:
    _, model = run("linear", "linear")
    assert model.criticism is not None
    assert not model.criticism.causes


def test_below_the_first_knee_the_gear_is_linear() -> None:
    """The result states up to which torque the law holds."""
    true, model = run("three-slope", AUTO, 2.0)
    for choice in model.gear_laws:
        assert choice.law == "linear"
        assert 0.0 < choice.largest_torque < true["gear_knee_t1", choice.joint] + 0.2
        p, slope = (
            estimates(model)["gear_stiffness", choice.joint],
            true["gear_stiffness_k1", choice.joint],
        )
        assert p.value == pytest.approx(slope, rel=0.02)


@pytest.mark.parametrize(("std", "warned"), [(1e7, False), (1e9, True)])
def test_a_line_that_hides_a_curve_is_an_equivalent_stiffness(std: float, *, warned: bool) -> None:
    """Here 3 k_3 (T / k)^2 / k is 0.6 % or 60 % at the 95 % bound."""
    study = with_spring(scara.STIFF.study(Path("nowhere"), "linear"), "linear")
    selection = Selection(Arm.of(study.arm), WholeArmOptions())
    selection.law_choices = {1: LawChoice(1, "linear")}
    step = 0.0, 0.0, 1.0, 0.0, {CUBIC: 0.0}, {CUBIC: std}, Values(), Values()
    test = score_tests.TestedEffect((1, "stiffness-curve"), *step)
    fit = cast(Fit, SimpleNamespace(values={("gear_stiffness", 1): 1e4}))
    warnings = list(equivalent_stiffnesses([test], fit, selection, [10.0, 10.0]))
    assert [w.code for w in warnings] == (["equivalent-stiffness"] if warned else [])
    if warned:
        assert "up to 10 N m" in warnings[0].message
        assert "59 %" in warnings[0].message
