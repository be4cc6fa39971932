"""Families of virtual arms drawn over a gear catalogue, each arm reproducible by its number.

`drawing` describes the distribution, draws arms and simulates their experiments in memory. Some
arms have a fault in their input, or an effect that their study does not mention.
"""

from __future__ import annotations

from benchmarks.families.drawing import (
    Family,
    Recorded,
    VirtualArm,
    draw,
    family_of,
    fields_of,
    record,
)

__all__ = ["Family", "Recorded", "VirtualArm", "draw", "family_of", "fields_of", "record"]
