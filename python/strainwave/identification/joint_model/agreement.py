"""Compare the frequency response of a `JointModel` with the measured response."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import (
    BoolArray,
    ComplexArray,
    Diagnostic,
    FloatArray,
    FrequencyResponse,
    JointModel,
    Place,
)
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.dynamics.two_inertia import jacobian, joint_of, state_space

BAND_EXTENSION_FACTOR = 3.0
"""Factor by which the compared and plotted frequency range exceeds the band of the fit."""

_MIN_COHERENCE = 0.8  # coherence below which a line is not compared
_MAX_RELATIVE_STD = 0.3  # relative standard deviation above which a line is not compared

_MIN_DIFFERENCE_DB = 2.0  # [dB] difference of about 25 %, clearly visible in the figure
_MIN_DIFFERING_SHARE = 0.2  # share of the lines; a smaller share may be leakage or a harmonic


def vector_of(joint: JointModel) -> FloatArray:
    """Parameters of a joint in the order of `TwoInertia`, (6,)."""
    return np.array(list(joint.values.values())[:6])


def motor_response(vector: FloatArray, gear_ratio: float, f: FloatArray) -> ComplexArray:
    """Frequency response from motor torque to motor velocity, G11 of (17).

    `vector` (6,) has the parameters of a joint in the order of `TwoInertia`; `f` (n_frequencies,)
    is in Hz. Returns (n_frequencies,) [rad/s/(N m)].
    """
    p = state_space(joint_of(vector, gear_ratio))
    s = 2j * np.pi * f[:, None, None]
    return np.asarray((p.C @ np.linalg.solve(s * np.eye(3) - p.A, p.B.astype(complex)))[:, 0, 0])


def response_jacobian(vector: FloatArray, gear_ratio: float, f: FloatArray) -> ComplexArray:
    """Derivatives of `motor_response` with respect to the parameters, (n_frequencies, 6)."""

    def parts(at: FloatArray) -> FloatArray:
        G = motor_response(at, gear_ratio, f)
        return np.concatenate([G.real, G.imag])

    real, imaginary = np.split(jacobian(parts, vector), 2)
    return np.asarray(real + 1j * imaginary)


def is_reliable(measured: FrequencyResponse) -> BoolArray:
    """Mask (n_frequencies,) of the lines with high coherence and a small standard deviation.

    The variance is the sum of the noise and distortion variances, where these are estimated.
    """
    variance = np.zeros(len(measured.frequencies_hz))
    for part in (measured.noise_variance, measured.distortion_variance):
        if part is not None:
            variance += part[:, 0, 0]
    mask = np.sqrt(variance) <= _MAX_RELATIVE_STD * np.abs(measured.response[:, 0, 0])
    if measured.coherence is not None:
        mask &= measured.coherence[:, 0] >= _MIN_COHERENCE
    return np.asarray(mask)


def compare_response(
    joint: JointModel, gear_ratio: float, measured: FrequencyResponse | None
) -> JointModel:
    """Return the joint, with a warning `response-apart` if model and measured response differ.

    They differ if more than a fifth of the lines lie outside both 95 % bands and more than 2 dB
    apart.
    """
    warning = None if measured is None else _difference(joint, gear_ratio, measured)
    return joint if warning is None else replace(joint, warnings=(*joint.warnings, warning))


def _difference(
    joint: JointModel, gear_ratio: float, measured: FrequencyResponse
) -> Diagnostic | None:
    """Warn with the share of differing lines and the largest difference; None if they agree."""
    low, high = joint.band_hz[0] / BAND_EXTENSION_FACTOR, joint.band_hz[1] * BAND_EXTENSION_FACTOR
    f = measured.frequencies_hz
    lines = (f >= low) & (f <= high) & is_reliable(measured)
    vector = vector_of(joint)
    if not lines.any() or not np.isfinite(vector).all():
        return None
    G, H = measured.response[lines, 0, 0], motor_response(vector, gear_ratio, f[lines])
    measured_std = np.zeros(len(G))
    if measured.noise_variance is not None:
        measured_std = np.sqrt(measured.noise_variance[lines, 0, 0])
    J = response_jacobian(vector, gear_ratio, f[lines])
    variance = np.einsum("fi,ij,fj->f", J, joint.covariance[:6, :6], J.conj()).real
    model_std = np.sqrt(np.clip(variance, 0.0, None))
    outside = np.abs(G - H) > CI95_STDS * (measured_std + model_std)
    difference_db = np.abs(20.0 * np.log10(np.abs(G) / np.abs(H)))
    differs = outside & (difference_db > _MIN_DIFFERENCE_DB)
    if np.mean(differs) <= _MIN_DIFFERING_SHARE:
        return None
    worst = int(np.argmax(np.where(differs, difference_db, 0.0)))
    return Diagnostic(
        "response-apart",
        Place(joint=joint.joint),
        share=float(np.mean(differs)),
        difference_db=float(difference_db[worst]),
        frequency_hz=float(f[lines][worst]),
    )
