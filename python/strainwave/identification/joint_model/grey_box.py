"""Estimate the physical parameters of one joint from its equations of motion.

If both sides of the gear are measured, (1) and (2) of one joint give two equations per sample:

    u + n tau = m_M dw_M + d_M w_M + f s + n (m_L dw_L + d_L w_L)                          (S6)
    delta = c (m_L dw_L + d_L w_L - tau) - t ddelta,     c = 1/k, t = d_G/k                (S7)

(S6) is linear in its parameters. (S7) relates the torsion to the torque through the gear and is
linearised around the current iterate. Both equations pass through one zero-phase band-pass around
the anti-resonance and the resonance, which removes sensor bias and drift below the band and sensor
noise above it. All signals have passed through the same sensor filters (`LinkSignals.shared`), so
these filters cancel in the equations. Where the motor may be in stiction, its friction torque is an
additional unknown with a prior from the measured velocity; the effect of that prior is added to the
covariance.

The quantities that the rigid model gives, c_1 = m_M + n^2 m_L, c_0 = d_M + n^2 d_L and the Coulomb
friction, are added as one equation each, weighted by the inverse of its standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from strainwave.domain import Decoupled, FloatArray, JointModel, LinkSignals
from strainwave.domain.arm.parameter_table import COULOMB
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES, anti_resonance, jacobian, resonance
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.equations import (
    PHYSICAL_COLUMNS,
    Records,
    RigidKnowledge,
    WeightedEquations,
    equations_in,
    physical_values,
)
from strainwave.identification.joint_model.joint_estimate import JointEstimate
from strainwave.identification.joint_model.stretches import (
    FIRST_BAND_HZ,
    Band,
    limit_band,
    neighbouring_bands,
    same_band,
)
from strainwave.numerics import least_squares as ls
from strainwave.numerics.parallel import one_blas_thread

Columns = TypeVar("Columns", LinkSignals, Decoupled)

_ANTI_RESONANCE_TO_LOW_EDGE = 2.5  # ratio of the anti-resonance to the lower edge of the band
# ratio of the upper edge of the band to the resonance; the next structural resonance is higher
_HIGH_EDGE_TO_RESONANCE = 1.8
_MIN_EDGE_RATIO = 2.0  # minimum ratio of the edges of the band
_MAX_BANDS = 6  # maximum number of bands in the search
_BAND_TOLERANCE = 0.05  # relative difference of the edges up to which two bands are the same
# number of samples used to search for the band; shorter records are used completely
_MAX_SEARCH_SAMPLES = 1 << 16
_BAND_CHANGE = 1.3  # factor on the band edges for the estimate of the model error
# convergence tolerances in standard deviations: for the final estimate, and for the search for the
# band, whose edges need an accuracy of only a few percent
_TOLERANCE, _SEARCH_TOLERANCE = 0.05, 10.0
_MODEL_ERROR_TOLERANCE = 0.5  # the same tolerance for the fits that measure the model error


@dataclass(frozen=True, slots=True)
class JointFit:
    """Solved equations of one joint in its band and in two neighbouring bands.

    The fit of one record can start from them.
    """

    records: tuple[tuple[LinkSignals, Decoupled], ...]
    arm: Arm
    in_band: WeightedEquations
    # with friction that follows the sign of the velocity everywhere
    with_sign_friction: WeightedEquations
    # in a narrower and a wider band; empty if the band is given
    in_other_bands: tuple[WeightedEquations, ...]
    model: JointModel = field(init=False)

    def __post_init__(self) -> None:
        """Compute the model."""
        object.__setattr__(self, "model", self._model())

    def _model(self) -> JointModel:
        """The joint model, with the model error added to the covariance.

        The model error consists of the changes of the estimates with the treatment of friction near
        zero velocity and with the band: an exact model gives the same estimates in all bands.
        """
        own, first = self.in_band, self.records[0][1]
        factor = ls.factorise(own.equations, own.root)
        covariance, _ = ls.jackknife(own.equations, factor)
        determined = ls.determined(own.equations, factor, covariance)
        # tau is computed from the rigid model; its error does not appear in the residuals
        errors, J = own.rigid_errors(factor), jacobian(physical_values, own.x)
        covariance = J @ (covariance + errors @ errors.T) @ J.T
        friction_change = self.with_sign_friction.physical - own.physical
        covariance = covariance + np.outer(friction_change, friction_change)
        if self.in_other_bands:
            changes = [other.physical - own.physical for other in self.in_other_bands]
            covariance = covariance + np.mean([np.outer(move, move) for move in changes], axis=0)
        of_modes = covariance[:6, :6]
        modes = anti_resonance(own.joint, of_modes), resonance(own.joint, of_modes)
        estimate = JointEstimate(
            self.arm.joints[first.joint - 1],
            first.joint,
            tuple(signals.experiment.name for signals, _ in self.records),
            dict(zip((*NAMES, COULOMB), own.physical.tolist(), strict=True)),
            self._with_delay(covariance),
            [bool(determined[k]) for k in PHYSICAL_COLUMNS],
            first.posture,
        )
        return estimate.to_model("grey-box", modes, own.band, own.fit_percent(factor))

    def _with_delay(self, covariance: FloatArray) -> FloatArray:
        """Add the variance of the gear damping that an uncertain sensor delay causes.

        A link sensor delayed by D measures the torsion n theta_M - theta_L + D dtheta_L, so the
        gear damping changes by about k D. The variance is (k std_D)^2, the same in all records.
        """
        number = self.records[0][1].joint
        delays = [s.removed_delay[number - 1] for s, _ in self.records if s.removed_delay]
        if not delays or not delays[0].value:
            return covariance
        k = NAMES.index("gear_damping")
        enlarged = covariance.copy()
        enlarged[k, k] += (self.in_band.joint.gear_stiffness * delays[0].std) ** 2
        return enlarged

    def of_record(self, name: str) -> JointModel:
        """Model of one record alone. `name` is the experiment's name."""
        names = self.model.experiments
        if names == (name,):
            return self.model
        with one_blas_thread():
            return self._fit_record(names.index(name)).model

    def _fit_record(self, k: int) -> JointFit:
        """Fit record `k` alone, starting from the solution of all records in the same bands.

        If its resonances differ, the equations are solved in new bands.
        """
        record, own = self.records[k : k + 1], self.in_band.of_record(k).iterate(_TOLERANCE)
        if not same_band(own.band, _band_around(own, record), _BAND_TOLERANCE):
            return solve(record, self.arm, own.known, search_from_hz=own.band)
        with_sign_friction, *in_other_bands = [
            each.of_record(k).iterate(_MODEL_ERROR_TOLERANCE)
            for each in (self.with_sign_friction, *self.in_other_bands)
        ]
        return JointFit(record, self.arm, own, with_sign_friction, tuple(in_other_bands))


def solve(
    records: Records,
    arm: Arm,
    known: RigidKnowledge,
    band_hz: Band | None = None,
    search_from_hz: Band = FIRST_BAND_HZ,
) -> JointFit:
    """Estimate the physical parameters of one joint from one or several records.

    `band_hz` is the filter band; None derives it from the estimated resonances, and the search
    starts in `search_from_hz`. Raises `NotIdentifiable` if the link has no sensor.
    """
    for signals, joint in records:
        if signals.sources[joint.joint - 1] == "motor":
            raise NotIdentifiable(
                f"link {joint.joint} has no sensor in {signals.experiment.name}: the gear's "
                "torsion is not measured"
            )
    if band_hz:
        equations = equations_in(records, arm, known, band_hz)
    else:
        in_middle = _search_band_in_middle(records, arm, known, search_from_hz)
        equations = in_middle or _search_band(records, arm, known, search_from_hz)
    own = equations.iterate(_TOLERANCE)
    other_bands = () if band_hz else neighbouring_bands(own.band, _BAND_CHANGE)
    in_other_bands = [
        equations_in(records, arm, known, _limit_band(band, records), own) for band in other_bands
    ]
    with_sign_friction, *in_other_bands = [
        each.iterate(_MODEL_ERROR_TOLERANCE) for each in (own.with_sign_friction(), *in_other_bands)
    ]
    return JointFit(tuple(records), arm, own, with_sign_friction, tuple(in_other_bands))


def _search_band(
    records: Records, arm: Arm, known: RigidKnowledge, search_from_hz: Band
) -> WeightedEquations:
    """Iterate the band around the resonances; return the equations in it."""
    equations = equations_in(records, arm, known, _limit_band(search_from_hz, records))
    for _ in range(_MAX_BANDS - 1):
        equations = equations.iterate(_SEARCH_TOLERANCE)
        band = _band_around(equations, records)
        if same_band(equations.band, band, _BAND_TOLERANCE):
            break
        equations = equations_in(records, arm, known, band, equations)
    return equations


def _search_band_in_middle(
    records: Records, arm: Arm, known: RigidKnowledge, search_from_hz: Band
) -> WeightedEquations | None:
    """The same with a search in the middle of long records, confirmed by the complete records.

    None if no record is long, or if the complete records need another band: the middle of a sweep,
    for example, need not contain the resonances.
    """
    if all(len(signals.time) <= _MAX_SEARCH_SAMPLES for signals, _ in records):
        return None
    middle = [(_middle(signals), _middle(joint)) for signals, joint in records]
    in_middle = _search_band(middle, arm, known, search_from_hz)
    equations = equations_in(records, arm, known, in_middle.band, in_middle)
    equations = equations.iterate(_SEARCH_TOLERANCE)
    is_confirmed = same_band(equations.band, _band_around(equations, records), _BAND_TOLERANCE)
    return equations if is_confirmed else None


def _middle(record: Columns) -> Columns:
    """The middle `_MAX_SEARCH_SAMPLES` samples of a record; a shorter record is unchanged."""
    n = len(record.time)
    if n <= _MAX_SEARCH_SAMPLES:
        return record
    start = (n - _MAX_SEARCH_SAMPLES) // 2
    columns = {f.name: getattr(record, f.name) for f in fields(record)}
    middle: dict[str, Any] = {
        name: column[start : start + _MAX_SEARCH_SAMPLES]
        for name, column in columns.items()
        if isinstance(column, np.ndarray) and len(column) == n
    }
    return replace(record, **middle)


def _limit_band(band: Band, records: Records) -> Band:
    signals = [signals for signals, _ in records]
    return limit_band(band, signals, [len(each.time) for each in signals], _MIN_EDGE_RATIO)


def _band_around(equations: WeightedEquations, records: Records) -> Band:
    """Band around the resonances of a solution; the same band if it has none."""
    joint = equations.joint
    if not np.all(joint.vector[[0, 2, 4]] > 0.0):
        return equations.band
    low, high = anti_resonance(joint).frequency_hz, resonance(joint).frequency_hz
    edges = low / _ANTI_RESONANCE_TO_LOW_EDGE, high * _HIGH_EDGE_TO_RESONANCE
    return _limit_band(edges, records)
