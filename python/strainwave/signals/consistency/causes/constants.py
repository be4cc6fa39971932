"""Causes in the constants of the study: gravity, encoder counts, gear ratios, distances."""

from __future__ import annotations

import math
from collections.abc import Iterator

from strainwave.domain import Clause, Correction, Place
from strainwave.domain.kinds import arm_keys
from strainwave.domain.study_keys import accepted_range
from strainwave.signals.consistency.causes.case import MAX_FACTOR_DIFFERENCE, Case, Cause
from strainwave.signals.consistency.causes.channels import scale_cause

# Maximum relative difference between an estimated reduction and a whole number.
_REDUCTION_TOLERANCE = 0.01
# Largest reduction for which the estimate distinguishes neighbouring whole numbers.
_MAX_DISTINCT_REDUCTION = 30
# Reductions of strain-wave gears, and the log ratio within which an estimate is one of them.
_REDUCTIONS = (30, 50, 51, 80, 81, 100, 101, 120, 121, 160, 161)
_USUAL_TOLERANCE = 0.03
# Maximum difference of distances that count as equal, over the distance between the axes.
_DISTANCE_TOLERANCE = 0.1


def propose_gravity(case: Case) -> Iterator[Cause]:
    """Gravity stated for a horizontal planar arm, or missing for a vertical one."""
    if not case.evidence.arm.has_planar_program:
        return  # the size alone does not state the gravity of a chain
    arm = case.evidence.study.arm
    clause, change = Clause("wrong-geometry/vertical"), Correction("arm", "", "gravity", 9.81)
    if arm.gravity_size:
        clause = Clause("wrong-geometry/horizontal", gravity=arm.gravity_size)
        change = Correction("arm", "", "gravity", None)
    yield Cause("wrong-geometry", (Place(key="gravity"),), clause, (change,))


def propose_encoder_counts(case: Case, joint: int) -> Iterator[Cause]:
    """A wrong number of encoder counts in the study."""
    name, per_turn = f"theta_m{joint}", case.evidence.arm.joints[joint - 1].encoder_counts
    for ratio in case.values(name, "count") if per_turn else ():
        counts = round((per_turn or 0.0) / ratio)
        if _is_accepted("encoder_counts", counts):
            place = Place(joint=joint, key="encoder_counts")
            clause = Clause("wrong-unit/counts", channel=name, ratio=ratio, counts=per_turn)
            change = Correction("joint", str(joint), "encoder_counts", counts)
            yield Cause("wrong-unit", (place,), clause, (change,), factor=ratio)


def propose_gear_ratios(case: Case, joint: int) -> Iterator[Cause]:
    """A wrong gear ratio in the study."""
    n = case.evidence.arm.joints[joint - 1].gear_ratio
    estimates = [scale * n for scale in case.rotation_factors(joint) if scale > 0.0]
    usual = [r for r in map(_usual_ratio, estimates) if r is not None]
    known = [0.5 * n, 2.0 * n, 1.0 / n, *usual]
    for candidate in estimates + known:
        reduction = round(1.0 / candidate)
        is_whole = reduction >= 1 and abs(reduction * candidate - 1.0) < _REDUCTION_TOLERANCE
        ratio = float(f"{1.0 / reduction if is_whole else candidate:.5g}")
        if abs(ratio / n - 1.0) < MAX_FACTOR_DIFFERENCE or not _is_accepted("gear_ratio", ratio):
            continue
        is_distinct = is_whole and reduction <= _MAX_DISTINCT_REDUCTION
        clause = Clause("wrong-gear-ratio", joint=joint, factor=ratio / n, stated=n, ratio=ratio)
        yield Cause(
            "wrong-gear-ratio",
            (Place(joint=joint, key="gear_ratio"),),
            clause,
            (Correction("joint", str(joint), "gear_ratio", ratio),),
            factor=n / ratio,
            has_estimated_factor=candidate not in known and not is_distinct,
        )


def _usual_ratio(estimate: float) -> float | None:
    """Ratio of a strain-wave gear of the catalogues near an estimate, which springs bias."""
    near = min(_REDUCTIONS, key=lambda reduction: abs(math.log(reduction * abs(estimate))))
    is_near = abs(math.log(near * abs(estimate))) < _USUAL_TOLERANCE
    return math.copysign(1.0 / near, estimate) if is_near else None


def propose_geometry(case: Case, joint: int) -> Iterator[Cause]:
    """A wrong accelerometer distance or link length, or an arbitrary accelerometer scale."""
    name, joints = f"a{joint}", case.evidence.arm.joints
    origins = [math.hypot(*each.origin.xyz) for each in joints[joint - 1 : joint + 1]]
    length = max(origins)  # to a neighbouring axis
    yield from _propose_distances(case, joint, length)
    has_length = joint > 1 and "link_length" in arm_keys(case.evidence.study.arm)
    for ratio in case.values(name, "origin-motion") if has_length else ():
        corrected = float(f"{ratio * length:.4g}")
        if _is_accepted("link_length", corrected):
            clause = Clause(
                "wrong-geometry/length", channel=name, joint=joint, ratio=ratio, stated=length
            )
            yield Cause(
                "wrong-geometry",
                (Place(key="link_length"),),
                clause,
                (Correction("arm", "", "link_length", corrected),),
                factor=1.0 / ratio,
                has_estimated_factor=True,
            )
    for ratio in case.values(name, "scale"):
        yield scale_cause(case, name, 1.0 / ratio, None, "motor-angle")


def _propose_distances(case: Case, joint: int, length: float) -> Iterator[Cause]:
    """Other distances of the accelerometer; `length` is the distance to a neighbouring axis."""
    name, stated = f"a{joint}", case.evidence.arm.joints[joint - 1].accelerometer_distance
    if not stated:
        return
    for ratio in case.values(name, "own-joint", "scale"):
        corrected = float(f"{ratio * stated:.4g}")
        if not _is_accepted("accelerometer_distance", corrected):
            continue
        clause = Clause(
            "wrong-geometry/distance",
            channel=name,
            joint=joint,
            ratio=ratio,
            stated=stated,
            corrected=corrected,
            hint=_distance_hint(corrected, stated, length, joint),
        )
        yield Cause(
            "wrong-geometry",
            (Place(joint=joint, key="accelerometer_distance"),),
            clause,
            (Correction("joint", str(joint), "accelerometer_distance", corrected),),
            Clause("remedy/distance", joint=joint),
            case.scale_corrections([name], 1.0 / ratio),
            factor=1.0 / ratio,
            has_estimated_factor=True,
        )


def _distance_hint(corrected: float, stated: float, length: float, joint: int) -> Clause | None:
    """The point from which the stated distance was probably measured."""
    if abs(stated - corrected - length) < _DISTANCE_TOLERANCE * length:
        return Clause("hint/axis", axis=max(1, joint - 1))
    if abs(stated + corrected - length) < _DISTANCE_TOLERANCE * length:
        return Clause("hint/end")
    return None


def _is_accepted(key: str, value: float) -> bool:
    """Whether a study file accepts a value."""
    minimum, maximum = accepted_range(key)
    return minimum <= value <= maximum
