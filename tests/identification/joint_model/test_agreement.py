"""Where the physical model and the measured response differ, a warning says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_results import JOINT, joint_model, measured
from strainwave.domain import FrequencyResponse
from strainwave.identification.joint_model import agreement, compared

RATIO = JOINT.gear_ratio


def codes(found: FrequencyResponse | None) -> list[str]:
    return [w.code for w in compared(joint_model(), RATIO, found).warnings]


def test_noise_and_distortion_make_a_point_doubtful() -> None:
    """Each alone is a quarter of the response, together a third."""
    found = replace(measured(), coherence=None)
    quarter = (0.25 * np.abs(found.response)) ** 2
    assert agreement.trusted(found).all()
    assert agreement.trusted(replace(found, noise_variance=quarter)).all()
    assert agreement.trusted(replace(found, distortion_variance=quarter)).all()
    both = replace(found, noise_variance=quarter, distortion_variance=quarter)
    assert not agreement.trusted(both).any()


def test_model_and_points_that_differ_are_a_warning() -> None:
    """Twice as large is 6 dB; a tenth of that is none, nor is what the points' own noise explains."""
    at = measured()
    assert codes(None) == codes(at) == codes(replace(at, response=1.07 * at.response)) == []
    twice = replace(at, response=2.0 * at.response)
    (said,) = compared(joint_model(), RATIO, twice).warnings
    assert (said.code, said.where) == ("response-apart", "joint 1")
    assert "on 100 % of the lines, by 6 dB near" in said.message
    noise = np.abs(twice.response) ** 2 * 0.29**2  # of points that still count as trusted
    assert codes(replace(twice, noise_variance=noise)) == []
    assert codes(replace(twice, coherence=np.zeros((len(at.response), 2)))) == []  # none to trust


def test_the_models_own_doubt_counts_as_well() -> None:
    twice = replace(measured(), response=2.0 * measured().response)
    vague = replace(joint_model(), covariance=np.diag((0.6 * JOINT.vector) ** 2))
    assert compared(vague, RATIO, twice).warnings == ()
