"""Competition of hypotheses about the torques of all joints on held-out stretches.

Continuous changes are found by Gauss-Newton steps of the fit of `torque_fit`, in which the
parameters of the links are eliminated (Kaufman's variable projection). A hypothesis explains the
torques if it predicts stretches that it was not fitted to better than the stated description does.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.input_check.evidence import Evidence, is_slow
from strainwave.input_check.hypothesis import Hypothesis
from strainwave.input_check.torque_fit import (
    N_LINK_PARAMETERS,
    FitQuality,
    TorqueFit,
    TorqueSystem,
    fit_torques,
    predict_stretches,
    torque_system,
    with_friction_laws,
)
from strainwave.input_check.torque_hypotheses import (
    N_FRAME_COORDINATES,
    HypothesisFamily,
    all_frames,
    exchanged_joints,
    propose_discrete,
    propose_families,
)
from strainwave.input_check.torque_rows import torque_rows
from strainwave.numerics.parallel import run_parallel

# Steps of the numerical derivatives, in prior standard deviations.
_DERIVATIVE_STEP = 1e-4
# Largest Gauss-Newton step, in prior standard deviations.
_MAX_STEP, _MAX_STEPS = 2.0, 8
# Mean unexplained share above which a search ends after the given number of steps.
_N_TRIAL_STEPS, _MAX_TRIAL_UNEXPLAINED = 3, 0.3
# Unexplained share of one torque above which exchanges of joints are tried.
_MAX_UNEXPLAINED = 0.25
# Decrease of the cost per independent row of the fit below which a change is not used to predict,
# no search is started, and a search ends.
_MIN_DECREASE_TO_PREDICT, _MIN_PREDICTED_DECREASE, _MIN_DECREASE = 0.03, 0.02, 2e-3
# Probability of the gain by chance, for all hypotheses together; and the gain of half the
# unexplained variance of one torque, which no hypothesis about a sound log reaches, with the
# difference of the log likelihoods that it needs in a short log: exp(-12) for each of 160.
_MAX_CHANCE, _LARGE_GAIN, _MIN_LOG_LIKELIHOOD = 1e-3, float(np.log(2.0)), 12.0
# Probability by chance of a large gain; but for a torque in another unit, whose size lets it
# determine the parameters of its own joint alone, and for a delay that one joint shows.
_MAX_CHANCE_OF_LARGE = 0.01
# Share of the errors of rigid links that looks like a delay: gears and friction delay the torques
# of a sound log by up to this share of the delay that would explain all errors.
_LAGGING_SHARE = 0.5
# Log ratio of unexplained variances from which a hypothesis is listed: of a change with one
# coordinate, whose size is tested as well; and of other changes.
_MIN_GAIN_OF_COORDINATE, _MIN_GAIN = 0.1, float(np.log(1.3))
_MEASURED = ("ratio", "zero", "torque", "delay")
# Delay [s] below which it gains as much as changes of other sizes: torques of measured arms are up
# to 13 ms early, because gears wind up and loggers lose cycles.
_USUAL_DELAY = 0.015
# Share of the largest gain of a joint, or of the gains of all, that another joint may lose.
_MAX_LOSS = 0.25
# Reduction of a step that does not decrease the cost, and the shortest fraction that is tried.
_STEP_REDUCTION, _MIN_STEP_FRACTION = 0.4, 0.1
# Smallest predicted unexplained share, for the logarithm.
_MIN_UNEXPLAINED = 1e-6


def search_explanations(evidence: Evidence) -> tuple[Hypothesis, ...] | None:
    """Other explanations of the torques that predict held-out stretches better, the best first.

    None without torques; empty if a change of a tolerated size explains them as well.
    """
    slow = tuple(record for record in evidence.records if is_slow(record.experiment))
    evidence.cache.state(evidence.arm, slow)
    evidence = replace(evidence, records=slow)
    system = torque_system(evidence)
    if system is None:
        return None
    search = _FaultSearch(evidence, system, fit_torques(system), predict_stretches(system))
    simple = [*propose_discrete(evidence, search.doubtful_records())]
    families = search.families()
    jobs = [partial(search.discrete, each) for each in simple]
    jobs += [partial(search.continuous, *each) for each in families]
    tried = [*simple, *(family.change(np.zeros(len(family.tolerated))) for family, _ in families)]
    found = [each for each in run_parallel(jobs) if each is not None]
    if found or search.fit.unexplained.max() > _MAX_UNEXPLAINED:
        exchanges = [*exchanged_joints(evidence)]
        tried += exchanges
        jobs = [partial(search.discrete, each) for each in exchanges]
        found += [each for each in run_parallel(jobs) if each is not None]
    # a quarter turn, proposed and estimated, is one explanation
    found = [
        *{(each.excluded, each.corrections or each.kind): each for each in found[::-1]}.values()
    ]
    # each kind of explanation has the same share of the probability, whatever their number
    n_tried = Counter((each.kind, bool(each.excluded)) for each in tried)
    limits = {group: _MAX_CHANCE / len(n_tried) / n for group, n in n_tried.items()}
    if not any(_is_evident(each, limits[each.kind, bool(each.excluded)]) for each in found):
        return ()
    found.sort(key=lambda each: each.cost)
    best = next(each for each in found if _is_evident(each, _MAX_CHANCE))
    rivals = [  # the same fault at another place is as likely, evident or not
        a
        for a in found
        if _is_evident(a, _MAX_CHANCE) or (a.kind == best.kind and a.is_as_good(best))
    ]
    if any(each.is_tolerated and each.is_as_good(best) for each in rivals):
        return ()
    # friction of load and direction is no fault: the fit selects it by itself
    friction = predict_stretches(with_friction_laws(evidence, system, search.fit.links))
    if friction.gain(search.stated).mean > max(each.gain.mean for each in rivals if each.gain):
        return ()
    return tuple(each for each in rivals if not each.is_tolerated)


def _is_evident(each: Hypothesis, limit: float) -> bool:
    """Whether the gain is not one of chance, of a probability below `limit`, or large.

    What acts on all joints must gain much on all torques together; a load, whose many parameters
    follow the friction of a joint, by no chance and much on one torque at least.
    """
    if each.gain is None:
        return False
    most, is_rare = float(each.gain.by_joint.max()), each.gain.probability < limit
    is_of_all = each.kind == "payload" or len(each.joints) > 2
    is_common = each.code == "wrong-unit" or (each.kind == "delay" and each.gain.mean < _MIN_GAIN)
    max_chance = _MAX_CHANCE if is_common else _MAX_CHANCE_OF_LARGE
    is_large = (
        (each.gain.mean if is_of_all else most) > _LARGE_GAIN
        and 0.5 * each.gain.n_rows * each.gain.mean > _MIN_LOG_LIKELIHOOD
        and each.gain.probability < max_chance
    )
    return is_large or (is_rare and (each.kind != "payload" or most > _LARGE_GAIN))


@dataclass(frozen=True, slots=True)
class _FaultSearch:
    """The stated description and its fit, which explanations are compared with."""

    evidence: Evidence
    system: TorqueSystem
    fit: TorqueFit
    stated: FitQuality

    def discrete(self, each: Hypothesis) -> Hypothesis | None:
        """The hypothesis with its gain; None if it is no clear one."""
        record = each.excluded[0] if each.excluded else ""
        changed = self.evidence.corrected_in(record, each.corrections)
        loaded = record if each.kind == "payload" else ""
        system = torque_system(changed, loaded, each.excluded if each.kind == "locked" else ())
        stated = self.system
        if system is None:
            return None
        if each.kind == "exchange" and system.joints == stated.joints:
            # errors relative to the stated torques: a large one in the place of a small one has a
            # smaller share of the same error
            system = replace(system, total=stated.total * system.n_rows / stated.n_rows)
        # of two records, either can be the one with the load
        is_one = len({r.experiment.name for r in self.evidence.records}) > 2
        fit = fit_torques(system)
        if self.fit.cost - fit.cost < _MIN_DECREASE_TO_PREDICT * self.fit.n_all:
            return None
        if loaded and is_one and len(fit.links) >= 2 * N_LINK_PARAMETERS:
            load = fit.links[-N_LINK_PARAMETERS:]  # the last parameters of a system with one
            if load[[4, 6, 9]].sum() < 0.0:  # the trace of its inertia
                return None
        return self._gaining(each, predict_stretches(system), _MIN_GAIN, is_pooled=False)

    def families(self) -> list[tuple[HypothesisFamily, FloatArray]]:
        """Families with their derivatives at the stated description, and that of all frames."""
        families = [*propose_families(self.evidence)]
        jobs = [partial(self._slope, f, np.zeros(len(f.tolerated)), self.fit) for f in families]
        pairs = [*zip(families, run_parallel(jobs), strict=True)]
        frames = [slope for family, slope in pairs if len(family.tolerated) == N_FRAME_COORDINATES]
        return [*pairs, (all_frames(self.evidence), np.hstack(frames))] if frames else pairs

    def continuous(self, family: HypothesisFamily, slope: FloatArray) -> Hypothesis | None:
        """Gauss-Newton search of one family; None without clear gain.

        The coordinates are fitted anew to the other stretches of each stretch, to first order.
        `slope` has the derivatives at the stated description.
        """
        size = len(family.tolerated)
        x, system, fit = np.zeros(size), self.system, self.fit
        for k in range(_MAX_STEPS):
            if k == _N_TRIAL_STEPS and np.exp(2.0 * fit.cost / fit.n_all) > _MAX_TRIAL_UNEXPLAINED:
                return None
            projected = fit.project(slope)
            curvature = projected.T @ projected + np.eye(size)  # of the prior
            step = np.linalg.solve(curvature, projected.T @ fit.residual - x)
            # the criterion of Schwarz
            penalty = 0.5 * size * float(np.log(fit.n_all)) / fit.n_all
            if k == 0 and self._decrease(projected @ step) - penalty < _MIN_PREDICTED_DECREASE:
                return None
            fraction = min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-12))
            before = fit.cost
            while fraction > _MIN_STEP_FRACTION:
                change = family.change(x + fraction * step)
                tried = torque_system(self.evidence.corrected(change.corrections))
                if tried is not None and (trial := fit_torques(tried)).cost < fit.cost:
                    x, system, fit = x + fraction * step, tried, trial
                    slope = self._slope(family, x, fit)
                    break
                fraction *= _STEP_REDUCTION
            if before - fit.cost < _MIN_DECREASE * fit.n_all:
                break
        found = family.change(x, is_final=True)
        # a scale changes the torque itself, not its explanation
        quality = predict_stretches(system, fitted=None if found.kind == "torque" else (x, slope))
        is_tolerated = bool(np.all(np.abs(x) < family.tolerated))
        # a torque constant is at best as accurate as those of the other joints
        is_accurate = np.all(CI95_STDS * quality.coordinate_std <= family.tolerated)
        if found.kind == "delay":  # of errors of the model
            own = np.any(slope, axis=1)
            error = np.linalg.norm(fit.residual[own]) / np.linalg.norm(fit.project(slope)[own])
            is_accurate &= _LAGGING_SHARE * error <= family.tolerated[0]
        if found.code == "wrong-torque-constant" or not is_accurate:
            found = found.as_estimate()
        found = replace(found, is_tolerated=is_tolerated, n_coordinates=size)
        is_usual = found.delay_s is not None and abs(found.delay_s) < _USUAL_DELAY
        is_measured = found.kind in _MEASURED and not is_usual
        least = _MIN_GAIN_OF_COORDINATE if is_measured else _MIN_GAIN
        return self._gaining(found, quality, least, is_pooled=True)

    def _decrease(self, change: FloatArray) -> float:
        """Decrease of the cost per row if weighted torques (n_rows,) are explained as well."""
        residuals = self.fit.residual, self.fit.residual - change
        before, after = (np.bincount(self.system.joint, r**2) for r in residuals)
        decrease = np.log(before / np.maximum(after, _MIN_UNEXPLAINED * before))
        return 0.5 * float(np.average(decrease, weights=self.fit.n_rows))

    def doubtful_records(self) -> list[str]:
        """Records without which the stretches of the others are predicted clearly better.

        Also the one with the largest errors in any torque relative to the others.
        """
        system, names = self.system, np.array(self.system.records)
        doubtful, excess = [], {}
        tiny = np.finfo(float).tiny
        for name in dict.fromkeys(system.records) if len(set(system.records)) > 1 else ():
            kept = names != name
            others = predict_stretches(system, names[~kept].tolist())
            before, after = (q.shares[kept].sum(axis=0) + tiny for q in (self.stated, others))
            if np.max(np.log(before / after)) > _MIN_GAIN:
                doubtful.append(name)
            rows = self.stated.rows
            errors = self.stated.shares[~kept].sum(axis=0) / (rows[~kept].sum(axis=0) + tiny)
            excess[name] = float(np.max(errors * rows[kept].sum(axis=0) / before))
        if excess and (worst := max(excess, key=lambda name: excess[name])) not in doubtful:
            doubtful.append(worst)
        return doubtful

    def _gaining(
        self, each: Hypothesis, quality: FitQuality, least: float, *, is_pooled: bool
    ) -> Hypothesis | None:
        """The hypothesis with its gain; None if it gains too little, or all or one torque loses.

        All torques gain at least `least` together if `is_pooled`, otherwise one does.
        """
        if quality.shares.shape[1] != self.stated.shares.shape[1]:
            return None  # a torque is compared in one of the two only
        gain = quality.gain(self.stated)
        if each.kind == "exchange":  # their errors change places as well
            pair = np.isin(self.system.joints, list(each.joints))
            by_joint = np.where(pair, gain.by_joint[pair].mean(), gain.by_joint)
            gain = replace(gain, by_joint=by_joint)  # the mean is of the torques as they are
        best, worst = float(gain.by_joint.max()), float(gain.by_joint.min())
        is_enough = gain.mean > 0.0 and (gain.mean if is_pooled else best) >= least
        if not is_enough or worst < -_MAX_LOSS * max(best, float(gain.by_joint.sum())):
            return None
        return replace(each, gain=gain, cost=quality.cost)

    def _slope(self, family: HypothesisFamily, x: FloatArray, fit: TorqueFit) -> FloatArray:
        """Derivatives (n_rows, size) of the torques that the links of the fit at x leave, negated.

        They are what the coordinates explain.
        """

        def leave(at: FloatArray) -> FloatArray:
            changed = self.evidence.corrected(family.change(at).corrections)
            rows = torque_rows(changed, fit.links)
            return np.concatenate([x.remainder(x.torque - x.of_links[:, 0]) for x in rows])

        here = fit.residual / fit.weight
        changes = [here - leave(x + _DERIVATIVE_STEP * unit) for unit in np.eye(len(x))]
        return np.column_stack(changes) / _DERIVATIVE_STEP
