"""phi about the first axis, on c_B and a damper that stand on the ground: a soft base, (S28)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_SHARE = 0.2  # of the gear's compliance
_COMPLIANCE = 1e-5  # [rad/(N m)], where no spring says how soft the gear is
_LIGHT_DAMPING = 0.1  # from which a fit finds the mode
_FREQUENCIES = (25.0, 12.0, 17.0, 36.0, 52.0)  # [Hz] closer than the tested damping spans


class SoftBase(Effect):
    """The base turns on what it stands on."""

    name = "soft-base"
    sizes = ("base_compliance",)
    shapes: Mapping[str, float] = {"base_frequency": _FREQUENCIES[0], "base_damping": 0.5}
    needs_elastic_gear = True
    first_joint_only = True
    moves_link_encoder = True
    description = "a base that turns on soft feet"
    consequence = "its compliance counts as the first gear's, and its mode as the gear's damping"
    experiment = (
        "hold the motors still, hit the base, and look for its motion with an accelerometer on it"
    )
    record = "a frequency record of joint 1 up to twice the frequency at which the base rings"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the gear's compliance."""
        stiff = not math.isfinite(joint.stiffness)
        return {"base_compliance": _COMPLIANCE if stiff else _SHARE / joint.stiffness}

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Modes of the frequencies that bases have, so damped that neighbours overlap."""
        return tuple({**self.shapes, "base_frequency": hz} for hz in _FREQUENCIES)

    def starts(self, joint: KnownJoint) -> Values:
        """Lightly damped: tested for is a mode so damped that its frequency need not be known."""
        return super().starts(joint) | {"base_damping": _LIGHT_DAMPING}
