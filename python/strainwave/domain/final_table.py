"""Which stage decides each parameter, and what it decides: the final table of a run.

A later stage's value, and its refusal, win over an earlier stage's. A fit that holds an impossible
value decides nothing: its values are rejected, and what an earlier stage gave stands. A value that
rests on channels at fault, or on stages that contradict each other, is rejected as well.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from strainwave.domain.arm import ArmDescription
from strainwave.domain.arm_model import ArmModel, contradictions
from strainwave.domain.combinations import lumped_inertias
from strainwave.domain.estimates import Parameter, Suspicion
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.joint_models import JointModel
from strainwave.domain.kinds import Key, Row, kind_of
from strainwave.domain.parameter_table import base_name, parameter_table
from strainwave.domain.ranges import is_physical, physical_range
from strainwave.domain.rigid_model import RigidModel
from strainwave.domain.signals import Activity
from strainwave.domain.study import Study

MAX_EFFECT_SHIFT = 0.05
"""Share of a value by which an effect that the model lacks may move it: beyond it, and beyond the
interval, the value is rejected."""

_RIGID, _DECOUPLED, _TUNED, _NONE = range(4)
_STAGE_OF_USE = {"motion": _RIGID, "frequency": _DECOUPLED, "sweep": _DECOUPLED, "tuning": _TUNED}
_LINK_SIDE = re.compile(
    r"(?:a[xyz]?|g[xyz]|gyro|theta_l|deflection)\d+|accelerometer_(?:distance|hz)|gyro_hz|"
    r"link_length|link_encoder_counts|imu"
)
_MOTOR_SIDE = re.compile(r"(?:u|torque|theta_m|omega_m|ref)\d+")
_SURELY = 2.0  # standard deviations beyond which a value of the wrong sign is no chance
_NOTHING = 0.02  # share of a joint's torque below which an interval counts as nearly nothing
_REACH = 1.96  # of a 95 % interval, in standard deviations
_FAULT = "it rests on channels that contradict one another or the study"
_CONTRADICTED = "the rigid and the whole-arm fit contradict each other"
_WRONG_MODEL = "the decoupled fit of the joint holds an impossible value"
_SPLIT = ("motor_viscous_friction", "link_viscous_friction")
_FIRST_OF_A_JOINT = (
    "rigid_inertia",
    "inertia",
    "motor_inertia",
    "link_inertia",
    "motor_viscous_friction",
    "link_viscous_friction",
    "total_viscous_friction",
    "motor_coulomb_friction",
    "friction_offset",
    "friction_settling_time",
)
"""The order of a table's rows; all others follow as the core has them."""


@dataclass(frozen=True, slots=True)
class Decision:
    """One row of the final table."""

    parameter: Parameter  # value None where it is not identified or rejected
    identified: bool
    rejected: str = ""  # why a value that a stage gave does not count; empty: none was
    raw: float | None = None  # the value that was rejected


@dataclass(frozen=True, slots=True)
class _Entry:
    parameter: Parameter
    rejected: str = ""


_Table = dict[Key, _Entry]


def decide(
    study: Study,
    rigid: RigidModel | None,
    joints: Sequence[JointModel],
    tuned: ArmModel | None,
    suspected: Sequence[Suspicion] = (),
    activity: Sequence[Activity] = (),
) -> tuple[Decision, ...]:
    """The final table: the arm's own parameters first, then joint by joint.

    Parameters
    ----------
    study : Study
    rigid : RigidModel or None
    joints : sequence of JointModel
        Of the decoupled stage.
    tuned : ArmModel or None
    suspected : sequence of Suspicion
        Faults of the input; values that rest on them are rejected.
    activity : sequence of Activity
        Of each joint in the fitted records; without it no interval counts as nearly nothing.

    Returns
    -------
    tuple of Decision
        Every name and joint once.
    """
    faulty = min((first_faulty(one, study) for one in suspected), default=_NONE)
    table: _Table = {}
    if rigid is not None:
        table = _plausible(rigid.parameters, "rigid", spread_to_all=False)
    if faulty <= _RIGID:
        table = _all_rejected(table.values(), _FAULT)
    decided = [one for one in joints if not _discard(table, one, faulty)]
    for joint in decided:
        table.update({_key(p): _Entry(p) for p in joint.parameters})
    if tuned is not None:
        _take_tuned(table, tuned, faulty)
    else:
        _make_consistent(table, study.arm, decided)
    _one_spring(table, study, tuned is not None)
    _check_body(table)
    levels = {one.joint: one for one in activity}
    rows = [_decision(entry, study, levels) for entry in table.values()]
    names = dict.fromkeys([*_FIRST_OF_A_JOINT, *parameter_table()])
    order = {name: place for place, name in enumerate(names)}

    def place(row: Decision) -> tuple[int, int]:
        """The arm's own first, then joint by joint."""
        return row.parameter.joint or 0, order.get(base_name(row.parameter.name), len(order))

    return tuple(sorted(rows, key=place))


def first_faulty(suspicion: Suspicion, study: Study) -> int:
    """The first stage that rests on what is suspected: 0 rigid, 1 decoupled, 2 tuned, 3 none.

    The rigid step uses motor signals of `motion` records only, the decoupled step link signals too
    and the fast records; a fault of motor signals or of no named place touches everything.

    Parameters
    ----------
    suspicion : Suspicion
    study : Study

    Returns
    -------
    int
    """
    words = re.findall(r"[A-Za-z0-9_]+", suspicion.where)
    links = any(_LINK_SIDE.fullmatch(word) for word in words) or suspicion.code == "wrong-geometry"
    motors = any(_MOTOR_SIDE.fullmatch(word) for word in words)
    of_channel = _DECOUPLED if links and not motors else _RIGID
    names = {e.name: e.use for e in study.experiments}
    whole = re.split(r"[,;:\s]+", suspicion.where)
    uses = [_STAGE_OF_USE.get(names[word], _NONE) for word in whole if word in names]
    return max(of_channel, min(uses, default=_RIGID))


def _key(parameter: Parameter) -> Key:
    return parameter.name, parameter.joint


def _impossible(parameters: Iterable[Parameter]) -> list[Parameter]:
    """Values of the wrong sign beyond their uncertainty."""
    return [
        p
        for p in parameters
        if p.value is not None
        and not is_physical(p.name, p.value)
        and p.value + _SURELY * (p.std or 0.0) < 0.0
    ]


def _plausible(parameters: Sequence[Parameter], stage: str, *, spread_to_all: bool) -> _Table:
    """A stage's values; with an impossible one those of its joint, and the arm's, are rejected."""
    wrong = _impossible(parameters)
    if not wrong:
        return {_key(p): _Entry(p) for p in parameters}
    first = wrong[0]
    why = f"the {stage} fit gives {first.label} = {first.value:.3g} {first.unit}, which no arm has"
    touched = {p.joint for p in wrong} | {None}
    everything = spread_to_all or None in {p.joint for p in wrong}
    return {_key(p): _Entry(p, why if everything or p.joint in touched else "") for p in parameters}


def _all_rejected(entries: Iterable[_Entry], why: str) -> _Table:
    return {_key(e.parameter): replace(e, rejected=why) for e in entries}


def _discard(table: _Table, joint: JointModel, faulty: int) -> bool:
    """Whether a joint's decoupled fit decides nothing; its own parameters are then rejected."""
    own = _plausible(joint.parameters, "decoupled", spread_to_all=True)
    if faulty <= _DECOUPLED:
        own = _all_rejected(own.values(), _FAULT)
    elif joint.status == "implausible":
        whys = {e.rejected for e in own.values()} - {""}
        own = _all_rejected(own.values(), next(iter(whys), _WRONG_MODEL))
    if not any(entry.rejected for entry in own.values()):
        return False
    for key, entry in own.items():
        table.setdefault(key, entry)
    return True


def _take_tuned(table: _Table, tuned: ArmModel, faulty: int) -> None:
    """What the whole-arm fit says of all it estimates, values and refusals.

    Where the stages contradict each other in inertias or gravity torques, some joint's torque is
    not what it is taken for, and all joints share the arm's inertias: nothing counts. Where only
    frictions differ, another law of friction is the likeliest, which leaves the rest alone.
    """
    if faulty <= _TUNED:
        for p in tuned.parameters:
            table.setdefault(_key(p), _Entry(p, _FAULT))
        return
    bounded = set(tuned.at_bounds)
    for p in tuned.parameters:
        at_end = f"the fit ended at the end of its range, {p.value or 0.0:.3g} {p.unit}"
        table[_key(p)] = _Entry(p, at_end if _key(p) in bounded else "")
    for key, why in _moved_by_effects(tuned).items():
        if key in table and not table[key].rejected:
            table[key] = replace(table[key], rejected=why)
    far = contradictions(tuned.agreement)
    rubbing = {test.joint for test in far if test.scope == "friction"}
    torques = any(test.scope == "inertias" for test in far)
    for key, entry in table.items():
        friction = "friction" in entry.parameter.name and entry.parameter.joint in rubbing
        if (torques or friction) and not entry.rejected:
            table[key] = replace(entry, rejected=_CONTRADICTED)


def _moved_by_effects(tuned: ArmModel) -> dict[Key, str]:
    """Values that an effect which the residuals show would move by more than their errors."""
    moved: dict[Key, str] = {}
    for cause in tuned.criticism.causes if tuned.criticism else ():
        why = (
            f"{cause.effect} of joint {cause.joint}, which explains part of the residuals, would"
            f" move it out of its interval and by more than {100.0 * MAX_EFFECT_SHIFT:.0f} %"
        )
        for each in cause.shifts:
            large = abs(each.shift) > MAX_EFFECT_SHIFT * abs(each.without)
            if large and abs(each.deviations) > _REACH:
                moved.setdefault((each.name, each.joint), why)
    return moved


def _make_consistent(table: _Table, arm: ArmDescription, decided: Sequence[JointModel]) -> None:
    """Inertias of the links, and those that have motors' in them, follow from the joints' models.

    Of two links beta = m_L2, alpha = m_L1 - beta - 2 gamma and the rigid inertia, alpha +
    m_M1 / n_1^2: (3) and (16). Errors of the stages are correlated in ways that nobody knows:
    standard deviations are added, an upper bound.
    """
    of_joints: dict[Key, Parameter] = {
        (p.name, one.joint): p for one in decided for p in one.parameters
    }

    def parts(row: Row) -> list[tuple[float, Parameter | None]]:
        known = ((w, of_joints.get(k) if k[1] else _published(table, k)) for k, w in row.items())
        return list(known)

    follows: dict[Key, Row] = {}
    for key, row in kind_of(arm).from_link_inertias:
        found = _renamed(key, parts(row)) if len(row) == 1 else _sum(*key, parts(row))
        if found is not None and key not in row:
            table[key], follows[key] = _Entry(found), row
    for key, row in lumped_inertias(arm).items():
        if follows.keys().isdisjoint(row):
            continue
        spelt = {
            k: w * v for part, w in row.items() for k, v in follows.get(part, {part: 1.0}).items()
        }
        total = _sum(*key, parts(spelt))
        if total is not None:
            table[key] = _Entry(total)


def _renamed(key: Key, parts: Sequence[tuple[float, Parameter | None]]) -> Parameter | None:
    """A parameter under the name that it has of the arm."""
    (_, own), *_ = parts
    return None if own is None else replace(own, name=key[0], joint=key[1])


def _published(table: _Table, key: Key) -> Parameter | None:
    entry = table.get(key)
    return entry.parameter if entry is not None and not entry.rejected else None


def _sum(
    name: str, joint: int | None, parts: Sequence[tuple[float, Parameter | None]]
) -> Parameter | None:
    """A weighted sum, its standard deviation the sum of theirs; None where one is not there."""
    value = std = 0.0
    for weight, p in parts:
        if p is None or p.value is None or p.std is None:
            return None
        value += weight * p.value
        std += abs(weight) * p.std
    interval = (value - _REACH * std, value + _REACH * std)
    return Parameter(name, joint, value, std, "kg m^2", "decoupled", interval)


def _one_spring(table: _Table, study: Study, reached: bool) -> None:
    """One equivalent stiffness does not stand beside the parameters of a curve that was fitted."""
    for number, joint in enumerate(study.arm.joints, start=1):
        own = joint.law.names
        if reached and STIFFNESS not in own and any((name, number) in table for name in own):
            table.pop((STIFFNESS, number), None)


def _check_body(table: _Table) -> None:
    """Reject gamma unless alpha beta > gamma^2: else some posture's inertia is not positive."""
    body = [_published(table, (name, None)) for name in ("alpha", "beta", "gamma")]
    if any(p is None or p.value is None for p in body):
        return
    alpha, beta, gamma = (p.value for p in body if p is not None and p.value is not None)
    if alpha > 0.0 and beta > 0.0 and gamma**2 >= alpha * beta:
        entry = table["gamma", None]
        table["gamma", None] = replace(
            entry, rejected=f"gamma^2 = {gamma**2:.3g} is not below alpha beta = {alpha * beta:.3g}"
        )


def _decision(entry: _Entry, study: Study, levels: Mapping[int, Activity]) -> Decision:
    """One row, with its value if that counts."""
    p, why = entry.parameter, entry.rejected
    if p.value is not None and not why and not is_physical(p.name, p.value):
        nearest = _at_zero(p, study, levels)
        if nearest is not None:
            return Decision(nearest, identified=True)
        why = f"{p.value:.3g} {p.unit} is no value that an arm has"
    if p.value is None or why:
        empty = replace(p, value=None, std=None, ci95=None)
        # a refusal is no value that could be rejected
        return Decision(
            empty, identified=False, rejected=why if p.value is not None else "", raw=p.value
        )
    return Decision(p, identified=_is_identified(p, study, levels))


def _at_zero(p: Parameter, study: Study, levels: Mapping[int, Activity]) -> Parameter | None:
    """Zero, for a friction or damping that is zero within its uncertainty and nearly nothing."""
    if physical_range(p.name) != "non-negative" or p.name in _SPLIT:
        return None  # the parts of a sum stay as they are, or are not there
    if p.value is None or p.ci95 is None or p.ci95[1] < 0.0:
        return None
    if not _is_nothing(p, study, levels):
        return None
    return replace(p, value=0.0, ci95=(0.0, p.ci95[1]))


def half_width(p: Parameter) -> float | None:
    """Half of the 95 % interval; None where there is none."""
    return None if p.ci95 is None else 0.5 * (p.ci95[1] - p.ci95[0])


def _is_identified(p: Parameter, study: Study, levels: Mapping[int, Activity]) -> bool:
    half = half_width(p)
    if p.value is None or half is None or not half < float("inf"):
        return False
    return half < abs(p.value) or _is_nothing(p, study, levels)


def _is_nothing(p: Parameter, study: Study, levels: Mapping[int, Activity]) -> bool:
    """Whether the interval's half-width makes less than 2 % of every torque that it is in."""
    half = half_width(p)
    shares = list(_torque_shares(p, study, levels))
    return half is not None and bool(shares) and max(shares) * half < _NOTHING


def _torque_shares(p: Parameter, study: Study, levels: Mapping[int, Activity]) -> Iterator[float]:
    """Of each joint that a parameter acts on, its torque at the motor per unit, over the rms."""
    gravity = re.fullmatch(r"gravity_torque_(\d+)", p.name)
    for number in [p.joint] if p.joint else sorted(levels):
        level = levels.get(number)
        if level is None or level.torque <= 0.0:
            continue
        n2 = study.arm.joints[number - 1].gear_ratio ** 2
        per_unit = {
            "motor_coulomb_friction": 1.0,
            "friction_offset": 1.0,
            "motor_viscous_friction": level.velocity,
            "total_viscous_friction": level.velocity,
            "link_viscous_friction": n2 * level.velocity,
            "gear_damping": n2 * level.velocity,  # as if the link stood still: no less
            "gamma": 2.0 * n2 * level.acceleration,
        }.get(p.name)
        if gravity and number <= int(gravity[1]):
            per_unit = abs(study.arm.joints[number - 1].gear_ratio)
        if per_unit is not None:
            yield per_unit / level.torque
