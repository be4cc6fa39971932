"""Estimate a state-space model of one decoupled joint, the paper's decoupling identification.

The inputs are motor torque minus Coulomb friction, and interaction torque. The outputs are motor
velocity and link velocity, as in (11), (12). The data are prepared for prediction-error estimation:

- Innovations need noise power at all frequencies up to Nyquist. The sampling rate is therefore
  reduced together with the low-pass; a low-pass alone would make the noise predictable.
- Friction and sensor bias drift. A second-order zero-phase high-pass below the anti-resonance
  removes them. Its gentle slope leaves power at all frequencies.
- Linear interpolation between samples attenuates the inputs by sinc^2. The inputs are divided by
  sinc^2, so that the interpolated inputs have the original spectrum within the band.
- At low frequencies the fused link velocity (10) contains the motor velocity. The fusion filter is
  known and is inverted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from strainwave.domain import (
    ComplexArray,
    Decoupled,
    Diagnostic,
    FloatArray,
    Fusion,
    Hold,
    InputOutput,
    LinearOptions,
    ModelCheck,
    Modes,
    Place,
    StateSpace,
)
from strainwave.errors import NotIdentifiable, StrainwaveError
from strainwave.identification.joint_model.bands import (
    FIRST_BAND_HZ,
    MIN_PERIODS,
    Band,
    limit_band,
    neighbouring_bands,
    same_band,
)
from strainwave.numerics.filters import by_spectrum, low_pass
from strainwave.signals.channels import check_alike
from strainwave.statespace import (
    check_model,
    modes,
    pem,
    propagate,
    select_order,
    subspace,
    subspace_orders,
)

ANTI_RESONANCE_TO_LOW_EDGE = 3.0  # ratio of the anti-resonance to the lower edge of the band
# ratio of the upper edge of the band to the resonance; with less, the data do not determine d_G
HIGH_EDGE_TO_RESONANCE = 3.0
_MIN_EDGE_RATIO = 4.0  # minimum ratio of the edges of the band
# ratio of the sampling rate to the upper edge of the band. 3.5 to 4.5 work; above 5 the low-pass
# leaves too little noise near Nyquist for the prediction-error method
_RATE_TO_HIGH_EDGE = 4.0
_FIT_SHARE = 0.75  # share of a stretch used to fit; the rest is used to check the model
_MAX_BANDS = 5  # maximum number of bands in the search
_BAND_TOLERANCE = 0.1  # relative difference of the edges up to which the search has converged
_REFIT_BAND_DIFFERENCE = (
    0.25  # relative difference of the edges above which the model is fitted again
)
_HIGH_PASS_ORDER, _LOW_PASS_ORDER = (
    2,
    6,
)  # orders of the band-pass: powers of the frequency ratios in the gain
# share of the new sampling rate up to which inputs are divided by sinc^2, which is 0.1 there
_MAX_COMPENSATED_RATE_SHARE = 0.75
_CUTOFF_TO_NYQUIST = 0.8  # cut-off over the new Nyquist frequency, as in MATLAB's `decimate`
_MIN_CUTOFF_PERIODS = (
    10.0  # minimum number of periods of the cut-off in one period of the slowest motion
)
PHYSICAL_ORDER = 3  # torsion and two velocities; the common angle is not observable
_ORDERS = (3, 4, 5, 6)  # three states of the joint and up to three of the filters
# samples used to select the order: about 100 per parameter of a model with three states
_ORDER_SELECTION_SAMPLES = 2000
_BAND_CHANGE = 1.2  # factor on the band edges for the estimate of the model error


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
    estimated together with the plant, so feedback through a servo or the other joint causes no
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
        return _fit_in((0.0, _decimated_hz(joint[0], chosen)), joint, chosen, near)
    if chosen.band_hz is not None:
        return _fit_in(chosen.band_hz, joint, chosen, near)
    band = _at_rate(_search_band(joint), joint, chosen)
    data = _data(joint, band, chosen)
    # the model of three states determines the band; then the order is selected in that band
    physical = _model(joint, data, physical_order(chosen))
    modes = modes_of(replace(physical, covariance=None))
    # with only some inputs or outputs, the modes need not be those of the joint
    is_whole = chosen.inputs == chosen.outputs == "both"
    if is_whole and modes.anti_resonance and modes.resonance:
        resonances = modes.anti_resonance.frequency_hz, modes.resonance.frequency_hz
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
    data = _data(records, band_hz, options)
    return LinearFit(records, options, band_hz, data, _model(records, data, options, near))


def physical_order(options: LinearOptions) -> LinearOptions:
    """The options with the order of (11), (12), three states, unless the order is set by hand."""
    return options if options.order else replace(options, order=PHYSICAL_ORDER)


def other_bands(band_hz: Band, records: Sequence[Decoupled]) -> list[Band]:
    """A narrower and a wider band [Hz], to measure the model error by the change of estimates."""
    return [_limit_band(band, records) for band in neighbouring_bands(band_hz, _BAND_CHANGE)]


def judge(fit: LinearFit) -> ModelCheck:
    """Refit the model to the first three quarters of each stretch and check it on the last quarter.

    The check computes fits and tests of whiteness and independence on samples that the fit does not
    use. Raises `NotIdentifiable` if the model has no resonance, because its band is then arbitrary.
    """
    if not _has_resonances(fit.model):
        raise NotIdentifiable("the model does not ring: there is no band to judge it in")
    cuts = [round(_FIT_SHARE * len(piece.inputs)) for piece in fit.data]
    fitted_part = [piece.window(0, cut) for piece, cut in zip(fit.data, cuts, strict=True)]
    held_out_part = [
        piece.window(cut, len(piece.inputs)) for piece, cut in zip(fit.data, cuts, strict=True)
    ]
    refitted = _fit_near(fitted_part, fit.model, fit.options)
    return check_model(refitted or _fit(fitted_part, fit.model.order, fit.options), held_out_part)


def modes_of(model: StateSpace) -> Modes:
    """Poles, and zeros from motor torque to motor velocity, of a model from `state_space_of`."""
    return modes(remove_alternating_poles(model), 0, 0)


def remove_alternating_poles(model: StateSpace) -> StateSpace:
    """Remove poles on the negative real axis, which have no continuous-time equivalent.

    Such a pole alternates in sign from sample to sample and models the edge of the band, at
    Nyquist. Within the band it is a constant gain, which is added to D. The covariance is
    propagated. Returns the model itself if it has no such pole.
    """
    values, vectors = np.linalg.eig(model.A)
    alternating = np.flatnonzero((values.imag == 0.0) & (values.real <= 0.0))
    if not len(alternating) or len(alternating) == model.order:
        return model
    z, w = float(values[alternating[0]].real), np.linalg.inv(vectors)[alternating[0]].real
    complement = np.linalg.svd(w[None])[2][
        1:
    ].T  # w'A = z w': `complement` is the invariant subspace
    reduced = _without(z, complement, model)

    def entries(near: StateSpace) -> FloatArray:
        remaining = _without(z, complement, near)
        return np.concatenate(
            [
                each.ravel()
                for each in (remaining.A, remaining.B, remaining.C, remaining.D, remaining.K)
            ]
        )

    if model.covariance is not None:
        reduced = replace(reduced, covariance=propagate(model, entries)[1])
    return remove_alternating_poles(reduced)


def _without(z: float, others: FloatArray, model: StateSpace) -> StateSpace:
    """Remove the pole nearest to z, in the basis `others` projected along that pole's eigenvector.

    The basis is a smooth function of the model, as `propagate` requires.
    """
    values, vectors = np.linalg.eig(model.A)
    index = int(np.argmin(np.abs(values - z)))
    pole, v, w = values[index].real, vectors[:, index].real, np.linalg.inv(vectors)[index].real
    basis = others - np.outer(v, w @ others)
    projection = np.linalg.inv(np.column_stack([basis, v]))[:-1]
    return replace(
        model,
        A=projection @ model.A @ basis,
        B=projection @ model.B,
        C=model.C @ basis,
        D=model.D + np.outer(model.C @ v, w @ model.B) / (1.0 - pole),
        K=projection @ model.K,
        initial_states=model.initial_states @ projection.T,
        covariance=None,
    )


def band_around(
    anti_resonance_hz: float, resonance_hz: float, records: Sequence[Decoupled]
) -> Band:
    """Filter band [Hz] around the resonances, limited to the frequencies in the records."""
    low = anti_resonance_hz / ANTI_RESONANCE_TO_LOW_EDGE
    return _limit_band((low, resonance_hz * HIGH_EDGE_TO_RESONANCE), records)


def _limit_band(band: Band, records: Sequence[Decoupled]) -> Band:
    longest = [
        max((stop - start for start, stop in _stretches(record)), default=1) for record in records
    ]
    return limit_band(band, records, longest, _MIN_EDGE_RATIO)


def band_for(rings_hz: Band, records: Sequence[Decoupled], options: LinearOptions) -> Band:
    """Filter band [Hz] of the options, otherwise the band around a joint's resonances.

    `rings_hz` has the anti-resonance and the resonance [Hz].
    """
    return options.band_hz or _at_rate(band_around(*rings_hz, records), records, options)


def _at_rate(band_hz: Band, records: Sequence[Decoupled], options: LinearOptions) -> Band:
    """Limit the upper edge of the band to what the decimation of the options allows."""
    if options.decimation is None:
        return band_hz
    high = 1.0 / (_RATE_TO_HIGH_EDGE * options.decimation * records[0].sample_time)
    return min(band_hz[0], high / _MIN_EDGE_RATIO), high


def band_of(f: FloatArray, band_hz: Band) -> FloatArray:
    """Gain (n_frequencies,) of the zero-phase band-pass, 1 / ((1 + (low/f)^2) (1 + (f/high)^6))."""
    low, high = band_hz
    gain = (1.0 + (low / f) ** _HIGH_PASS_ORDER) * (1.0 + (f / high) ** _LOW_PASS_ORDER)
    return np.asarray(1.0 / gain)


def velocities(f: FloatArray, record: Decoupled) -> ComplexArray:
    """Frequency response from the outputs to motor and link velocity, the inverse of (10).

    Returns (n_frequencies, 2, 2) for `f` (n_frequencies,) [Hz].
    """
    inverse = np.zeros((len(f), 2, 2), dtype=complex)
    inverse[:, 0, 0] = inverse[:, 1, 1] = 1.0
    if record.fusion is not None:
        F = _fusion_low_pass(f, record.fusion)
        inverse[:, 1, 1] = 1.0 / (1.0 - F)
        inverse[:, 1, 0] = -record.gear_ratio * F / (1.0 - F)
    return inverse


def _fusion_low_pass(f: FloatArray, fusion: Fusion) -> ComplexArray:
    """Low-pass F of the fusion (10)."""
    x = 2j * np.pi * f * fusion.time_constant
    return np.asarray(1.0 / (1.0 + x if fusion.order == 1 else 1.0 + np.sqrt(2.0) * x + x * x))


def _stretches(record: Decoupled) -> list[tuple[int, int]]:
    """Start and stop (exclusive) of each run of valid samples."""
    edges = np.flatnonzero(np.diff(np.r_[False, record.valid, False].astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def _data(
    records: Sequence[Decoupled], band_hz: Band, options: LinearOptions
) -> tuple[InputOutput, ...]:
    """Filtered and decimated stretches of all records."""
    pieces = _pieces if options.filter == "band" else _decimate
    stretches = [piece for record in records for piece in pieces(record, band_hz, options)]
    if not stretches:
        raise NotIdentifiable(
            f"no stretch of {records[0].experiment.name} is free of edges and saturation for "
            f"{MIN_PERIODS:g} periods of "
            f"{band_hz[0] or band_hz[1] / _MIN_CUTOFF_PERIODS:.3g} Hz: record for longer, "
            "or lower the amplitude"
        )
    return tuple(stretches)


def _pieces(record: Decoupled, band_hz: Band, options: LinearOptions) -> Iterator[InputOutput]:
    low, high = band_hz
    T = record.sample_time
    step = options.decimation or max(1, round(1.0 / (_RATE_TO_HIGH_EDGE * high * T)))
    n_in = 1 if options.inputs == "motor" else record.inputs.shape[1]
    n_out = 1 if options.outputs == "motor" else 2

    def compensated_band(f: FloatArray) -> ComplexArray:
        attenuation = np.where(
            f * step * T < _MAX_COMPENSATED_RATE_SHARE, np.sinc(f * step * T) ** 2, 1.0
        )
        return np.asarray(band_of(f, band_hz) / attenuation, dtype=complex)

    def compensated_sensors(f: FloatArray) -> ComplexArray:
        return np.asarray(band_of(f, band_hz)[:, None, None] * velocities(f, record))

    for start, stop in _stretches(record):
        edge = int(1.0 / (low * T))
        # the high-pass response lasts one period; the remaining samples must suffice for a fit
        if (stop - start) * T * low < MIN_PERIODS - 1e-6:
            continue
        inputs = by_spectrum(record.inputs[start:stop, :n_in], compensated_band, T, 3.0 / low)
        outputs = by_spectrum(record.outputs[start:stop], compensated_sensors, T, 3.0 / low)
        yield InputOutput(
            inputs=np.ascontiguousarray(inputs[edge : stop - start - edge : step]),
            outputs=np.ascontiguousarray(outputs[edge : stop - start - edge : step, :n_out]),
            sample_time=step * T,
            hold=cast("tuple[Hold, ...]", ("first",) * n_in),
            input_names=("motor_torque", "interaction_torque")[:n_in],
            output_names=("motor_velocity", "link_velocity")[:n_out],
        )


def _decimated_hz(record: Decoupled, options: LinearOptions) -> float:
    """Cut-off frequency [Hz] of the low-pass before decimation."""
    return _CUTOFF_TO_NYQUIST * 0.5 / ((options.decimation or 1) * record.sample_time)


def _decimate(record: Decoupled, _: Band, options: LinearOptions) -> Iterator[InputOutput]:
    """Low-passed, decimated stretches without their means, prepared as in the source."""
    T, step, cutoff = record.sample_time, options.decimation or 1, _decimated_hz(record, options)
    n_in = 1 if options.inputs == "motor" else record.inputs.shape[1]
    n_out = 1 if options.outputs == "motor" else 2
    for start, stop in _stretches(record):
        edge = int(1.0 / (cutoff * T))
        if (stop - start) * T * cutoff < _MIN_CUTOFF_PERIODS * MIN_PERIODS:
            continue
        columns = np.hstack([record.inputs[start:stop, :n_in], record.outputs[start:stop, :n_out]])
        samples = low_pass(columns, cutoff, T)[edge : stop - start - edge : step]
        samples = np.ascontiguousarray(samples - samples.mean(axis=0))
        yield InputOutput(
            inputs=samples[:, :n_in],
            outputs=samples[:, n_in:],
            sample_time=step * T,
            hold=cast("tuple[Hold, ...]", ("first",) * n_in),
            input_names=("motor_torque", "interaction_torque")[:n_in],
            output_names=("motor_velocity", "link_velocity")[:n_out],
        )


def _search_band(records: Sequence[Decoupled]) -> Band:
    """Band around the resonances, from fast subspace estimates without starting values."""
    band = _limit_band(FIRST_BAND_HZ, records)
    for _ in range(_MAX_BANDS):
        estimated_modes = modes_of(subspace(_data(records, band, LinearOptions()), 3))
        if estimated_modes.anti_resonance is None or estimated_modes.resonance is None:
            break
        previous_band = band
        low, high = (
            estimated_modes.anti_resonance.frequency_hz,
            estimated_modes.resonance.frequency_hz,
        )
        band = band_around(min(low, high), max(low, high), records)
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
    start = near if near is not None and near.order == order else None
    model = _fit_from(data, start, options) or _fit(data, order, options)
    notes: tuple[Diagnostic, ...] = ()
    if not options.order and order != PHYSICAL_ORDER and not _is_usable(model):
        reduced = physical or _fit(data, PHYSICAL_ORDER, options)
        if _is_usable(reduced):
            model, notes = reduced, (_order_warning(records, order),)
    return replace(model, warnings=(*model.warnings, *notes, *_warnings(model, records)))


def _order_warning(records: Sequence[Decoupled], order: int) -> Diagnostic:
    place = Place.in_records(*(record.experiment.name for record in records))
    text = (
        f"the data ask for {order} states, but no such model converges with a resonance: this has"
    )
    return Diagnostic.at("order-reduced", place, f"{text} {PHYSICAL_ORDER}")


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
        if options.horizon is None:
            return pem(data, order)
        return pem(data, order, start=subspace(data, order, horizon=options.horizon))
    method = "auto" if options.method == "subspace" else options.method
    return subspace(data, order, method=method, horizon=options.horizon)


def _fit_from(
    data: Sequence[InputOutput], near: StateSpace | None, options: LinearOptions
) -> StateSpace | None:
    """Fit starting from a model in another band; None if the result is not usable.

    A model with an alternating pole is not used, because that pole models the edge of the other
    band.
    """
    if near is None or remove_alternating_poles(near) is not near:
        return None
    return _fit_near(data, near, options)


def _fit_near(
    data: Sequence[InputOutput], near: StateSpace, options: LinearOptions
) -> StateSpace | None:
    """Fit starting from a model of the same sampling rate; None if the result is not usable."""
    if options.method != "pem":
        return None
    model = pem(data, start=near)
    return model if _is_usable(model) else None


def _is_usable(model: StateSpace) -> bool:
    return model.status in ("converged", "estimated") and _has_resonances(model)


def _has_resonances(model: StateSpace) -> bool:
    modes = modes_of(replace(model, covariance=None))
    return bool(modes.resonance and modes.anti_resonance)


def _warnings(model: StateSpace, records: Sequence[Decoupled]) -> Iterator[Diagnostic]:
    place = Place.in_records(*(record.experiment.name for record in records))
    growth = float(np.abs(np.linalg.eigvals(model.A)).max())
    if growth > 1.0:
        rate = float(np.log(growth) / model.sample_time)
        text = f"the slowest pole grows by {rate:.2g} 1/s, as friction that is not quite taken off"
        text += " makes it seem; the simulated fit means nothing, resonances are not touched"
        yield Diagnostic.at("unstable-model", place, text)
