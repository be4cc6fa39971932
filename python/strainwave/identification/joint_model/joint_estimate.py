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
from strainwave.domain.arm import unit_of
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.parameter_table import VISCOUS

# relative standard deviation up to which a viscous friction is reported
_MAX_VISCOUS_RELATIVE_STD = 0.3


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """Values of one joint's parameters, and which of them the data determine."""

    joint: Joint
    number: int  # of the joint, from 1
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
        warnings = (*self._warnings(), *notes)
        codes = {warning.code for warning in warnings}
        is_partial = "not-identifiable" in codes
        status: Literal["determined", "partly-determined", "implausible"]
        status = "partly-determined" if is_partial else "determined"
        return JointModel(
            joint=self.number,
            experiments=self.experiments,
            method=method,
            parameters=tuple(self._parameters()),
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

    def _entries(self) -> Iterator[_ReportedValue]:
        variances = np.clip(np.diag(self.covariance), 0.0, None)
        for (name, value), std, determined in zip(
            self.values.items(), np.sqrt(variances).tolist(), self.determined, strict=True
        ):
            # in fast records only the sum of the viscous frictions is well determined
            is_split = name in VISCOUS
            is_precise = std <= _MAX_VISCOUS_RELATIVE_STD * abs(value)
            yield _ReportedValue(
                name, value, std, bool(determined) and (is_precise or not is_split)
            )

    def _parameters(self) -> Iterator[Parameter]:
        """Each value as a parameter, None if not determined, then the total viscous friction."""
        for entry in self._entries():
            yield self._parameter(entry)
        ratio, values = self.joint.gear_ratio, np.array(list(self.values.values()))
        weights = dict(zip(VISCOUS, (1.0, ratio**2), strict=True))
        weight = np.array([weights.get(name, 0.0) for name in self.values])
        std = np.sqrt(np.clip(weight @ self.covariance @ weight, 0.0, None))
        total = _ReportedValue("total_viscous_friction", float(weight @ values), float(std), True)
        yield self._parameter(total)

    def _parameter(self, entry: _ReportedValue) -> Parameter:
        key, unit = (entry.name, self.number), unit_of(entry.name, self.joint)
        known = entry.value if entry.is_identified else None
        if known is None or not np.isfinite(entry.std):
            return Parameter(*key, known, None, unit, "decoupled")
        return Parameter.estimated(key, entry.value, entry.std, unit, "decoupled")

    def _warnings(self) -> Iterator[Diagnostic]:
        """Warnings about parameters that are not identifiable, implausible or equivalent values."""
        joint, records = self.joint, self.experiments
        for entry in self._entries():
            name, value, std = entry.name, entry.value, entry.std
            place, unit = Place(joint=self.number, parameter=name), unit_of(name, joint)
            estimate = Clause("estimate", value=value, std=std, unit=unit)
            if not np.isfinite(std):
                estimate = Clause("estimate/no-std", value=value, unit=unit)
            is_viscous = name in VISCOUS
            is_negative = value + 2.0 * np.nan_to_num(std) < 0.0
            if is_negative and (entry.is_identified or not is_viscous):
                yield Diagnostic("implausible", place, estimate=estimate, records=records)
            elif not entry.is_identified:
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


@dataclass(frozen=True, slots=True)
class _ReportedValue:
    """One value, and whether it is reported."""

    name: str
    value: float
    std: float
    is_identified: bool
