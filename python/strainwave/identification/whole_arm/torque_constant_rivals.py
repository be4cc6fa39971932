"""Comparison of a wrong torque constant with the effects of the whole-arm fit."""

from __future__ import annotations

from strainwave.domain import ArmModel
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.problem.effect_unknowns import effects_among

_DRIVE_GAIN = "drive-gain"  # effect that a wrong torque constant resembles


def has_likelier_effect(model: ArmModel, arm: Arm) -> bool:
    """Whether the fit includes an effect that is not a wrong torque constant.

    `model` is the whole-arm model of a study whose rigid step suspects a torque constant.
    """
    keys = (parameter.key for parameter in model.parameters)
    fitted = [effect for _, effect in effects_among(keys, arm.n_joints)]
    return model.end.is_minimum and bool(fitted) and _DRIVE_GAIN not in fitted
