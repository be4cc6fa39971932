"""JointModel, FrequencyResponse -> whether the physical model and the measured response agree."""

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
)
from strainwave.dynamics.two_inertia import jacobian, joint_of, state_space

OUTSIDE = 3.0
"""How far beyond the band of the fit a response is compared, and drawn, as a factor."""

_COHERENT = 0.8  # below that a line is doubtful
_BLURRED = 0.3  # and so it is above this relative deviation
REACH = 1.96
"""Of a 95 % band, in deviations."""

_APART = 2.0  # [dB], a quarter: what nobody overlooks in the figure
_MANY = 0.2  # of the lines; fewer may be leakage or a harmonic


def vector_of(joint: JointModel) -> FloatArray:
    """A joint's parameters in the order of `TwoInertia`.

    Returns: (6,).
    """
    return np.array(list(joint.values.values())[:6])


def motor_response(vector: FloatArray, gear_ratio: float, f: FloatArray) -> ComplexArray:
    """G11 of (17): motor torque to motor velocity.

    `vector` (6,): A joint's parameters in the order of `TwoInertia`.
    `f` (n_frequencies,) [Hz].

    Returns: (n_frequencies,) [rad/s/(N m)].
    """
    A, B, C = state_space(joint_of(vector, gear_ratio))
    s = 2j * np.pi * f[:, None, None]
    return np.asarray((C @ np.linalg.solve(s * np.eye(3) - A, B.astype(complex)))[:, 0, 0])


def response_jacobian(vector: FloatArray, gear_ratio: float, f: FloatArray) -> ComplexArray:
    """Derivatives of `motor_response` by the parameters.

    `vector, gear_ratio, f`: As for `motor_response`.

    Returns: (n_frequencies, 6).
    """

    def parts(at: FloatArray) -> FloatArray:
        G = motor_response(at, gear_ratio, f)
        return np.concatenate([G.real, G.imag])

    real, imaginary = np.split(jacobian(parts, vector), 2)
    return np.asarray(real + 1j * imaginary)


def trusted(measured: FrequencyResponse) -> BoolArray:
    """Where the output follows the input, and neither noise nor distortion blurs by how much.

    Returns: (n_frequencies,).
    """
    variance = np.zeros(len(measured.frequencies_hz))
    for part in (measured.noise_variance, measured.distortion_variance):
        if part is not None:
            variance += part[:, 0, 0]
    sure = np.sqrt(variance) <= _BLURRED * np.abs(measured.response[:, 0, 0])
    if measured.coherence is not None:
        sure &= measured.coherence[:, 0] >= _COHERENT
    return np.asarray(sure)


def compared(
    joint: JointModel, gear_ratio: float, measured: FrequencyResponse | None
) -> JointModel:
    """The joint, with the warning `response-apart` where model and measured response differ.

    They do where more than a fifth of the lines lie beyond both 95 % bands and 2 dB.
    """
    text = None if measured is None else _difference(joint, gear_ratio, measured)
    if text is None:
        return joint
    apart = Diagnostic("response-apart", f"joint {joint.joint}", text)
    return replace(joint, warnings=(*joint.warnings, apart))


def _difference(joint: JointModel, gear_ratio: float, measured: FrequencyResponse) -> str | None:
    """How much they differ, and near which frequency."""
    low, high = joint.band_hz[0] / OUTSIDE, joint.band_hz[1] * OUTSIDE
    f = measured.frequencies_hz
    at = (f >= low) & (f <= high) & trusted(measured)
    vector = vector_of(joint)
    if not at.any() or not np.isfinite(vector).all():
        return None
    G, H = measured.response[at, 0, 0], motor_response(vector, gear_ratio, f[at])
    spread = np.zeros(len(G))
    if measured.noise_variance is not None:
        spread = np.sqrt(measured.noise_variance[at, 0, 0])
    J = response_jacobian(vector, gear_ratio, f[at])
    variance = np.einsum("fi,ij,fj->f", J, joint.covariance[:6, :6], J.conj()).real
    own = np.sqrt(np.clip(variance, 0.0, None))
    beyond = np.abs(G - H) > REACH * (spread + own)
    apart = np.abs(20.0 * np.log10(np.abs(G) / np.abs(H)))
    differs = beyond & (apart > _APART)
    if np.mean(differs) <= _MANY:
        return None
    worst = int(np.argmax(np.where(differs, apart, 0.0)))
    return (
        "the physical model and the measured response differ by more than both 95 % bands on "
        f"{100.0 * np.mean(differs):.0f} % of the lines, by {apart[worst]:.0f} dB near "
        f"{f[at][worst]:.3g} Hz"
    )
