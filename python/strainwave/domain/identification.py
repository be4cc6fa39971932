"""What comes of it all: everything that one run learnt."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from strainwave.display import Displayed
from strainwave.domain.arm_model import ArmModel, MotorResponse, ResidualTest, contradictions
from strainwave.domain.combinations import is_uncoupled, viscous_friction
from strainwave.domain.estimates import Diagnostic, Parameter, Prediction, Suspicion
from strainwave.domain.final_table import Decision, decide
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.joint_models import JointModel, RecordModel, Sweep
from strainwave.domain.kinds import kind_of
from strainwave.domain.linear_models import FrequencyResponse
from strainwave.domain.ranges import implausible_joints
from strainwave.domain.rigid_model import RigidModel
from strainwave.domain.signals import Activity, LinkSummary, Log
from strainwave.domain.study import Study
from strainwave.domain.verdict import Status, Validated, Verdict


@dataclass(frozen=True, slots=True)
class Identification(Displayed):
    """Everything one run learnt: what result.json and the report are made of."""

    study: Study
    created: str  # ISO 8601, UTC
    version: str
    stages: tuple[str, ...]  # those that were asked for
    rigid: RigidModel | None
    fitted: tuple[Prediction, ...]  # the model on the records it was fitted to
    checks: tuple[Prediction, ...]  # and on those kept for validation
    warnings: tuple[Diagnostic, ...]
    timing_s: Mapping[str, float]
    links: tuple[LinkSummary, ...] = ()  # of every joint in every record that excites a gear
    records: tuple[RecordModel, ...] = ()  # of the joints excited, record by record
    joints: tuple[JointModel, ...] = ()  # all records of a joint at once
    responses: Mapping[int, FrequencyResponse] = field(default_factory=dict)  # by joint
    sweeps: tuple[Sweep, ...] = ()
    tuned: ArmModel | None = None
    suspected: tuple[Suspicion, ...] = ()  # causes of contradictions in the input
    failures: tuple[str, ...] = ()  # why stages could not answer, each in one sentence
    motor_responses: tuple[MotorResponse, ...] = ()  # of fast records, where the arm was fitted
    activity: tuple[Activity, ...] = ()  # of each joint in the fitted records
    logs: tuple[Log, ...] = ()  # as read

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """The final table with what was decided of each parameter, and why."""
        return decide(
            self.study, self.rigid, self.joints, self.tuned, self.suspected, self.activity
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The final table: each parameter once, the arm's own first, then joint by joint.

        A later stage's value, and its refusal, win over an earlier stage's.
        """
        return tuple(decision.parameter for decision in self.decisions)

    @property
    def verdict(self) -> Verdict:
        """The verdict by docs/result.md: exit code, status, and why."""
        return verdict_of(self)

    @property
    def determined(self) -> bool:
        """Whether every parameter asked for was identified and nothing speaks against it."""
        return self.verdict.status == "determined"

    @property
    def reason(self) -> str | None:
        """Why the run is not determined, in one sentence; None where it is."""
        return "; ".join(self.verdict.reasons) or None


@dataclass(frozen=True, slots=True)
class _Called:
    """What the requested stages and the study's springs call for."""

    stages: tuple[str, ...]
    primary: tuple[str, ...]  # labels, as in the verdict


def verdict_of(found: Identification) -> Verdict:
    """The verdict on a run, by docs/result.md.

    Parameters
    ----------
    found : Identification

    Returns
    -------
    Verdict
    """
    decisions = found.decisions
    called = _called_for(found)
    known = {d.parameter.label for d in decisions}
    identified = tuple(d.parameter.label for d in decisions if d.identified)
    rejected = tuple(d.parameter.label for d in decisions if d.rejected)
    open_ones = [d.parameter.label for d in decisions if not d.identified and not d.rejected]
    not_identified = (*open_ones, *(label for label in called.primary if label not in known))
    reasons = tuple(_reasons(found, called, identified, rejected))
    primary = [label for label in called.primary if label in identified]
    status: Status = "partly-determined" if reasons else "determined"
    if not primary:
        status = "not-determined"
    if found.suspected:
        status = "inconsistent-input"
    return Verdict(
        status=status,
        identified=identified,
        not_identified=not_identified,
        rejected=rejected,
        validated=_validated(found),
        suspected=found.suspected,
        reasons=reasons,
    )


def _called_for(found: Identification) -> _Called:
    """Stages that the study needs of those requested, and the primary parameters these answer."""
    study = found.study
    arm, kind = study.arm, kind_of(study.arm)
    elastic = [number for number, joint in enumerate(arm.joints, start=1) if joint.elastic]
    motion = any(e.use == "motion" for e in study.experiments)
    alone = is_uncoupled(arm) and bool(elastic)
    fast = bool(elastic) and "decoupled" in found.stages
    stages = ["rigid"] if motion or not (alone and fast) else []
    names: list[str] = []
    if stages:
        names += kind.primary
        if arm.gravity is not None:
            names += [f"gravity_torque_{i}" for i in range(1, arm.n_joints + 1)]
    viscous = viscous_friction(arm)
    for number in range(1, arm.n_joints + 1):
        names += [f"{viscous} {number}", f"motor_coulomb_friction {number}"]
    whole = "tuned" in found.stages and len(elastic) == arm.n_joints
    excited = any(e.use in ("frequency", "sweep") for e in study.experiments)
    if fast and (excited or not whole):
        stages.append("decoupled")
    if fast:
        for number in elastic:
            inertias = [f"motor_inertia {number}", f"link_inertia {number}"]
            gear = arm.joints[number - 1].law.names if whole else (STIFFNESS,)
            names += inertias + [f"{name} {number}" for name in (*gear, "gear_damping")]
    if whole:
        stages.append("tuned")
        names += kind.primary_of_all
    return _Called(tuple(stages), tuple(dict.fromkeys(names)))


def _reasons(
    found: Identification, called: _Called, identified: Sequence[str], rejected: Sequence[str]
) -> Iterator[str]:
    """Why a run is not determined, the most important first."""
    if found.suspected:  # whatever else is missing follows from these
        yield from (suspicion.message for suspicion in found.suspected)
        return
    yield from found.failures
    yield from _stages_missing(found, called)
    yield from (f"{defect.where}: {defect.message}" for defect in model_defects(found))
    yield from (size.text for size in implausible_joints(found.study.arm, found.parameters))
    if found.tuned is not None:
        yield from _contradictions(found.tuned)
    wrong = [label for label in called.primary if label in rejected]
    if wrong:
        yield f"rejected: {', '.join(wrong)}"
    missing = [name for name in called.primary if name not in identified and name not in wrong]
    if missing:
        yield f"not identified: {', '.join(missing)}"


def _contradictions(tuned: ArmModel) -> Iterator[str]:
    """On what the stages disagree, and the likely causes with the experiments that tell."""
    for test in contradictions(tuned.agreement):
        text = f"the stages disagree by {test.deviations:.2g} standard deviations on {test.subject}"
        yield f"{text}{_causes(tuned)}"


def _causes(tuned: ArmModel | None) -> str:
    """The likely causes of what a fit does not explain, as the end of a sentence."""
    causes = ", or ".join(each.text for each in tuned.suspects) if tuned else ""
    if not causes:
        return ", so check the constants in the study"
    return f", likely causes in this order: {causes}"


def _stages_missing(found: Identification, called: _Called) -> Iterator[str]:
    elastic = [n for n, j in enumerate(found.study.arm.joints, start=1) if j.elastic]
    fitted = {joint.joint for joint in found.joints}
    if found.failures:
        return  # a stage that failed has said so, and those after it follow
    if "rigid" in called.stages and found.rigid is None:
        yield "the rigid stage was not reached"
    if "decoupled" in called.stages and not fitted.issuperset(elastic):
        names = ", ".join(str(n) for n in elastic if n not in fitted)
        yield f"the decoupled stage gave no model of joint {names}"
    if "tuned" in called.stages and found.tuned is None:
        yield "the whole-arm fit was not reached"
    if "tuned" in called.stages and found.tuned and found.tuned.status == "iteration-limit":
        yield "the whole-arm fit did not converge"


MIN_STIFFNESS_EFFECT = 0.05
"""Change of a channel, in its spreads, that a fifth more stiffness must make in validation data.

A very good prediction has a fit of 95 %: where the effect is smaller, a stiffness far off would
pass as well.
"""

MAX_RESIDUAL = 0.1
"""Share of a channel's spread from which its residuals are a defect of the model, if they are also
far above the sensor's noise."""


def _validated(found: Identification) -> Validated:
    """Whether check records exercised each model, and it predicts them."""
    elastic = {n for n, joint in enumerate(found.study.arm.joints, start=1) if joint.elastic}
    drives = [check for check in found.checks if check.of_drive]
    motions = [check for check in found.checks if not check.of_drive]
    shown = {
        number
        for check in motions
        for number, effect in check.stiffness_effect.items()
        if effect >= MIN_STIFFNESS_EFFECT
    }
    moving = any(math.isfinite(fit) for check in drives for fit in check.fit_percent.values())
    return Validated(
        rigid=moving and not any(check.unexplained for check in drives),
        elastic=bool(elastic)
        and shown >= elastic
        and not any(check.unexplained for check in motions)
        and _worst_residual(found) is None,
    )


def model_defects(found: Identification) -> Iterator[Diagnostic]:
    """Records that the models do not describe: check records first, then the worst fitted one."""
    for check in found.checks:
        if check.unexplained:
            yield Diagnostic("not-predicted", check.experiment, _not_predicted(found, check))
    worst = _worst_residual(found)
    if worst is not None:
        share, test = worst
        text = (
            f"the residuals of {test.channel} are {test.deviation / test.noise:.2g} times the"
            f" sensor's noise and {100.0 * share:.2g} % of the signal, so the model does not"
            f" describe the record{_harder_spring(found) or _causes(found.tuned)}"
        )
        yield Diagnostic("not-described", test.experiment, text)


def _not_predicted(found: Identification, check: Prediction) -> str:
    """What is wrong with the worst channel of a check record, and what to do."""
    channel = min(check.unexplained, key=lambda name: check.fit_percent[name])
    text = (
        f"{channel} is predicted with a fit of {check.fit_percent[channel]:.3g} %, an error of"
        f" {check.unexplained[channel]:.2g} times what noise, friction, the intervals and the"
        " residuals of the fit explain"
    )
    if check.of_drive:
        return f"{text}, so check the payload, the voltage and the friction of that record"
    if check.is_servo_at_fault:
        return (
            f"{text}, but the recorded voltages explain the motion, so correct kp, ki, period and"
            " limit of [servo], or the references of that record"
        )
    spring = _harder_spring(found)
    return f"{text}{spring or ', so check [servo], the references and the payload of that record'}"


def _worst_residual(found: Identification) -> tuple[float, ResidualTest] | None:
    """The largest residual that is far above the noise, as a share of the signal."""
    if found.tuned is None or found.tuned.criticism is None:
        return None
    far = []
    for test in found.tuned.criticism.residuals:
        fit = found.tuned.fit_percent.get(test.experiment, {}).get(test.channel, math.nan)
        share = 1.0 - 0.01 * fit
        if share > MAX_RESIDUAL and test.is_far_above_noise:
            far.append((share, test))
    return max(far, key=lambda one: one[0], default=None)


def _harder_spring(found: Identification) -> str:
    """What to do if a gear hardens with the amplitude that the study has as linear; else empty."""
    bent = [
        sweep.joint
        for sweep in found.sweeps
        if sweep.verdict == "hardening"
        and not found.study.arm.joints[sweep.joint - 1].law.is_curved
    ]
    if not bent:
        return ""
    joints = " and ".join(str(number) for number in bent)
    return f', and the sweep of joint {joints} shows hardening: give it spring = "three-slope"'
