"""Propose the use of each record.

Records with pseudo-random input identify elasticity; slow motion identifies the rigid arm.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import Control, FloatArray, Prbs, Use
from strainwave.init.inspection import InspectedLog
from strainwave.init.joint_columns import MIN_RANGE_SHARE, Mapping
from strainwave.init.signal_features import (
    levels,
    runs_alike,
    sequence_of,
    sequence_under_servo,
    smooth_share,
    switches,
)

_SLOW_HZ = 5.0  # [Hz] upper frequency of a motion of the whole arm
_MIN_LOW_FREQUENCY_SHARE = 0.9  # of an input's power below _SLOW_HZ in a motion record
_MIN_RANDOM_JUMPS = 40  # minimum number of jumps of a random input; step records have fewer
_EXCITING = ("frequency", "sweep")
# name of a validation record
_CHECK_NAME = re.compile(r"check|val(?!ve)|test|verif", re.IGNORECASE)


@dataclass(slots=True)
class ExperimentProposal:
    """Proposed entry of [[experiment]]."""

    record: InspectedLog
    use: Use
    reason: str
    joint: int | None = None
    control: tuple[Control, ...] = ()
    prbs: Prbs | None = None
    has_known_amplitude: bool = True  # False: the user must fill in the voltage scale

    def become(self, use: Use, reason: str) -> None:
        """Propose another use, with a further reason."""
        self.use, self.reason = use, self.reason + reason


@dataclass(frozen=True, slots=True)
class _JointInput:
    """Classification of one joint's input in a record."""

    joint: int
    kind: str  # "still", "random", "steps" or "smooth"
    sequence: Prbs | None
    servo: bool
    size: float  # standard deviation of the input


def propose_uses(records: Sequence[InspectedLog], mapping: Mapping) -> list[ExperimentProposal]:
    """Propose a use for every record.

    Gear stiffness is identified if a link sensor or a pseudo-random input shows it.
    """
    numbers = range(1, len(mapping.joints) + 1)
    inputs = [[_classify_input(record, mapping, j) for j in numbers] for record in records]
    elastic = mapping.shows_elasticity or any(
        each.sequence and not mapping.joints[each.joint - 1].joint_side
        for of_record in inputs
        for each in of_record
    )
    proposals = [
        _propose_use(record, of_record, mapping, elastic)
        for record, of_record in zip(records, inputs, strict=True)
    ]
    _assign_sweeps(proposals)
    _assign_checks(proposals, mapping)
    return proposals


def _propose_use(
    record: InspectedLog, inputs: Sequence[_JointInput], mapping: Mapping, elastic: bool
) -> ExperimentProposal:
    control: tuple[Control, ...] = tuple("servo" if each.servo else "open" for each in inputs)
    stepped = [s for s in inputs if s.kind == "steps"]
    # next to a stepped joint, the input of a joint that a servo holds has the noise of its encoder
    random_inputs = [s for s in inputs if s.kind == "random" and (s.sequence or not stepped)]
    # a detected maximum-length sequence has priority over other random inputs
    random_input = max(random_inputs, key=lambda s: (s.sequence is not None, s.size), default=None)
    if random_input is not None and elastic:
        sequence = random_input.sequence
        description = "a pseudo-random sequence" if sequence else "fast and broad"
        reason = f"the input of joint {random_input.joint} is {description}"
        names = (f"u{random_input.joint}", f"torque{random_input.joint}")
        guesses = [mapping.guesses[name] for name in names if name in mapping.guesses]
        has_scale = all(guess.scale is not None for guess in guesses)
        return ExperimentProposal(
            record, "frequency", reason, random_input.joint, control, sequence, has_scale
        )
    if len(stepped) == 1 and elastic and (len(inputs) == 1 or not _moves_all(record, mapping)):
        joint = stepped[0].joint
        reason = f"joint {joint} is stepped" if len(inputs) > 1 else "the joint is stepped"
        return ExperimentProposal(record, "tuning", reason, joint, control)
    reason = (
        "a slow motion" if not random_input else "a fast motion; a rigid arm requires only motions"
    )
    return ExperimentProposal(record, "motion", reason, None, control)


def _classify_input(record: InspectedLog, mapping: Mapping, joint: int) -> _JointInput:
    drive = _column(record, mapping, f"u{joint}", f"torque{joint}")
    reference = _column(record, mapping, f"ref{joint}")
    if drive is None or np.ptp(drive) == 0.0:
        is_moved = reference is not None and bool(np.ptp(reference) > 0.0)
        is_held = drive is not None and bool(drive[0] != 0.0)  # by the integral of a servo
        return _JointInput(joint, "still", None, is_moved or is_held, 0.0)
    std = float(np.std(drive))
    input_levels = levels(drive)
    jumps = len(switches(drive))
    servo = input_levels is None
    if input_levels is not None and jumps >= _MIN_RANDOM_JUMPS and not runs_alike(drive):
        return _JointInput(joint, "random", sequence_of(drive, record.period), False, std)
    if input_levels is not None:
        return _JointInput(joint, "steps", None, False, std)
    sequence = sequence_under_servo(drive, record.period)
    if sequence is not None:
        return _JointInput(joint, "random", sequence, servo, std)
    if reference is not None and np.ptp(reference) > 0.0:
        is_stepped = levels(reference) is not None
        return _JointInput(joint, "steps" if is_stepped else "smooth", None, servo, std)
    is_smooth = smooth_share(drive, record.period, _SLOW_HZ) > _MIN_LOW_FREQUENCY_SHARE
    is_broad = jumps >= _MIN_RANDOM_JUMPS and not is_smooth
    return _JointInput(joint, "random" if is_broad else "smooth", None, servo, std)


def _replaceable(
    motions: Sequence[ExperimentProposal], mapping: Mapping
) -> list[ExperimentProposal]:
    """Motions of which each joint moves in another motion too."""
    angles = [f"theta_m{joint}" for joint in range(1, len(mapping.joints) + 1)]
    columns = [[_column(each.record, mapping, name) for name in angles] for each in motions]
    ranges = np.array(
        [[0.0 if c is None else float(np.ptp(c)) for c in each] for each in columns]
    ).reshape(len(motions), len(angles))
    moves = (ranges > MIN_RANGE_SHARE * ranges.max(axis=0, initial=0.0)).astype(int)
    is_alone = ((moves == 1) & (moves.sum(axis=0) == 1)).any(axis=1)
    return [each for each, alone in zip(motions, is_alone, strict=True) if not alone]


def _moves_all(record: InspectedLog, mapping: Mapping) -> bool:
    references = [_column(record, mapping, f"ref{j}") for j in range(1, len(mapping.joints) + 1)]
    return all(each is not None and np.ptp(each) > 0.0 for each in references)


def _column(record: InspectedLog, mapping: Mapping, *channels: str) -> FloatArray | None:
    """Return the record's first available channel, in SI units if its scale is known."""
    for channel in channels:
        guess = mapping.guesses.get(channel)
        if guess is not None and guess.column in record.columns:
            return (1.0 if guess.scale is None else guess.scale) * record.columns[guess.column]
    return None


def _assign_sweeps(proposals: list[ExperimentProposal]) -> None:
    """Assign `frequency` or `sweep` to records that excite one joint under the same control.

    The record with the largest amplitude is `frequency`, weaker ones are `sweep`.
    """
    groups: dict[tuple[int | None, tuple[Control, ...]], list[ExperimentProposal]] = {}
    for each in proposals:
        if each.prbs:
            groups.setdefault((each.joint, each.control), []).append(each)
    for group in groups.values():
        strongest = max(group, key=_amplitude)
        for each in group:
            if _amplitude(each) < 0.95 * _amplitude(strongest):
                each.become("sweep", f", with a smaller amplitude than in {strongest.record.name}")


def _amplitude(each: ExperimentProposal) -> float:
    return each.prbs.amplitude if each.prbs else 0.0


def _assign_checks(proposals: list[ExperimentProposal], mapping: Mapping) -> None:
    """Select validation records: by name, else the shortest motion whose joints others move too."""
    for each in proposals:
        if _CHECK_NAME.search(each.record.name) and each.use in ("motion", "tuning"):
            each.become("check", "; a validation record according to its name")
    motions = [each for each in proposals if each.use == "motion"]
    replaceable = _replaceable(motions, mapping)
    if (
        len(motions) > 1
        and replaceable
        and not any(e.use == "check" and e.joint is None for e in proposals)
    ):
        # of records with equal duration, the last
        shortest = min(
            reversed(replaceable), key=lambda each: round(float(np.ptp(each.record.time)))
        )
        shortest.become("check", "; the shortest of several: used for validation")
    excited = {each.joint for each in proposals if each.use == "frequency"}
    for each in proposals:
        if each.use == "tuning" and each.joint in excited and "servo" not in each.control:
            each.become("check", " in open loop; used for validation")
    # the last step record of each joint validates the elastic model, if others fit it
    checked = {each.joint for each in proposals if each.use == "check"}
    for joint in {each.joint for each in proposals if each.use == "tuning"} - checked:
        steps = [each for each in proposals if each.use == "tuning" and each.joint == joint]
        if len(steps) > 1 or joint in {e.joint for e in proposals if e.use in _EXCITING}:
            steps[-1].become("check", "; used to validate the elastic model")
    if not any(each.use == "motion" for each in proposals):
        motion_checks = [e for e in proposals if e.use == "check" and e.joint is None]
        if motion_checks:
            motion_checks[0].use = "motion"
