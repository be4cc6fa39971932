"""Each effect: consistency of its declarations with the core, its simulation and the documentation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from effect_runs import records, whole_arm
from extensions import added
from strainwave import _core
from strainwave.domain import Cause, FloatArray, Joint, Parameter, ParameterShift, is_physical
from strainwave.domain.arm import effects
from strainwave.domain.arm.effects import Effect, KnownJoint, RecordEffect, Values, effect_named
from strainwave.domain.arm.gear_laws import RIGID
from strainwave.domain.arm.kinds import single_joint
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, record_inputs, simulate
from strainwave.errors import InvalidInput
from strainwave.identification.whole_arm.conclusion import warn_likely_cause
from strainwave.io.study import read_study
from strainwave.report.document.verdict import advice
from virtual_arms import ELASTIC_JOINT

EFFECTS = effects.all_effects()
OF_THE_CORE = [effect for effect in EFFECTS if not isinstance(effect, RecordEffect)]
EACH = pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
EACH_OF_THE_CORE = pytest.mark.parametrize("effect", OF_THE_CORE, ids=lambda effect: effect.name)
KNOWN = KnownJoint(
    gear_ratio=0.01,
    coulomb_friction=0.05,
    stiffness=2e4,
    largest_torque=30.0,
    largest_voltage=10.0,
)
DOCS = Path(__file__).parents[4] / "docs"
STUDY = """
[arm]
kind = "single-joint"

[[joint]]
spring = "{spring}"
gear_ratio = 0.01
effects = {effects}

[[experiment]]
name = "prbs"
file = "prbs.csv"
use = "frequency"
joint = 1
"""


def arm(*names: str, spring: str = "linear") -> Arm:
    return Arm.of(single_joint(Joint(spring, 0.01, effects=names)))


def motion(names: tuple[str, ...], own: Values) -> FloatArray:
    """Motor and link velocity of one joint under a reversing torque with a pause."""
    values = ELASTIC_JOINT | {(name, 1): value for name, value in own.items()}
    torque = np.repeat([1.0, -1.5, 0.04, 2.0, 0.0], 60)[:, None]
    drive = Drive(1e-3, torque, np.zeros_like(torque), (False,), (0.0,), (0.0,))
    run = simulate(
        arm(*names),
        values,
        drive,
        sample_time=1e-3,
        samples=len(torque),
        record=["motor_angle", "link_angle"],
    )
    return np.hstack([run["motor_angle"], run["link_angle"]])


def study(path: Path, named: str, spring: str = "linear") -> Path:
    path = path / "study.toml"
    path.write_text(STUDY.format(spring=spring, effects=named), encoding="utf-8")
    return path


@EACH_OF_THE_CORE
def test_parameter_names_match_the_core(effect: Effect) -> None:
    known = {name: own for name, *own in _core.joint_effects()}
    assert effect.core_name is not None
    assert known[effect.core_name] == [
        list(effect.names),
        len(effect.sizes),
        effect.needs_elastic_gear,
    ]


def test_all_effects_of_the_core_are_registered() -> None:
    assert {name for name, *_ in _core.joint_effects()} == {one.core_name for one in OF_THE_CORE}


@EACH
def test_sizes_have_the_range_that_the_core_declares(effect: Effect) -> None:
    for name in effect.sizes:
        assert is_physical(name, 0.0)
        assert effect.is_signed(name) == is_physical(name, -1.0)
    for name, value in effect.absent.items():
        assert is_physical(name, value)


@EACH
@pytest.mark.parametrize(
    "known",
    [KNOWN, replace(KNOWN, stiffness=math.inf, largest_torque=0.1, largest_voltage=0.5)],
    ids=["elastic", "stiff"],
)
def test_starting_values_are_within_their_ranges(effect: Effect, known: KnownJoint) -> None:
    if effect.needs_elastic_gear and math.isinf(known.stiffness):
        return
    typical, starts = effect.typical_sizes(known), effect.starts(known)
    assert list(typical) == list(effect.sizes)
    assert list(starts) == list(effect.names)
    for name in effect.sizes:
        assert 0.0 < typical[name] < math.inf
        assert starts[name] == (0.0 if effect.is_signed(name) else typical[name])
    for name, value in starts.items():
        assert is_physical(name, value)
        # the search uses the logarithm of positive parameters
        assert value > 0.0 or effect.is_signed(name)


@EACH
def test_tested_shapes_contain_all_shapes(effect: Effect) -> None:
    sets = effect.tested_shapes(KNOWN)
    assert all(list(shapes) == list(effect.shapes) for shapes in sets)
    assert len({tuple(shapes.values()) for shapes in sets}) == len(sets) > 0
    for name, value in (item for shapes in sets for item in shapes.items()):
        assert is_physical(name, value)


@EACH_OF_THE_CORE
def test_size_zero_does_not_change_the_motion(effect: Effect) -> None:
    np.testing.assert_array_equal(motion((effect.name,), effect.absent), motion((), {}))


@EACH_OF_THE_CORE
def test_the_typical_size_changes_the_motion(effect: Effect) -> None:
    shapes = effect.tested_shapes(replace(KNOWN, largest_voltage=2.0))[0]
    own = effect.typical_sizes(KNOWN) | shapes
    assert np.max(np.abs(motion((effect.name,), own) - motion((), {}))) > 1e-6


@EACH_OF_THE_CORE
def test_rigid_gears_reject_effects_of_elastic_gears(effect: Effect, tmp_path: Path) -> None:
    path = study(tmp_path, f'["{effect.name}"]', RIGID)
    if effect.name in effects.OF_RIGID_JOINTS and effect.needs_elastic_gear:
        assert read_study(path, logs_exist=False).arm.joints[0].effects == (effect.name,)
    elif effect.needs_elastic_gear:
        with pytest.raises(InvalidInput, match=f"'{effect.name}' needs an elastic gear"):
            read_study(path, logs_exist=False)
    else:
        description = read_study(path, logs_exist=False).arm
        assert (effect.sizes[0], 1) in Arm.of(description).parameter_names


@EACH
def test_every_effect_is_documented(effect: Effect) -> None:
    trouble = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    (section,) = (s for s in trouble.split("\n### ") if s.startswith(f"`{effect.warning_code}`"))
    assert f'effects = ["{effect.name}"]' in " ".join(section.split())
    assert f'`"{effect.name}"`' in (DOCS / "study.md").read_text(encoding="utf-8")
    parameters = (DOCS / "notation.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in parameters for name in effect.names)


@EACH
def test_the_warning_contains_experiment_and_remedy(effect: Effect) -> None:
    fitted = tuple(Parameter(n, 1, 1.0, 0.1, "rad", "tuned", (0.8, 1.2)) for n in effect.names)
    moved = ParameterShift("motor_inertia", 1, 2e-5, -1e-6, -8.0)
    likeliest = Cause(1, effect.name, fitted, 100.0, 0.4, (moved,))
    other = Cause(2, "stribeck", fitted, 60.0, 0.2, ())
    (warning,) = warn_likely_cause([likeliest, other])
    assert warning.code == effect.warning_code
    assert effect.experiment in warning.message
    assert advice()[warning.code].remedy == effect.remedy
    assert "would explain 40 % of the residuals" in warning.message
    assert "motor_inertia of joint 1 by -5 %" in warning.message
    assert "less likely causes are stribeck of joint 2" in warning.message
    assert "the intervals contain this change" in warning.message
    assert not list(warn_likely_cause([]))
    for words in (effect.description, effect.consequence, effect.experiment, effect.record):
        assert words
        assert not words.endswith(".")


@pytest.mark.parametrize("named", ['["creep"]', '["stribeck", 3]', "[[]]"])
def test_unknown_effects_are_rejected(named: str, tmp_path: Path) -> None:
    with pytest.raises(
        InvalidInput, match=r"'effects' is .*, but it should be 'stribeck', "
    ) as error:
        read_study(study(tmp_path, named), logs_exist=False)
    assert error.value.problem.endswith(f" or {effects.study_names()[-1]!r}")
    assert "line 8" in str(error.value)


OF_FIRST = [effect.name for effect in EFFECTS if effect.first_joint_only]


@pytest.mark.parametrize("name", OF_FIRST)
def test_only_joint_1_accepts_effects_of_the_base(name: str, tmp_path: Path) -> None:
    gear = '[[joint]]\nspring = "linear"\ngear_ratio = 0.01\n'
    arm = '[arm]\nkind = "planar-two-link"\nlink_length = 0.35\n'
    experiment = STUDY[STUDY.index("[[experiment]]") :]
    path, own = tmp_path / "study.toml", f'effects = ["{name}"]\n'
    path.write_text(arm + gear + own + gear + experiment, encoding="utf-8")
    assert read_study(path, logs_exist=False).arm.joints[0].effects == (name,)
    path.write_text(arm + gear + gear + own + experiment, encoding="utf-8")
    with pytest.raises(
        InvalidInput, match=f"joint 2 has the effect '{name}', which only joint 1 can have"
    ) as error:
        read_study(path, logs_exist=False)
    assert error.value.remedy == f"move '{name}' to the effects of joint 1"


@pytest.mark.parametrize("channel", ["theta_l1", "deflection1"])
def test_a_soft_base_rejects_link_encoders(channel: str, tmp_path: Path) -> None:
    path = study(tmp_path, '["soft-base"]')
    text = path.read_text(encoding="utf-8")
    path.write_text(text + f'\n[channels]\n{channel} = "angle"\n', encoding="utf-8")
    with pytest.raises(InvalidInput, match=f"'{channel}' does not measure the absolute link angle"):
        read_study(path, logs_exist=False)


def test_effects_can_be_auto(tmp_path: Path) -> None:
    for spring in ("linear", RIGID):
        (joint,) = read_study(study(tmp_path, '"auto"', spring), logs_exist=False).arm.joints
        assert joint.selects_effects
        assert joint.named_effects == ()
        possible = [e.name for e in EFFECTS if spring != RIGID or not e.needs_elastic_gear]
        assert list(joint.possible_effects) == possible


def test_auto_effects_are_not_simulated() -> None:
    auto = arm().with_joints(replace(joint, effects="auto") for joint in arm().joints)
    np.testing.assert_array_equal(
        auto.parameter_vector(ELASTIC_JOINT), arm().parameter_vector(ELASTIC_JOINT)
    )
    inputs = record_inputs(auto, ELASTIC_JOINT, "prbs", hanging=True)
    assert (inputs.values, inputs.offsets, inputs.slopes) == (ELASTIC_JOINT, {}, {})


def test_effects_must_be_a_list(tmp_path: Path) -> None:
    with pytest.raises(
        InvalidInput,
        match=r"'effects' is 'stribeck', but it should be a list of effects or \"auto\"",
    ):
        read_study(study(tmp_path, '"stribeck"'), logs_exist=False)


class Breakaway(Effect):
    """Stribeck friction with other typical values."""

    def typical_sizes(self, joint: KnownJoint) -> Values:
        return {"stribeck_friction": 0.5 * joint.coulomb_friction}


@pytest.fixture
def registered() -> Iterator[Effect]:
    effect = Breakaway(
        name="breakaway",
        core_name="stribeck",
        sizes=("stribeck_friction",),
        shapes={"stribeck_velocity": 2.0},
        description="friction that a motor at standstill has",
        consequence="Coulomb friction is biased",
        experiment="turn the motor slowly",
        record="a record of slow motion",
    )
    with added(effects.EFFECTS, effect):
        yield effect


def test_a_registered_effect_is_simulated(registered: Effect, tmp_path: Path) -> None:
    registered_arm = Arm.of(read_study(study(tmp_path, '["breakaway"]'), logs_exist=False).arm)
    assert registered_arm.joints[0].effects == ("breakaway",)
    assert ("stribeck_friction", 1) in registered_arm.parameter_names
    assert advice()["breakaway-likely"].remedy.startswith('Set effects = ["breakaway"]')
    own = registered.starts(KNOWN)
    np.testing.assert_array_equal(motion(("breakaway",), own), motion(("stribeck",), own))
    both = motion(("stribeck", "breakaway"), own)  # one effect of the core by two names
    np.testing.assert_array_equal(both, motion(("stribeck",), own))


@pytest.mark.usefixtures("registered")
def test_a_registered_effect_is_fitted() -> None:
    _, true, _ = records(("stribeck",))
    model = whole_arm.__wrapped__(("stribeck",), ("breakaway",))
    assert model.status == "converged"
    for name in ("stribeck_friction", "stribeck_velocity"):
        assert model.values[name, 1] == pytest.approx(true[name, 1], rel=0.05)


def test_an_unknown_effect_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="should be 'stribeck', "):
        read_study(study(tmp_path, '["breakaway"]'), logs_exist=False)
    with pytest.raises(InvalidInput, match="no effect 'breakaway'"):
        effect_named("breakaway")
    assert "breakaway-likely" not in advice()
