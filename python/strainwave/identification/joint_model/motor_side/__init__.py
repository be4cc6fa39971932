"""LinkSignals, RigidModel -> JointModels from the motors' own frequency responses.

Without a link sensor the interaction torques cannot be measured. But the motors' motion can, and
given that, the rest of the arm is a linear system of which the rigid model knows the inertias: the
anti-resonances are its modes with all motors held. So a joint's gear and the share of its motor
show in how the motor moves under its torque, whatever the other motors do meanwhile.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray, JointModel, LinkSignals, RigidModel
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES, anti_resonance, resonance
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.estimates import parameters_of, status_of, warnings_of
from strainwave.identification.joint_model.motor_side.arms import Family, family_of
from strainwave.identification.joint_model.motor_side.catalogue import models_from_catalogue
from strainwave.identification.joint_model.motor_side.search import Found, minima
from strainwave.identification.joint_model.motor_side.spectra import Piece, pieces, thinned
from strainwave.numerics.parallel import one_blas_thread

__all__ = ["models_from_catalogue", "models_from_motors"]

_LINES, _COARSE = 160, 40  # of a piece, for least squares and for the grid
_IDENTIFIED = 0.3  # relative deviation up to which a value is worth printing
_SPLIT = ("motor_viscous_friction", "link_viscous_friction")
_DIFFERENCE = 1e-4  # of a coordinate


def models_from_motors(
    records: Sequence[LinkSignals], model: RigidModel | None, arm: Arm
) -> list[tuple[JointModel, ...]]:
    """Models of all joints from motor torques and velocities alone.

    Every joint's motor must be driven in some record, wide in frequency as by a PRBS.

    `records`: Their link signals are not used.
    `model`: None will do for a single joint without gravity.

    Returns: One model per joint from the base; first the set that explains the motors best, then
    other minima, from which a search may start as well.

    Raises `NotIdentifiable`: A joint is not driven, or nothing explains the motors' motion.
    """
    ratio = arm.gear_ratios
    seen = [piece for r in records for piece in pieces(r, ratio, most_lines=_LINES) if piece.rows]
    for i in range(arm.n_joints):
        if not any(i in piece.rows for piece in seen):
            raise NotIdentifiable(
                f"no record has the motor of joint {i + 1} slide most of the time when driven,"
                " so that its gear does not show: record it with a PRBS of larger amplitude"
            )
    family = family_of(model, arm)
    with one_blas_thread():
        found = minima(family, seen, [thinned(piece, _COARSE) for piece in seen])
        names = [
            tuple(dict.fromkeys(p.experiment for p in seen if i in p.rows))
            for i in range(arm.n_joints)
        ]
        return [_models(each, family, arm, seen, names) for each in found]


def _models(
    found: Found,
    family: Family,
    arm: Arm,
    seen: Sequence[Piece],
    experiments: Sequence[tuple[str, ...]],
) -> tuple[JointModel, ...]:
    """One model per joint from a minimum."""
    joints = family.joints(found.point)
    band = (
        float(min(piece.s[0].imag for piece in seen) / (2.0 * np.pi)),
        float(max(piece.s[-1].imag for piece in seen) / (2.0 * np.pi)),
    )
    models = []
    for i, joint in enumerate(joints):
        covariance = _covariance(found, family, i)
        values = dict(zip(NAMES, joint.vector.tolist(), strict=True))
        deviation = np.sqrt(np.diag(covariance))
        identified = [
            bool(d <= _IDENTIFIED * v) for d, v in zip(deviation, values.values(), strict=True)
        ]
        said = values, covariance, identified, arm.joints[i], i + 1
        warnings = tuple(warnings_of(*said, ", ".join(experiments[i])))
        fit = found.fit_percent[i]
        models.append(
            JointModel(
                joint=i + 1,
                experiments=experiments[i],
                method="motor-response",
                parameters=tuple(parameters_of(*said)),
                values=values,
                covariance=covariance,
                anti_resonance=anti_resonance(joint, covariance),
                resonance=resonance(joint, covariance),
                band_hz=band,
                fit_percent={"motor_velocity": float(fit)},
                status=status_of(warnings),
                warnings=warnings,
            )
        )
    return tuple(models)


def _covariance(found: Found, family: Family, i: int) -> FloatArray:
    """Of one joint's physical parameters, the rigid model's own deviations left out: (6, 6).

    Of the viscous frictions only the sum is known: their split may be anything.
    """
    columns = []
    for step in _DIFFERENCE * np.eye(len(found.point)):
        ahead, behind = (family.parts(found.point + sign * step) for sign in (1.0, -1.0))
        columns.append([(ahead[name][i] - behind[name][i]) / (2.0 * _DIFFERENCE) for name in NAMES])
    slopes = np.array(columns).T
    covariance = slopes @ found.covariance @ slopes.T
    motor, link = (NAMES.index(name) for name in _SPLIT)
    parts = family.parts(found.point)
    split = np.zeros(len(NAMES))
    split[motor] = parts[_SPLIT[0]][i]
    split[link] = -split[motor] / family.ratio[i] ** 2
    return np.asarray(covariance + np.outer(split, split))
