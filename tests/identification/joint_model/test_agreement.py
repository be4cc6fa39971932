"""Warnings for differences between the physical model and the measured response."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_results import JOINT, joint_model, measured
from strainwave.domain import FrequencyResponse
from strainwave.identification.joint_model import agreement, compare_response

RATIO = JOINT.gear_ratio


def codes(found: FrequencyResponse | None) -> list[str]:
    return [w.code for w in compare_response(joint_model(), RATIO, found).warnings]


def test_noise_and_distortion_make_a_point_doubtful() -> None:
    """Noise and distortion of a quarter of the response each: a third together."""
    response = replace(measured(), coherence=None)
    quarter = (0.25 * np.abs(response.response)) ** 2
    assert agreement.is_reliable(response).all()
    assert agreement.is_reliable(replace(response, noise_variance=quarter)).all()
    assert agreement.is_reliable(replace(response, distortion_variance=quarter)).all()
    noisy_and_distorted = replace(response, noise_variance=quarter, distortion_variance=quarter)
    assert not agreement.is_reliable(noisy_and_distorted).any()


def test_model_and_points_that_differ_are_a_warning() -> None:
    """A factor of 2, 6 dB, gives a warning; 7 % or a difference within the noise does not."""
    response = measured()
    assert (
        codes(None)
        == codes(response)
        == codes(replace(response, response=1.07 * response.response))
        == []
    )
    twice = replace(response, response=2.0 * response.response)
    (warning,) = compare_response(joint_model(), RATIO, twice).warnings
    assert (warning.code, warning.where) == ("response-apart", "joint 1")
    assert "on 100 % of the lines, by 6 dB near" in warning.message
    noise = np.abs(twice.response) ** 2 * 0.29**2  # of points that are still trusted
    assert codes(replace(twice, noise_variance=noise)) == []
    # No trusted point.
    assert codes(replace(twice, coherence=np.zeros((len(response.response), 2)))) == []


def test_the_models_own_doubt_counts_as_well() -> None:
    """The uncertainty of the model also explains a difference."""
    twice = replace(measured(), response=2.0 * measured().response)
    vague = replace(joint_model(), covariance=np.diag((0.6 * JOINT.vector) ** 2))
    assert compare_response(vague, RATIO, twice).warnings == ()
