"""Second encoder, on the link's side of the gear."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from strainwave.domain.link_sensors.interface import ConstantKind, LinkSensor

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint


@dataclass(frozen=True)
class LinkEncoder(LinkSensor):
    """Encoder `theta_l{i}` of the link angle; the line count gives its scale."""

    name = "link_encoder"
    noun = "link encoder"
    channel_kinds = ("theta_l",)
    keys = ("link_encoder_counts",)
    rank = 1
    reads_angle = True
    has_bias = False
    common = (ConstantKind.DELAY,)
    per_axis = ()

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        return cls()

    def quantities(self) -> tuple[str, ...]:
        return ("link_angle",)
