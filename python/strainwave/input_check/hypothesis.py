"""Hypotheses: single faults of the input, with the corrections that remove them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import Clause, Correction, Place, Relation, Study, Suspicion, channel_parts
from strainwave.domain.keys import JointNumber
from strainwave.domain.results.consistency import exchange_corrections, steps_of
from strainwave.input_check.evidence import Evidence
from strainwave.input_check.sensors import LINK_CHANNELS, estimate_rotation_factors
from strainwave.input_check.torque_fit import Gain

MIN_SHARE_OF_GAIN = 0.6
"""Share of the best gain from which a simpler explanation is as good as the best one.

Changes with many coordinates gain more, since they absorb model errors as well."""

Unit = str | Clause
"""Name of a unit, as text or with its values."""

# Maximum relative difference between an estimated reduction and a whole number.
_REDUCTION_TOLERANCE = 0.01

STEPS = Clause("remedy")
"""Remedy that consists of the corrections alone."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A fault of the input: how it changes the logs or the study, and how it is worded."""

    code: str
    clause: Clause
    corrections: tuple[Correction, ...] = ()
    remedy: Clause = STEPS
    alternative: tuple[Correction, ...] = ()  # equally likely corrections
    at: tuple[Place, ...] = ()  # empty: the places of the corrections
    factor: float | None = None
    delay_s: float | None = None
    has_estimated_factor: bool = False  # not a unit, a sign or an exchange
    moves_frames: bool = False
    is_fitted: bool = False  # the fit estimates it: no reason to stop
    is_undecided: bool = False  # no value to obey: a rival is as likely, or it is inaccurate
    excluded: tuple[str, ...] = ()  # records with the fault; the others do not have it
    rivals: tuple[Hypothesis, ...] = ()  # that explain the contradictions equally well
    # of the torques alone
    kind: str = ""  # hypotheses of one kind share the probability of a gain by chance
    n_coordinates: int = 0  # estimated from the torques
    is_tolerated: bool = False  # of a size within which a study is accepted
    gain: Gain | None = None  # over the stated description, on held-out stretches
    cost: float = np.inf  # half the mean logarithm of the unexplained shares

    @property
    def places(self) -> tuple[Place, ...]:
        """Channels, records and keys that the fault concerns."""
        return self.at or tuple(dict.fromkeys(map(_place_of, self.corrections)))

    @property
    def joints(self) -> set[JointNumber]:
        """Joints of the channels that the fault concerns."""
        return {channel_parts(p.channel)[1] for p in self.places if p.channel is not None}

    def is_as_good(self, best: Hypothesis) -> bool:
        """Whether it gains most of what the best hypothesis gains."""
        if self.gain is None or best.gain is None:
            return False
        return self.gain.mean >= MIN_SHARE_OF_GAIN * best.gain.mean

    def corrected(self, evidence: Evidence) -> Evidence:
        """Evidence after the corrections.

        Torques determine frames up to displacements on which the readings of link sensors depend,
        so these are not compared with estimated frames.
        """
        if self.excluded:  # the explanations of the torques competed on all records
            kept = [r for r in evidence.records if r.experiment.name not in self.excluded]
            return replace(evidence, records=tuple(kept), best_fit=None)
        after = evidence.corrected(self.corrections)
        if self.gain is not None:  # it competed with the best fit on held-out stretches
            after = replace(after, best_fit=(np.inf, 0.0))
        if not self.moves_frames:
            return after
        links = [name for name in after.channels if channel_parts(name)[0] in LINK_CHANNELS]
        return after.without(links)

    def suspicion(self, study: Study) -> Suspicion:
        """The fault as a suspicion; `study` is the one that the corrections change."""
        corrections = () if self.excluded else self.corrections
        values = dict(self.remedy.values) | {
            "steps": steps_of(study, corrections),
            "other": steps_of(study, self.alternative),
        }
        return Suspicion(
            code=self.code,
            places=self.places,
            clause=self.clause,
            remedy_clause=Clause(self.remedy.template, **values),
            factor=self.factor,
            delay_s=self.delay_s,
            corrections=() if self.is_undecided else corrections,
            accepted=self.is_fitted,
        )

    def undecided(self, other: Hypothesis) -> Hypothesis:
        """The hypothesis with a remedy that names the corrections of another one as well."""
        if self.excluded or other.excluded:
            return self
        remedy, corrections = Clause("remedy/either"), other.corrections
        return replace(self, remedy=remedy, alternative=corrections, is_undecided=True)

    def as_estimate(self) -> Hypothesis:
        """The hypothesis with values that the torques determine too inaccurately to obey."""
        remedy = self.remedy if self.moves_frames else Clause("remedy/estimate")
        return replace(self, remedy=remedy, is_undecided=True)

    def as_rival(self) -> Hypothesis:
        """The hypothesis as one that is as likely as the one before it."""
        return replace(self, clause=Clause("rival", fault=self.clause))


@dataclass(frozen=True, slots=True)
class UnexplainedEvidence:
    """Evidence, and the contradictions in it that a hypothesis must explain."""

    evidence: Evidence
    contradictions: tuple[Relation, ...]
    explanations: tuple[Hypothesis, ...] = ()  # of the torques, the best first

    @property
    def joints(self) -> set[JointNumber]:
        """Joints of the contradictions."""
        return {o.joint for o in self.contradictions if o.joint is not None}

    def contradicts(self, *kinds: str) -> bool:
        """Whether an observation of one of these kinds contradicts."""
        return any(o.kind in kinds for o in self.contradictions)

    def by_channel(self, kind: str) -> dict[str, float]:
        """Values of the contradictions of one kind, by channel."""
        chosen = [o for o in self.contradictions if o.kind == kind]
        return {o.place.channel: o.measured for o in chosen if o.place.channel is not None}

    def values(self, channel: str | None, *kinds: str) -> list[float]:
        """Nonzero values of the contradictions in one channel, or in records, kind by kind."""
        return [
            o.measured
            for kind in kinds
            for o in self.contradictions
            if o.kind == kind and o.place.channel == channel and o.measured
        ]

    def rotation_factors(self, joint: int) -> list[float]:
        """Estimates of the rotation of a link relative to that which the study implies."""
        sources = [*(f"{kind}{joint}" for kind in ("gyro", "theta_l", "a"))]
        factors = [factor for name in sources for factor in self.values(name, "scale")]
        estimate = partial(estimate_rotation_factors, self.evidence, joint)
        motors = (self.evidence.arm, *self.evidence.records)
        searched = self.evidence.cache.recall(("rotation", joint), motors, estimate)
        return [*factors, *self.values(f"a{joint}", "own-joint"), *searched]


def _place_of(each: Correction) -> Place:
    """The channel or the key that a correction changes."""
    key = each.key.partition(".")[0]
    if each.table in ("channels", "log"):
        return Place(channel=each.entry)
    if each.table == "experiment":
        return Place(experiments=(each.entry,), key=key)
    return Place(joint=int(each.entry) if each.table == "joint" else None, key=key)


def scaled(evidence: Evidence, names: Iterable[str], factor: float) -> tuple[Correction, ...]:
    """Corrections that multiply channels by a factor."""
    corrections = []
    for name in names:
        before = evidence.channel(name)
        for key, value in (("scale", before.scale), ("offset", before.offset)):
            if value:
                changed = float(f"{value * factor:.7g}")
                corrections.append(Correction("channels", name, key, changed))
    return tuple(corrections)


def of_logs(names: Iterable[str], key: str, value: float) -> tuple[Correction, ...]:
    """The same correction of several channels of the logs."""
    return tuple(Correction("log", name, key, value) for name in names)


def exchanges(
    evidence: Evidence, groups: Iterable[Sequence[str]], joints: tuple[int, int]
) -> Iterator[Hypothesis]:
    """Exchanged channels of two joints, for each group of kinds of those that both have."""
    (i, j), channels = joints, evidence.channels
    named = [[(f"{kind}{i}", f"{kind}{j}") for kind in kinds] for kinds in groups]
    given = [tuple(p for p in pairs if set(p) <= channels) for pairs in named]
    for pairs in filter(None, dict.fromkeys(given)):
        clause = Clause("swapped-channels", pairs=pairs, joints=joints)
        if len(pairs) == 1:
            a, b = pairs[0]
            clause = Clause("swapped-channels/one-kind", first=a, second=b, joint=i, other=j)
        changes = exchange_corrections(pairs, evidence.study)
        yield Hypothesis("swapped-channels", clause, changes, kind="exchange")


def other_scale(
    evidence: Evidence, name: str, factor: float, unit: Unit | None, basis: str
) -> Hypothesis:
    """One channel in another unit or with another sign; `basis` determines its scale."""
    is_reversed = factor == -1.0
    code = template = "wrong-sign" if is_reversed else "wrong-unit"
    if not is_reversed and (unit is None or factor < 0.0):
        template += "/unknown" if unit is None else "/reversed"
    based_on = Clause(f"basis/{basis}", joint=channel_parts(name)[1])
    clause = Clause(template, channel=name, ratio=1.0 / factor, basis=based_on, unit=unit)
    is_estimated, changes = unit is None and not is_reversed, scaled(evidence, [name], factor)
    return Hypothesis(code, clause, changes, factor=1.0 / factor, has_estimated_factor=is_estimated)


def angle_unit(
    names: Sequence[str], unit: Unit, changes: tuple[Correction, ...], factor: float
) -> Hypothesis:
    """All motor angles in another unit, of which `factor` is that of the first."""
    clause = Clause("wrong-unit/angles", channels=tuple(names), unit=unit)
    return Hypothesis("wrong-unit", clause, changes, factor=1.0 / factor, kind="unit")


def other_meaning(efforts: Sequence[str], meaning: str, clause: Clause) -> Hypothesis:
    """Another meaning of the efforts."""
    changes = tuple(Correction("channels", name, "meaning", meaning) for name in efforts)
    return Hypothesis(clause.template, clause, changes, kind=meaning)


def whole_reduction(ratio: float) -> tuple[float, bool]:
    """A gear ratio, or that of the whole reduction near it; and whether there is one."""
    reduction = round(1.0 / ratio)
    is_whole = reduction != 0 and abs(reduction * ratio - 1.0) < _REDUCTION_TOLERANCE
    return float(f"{1.0 / reduction if is_whole else ratio:.5g}"), is_whole
