"""Physical parameters from transfer functions, and both methods together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, tf2ss

from joint_records import case
from strainwave.domain import StateSpace
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model import (
    LinearOptions,
    PhysicalOptions,
    RecordOptions,
    from_state_space,
    identify_record,
    rigid_knowledge,
    state_space_of,
)
from strainwave.identification.joint_model.equations import RigidKnowledge
from two_inertia import SAMPLE_TIME, TwoInertia, state_space

EXACT = TwoInertia(torque_per_volt=1.0)
NOTHING = RigidKnowledge(None, None, None)
WELL_IDENTIFIED = ("motor_inertia", "link_inertia", "gear_stiffness")


def known(scale: float = 1.0, std: float = 0.0) -> RigidKnowledge:
    """Exact c_1 and c_0 of the joint, or a multiple of c_1."""
    c1 = scale * (EXACT.motor_inertia + 1e-4 * EXACT.link_inertia)
    c0 = EXACT.motor_viscous_friction + 1e-4 * EXACT.link_viscous_friction
    return RigidKnowledge((c1, std * c1), (c0, std * c0), None)


def exact_of(model: StateSpace, rigid: RigidKnowledge) -> dict[str, float]:
    joint_case = case(1, 1)
    return dict(
        from_state_space(model, joint_case.decoupled, Arm.of(joint_case.study.arm), rigid).values
    )


def test_an_exact_model_gives_its_joint_back() -> None:
    values = exact_of(EXACT.sampled(), known())
    for name in WELL_IDENTIFIED:
        assert values[name] == pytest.approx(getattr(EXACT, name), rel=1e-3)
    assert values["gear_damping"] == pytest.approx(EXACT.gear_damping, rel=1e-2)


def test_without_a_rigid_model_17_itself_is_inverted() -> None:
    values = exact_of(EXACT.sampled(), NOTHING)
    for name in (*WELL_IDENTIFIED, "gear_damping"):
        assert values[name] == pytest.approx(getattr(EXACT, name), rel=2e-3)


def test_an_error_of_c1_goes_straight_into_the_parameters() -> None:
    right, wrong = (exact_of(EXACT.sampled(), known(scale)) for scale in (1.0, 1.05))
    for name in WELL_IDENTIFIED:
        assert wrong[name] == pytest.approx(1.05 * right[name], rel=1e-6)


def test_the_records_joint_comes_back() -> None:
    for which in ((1, 1), (3, 2)):
        joint_case = case(*which)
        rigid = rigid_knowledge(joint_case.model, Arm.of(joint_case.study.arm), which[1])
        model = state_space_of(joint_case.decoupled)
        fit = from_state_space(model, joint_case.decoupled, Arm.of(joint_case.study.arm), rigid)
        for name in WELL_IDENTIFIED:
            assert fit.values[name] == pytest.approx(getattr(joint_case.truth, name), rel=0.03)
        assert fit.fit_percent["motor_velocity"] > 85.0
        assert fit.fit_percent["link_velocity"] > 85.0
        assert fit.fit_percent["reciprocity"] > 90.0
        assert fit.anti_resonance is not None
        assert fit.anti_resonance.frequency_std_hz is not None
        # the standard deviations contain those of c_1 and of the pole and zero pairs
        assert rigid.total_inertia is not None
        uncertain = replace(rigid, total_inertia=(rigid.total_inertia[0], 1e-4))
        uncertain_fit = from_state_space(
            model, joint_case.decoupled, Arm.of(joint_case.study.arm), uncertain
        )
        k = NAMES.index("link_inertia")
        assert uncertain_fit.covariance[k, k] > 2.0 * fit.covariance[k, k]
        # other models of the record increase them
        other_model = state_space_of(joint_case.decoupled, LinearOptions(band_hz=(4.0, 50.0)))
        combined_fit = from_state_space(
            model, joint_case.decoupled, Arm.of(joint_case.study.arm), rigid, [other_model]
        )
        assert combined_fit.values == fit.values
        assert np.all(np.diag(combined_fit.covariance) >= np.diag(fit.covariance) * (1.0 - 1e-9))


def test_a_joint_that_cannot_be_is_reported_and_not_clipped() -> None:
    """An anti-resonance above the resonance implies a negative link inertia."""
    joint_case = case(1, 1)
    rigid, slow, peak, dip = 5e-4, 2.5e-4, 100.0, 140.0
    numerator = [1.0 / dip**2, 0.1 / dip, 1.0]
    denominator = np.polymul([rigid, slow], [1.0 / peak**2, 0.1 / peak, 1.0])
    A, B, C, D, T = cont2discrete(tf2ss(numerator, denominator), SAMPLE_TIME, "zoh")
    assert T == SAMPLE_TIME
    model = state_space(A, B, C, D, hold=("zero",))
    fit = from_state_space(
        model,
        joint_case.decoupled,
        Arm.of(joint_case.study.arm),
        RigidKnowledge((rigid, 1e-6), (slow, 1e-6), None),
    )
    link = (rigid - rigid * dip**2 / peak**2) / joint_case.decoupled.gear_ratio**2
    assert fit.values["link_inertia"] == pytest.approx(link, rel=1e-6)
    assert fit.values["link_inertia"] < 0.0
    assert fit.status == "implausible"
    assert "link_inertia of joint 1" in {w.where for w in fit.warnings if w.code == "implausible"}


def test_a_model_without_covariance_has_values_and_no_deviations() -> None:
    joint_case = case(1, 1)
    model = state_space_of(joint_case.decoupled, LinearOptions(method="subspace"))
    fit = from_state_space(
        model,
        joint_case.decoupled,
        Arm.of(joint_case.study.arm),
        rigid_knowledge(joint_case.model, Arm.of(joint_case.study.arm), 1),
    )
    stiffness = next(p for p in fit.parameters if p.name == "gear_stiffness")
    assert stiffness.value == pytest.approx(joint_case.truth.gear_stiffness, rel=0.1)
    assert stiffness.std is None
    assert fit.anti_resonance is not None
    assert fit.anti_resonance.frequency_std_hz is None


def test_a_gear_ratio_that_is_wrong_breaks_reciprocity() -> None:
    joint_case = case(1, 1)
    sampled = EXACT.sampled()
    wrong = replace(sampled, B=sampled.B * [1.0, 3.0], D=sampled.D * [1.0, 3.0])
    codes = []
    for model in (sampled, wrong):
        fit = from_state_space(model, joint_case.decoupled, Arm.of(joint_case.study.arm), known())
        codes.append({w.code for w in fit.warnings})
    assert "not-reciprocal" not in codes[0]
    assert "not-reciprocal" in codes[1]


def test_a_rigid_model_of_another_arm_is_reported() -> None:
    joint_case = case(1, 1)
    fit = from_state_space(
        EXACT.sampled(), joint_case.decoupled, Arm.of(joint_case.study.arm), known(scale=1.5)
    )
    assert "inertia-mismatch" in {w.code for w in fit.warnings}


def test_a_model_that_does_not_ring_is_refused() -> None:
    joint_case = case(1, 1)
    sampled = EXACT.sampled()
    with pytest.raises(NotIdentifiable, match="no oscillating pair"):
        from_state_space(
            replace(sampled, A=np.diag([0.9, 0.8, 0.7])),
            joint_case.decoupled,
            Arm.of(joint_case.study.arm),
            known(),
        )


def test_a_record_shows_both_ways() -> None:
    joint_case = case(1, 1)
    record_model = identify_record(
        joint_case.signals, joint_case.decoupled, joint_case.model, Arm.of(joint_case.study.arm)
    )
    assert record_model.physical is not None
    assert record_model.transfer is not None
    assert record_model.modes is not None
    assert not record_model.warnings
    for name in WELL_IDENTIFIED:
        grey, linear = record_model.physical.values[name], record_model.transfer.values[name]
        assert linear == pytest.approx(grey, rel=0.03)


def test_a_failed_estimate_is_a_warning() -> None:
    """Without a link sensor there is no torsion; a band with too short sections gives no model."""
    joint_case = case(1, 1)
    links = tuple(replace(link, source="motor") for link in joint_case.signals.links)
    blind = replace(joint_case.signals, links=links)
    options = RecordOptions(linear=LinearOptions(band_hz=(0.5, 60.0)))
    record_model = identify_record(
        blind, joint_case.decoupled, joint_case.model, Arm.of(joint_case.study.arm), options
    )
    assert record_model.physical is None
    assert record_model.state_space is None
    assert record_model.transfer is None
    assert [w.code for w in record_model.warnings] == ["grey-box-failed", "state-space-failed"]


def test_options_reach_both_ways() -> None:
    joint_case = case(1, 1)
    options = RecordOptions(
        physical=PhysicalOptions(band_hz=(5.0, 45.0)), linear=LinearOptions(method="subspace")
    )
    record_model = identify_record(
        joint_case.signals,
        joint_case.decoupled,
        joint_case.model,
        Arm.of(joint_case.study.arm),
        options,
    )
    assert record_model.physical is not None
    assert record_model.physical.band_hz == (5.0, 45.0)
    assert record_model.state_space is not None
    assert record_model.state_space.method == "subspace"
