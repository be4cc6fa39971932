"""Flexible link, (S24): inertia J_f on a spring and a damper attached to the link."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_INERTIA_SHARE = 0.05  # of the link inertia
_TYPICAL_ANTI_RESONANCE_HZ = 10.0  # gives the link inertia from the gear's stiffness
_STARTING_DAMPING = 0.05  # a fit converges to the mode from a lightly damped one
_LINK_INERTIA_OF_RIGID_GEAR = 1.0  # [kg m^2] if no stiffness gives the link inertia
# The half-power bands of neighbours overlap at the tested damping of 0.2. The first is the default.
_TESTED_FREQUENCIES_HZ = (30.0, 12.0, 18.0, 24.0, 45.0, 65.0)


class FlexibleLink(Effect):
    """A part of the link has a vibration mode."""

    name = "flexible-link"
    sizes = ("flexible_inertia",)
    shapes: Mapping[str, float] = {
        "flexible_frequency": _TESTED_FREQUENCIES_HZ[0],
        "flexible_damping": 0.2,
    }
    description = "a vibration mode of a part of the link"
    consequence = "the mode biases the stiffness and damping of the gear"
    experiment = "hold the motor, hit the link and look for a second resonance"
    record = "a frequency record up to twice the frequency of that mode"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the link inertia, which follows from a typical anti-resonance."""
        link = joint.stiffness / (math.tau * _TYPICAL_ANTI_RESONANCE_HZ) ** 2
        return {
            "flexible_inertia": _TYPICAL_INERTIA_SHARE
            * (link if math.isfinite(link) else _LINK_INERTIA_OF_RIGID_GEAR)
        }

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Modes at the tested frequencies, so damped that neighbours overlap."""
        return tuple({**self.shapes, "flexible_frequency": hz} for hz in _TESTED_FREQUENCIES_HZ)

    def starts(self, joint: KnownJoint) -> Values:
        """The first tested shape with light damping; heavy damping serves only the test."""
        return super().starts(joint) | {"flexible_damping": _STARTING_DAMPING}
