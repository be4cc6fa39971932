"""Decoupled -> StateSpace: a linear model of one joint, the paper's decoupling identification.

Two inputs, motor torque less Coulomb friction and interaction torque, and two outputs, motor and
link velocity, as in (11), (12). What prediction-error estimation asks of the data, it gets here:

- The noise must be innovations of some size at every frequency up to Nyquist. So the rate comes
  down together with the low-pass in front; a low-pass alone would make the noise predictable.
- Friction and sensor bias drift. A second-order zero-phase high-pass below the anti-resonance
  keeps that out, and gentle as it is leaves no empty band.
- Straight lines between so few samples are not the input. Its samples are raised by 1/sinc^2, so
  that the lines through them have in the band the spectrum that the input had.
- The link velocity (10) leans on the motor's at low frequencies; both are known, so it is undone.
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
    StateSpace,
)
from strainwave.errors import NotIdentifiable, StrainwaveError
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

BELOW = 3.0  # anti-resonance over the band's lower edge
ABOVE = 3.0  # the band's upper edge over the resonance: with less, d_G hardly shows
_FIRST_BAND_HZ = (3.0, 60.0)  # where strain-wave gears and links of metres ring; then adapted
_SLOWEST = 6.0  # periods of the lower edge in the longest stretch, at least
_OVERSAMPLED = 4.0  # the rate over the band's upper edge: 3.5 to 4.5 do, beyond 5 the
# low-pass leaves so little noise below Nyquist that the fit sees nothing else
_FITTED = 0.75  # share of a stretch that is fitted where the rest is to judge
_ROUNDS = 5  # in which the band may move
_SAME_BAND = 0.1
_FAR_OFF = 0.25
_HIGH_PASS, _LOW_PASS = 2, 6  # powers of the frequency ratios in the gain
_RAISED = 0.75  # of the new rate, up to which inputs are raised: sinc^2 is then a tenth
_BELOW_NYQUIST = 0.8  # of the new Nyquist frequency, as in MATLAB's `decimate`
_SHORTEST = 10.0  # periods of that low-pass in one of the slowest motion, at least
PHYSICAL_ORDER = 3  # torsion and two velocities: a common turn of both sides is not seen in them
_ORDERS = (3, 4, 5, 6)  # a joint has three states, and filters add a few
_INFORMATIVE = 2000  # samples that choose an order: a hundred for each parameter of three states
_OTHER_BAND = 1.2  # factor by which band edges are moved to see the residuals out


@dataclass(frozen=True, slots=True)
class LinearFit:
    """A joint's state-space model with the band and the samples that it is fitted to."""

    records: tuple[Decoupled, ...]
    options: LinearOptions
    band_hz: tuple[float, float]  # of the filter
    data: tuple[InputOutput, ...]  # filtered, decimated stretches
    model: StateSpace
    physical: StateSpace | None = None  # of three states in the same band; None: not fitted yet

    def of_physical_order(self) -> StateSpace:
        """The model of three states, which (17) presumes, in the same band.

        The model itself if its order is set by hand, if it has three states, or if the model of
        three states does not converge or has no resonance.
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

    The model is one of the filtered signals, so it says nothing below the band. The noise model is
    estimated along with the plant, so feedback through a servo or the other joint does not bias it.
    `near` is a model of the same records in another band, from which the search starts.

    Raises `InvalidInput` for records of different joints or rates, `NotIdentifiable` if no stretch
    without saturation is long enough or no model fits.
    """
    return fit_linear(records, options, near).model


def fit_linear(
    records: Decoupled | Sequence[Decoupled],
    options: LinearOptions | None = None,
    near: StateSpace | None = None,
) -> LinearFit:
    """Estimate a state-space model like `state_space_of`, and return its band and samples too."""
    chosen = options or LinearOptions()
    joint = (records,) if isinstance(records, Decoupled) else tuple(records)
    check_alike(joint)
    if chosen.filter == "decimation":
        return _fit_in((0.0, _decimated_hz(joint[0], chosen)), joint, chosen, near)
    if chosen.band_hz is not None:
        return _fit_in(chosen.band_hz, joint, chosen, near)
    band = _at_rate(_search(joint), joint, chosen)
    data = _data(joint, band, chosen)
    # the model of physical order sets the band, then the data choose the order in that band
    physical = _model(joint, data, physical_order(chosen))
    modes = modes_of(replace(physical, covariance=None))
    # with some inputs or outputs left out the modes may be others than the joint's
    is_whole = chosen.inputs == chosen.outputs == "both"
    if is_whole and modes.anti_resonance and modes.resonance:
        rings = modes.anti_resonance.frequency_hz, modes.resonance.frequency_hz
        better = band_for(rings, joint, chosen)
        if not same_band(band, better, _FAR_OFF):
            return _fit_in(better, joint, chosen)
    model = _model(joint, data, chosen, physical=physical)
    return LinearFit(joint, chosen, band, data, model, physical)


def _fit_in(
    band_hz: tuple[float, float],
    records: tuple[Decoupled, ...],
    options: LinearOptions,
    near: StateSpace | None = None,
) -> LinearFit:
    data = _data(records, band_hz, options)
    return LinearFit(records, options, band_hz, data, _model(records, data, options, near))


def physical_order(options: LinearOptions) -> LinearOptions:
    """The same options with the order of (11), (12): what the closed forms (17), (18) presume.

    Returns: With the order that was chosen by hand, where one was.
    """
    return options if options.order else replace(options, order=PHYSICAL_ORDER)


def other_bands(
    band_hz: tuple[float, float], records: Sequence[Decoupled]
) -> tuple[tuple[float, float], ...]:
    """A narrower and a wider band: what the model lacks shows in how its answer changes.

    `band_hz` [Hz].

    Returns: [Hz].
    """
    low, high = band_hz
    return tuple(
        band_around(low * BELOW * by, high / ABOVE / by, records)
        for by in (_OTHER_BAND, 1.0 / _OTHER_BAND)
    )


def judge(fit: LinearFit) -> ModelCheck:
    """Refit the model to the first three quarters of each stretch and check it on the last quarter.

    The result has fits, and tests of whiteness and independence, on samples that the fit does not
    use. Raises `NotIdentifiable` if the model has no resonance, because its band is then arbitrary.
    """
    if not _has_resonances(fit.model):
        raise NotIdentifiable("the model does not ring: there is no band to judge it in")
    cuts = [round(_FITTED * len(piece.inputs)) for piece in fit.data]
    first = [piece.window(0, cut) for piece, cut in zip(fit.data, cuts, strict=True)]
    last = [piece.window(cut, len(piece.inputs)) for piece, cut in zip(fit.data, cuts, strict=True)]
    refitted = _fit_near(first, fit.model, fit.options)
    return check_model(refitted or _fit(first, fit.model.order, fit.options), last)


def modes_of(model: StateSpace) -> Modes:
    """Poles, and zeros from motor torque to motor velocity, of what lies in the band.

    `model`: From `state_space_of`.
    """
    return modes(without_alternating(model), 0, 0)


def without_alternating(model: StateSpace) -> StateSpace:
    """A model that has a counterpart in continuous time: poles on the negative real axis left out.

    Such a pole answers every sample with the opposite sign: it shapes the edge of the band, at
    Nyquist. In the band it is a mere gain, which goes into D.

    Returns: The model itself where there is none; else one with its covariance carried over, if it
    has one.
    """
    values, vectors = np.linalg.eig(model.A)
    bad = np.flatnonzero((values.imag == 0.0) & (values.real <= 0.0))
    if not len(bad) or len(bad) == model.order:
        return model
    z, w = float(values[bad[0]].real), np.linalg.inv(vectors)[bad[0]].real
    others = np.linalg.svd(w[None])[2][1:].T  # w'A = z w', so that what w does not see stays unseen
    shorter = _without(z, others, model)

    def entries(near: StateSpace) -> FloatArray:
        left = _without(z, others, near)
        return np.concatenate([each.ravel() for each in (left.A, left.B, left.C, left.D, left.K)])

    if model.covariance is not None:
        shorter = replace(shorter, covariance=propagate(model, entries)[1])
    return without_alternating(shorter)


def _without(z: float, others: FloatArray, model: StateSpace) -> StateSpace:
    """The model without its pole nearest to z, in a basis that is `others` seen along that pole.

    That basis moves smoothly with the model, as `propagate` asks.
    """
    values, vectors = np.linalg.eig(model.A)
    bad = int(np.argmin(np.abs(values - z)))
    pole, v, w = values[bad].real, vectors[:, bad].real, np.linalg.inv(vectors)[bad].real
    basis = others - np.outer(v, w @ others)
    to = np.linalg.inv(np.column_stack([basis, v]))[:-1]
    return replace(
        model,
        A=to @ model.A @ basis,
        B=to @ model.B,
        C=model.C @ basis,
        D=model.D + np.outer(model.C @ v, w @ model.B) / (1.0 - pole),
        K=to @ model.K,
        initial_states=model.initial_states @ to.T,
        covariance=None,
    )


def band_around(
    anti_resonance_hz: float, resonance_hz: float, records: Sequence[Decoupled]
) -> tuple[float, float]:
    """The band of the filter for a joint with its resonance there, cut to what the records hold.

    `anti_resonance_hz, resonance_hz` [Hz].

    Returns: [Hz].
    """
    low, high = anti_resonance_hz / BELOW, resonance_hz * ABOVE
    for record in records:
        longest = max((stop - start for start, stop in _stretches(record)), default=1)
        low = max(low, _SLOWEST / (longest * record.sample_time))
        high = min(high, 0.4 / record.sample_time, 0.8 * (record.bandwidth_hz or np.inf))
    return min(low, high / 4.0), high


def band_for(
    rings_hz: tuple[float, float], records: Sequence[Decoupled], options: LinearOptions
) -> tuple[float, float]:
    """The band of the filter that the options give, else that around a joint's resonances.

    `rings_hz` [Hz]: Anti-resonance and resonance.

    Returns: [Hz].
    """
    return options.band_hz or _at_rate(band_around(*rings_hz, records), records, options)


def _at_rate(
    band_hz: tuple[float, float], records: Sequence[Decoupled], options: LinearOptions
) -> tuple[float, float]:
    """The band up to where the rate asks for the low-pass, if the rate is given."""
    if options.decimation is None:
        return band_hz
    high = 1.0 / (_OVERSAMPLED * options.decimation * records[0].sample_time)
    return min(band_hz[0], high / 4.0), high


def same_band(band: tuple[float, float], other: tuple[float, float], within: float) -> bool:
    """Whether both edges of two bands are the same, within a share of theirs.

    `band, other` [Hz].
    """
    return all(abs(a / b - 1.0) < within for a, b in zip(band, other, strict=True))


def band_of(f: FloatArray, band_hz: tuple[float, float]) -> FloatArray:
    """Gain of the zero-phase band-pass, 1 / ((1 + (low/f)^2) (1 + (f/high)^6)).

    `f` (n_frequencies,) [Hz].
    `band_hz` [Hz].

    Returns: (n_frequencies,).
    """
    low, high = band_hz
    gain = (1.0 + (low / f) ** _HIGH_PASS) * (1.0 + (f / high) ** _LOW_PASS)
    return np.asarray(1.0 / gain)


def velocities(f: FloatArray, record: Decoupled) -> ComplexArray:
    """From the outputs to the velocities of motor and link themselves, (10) undone.

    `f` (n_frequencies,) [Hz].

    Returns: (n_frequencies, 2, 2).
    """
    undo = np.zeros((len(f), 2, 2), dtype=complex)
    undo[:, 0, 0] = undo[:, 1, 1] = 1.0
    if record.fusion is not None:
        F = _lean(f, record.fusion)
        undo[:, 1, 1] = 1.0 / (1.0 - F)
        undo[:, 1, 0] = -record.gear_ratio * F / (1.0 - F)
    return undo


def _lean(f: FloatArray, fusion: Fusion) -> ComplexArray:
    """The low-pass F of (10)."""
    x = 2j * np.pi * f * fusion.time_constant
    return np.asarray(1.0 / (1.0 + x if fusion.order == 1 else 1.0 + np.sqrt(2.0) * x + x * x))


def _stretches(record: Decoupled) -> list[tuple[int, int]]:
    """First and last but one of the uninterrupted valid samples."""
    edges = np.flatnonzero(np.diff(np.r_[False, record.valid, False].astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def _data(
    records: Sequence[Decoupled], band_hz: tuple[float, float], options: LinearOptions
) -> tuple[InputOutput, ...]:
    """Filtered, decimated stretches."""
    pieces = _pieces if options.filter == "band" else _decimated
    found = [piece for record in records for piece in pieces(record, band_hz, options)]
    if not found:
        raise NotIdentifiable(
            f"no stretch of {records[0].experiment.name} is free of edges and saturation for "
            f"{_SLOWEST:g} periods of {band_hz[0] or band_hz[1] / _SHORTEST:.3g} Hz: record for "
            "longer, or lower the amplitude"
        )
    return tuple(found)


def _pieces(
    record: Decoupled, band_hz: tuple[float, float], options: LinearOptions
) -> Iterator[InputOutput]:
    low, high = band_hz
    T = record.sample_time
    step = options.decimation or max(1, round(1.0 / (_OVERSAMPLED * high * T)))
    n_in = 1 if options.inputs == "motor" else record.inputs.shape[1]
    n_out = 1 if options.outputs == "motor" else 2

    def raised(f: FloatArray) -> ComplexArray:
        lines = np.where(f * step * T < _RAISED, np.sinc(f * step * T) ** 2, 1.0)
        return np.asarray(band_of(f, band_hz) / lines, dtype=complex)

    def undone(f: FloatArray) -> ComplexArray:
        return np.asarray(band_of(f, band_hz)[:, None, None] * velocities(f, record))

    for start, stop in _stretches(record):
        edge = int(1.0 / (low * T))
        # the high-pass answers over one period; the rest must say something
        if (stop - start) * T * low < _SLOWEST - 1e-6:
            continue
        inputs = by_spectrum(record.inputs[start:stop, :n_in], raised, T, 3.0 / low)
        outputs = by_spectrum(record.outputs[start:stop], undone, T, 3.0 / low)
        yield InputOutput(
            inputs=np.ascontiguousarray(inputs[edge : stop - start - edge : step]),
            outputs=np.ascontiguousarray(outputs[edge : stop - start - edge : step, :n_out]),
            sample_time=step * T,
            hold=cast("tuple[Hold, ...]", ("first",) * n_in),
            input_names=("motor_torque", "interaction_torque")[:n_in],
            output_names=("motor_velocity", "link_velocity")[:n_out],
        )


def _decimated_hz(record: Decoupled, options: LinearOptions) -> float:
    """Cut-off of the low-pass in front of a decimation."""
    return _BELOW_NYQUIST * 0.5 / ((options.decimation or 1) * record.sample_time)


def _decimated(
    record: Decoupled, _: tuple[float, float], options: LinearOptions
) -> Iterator[InputOutput]:
    """Stretches as the source prepares them, less their means: a low-pass, and fewer samples."""
    T, step, cutoff = record.sample_time, options.decimation or 1, _decimated_hz(record, options)
    n_in = 1 if options.inputs == "motor" else record.inputs.shape[1]
    n_out = 1 if options.outputs == "motor" else 2
    for start, stop in _stretches(record):
        edge = int(1.0 / (cutoff * T))
        if (stop - start) * T * cutoff < _SHORTEST * _SLOWEST:
            continue
        columns = np.hstack([record.inputs[start:stop, :n_in], record.outputs[start:stop, :n_out]])
        kept = low_pass(columns, cutoff, T)[edge : stop - start - edge : step]
        kept = np.ascontiguousarray(kept - kept.mean(axis=0))
        yield InputOutput(
            inputs=kept[:, :n_in],
            outputs=kept[:, n_in:],
            sample_time=step * T,
            hold=cast("tuple[Hold, ...]", ("first",) * n_in),
            input_names=("motor_torque", "interaction_torque")[:n_in],
            output_names=("motor_velocity", "link_velocity")[:n_out],
        )


def _search(records: Sequence[Decoupled]) -> tuple[float, float]:
    """A band around the resonances, by subspace estimates, which are quick and need no start."""
    band = band_around(_FIRST_BAND_HZ[0] * BELOW, _FIRST_BAND_HZ[1] / ABOVE, records)
    for _ in range(_ROUNDS):
        found = modes_of(subspace(_data(records, band, LinearOptions()), 3))
        if found.anti_resonance is None or found.resonance is None:
            break
        before = band
        low, high = found.anti_resonance.frequency_hz, found.resonance.frequency_hz
        band = band_around(min(low, high), max(low, high), records)
        if same_band(before, band, _SAME_BAND):
            break
    return band


def _model(
    records: Sequence[Decoupled],
    data: Sequence[InputOutput],
    options: LinearOptions,
    near: StateSpace | None = None,
    physical: StateSpace | None = None,
) -> StateSpace:
    """Fit the order that the options give, that of `near`, or the best of several.

    `physical` is the model of three states of the same data, where it is known already.
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
            model, notes = reduced, (_reduced(records, order),)
    return replace(model, warnings=(*model.warnings, *notes, *_warnings(model, records)))


def _reduced(records: Sequence[Decoupled], order: int) -> Diagnostic:
    where = ", ".join(record.experiment.name for record in records)
    text = (
        f"the data ask for {order} states, but no such model converges with a resonance: this has"
    )
    return Diagnostic("order-reduced", where, f"{text} {PHYSICAL_ORDER}")


def _best_order(data: Sequence[InputOutput], options: LinearOptions) -> int:
    """By `select_order`, on no more samples than an order needs to show."""
    left, taken = _INFORMATIVE, []
    for piece in data:
        if left > 0:
            taken.append(piece.window(0, min(left, len(piece.inputs))))
            left -= len(piece.inputs)
    if options.method == "pem":  # prediction-error fits take a hundred times as long
        options = replace(options, method="subspace")
    if options.horizon is None and options.method == "subspace":
        return select_order(taken, _ORDERS, fit=subspace_orders).chosen
    fit = partial(_fit, options=options)
    return select_order(taken, _ORDERS, fit=lambda some: partial(fit, some)).chosen


def _fit(data: Sequence[InputOutput], order: int, options: LinearOptions) -> StateSpace:
    if options.method == "pem":
        if options.horizon is None:
            return pem(data, order)
        return pem(data, order, start=subspace(data, order, horizon=options.horizon))
    way = "auto" if options.method == "subspace" else options.method
    return subspace(data, order, method=way, horizon=options.horizon)


def _fit_from(
    data: Sequence[InputOutput], near: StateSpace | None, options: LinearOptions
) -> StateSpace | None:
    """The fit that starts from a model in another band; None if it is not usable.

    An alternating pole belongs to the edge of the other band, so that model is no start.
    """
    if near is None or without_alternating(near) is not near:
        return None
    return _fit_near(data, near, options)


def _fit_near(
    data: Sequence[InputOutput], near: StateSpace, options: LinearOptions
) -> StateSpace | None:
    """The fit that starts from another model of the same rate; None if it is not usable."""
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
    where = ", ".join(record.experiment.name for record in records)
    growth = float(np.abs(np.linalg.eigvals(model.A)).max())
    if growth > 1.0:
        rate = float(np.log(growth) / model.sample_time)
        text = f"the slowest pole grows by {rate:.2g} 1/s, as friction that is not quite taken off"
        text += " makes it seem; the simulated fit means nothing, resonances are not touched"
        yield Diagnostic("unstable-model", where, text)
