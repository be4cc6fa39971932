"""Signals -> RigidModel: the rigid-joint arm (5)-(7) by weighted least squares.

The equations of motion are linear in the model's parameters. They are filtered to a bandwidth
chosen from the data, weighted per joint, and solved together with nuisance unknowns for the
friction of motors that may stand and for the gears' compliance; see `_equations`. Deviations come
from leaving out stretches of the data and from changing the bandwidth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave import _least_squares as ls
from strainwave._equations import (
    Estimate,
    Stretch,
    anti_resonances,
    assemble,
    estimate_of,
    n_compliances,
    decimation,
    prepare,
)
from strainwave._regressor import columns_of
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.records import BoolArray, FloatArray, Parameter, RigidModel, Signals, Study, Warning

_ROUNDS = 20
_CONVERGED = 0.02  # change in white-error deviations, which are the smallest there are
_STEP = 2.0**0.5  # between bandwidths tried
_GAIN = np.log(1.1)  # a deviation's change that counts; the jackknife knows it no better
_FRUITLESS = 3  # bandwidths without gain that end the search
_BELOW_RESONANCE = 3.0  # anti-resonance over bandwidth from which first order suffices


@dataclass(frozen=True, slots=True)
class RigidOptions:
    """What may be set by hand."""

    bandwidth_hz: float | None = None  # of the equations' filter; None: chosen from the data


@dataclass(frozen=True, slots=True)
class _Trial:
    """A fit at one bandwidth."""

    bandwidth_hz: float
    stretches: tuple[Stretch, ...]
    estimate: Estimate
    compliance_deviation: FloatArray
    equations: ls.Equations
    factor: ls.Factor
    covariance: FloatArray
    determined: BoolArray

    @property
    def spread(self) -> FloatArray:
        """Logarithms of the parameters' deviations; infinite where not determined."""
        deviation = np.sqrt(np.clip(np.diag(self.covariance), 1e-300, None))
        return np.where(self.determined, np.log(deviation), np.inf)


def fit(
    signals: Sequence[Signals], study: Study, options: RigidOptions | None = None
) -> RigidModel:
    """Identify the rigid-joint arm from motion records.

    Parameters
    ----------
    signals : sequence of Signals
        One a record, from `signals.motor_side`.
    study : Study
    options : RigidOptions, optional

    Returns
    -------
    RigidModel
        Parameters that the data do not tell have the value None, and a warning says why.

    Raises
    ------
    NotIdentifiable
        There is no record, or none in which a joint moves.
    """
    chosen = options or RigidOptions()
    if not signals:
        raise NotIdentifiable(
            "the rigid step needs a record with use = \"motion\": slow, smooth motion of all joints"
        )
    _check_motion(signals)
    if chosen.bandwidth_hz is not None:
        trials = [_trial(signals, study, chosen.bandwidth_hz, None)]
    else:
        trials = _search(signals, study)
    best = _choose(trials, study)
    remainder = _scatter(trials, best) + _elastic_remainder(signals, study, best)
    covariance = best.covariance + np.diag(remainder)
    return _model(study, signals, best, covariance)


def _search(signals: Sequence[Signals], study: Study) -> list[_Trial]:
    """Trials at rising bandwidths, while they gain and the arm still looks nearly rigid."""
    trials: list[_Trial] = []
    least, since = np.full(len(columns_of(study)), np.inf), 0
    around: Estimate | None = None
    for bandwidth in _bandwidths(signals):
        trial = _trial(signals, study, bandwidth, around)
        if trials and bandwidth > _surely_elastic(study, trial):
            break
        trials.append(trial)
        around = trial.estimate
        gained = bool(np.any(trial.spread < least - _GAIN))
        since = 0 if gained else since + 1
        least = np.minimum(least, trial.spread)
        if since >= _FRUITLESS:
            break
    return trials


def _surely_elastic(study: Study, trial: _Trial) -> float:
    """Bandwidth above which the arm's elasticity is certainly more than first order."""
    if not len(trial.compliance_deviation):
        return np.inf
    certain = np.clip(trial.estimate.compliance - 2.0 * trial.compliance_deviation, 0.0, None)
    sure = replace(trial.estimate, compliance=certain)
    return float(np.min(anti_resonances(study, sure))) / _BELOW_RESONANCE


def _bandwidths(signals: Sequence[Signals]) -> Iterator[float]:
    """From where nine tenths of the motion's power lie below, up to half the signals' own."""
    top = min(s.bandwidth_hz or 0.5 / s.sample_time for s in signals) / 2.0
    shortest = min(len(s.time) * s.sample_time for s in signals)
    bandwidth = max(max(_motion_band(s) for s in signals), 8.0 / shortest)
    bandwidth = min(bandwidth, top)
    while bandwidth <= top:
        yield bandwidth
        bandwidth *= _STEP


def _motion_band(signals: Signals) -> float:
    """Frequency below which nine tenths of the velocities' power lie [Hz]."""
    from scipy.signal import periodogram

    highest = 0.0
    for velocity in signals.motor_velocity.T:
        frequency, power = periodogram(velocity, 1.0 / signals.sample_time, detrend="linear")
        share = np.cumsum(power)
        if share[-1] > 0.0:
            highest = max(highest, float(frequency[np.searchsorted(share, 0.9 * share[-1])]))
    return highest


def _trial(
    signals: Sequence[Signals], study: Study, bandwidth_hz: float, around: Estimate | None
) -> _Trial:
    """Fit at one bandwidth: parameters, compliances and weights in turn until nothing moves."""
    stretches = tuple(prepare(s, bandwidth_hz) for s in signals)
    equations = assemble(study, stretches, around)
    if not len(equations.target):
        raise NotIdentifiable("every sample is at an edge or in saturation; record for longer")
    root = ls.first_weights(equations.target, equations.group)
    for rounds in range(_ROUNDS):
        factor = ls.factorise(equations, root)
        settled = (
            rounds > 1
            and around is not None
            and np.all(
                np.abs(factor.value - around.solution) <= _CONVERGED * factor.deviation
            )
        )
        around = estimate_of(study, stretches, equations, factor)
        if settled:
            break
        root = ls.root_weights(equations, factor)
        equations = assemble(study, stretches, around)
    covariance, compliance_variance = ls.jackknife(equations, factor, n_compliances(study))
    told = ls.determined(equations, factor, covariance)
    assert around is not None
    return _Trial(
        bandwidth_hz=bandwidth_hz,
        stretches=stretches,
        estimate=around,
        compliance_deviation=np.sqrt(compliance_variance),
        equations=equations,
        factor=factor,
        covariance=covariance,
        determined=told,
    )


def _elastic_remainder(
    signals: Sequence[Signals], study: Study, best: _Trial
) -> FloatArray:
    """Variance from elasticity beyond first order.

    The compliances moved the parameters by some amount, in first order of (w / w_a)^2; what the
    next order would move them by is taken as that amount times (bandwidth / anti-resonance)^2.

    Returns
    -------
    (n_parameters,)
    """
    ratio = best.bandwidth_hz / float(np.min(anti_resonances(study, best.estimate)))
    if ratio == 0.0:
        return np.zeros(len(best.covariance))
    stiff = replace(study, joints=tuple(replace(j, spring="rigid") for j in study.joints))
    rigid = _trial(signals, stiff, best.bandwidth_hz, best.estimate)
    moved = best.estimate.solution - rigid.estimate.solution
    return np.asarray((moved * ratio**2) ** 2)


def _choose(trials: Sequence[_Trial], study: Study) -> _Trial:
    """The bandwidth at which no parameter is much less certain than it might be.

    The regret of a bandwidth is the largest ratio of a deviation there to that parameter's least.
    Behind elastic gears the lowest of the good bandwidths is taken, because what the model leaves
    out shows at high frequencies first.
    """
    spread = np.array([trial.spread for trial in trials])
    least = spread.min(axis=0)
    told = np.isfinite(least)
    regret = np.max(spread[:, told] - least[told], axis=1, initial=0.0)
    if all(joint.spring == "rigid" for joint in study.joints):
        return trials[int(np.argmin(regret))]
    return trials[int(np.argmax(regret <= regret.min() + _GAIN))]


def _scatter(trials: Sequence[_Trial], best: _Trial) -> FloatArray:
    """Variance from model error that shows as dependence on the bandwidth.

    Were the model exact, every bandwidth would give the same values within their deviations; what
    the neighbours, within a factor of about two, differ by beyond those is what it lacks.

    Returns
    -------
    (n_parameters,)
    """
    excess = [
        np.clip(
            (t.estimate.solution - best.estimate.solution) ** 2 - np.diag(t.covariance), 0.0, None
        )
        for t in trials
        if t is not best and 0.45 <= t.bandwidth_hz / best.bandwidth_hz <= 2.1
    ]
    return np.mean(excess, axis=0) if excess else np.zeros(len(best.covariance))
