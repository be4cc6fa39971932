"""Estimate of a load on the last link of an identified arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from strainwave.domain.arm.description import LinkPrior
from strainwave.domain.keys import FloatArray
from strainwave.domain.results.estimates import Diagnostic
from strainwave.domain.study import Payload, Study

INERTIAS = ("xx", "xy", "xz", "yy", "yz", "zz")
"""Order of the inertias of a load."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A value with its standard deviation and 95 % interval."""

    value: float
    std: float
    ci95: tuple[float, float]
    unit: str


@dataclass(frozen=True, slots=True)
class LoadQuantities:
    """Mass, centre of mass and inertias of a load in the last link's frame.

    None: not determined. Inertias are in the order of `INERTIAS`.
    """

    mass: Quantity | None
    xyz: tuple[Quantity | None, ...]  # centre of mass [m]
    inertia_about_centre: tuple[Quantity | None, ...]
    first_moments: tuple[Quantity | None, ...]  # mass times centre [kg m]
    inertia_about_origin: tuple[Quantity | None, ...]


@dataclass(frozen=True, slots=True)
class PayloadEstimate:
    """A load estimated from records that carry it, with the arm's errors in all intervals."""

    quantities: LoadQuantities
    standard: FloatArray  # (10,) mass, first moments, inertias xx, xy, yy, xz, yz, zz at the origin
    covariance: FloatArray  # (10, 10) of `standard`
    body: LinkPrior | None  # physically consistent, for controllers; None: no load to be set
    assumed: tuple[str, ...]  # entries of `body` that are not determined
    records: tuple[str, ...]  # names of the fitted records
    warnings: tuple[Diagnostic, ...]
    study: Study  # with the identified arm
    result: Path  # file of the arm
    stated: Payload | None = None  # known load of the records
    torque_scale: Quantity | None = None  # true torque over stated torque, from the known load

    @property
    def mass(self) -> Quantity | None:
        """Mass [kg]."""
        return self.quantities.mass

    @property
    def xyz(self) -> tuple[Quantity | None, ...]:
        """Centre of mass [m] in the last link's frame."""
        return self.quantities.xyz

    @property
    def inertia_about_centre(self) -> tuple[Quantity | None, ...]:
        """Inertias [kg m^2] about the centre of mass: xx, xy, xz, yy, yz, zz."""
        return self.quantities.inertia_about_centre
