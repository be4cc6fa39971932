"""Model of the arm with rigid joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from strainwave.display import Displayed
from strainwave.domain.arm import ArmDescription
from strainwave.domain.arrays import FloatArray
from strainwave.domain.estimates import Diagnostic, Parameter


@dataclass(frozen=True, slots=True)
class DriveGains:
    """Torques per volt, estimated from records with and without a known payload."""

    parameters: tuple[Parameter, ...]  # `torque_per_volt` of the joints whose drive is unknown
    relative_covariance: FloatArray  # (n_gains, n_gains) of their logarithms
    warnings: tuple[Diagnostic, ...] = ()

    def of(self, arm: ArmDescription) -> ArmDescription:
        """The arm with the estimates."""
        for parameter in self.parameters:
            arm = arm.with_joint(parameter.joint or 1, torque_per_volt=parameter.value)
        return arm


@dataclass(frozen=True, slots=True)
class FrictionTerm:
    """Effect of rigid joints in addition to inertia, viscous and Coulomb friction."""

    effect: str  # names the law
    joint: int | None  # from 1; None for all joints
    size: Parameter
    shape: float  # of the law
    estimated_shape: Parameter | None = None  # None if the shape is given or the law has none
    changes: Mapping[str, float] = field(default_factory=dict)  # of other values, by their labels

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Estimates of size and shape."""
        return (self.size,) if self.estimated_shape is None else (self.size, self.estimated_shape)


ASSUMED_TORQUE_ERROR = 0.01
"""Error of a motor's torque over its rms value: friction and drives of a rig vary by this much."""


@dataclass(frozen=True, slots=True)
class RigidModel(Displayed):
    """Estimate of the arm with rigid joints, (5) to (7)."""

    parameters: tuple[Parameter, ...]
    solution: FloatArray  # (n_parameters,) values, of minimum norm if not determined
    covariance: FloatArray  # (n_parameters, n_parameters), order of `parameters`; NaN where unknown
    condition_number: float  # of the column-scaled, weighted regressor
    fit_percent: Mapping[str, Mapping[str, float]]  # by experiment and channel
    bandwidth_hz: float  # of the zero-phase filter, chosen from the data
    decimation: int
    n_rows: int  # equations after decimation and rejection
    status: Literal["determined", "partly-determined", "not-identifiable"]
    warnings: tuple[Diagnostic, ...] = ()
    # joint -> torque of joint 1 over that joint relative to the symmetry of M(q), and its standard
    # deviation; 1 if both torque constants are right
    torque_ratios: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    # joint -> residual of the equations over their torque, rms values within the bandwidth
    torque_errors: Mapping[int, float] = field(default_factory=dict)
    friction_terms: tuple[FrictionTerm, ...] = ()  # further friction that the data support
    # samples of the fitted motion: angle, velocity, acceleration of the motors. The velocity is
    # zero where the motor may stick.
    motion: FloatArray = field(default_factory=lambda: np.zeros((3, 0, 0)))  # (3, n, n_joints)

    def value(self, name: str, joint: int | None = None) -> float | None:
        """Value of one parameter; None if it is not identifiable.

        Raises KeyError if the model has no such parameter.
        """
        for parameter in self.parameters:
            if parameter.name == name and parameter.joint == joint:
                return parameter.value
        raise KeyError(f"{name} of joint {joint}" if joint else name)
