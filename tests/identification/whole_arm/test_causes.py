"""The likeliest effect that a model lacks: told from its rivals, and taken up where asked to be."""

from __future__ import annotations

import numpy as np
import pytest

from effect_runs import ALIKE, EVERY, OF_THE_CORE, tuned
from strainwave.domain import ArmModel
from strainwave.domain.effects import effect_named
from strainwave.domain.gear_laws import STIFFNESS
from tuning_runs import truth

MENDED = ("motor_inertia", "motor_coulomb_friction", STIFFNESS, "gear_damping")


def taken_up(model: ArmModel) -> list[str]:
    return [w.message.split(",")[0] for w in model.warnings if w.code == "effect-taken-up"]


@pytest.mark.parametrize("name", OF_THE_CORE)
def test_the_likeliest_cause_is_the_true_one(name: str) -> None:
    """Its size is right, and what it would move is what it has moved."""
    model = tuned((name,), ())
    assert model.criticism is not None
    cause = model.criticism.causes[0]
    if cause.effect in ALIKE.get(name, ()):
        return
    assert (cause.joint, cause.effect) == (1, name)
    assert cause.share > 0.1
    known = truth()[1]
    for own in cause.parameters:
        if own.name in effect_named(name).sizes:
            assert own.value == pytest.approx(EVERY[own.name, 1], rel=0.1), own
    for move in cause.shifts:
        if move.name in MENDED and abs(move.deviations) > 5.0:
            true = known[move.name, move.joint]
            off = abs(move.without + move.shift - true)
            assert off < max(0.2 * abs(move.without - true), 0.01 * true), move


@pytest.mark.parametrize("name", OF_THE_CORE)
def test_what_the_records_demand_is_taken_up(name: str) -> None:
    model = tuned((name,), "auto")
    assert taken_up(model) == [name]
    assert model.status == "converged"
    for other in MENDED:
        assert model.values[other, 1] == pytest.approx(truth()[1][other, 1], rel=0.005), other


def test_two_effects_are_taken_up_one_after_the_other() -> None:
    model = tuned(("hysteresis", "load-friction"), "auto")
    assert sorted(taken_up(model)) == ["hysteresis", "load-friction"]
    for other in MENDED:
        assert model.values[other, 1] == pytest.approx(truth()[1][other, 1], rel=0.01), other


def test_an_arm_without_effects_takes_up_none() -> None:
    model, plain = tuned((), "auto"), tuned((), ())
    assert taken_up(model) == []
    assert model.values == plain.values
    assert model.criticism is not None
    assert model.criticism.causes == ()


def test_what_a_cause_would_move_is_in_order() -> None:
    model = tuned(("hysteresis",), ())
    assert model.criticism is not None
    for cause in model.criticism.causes:
        deviations = [abs(move.deviations) for move in cause.shifts]
        assert deviations == sorted(deviations, reverse=True)
        assert np.all(np.isfinite(deviations))
