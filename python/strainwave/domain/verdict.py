"""Verdict on a run, shared by exit code, result.json, terminal output and report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from strainwave.domain.arm_model import ArmModel
from strainwave.domain.base_parameters import base_parameters
from strainwave.domain.combinations import is_uncoupled, viscous_friction
from strainwave.domain.consistency import Suspicion
from strainwave.domain.effects import effect_named
from strainwave.domain.estimates import Diagnostic, Prediction
from strainwave.domain.final_table import Decision
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.keys import Key, grouped_labels
from strainwave.domain.messages import Clause, Place, text_of
from strainwave.domain.options import Stage
from strainwave.domain.ranges import size_warnings
from strainwave.domain.stage_results import StageResults

_MAX_LISTED_CAUSES = 3  # in a reason

Status = Literal["determined", "partly-determined", "not-determined", "inconsistent-input"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Validation:
    """Whether validation records excite each model and the model predicts them."""

    rigid: bool
    elastic: bool  # for every joint with an elastic gear


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Verdict on a run, as defined in docs/result.md.

    Reasons say why the status is not "determined", the most important first.
    """

    status: Status
    identified: tuple[Key, ...]
    not_identified: tuple[Key, ...]  # null, or with too wide an interval
    rejected: tuple[Key, ...]  # null because the estimate is invalid
    validated: Validation
    suspected: tuple[Suspicion, ...] = ()
    reason_clauses: tuple[Clause, ...] = ()

    @property
    def reasons(self) -> tuple[str, ...]:
        """Text of the reasons."""
        return tuple(map(text_of, self.reason_clauses))

    @property
    def exit_code(self) -> int:
        """0 if the status is "determined", otherwise 3."""
        return 0 if self.status == "determined" else 3


def compute_verdict(results: StageResults, decisions: Sequence[Decision]) -> Verdict:
    """Compute the verdict on a run, as defined in docs/result.md."""
    stages, primary = _requirements(results)
    keys = {d.parameter.key for d in decisions}
    identified = tuple(d.parameter.key for d in decisions if d.identified)
    rejected = tuple(d.parameter.key for d in decisions if d.rejected)
    undecided = [d.parameter.key for d in decisions if not d.identified and not d.rejected]
    reasons = tuple(_failure_reasons(results, decisions, stages, primary))
    status: Status = "partly-determined" if reasons else "determined"
    if set(identified).isdisjoint(primary):
        status = "not-determined"
    if any(not each.accepted for each in results.suspected):
        status = "inconsistent-input"
    return Verdict(
        status=status,
        identified=identified,
        not_identified=(*undecided, *(key for key in primary if key not in keys)),
        rejected=rejected,
        validated=_validate_models(results),
        suspected=results.suspected,
        reason_clauses=reasons,
    )


def _requirements(results: StageResults) -> tuple[list[Stage], list[Key]]:
    """Required stages among those requested, and the primary parameters that they estimate."""
    study = results.study
    arm, base = study.arm, base_parameters(study.arm)
    elastic = [number for number, joint in enumerate(arm.joints, start=1) if joint.elastic]
    has_motion = any(e.use == "motion" for e in study.experiments)
    is_independent = is_uncoupled(arm) and bool(elastic)
    has_decoupled = bool(elastic) and "decoupled" in results.stages
    stages: list[Stage] = ["rigid"] if has_motion or not (is_independent and has_decoupled) else []
    keys: list[Key] = []
    if stages:
        keys += [column.key for column in base.columns]
    viscous = viscous_friction(arm)
    for number, joint in enumerate(arm.joints, start=1):
        if not joint.torque_at_link:  # a sensor behind the gear does not show the friction
            keys += [(viscous, number), ("motor_coulomb_friction", number)]
    has_whole_arm = "tuned" in results.stages and len(elastic) == arm.n_joints
    is_excited = any(e.use in ("frequency", "sweep") for e in study.experiments)
    if has_decoupled and (is_excited or not has_whole_arm):
        stages.append("decoupled")
    if has_decoupled:
        for number in elastic:
            gear = arm.joints[number - 1].law.names if has_whole_arm else (STIFFNESS,)
            names = ("motor_inertia", "link_inertia", *gear, "gear_damping")
            keys += [(name, number) for name in names]
    if has_whole_arm:
        stages.append("tuned")
    if has_whole_arm and not base.has_groups:
        keys += [key for key in base.effective if key not in base.separate_links]
    return stages, list(dict.fromkeys(keys))


def _failure_reasons(
    results: StageResults,
    decisions: Sequence[Decision],
    stages: Sequence[Stage],
    primary: Sequence[Key],
) -> Iterator[Clause]:
    """Yield the reasons why a run is not determined, most important first."""
    deciding = [each.clause for each in results.suspected if not each.accepted]
    if deciding:  # all other failures may follow from these
        yield from deciding
        return
    yield from results.failures
    yield from _missing_stages(results, stages)
    for defect in model_defects(results):
        yield Clause("defect", places=defect.places, defect=defect.clause)
    sizes = size_warnings(results.study.arm, [decision.parameter for decision in decisions])
    yield from (warning.clause for warning in sizes)
    for test in results.whole_arm.contradictions if results.whole_arm else ():
        size, causes = test.deviations, _likely_causes(results.whole_arm)
        yield Clause("disagreement", deviations=size, subject=test.subject, causes=causes)
    rejected = {d.parameter.key for d in decisions if d.rejected}
    decided = rejected.union(d.parameter.key for d in decisions if d.identified)
    rejected_primary = [key for key in primary if key in rejected]
    if rejected_primary:
        yield Clause("primary/rejected", parameters=grouped_labels(rejected_primary))
    missing = [key for key in primary if key not in decided]
    if missing:
        yield Clause("primary/not-identified", parameters=grouped_labels(missing))


def _likely_causes(whole_arm: ArmModel | None) -> Clause:
    """Plausible effects, the likeliest first, as the end of a sentence."""
    criticism = whole_arm.criticism if whole_arm else None
    causes = tuple(
        Clause(
            "suspect",
            subject=Place(joint=cause.joint, parameter=cause.effect),
            share=cause.share,
            experiment=effect_named(cause.effect).experiment,
        )
        for cause in (criticism.causes if criticism else ())
        if not cause.is_included
    )[:_MAX_LISTED_CAUSES]
    return Clause("suspects", causes=causes) if causes else Clause("suspects/none")


def _missing_stages(results: StageResults, required: Sequence[Stage]) -> Iterator[Clause]:
    elastic = [n for n, j in enumerate(results.study.arm.joints, start=1) if j.elastic]
    fitted = {joint.joint for joint in results.joints}
    if results.failures:
        return  # failures are reported separately; later stages depend on them
    if "rigid" in required and results.rigid is None:
        yield Clause("no-rigid-stage")
    if "decoupled" in required and not fitted.issuperset(elastic):
        yield Clause("no-decoupled-model", joints=tuple(n for n in elastic if n not in fitted))
    if "tuned" in required and results.whole_arm is None:
        yield Clause("no-whole-arm-fit")
    if "tuned" in required and results.whole_arm and not results.whole_arm.end.is_minimum:
        yield Clause("not-converged")


MIN_STIFFNESS_EFFECT = 0.05
"""Smallest change of a validation channel, relative to its standard deviation, if the gear
stiffness rises by 20 %.

A very good prediction has a fit of 95 %. If the change is smaller than the remaining 5 %, a wrong
stiffness would also pass.
"""

MAX_RELATIVE_RESIDUAL = 0.1
"""Residual norm, relative to the centred channel, above which the model is considered defective.

The residual must also be far above the sensor noise.
"""


def _validate_models(results: StageResults) -> Validation:
    """Check whether validation records excite each model and the model predicts them."""
    effects = [effect for effect, _, _ in stiffness_effects(results).values()]
    drives = [check for check in results.checks if check.of_drive]
    has_motion = any(math.isfinite(fit) for check in drives for fit in check.fit_percent.values())
    is_missed = any(check.of_drive and check.unexplained for check in _decisive_checks(results))
    return Validation(
        rigid=has_motion and not is_missed,
        elastic=min(effects, default=0.0) >= MIN_STIFFNESS_EFFECT
        and not any(model_defects(results)),
    )


def stiffness_effects(results: StageResults) -> dict[int, tuple[float, str, str]]:
    """Elastic joint -> its largest stiffness effect in a check record, channel and record."""
    effects = [
        (joint, (effect, channel, check.experiment))
        for check in results.checks
        for joint, by_channel in check.stiffness_effect.items()
        for channel, effect in by_channel.items()
    ]
    return {
        n: max((effect for joint, effect in effects if joint == n), default=(0.0, "", ""))
        for n, joint in enumerate(results.study.arm.joints, start=1)
        if joint.elastic
    }


def _decisive_checks(results: StageResults) -> list[Prediction]:
    """Predictions of validation records that decide whether a model holds.

    The rigid model omits the vibration of elastic gears, so its torques of a record decide only if
    all joints are rigid.
    """
    has_elastic_joints = any(joint.elastic for joint in results.study.arm.joints)
    return [c for c in results.checks if not (c.of_drive and has_elastic_joints)]


def model_defects(results: StageResults) -> Iterator[Diagnostic]:
    """Yield records that the models do not describe.

    Validation records come first, then the fitted record with the largest residual.
    """
    for check in _decisive_checks(results):
        if check.unexplained:
            fits = check.fit_percent
            worst = min(check.unexplained, key=fits.__getitem__)
            cause = "rigid" if check.of_drive else "servo" if check.is_servo_at_fault else "elastic"
            yield Diagnostic(
                "not-predicted",
                Place.in_records(check.experiment),
                cause,
                channel=worst,
                fit=float(fits[worst]),
                ratio=float(check.unexplained[worst]),
            )
    fit = results.whole_arm
    if fit is None or fit.criticism is None:
        return
    residuals = []
    for test in fit.criticism.residuals:
        percent = fit.fit_percent.get(test.experiment, {}).get(test.channel, math.nan)
        relative_residual = 1.0 - 0.01 * percent
        if relative_residual > MAX_RELATIVE_RESIDUAL and test.is_far_above_noise:
            residuals.append((relative_residual, test))
    if residuals:
        ratio, test = max(residuals, key=lambda residual: residual[0])
        yield Diagnostic(
            "not-described",
            Place.in_records(test.experiment),
            channel=test.channel,
            noise_ratio=test.deviation / test.noise,
            share=ratio,
            advice=_likely_causes(results.whole_arm),
        )
