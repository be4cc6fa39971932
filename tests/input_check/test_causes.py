"""Candidate causes and suspicions are data, for any number of joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from consistency_inputs import Input
from strainwave.domain import ArmDescription, Experiment, Joint, Place
from strainwave.identification.rigid.torque_constants import suspect_torque_constants
from strainwave.input_check import report_remaining
from strainwave.input_check.evidence import Evidence, SlowRecord, collect_evidence
from strainwave.input_check.hypothesis import UnexplainedEvidence
from strainwave.input_check.input_hypotheses import propose_hypotheses
from strainwave.input_check.observations import EXPECTED, is_of_link, observe
from strainwave.virtual import scara


def test_channels_of_any_two_joints_may_be_exchanged() -> None:
    arm = ArmDescription("serial", (Joint("linear", 0.01),) * 3)
    study = replace(scara.STIFF.study(Path("nowhere")), arm=arm, channels={})
    channels = {f"{kind}{i}": np.zeros(1) for kind in ("u", "theta_m") for i in (1, 2, 3)}
    record = SlowRecord(
        experiment=Experiment("motion", "", "motion", ("open",) * 3),
        sample_time=0.1,
        bandwidth_hz=1.0,
        channels=channels,
        noise=dict.fromkeys(channels, 0.0),
        moves=np.ones(1, dtype=bool),
        direction=np.zeros((1, 3)),
        inside=np.ones(1, dtype=bool),
        prbs_clock=None,
        servo_clock=None,
        levels={},
        excited=frozenset(),
        delays={},
    )
    suspicions = [
        cause.suspicion(study)
        for cause in propose_hypotheses(UnexplainedEvidence(Evidence(study, (record,), {}), ()))
    ]
    exchanged = [each.message for each in suspicions if each.code == "swapped-channels"]
    both = "u{0}, u{1} and theta_m{0}, theta_m{1}: the channels of joints {0} and {1} are exchanged"
    for pair in ((1, 2), (1, 3), (2, 3)):
        assert both.format(*pair) in exchanged


@pytest.fixture(scope="module")
def evidence(small_arm: Input) -> Evidence:
    return collect_evidence(*small_arm)


def test_the_joint_of_an_observation_has_any_number_of_digits() -> None:
    assert observe("scale", Place(channel="a12"), 2.0, 0.1).joint == 12
    assert is_of_link(observe("scale", Place(channel="a12"), 2.0, 0.1))
    assert observe("prbs-clock", Place.in_records("step-12"), 2.0, 0.1).joint is None
    assert observe("explained-share", Place(joint=12), 0.1, 0.0).joint == 12


@pytest.mark.parametrize("kind", sorted(EXPECTED))
def test_each_kind_of_contradiction_has_a_text(kind: str) -> None:
    place = Place.in_records("motion", joint=1) if "clock" in kind else Place(channel="a2")
    each = observe(kind, place, 3.0, 0.1)
    likely = ("ac-coupled", "wrong-unit")
    (suspicion,) = report_remaining([each], likely)
    assert suspicion.where == ("motion" if "clock" in kind else "a2")
    assert suspicion.where in suspicion.message or kind in ("friction", "mass")
    assert suspicion.remedy.startswith("No single cause explains all contradictions.")
    assert "(1) ac coupled: " in suspicion.remedy
    assert "; (4) wrong sign: " in suspicion.remedy


def test_torque_constants_of_any_joint_are_named(evidence: Evidence) -> None:
    ratios = {2: (1.001, 0.001), 3: (1.5, 0.01), 11: (1.2, 0.01)}
    suspicion = suspect_torque_constants(ratios, evidence.study)
    assert suspicion is not None
    assert "of joint 3 and the symmetry" in suspicion.message


def test_delays_of_one_kind_are_one_cause(evidence: Evidence) -> None:
    late = observe("delay", Place(channel="a1"), 0.02, 1e-4)
    causes = [*propose_hypotheses(UnexplainedEvidence(evidence, (late,)))]
    causes = [each for each in causes if each.code == "misaligned"]
    assert causes[-1].places == (Place(channel="a1"),)
    message = causes[-1].suspicion(evidence.study).message
    assert message.startswith("a1: 20 ms late relative to the motor angle")
