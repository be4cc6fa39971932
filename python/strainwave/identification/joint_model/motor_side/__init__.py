"""Estimate joint models from the frequency responses of the motors, without link sensors.

Without a link sensor the interaction torques cannot be measured, but the motion of the motors can.
For a given motion of the motors, the rest of the arm is a linear system with the inertias of the
rigid model. Its modes with all motors held are the anti-resonances. The response of each motor to
its torque therefore determines the gear and the motor's share of the inertia, independent of the
motion of the other motors.

Where no record determines the gears, they start from a catalogue. Strain-wave gears are selected
for their loads: anti-resonances are typically 8 to 60 Hz, higher for small arms, and the motor
contributes a fifth to two thirds of the joint's inertia.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray, JointModel, LinkSignals, RigidModel
from strainwave.domain.arm.parameter_table import VISCOUS
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, anti_resonance, resonance
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.joint_estimate import JointEstimate
from strainwave.identification.joint_model.motor_side.arms import NO_ARM, ConsistentArms, family_of
from strainwave.identification.joint_model.motor_side.search import GearMinimum, minima
from strainwave.identification.joint_model.motor_side.spectra import Piece, pieces, thin_lines
from strainwave.numerics.parallel import one_blas_thread

__all__ = ["models_from_catalogue", "models_from_motors"]

# spectral lines of a piece for least squares and for the grid search
_FIT_LINES, _GRID_LINES = 160, 40
_MAX_RELATIVE_STD = 0.3  # relative standard deviation up to which a value is reported
_DIFFERENCE_STEP = 1e-4  # step of a coordinate for central differences


def models_from_motors(
    records: Sequence[LinkSignals], model: RigidModel | None, arm: Arm
) -> list[tuple[JointModel, ...]]:
    """Estimate models of all joints from motor torques and velocities alone.

    Each motor must be driven over a wide range of frequencies in some record, for example by a
    PRBS. Link signals of `records` are not used. `model` may be None for a single joint without
    gravity.

    Returns sets of models, one model per elastic joint from the base. The first set has the least
    objective; the others are alternative minima from which a whole-arm fit may start.

    Raises `NotIdentifiable` if a joint is not driven or no arm explains the motion of the motors.
    """
    spectra_pieces = [
        piece for r in records for piece in pieces(r, arm, max_lines=_FIT_LINES) if piece.rows
    ]
    elastic = [i for i in range(arm.n_joints) if i + 1 not in arm.rigid_joints]
    for i in elastic:
        if not any(i in piece.rows for piece in spectra_pieces):
            raise NotIdentifiable(
                f"no record has the motor of joint {i + 1} slide most of the time when driven,"
                " so that its gear does not show: record it with a PRBS of larger amplitude"
            )
    family = family_of(model, arm)
    with one_blas_thread():
        fits = minima(
            family, spectra_pieces, [thin_lines(piece, _GRID_LINES) for piece in spectra_pieces]
        )
        names = [
            tuple(dict.fromkeys(p.experiment for p in spectra_pieces if i in p.rows))
            for i in range(arm.n_joints)
        ]
        return [_models(fit, family, arm, spectra_pieces, names) for fit in fits]


def _models(
    minimum: GearMinimum,
    family: ConsistentArms,
    arm: Arm,
    pieces_in_posture: Sequence[Piece],
    experiments: Sequence[tuple[str, ...]],
) -> tuple[JointModel, ...]:
    """One model per elastic joint from a minimum."""
    joints = family.joints(minimum.point)
    band = (
        float(min(piece.s[0].imag for piece in pieces_in_posture) / (2.0 * np.pi)),
        float(max(piece.s[-1].imag for piece in pieces_in_posture) / (2.0 * np.pi)),
    )
    models = []
    for i, joint in enumerate(joints):
        if i + 1 in arm.rigid_joints:
            continue
        covariance = _covariance(minimum, family, i)
        values = dict(zip(NAMES, joint.vector.tolist(), strict=True))
        standard_deviations = np.sqrt(np.diag(covariance))
        identified = [
            bool(std <= _MAX_RELATIVE_STD * value)
            for std, value in zip(standard_deviations, values.values(), strict=True)
        ]
        estimate = JointEstimate(
            arm.joints[i], i + 1, experiments[i], values, covariance, identified
        )
        modes = anti_resonance(joint, covariance), resonance(joint, covariance)
        fit_percent = {"motor_velocity": float(minimum.fit_percent[i])}
        models.append(estimate.to_model("motor-response", modes, band, fit_percent))
    return tuple(models)


def _covariance(minimum: GearMinimum, family: ConsistentArms, i: int) -> FloatArray:
    """Covariance (6, 6) of one joint's physical parameters.

    Of the errors of the rigid model it has that of the total viscous friction. Only this sum is
    determined, so its split has a variance of its full size.
    """
    columns = []
    for step in _DIFFERENCE_STEP * np.eye(len(minimum.point)):
        above, below = (family.parts(minimum.point + sign * step) for sign in (1.0, -1.0))
        columns.append(
            [(above[name][i] - below[name][i]) / (2.0 * _DIFFERENCE_STEP) for name in NAMES]
        )
    J = np.array(columns).T
    covariance = J @ minimum.covariance @ J.T
    motor, link = (NAMES.index(name) for name in VISCOUS)
    parts = family.parts(minimum.point)
    split = np.zeros(len(NAMES))
    split[motor] = parts[VISCOUS[0]][i]
    split[link] = -split[motor] / family.ratio[i] ** 2
    total = np.abs(split)
    total *= family.viscous_std[i] / (parts[VISCOUS[0]][i] + family.ratio[i] ** 2 * total[link])
    return np.asarray(covariance + np.outer(split, split) + np.outer(total, total))


_ANTI_RESONANCES_HZ = (8.0, 12.0, 18.0, 27.0, 40.0, 60.0)  # anti-resonances
_MOTOR_SHARES = (0.25, 0.55)  # motor's share of the joint's inertia
_DAMPING_RATIO = 0.05  # damping ratio of the anti-resonance


def models_from_catalogue(model: RigidModel | None, arm: Arm) -> list[tuple[JointModel, ...]]:
    """Models of all joints with typical gears, as starting values for a whole-arm fit.

    The inertias come from `model`. Returns sets of one model per joint from the base, without
    estimated parameters. The joints of a set are alike; joints of several sets can be combined.

    Raises `NotIdentifiable` if the rigid model is missing or lacks an inertia.
    """
    if model is None:
        raise NotIdentifiable(
            "without a rigid model and records that excite the gears, the whole-arm fit has no"
            ' start: add an experiment with use = "motion", or one with use = "frequency"'
        )
    family, candidates = family_of(model, arm), []
    known = family.known_share
    shares = [np.where(np.isnan(known), share, known) for share in _MOTOR_SHARES]
    if not np.isnan(known).any():
        shares = [known]
    models: dict[tuple[int, float, float], JointModel] = {}
    for ring in 2.0 * np.pi * np.array(_ANTI_RESONANCES_HZ):
        for share in shares:
            point = family.point(np.full(family.n_joints, ring), share, _DAMPING_RATIO)
            if family.least_inertia(point) > 0.0:
                keys = [(i, ring, own) for i, own in enumerate(share.tolist(), start=1)]
                for key, joint in zip(keys, family.joints(point), strict=True):
                    models.setdefault(key, _model(key[0], joint))
                candidates.append(tuple(models[key] for key in keys))
    if not candidates:
        raise NotIdentifiable(NO_ARM)
    return candidates


def _model(number: int, joint: TwoInertia) -> JointModel:
    return JointModel(
        joint=number,
        experiments=(),
        method="catalogue",
        parameters=(),
        values=dict(zip(NAMES, joint.vector.tolist(), strict=True)),
        covariance=np.full((len(NAMES), len(NAMES)), np.nan),
        anti_resonance=None,
        resonance=None,
        band_hz=(0.0, np.inf),
        fit_percent={},
        status="partly-determined",
    )
