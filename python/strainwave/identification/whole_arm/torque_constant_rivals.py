"""Comparison of a wrong torque constant with the effects of the whole-arm fit."""

from __future__ import annotations

from strainwave.domain import ArmModel
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.problem.effect_unknowns import effects_among

_DRIVE_GAIN = "drive-gain"  # effect that a wrong torque constant resembles
_MIN_GAIN_RATIO = 1.2  # minimum ratio of cost reductions, other effect over wrong torque constant


def has_likelier_effect(model: ArmModel, arm: Arm) -> bool:
    """Whether an effect explains the records clearly better than a wrong torque constant.

    `model` is the whole-arm model of a study whose rigid step suspects a torque constant. Returns
    False if no effect is fitted or likely, if the effect is a drive gain, or if the fit is not at
    a minimum.
    """
    if model.criticism is None or not model.end.is_minimum:
        return False
    keys = (parameter.key for parameter in model.parameters)
    fitted = [effect for _, effect in effects_among(keys, arm.n_joints)]
    causes = model.criticism.causes
    if _DRIVE_GAIN in fitted or not causes:
        return bool(fitted) and _DRIVE_GAIN not in fitted
    gain_reduction = max(
        (cause.gain for cause in causes if cause.effect == _DRIVE_GAIN), default=0.0
    )
    return causes[0].effect != _DRIVE_GAIN and causes[0].gain > _MIN_GAIN_RATIO * gain_reduction
