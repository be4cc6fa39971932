"""Result of one run: the results of all stages, with the conclusions from them.

The conclusions are the final table, the warnings, and the verdict that exit code, result.json,
terminal and report share.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from strainwave.display import Displayed
from strainwave.domain.arm.base_parameters import base_parameters
from strainwave.domain.arm.combinations import is_uncoupled, viscous_friction
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.keys import Key, grouped_labels
from strainwave.domain.messages import Clause, Place, merge_clauses, text_of
from strainwave.domain.results.arm_model import ArmModel
from strainwave.domain.results.consistency import Suspicion
from strainwave.domain.results.estimates import Diagnostic, Parameter, Prediction, size_warnings
from strainwave.domain.results.final_table import Decision, decide
from strainwave.domain.results.stage_results import StageResults
from strainwave.domain.study import Stage

_MAX_LISTED_CAUSES = 3  # in a reason

Status = Literal["determined", "partly-determined", "not-determined", "inconsistent-input"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification(StageResults, Displayed):
    """Result of one run; result.json and the report are rendered from it.

    The conclusions from the results of the stages are computed once, at construction.
    """

    created: str  # ISO 8601, UTC
    version: str
    timing_s: Mapping[str, float]
    decisions: tuple[Decision, ...] = field(init=False)  # the final table, each with its reason
    verdict: Verdict = field(init=False)
    warnings: tuple[Diagnostic, ...] = field(init=False)  # that apply to the final table

    def __post_init__(self) -> None:
        """Draw the conclusions."""
        decisions = decide(self)
        verdict = compute_verdict(self, decisions)
        object.__setattr__(self, "decisions", decisions)
        object.__setattr__(self, "verdict", verdict)
        object.__setattr__(self, "warnings", published_warnings(self, decisions, verdict))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The final table: parameters of the whole arm first, then joint by joint.

        The latest stage that estimates a parameter decides it.
        """
        return tuple(decision.parameter for decision in self.decisions)

    @property
    def reason(self) -> str | None:
        """Reasons why the run is not determined, in one sentence; None if it is determined."""
        return "; ".join(self.verdict.reasons) or None


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
    gears: list[Key] = [(STIFFNESS, number) for number in elastic]
    if arm.position_servo is not None:
        elastic = []  # all stages are one fit
    has_motion = any(e.use == "motion" for e in study.experiments)
    is_independent = is_uncoupled(arm) and bool(elastic)
    has_decoupled = bool(elastic) and "decoupled" in results.stages
    stages: list[Stage] = ["rigid"] if has_motion or not (is_independent and has_decoupled) else []
    keys: list[Key] = []
    if stages:
        keys += [column.key for column in base.columns]
    viscous = viscous_friction(arm) if arm.position_servo is None else "servo_damping"
    for number, joint in enumerate(arm.joints, start=1):
        if not joint.torque_at_link:  # a sensor behind the gear does not show the friction
            keys += [(viscous, number), ("motor_coulomb_friction", number)]
    keys += gears if arm.position_servo is not None else []
    has_whole_arm = "tuned" in results.stages and bool(elastic) and len(elastic) == arm.n_joints
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
    has_servo = results.study.arm.position_servo is not None
    drives = [check for check in results.checks if check.of_drive or has_servo]
    has_motion = any(math.isfinite(fit) for check in drives for fit in check.fit_percent.values())
    decisive = _decisive_checks(results)
    is_missed = any((check.of_drive or has_servo) and check.unexplained for check in decisive)
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


_STAGE_CODES = frozenset({"not-identifiable", "implausible", "equivalent-stiffness"})
"""Codes of warnings about one parameter in one stage."""


def published_warnings(
    results: StageResults, decisions: Sequence[Decision], verdict: Verdict
) -> tuple[Diagnostic, ...]:
    """Collect the warnings of a run, one for each cause.

    A warning about a parameter is omitted if a later stage decides that parameter. It remains in
    the warnings of its stage. Each reason for rejection has one warning.
    """
    warnings = [*_current_warnings(results, decisions), *rejection_warnings(decisions)]
    defects = tuple(model_defects(results))
    warnings += defects
    checks = results.checks
    for channel in dict.fromkeys(name for check in checks for name in check.channels):
        fits = {c.experiment: c.fit_percent[channel] for c in checks if channel in c.channels}
        if not any(map(math.isfinite, fits.values())):  # it has no fit in any check record
            places = tuple(map(Place.in_records, fits))
            warnings.append(Diagnostic("nothing-to-predict", places, "rest", channel=channel))
    warnings += size_warnings(results.study.arm, [d.parameter for d in decisions])
    if results.whole_arm is not None and not verdict.validated.elastic and not defects:
        warnings.append(missing_validation(results))
    return merge_by_cause(dict.fromkeys(warnings))


def rejection_warnings(decisions: Iterable[Decision]) -> Iterator[Diagnostic]:
    """Yield one warning for each reason for rejection, with the rejected values."""
    by_reason: dict[Clause, list[Decision]] = {}
    for decision in decisions:
        if decision.rejected:
            by_reason.setdefault(decision.rejected, []).append(decision)
    for reason, rows in by_reason.items():
        values = tuple(
            Clause("rejected-value", label=d.parameter.label, value=d.raw)
            for d in rows
            if d.raw is not None
        )
        joints = sorted({d.parameter.joint or 0 for d in rows})
        places = tuple(Place(joint=number) for number in joints)
        if 0 in joints:
            places = (Place(part="arm"),)
        if len(rows) == 1:
            places = (_place_of(rows[0].parameter),)
        yield Diagnostic("rejected", places, reason=reason, values=values)


def missing_validation(results: StageResults) -> Diagnostic:
    """Warn why the elastic model is not validated, and what to record."""
    defects = [Clause("defect", places=d.places, defect=d.clause) for d in model_defects(results)]
    reasons = {
        "no-fit": results.whole_arm is None,
        "defect": bool(defects),
        "no-check": all(e.use != "check" for e in results.study.experiments),
        "no-effect": True,
    }
    reason = next(name for name, holds in reasons.items() if holds)
    place = Place(file=str(results.study.path))
    clauses = {"defects": tuple(defects), "unused": tuple(_unused_checks(results))}
    return Diagnostic("elastic-not-validated", place, reason, **clauses)


def _unused_checks(results: StageResults) -> Iterator[Clause]:
    """Yield check records that are not simulated, and gears that no other check record loads."""
    simulated = {check.experiment for check in results.checks if not check.of_drive}
    records_by_reason: dict[str, list[str]] = {}
    for experiment in results.study.experiments:
        if experiment.use == "check" and experiment.name not in simulated:
            reason = results.not_simulated.get(experiment.name, "a defect of the data")
            records_by_reason.setdefault(reason, []).append(experiment.name)
    for reason, records in records_by_reason.items():
        yield Clause("check/not-simulated", records=tuple(records), reason=reason)
    for joint, (effect, channel, record) in stiffness_effects(results).items():
        if simulated and not channel:
            yield Clause("check/rest", joint=joint)
        elif simulated and effect < MIN_STIFFNESS_EFFECT:
            yield Clause(
                "check/insensitive",
                joint=joint,
                channel=channel,
                record=record,
                effect=effect,
                limit=MIN_STIFFNESS_EFFECT,
            )


def merge_by_cause(warnings: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Merge warnings about several records with the same cause into one.

    Two warnings have the same cause if they differ only in measurements; the merged warning has
    the range of each. Only warnings whose place is one record, or one joint in one record, are
    merged. The order is that of the first warning of each cause.
    """
    groups: dict[Diagnostic | tuple[str, Clause], list[Diagnostic]] = {}
    for warning in warnings:
        is_of_record = warning.place is not None and warning.place.is_one_record
        cause = (warning.code, warning.clause.shape) if is_of_record else warning
        groups.setdefault(cause, []).append(warning)
    merged = []
    for group in groups.values():
        places = tuple(dict.fromkeys(place for each in group for place in each.places))
        merged.append(group[0])
        if len(group) > 1 and len(places) > 1:
            clause = merge_clauses([each.clause for each in group])
            merged[-1] = Diagnostic.of(group[0].code, places, clause)
    return tuple(merged)


def _current_warnings(results: StageResults, decisions: Sequence[Decision]) -> Iterator[Diagnostic]:
    """Yield all warnings except those about parameters that a later stage decides."""
    decision_by_place = {_place_of(d.parameter): d for d in decisions}
    tuned_warnings = set(results.whole_arm.warnings) if results.whole_arm is not None else set()
    for warning in results.stage_warnings:
        if warning.code in _STAGE_CODES and warning not in tuned_warnings:
            decision = decision_by_place.get(warning.place) if warning.place else None
            if decision is None:  # the whole-arm fit has a stiffness curve instead
                is_stiffness = warning.place is not None and warning.place.parameter == STIFFNESS
                is_superseded = results.whole_arm is not None and is_stiffness
            else:
                has_value = decision.parameter.value is not None
                is_superseded = decision.parameter.stage == "tuned"
                is_superseded = is_superseded or (warning.code == "not-identifiable" and has_value)
            if is_superseded:
                continue
        yield warning


def _place_of(p: Parameter) -> Place:
    return Place(joint=p.joint, parameter=p.name)
