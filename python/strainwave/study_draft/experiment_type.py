"""What each record is for: pseudo-random voltages identify elasticity, slow motion rigidity."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import Control, FloatArray, Prbs, Use
from strainwave.study_draft.candidates import Mapping
from strainwave.study_draft.inspection import Record
from strainwave.study_draft.signal_features import (
    levels,
    runs_alike,
    sequence_of,
    smooth_share,
    switches,
)

_SLOW_HZ = 5.0
_SLOW = 0.9  # share of an input's power below that in a motion of the whole arm
_MANY = 40  # jumps of an input that no step and no square wave has
_CHECK = re.compile(r"check|val(?!ve)|test|verif", re.IGNORECASE)


@dataclass(slots=True)
class Proposed:
    """One [[experiment]]."""

    record: Record
    use: Use
    why: str
    joint: int | None = None
    control: tuple[Control, ...] = ()
    prbs: Prbs | None = None
    has_known_amplitude: bool = True  # False: the scale of the voltage is to be filled in


@dataclass(frozen=True, slots=True)
class _Seen:
    """One joint's part in a record."""

    joint: int
    kind: str  # still, random, steps, smooth
    sequence: Prbs | None
    servo: bool
    size: float


def propose(records: Sequence[Record], mapping: Mapping, elastic: bool) -> list[Proposed]:
    """A use for every record.

    Parameters
    ----------
    records : sequence of Record
    mapping : Mapping
    elastic : bool
        Whether the gears' springs are to be identified.

    Returns
    -------
    list of Proposed
    """
    found = [_one(record, mapping, elastic) for record in records]
    _sweeps(found)
    _checks(found)
    return found


def _elastic_checks(found: list[Proposed]) -> None:
    """Of each joint's steps one to check the elastic model with; the last only if others fit it."""
    checked = {each.joint for each in found if each.use == "check"}
    excited = {each.joint for each in found if each.use in ("frequency", "sweep")}
    for joint in {each.joint for each in found if each.use == "tuning"} - checked:
        steps = [each for each in found if each.use == "tuning" and each.joint == joint]
        if len(steps) > 1 or joint in excited:
            steps[-1].use = "check"
            steps[-1].why += "; kept to check the elastic model with"


def unchecked_joints(found: Sequence[Proposed], joints: int) -> list[int]:
    """Joints whose elastic model no record would check.

    Parameters
    ----------
    found : sequence of Proposed
    joints : int
        Of the arm.

    Returns
    -------
    list of int
    """
    checked = {each.joint for each in found if each.use == "check"}
    return [joint for joint in range(1, joints + 1) if joint not in checked]


def _one(record: Record, mapping: Mapping, elastic: bool) -> Proposed:
    seen = [_joint(record, mapping, j) for j in range(1, len(mapping.joints) + 1)]
    control: tuple[Control, ...] = tuple("servo" if each.servo else "open" for each in seen)
    random = max((s for s in seen if s.kind == "random"), key=_size, default=None)
    stepped = [s for s in seen if s.kind == "steps"]
    if random is not None and elastic:
        sequence = random.sequence
        what = "a pseudo-random sequence" if sequence else "fast and broad"
        why = f"the input of joint {random.joint} is {what}"
        names = (f"u{random.joint}", f"torque{random.joint}")
        guesses = [mapping.guesses[name] for name in names if name in mapping.guesses]
        known = all(guess.scale is not None for guess in guesses)
        return Proposed(record, "frequency", why, random.joint, control, sequence, known)
    if len(stepped) == 1 and elastic and len(seen) > 1 and not _moves_all(record, mapping):
        why = f"joint {stepped[0].joint} is stepped"
        return Proposed(record, "tuning", why, stepped[0].joint, control)
    if stepped and elastic and len(seen) == 1:
        return Proposed(record, "tuning", "the joint is stepped", 1, control)
    why = "a slow motion" if not random else "fast, but a rigid arm needs no more than motions"
    return Proposed(record, "motion", why, None, control)


def _joint(record: Record, mapping: Mapping, joint: int) -> _Seen:
    drive = _column(record, mapping, f"u{joint}", f"torque{joint}")
    reference = _column(record, mapping, f"ref{joint}")
    if drive is None or np.ptp(drive) == 0.0:
        return _Seen(
            joint, "still", None, reference is not None and bool(np.ptp(reference) > 0.0), 0.0
        )
    size = float(np.std(drive))
    few = levels(drive)
    jumps = switches(drive)
    servo = few is None
    if few is not None and jumps >= _MANY and not runs_alike(drive):
        return _Seen(joint, "random", sequence_of(drive, record.period), False, size)
    if few is not None:
        return _Seen(joint, "steps", None, False, size)
    if reference is not None and np.ptp(reference) > 0.0:
        stepped = levels(reference) is not None
        return _Seen(joint, "steps" if stepped else "smooth", None, servo, size)
    smooth = smooth_share(drive, record.period, _SLOW_HZ) > _SLOW
    broad = jumps >= _MANY and not smooth
    return _Seen(joint, "random" if broad else "smooth", None, servo, size)


def _size(seen: _Seen) -> float:
    # a sequence that is one for certain counts before what only looks like it
    return seen.size * (1e6 if seen.sequence else 1.0)


def _moves_all(record: Record, mapping: Mapping) -> bool:
    references = [_column(record, mapping, f"ref{j}") for j in range(1, len(mapping.joints) + 1)]
    return all(each is not None and np.ptp(each) > 0.0 for each in references)


def _column(record: Record, mapping: Mapping, *channels: str) -> FloatArray | None:
    """The first of some channels that the record has, in SI units where its scale is known."""
    for channel in channels:
        guess = mapping.guesses.get(channel)
        if guess is not None and guess.column in record.columns:
            return (1.0 if guess.scale is None else guess.scale) * record.columns[guess.column]
    return None


def _sweeps(found: list[Proposed]) -> None:
    """Of records that excite one joint alike, the strongest is `frequency`, the others `sweep`."""
    groups: dict[tuple[int | None, tuple[Control, ...]], list[Proposed]] = {}
    for each in found:
        if each.prbs:
            groups.setdefault((each.joint, each.control), []).append(each)
    for group in groups.values():
        strongest = max(group, key=_amplitude)
        for each in group:
            if _amplitude(each) < 0.95 * _amplitude(strongest):
                each.use = "sweep"
                each.why += f", weaker than in {strongest.record.name}"


def _amplitude(each: Proposed) -> float:
    return each.prbs.amplitude if each.prbs else 0.0


def _checks(found: list[Proposed]) -> None:
    """Records to predict: those that say so, or else the last of several motions."""
    for each in found:
        if _CHECK.search(each.record.name) and each.use in ("motion", "tuning"):
            each.use, each.why = "check", f"{each.why}; a record to check with, by its name"
    motions = [each for each in found if each.use == "motion"]
    if len(motions) > 1 and not any(e.use == "check" and e.joint is None for e in found):
        # of equally long ones the last
        shortest = min(reversed(motions), key=lambda each: round(float(np.ptp(each.record.time))))
        shortest.use = "check"
        shortest.why += "; the shortest of several: kept to check with"
    excited = {each.joint for each in found if each.use == "frequency"}
    for each in found:
        if each.use == "tuning" and each.joint in excited and "servo" not in each.control:
            each.use, each.why = "check", f"{each.why} in open loop; kept to check with"
    _elastic_checks(found)
    if not any(each.use == "motion" for each in found):
        slow = [e for e in found if e.use == "check" and e.joint is None]
        if slow:
            slow[0].use = "motion"
