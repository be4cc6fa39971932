"""What comes of it all: published claims put to the test, and all that one run learnt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from strainwave.records.answers import Caution, Parameter, Prediction, Suspicion
from strainwave.records.arm import ArmModel
from strainwave.records.joints import JointModel, RecordModel, Sweep
from strainwave.records.rigid import RigidModel
from strainwave.records.statespace import FrequencyResponse
from strainwave.records.study import Study
from strainwave.shown import Shown


@dataclass(frozen=True, slots=True)
class Comparison:
    """One claim of the method, put to the built-in arm whose truth is known."""

    figure: int  # of the source that makes the claim
    title: str
    claim: str  # in one sentence
    holds: bool  # on this arm
    values: Mapping[str, float]  # NaN: there is none
    message: str  # the number that shows it, or why it does not hold
    plots: tuple[dict[str, Any], ...]  # plotly figures; the caption is `layout.meta`


@dataclass(frozen=True, slots=True)
class Identification(Shown):
    """Everything one run learnt: what result.json and the report are made of."""

    study: Study
    created: str  # ISO 8601, UTC
    version: str
    stages: tuple[str, ...]  # those that ran
    rigid: RigidModel | None
    fitted: tuple[Prediction, ...]  # the model on the records it was fitted to
    checks: tuple[Prediction, ...]  # and on the records it never saw
    warnings: tuple[Caution, ...]
    timing_s: Mapping[str, float]
    records: tuple[RecordModel, ...] = ()  # of the joints excited, record by record
    joints: tuple[JointModel, ...] = ()  # all records of a joint at once
    responses: Mapping[int, FrequencyResponse] = field(default_factory=dict)  # by joint
    sweeps: tuple[Sweep, ...] = ()
    tuned: ArmModel | None = None
    suspected: tuple[Suspicion, ...] = ()  # causes of contradictions in the input
    reason: str | None = None  # why the question could not be answered, or not wholly

    @property
    def determined(self) -> bool:
        """Whether every parameter asked for was found."""
        return self.reason is None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The best of each parameter, once.

        What the whole-arm fit tells, which rests on all records and on the rigid model; of the
        other stages' values the one most certain, of equals the later stage's. The arm's own first,
        then joint by joint. One stiffness does not stand beside the three slopes of a curve.
        """
        best: dict[tuple[str, int | None], Parameter] = {}
        for model in (self.rigid, *self.joints):
            for found in model.parameters if model else ():
                earlier = best.get((found.name, found.joint))
                if earlier is None or _deviation(found) <= _deviation(earlier):
                    best[found.name, found.joint] = found
        for found in self.tuned.parameters if self.tuned else ():
            if found.value is not None or (found.name, found.joint) not in best:
                best[found.name, found.joint] = found
        slopes = [best[key] for key in best if key[0] == "gear_stiffness_k1"]
        curved = [slope.joint for slope in slopes if slope.value is not None]
        for joint in curved:
            best.pop(("gear_stiffness", joint), None)
        return tuple(sorted(best.values(), key=lambda p: p.joint or 0))


def _deviation(parameter: Parameter) -> float:
    if parameter.value is None or parameter.std is None:
        return float("inf")
    return parameter.std
