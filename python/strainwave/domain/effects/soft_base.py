"""Soft base, (S28): the base rotates about the first axis on compliance c_B and a damper."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_COMPLIANCE_SHARE = 0.2  # of the gear's compliance
_TYPICAL_COMPLIANCE = 1e-5  # [rad/(N m)] if the gear is rigid
_STARTING_DAMPING = 0.1  # a fit converges to the mode from a lightly damped one
# The half-power bands of neighbours overlap at the tested damping of 0.5. The first is the default.
_TESTED_FREQUENCIES_HZ = (25.0, 12.0, 17.0, 36.0, 52.0)


class SoftBase(Effect):
    """The base rotates on its support."""

    name = "soft-base"
    sizes = ("base_compliance",)
    shapes: Mapping[str, float] = {"base_frequency": _TESTED_FREQUENCIES_HZ[0], "base_damping": 0.5}
    needs_elastic_gear = True
    first_joint_only = True
    moves_link_encoder = True
    description = "a base that rotates on a compliant support"
    consequence = "its compliance and its mode bias the first gear's stiffness and damping"
    experiment = "hold the motors, hit the base and measure its motion with an accelerometer on it"
    record = "a frequency record of joint 1 up to twice the natural frequency of the base"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the gear's compliance."""
        is_rigid = not math.isfinite(joint.stiffness)
        return {
            "base_compliance": _TYPICAL_COMPLIANCE
            if is_rigid
            else _TYPICAL_COMPLIANCE_SHARE / joint.stiffness
        }

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Modes at the tested frequencies, so damped that neighbours overlap."""
        return tuple({**self.shapes, "base_frequency": hz} for hz in _TESTED_FREQUENCIES_HZ)

    def starts(self, joint: KnownJoint) -> Values:
        """The first tested shape with light damping; heavy damping serves only the test."""
        return super().starts(joint) | {"base_damping": _STARTING_DAMPING}
