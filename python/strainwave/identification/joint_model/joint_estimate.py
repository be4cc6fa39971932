"""Values of one joint's parameters with their covariance, and the joint model that reports them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from strainwave.domain import (
    Clause,
    Diagnostic,
    FloatArray,
    Joint,
    JointModel,
    Mode,
    Parameter,
    Place,
)
from strainwave.domain.arm.description import unit_of
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.arm.parameter_table import VISCOUS
from strainwave.domain.keys import JointNumber

# relative standard deviation up to which a viscous friction is reported
_MAX_VISCOUS_RELATIVE_STD = 0.3


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """Values of one joint's parameters, and which of them the data determine."""

    joint: Joint
    number: JointNumber  # of the joint
    experiments: tuple[str, ...]  # records that the values come from
    values: Mapping[str, float]
    covariance: FloatArray  # (n_values, n_values); NaN: no standard deviation
    determined: Sequence[bool]  # (n_values,)
    posture: tuple[float, ...] = ()  # link angles [rad] of `link_inertia`; empty: all are zero

    def to_model(
        self,
        method: Literal["grey-box", "transfer-function", "motor-response"],
        modes: tuple[Mode, Mode],
        band_hz: tuple[float, float],
        fit_percent: Mapping[str, float],
        notes: Iterable[Diagnostic] = (),
    ) -> JointModel:
        """The joint model. `modes` are anti-resonance and resonance, `notes` further warnings."""
        stds = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None)).tolist()
        parameters = tuple(self._parameters(stds))
        warnings = (*self._warnings(stds, parameters), *notes)
        codes = {warning.code for warning in warnings}
        is_partial = "not-identifiable" in codes
        status: Literal["determined", "partly-determined", "implausible"]
        status = "partly-determined" if is_partial else "determined"
        return JointModel(
            joint=self.number,
            experiments=self.experiments,
            method=method,
            parameters=parameters,
            values=self.values,
            covariance=self.covariance,
            anti_resonance=modes[0],
            resonance=modes[1],
            band_hz=band_hz,
            fit_percent=fit_percent,
            status="implausible" if "implausible" in codes else status,
            warnings=warnings,
            posture=self.posture,
        )

    def _parameters(self, stds: Sequence[float]) -> Iterator[Parameter]:
        """Each value as a parameter, None if not determined, then the total viscous friction."""

        def parameter(name: str, value: float, std: float, is_identified: bool) -> Parameter:
            key, unit = (name, self.number), unit_of(name, self.joint)
            if is_identified and np.isfinite(std):
                return Parameter.estimated(key, value, std, unit, "decoupled")
            return Parameter(*key, value if is_identified else None, None, unit, "decoupled")

        values = zip(self.values.items(), stds, self.determined, strict=True)
        for (name, value), std, determined in values:
            # in fast records only the sum of the viscous frictions is well determined
            is_precise = name not in VISCOUS or std <= _MAX_VISCOUS_RELATIVE_STD * abs(value)
            yield parameter(name, value, std, bool(determined) and is_precise)
        weights = dict(zip(VISCOUS, (1.0, self.joint.gear_ratio**2), strict=True))
        weight = np.array([weights.get(name, 0.0) for name in self.values])
        total = float(weight @ np.array(list(self.values.values())))
        total_std = float(np.sqrt(np.clip(weight @ self.covariance @ weight, 0.0, None)))
        yield parameter("total_viscous_friction", total, total_std, True)

    def _warnings(
        self, stds: Sequence[float], parameters: Sequence[Parameter]
    ) -> Iterator[Diagnostic]:
        """Warnings about parameters that are not identifiable, implausible or equivalent values."""
        joint, records = self.joint, self.experiments
        for (name, value), std, p in zip(self.values.items(), stds, parameters, strict=False):
            place, unit = Place(joint=self.number, parameter=name), unit_of(name, joint)
            estimate = Clause("estimate", value=value, std=std, unit=unit)
            if not np.isfinite(std):
                estimate = Clause("estimate/no-std", value=value, unit=unit)
            is_viscous = name in VISCOUS
            is_negative = value + 2.0 * np.nan_to_num(std) < 0.0
            if is_negative and (p.value is not None or not is_viscous):
                yield Diagnostic("implausible", place, estimate=estimate, records=records)
            elif p.value is None:
                split = Clause("viscous-split") if is_viscous else None
                yield Diagnostic(
                    "not-identifiable",
                    place,
                    "wide",
                    records=records,
                    estimate=estimate,
                    split=split,
                )
        if joint.law.is_curved or joint.selects_law:
            place, note = Place(joint=self.number, parameter=STIFFNESS), joint.law.equivalent_note
            yield Diagnostic("equivalent-stiffness", place, records=records, note=note)
