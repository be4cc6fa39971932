"""Whether the whole-arm fit has another explanation for torques that contradict one another."""

from __future__ import annotations

from strainwave.domain import ArmModel
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.effects import effects_among

_GAIN = "drive-gain"
_CLEARLY = 1.2  # times what a wrong torque constant would take off the cost


def blames_another(model: ArmModel, arm: Arm) -> bool:
    """Whether an effect explains the records clearly better than a wrong torque constant.

    `model`: Of a study whose rigid fit suspects a torque constant.

    Returns: False where nothing is named, where a gain is, and where the fit has not converged.
    """
    if model.criticism is None or model.status == "iteration-limit":
        return False
    keys = ((parameter.name, parameter.joint) for parameter in model.parameters)
    taken = [effect for _, effect in effects_among(keys, arm.n_joints)]
    causes = model.criticism.causes
    if _GAIN in taken or not causes:
        return bool(taken) and _GAIN not in taken
    of_gain = max((cause.gain for cause in causes if cause.effect == _GAIN), default=0.0)
    return causes[0].effect != _GAIN and causes[0].gain > _CLEARLY * of_gain
