"""Hypotheses about the torques of all joints: their changes of the study or the logs, and wording.

Each is a single change: an axis, gravity, a gear ratio, a zero, a frame, a sign, an exchange, a
delay, another meaning of the efforts, or a load. Those with continuous coordinates are families,
whose coordinates `torque_search` estimates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from strainwave.domain import Clause, Correction, FloatArray, Place, channel_parts
from strainwave.domain.arm.effects import OF_RIGID_JOINTS
from strainwave.domain.arm.kinds import arm_keys, kind_of
from strainwave.input_check.evidence import Evidence
from strainwave.input_check.hypothesis import (
    Hypothesis,
    UnexplainedEvidence,
    angle_unit,
    exchanges,
    of_logs,
    other_meaning,
    other_scale,
    scaled,
    whole_reduction,
)
from strainwave.input_check.torque_fit import N_LINK_PARAMETERS, friction_shares
from strainwave.input_check.torque_rows import EFFORTS, effort_channel

# Prior standard deviations of the changes: log ratio, angles [rad], lengths [m], gravity [m/s^2].
_RATIO_STD, _ANGLE_STD, _LENGTH_STD, _GRAVITY_STD = 0.3, 0.5, 0.15, 5.0
# Changes within which a description is accepted: relative, angles [rad], lengths [m], gravity
# [m/s^2], torque constants, delays [s]. Drawings and calibrations of robots are more accurate.
_TOLERATED_RATIO, _TOLERATED_ANGLE, _TOLERATED_LENGTH = 0.004, 0.03, 0.01
_TOLERATED_GRAVITY, _TOLERATED_TORQUE, _TOLERATED_DELAY = 0.5, 0.1, 4e-3
_TOLERATED_FRAME = np.repeat([_TOLERATED_LENGTH / _LENGTH_STD, _TOLERATED_ANGLE / _ANGLE_STD], 3)
# Factors of the torque of one joint in another unit, and the decimal logarithm within which a
# factor is one.
_TORQUE_UNITS, _UNIT_TOLERANCE = (1e3, 1e-3), 0.01
# Zeros that a search from the stated one does not reach [rad].
_QUARTER_TURNS = (0.5 * np.pi, -0.5 * np.pi, np.pi)
# Largest zero of one of several joints from which the fit of the arm finds the true one [rad].
_MAX_FITTED_ZERO = 0.5
# Least median share of friction in the torques of gears: measured arms have 0.15 to 0.8, torques of
# a set-point, with the errors of the model, up to 0.06.
_MIN_FRICTION_OF_GEARS = 0.1
_STANDARD_GRAVITY = 9.81  # [m/s^2]
# Cosine above which two directions are equal.
_EQUAL_DIRECTIONS = 0.999
N_FRAME_COORDINATES = 6
_DIRECTIONS = [tuple(float(s * x) for x in e) for e in np.eye(3) for s in (1.0, -1.0)]
_ANGLES = ("theta_m", "omega_m", "ref")
_ESTIMATED = ("ratio", "torque", "gravity", "zero", "frame", "robot", "length")
"""Kinds of change with coordinates that are estimated from the torques."""


@dataclass(frozen=True, slots=True)
class HypothesisFamily:
    """Hypotheses with continuous coordinates, in prior standard deviations."""

    tolerated: FloatArray  # (size,) coordinates of a change within which a study is accepted
    change: Callable[..., Hypothesis]  # of coordinates; with rounded values if it `is_final`


def propose_explanations(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Explanations of the torques about as good as the best one, simple ones first.

    Of those as simple as each other, the one that predicts best is first. Faults of one record
    follow those of all. The others are rivals.
    """
    found = case.explanations
    if not found:
        return
    good = [_in_words(each) for each in found if each.is_as_good(found[0])]
    good.sort(key=lambda h: (bool(h.excluded), *_complexity(h)))
    rivals = tuple(each.as_rival() for each in good)
    desired = []
    efforts = _motor_torques(case.evidence)
    shares = [share for share, _ in friction_shares(case.evidence).values()]
    if efforts and shares and (share := float(np.median(shares))) < _MIN_FRICTION_OF_GEARS:
        clause = Clause("desired-effort", channels=efforts, share=share)
        desired = [replace(other_meaning(efforts, "desired", clause), rivals=rivals)]
    if good[0].kind == "delay":  # efforts of a set-point are early
        yield from desired
    for each in good:
        others = tuple(  # at another place, or with other values that predict exactly the same
            other
            for other in rivals
            if other.places != each.places
            or (np.isclose(other.cost, each.cost) and other.corrections != each.corrections)
        )
        is_estimated = each.kind in _ESTIMATED and each.factor != -1.0
        yield replace(each, rivals=others, has_estimated_factor=is_estimated)
    yield from desired


def _in_words(each: Hypothesis) -> Hypothesis:
    """The hypothesis with its gain in words; one record with a fault is named."""
    gain = float(np.exp(each.gain.mean if each.gain else 0.0))
    clause = Clause(each.clause.template, **{**dict(each.clause.values), "gain": gain})
    if not each.excluded or each.kind in ("payload", "locked"):
        return replace(each, clause=clause)
    (record,) = each.excluded
    return replace(
        each,
        at=tuple(replace(place, experiments=each.excluded) for place in each.places),
        clause=Clause("record", record=record, fault=clause),
        remedy=Clause("remedy/record", record=record),
    )


def _complexity(each: Hypothesis) -> tuple[int, bool, float]:
    """0 for exchanges, signs, units and axes, 1 for one number, 2 for several.

    Also whether a scale is larger than that of SI units, since small units are the common fault;
    and the cost with the penalty of the Bayesian information criterion for its coordinates.
    """
    is_larger = each.kind == "torque" and abs(each.corrections[0].number) > 1.0
    n = max(each.gain.n_rows, 1.0) if each.gain else 1.0
    cost = each.cost + 0.5 * each.n_coordinates * float(np.log(n)) / n
    return min(max(each.n_coordinates, each.kind == "zero"), 2), is_larger, cost


def _motor_torques(evidence: Evidence) -> tuple[str, ...]:
    names = (f"torque{i + 1}" for i in range(evidence.arm.n_joints))
    return tuple(name for name in names if name in evidence.channels)


def propose_discrete(evidence: Evidence, doubtful: Sequence[str]) -> Iterator[Hypothesis]:
    """Axes, directions of gravity, signs, units, couplings, meanings of efforts, and loads.

    Also reversed and exchanged channels in one of the `doubtful` records.
    """
    arm = evidence.study.arm
    for i, joint in enumerate(arm.joints, start=1):
        names = [n for n in (f"theta_m{i}", f"omega_m{i}") if n in evidence.channels]
        reversed_angle = other_scale(evidence, names[0], -1.0, None, "motion")
        changes, at = scaled(evidence, names, -1.0), reversed_angle.places
        yield replace(reversed_angle, corrections=changes, at=at, kind="angle")
        if joint.motion == "revolute":
            yield from (_zero(evidence, i, np.array([a / _ANGLE_STD])) for a in _QUARTER_TURNS)
        if _torque_scale(evidence, i) is not None:
            yield from (_torque(evidence, i, factor) for factor in _TORQUE_UNITS)
    if not kind_of(arm).places_joints:
        yield from _axes(evidence)
    yield from _gravities(evidence)
    if arm.coupling is not None and arm.is_coupled:
        C = np.array(arm.coupling)
        for other in (np.eye(len(C)), C.T, 2.0 * np.diag(np.diag(C)) - C):
            matrix = tuple(tuple(map(float, row)) for row in other)
            change = Correction("transmission", "", "coupling", matrix)
            clause = Clause("wrong-geometry/coupling", corrected=_text(matrix))
            yield Hypothesis("wrong-geometry", clause, (change,), kind="coupling")
    if (efforts := _motor_torques(evidence)) and arm.gravity:
        yield other_meaning(efforts, "without-gravity", Clause("effort-without-gravity"))
    if all(joint.motion == "revolute" for joint in arm.joints):
        names = [n for n in sorted(evidence.channels) if channel_parts(n)[0] in _ANGLES]
        for unit, factor in (("degrees", np.pi / 180.0), ("turns", 2.0 * np.pi)):
            yield angle_unit(names, unit, scaled(evidence, names, factor), factor)
    yield from _efforts(evidence)
    records = tuple(dict.fromkeys(r.experiment.name for r in evidence.records))
    for locked in dict.fromkeys([records, *((name,) for name in doubtful)]):
        yield Hypothesis(
            "locked-output",
            Clause("locked-output", records=locked),
            remedy=Clause("remedy/locked", records=locked),
            at=(Place(experiments=locked),),
            excluded=locked,
            kind="locked",
            n_coordinates=arm.n_joints,
        )
    for record in doubtful:
        yield Hypothesis(
            "unstated-payload",
            Clause("unstated-payload", record=record),
            remedy=Clause("remedy/payload", record=record),
            at=(Place(experiments=(record,), key="payload"),),
            excluded=(record,),
            kind="payload",
            n_coordinates=N_LINK_PARAMETERS,
        )
        for each in (*_efforts(evidence), *exchanged_joints(evidence)):
            yield replace(each, excluded=(record,))


def _efforts(evidence: Evidence) -> Iterator[Hypothesis]:
    """Reversed and exchanged efforts."""
    joints = range(1, evidence.arm.n_joints + 1)
    for i in joints:
        if (name := effort_channel(evidence.channels, i)) is not None:
            clause = Clause("wrong-sign/torques", joint=i, channel=name)
            change = Correction("channels", name, "scale", -evidence.channel(name).scale)
            yield Hypothesis("wrong-sign", clause, (change,), factor=-1.0, kind="torque")
    for pair in combinations(joints, 2):
        # motor torques can be exchanged without those of the sensors behind the gears
        yield from exchanges(evidence, (EFFORTS[:2], EFFORTS), pair)


def exchanged_joints(evidence: Evidence) -> Iterator[Hypothesis]:
    """Exchanged motor angles, or angles and efforts, of two joints."""
    groups = (_ANGLES, (*_ANGLES, *EFFORTS[:2]), (*_ANGLES, *EFFORTS))
    for pair in combinations(range(1, evidence.arm.n_joints + 1), 2):
        yield from exchanges(evidence, groups, pair)


def _axes(evidence: Evidence) -> Iterator[Hypothesis]:
    """Other axes, or the same in the opposite direction."""
    for i, joint in enumerate(evidence.study.arm.joints, start=1):
        stated, opposite = np.array(joint.axis), tuple(-x for x in joint.axis)
        for axis in dict.fromkeys([opposite, *_DIRECTIONS]):
            change = Correction("joint", str(i), "axis", axis)
            if axis == opposite:
                clause, remedy = Clause("wrong-sign/axis", joint=i), Clause("remedy/axis", joint=i)
                yield Hypothesis("wrong-sign", clause, (change,), remedy, factor=-1.0, kind="axis")
            elif axis @ stated < _EQUAL_DIRECTIONS * np.linalg.norm(stated):
                given = _text(joint.axis)
                clause = Clause("wrong-geometry/axis", joint=i, corrected=_text(axis), stated=given)
                yield Hypothesis("wrong-geometry", clause, (change,), kind="axis")


def _gravities(evidence: Evidence) -> Iterator[Hypothesis]:
    """Other directions of the gravity of chains; gravity of planes, where the study states none."""
    arm = evidence.study.arm
    if "gravity" not in arm_keys(arm) or (arm.n_joints == 1 and not arm.gravity):
        return  # a torque that depends on the angle is not yet one of gravity
    if kind_of(arm).places_joints:
        yield other_gravity(evidence)
        return
    size = arm.gravity_size or _STANDARD_GRAVITY
    stated = np.array(arm.gravity or (0.0, 0.0, 0.0)) / size
    for unit in _DIRECTIONS:
        if unit @ stated < _EQUAL_DIRECTIONS:
            yield _turned(evidence, tuple(size * x for x in unit))


def other_gravity(evidence: Evidence) -> Hypothesis:
    """Gravity of a plane that the study states as horizontal, or none."""
    size = evidence.study.arm.gravity_size
    clause = Clause(
        "wrong-geometry/horizontal" if size else "wrong-geometry/vertical", gravity=size
    )
    change = Correction("arm", "", "gravity", None if size else _STANDARD_GRAVITY)
    return Hypothesis("wrong-geometry", clause, (change,), kind="gravity")


def _turned(evidence: Evidence, gravity: tuple[float, ...]) -> Hypothesis:
    before = _text(evidence.study.arm.gravity)
    change = Correction("arm", "", "gravity", gravity)
    clause = Clause("wrong-geometry/gravity", corrected=_text(gravity), stated=before)
    return Hypothesis("wrong-geometry", clause, (change,), kind="gravity")


def _torque_scale(evidence: Evidence, i: int) -> Correction | None:
    """Stated scale of the torque channel, or the torque constant; None without both."""
    name, constant = f"torque{i}", evidence.study.arm.joints[i - 1].known_torque_per_volt
    if name in evidence.channels:
        return Correction("channels", name, "scale", evidence.channel(name).scale)
    return None if constant is None else Correction("joint", str(i), "torque_per_volt", constant)


def _torque(evidence: Evidence, i: int, factor: float) -> Hypothesis:
    """Another torque constant of one joint that has one, or another unit of its torque."""
    stated = _torque_scale(evidence, i)
    assert stated is not None
    is_unit = abs(abs(np.log10(factor)) - 3.0) < _UNIT_TOLERANCE
    code = "wrong-unit" if is_unit else "wrong-torque-constant"
    clause = Clause(f"{code}/torques", joint=i, factor=factor)
    changes = (replace(stated, value=stated.number * factor),)
    return Hypothesis(code, clause, changes, factor=1.0 / factor, kind="torque")


def propose_families(evidence: Evidence) -> Iterator[HypothesisFamily]:
    """Gravity, ratios, zeros, frames, torques and delays."""
    arm, joints = evidence.study.arm, range(1, evidence.arm.n_joints + 1)
    is_chain = not kind_of(arm).places_joints

    def family(
        change: Callable[..., Hypothesis], tolerated: FloatArray | float, *of: object
    ) -> HypothesisFamily:
        return HypothesisFamily(np.atleast_1d(tolerated), partial(change, evidence, *of))

    if arm.gravity and is_chain:
        yield family(_gravity, np.full(3, _TOLERATED_GRAVITY / _GRAVITY_STD))
    for i in joints:
        yield family(_ratio, _TOLERATED_RATIO / _RATIO_STD, i)
        yield family(_zero, _TOLERATED_ANGLE / _ANGLE_STD, i)
        if is_chain:
            yield family(_frame, _TOLERATED_FRAME, i)
        if _torque_scale(evidence, i) is not None:
            yield family(_constant, _TOLERATED_TORQUE / _RATIO_STD, i)
    if arm.gravity and "link_length" in arm_keys(arm):
        yield family(_length, _TOLERATED_RATIO / _RATIO_STD)
    step = max(r.sample_time for r in evidence.records)
    efforts = [name for i in joints if (name := effort_channel(evidence.channels, i))]
    angles = [[n for n in (f"theta_m{i}", f"omega_m{i}") if n in evidence.channels] for i in joints]
    for names in (efforts, *([name] for name in efforts), *angles):
        yield family(_delay, _TOLERATED_DELAY / step, names, step)


def all_frames(evidence: Evidence) -> HypothesisFamily:
    """The family of the frames of all joints."""
    tolerated = np.tile(_TOLERATED_FRAME, evidence.arm.n_joints)
    return HypothesisFamily(tolerated, partial(_robot, evidence))


def _rounded(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{x:.9g}") for x in values.tolist())


def _gravity(evidence: Evidence, x: FloatArray, *, is_final: bool = False) -> Hypothesis:
    stated = np.array(evidence.study.arm.gravity)
    changed = stated + _GRAVITY_STD * x
    changed *= np.linalg.norm(stated) / np.linalg.norm(changed)
    return _turned(evidence, _rounded(changed))


def _constant(evidence: Evidence, i: int, x: FloatArray, *, is_final: bool = False) -> Hypothesis:
    return _torque(evidence, i, float(np.exp(_RATIO_STD * x[0])))


def _ratio(evidence: Evidence, i: int, x: FloatArray, *, is_final: bool = False) -> Hypothesis:
    """Another gear ratio, finally with a whole reduction if one is near."""
    stated = evidence.study.arm.joints[i - 1].gear_ratio
    ratio = stated * float(np.exp(_RATIO_STD * x[0]))
    ratio = whole_reduction(ratio)[0] if is_final else ratio
    clause = Clause("wrong-gear-ratio/torques", joint=i, corrected=ratio, stated=stated)
    change, factor = Correction("joint", str(i), "gear_ratio", ratio), stated / ratio
    return Hypothesis("wrong-gear-ratio", clause, (change,), factor=factor, kind="ratio")


def _length(evidence: Evidence, x: FloatArray, *, is_final: bool = False) -> Hypothesis:
    """Another distance of the axes of a planar arm."""
    stated = float(np.linalg.norm(evidence.study.arm.joints[1].origin.xyz))
    length = float(f"{stated * np.exp(_RATIO_STD * x[0]):.4g}")
    clause = Clause("wrong-geometry/torques", corrected=length, stated=stated)
    change, factor = Correction("arm", "", "link_length", length), stated / length
    return Hypothesis("wrong-geometry", clause, (change,), factor=factor, kind="length")


def _delay(
    evidence: Evidence, names: Sequence[str], step: float, x: FloatArray, *, is_final: bool = False
) -> Hypothesis:
    """Efforts or motor angles that are late or early; coordinates in units of `step`."""
    delay = step * float(x[0])
    delay = float(f"{delay:.3g}") if is_final else delay
    side = "later" if delay > 0.0 else "earlier"
    return Hypothesis(
        "misaligned",
        Clause("misaligned/motors", channels=tuple(names), delay=abs(delay), side=side),
        of_logs(names, "delay_s", delay),
        Clause("remedy/command"),
        delay_s=delay,
        is_fitted=_is_fitted(evidence, names, "torque-delay"),
        kind="delay",
    )


def _zero(evidence: Evidence, i: int, x: FloatArray, *, is_final: bool = False) -> Hypothesis:
    """Another zero of an encoder, finally a quarter turn if one is near.

    The fit finds that of one of several joints near the stated.
    """
    name, ratio = f"theta_m{i}", evidence.study.arm.joints[i - 1].gear_ratio
    angle = _ANGLE_STD * float(x[0])
    turns = round(angle / _QUARTER_TURNS[0])
    if is_final and turns and abs(angle - turns * _QUARTER_TURNS[0]) < _TOLERATED_ANGLE:
        angle = turns * _QUARTER_TURNS[0]
    change = Correction("channels", name, "offset", evidence.channel(name).offset + angle / ratio)
    is_near = evidence.arm.n_joints == 1 or abs(angle) < _MAX_FITTED_ZERO
    is_fitted = is_near and _is_fitted(evidence, [name], "encoder-zero")
    clause = Clause("wrong-geometry/zero", joint=i, angle=abs(angle))
    return Hypothesis("wrong-zero", clause, (change,), is_fitted=is_fitted, kind="zero")


def _is_fitted(evidence: Evidence, names: Sequence[str], effect: str) -> bool:
    """Whether the fit estimates what would be corrected: an effect of the joints of channels."""
    for joint in (evidence.study.arm.joints[channel_parts(name)[1] - 1] for name in names):
        is_of_rigid = not joint.elastic and effect in OF_RIGID_JOINTS
        if not (joint.selects_effects if is_of_rigid else effect in joint.possible_effects):
            return False
    return True


def _frame(evidence: Evidence, i: int, x: FloatArray, *, is_final: bool = False) -> Hypothesis:
    origin = evidence.study.arm.joints[i - 1].origin
    xyz = np.array(origin.xyz) + _LENGTH_STD * x[:3]
    rpy = np.array(origin.rpy) + _ANGLE_STD * x[3:]
    length = _LENGTH_STD * float(np.linalg.norm(x[:3]))
    angle = _ANGLE_STD * float(np.linalg.norm(x[3:]))
    clause = Clause("wrong-geometry/frame", joint=i, length=length, angle=angle)
    parts, remedy = (("origin.xyz", xyz), ("origin.rpy", rpy)), Clause("remedy/frame")
    changes = tuple(Correction("joint", str(i), key, _rounded(value)) for key, value in parts)
    return Hypothesis("wrong-geometry", clause, changes, remedy, moves_frames=True, kind="frame")


def _robot(evidence: Evidence, x: FloatArray, *, is_final: bool = False) -> Hypothesis:
    """Other frames of all joints."""
    rows = x.reshape(-1, N_FRAME_COORDINATES)
    frames = [_frame(evidence, i, row) for i, row in enumerate(rows, start=1)]
    length = _LENGTH_STD * float(np.linalg.norm(rows[:, :3], axis=1).max())
    angle = _ANGLE_STD * float(np.linalg.norm(rows[:, 3:], axis=1).max())
    place = Place(key="origin" if evidence.study.arm.urdf is None else "urdf")
    return replace(
        frames[0],
        clause=Clause("wrong-geometry/robot", length=length, angle=angle),
        corrections=tuple(change for frame in frames for change in frame.corrections),
        remedy=Clause("remedy/robot"),
        at=(place,),
        kind="robot",
    )


def _text(value: object) -> str:
    """A vector or a matrix as text."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value + 0.0:.4g}" if isinstance(value, float) else "none"  # not -0
