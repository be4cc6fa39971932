"""Whether the whole-arm fit has another explanation for torques that contradict one another."""

from __future__ import annotations

from strainwave.domain import ArmModel
from strainwave.domain.effects import all_effects
from strainwave.domain.parameter_table import base_name

_GAIN = "drive-gain"
_CLEARLY = 1.2  # times what a wrong torque constant would take off the cost


def blames_another(model: ArmModel) -> bool:
    """Whether an effect explains the records clearly better than a wrong torque constant.

    Parameters
    ----------
    model : ArmModel
        Of a study whose rigid fit suspects a torque constant.

    Returns
    -------
    bool
        False where nothing is named, where a gain is, and where the fit has not converged.
    """
    if model.criticism is None or model.status == "iteration-limit":
        return False
    names = {base_name(parameter.name) for parameter in model.parameters}
    taken = {effect.name for effect in all_effects() if effect.sizes[0] in names}
    gains = {cause.effect: cause.gain for cause in reversed(model.criticism.causes)}  # the best
    if _GAIN in taken or not (taken or gains):
        return False
    best = max(gains, key=lambda effect: gains[effect], default=None)
    return best != _GAIN and (best is None or gains[best] > _CLEARLY * gains.get(_GAIN, 0.0))
