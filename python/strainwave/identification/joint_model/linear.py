"""Estimate a state-space model of one decoupled joint, the paper's decoupling identification.

The inputs are motor torque minus Coulomb friction, and interaction torque. The outputs are motor
velocity and link velocity, as in (11), (12).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import (
    Decoupled,
    Diagnostic,
    InputOutput,
    LinearOptions,
    ModelCheck,
    Modes,
    Place,
    SearchEnd,
    StateSpace,
)
from strainwave.errors import NotIdentifiable, StrainwaveError
from strainwave.identification.joint_model.stretches import (
    FIRST_BAND_HZ,
    Band,
    band_around,
    band_for,
    decimated_hz,
    input_output_of,
    limit_to_rate,
    limit_to_records,
    resonances_of,
    same_band,
)
from strainwave.signals.channels import check_alike
from strainwave.statespace import (
    PemOptions,
    check_model,
    modes,
    pem,
    remove_alternating_poles,
    select_order,
    subspace,
    subspace_orders,
)

_FIT_SHARE = 0.75  # share of a stretch used to fit; the rest is used to check the model
_MAX_BANDS = 5  # maximum number of bands in the search
_BAND_TOLERANCE = 0.1  # relative difference of the edges up to which the search has converged
# relative difference of the edges above which the model is fitted again
_REFIT_BAND_DIFFERENCE = 0.25
PHYSICAL_ORDER = 3  # torsion and two velocities; the common angle is not observable
_ORDERS = (3, 4, 5, 6)  # three states of the joint and up to three of the filters
# samples used to select the order: about 100 per parameter of a model with three states
_ORDER_SELECTION_SAMPLES = 2000


@dataclass(frozen=True, slots=True)
class LinearFit:
    """State-space model of a joint with the band and the samples of the fit."""

    records: tuple[Decoupled, ...]
    options: LinearOptions
    band_hz: Band  # of the filter
    data: tuple[InputOutput, ...]  # filtered and decimated stretches
    model: StateSpace
    physical: StateSpace | None = None  # three states in the same band; None: not fitted

    def of_physical_order(self) -> StateSpace:
        """Model of three states in the same band, as (17) assumes.

        Returns the model itself if its order is set by hand, if it has three states, or if the
        model of three states does not converge or has no resonance.
        """
        if self.options.order or self.model.order == PHYSICAL_ORDER:
            return self.model
        try:
            reduced = self.physical or _model(self.records, self.data, physical_order(self.options))
        except (StrainwaveError, np.linalg.LinAlgError):
            return self.model
        return reduced if _is_usable(reduced) else self.model


def state_space_of(
    records: Decoupled | Sequence[Decoupled],
    options: LinearOptions | None = None,
    near: StateSpace | None = None,
) -> StateSpace:
    """Estimate the state-space model of one joint from one or several of its records.

    The model describes the filtered signals and is not valid below the band. The noise model is
    estimated together with the plant, so feedback through a servo or another joint causes no
    bias. `near` is a model of the same records in another band, the starting value of the fit.

    Raises `InvalidInput` for records of different joints or sampling rates, `NotIdentifiable` if no
    stretch without saturation is long enough or no model fits.
    """
    return fit_linear(records, options, near).model


def fit_linear(
    records: Decoupled | Sequence[Decoupled],
    options: LinearOptions | None = None,
    near: StateSpace | None = None,
) -> LinearFit:
    """Estimate a state-space model like `state_space_of`; return it with its band and samples."""
    chosen = options or LinearOptions()
    joint = (records,) if isinstance(records, Decoupled) else tuple(records)
    check_alike(joint)
    if chosen.filter == "decimation":
        return _fit_in((0.0, decimated_hz(joint[0], chosen)), joint, chosen, near)
    if chosen.band_hz is not None:
        return _fit_in(chosen.band_hz, joint, chosen, near)
    band = limit_to_rate(_search_band(joint), joint, chosen)
    data = input_output_of(joint, band, chosen)
    # the model of three states determines the band; then the order is selected in that band
    physical = _model(joint, data, physical_order(chosen))
    resonances = _resonances(physical)
    # with only some inputs or outputs, the modes need not be those of the joint
    is_whole = chosen.inputs == chosen.outputs == "both"
    if is_whole and resonances:
        refined_band = band_for(resonances, joint, chosen)
        if not same_band(band, refined_band, _REFIT_BAND_DIFFERENCE):
            return _fit_in(refined_band, joint, chosen)
    model = _model(joint, data, chosen, physical=physical)
    return LinearFit(joint, chosen, band, data, model, physical)


def _fit_in(
    band_hz: Band,
    records: tuple[Decoupled, ...],
    options: LinearOptions,
    near: StateSpace | None = None,
) -> LinearFit:
    data = input_output_of(records, band_hz, options)
    return LinearFit(records, options, band_hz, data, _model(records, data, options, near))


def physical_order(options: LinearOptions) -> LinearOptions:
    """The options with the order of (11), (12), three states, unless the order is set by hand."""
    return options if options.order else replace(options, order=PHYSICAL_ORDER)


def judge(fit: LinearFit) -> ModelCheck:
    """Refit the model to the first three quarters of each stretch and check it on the last quarter.

    The check computes fits and tests of whiteness and independence on samples that the fit does not
    use. Raises `NotIdentifiable` if the model has no resonance, because its band is then arbitrary.
    """
    if _resonances(fit.model) is None:
        raise NotIdentifiable("the model does not ring: there is no band to judge it in")
    cuts = [round(_FIT_SHARE * len(piece.inputs)) for piece in fit.data]
    pairs = list(zip(fit.data, cuts, strict=True))
    fitted_part = [piece.window(0, cut) for piece, cut in pairs]
    held_out_part = [piece.window(cut, len(piece.inputs)) for piece, cut in pairs]
    refitted = _fit_near(fitted_part, fit.model, fit.options)
    return check_model(refitted or _fit(fitted_part, fit.model.order, fit.options), held_out_part)


def modes_of(model: StateSpace) -> Modes:
    """Poles, and zeros from motor torque to motor velocity, of a model from `state_space_of`."""
    return modes(remove_alternating_poles(model), 0, 0)


def _search_band(records: Sequence[Decoupled]) -> Band:
    """Band around the resonances, from fast subspace estimates without starting values."""
    band = limit_to_records(FIRST_BAND_HZ, records)
    for _ in range(_MAX_BANDS):
        estimate = subspace(input_output_of(records, band, LinearOptions()), PHYSICAL_ORDER)
        resonances = resonances_of(modes_of(estimate))
        if resonances is None:
            break
        previous_band, band = band, band_around(min(resonances), max(resonances), records)
        if same_band(previous_band, band, _BAND_TOLERANCE):
            break
    return band


def _model(
    records: Sequence[Decoupled],
    data: Sequence[InputOutput],
    options: LinearOptions,
    near: StateSpace | None = None,
    physical: StateSpace | None = None,
) -> StateSpace:
    """Fit the order of the options, the order of `near`, or the best of several orders.

    `physical` is the model of three states of the same data, if it is available.
    """
    order = options.order or (near.order if near else None) or _best_order(data, options)
    if physical is not None and physical.order == order:
        return physical
    model = None
    # an alternating pole models the edge of the other band
    if near is not None and near.order == order and remove_alternating_poles(near) is near:
        model = _fit_near(data, near, options)
    model = model or _fit(data, order, options)
    place = Place.in_records(*(record.experiment.name for record in records))
    notes = []
    if not options.order and order != PHYSICAL_ORDER and not _is_usable(model):
        reduced = physical or _fit(data, PHYSICAL_ORDER, options)
        if _is_usable(reduced):
            model = reduced
            notes = [Diagnostic("order-reduced", place, order=order, reduced=PHYSICAL_ORDER)]
    growth = float(np.abs(np.linalg.eigvals(model.A)).max())
    if growth > 1.0:
        rate = float(np.log(growth) / model.sample_time)
        notes.append(Diagnostic("unstable-model", place, rate=rate))
    return replace(model, warnings=(*model.warnings, *notes))


def _best_order(data: Sequence[InputOutput], options: LinearOptions) -> int:
    """Select the model order with `select_order` on at most `_ORDER_SELECTION_SAMPLES` samples."""
    n_remaining, pieces = _ORDER_SELECTION_SAMPLES, []
    for piece in data:
        if n_remaining > 0:
            pieces.append(piece.window(0, min(n_remaining, len(piece.inputs))))
            n_remaining -= len(piece.inputs)
    if options.method == "pem":  # prediction-error fits are a hundred times slower
        options = replace(options, method="subspace")
    if options.horizon is None and options.method == "subspace":
        return select_order(pieces, _ORDERS, fit=subspace_orders).chosen
    fit = partial(_fit, options=options)
    return select_order(pieces, _ORDERS, fit=lambda some: partial(fit, some)).chosen


def _fit(data: Sequence[InputOutput], order: int, options: LinearOptions) -> StateSpace:
    if options.method == "pem":
        start = options.horizon and subspace(data, order, horizon=options.horizon)
        return pem(data, order, start=start or None, options=PemOptions(focus=options.focus))
    method = "auto" if options.method == "subspace" else options.method
    return subspace(data, order, method=method, horizon=options.horizon, focus=options.focus)


def _fit_near(
    data: Sequence[InputOutput], near: StateSpace, options: LinearOptions
) -> StateSpace | None:
    """Fit starting from a model of the same sampling rate; None if the result is not usable."""
    if options.method != "pem":
        return None
    model = pem(data, start=near, options=PemOptions(focus=options.focus))
    return model if _is_usable(model) else None


def _is_usable(model: StateSpace) -> bool:
    return model.status in (SearchEnd.CONVERGED, "estimated") and _resonances(model) is not None


def _resonances(model: StateSpace) -> Band | None:
    """Frequencies [Hz] of anti-resonance and resonance, without the cost of their errors."""
    return resonances_of(modes_of(replace(model, covariance=None)))
