"""Likely effect that the model lacks: distinction from rival effects, and automatic addition."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from effect_runs import ALIKE, EVERY, OF_THE_CORE, SHARES, whole_arm
from strainwave.domain import ArmModel, WholeArmOptions
from strainwave.domain.arm.effects import KnownJoint, all_effects, effect_named
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.inference.score_tests import (
    EffectColumns,
    EffectHypothesis,
    Shapes,
)
from strainwave.identification.whole_arm.problem.effect_unknowns import NamedEffect
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.search import Fit
from strainwave.identification.whole_arm.selection import causes
from strainwave.identification.whole_arm.selection.causes import with_large_part
from tuning_runs import linear_search, truth

MENDED = ("motor_inertia", "motor_coulomb_friction", STIFFNESS, "gear_damping")


def added_effects(model: ArmModel) -> list[str]:
    return [w.message.split(",")[0] for w in model.warnings if w.code == "effect-taken-up"]


@pytest.mark.parametrize("name", OF_THE_CORE)
def test_the_likeliest_cause_is_the_true_one(name: str) -> None:
    """It is named first and has the correct size; predicted shifts equal the actual ones.

    No resonance of a sensor mount is reported in its place.
    """
    check_cause(whole_arm((name,), ()), name)


@pytest.mark.parametrize("name", ["stribeck", "hysteresis", "backlash", "flexible-link"])
def test_the_derivatives_of_many_unknowns_may_lack_the_cause(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact = whole_arm((name,), ()).criticism
    monkeypatch.setattr(causes, "MAX_DUAL_UNKNOWNS", 0)
    model = whole_arm.__wrapped__((name,), ())
    check_cause(model, name)
    assert exact is not None
    assert model.criticism is not None
    gains = [criticism.causes[0].gain for criticism in (model.criticism, exact)]
    assert gains[0] == pytest.approx(gains[1], rel=5e-4)


def check_cause(model: ArmModel, name: str) -> None:
    codes = [w.code for w in model.warnings]
    (likely,) = (code for code in codes if code.endswith("-likely"))
    assert likely in [effect_named(effect).warning_code for effect in (name, *ALIKE.get(name, ()))]
    assert "sensor-mount" not in codes
    assert model.criticism is not None
    cause = model.criticism.causes[0]
    if cause.effect in ALIKE.get(name, ()):
        return
    assert (cause.joint, cause.effect) == (1, name)
    assert cause.share > SHARES.get(name, 0.1)
    true_values = truth()[1]
    for parameter in cause.parameters:
        if parameter.name in effect_named(name).sizes:
            assert parameter.value == pytest.approx(EVERY[parameter.name, 1], rel=0.1), parameter
    for move in cause.shifts:
        if move.name in MENDED and abs(move.deviations) > 5.0:
            true = true_values[move.name, move.joint]
            error = abs(move.without + move.shift - true)
            assert error < max(0.2 * abs(move.without - true), 0.01 * true), move


@pytest.mark.parametrize(
    "name", ["stribeck", "hysteresis", "kinematic-error", "backlash", "drive-lag"]
)
def test_a_significant_effect_is_added(name: str) -> None:
    """With few rival fits: the test above tells all effects apart, and each is fitted elsewhere."""
    model = whole_arm((name,), "auto", effort=0.1)
    assert added_effects(model) == [name]
    assert model.status == "converged"
    for parameter in MENDED:
        assert model.values[parameter, 1] == pytest.approx(truth()[1][parameter, 1], rel=0.005), (
            parameter
        )


@pytest.mark.parametrize(
    ("name", "shape", "value"),
    [
        ("flexible-link", "flexible_frequency", 15.0),
        ("flexible-link", "flexible_frequency", 60.0),
        ("torque-ripple", "torque_ripple_order", 4.0),
        ("kinematic-error", "kinematic_error_order", 4.0),
    ],
    ids=["a mode below", "a mode above", "another order", "another order of the gear"],
)
def test_an_effect_of_unusual_shape_is_named(name: str, shape: str, value: float) -> None:
    model = whole_arm((name,), (), shapes=(((shape, 1), value),))
    assert model.criticism is not None
    cause = model.criticism.causes[0]
    assert (cause.joint, cause.effect) == (1, name)
    true_values = EVERY | {(shape, 1): value}
    for parameter in cause.parameters:
        assert parameter.value == pytest.approx(true_values[parameter.name, 1], rel=0.1), parameter


def test_an_effect_of_unusual_shape_is_added() -> None:
    model = whole_arm(("flexible-link",), "auto", shapes=((("flexible_frequency", 1), 15.0),))
    assert added_effects(model) == ["flexible-link"]
    for parameter in MENDED:
        assert model.values[parameter, 1] == pytest.approx(truth()[1][parameter, 1], rel=0.005), (
            parameter
        )


POSSIBLE = [
    (joint, effect.name)
    for joint in (1, 2)
    for effect in all_effects()
    if joint == 1 or not effect.first_joint_only
] + [(joint, "stiffness-curve") for joint in (1, 2)]
"""Joint and effect of each possible hypothesis."""


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> Counter[NamedEffect]:
    """Counts how many sets of shapes of each effect are tested from here on."""
    columns_of, numbers = EffectColumns.of, Counter[NamedEffect]()

    def counted(fit: Fit, arm: Arm, tested: Mapping[EffectHypothesis, Shapes]) -> EffectColumns:
        numbers.update(hypothesis.named_effect for hypothesis in tested)
        return columns_of(fit, arm, tested)

    monkeypatch.setattr(EffectColumns, "of", counted)
    return numbers


def test_of_noise_each_effect_is_tested_once(counts: Counter[NamedEffect]) -> None:
    whole_arm((), (), most=59)
    assert counts == dict.fromkeys(POSSIBLE, 1)


@pytest.mark.parametrize(
    ("cutoff_hz", "below"),
    [(50.0, {"flexible-link": 5, "soft-base": 4}), (80.0, {"flexible-link": 6, "soft-base": 5})],
)
def test_of_more_than_noise_each_is_tested_at_all_its_shapes_within_the_band(
    counts: Counter[NamedEffect], cutoff_hz: float, below: dict[str, int]
) -> None:
    whole_arm(("hysteresis",), (), cutoff_hz=cutoff_hz)
    joint_parameters = KnownJoint(0.01, 0.05, 2e4, 30.0, 10.0)
    numbers = {effect.name: len(effect.tested_shapes(joint_parameters)) for effect in all_effects()}
    numbers |= below | {"stiffness-curve": 1}
    assert counts == {(joint, name): numbers[name] for joint, name in POSSIBLE}


def test_two_effects_are_added_one_after_the_other() -> None:
    model = whole_arm(("hysteresis", "load-friction"), "auto")
    assert sorted(added_effects(model)) == ["hysteresis", "load-friction"]
    for parameter in MENDED:
        assert model.values[parameter, 1] == pytest.approx(truth()[1][parameter, 1], rel=0.01), (
            parameter
        )


def test_effects_that_do_not_enter_widen_the_intervals() -> None:
    """The effect that explains most predicts better than the model that the study demands."""
    model = whole_arm(("hysteresis", "load-friction"), ())
    assert added_effects(model) == []
    assert model.criticism is not None
    weights = {cause.effect: cause.weight for cause in model.criticism.causes}
    assert weights["hysteresis"] > 0.95
    estimates = {p.key: p for p in model.parameters}
    for parameter in MENDED:
        low, high = estimates[parameter, 1].ci95 or (0.0, 0.0)
        assert low <= truth()[1][parameter, 1] <= high, parameter


def test_rivals_of_an_effect_gain_by_its_refinement(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rival that explains as much as the included effect keeps half of the weight."""
    objective = Objective.of(linear_search(1), [])
    final, before, rival, without = (
        Fit(objective, np.zeros(1), cost, 0) for cost in (1.0, 2.0, 2.0, 9.0)
    )
    folds = np.full(10, 2.0)  # log densities fall by the cost
    monkeypatch.setattr(
        causes, "held_out_scores", lambda fits: np.array([-fit.cost * folds for fit in fits])
    )
    weights = causes._weights(final, [without, rival], [(before, final, [before, rival])])
    np.testing.assert_allclose(weights, [0.0, 0.5], atol=1e-3)


def test_an_arm_without_effects_takes_up_none() -> None:
    model, reference = whole_arm((), "auto"), whole_arm((), ())
    assert added_effects(model) == []
    assert model.values == reference.values
    assert model.criticism is not None
    assert model.criticism.causes == ()


def test_the_parameter_shifts_of_a_cause_are_sorted() -> None:
    model = whole_arm(("hysteresis",), ())
    assert model.criticism is not None
    for cause in model.criticism.causes:
        shift_sizes = [abs(move.deviations) for move in cause.shifts]
        assert shift_sizes == sorted(shift_sizes, reverse=True)
        assert np.all(np.isfinite(shift_sizes))


def test_rivals_are_fitted_within_their_budget() -> None:
    """With zero effort rival effects are linearised, and a warning lists them."""
    named = whole_arm(("hysteresis",), ())
    assert named.criticism is not None
    assert named.criticism.causes
    assert not [w for w in named.warnings if w.code == "causes-not-fitted"]
    unfitted = whole_arm(("hysteresis",), (), effort=0.0)
    assert unfitted.criticism is not None
    assert all(cause.is_linearised for cause in unfitted.criticism.causes)
    (warning,) = [w for w in unfitted.warnings if w.code == "causes-not-fitted"]
    assert "hysteresis of joint 1" in warning.message
    assert "rival_effort" in warning.message
    assert unfitted.values == named.values


@pytest.mark.parametrize(
    ("joints", "evaluations", "linearised"), [(1, 124, 6), (2, 124, 6), (3, 55, 2), (7, 10, 0)]
)
def test_the_budget_of_fits_buys_fewer_of_more_joints(
    joints: int, evaluations: int, linearised: int
) -> None:
    record = SimpleNamespace(time=np.zeros(9_670), arm=SimpleNamespace(n_joints=joints))
    fit = SimpleNamespace(objective=SimpleNamespace(records=[record]))
    budget = causes._Budget(cast("Fit", fit), WholeArmOptions())
    assert (budget.evaluations, budget.remaining) == (evaluations, evaluations)
    assert budget.linearised == linearised


def test_a_large_part_of_a_link_starts_with_the_compliance_and_inertia_of_slow_torsion() -> None:
    study, values = truth()
    arm, hz = Arm.of(study.arm), 20.0
    (whole,) = arm.link_inertia(2)
    start = with_large_part(values | {("flexible_frequency", 2): hz}, (2, "flexible-link"), arm)
    part = start["flexible_inertia", 2]
    assert start[whole] + part == pytest.approx(values[whole])
    own = part * (2.0 * np.pi * hz) ** 2
    compliance = 1.0 / start[STIFFNESS, 2] + (part / values[whole]) ** 2 / own
    assert compliance == pytest.approx(1.0 / values[STIFFNESS, 2])
    # the spring of a slow part would be softer than the gear: the start keeps the gear
    slow = with_large_part(values | {("flexible_frequency", 2): 1.0}, (2, "flexible-link"), arm)
    assert slow[STIFFNESS, 2] == values[STIFFNESS, 2]
