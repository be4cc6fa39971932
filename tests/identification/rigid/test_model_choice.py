"""Which further terms a rigid model takes: their significance, and the limit of leads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import virtual_arms
from strainwave.domain import FloatArray, Signals
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.rigid.bandwidth import prepare_all
from strainwave.identification.rigid.equations import ALL_JOINTS, Candidate
from strainwave.identification.rigid.model_choice import MIN_STDS, Choice
from strainwave.identification.rigid.trial import Trial, fit_trial

INERTIA, VISCOUS, COULOMB = 2e-3, 1e-3, 0.05
NOISE = 5e-3  # [N m]


ARM = Arm.of(virtual_arms.rigid_drive().arm)


def signals_of(*, asymmetry: float = 0.0, lead: int = 0) -> Signals:
    """A joint with friction by direction, whose torque leads by samples."""
    motion = virtual_arms.exact_motion(1, seed=1)
    _, angle, velocity, acceleration = motion
    torque = INERTIA * acceleration + VISCOUS * velocity + COULOMB * np.sign(velocity)
    torque = np.roll(torque + asymmetry * np.abs(velocity), -lead, axis=0)
    torque += np.random.default_rng(1).normal(0.0, NOISE, torque.shape)
    signals = virtual_arms.exact_signals(motion, torque)
    inside = np.ones(angle.shape, dtype=bool)
    inside[len(angle) - abs(lead) :] = False
    return replace(signals, valid=inside)


def trial_of(signals: Signals, bandwidth_hz: float = 8.0) -> Trial:
    stretches = prepare_all(ARM, [(signals, float(len(signals.time)))], bandwidth_hz)
    return fit_trial(ARM, stretches, None)


def score(choice: Choice, *terms: int) -> float:
    return float(np.sum(choice.models.scores(terms)))


def significance(choice: Choice) -> FloatArray:
    return np.asarray(np.abs(choice.models.sizes([0])) / choice.models.size_stds([0]))


@pytest.mark.parametrize(("asymmetry", "enters"), [(2e-6, False), (2e-5, True)])
def test_a_term_enters_from_its_significance_on(asymmetry: float, *, enters: bool) -> None:
    """Both predict held-out stretches better; one of 80 candidates does so by chance."""
    candidate = Candidate("direction-friction", 0, 50.0)
    choice = Choice.of(trial_of(signals_of(asymmetry=asymmetry)), [candidate])
    assert score(choice, 0) > score(choice)
    assert (significance(choice) > MIN_STDS) == enters
    assert len(choice.select()) == enters


@pytest.mark.parametrize(("lead", "is_possible"), [(1, True), (3, False)])
def test_a_torque_leads_by_its_hold_and_the_order_of_the_log(
    lead: int, *, is_possible: bool
) -> None:
    choice = Choice.of(trial_of(signals_of(lead=lead)), [Candidate("torque-delay", ALL_JOINTS)])
    expected = -lead * virtual_arms.CLOCK
    assert choice.models.sizes([0])[0] == pytest.approx(expected, rel=0.2)
    assert significance(choice) > MIN_STDS
    assert len(choice.select()) == is_possible


def test_a_record_within_the_edges_of_the_filter_is_refused() -> None:
    with pytest.raises(NotIdentifiable, match="every sample is at an edge"):
        trial_of(signals_of(), bandwidth_hz=0.1)
