"""Comparison of the inertial values of a URDF with the torques in the logs.

Each link keeps the shape of its mass in the URDF and gets one factor,

    tau = sum_i s_i Y_i(q, dq, ddq) pi_i + friction,

by weighted least squares over all joints. A factor far from 1 means another mass. Such values are
only a prior, so the input remains consistent.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from strainwave.domain import ArmDescription, Diagnostic, Place
from strainwave.domain.consistent_links import is_consistent, principal_moments
from strainwave.domain.distributions import CI95_STDS
from strainwave.input_check.evidence import Evidence
from strainwave.input_check.torque_fit import fit_torques, torque_system
from strainwave.numerics.regression import regress

# Factor of a mass within which a guess is accepted, in either direction.
_TOLERATED_FACTOR = 2.0
# Minimum share of the torques that the scaled links must explain.
_MIN_EXPLAINED = 0.5
# Norm of a link's torques over that of the largest below which the motion does not show its mass.
_MIN_TORQUE = 1e-6


def report_impossible_links(arm: ArmDescription) -> Iterator[Diagnostic]:
    """Yield a warning for each link whose inertial values in the URDF belong to no body.

    Links without values are guessed as well, but nothing in the file is wrong.
    """
    for number, prior in enumerate(arm.urdf.priors if arm.urdf else (), start=1):
        if any(prior) and not is_consistent(prior):
            yield Diagnostic(
                "urdf-inertia",
                Place(joint=number, key="urdf"),
                link=number,
                mass=prior[0],
                moments=tuple(principal_moments(prior).tolist()),
            )


def compare_urdf_masses(evidence: Evidence) -> Iterator[Diagnostic]:
    """Yield a warning for each link whose mass in the URDF the torques exclude."""
    urdf = evidence.study.arm.urdf
    system = torque_system(evidence) if urdf is not None else None
    if urdf is None or system is None:
        return
    priors = np.array(urdf.priors)
    if not priors.any():
        return  # the file has no inertial values
    per_link = system.columns.reshape(len(system.torque), len(priors), -1)
    torques = np.einsum("rlp,lp->rl", per_link, priors)
    sizes = np.linalg.norm(torques, axis=0)
    shown = np.flatnonzero(sizes > _MIN_TORQUE * sizes.max())
    scaled = replace(system, columns=torques[:, shown], grams={})
    weight = fit_torques(scaled).weight
    fit = regress(weight * system.torque, weight[:, None] * scaled.columns)
    if fit is None or fit.explained < _MIN_EXPLAINED:
        return
    stds = np.sqrt(np.diag(fit.covariance))
    for link, scale, std in zip(shown.tolist(), fit.value, stds, strict=True):
        low, high = scale - CI95_STDS * std, scale + CI95_STDS * std
        if low > _TOLERATED_FACTOR or 0.0 < high < 1.0 / _TOLERATED_FACTOR:
            mass = float(priors[link, 0])
            yield Diagnostic(
                "urdf-mass",
                Place(joint=link + 1, key="urdf"),
                link=link + 1,
                mass=mass,
                low=max(0.0, float(low) * mass),
                high=float(high) * mass,
            )
