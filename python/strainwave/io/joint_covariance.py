"""What a result states of errors: joint covariance of the final table, noise of the sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from strainwave.domain import (
    ArmModel,
    FloatArray,
    Identification,
    JointModel,
    RigidModel,
    Stage,
)
from strainwave.domain.keys import JointNumber
from strainwave.errors import import_optional

if TYPE_CHECKING:
    from pandas import DataFrame


_EQUALITY_TOLERANCE = 1e-9  # relative difference of numbers that are equal but for rounding


@dataclass(frozen=True, slots=True, eq=False)
class JointCovariance:
    """Covariance of the estimates that the last stage decides."""

    stage: Stage
    names: tuple[str, ...]  # parameter and joint as in the verdict: "gear_stiffness 1", "beta"
    matrix: FloatArray  # (n_names, n_names), in the units of the parameters

    @property
    def correlation(self) -> FloatArray:
        """Correlation matrix of the estimates, (n_names, n_names)."""
        std = np.sqrt(np.diag(self.matrix))
        return np.asarray(self.matrix / np.outer(std, std))

    def to_frame(self) -> DataFrame:
        """The matrix as a pandas frame with the names as index and columns."""
        pandas = import_optional("pandas", "a data frame", "pandas")
        frame: DataFrame = pandas.DataFrame(self.matrix, index=self.names, columns=self.names)
        return frame


def joint_covariance(identification: Identification) -> JointCovariance | None:
    """The covariance of the last stage; None if that stage has no standard deviations.

    It contains the parameters whose value and standard deviation in the final table are those of
    the stage. Values that are clipped at zero, combined from several stages or rejected have none.
    """
    published = {p.label: p for p in identification.parameters}
    stage: Stage = "rigid"
    models: list[RigidModel | JointModel | ArmModel]
    models = [] if identification.rigid is None else [identification.rigid]
    if identification.whole_arm is not None:
        stage, models = "tuned", [identification.whole_arm]
    elif identification.joints:  # of which also values without an estimate have a covariance
        stage, models = "decoupled", [*identification.joints]
    names: list[str] = []
    matrix = np.zeros((0, 0))
    for model in models:
        parameters, covariance = model.parameters, model.covariance
        selected = [
            k
            for k, p in enumerate(parameters[: len(covariance)])
            if (final := published.get(p.label)) is not None
            and _is_equal(p.value, final.value)
            and _is_equal(float(np.sqrt(max(covariance[k, k], 0.0))), final.std)
        ]
        n = len(names)
        names += [parameters[k].label for k in selected]
        matrix = np.pad(matrix, (0, len(selected)))
        matrix[n:, n:] = covariance[np.ix_(selected, selected)]
    return JointCovariance(stage, tuple(names), matrix) if names else None


def _is_equal(first: float | None, second: float | None) -> bool:
    if first is None or second is None or not np.isfinite(second):
        return False
    return abs(first - second) <= _EQUALITY_TOLERANCE * max(abs(first), abs(second))


@dataclass(frozen=True, slots=True)
class IdentifiedNoise:
    """Standard deviations; empty for a result without them, as in earlier versions."""

    # by channel: of one sample; the angle for "omega_m1", the motor angle's velocity
    samples: Mapping[str, float] = field(default_factory=dict)
    # by joint: of the motor torque that the rigid model does not explain [N m]
    torques: Mapping[JointNumber, float] = field(default_factory=dict)
    torque_band_hz: float | None = None  # of `torques`
