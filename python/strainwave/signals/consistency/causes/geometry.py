"""Causes in the geometry of a chain: axes, frames, zeros, gravity, ratios, coupling."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from strainwave.domain import Clause, Correction, Place, channel_parts
from strainwave.domain.effects import OF_RIGID_JOINTS
from strainwave.domain.kinds import kind_of
from strainwave.signals.consistency.causes.case import STEPS, Case, Cause, as_rival
from strainwave.signals.consistency.causes.channels import scale_cause
from strainwave.signals.consistency.evidence import Alternative, ChangeKind, is_as_good
from strainwave.signals.consistency.torque_fit import friction_shares

# Log ratio within which an estimated reduction is the nearest whole number.
_REDUCTION_TOLERANCE = 0.01
# Effects of a fit that estimate what these changes correct, and the largest zero of one of several
# joints from which the fit finds the true one [rad].
_ESTIMATED_BY_FIT: Mapping[ChangeKind, str] = {"zero": "encoder-zero", "delay": "torque-delay"}
_MAX_FITTED_ZERO = 0.5
# Least share of friction in the torques of gears, from measured arms.
_MIN_FRICTION_OF_GEARS = 0.1
# Decimal logarithm within which a factor is that of a unit.
_UNIT_TOLERANCE = 0.01


def propose_explanations(case: Case) -> Iterator[Cause]:
    """Explanations of the torques about as good as the best one, simple ones first.

    Of those as simple as each other, the one that predicts best is first. Faults of one record
    follow those of all. The others are rivals.
    """
    found = case.evidence.explanations
    if not found or not case.contradicts("torque-fit"):
        return
    good = [v for a in found if is_as_good(a, found[0]) for v in _variants(a)]
    good.sort(key=lambda a: (bool(a.record), _complexity(a), _enlarges(a), a.penalised_cost))
    causes = [_cause(case, a, float(np.exp(a.gain.mean if a.gain else 0.0))) for a in good]
    desired = [replace(c, rivals=tuple(map(as_rival, causes))) for c in _desired(case)]
    if good[0].kind == "delay":  # efforts of a set-point are early
        yield from desired
    for cause in causes:
        others = [other for other in causes if other.places != cause.places]
        yield replace(cause, rivals=tuple(map(as_rival, others)))
    yield from desired


def _desired(case: Case) -> Iterator[Cause]:
    """Efforts of the set-point, which contain hardly any friction."""
    evidence = case.evidence
    names = [f"torque{i}" for i in range(1, evidence.arm.n_joints + 1)]
    efforts = tuple(name for name in names if name in evidence.channels)
    shares = [share for share, _ in friction_shares(evidence).values()]
    if efforts and shares and np.median(shares) < _MIN_FRICTION_OF_GEARS:
        clause = Clause("desired-effort", channels=efforts, share=float(np.median(shares)))
        changes = tuple(Correction("channels", name, "meaning", "desired") for name in efforts)
        places = tuple(Place(channel=name) for name in efforts)
        yield Cause("desired-effort", places, clause, changes)


def _variants(each: Alternative) -> Iterator[Alternative]:
    """An explanation, and an exchange of motor torques without that of the sensors behind gears."""
    yield each
    motors = tuple(kind for kind in each.exchanged if kind != "tau_l")
    if motors and motors != each.exchanged:
        kept = [c for c in each.corrections if channel_parts(c.entry)[0] != "tau_l"]
        yield replace(each, corrections=tuple(kept), exchanged=motors)


def _complexity(each: Alternative) -> int:
    """0 for exchanges, signs, units and axes, 1 for one number, 2 for several."""
    return min(max(each.n_coordinates, each.kind == "zero"), 2)


def _enlarges(each: Alternative) -> bool:
    """Whether a scale is larger than that of SI units; small units are the common fault."""
    return each.kind == "torque" and abs(each.corrections[0].number) > 1.0


def _cause(case: Case, change: Alternative, ratio: float) -> Cause:
    cause = _CAUSES[change.kind](case, change, ratio)
    effect = _ESTIMATED_BY_FIT.get(change.kind)
    return replace(
        cause,
        is_fitted=effect is not None and _estimates(case, change, cause, effect),
        has_estimated_factor=change.kind in _ESTIMATED and cause.factor != -1.0,
        moves_frames=change.kind in ("frame", "robot"),
    )


def _estimates(case: Case, change: Alternative, cause: Cause, effect: str) -> bool:
    """Whether the fit estimates what a cause would correct: an effect that it selects.

    It finds the zeros of several joints near the stated ones only.
    """
    arm = case.evidence.study.arm
    joints = {channel_parts(place.channel)[1] for place in cause.places if place.channel}
    is_near = (
        change.kind != "zero" or arm.n_joints == 1 or _zero_angle(case, change) < _MAX_FITTED_ZERO
    )
    fitted = [arm.joints[i - 1] for i in joints]
    return is_near and all(
        joint.selects_effects
        if not joint.elastic and effect in OF_RIGID_JOINTS
        else effect in joint.possible_effects
        for joint in fitted
    )


def _axis(case: Case, change: Alternative, ratio: float) -> Cause:
    """Another axis, or the same in the opposite direction."""
    joint, corrections = change.joint or 0, change.corrections
    place, value = Place(joint=joint, key="axis"), corrections[0].value
    stated = case.evidence.study.arm.joints[joint - 1].axis
    if value == tuple(-x for x in stated):
        clause = Clause("wrong-sign/axis", ratio=ratio, joint=joint)
        remedy = Clause("remedy/axis", joint=joint)
        return Cause("wrong-sign", (place,), clause, corrections, remedy, factor=-1.0)
    texts = {"corrected": _text(value), "stated": _text(stated)}
    clause = Clause("wrong-geometry/axis", ratio=ratio, joint=joint, **texts)
    return Cause("wrong-geometry", (place,), clause, corrections)


def _gear_ratio(case: Case, change: Alternative, ratio: float) -> Cause:
    """Another gear ratio, with a whole reduction if one is near."""
    joint, estimate = change.joint or 0, change.corrections[0].value
    stated = case.evidence.study.arm.joints[joint - 1].gear_ratio
    corrected = float(f"{estimate:.5g}")
    reduction = round(1.0 / corrected)
    if reduction != 0 and abs(reduction * corrected - 1.0) < _REDUCTION_TOLERANCE:
        corrected = float(f"{1.0 / reduction:.5g}")
    values = {"ratio": ratio, "corrected": corrected, "stated": stated}
    clause = Clause("wrong-gear-ratio/torques", joint=joint, **values)
    changes = (Correction("joint", str(joint), "gear_ratio", corrected),)
    place = Place(joint=joint, key="gear_ratio")
    return Cause("wrong-gear-ratio", (place,), clause, changes, factor=stated / corrected)


def _torque(case: Case, change: Alternative, ratio: float) -> Cause:
    """Another torque constant of one joint, or another unit or sign of its torque."""
    joint, (correction,) = change.joint or 0, change.corrections
    stated = case.evidence.study.arm.joints[joint - 1].torque_per_command
    place = Place(joint=joint, key="torque_per_volt")
    if correction.table == "channels":
        place, stated = (
            Place(channel=correction.entry),
            case.evidence.channel(correction.entry).scale,
        )
    factor = correction.number / stated
    if factor == -1.0:
        clause = Clause("wrong-sign/torques", ratio=ratio, joint=joint, channel=correction.entry)
        places = (_place(change, channel=correction.entry),)
        return _of_records(change, Cause("wrong-sign", places, clause, (correction,), factor=-1.0))
    is_unit = abs(abs(np.log10(factor)) - 3.0) < _UNIT_TOLERANCE
    code = "wrong-unit" if is_unit else "wrong-torque-constant"
    clause = Clause(f"{code}/torques", ratio=ratio, joint=joint, factor=factor)
    remedy = STEPS if is_unit else Clause("remedy/torque-estimate")
    return Cause(code, (place,), clause, (correction,), remedy, factor=1.0 / factor)


def _gravity(case: Case, change: Alternative, ratio: float) -> Cause:
    """Another direction of gravity, or a plane of motion with or without gravity."""
    arm = case.evidence.study.arm
    if kind_of(arm).places_joints:
        clause = Clause("wrong-geometry/vertical")
        if arm.gravity_size:
            clause = Clause("wrong-geometry/horizontal", gravity=arm.gravity_size)
        return Cause("wrong-geometry", (Place(key="gravity"),), clause, change.corrections)
    texts = {"corrected": _text(change.corrections[0].value)}
    texts["stated"] = _text(case.evidence.study.arm.gravity)
    clause = Clause("wrong-geometry/gravity", ratio=ratio, **texts)
    return Cause("wrong-geometry", (Place(key="gravity"),), clause, change.corrections)


def _coupling(_: Case, change: Alternative, ratio: float) -> Cause:
    corrected = _text(change.corrections[0].value)
    clause = Clause("wrong-geometry/coupling", ratio=ratio, corrected=corrected)
    return Cause("wrong-geometry", (Place(key="coupling"),), clause, change.corrections)


def _exchange(_: Case, change: Alternative, ratio: float) -> Cause:
    """Exchanged channels of two joints, in all records or in one."""
    joints = change.joint or 0, change.other or 0
    pairs = tuple((f"{kind}{joints[0]}", f"{kind}{joints[1]}") for kind in change.exchanged)
    places = tuple(_place(change, channel=name) for pair in pairs for name in pair)
    clause = Clause("swapped-channels", pairs=pairs, joints=joints)
    return _of_records(change, Cause("swapped-channels", places, clause, change.corrections))


def _of_records(change: Alternative, cause: Cause) -> Cause:
    """The cause, or that of one record, which is then left out."""
    if not change.record:
        return cause
    clause = Clause("record", record=change.record, fault=cause.clause)
    remedy = Clause("remedy/record", record=change.record)
    excluded = (change.record,)
    return replace(cause, clause=clause, corrections=(), remedy=remedy, excluded=excluded)


def _place(change: Alternative, **place: Any) -> Place:
    return Place(experiments=(change.record,) if change.record else (), **place)


def _delay(case: Case, change: Alternative, ratio: float) -> Cause:
    """Torques that are late or early relative to the motor angles."""
    names = tuple(each.entry for each in change.corrections)
    delay = float(f"{change.corrections[0].number:.3g}")
    side = "later" if delay > 0.0 else "earlier"
    clause = Clause("misaligned/motors", ratio=ratio, channels=names, delay=abs(delay), side=side)
    changes = tuple(replace(each, value=delay) for each in change.corrections)
    places, remedy = tuple(Place(channel=name) for name in names), Clause("remedy/command")
    return Cause("misaligned", places, clause, changes, remedy, delay_s=delay)


def _without_gravity(_: Case, change: Alternative, ratio: float) -> Cause:
    """Efforts from which the drivers subtract gravity."""
    places = tuple(Place(channel=each.entry) for each in change.corrections)
    clause = Clause("effort-without-gravity", ratio=ratio)
    return Cause("effort-without-gravity", places, clause, change.corrections)


def _payload(_: Case, change: Alternative, ratio: float) -> Cause:
    """A load on the last link in one record only."""
    clause = Clause("unstated-payload", ratio=ratio, record=change.record)
    remedy = Clause("remedy/payload", record=change.record)
    places, excluded = (_place(change, key="payload"),), (change.record,)
    return Cause("unstated-payload", places, clause, (), remedy, excluded=excluded)


def _zero(case: Case, change: Alternative, ratio: float) -> Cause:
    joint, (offset,) = change.joint or 0, change.corrections
    angle = _zero_angle(case, change)
    clause = Clause("wrong-geometry/zero", ratio=ratio, joint=joint, angle=angle)
    return Cause("wrong-zero", (Place(channel=offset.entry),), clause, (offset,))


def _zero_angle(case: Case, change: Alternative) -> float:
    """Angle of the joint between the stated zero and the corrected one [rad]."""
    (offset,) = change.corrections
    moved = offset.number - case.evidence.channel(offset.entry).offset
    return abs(moved * case.evidence.study.arm.joints[(change.joint or 1) - 1].gear_ratio)


def _frame(case: Case, change: Alternative, ratio: float) -> Cause:
    length, angle = _moved(case, change)
    sizes = {"ratio": ratio, "length": length, "angle": angle}
    clause = Clause("wrong-geometry/frame", joint=change.joint, **sizes)
    place, remedy = Place(joint=change.joint, key="origin"), Clause("remedy/frame")
    return Cause("wrong-geometry", (place,), clause, change.corrections, remedy)


def _robot(case: Case, change: Alternative, ratio: float) -> Cause:
    length, angle = _moved(case, change)
    clause = Clause("wrong-geometry/robot", ratio=ratio, length=length, angle=angle)
    place = Place(key="origin" if case.evidence.study.arm.urdf is None else "urdf")
    remedy = Clause("remedy/robot")
    return Cause("wrong-geometry", (place,), clause, change.corrections, remedy)


def _unit(case: Case, change: Alternative, _: float) -> Cause:
    """All motor angles in another unit."""
    names = tuple(each.entry for each in change.corrections)
    factor = change.corrections[0].number / case.evidence.channel(names[0]).scale
    unit = "degrees" if factor < 1.0 else "turns"
    clause = Clause("wrong-unit/angles", channels=names, unit=unit)
    places = tuple(Place(channel=name) for name in names)
    return Cause("wrong-unit", places, clause, change.corrections, factor=1.0 / factor)


def _angle(case: Case, change: Alternative, _: float) -> Cause:
    """A motor angle with another sign."""
    name = change.corrections[0].entry
    return replace(scale_cause(case, name, -1.0, None, "motion"), corrections=change.corrections)


_CAUSES: Mapping[ChangeKind, Callable[[Case, Alternative, float], Cause]] = {
    "unit": _unit,
    "angle": _angle,
    "axis": _axis,
    "without-gravity": _without_gravity,
    "exchange": _exchange,
    "payload": _payload,
    "delay": _delay,
    "ratio": _gear_ratio,
    "torque": _torque,
    "coupling": _coupling,
    "gravity": _gravity,
    "zero": _zero,
    "frame": _frame,
    "robot": _robot,
}
"""Causes by kind of change, simple ones first; of equal fit, the simplest is the likely cause."""


_ESTIMATED = ("ratio", "torque", "gravity", "zero", "frame", "robot")
"""Kinds of change with coordinates that are estimated from the torques."""


def _moved(case: Case, change: Alternative) -> tuple[float, float]:
    """Largest displacement [m] and rotation [rad] of a frame."""
    lengths, angles = [0.0], [0.0]
    for each in change.corrections:
        origin = case.evidence.study.arm.joints[int(each.entry) - 1].origin
        before, moved = (origin.xyz, lengths) if each.key == "origin.xyz" else (origin.rpy, angles)
        moved.append(float(np.linalg.norm(np.subtract(each.value, before))))  # type: ignore[arg-type]
    return max(lengths), max(angles)


def _text(value: object) -> str:
    """A vector or a matrix as text."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value + 0.0:.4g}" if isinstance(value, float) else "none"  # not -0
