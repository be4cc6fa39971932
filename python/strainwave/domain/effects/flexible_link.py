"""J_f on a spring and a damper that stand on the link: one more flexible mode, (S24)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_SHARE = 0.05  # of the inertia that rings at this frequency on the gear's spring
_ANTI_RESONANCE = 10.0  # [Hz]
_LIGHT_DAMPING = 0.05  # from which a fit finds the mode
_HEAVY = 1.0  # [kg m^2], where no spring says how heavy the link is
_FREQUENCIES = (
    30.0,
    12.0,
    18.0,
    24.0,
    45.0,
    65.0,
)  # [Hz] a ratio apart that the tested damping spans


class FlexibleLink(Effect):
    """A part of the link swings by itself."""

    name = "flexible-link"
    sizes = ("flexible_inertia",)
    shapes: Mapping[str, float] = {"flexible_frequency": _FREQUENCIES[0], "flexible_damping": 0.2}
    description = "a part of the link that swings by itself"
    consequence = "stiffness and damping of the gear take up a mode that is not the gear's"
    experiment = "hit the link with the motor held still, and look for a second resonance"
    record = "a frequency record up to twice the frequency of that mode"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the inertia that a common anti-resonance speaks of."""
        link = joint.stiffness / (math.tau * _ANTI_RESONANCE) ** 2
        return {"flexible_inertia": _SHARE * (link if math.isfinite(link) else _HEAVY)}

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Modes of the frequencies that arms have, so damped that neighbours overlap."""
        return tuple({**self.shapes, "flexible_frequency": hz} for hz in _FREQUENCIES)

    def starts(self, joint: KnownJoint) -> Values:
        """Lightly damped: tested for is a mode so damped that its frequency need not be known."""
        return super().starts(joint) | {"flexible_damping": _LIGHT_DAMPING}
