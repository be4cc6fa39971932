"""The arm with rigid joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from strainwave.display import Displayed
from strainwave.domain.arrays import FloatArray
from strainwave.domain.estimates import Diagnostic, Parameter


@dataclass(frozen=True, slots=True)
class RigidModel(Displayed):
    """The rigid-joint arm (5)-(7) as estimated."""

    parameters: tuple[Parameter, ...]
    solution: FloatArray  # (n_parameters,) their values, of least norm where not determined
    covariance: FloatArray  # (n_parameters, n_parameters), order of `parameters`; NaN where unknown
    condition_number: float  # of the column-scaled, weighted regressor
    fit_percent: Mapping[str, Mapping[str, float]]  # experiment -> channel -> fit
    bandwidth_hz: float  # of the zero-phase filter the data asked for
    decimation: int
    n_rows: int  # equations used, after decimation and rejection
    status: Literal["determined", "partly-determined", "not-identifiable"]
    warnings: tuple[Diagnostic, ...] = ()
    torque_ratio: tuple[float, float] | None = None  # joint 1's torque over joint 2's, against what
    # the symmetry of M(q) allows, and its deviation; 1 where both torque constants are right
    load_friction: tuple[Parameter, ...] = ()  # of joints whose friction grows with the load: share
    # of the torque of the body, gravity included, that Coulomb friction is higher by

    def value(self, name: str, joint: int | None = None) -> float | None:
        """The value of one parameter; `None` where it is not identifiable.

        Raises `KeyError`: The model has no such parameter.
        """
        for parameter in self.parameters:
            if parameter.name == name and parameter.joint == joint:
                return parameter.value
        raise KeyError(f"{name} of joint {joint}" if joint else name)
