"""Physical consistency of the comparisons on an arm with known true values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from reproduction import (
    PUBLISHED_SETTINGS,
    ComparisonOptions,
    amplitude,
    compare,
    decoupled,
    document_of,
    refinement,
    to_json,
)
from reproduction.joint_estimates import LINES_HZ, distance_db, response_of
from reproduction.records import Comparison, Evidence, Tally
from reproduction.rig import CLASSICAL_METHOD, Rig, WholeArmEstimate, joint_with
from strainwave.domain import Decoupled, InputOutput, LinearOptions
from strainwave.dynamics.two_inertia import TwoInertia
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model import linear, stretches
from strainwave.virtual import scara

ByFigure = dict[int, Comparison]


def value(comparison: Comparison, name: str) -> float:
    """Value of the criterion whose name starts with `name`."""
    return next(c.value for c in comparison.criteria if c.name.startswith(name))


def test_every_figure_has_criteria_claim_and_plots(comparisons: ByFigure) -> None:
    assert list(comparisons) == [2, *range(4, 16)]
    assert all(c.criteria and c.claim and c.message for c in comparisons.values())
    assert all(c.plots for figure, c in comparisons.items() if figure != 2)


@pytest.mark.parametrize("figure", [2, *range(4, 16)])
def test_claims_are_shown(comparisons: ByFigure, figure: int) -> None:
    assert comparisons[figure].outcome == "shown", comparisons[figure].reasons


def test_every_model_has_a_status(comparisons: ByFigure) -> None:
    for figure in (2, 6, 7, 8, 9, 10, 11, 13, 14, 15):
        assert comparisons[figure].evidence
    for c in comparisons.values():
        assert all(e.status and e.name and e.method for e in c.evidence)
        if c.outcome == "shown":
            assert all(e.sound for e in c.evidence if e.decisive)


def test_state_space_models_converge(comparisons: ByFigure) -> None:
    # the estimation filter keeps the noise white, so all models converge
    pem = [e for c in comparisons.values() for e in c.evidence if e.method == "pem"]
    assert len(pem) > 10
    assert {e.status for e in pem} == {"converged"}


def test_the_prbs_spectrum_is_flat_up_to_its_hold(comparisons: ByFigure) -> None:
    # sinc^2(100 Hz x 1 ms) is -0.14 dB, the only ripple of a maximum-length sequence with 1 ms hold
    assert value(comparisons[4], "ripple") == pytest.approx(0.14, abs=0.02)


@pytest.mark.parametrize("figure", [5, 12])
def test_the_computed_torque_matches_the_true_torque(comparisons: ByFigure, figure: int) -> None:
    assert value(comparisons[figure], "fit of the computed") > 98.0


@pytest.mark.parametrize("figure", [6, 9])
def test_the_rigid_lag_corrects_low_frequencies(comparisons: ByFigure, figure: int) -> None:
    off = comparisons[figure].values
    assert off["modified_slow_db"] < 0.05
    assert off["modified_slow_db"] < off["initial_slow_db"] or figure == 9
    assert off["tuned_db"] < 0.05


def test_models_without_the_torque_have_other_resonances(comparisons: ByFigure) -> None:
    for joint in (1, 2):
        for mode in ("anti-resonance", "resonance"):
            assert value(comparisons[10], f"joint {joint}, error of the {mode}") < 5.0
        assert value(comparisons[10], f"joint {joint} by motor input only") > 5.0


def test_pem_is_more_accurate_in_closed_loop(comparisons: ByFigure) -> None:
    result = comparisons[13]
    assert value(result, "PEM, joint 2 servoed") < 5.0
    assert value(result, "joint 2 servoed, larger error of both by the subspace") > 1.0
    assert {e.order for e in result.evidence} == {3}


def test_the_equivalent_stiffness_is_the_mean_slope(comparisons: ByFigure) -> None:
    values = comparisons[15].values
    for joint in (1, 2):
        for volt in (4, 10):
            name = f"joint {joint} at {volt} V, square"
            # 5 %: Coulomb friction and the knees are nonlinear
            true = values[f"{name}, truth [rad²/s²]"]
            assert values[f"{name} [rad²/s²]"] == pytest.approx(true, rel=0.05)


def test_the_largest_amplitude_does_not_show_k3_of_stiff_gears() -> None:
    options = ComparisonOptions(figures=(2,), amplitudes=(10.0,))
    (stiffest,) = compare(seed=1, built_in=scara.STIFF, options=options)
    assert stiffest.outcome == "does-not-hold"
    assert max(c.value for c in stiffest.criteria) < 0.9


def sound(name: str = "given") -> tuple[Evidence, ...]:
    return (Evidence(name, "none", "converged"),)


def test_claims_of_tuning_can_fail() -> None:
    rig = Rig(1)
    truth = WholeArmEstimate(scara.SOFT.parameters(), sound())
    result = refinement.responses(rig, 1, truth)
    assert result.outcome == "shown"
    assert result.values["tuned_db"] == pytest.approx(0.0, abs=1e-9)
    stiff = WholeArmEstimate(
        scara.SOFT.parameters(spring="linear") | {("gear_stiffness", 1): 60000.0}, sound()
    )
    missed = refinement.responses(rig, 1, stiff)
    assert missed.outcome == "does-not-hold"
    assert "stiffness" in missed.reasons[0]
    assert refinement.tuning(rig, truth, stiff).outcome == "does-not-hold"
    heavy = WholeArmEstimate(scara.SOFT.parameters() | {("motor_inertia", 1): 3e-4}, sound())
    assert refinement.validation(rig, truth).outcome == "shown"
    assert refinement.validation(rig, heavy).outcome == "does-not-hold"


@pytest.mark.parametrize("status", ["iteration-limit", "stalled", "at-bounds", "failed"])
def test_models_that_did_not_converge_show_nothing(status: str) -> None:
    doubtful = WholeArmEstimate(
        scara.SOFT.parameters(), (Evidence("whole arm", "whole-arm fit", status),)
    )
    result = refinement.validation(Rig(1), doubtful)
    assert result.outcome == "not-shown"
    assert result.reasons == (f"whole arm: {status}",)


def test_unstable_models_show_nothing(comparisons: ByFigure) -> None:
    good = comparisons[10]
    assert good.outcome == "shown"
    first, *rest = good.evidence
    unstable = replace(good, evidence=(replace(first, growth=1.03), *rest))
    assert unstable.outcome == "not-shown"
    assert "unstable, pole of modulus 1.030" in unstable.reasons[0]
    # a model that is not decisive has no effect
    beside = replace(good, evidence=(replace(first, growth=1.03, decisive=False), *rest))
    assert beside.outcome == "shown"


@pytest.mark.parametrize("figure", [4, 8, 10, 12, 14, 15])
def test_corrupt_values_show_no_claim(comparisons: ByFigure, figure: int) -> None:
    good = comparisons[figure]
    for k, criterion in enumerate(good.criteria):
        for bad in (
            float("nan"),
            criterion.limit + (1.0 if criterion.bound == "at most" else -1.0),
        ):
            criteria = list(good.criteria)
            criteria[k] = replace(criterion, value=bad)
            assert replace(good, criteria=tuple(criteria)).outcome == "does-not-hold"


def test_claims_over_the_amplitude_can_fail() -> None:
    rig = Rig(1)
    low, high = amplitude.estimate_levels(rig, 1, (6.0, 10.0), 1)
    assert amplitude.responses({1: (low, high)}).outcome == "shown"
    falling = amplitude.responses({1: (high, low)})
    assert falling.outcome == "does-not-hold"
    outside = replace(high, square=2.0 * high.bounds[1])
    assert amplitude.squares({1: (low, outside)}).outcome == "does-not-hold"
    doubtful = replace(
        high, evidence=tuple(replace(e, status="implausible") for e in high.evidence)
    )
    assert amplitude.squares({1: (low, doubtful)}).outcome == "not-shown"


def test_a_failed_estimation_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise NotIdentifiable("no stretch is long enough")

    monkeypatch.setattr(decoupled, "methods", fail)
    (result,) = compare(seed=1, options=ComparisonOptions(figures=(13,)))
    assert result.outcome == "not-shown"
    assert "no stretch" in result.reasons[0]


def test_outcomes_do_not_depend_on_blas_threads() -> None:
    options = ComparisonOptions(figures=(10,))
    result = []
    for threads in (1, 2):
        with threadpool_limits(limits=threads, user_api="blas"):
            tally = Tally(compare(seed=1, options=options))
            result.append(to_json(document_of([tally], [1])))
    assert result[0] == result[1]


def test_the_published_settings_match_the_source() -> None:
    rig = Rig(1, PUBLISHED_SETTINGS)
    run = rig.prbs(1)
    assert run.log.sample_time == 2.5e-5
    assert len(run.log) == 40920  # one period of 1.023 s
    model = rig.estimate(run).model
    assert model is not None
    assert (model.order, model.method) == (4, "pem")
    assert model.sample_time == pytest.approx(2e-3)
    assert rig.estimate(run, method=CLASSICAL_METHOD).evidence.status == "estimated"


def test_the_published_claims_can_be_shown_and_fail() -> None:
    options = ComparisonOptions(figures=(2, 10), amplitudes=(10.0,))
    stiffest, inputs = compare(seed=1, settings=PUBLISHED_SETTINGS, options=options)
    assert inputs.outcome == stiffest.outcome == "shown"
    assert inputs.protocol == stiffest.protocol == "as-published"
    assert {e.method for e in stiffest.evidence} == {"pem"}


def test_held_inputs_give_unstable_models(monkeypatch: pytest.MonkeyPatch) -> None:
    # a statement of the page: with inputs held for 2 ms, models of order 4 are unstable
    def held(
        record: Decoupled, band: tuple[float, float], options: LinearOptions
    ) -> list[InputOutput]:
        return [replace(piece, hold=("zero", "zero")) for piece in decimate(record, band, options)]

    decimate = stretches._decimate
    run = Rig(0, PUBLISHED_SETTINGS).prbs(1)
    monkeypatch.setattr(stretches, "_decimate", held)
    options = replace(PUBLISHED_SETTINGS.linear, focus="prediction")
    model = linear.state_space_of(run.decoupled, options)
    assert np.abs(np.linalg.eigvals(model.A)).max() > 1.05  # 3.4 on the soft arm


def test_seeds_differ_in_noise_and_in_the_sequence() -> None:
    voltages = [Rig(seed).prbs(1, disks=0, periods=1).log.channels["u1"] for seed in (1, 2)]
    assert not np.array_equal(voltages[0], voltages[1])


def test_distance_of_a_gain() -> None:
    joint: TwoInertia = joint_with(scara.SOFT.parameters(), 1, 20000.0, 0.01)
    one = response_of(joint).response[:, 0, 0]
    assert distance_db(2.0 * one, one) == pytest.approx(20.0 * np.log10(2.0))
    assert len(one) == len(LINES_HZ)
