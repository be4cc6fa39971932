"""Final table of a run: the value and the verdict of each parameter.

The latest stage that estimates a parameter decides it, whether or not it identifies a value. A
value is rejected if the input contradicts it, or if it is impossible beyond its interval.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from strainwave.domain.arm.base_parameters import (
    base_parameters,
    link_inertia,
    torque_per_parameter,
)
from strainwave.domain.arm.combinations import (
    LINK_INERTIA,
    change_from,
    inertias_of_links,
    lumped_inertias,
)
from strainwave.domain.arm.description import ArmDescription
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.link_sensors import constant_of, key_texts, link_channel_kinds
from strainwave.domain.arm.parameter_table import VISCOUS, base_name, family_of, parameter_table
from strainwave.domain.keys import Key, Row
from strainwave.domain.messages import Clause
from strainwave.domain.results.arm_model import ArmModel
from strainwave.domain.results.consistency import Suspicion
from strainwave.domain.results.estimates import Parameter, is_physical, physical_range
from strainwave.domain.results.signals import Activity
from strainwave.domain.results.stage_results import JointModel, StageResults
from strainwave.domain.study import Study, channel_parts

_RIGID, _DECOUPLED, _TUNED, _NONE = range(4)
_STAGE_OF_USE = {"motion": _RIGID, "frequency": _DECOUPLED, "sweep": _DECOUPLED, "tuning": _TUNED}
_MOTOR_CHANNELS = frozenset({"u", "torque", "theta_m", "omega_m", "ref"})
# share of a joint's rms torque below which the half-width of a confidence interval is negligible
_MAX_NEGLIGIBLE_SHARE = 0.02
# half-width of the interval of a sensor's place, whose zero is arbitrary
_MAX_PLACE_HALF_WIDTH = {"m": 0.01, "rad": 0.05}
_FAULT_REASON = Clause("reason/fault")
_CONTRADICTION_REASON = Clause("reason/contradiction")
_FRICTIONS = (
    "motor_viscous_friction",
    "link_viscous_friction",
    "total_viscous_friction",
    "motor_coulomb_friction",
    "friction_offset",
)
_FIRST_ROWS = (
    "torque_per_volt",
    "rigid_inertia",
    "inertia",
    "motor_inertia",
    "link_inertia",
    *_FRICTIONS,
    "friction_settling_time",
)
"""First rows of each joint in the table; the other parameters follow in the order of the core."""


@dataclass(frozen=True, slots=True)
class Decision:
    """One row of the final table."""

    parameter: Parameter  # value None if not identified or rejected
    identified: bool = False
    rejected: Clause | None = None  # the first reason for the rejection; None: not rejected
    raw: float | None = None  # rejected value

    def reject(self, reason: Clause) -> Decision:
        """The row, rejected for the first reason."""
        return self if self.rejected else replace(self, rejected=reason)


_Table = dict[Key, Decision]


def decide(results: StageResults) -> tuple[Decision, ...]:
    """Combine the estimates of all stages into the final table.

    Estimates that depend on faults of the input are rejected. Without the rms motion of the joints
    (`activity`), no confidence interval is considered negligible. Returns one decision for each
    parameter and joint: parameters of the whole arm first, then joint by joint.
    """
    study, rigid, whole_arm = results.study, results.rigid, results.whole_arm
    first_affected = min(
        (first_affected_stage(each, study) for each in results.suspected if not each.accepted),
        default=_NONE,
    )
    table: _Table = {}
    if rigid is not None:
        further = [p for term in rigid.friction_terms for p in term.parameters]
        reason = _FAULT_REASON if first_affected <= _RIGID else None
        table = {p.key: Decision(p, rejected=reason) for p in (*rigid.parameters, *further)}
    accepted: list[JointModel] = []
    if first_affected <= _DECOUPLED:
        for p in (p for joint in results.joints for p in joint.parameters):
            table.setdefault(p.key, Decision(p, rejected=_FAULT_REASON))
    else:
        accepted = [_at_zero_angles(joint, table, study.arm) for joint in results.joints]
        for p in (p for joint in accepted for p in joint.parameters):
            if p.key not in table or not _is_impossible(p):
                table[p.key] = Decision(p)
    for torsion in results.torsions:
        entry = Decision(torsion.stiffness)
        is_faulty = first_affected <= _DECOUPLED
        table.setdefault(torsion.stiffness.key, entry.reject(_FAULT_REASON) if is_faulty else entry)
    if whole_arm is not None:
        _enter_whole_arm(table, whole_arm, first_affected)
        _remove_equivalent_stiffness(table, study)
    else:
        _make_consistent(table, study.arm, accepted)
    _reject_contradictions(table, study.arm)
    for key, entry in table.items():
        channel = study.channels.get(f"torque{key[1]}")
        is_calculated = channel is not None and channel.meaning in ("without-friction", "desired")
        if is_calculated and key[0] in _FRICTIONS:  # the model that calculates it has no friction
            table[key] = entry.reject(Clause("reason/calculated-effort"))
    drives = {p.key: Decision(p) for p in results.drive_gains}
    levels_by_joint = {level.joint: level for level in results.activity}
    rows = [_decide_row(entry, study, levels_by_joint) for entry in (drives | table).values()]
    order = list(dict.fromkeys([*_FIRST_ROWS, *parameter_table()]))

    def place(row: Decision) -> tuple[int, int]:
        """Sort key: parameters of the whole arm first, then joint by joint."""
        name = base_name(row.parameter.name)
        return row.parameter.joint or 0, order.index(name) if name in order else len(order)

    return tuple(sorted(rows, key=place))


def first_affected_stage(suspicion: Suspicion, study: Study) -> int:
    """First stage that a suspected fault affects: 0 rigid, 1 decoupled, 2 tuned, 3 none.

    The rigid step uses only motor signals of `motion` records. The decoupled step also uses link
    signals and the fast records. A fault of motor signals, or without a known channel, affects all
    stages.
    """
    places = suspicion.places
    kinds = {channel_parts(place.channel)[0] for place in places if place.channel is not None}
    is_on_link = (
        not kinds.isdisjoint(link_channel_kinds())
        or any(place.key in ("link_length", *key_texts()) for place in places)
        or suspicion.code == "wrong-geometry"
    )
    is_on_motor = not kinds.isdisjoint(_MOTOR_CHANNELS)
    channel_stage = _DECOUPLED if is_on_link and not is_on_motor else _RIGID
    uses = {e.name: e.use for e in study.experiments}
    record_stages = [
        _STAGE_OF_USE.get(uses[name], _NONE) for place in places for name in place.experiments
    ]
    return max(channel_stage, min(record_stages, default=_RIGID))


def _enter_whole_arm(table: _Table, whole_arm: ArmModel, first_affected: int) -> None:
    """Enter the estimates of the whole-arm fit, identified or not, into the table.

    If the stages contradict each other in inertias or gravity torques, the torque of a joint is
    wrong. All values are then rejected, because all joints share the inertias of the arm.
    """
    if first_affected <= _TUNED:
        for p in whole_arm.parameters:
            table.setdefault(p.key, Decision(p, rejected=_FAULT_REASON))
        return
    bounded = set(whole_arm.at_bounds)
    for p in whole_arm.parameters:
        reason = Clause("reason/at-bound", value=p.value or 0.0, unit=p.unit)
        table[p.key] = Decision(p, rejected=reason if p.key in bounded else None)
    if whole_arm.contradictions:
        table.update({key: row.reject(_CONTRADICTION_REASON) for key, row in table.items()})


def _at_zero_angles(model: JointModel, table: _Table, arm: ArmDescription) -> JointModel:
    """The joint model with its `link_inertia` at zero angles, by the base parameters of the table.

    None if one of them is unknown.
    """
    row = change_from(arm, model.joint, model.posture) if model.posture else {}
    if not row:
        return model
    weights = base_parameters(arm).weights(row)
    change = [(weight, _accepted_estimate(table, key)) for key, weight in weights.items()]
    parameters = {p.name: p for p in model.parameters}
    own = parameters[LINK_INERTIA]
    at_zero = _weighted_sum(own.key, [(1.0, own), *change])
    parameters[LINK_INERTIA] = at_zero or replace(own, value=None, std=None, ci95=None)
    return replace(model, parameters=tuple(parameters.values()))


def _make_consistent(
    table: _Table, arm: ArmDescription, joint_models: Sequence[JointModel]
) -> None:
    """Compute base parameters and rigid inertias from the inertias of the joint models.

    For two links, beta = m_L2, alpha = m_L1 - beta - 2 gamma, and the rigid inertia is alpha +
    m_M1 / n_1^2, see (3) and (16). The correlation between the errors of the stages is unknown.
    Standard deviations are therefore added, which is an upper bound.
    """
    joint_estimates: dict[Key, Parameter] = {
        (p.name, model.joint): p for model in joint_models for p in model.parameters
    }

    def parts(row: Row) -> list[tuple[float, Parameter | None]]:
        return [
            (w, joint_estimates.get(key) or _accepted_estimate(table, key))
            for key, w in row.items()
        ]

    derived_rows: dict[Key, Row] = {}
    for key, row in inertias_of_links(arm):
        parameter = _weighted_sum(key, parts(row))
        if len(row) == 1:  # a joint's parameter under its name in the whole arm
            ((_, own),) = parts(row)
            parameter = own and replace(own, name=key[0], joint=key[1])
        if parameter is not None and key not in row:
            table[key], derived_rows[key] = Decision(parameter), row
    for key, row in lumped_inertias(arm).items():
        if derived_rows.keys().isdisjoint(row):
            continue
        expanded_row = {
            k: w * v
            for part, w in row.items()
            for k, v in derived_rows.get(part, {part: 1.0}).items()
        }
        total = _weighted_sum(key, parts(expanded_row))
        if total is not None:
            table[key] = Decision(total)


def _accepted_estimate(table: _Table, key: Key) -> Parameter | None:
    entry = table.get(key)
    return entry.parameter if entry is not None and not entry.rejected else None


def _weighted_sum(key: Key, parts: Sequence[tuple[float, Parameter | None]]) -> Parameter | None:
    """Weighted sum with added standard deviations; None if a part is missing."""
    value = std = 0.0
    for weight, p in parts:
        if p is None or p.value is None or p.std is None:
            return None
        value += weight * p.value
        std += abs(weight) * p.std
    return Parameter.estimated(key, value, std, "kg m^2", "decoupled")


def _remove_equivalent_stiffness(table: _Table, study: Study) -> None:
    """Remove the equivalent stiffness of joints whose stiffness curve was fitted."""
    for number, joint in enumerate(study.arm.joints, start=1):
        names = joint.law.names
        if STIFFNESS not in names and any((name, number) in table for name in names):
            table.pop((STIFFNESS, number), None)


def _reject_contradictions(table: _Table, arm: ArmDescription) -> None:
    accepted = [e.parameter for e in table.values() if not e.rejected]
    values = {p.key: p.value for p in accepted if p.value is not None}
    for key, reason in kind_of(arm).contradictions(values).items():
        table[key] = replace(table[key], rejected=reason)


def _decide_row(entry: Decision, study: Study, levels: Mapping[int, Activity]) -> Decision:
    """Decide one row: accept its value, set it to the bound of zero, or reject it."""
    p, reason = entry.parameter, entry.rejected
    if not reason and p.value is not None and not is_physical(p.name, p.value):
        if _is_impossible(p) or p.ci95 is None:
            reason = Clause("reason/impossible", value=p.value, unit=p.unit)
        else:
            zero = Parameter.at_zero(p.key, p.ci95[1], p.unit, p.stage)
            # a part of the total viscous friction has no value instead: the sum must remain
            p = replace(zero, model_std=p.model_std, value=None if p.name in VISCOUS else 0.0)
    if p.value is None or reason:
        without_value = replace(p, value=None, std=None, ci95=None, model_std=None)
        # a parameter without a value is not identified instead of rejected
        rejected = reason if p.value is not None else None
        return Decision(without_value, identified=False, rejected=rejected, raw=p.value)
    return Decision(p, identified=is_identified(p, study.arm, levels))


def _is_impossible(p: Parameter) -> bool:
    """Whether a value is physically impossible beyond its interval.

    Inertia, friction and damping have a bound of zero. A value that crosses it by less than its
    interval is zero with a one-sided interval.
    """
    if p.value is None or is_physical(p.name, p.value):
        return False
    may_vanish = physical_range(p.name) == "non-negative" or family_of(p.name) == "inertia"
    return not may_vanish or p.ci95 is None or p.ci95[1] <= 0.0


def half_width(p: Parameter) -> float | None:
    """Half-width of the 95 % confidence interval, or its width if it is one-sided."""
    if p.ci95 is None:
        return None
    width = p.ci95[1] - p.ci95[0]
    return width if p.value in p.ci95 else 0.5 * width


def is_identified(p: Parameter, arm: ArmDescription, levels: Mapping[int, Activity]) -> bool:
    """Whether the half-width of the interval is below the value, or negligible.

    It is negligible if it contributes less than 2 % to the torque of every joint. `levels` maps
    joints to their rms motion.
    """
    half = half_width(p)
    if p.value is None or half is None or not half < math.inf:
        return False
    if constant_of(p.key) is not None and p.unit in _MAX_PLACE_HALF_WIDTH:
        return half < _MAX_PLACE_HALF_WIDTH[p.unit]
    return half < abs(p.value) or (
        max(_torque_shares(p, arm, levels), default=math.inf) * half < _MAX_NEGLIGIBLE_SHARE
    )


def _torque_shares(
    p: Parameter, arm: ArmDescription, levels: Mapping[int, Activity]
) -> Iterator[float]:
    """Motor torque per unit of a parameter, over the rms torque, for each joint it acts on."""
    of_link = _motion_per_unit(p, arm)
    of_chain = _torque_per_base_parameter(p, arm, levels)
    for number in [p.joint] if p.joint and not of_chain else sorted(levels):
        level = levels.get(number)
        if level is None or level.torque <= 0.0:
            continue
        ratio = abs(arm.joints[number - 1].gear_ratio)
        n2 = ratio**2
        per_unit = {
            "motor_coulomb_friction": 1.0,
            "friction_offset": 1.0,
            "motor_viscous_friction": level.velocity,
            "total_viscous_friction": level.velocity,
            "link_viscous_friction": n2 * level.velocity,
            "gear_damping": n2 * level.velocity,  # upper bound: link at rest
        }.get(p.name)
        if number in of_link:
            reflected = ratio if family_of(p.name) == "gravity" else n2 * level.acceleration
            per_unit = of_link[number] * reflected
        per_unit = of_chain.get(number, per_unit)
        if per_unit is not None:
            yield per_unit / level.torque


def _motion_per_unit(p: Parameter, arm: ArmDescription) -> dict[int, float]:
    """Largest torque at the links per unit of a parameter that may have either sign, by joint.

    It is that of a stretched arm, for unit acceleration. A gravity torque acts on the joints up to
    that of its link.
    """
    if p.joint is not None or physical_range(p.name) != "any":
        return {}
    if family_of(p.name) == "gravity":
        row = kind_of(arm).standard_rows(arm).get(p.key, {})
        last = min((joint for _, joint in row if joint is not None), default=0)
        return dict.fromkeys(range(1, last + 1), 1.0)
    joints = range(1, arm.n_joints + 1)
    weight = max(abs(link_inertia(arm, joint).get(p.key, 0.0)) for joint in joints)
    return dict.fromkeys(joints, weight)


def _torque_per_base_parameter(
    p: Parameter, arm: ArmDescription, levels: Mapping[int, Activity]
) -> dict[int, float]:
    """Rms motor torque per unit of a base parameter of a chain, by joint; else nothing.

    The postures are random, and rates and accelerations those of the records.
    """
    base = base_parameters(arm)
    at = {column.key: k for k, column in enumerate(base.columns)}.get(p.key)
    if at is None or not base.has_groups:
        return {}
    motion = [
        [
            getattr(levels[i], quantity) * abs(arm.joints[i - 1].gear_ratio) if i in levels else 0.0
            for i in range(1, arm.n_joints + 1)
        ]
        for quantity in ("velocity", "acceleration")
    ]
    torques = torque_per_parameter(arm, *motion)[:, at]
    return dict(enumerate(torques.tolist(), start=1))
