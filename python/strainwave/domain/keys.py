"""Keys of parameters, and mappings over them."""

from __future__ import annotations

from collections.abc import Mapping

Key = tuple[str, int | None]
"""Name of a parameter and its joint, from 1; None for parameters of the whole arm."""

Values = dict[Key, float]
"""Parameter values."""

Row = Mapping[Key, float]
"""Weights of a linear combination of parameters."""


def label_of(name: str, joint: int | None) -> str:
    """Name and joint, as in the verdict: "gear_stiffness 1", or "beta" for the whole arm."""
    return name if joint is None else f"{name} {joint}"


class Keyed:
    """Mixin of records about one parameter."""

    __slots__ = ()
    name: str
    joint: int | None

    @property
    def key(self) -> Key:
        """Name and joint."""
        return self.name, self.joint

    @property
    def label(self) -> str:
        """Name and joint, as in the verdict."""
        return label_of(self.name, self.joint)
