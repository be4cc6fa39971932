"""Rigid step: identify the arm with rigid joints (5)-(7) by weighted least squares.

The equations of motion are linear in the parameters. They are low-passed to a bandwidth selected
from the data, weighted per joint, and solved together with nuisance parameters for stiction and
gear compliance; see `equations`. The covariance comes from a block jackknife and from the change of
the estimates with the bandwidth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from strainwave.domain import (
    DriveGains,
    FloatArray,
    FrictionTerm,
    Parameter,
    RigidModel,
    RigidOptions,
    Signals,
)
from strainwave.domain.arm.gear_laws import RIGID
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import (
    CORRECTIONS,
    LOAD_TERMS,
    band_fit,
    body_regressor,
)
from strainwave.errors import NotIdentifiable
from strainwave.identification.rigid.conclusion import Bounded, bound, warnings_of
from strainwave.identification.rigid.drive_gains import estimate_drive_gains, gain_sensitivity
from strainwave.identification.rigid.equations import FurtherTerm, MotorShares, anti_resonances
from strainwave.identification.rigid.filtered_record import decimation, n_compliances, sample_motion
from strainwave.identification.rigid.friction_terms import (
    MAX_POWER_RATIO,
    corrected_motions,
    estimated_terms,
    fit_with_terms,
    insignificant,
    refit,
    term_warning,
    with_coarse_zeros,
    with_delay,
)
from strainwave.identification.rigid.model_choice import (
    ModelChoice,
    candidates_of,
    is_selected,
)
from strainwave.identification.rigid.torque_constants import torque_ratios
from strainwave.identification.rigid.trial import (
    Motion,
    Trial,
    excess_variance,
    fit_trial,
    neighbours,
    prepare_all,
    search_bandwidths,
    select_bandwidth,
    solve,
)
from strainwave.numerics.parallel import one_blas_thread
from strainwave.signals.motor import period_of

__all__ = ["RigidOptions", "estimate_drive_gains", "fit_rigid"]

# alternatives to the motors' usual shares, about one standard deviation away
_ALTERNATIVE_INERTIA_SHARE = 0.3
_ALTERNATIVE_VISCOUS_SHARE = 0.21  # any split is possible: that of a uniform distribution


def fit_rigid(
    signals: Sequence[Signals],
    arm: Arm,
    options: RigidOptions | None = None,
    gains: DriveGains | None = None,
) -> RigidModel:
    """Identify the rigid-joint arm from motion records.

    `signals` has one item per record, from `signals.prepare_motor_signals`. A parameter that the
    data do not determine has the value None, and a warning gives the reason. The covariance
    includes the errors of estimated `gains`, which the arm has. Raises `NotIdentifiable` if there
    is no record or no usable sample.

    Signals with the torsion of all gears need no model of it.
    """
    if not signals:
        raise NotIdentifiable(
            'the rigid step needs a record with use = "motion": slow, smooth motion of all joints'
        )
    with one_blas_thread():  # hundreds of small factorisations: several threads are slower
        if all(s.torsion is not None for s in signals):
            arm = arm.with_joints(replace(joint, spring=RIGID) for joint in arm.joints)
        return _fit(signals, arm, options or RigidOptions(), gains)


def _fit(
    signals: Sequence[Signals], arm: Arm, chosen: RigidOptions, gains: DriveGains | None
) -> RigidModel:
    motions = [(s, period_of(s)) for s in signals]
    trials, candidates = _search(motions, arm, chosen)
    best = plain = select_bandwidth(trials)
    nearby = neighbours(trials, best)
    doubt, noise_share = np.zeros_like(best.covariance), np.ones(1)
    changes: list[dict[str, float]] = []
    if candidates:
        plain, (best, nearby, choice) = _at_best_bandwidth(trials, motions, candidates)
        start, moved = with_coarse_zeros(plain, motions, candidates)
        if start is not plain:
            zeros = [c for c in moved if c.corrected]
            others = [refit(trial, motions, zeros) for trial in neighbours(trials, plain)]
            distant = _with_terms(start, others, motions, moved)
            if distant[0].residual_power < MAX_POWER_RATIO * best.residual_power:
                best, nearby, choice = distant
        doubt, noise_share, changes = choice.model_error(), choice.noise_share(), choice.changes()
        if any(c.effect in LOAD_TERMS for c in best.candidates):
            # other shares of the rotors in inertias, on which the gears' loads depend
            shares = replace(best.estimate.shares, inertia=_ALTERNATIVE_INERTIA_SHARE)
            other = solve(
                best.arm, best.stretches, best.estimate, shares, best.candidates, best.factor.root
            )
            change = other.estimate.solution - best.solution
            doubt += np.outer(change, change)
            of_terms = other.factor.common - best.factor.common
            best = replace(best, common_deviation=np.hypot(best.common_deviation, of_terms))
    excess = excess_variance(best.solution, [(t.solution, np.diag(t.covariance)) for t in nearby])
    # rivals and bandwidths partly show the same error
    excess = np.clip(excess - np.diag(doubt), 0.0, None)
    noise = noise_share * (np.diag(best.covariance) + excess)
    covariance = best.covariance + doubt + np.diag(excess + _elastic_model_error(best))
    fit = Bounded(best, covariance)
    if not n_compliances(arm):  # otherwise the whole-arm fit has the bounds
        fit = bound(best, covariance)
    if gains is not None:
        by_gain = gain_sensitivity(fit.trial, gains)
        by_gains = by_gain @ gains.relative_covariance @ by_gain.T
        fit, noise = replace(fit, covariance=fit.covariance + by_gains), noise + np.diag(by_gains)
    trials = [fit.trial, *nearby]
    further = estimated_terms(trials, fit.trial, changes)
    if plain is best:
        plain = fit.trial
    ratios = torque_ratios(trials, fit.trial, plain)
    fits = {}
    for s in signals:
        band = band_fit(fit.trial.arm, fit.trial.solution, s, fit.trial.bandwidth_hz, further)
        fits[s.experiment.name] = dict(zip(s.torque_channel, band.tolist(), strict=True))
    motion = sample_motion(signals, fit.trial.bandwidth_hz)
    return _model(fit, noise, further, ratios, fits, motion)


def _search(
    motions: Sequence[Motion], arm: Arm, chosen: RigidOptions
) -> tuple[list[Trial], list[FurtherTerm]]:
    """Fits at increasing bandwidths, without a delay of the torques that they show; candidates."""
    if chosen.bandwidth_hz is not None:
        trials = [fit_trial(arm, prepare_all(arm, motions, chosen.bandwidth_hz), None)]
    else:
        trials = search_bandwidths(motions, arm)
    best = select_bandwidth(trials)
    plain = candidates_of(arm, best.stretches)
    candidates = with_delay(best, motions, plain)
    delays = [c for c in candidates if c.corrected]
    if not delays or chosen.bandwidth_hz is not None:
        return trials, candidates
    undelayed = search_bandwidths(corrected_motions(arm, motions, delays), arm)
    best = select_bandwidth(undelayed)
    at_delay = [refit(trial, motions, delays) for trial in (best, *neighbours(undelayed, best))]
    if insignificant(at_delay, at_delay[0].common_deviation):
        return trials, plain
    return undelayed, candidates


def _at_best_bandwidth(
    trials: Sequence[Trial], motions: Sequence[Motion], candidates: Sequence[FurtherTerm]
) -> tuple[Trial, tuple[Trial, list[Trial], ModelChoice]]:
    """Trial without terms, and fits with them, at the best bandwidth of the model with terms.

    Without them, the change of the estimates with the bandwidth favours low bandwidths, at which a
    short record shows no term. Only higher ones are tried, so the iteration ends.
    """
    plain = select_bandwidth(trials)
    while True:
        fits = _with_terms(plain, neighbours(trials, plain), motions, candidates)
        better = select_bandwidth([*fits[1], fits[0]]).bandwidth_hz
        if better <= plain.bandwidth_hz:
            return plain, fits
        plain = next(trial for trial in trials if trial.bandwidth_hz == better)


def _with_terms(
    best: Trial, nearby: list[Trial], motions: Sequence[Motion], candidates: Sequence[FurtherTerm]
) -> tuple[Trial, list[Trial], ModelChoice]:
    """Fits with the terms that the records support, and the choice between them and others.

    A term changes what is left for others: the choice is made again around each fit. A term that a
    fit does not show, or that another replaces, stays out until a fit has more terms, so the
    iteration ends.

    An error of an angle or of a time is the same at all bandwidths. A correction of the signals
    that changes with the bandwidth is another error that resembles it, and no rival.
    """
    fit, others, rest, left_out = best, nearby, list(candidates), set[tuple[str, int]]()
    tested, largest = {c.key for c in candidates if is_selected(best.arm, c)}, 0
    while True:
        choice = ModelChoice.of(fit, rest)
        stds = choice.models.size_stds(range(len(fit.candidates)))
        doubtful = [c for c in insignificant([fit, *others], stds) if c.key in tested]
        if not doubtful and len(fit.candidates) > largest:
            largest = len(fit.candidates)
            left_out.clear()
        corrected = {c.key for c in doubtful if c.effect in CORRECTIONS}
        rest = [c for c in rest if c.key not in corrected]
        terms = [c for c in fit.candidates if c not in doubtful]
        if not doubtful:
            terms = choice.select(left_out)
        before, after = {c.key for c in fit.candidates}, {c.key for c in terms}
        if after == before:
            return fit, others, choice
        left_out |= before - after
        if terms:
            fit = fit_with_terms(_started(best, fit), motions, terms)
            others = [
                refit(_started(plain, each), motions, fit.candidates)
                for plain, each in zip(nearby, others, strict=True)
            ]
        else:
            fit, others = best, nearby
        left_out |= after - {c.key for c in fit.candidates}


def _started(trial: Trial, start: Trial) -> Trial:
    """The trial with the estimate and the weights of another fit of its stretches."""
    return replace(trial, estimate=start.estimate, factor=start.factor)


def _elastic_model_error(best: Trial) -> FloatArray:
    """Variance (n_parameters,) of the error of the first-order compliance model.

    It has two parts: the change of the estimates with the motors' shares of inertias and viscous
    friction, from one half to about one standard deviation away; and the second-order term in
    (w / w_a)^2,
    estimated as the first-order change times (bandwidth / anti-resonance)^2.
    """
    arm = best.arm
    ratio = best.bandwidth_hz / float(np.min(anti_resonances(arm, best.estimate)))
    if ratio == 0.0:
        return np.zeros(len(best.covariance))
    usual, root = MotorShares.usual(arm), best.factor.root
    alternatives = [replace(usual, inertia=_ALTERNATIVE_INERTIA_SHARE)]
    if usual.viscous_friction < 1.0:
        alternatives.append(replace(usual, viscous_friction=_ALTERNATIVE_VISCOUS_SHARE))
    rigid_arm = arm.behind_rigid_gears()
    bodies = (body_regressor(rigid_arm, s.links, s.torsion) for s in best.stretches)
    rigid = tuple(
        replace(s, body=s.filtered(x)) for s, x in zip(best.stretches, bodies, strict=True)
    )
    cases = [(rigid_arm, rigid, usual), *((arm, best.stretches, each) for each in alternatives)]
    rigid_solution, *others = (
        solve(each, stretches, best.estimate, shares, weights=root).estimate.solution
        for each, stretches, shares in cases
    )
    next_order = (best.solution - rigid_solution) * ratio**2
    return np.asarray(next_order**2 + sum((best.solution - other) ** 2 for other in others))


def _model(
    fit: Bounded,
    noise: FloatArray,
    terms: tuple[FrictionTerm, ...],
    ratios: dict[int, tuple[float, float]],
    fit_percent: dict[str, dict[str, float]],
    motion: FloatArray,
) -> RigidModel:
    """Result of a fit; parameters that are not identified are None.

    `noise` (n_parameters,) is the part of the variances that is not model error. `motion` is that
    of `sample_motion`.
    """
    best, covariance = fit.trial, fit.covariance
    identified = best.determined
    variances, width = np.diag(covariance), best.interval_half_width
    model_stds = np.sqrt(np.clip(variances - noise, 0.0, None)).tolist()

    def parameter(k: int) -> Parameter:
        column = best.arm.rigid_columns[k]
        if not identified[k]:
            return Parameter(*column.key, None, None, column.unit, "rigid")
        if k in fit.upper:
            return Parameter.at_zero(column.key, fit.upper[k], column.unit, "rigid")
        value, std = float(best.solution[k]), float(np.sqrt(variances[k]))
        estimate = Parameter.estimated(column.key, value, std, column.unit, "rigid", width)
        return replace(estimate, model_std=model_stds[k])

    parameters = map(parameter, range(len(identified)))
    status: Literal["determined", "partly-determined", "not-identifiable"] = "not-identifiable"
    if identified.any():
        status = "determined" if identified.all() else "partly-determined"
    mask = np.where(identified, 1.0, np.nan)
    return RigidModel(
        parameters=tuple(parameters),
        solution=best.solution,
        covariance=covariance * np.outer(mask, mask),
        condition_number=best.factor.condition_number,
        fit_percent=fit_percent,
        bandwidth_hz=best.bandwidth_hz,
        decimation=max(
            decimation(s.signals.sample_time, best.bandwidth_hz) for s in best.stretches
        ),
        n_rows=len(best.equations.target),
        status=status,
        warnings=(*warnings_of(best, variances), *map(term_warning, terms)),
        torque_ratios=ratios,
        torque_errors=best.torque_errors,
        friction_terms=terms,
        motion=motion,
    )
