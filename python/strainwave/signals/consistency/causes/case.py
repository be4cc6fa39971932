"""Contradictions to explain, and candidate causes with the corrections that remove them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import Clause, Correction, Place, Study, Suspicion, channel_parts
from strainwave.domain.corrections import steps_of
from strainwave.signals.consistency.evidence import Evidence
from strainwave.signals.consistency.observations import Observation
from strainwave.signals.consistency.sensors import LINK_CHANNELS, estimate_rotation_factors

MAX_FACTOR_DIFFERENCE = 0.02
"""Maximum relative difference between two factors that count as equal."""
UNIT_TOLERANCE = 0.04
"""Maximum log ratio of an estimated factor to that of a unit; units differ by at least 5 %."""
MIN_RATIO = 1e-6
"""Smallest factor that a unit can explain; a smaller ratio indicates a missing signal."""

MOTOR_SIDE = ("u", "torque", "theta_m", "omega_m", "ref")
"""Kinds of channels on the motor side."""

Unit = str | Clause
"""Name of a unit, as text or with its values."""

STEPS = Clause("remedy")
"""Remedy that consists of the corrections alone."""


@dataclass(frozen=True, slots=True)
class Cause:
    """A candidate fault of the input with the corrections that remove it."""

    code: str
    places: tuple[Place, ...]
    clause: Clause
    corrections: tuple[Correction, ...]
    remedy: Clause = STEPS
    alternative: tuple[Correction, ...] = ()  # equally likely corrections
    factor: float | None = None
    delay_s: float | None = None
    has_estimated_factor: bool = False  # not a unit, a sign or an exchange
    moves_frames: bool = False
    rivals: tuple[Cause, ...] = ()  # that explain the contradictions equally well
    is_fitted: bool = False  # the fit estimates it: no reason to stop
    excluded: tuple[str, ...] = ()  # records with the fault; the others do not have it

    def corrected(self, evidence: Evidence) -> Evidence:
        """Evidence after the corrections.

        Torques determine frames up to displacements on which the readings of link sensors depend,
        so these are not compared with estimated frames.
        """
        after = evidence.corrected(self.corrections)
        if self.excluded:  # the explanations of the torques competed on all records
            after = replace(after.without_records(self.excluded), explanations=None)
        if not self.moves_frames:
            return after
        links = [name for name in after.channels if channel_parts(name)[0] in LINK_CHANNELS]
        return after.without(links)

    def suspicion(self, study: Study) -> Suspicion:
        """The cause as a suspicion; `study` is the one that the corrections change."""
        values = dict(self.remedy.values) | {
            "steps": steps_of(study, self.corrections),
            "other": steps_of(study, self.alternative),
        }
        return Suspicion(
            code=self.code,
            places=self.places,
            clause=self.clause,
            remedy_clause=Clause(self.remedy.template, **values),
            factor=self.factor,
            delay_s=self.delay_s,
            corrections=self.corrections,
            accepted=self.is_fitted,
        )


def as_rival(cause: Cause) -> Cause:
    """The cause as one that is as likely as the cause before it."""
    return replace(cause, clause=Clause("rival", fault=cause.clause))


@dataclass(frozen=True, slots=True)
class Case:
    """Evidence, and the contradictions in it that a cause must explain."""

    evidence: Evidence
    contradictions: tuple[Observation, ...]
    _rotation_factors: dict[int, list[float]] = field(default_factory=dict, init=False)

    @property
    def joints(self) -> set[int]:
        """Joints of the contradictions, from 1; a torque ratio is not about one of its joints."""
        about_joints = [o.joint for o in self.contradictions if o.kind != "torque-ratio"]
        return {joint for joint in about_joints if joint is not None}

    def contradicts(self, *kinds: str) -> bool:
        """Whether an observation of one of these kinds contradicts."""
        return any(o.kind in kinds for o in self.contradictions)

    def by_channel(self, kind: str) -> dict[str, float]:
        """Values of the contradictions of one kind, by channel."""
        chosen = [o for o in self.contradictions if o.kind == kind]
        return {o.place.channel: o.value for o in chosen if o.place.channel is not None}

    def values(self, channel: str | None, *kinds: str) -> list[float]:
        """Nonzero values of the contradictions in one channel, or in records, kind by kind."""
        return [
            o.value
            for kind in kinds
            for o in self.contradictions
            if o.kind == kind and o.place.channel == channel and o.value
        ]

    def rotation_factors(self, joint: int) -> list[float]:
        """Estimates of the rotation of a link relative to that which the study implies."""
        if joint not in self._rotation_factors:
            factors = [
                factor
                for kind in ("gyro", "theta_l", "a")
                for factor in self.values(f"{kind}{joint}", "scale")
            ]
            factors += self.values(f"a{joint}", "own-joint")
            factors += estimate_rotation_factors(self.evidence, joint)
            self._rotation_factors[joint] = factors
        return self._rotation_factors[joint]

    def scale_corrections(self, names: Iterable[str], factor: float) -> tuple[Correction, ...]:
        """Corrections that multiply channels by a factor."""
        corrections = []
        for name in names:
            before = self.evidence.channel(name)
            scale = float(f"{before.scale * factor:.7g}")
            corrections.append(Correction("channels", name, "scale", scale))
            if before.offset:
                offset = float(f"{before.offset * factor:.7g}")
                corrections.append(Correction("channels", name, "offset", offset))
        return tuple(corrections)


def log_corrections(names: Iterable[str], key: str, value: float) -> tuple[Correction, ...]:
    """The same correction of several channels of the logs."""
    return tuple(Correction("log", name, key, value) for name in names)


def places_of(names: Iterable[str]) -> tuple[Place, ...]:
    """Places of channels."""
    return tuple(Place(channel=name) for name in names)


def match_known_factor(factor: float, units: Mapping[Unit, float]) -> tuple[Unit, float] | None:
    """Name and signed value of the known factor that matches an estimate; signs are ignored."""
    for unit, known in units.items():
        if abs(np.log(abs(factor / known))) < UNIT_TOLERANCE:
            return unit, float(np.copysign(known, factor))
    return None
