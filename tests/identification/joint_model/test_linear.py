"""State-space models of decoupled joints."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from joint_records import case
from strainwave.domain import Decoupled, Fusion, LinearOptions, StateSpace
from strainwave.dynamics.two_inertia import anti_resonance, resonance
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification.joint_model import linear
from strainwave.identification.joint_model.linear import (
    fit_linear,
    judge,
    modes_of,
    physical_order,
    state_space_of,
)
from strainwave.identification.joint_model.stretches import band_of, other_bands, velocities
from strainwave.statespace import frequency_response, remove_alternating_poles
from two_inertia import TwoInertia, state_space

CASES = [(1, 1), (2, 1), (3, 2), (4, 2)]


@cache
def model_of(seed: int, joint: int) -> StateSpace:
    return state_space_of(case(seed, joint).decoupled)


def frequencies(model: StateSpace) -> tuple[float, float]:
    mode_pair = modes_of(model)
    assert mode_pair.anti_resonance is not None
    assert mode_pair.resonance is not None
    return mode_pair.anti_resonance.frequency_hz, mode_pair.resonance.frequency_hz


@pytest.mark.parametrize("which", CASES)
def test_the_model_has_the_resonances_of_the_joint(which: tuple[int, int]) -> None:
    model, truth = model_of(*which), case(*which).truth
    assert model.order in (3, 4)  # the low-pass may add one state
    assert model.status == "converged"
    # a third of the requirement: stiction, quantisation and a record of one second
    expected = (anti_resonance(truth).frequency_hz, resonance(truth).frequency_hz)
    assert frequencies(model) == pytest.approx(expected, rel=0.007)
    assert min(model.fit_percent) > 85.0
    assert model.output_names == ("motor_velocity", "link_velocity")


def test_records_are_fitted_at_once() -> None:
    joint_case = case(1, 1).decoupled
    model = state_space_of([joint_case, joint_case])
    assert model.initial_states.shape == (2, model.order)
    assert frequencies(model) == pytest.approx(frequencies(model_of(1, 1)), rel=2e-3)


def test_only_uninterrupted_valid_stretches_are_used() -> None:
    joint_case = case(1, 1).decoupled
    gap = len(joint_case.valid) // 2
    valid = joint_case.valid.copy()
    valid[gap : gap + 10] = False
    disturbed = joint_case.outputs.copy()
    disturbed[gap : gap + 10] = 1e6
    model = state_space_of(replace(joint_case, valid=valid, outputs=disturbed))
    assert len(model.initial_states) == 2
    assert frequencies(model) == pytest.approx(frequencies(model_of(1, 1)), rel=0.01)


def test_options_change_the_model() -> None:
    joint_case = case(1, 1).decoupled
    assert state_space_of(joint_case, LinearOptions(order=4)).order == 4
    assert state_space_of(joint_case, LinearOptions(method="subspace")).method == "subspace"
    assert state_space_of(joint_case, LinearOptions(outputs="motor")).C.shape[0] == 1
    assert state_space_of(joint_case, LinearOptions(inputs="motor")).B.shape[1] == 1
    slow = state_space_of(joint_case, LinearOptions(band_hz=(4.0, 40.0)))
    assert slow.sample_time == pytest.approx(1.0 / 160.0, rel=0.05)


def test_too_many_states_give_way_to_the_physical_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear, "_best_order", lambda *_: 6)
    monkeypatch.setattr(linear, "_is_usable", lambda model: model.order == 3)
    model = state_space_of(case(1, 1).decoupled)
    assert model.order == 3
    assert [warning.code for warning in model.warnings] == ["order-reduced"]


def test_the_closed_form_is_of_the_physical_order() -> None:
    assert physical_order(LinearOptions()).order == 3
    assert physical_order(LinearOptions(order=4)).order == 4
    joint_case = case(1, 1)
    assert state_space_of(joint_case.decoupled, physical_order(LinearOptions())).order == 3


def test_leaving_the_interaction_out_is_wrong() -> None:
    """Without the interaction torque, the model has the coupled modes of the arm."""
    joint_case = case(1, 1)
    expected = anti_resonance(joint_case.truth).frequency_hz
    low, _ = frequencies(state_space_of(joint_case.decoupled, LinearOptions(inputs="motor")))
    assert abs(low / expected - 1.0) > 0.05


def test_no_stretch_is_long_enough() -> None:
    joint_case = case(1, 1).decoupled
    valid = np.arange(len(joint_case.valid)) % 400 != 0
    with pytest.raises(NotIdentifiable, match="no stretch"):
        state_space_of(replace(joint_case, valid=valid), LinearOptions(band_hz=(5.0, 60.0)))


def test_incompatible_records_are_refused() -> None:
    joint_case = case(1, 1).decoupled
    with pytest.raises(InvalidInput, match="different joints"):
        state_space_of([joint_case, replace(joint_case, joint=2)])
    with pytest.raises(InvalidInput, match="sampling periods"):
        state_space_of([joint_case, replace(joint_case, sample_time=2.0 * joint_case.sample_time)])
    with pytest.raises(InvalidInput, match="no record"):
        state_space_of([])


@pytest.mark.parametrize("order", [1, 2])
def test_the_fusion_is_undone(order: int) -> None:
    """Equation (10) and its inverse give the identity."""
    fusion = Fusion(0.2, 1 if order == 1 else 2)
    record: Decoupled = replace(case(1, 1).decoupled, fusion=fusion)
    f = np.geomspace(0.5, 100.0, 7)
    x = 2j * np.pi * f * 0.2
    F = 1.0 / (1.0 + x) if order == 1 else 1.0 / (1.0 + np.sqrt(2.0) * x + x**2)
    forward = np.zeros((7, 2, 2), dtype=complex)
    forward[:, 0, 0] = 1.0
    forward[:, 1, 0], forward[:, 1, 1] = record.gear_ratio * F, 1.0 - F
    unit = np.tile(np.eye(2), (7, 1, 1))
    assert velocities(f, record) @ forward == pytest.approx(unit, abs=1e-12)
    bare = replace(record, fusion=None)
    assert velocities(f, bare) == pytest.approx(unit)


def test_the_band() -> None:
    gain = band_of(np.array([0.01, 5.0, 16.0, 50.0, 1e4]), (5.0, 50.0))
    assert gain[[1, 3]] == pytest.approx([0.5, 0.5], rel=0.02)
    assert gain[2] > 0.9
    assert max(gain[0], gain[4]) < 1e-4
    (low, high), (lower, higher) = other_bands((5.0, 50.0), [case(1, 1).decoupled])
    assert lower < 5.0 < low
    assert high < 50.0 < higher


def test_an_alternating_pole_is_a_gain_in_the_band() -> None:
    """Without a pole at -0.6, the model has the same response at low frequencies."""
    joint = TwoInertia().sampled()
    A = np.zeros((4, 4))
    A[:3, :3], A[3, 3] = joint.A, -0.6
    rng = np.random.default_rng(1)
    small = 1e-2 * rng.standard_normal(2)
    full_model = state_space(
        A, np.vstack([joint.B, small]), np.hstack([joint.C, [[1.0], [1e-3]]]), joint.D
    )
    T = rng.standard_normal((4, 4)) + 3.0 * np.eye(4)
    inverse = np.linalg.inv(T)
    transformed = replace(
        full_model,
        A=T @ full_model.A @ inverse,
        B=T @ full_model.B,
        C=full_model.C @ inverse,
        K=T @ full_model.K,
        initial_states=full_model.initial_states @ T.T,
    )
    reduced = remove_alternating_poles(transformed)
    assert reduced.order == 3
    assert np.linalg.eigvals(reduced.A) == pytest.approx(np.linalg.eigvals(joint.A), rel=1e-9)
    f = np.array([2.0, 10.0, 30.0])
    before, after = (frequency_response(m, f).response for m in (transformed, reduced))
    assert after == pytest.approx(before, rel=0.02)
    assert remove_alternating_poles(joint) is joint


def test_deviations_stay_when_an_alternating_pole_is_left_out() -> None:
    """Standard deviations against the scatter of models drawn from the covariance and reduced."""
    joint = TwoInertia().sampled()
    A = np.zeros((4, 4))
    A[:3, :3], A[3, 3] = joint.A, -0.6
    rng = np.random.default_rng(2)
    small = 1e-2 * rng.standard_normal(2)
    unreduced = state_space(
        A, np.vstack([joint.B, small]), np.hstack([joint.C, [[1.0], [1e-3]]]), joint.D
    )
    names = ("A", "B", "C", "D", "K")
    entries = np.concatenate([getattr(unreduced, name).ravel() for name in names])
    std = 1e-5 * np.abs(entries)
    full_with_covariance = replace(unreduced, covariance=np.diag(std**2))
    reduced_modes = modes_of(full_with_covariance)

    def drawn() -> list[float]:
        values = entries + std * rng.standard_normal(len(std))
        parts = np.split(values, np.cumsum([getattr(unreduced, name).size for name in names])[:-1])
        shapes: dict[str, Any] = {
            name: part.reshape(getattr(unreduced, name).shape)
            for name, part in zip(names, parts, strict=True)
        }
        perturbed = modes_of(replace(unreduced, **shapes))
        assert perturbed.resonance is not None
        assert perturbed.anti_resonance is not None
        return [perturbed.resonance.frequency_hz, perturbed.anti_resonance.frequency_hz]

    scatter = np.std([drawn() for _ in range(300)], axis=0)
    assert reduced_modes.resonance is not None
    assert reduced_modes.anti_resonance is not None
    reported_std = [
        reduced_modes.resonance.frequency_std_hz,
        reduced_modes.anti_resonance.frequency_std_hz,
    ]
    assert reported_std == pytest.approx(scatter, rel=0.2)  # 300 draws: standard error of 4 %


@pytest.mark.parametrize("which", CASES[:2])
def test_held_out_data_are_predicted_and_feedback_is_detected(which: tuple[int, int]) -> None:
    """One-step prediction of the last quarter; the interaction torque is reported as feedback."""
    check = judge(fit_linear(case(*which).decoupled))
    assert min(check.prediction_fit_percent) > 90.0
    verdicts = {test.name: test.passed for test in check.tests}
    assert set(verdicts) == {"white", "independent-of-past-inputs", "no-feedback"}


def test_a_model_that_does_not_ring_is_not_judged() -> None:
    fit = fit_linear(case(1, 1).decoupled)
    model = fit.model
    not_oscillating = replace(model, A=np.diag(np.linspace(0.5, 0.7, model.order)))
    with pytest.raises(NotIdentifiable, match="does not ring"):
        judge(replace(fit, model=not_oscillating))
