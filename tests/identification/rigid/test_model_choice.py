"""Which further terms a rigid model takes: their significance, and the limit of leads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import virtual_arms
from strainwave.domain import FloatArray, Signals
from strainwave.domain.arm.kinds.base import MOTOR_SHARE
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.rigid import fit_rigid
from strainwave.identification.rigid.equations import ALL_JOINTS, FurtherTerm
from strainwave.identification.rigid.model_choice import MIN_STDS, ModelChoice
from strainwave.identification.rigid.trial import (
    Trial,
    fit_trial,
    prepare_all,
    search_bandwidths,
    select_bandwidth,
)

INERTIA, VISCOUS, COULOMB = 2e-3, 1e-3, 0.05
NOISE = 5e-3  # [N m]
STRIBECK_VELOCITY = 10.0  # [rad/s]
LOAD, STRIBECK = FurtherTerm("load-friction", 0), FurtherTerm("stribeck", 0, STRIBECK_VELOCITY)

ARM = Arm.of(virtual_arms.rigid_drive().arm)


def signals_of(
    *,
    asymmetry: float = 0.0,
    lead: int = 0,
    coulomb: float = COULOMB,
    load: float = 0.0,
    stribeck: float = 0.0,
    seed: int = 1,
    duration: float = 12.0,
) -> Signals:
    """A joint with friction by direction, load and speed, whose torque leads by samples."""
    motion = virtual_arms.exact_motion(1, seed=1, duration=duration)
    _, angle, velocity, acceleration = motion
    dry = coulomb + load * np.abs(MOTOR_SHARE * INERTIA * acceleration)
    dry = dry + stribeck * np.exp(-((velocity / STRIBECK_VELOCITY) ** 2))
    torque = INERTIA * acceleration + VISCOUS * velocity + dry * np.sign(velocity)
    torque = np.roll(torque + asymmetry * np.abs(velocity), -lead, axis=0)
    torque += np.random.default_rng(seed).normal(0.0, NOISE, torque.shape)
    signals = virtual_arms.exact_signals(motion, torque)
    inside = np.ones(angle.shape, dtype=bool)
    inside[len(angle) - abs(lead) :] = False
    return replace(signals, valid=inside)


def trial_of(signals: Signals, bandwidth_hz: float = 8.0) -> Trial:
    stretches = prepare_all(ARM, [(signals, float(len(signals.time)))], bandwidth_hz)
    return fit_trial(ARM, stretches, None)


def score(choice: ModelChoice, *terms: int) -> float:
    return float(np.sum(choice.models.scores(terms)))


def significance(choice: ModelChoice) -> FloatArray:
    return np.asarray(np.abs(choice.models.sizes([0])) / choice.models.size_stds([0]))


@pytest.mark.parametrize(("asymmetry", "enters"), [(2e-6, False), (2e-5, True)])
def test_a_term_enters_from_its_significance_on(asymmetry: float, *, enters: bool) -> None:
    """Both predict held-out stretches better; one of 80 candidates does so by chance."""
    candidate = FurtherTerm("direction-friction", 0, 50.0)
    choice = ModelChoice.of(trial_of(signals_of(asymmetry=asymmetry)), [candidate])
    assert score(choice, 0) > score(choice)
    assert (significance(choice) > MIN_STDS) == enters
    assert len(choice.select()) == enters


@pytest.mark.parametrize(("lead", "is_possible"), [(1, True), (3, False)])
def test_a_torque_leads_by_its_hold_and_the_order_of_the_log(
    lead: int, *, is_possible: bool
) -> None:
    choice = ModelChoice.of(
        trial_of(signals_of(lead=lead)), [FurtherTerm("torque-delay", ALL_JOINTS)]
    )
    expected = -lead * virtual_arms.CLOCK
    assert choice.models.sizes([0])[0] == pytest.approx(expected, rel=0.2)
    assert significance(choice) > MIN_STDS
    assert len(choice.select()) == is_possible


def coulomb_of(solution: FloatArray) -> float:
    return float(ARM.joint_friction(solution)[0, 1])


def test_no_term_makes_a_certain_coulomb_friction_negative() -> None:
    """The friction of the load is then larger than all dry friction."""
    choice = ModelChoice.of(trial_of(signals_of(coulomb=-0.01, load=0.5)), [LOAD])
    trial = choice.trial
    std = float(ARM.joint_friction(trial.standard_deviations)[0, 1])
    assert coulomb_of(trial.solution) > trial.interval_half_width * std
    assert coulomb_of(choice.models.solution([0])) < 0.0
    assert score(choice, 0) > score(choice)
    assert significance(choice) > MIN_STDS
    assert choice.select() == []


def test_a_term_may_change_the_sign_of_an_uncertain_coulomb_friction() -> None:
    """Sensors behind gears show almost no dry friction: its estimate is noise around zero."""
    signals = signals_of(coulomb=0.0, asymmetry=-2e-5, seed=2)
    choice = ModelChoice.of(trial_of(signals), [FurtherTerm("direction-friction", 0, 50.0)])
    assert coulomb_of(choice.trial.solution) > 0.0 > coulomb_of(choice.models.solution([0]))
    assert len(choice.select()) == 1


def test_two_terms_together_are_plausible() -> None:
    """Each changes the Coulomb friction; the model error contains the change by both."""
    choice = ModelChoice.of(trial_of(signals_of(load=0.1, stribeck=0.03)), [LOAD, STRIBECK])
    alone = coulomb_of(choice.models.solution([]))
    changes = [coulomb_of(choice.models.solution(m)) - alone for m in ([0], [1], [0, 1])]
    error = np.sqrt(coulomb_of(np.diag(choice.model_error())))
    assert abs(changes[2]) > 1.2 * max(abs(changes[0]), abs(changes[1]))
    assert error == pytest.approx(abs(changes[2]), rel=0.1)


def test_the_bandwidth_is_that_of_the_model_with_its_terms() -> None:
    """Without them, the change of the estimates with the bandwidth favours the lowest one."""
    signals = signals_of(coulomb=0.02, load=0.3, duration=6.0)
    plain = select_bandwidth(search_bandwidths([(signals, float(len(signals.time)))], ARM))
    model = fit_rigid([signals], ARM)
    assert model.bandwidth_hz > 2.0 * plain.bandwidth_hz
    assert [term.effect for term in model.friction_terms] == ["load-friction"]
    assert model.friction_terms[0].size.value == pytest.approx(0.3, rel=0.01)


def test_a_record_within_the_edges_of_the_filter_is_refused() -> None:
    with pytest.raises(NotIdentifiable, match="every sample is at an edge"):
        trial_of(signals_of(), bandwidth_hz=0.1)
