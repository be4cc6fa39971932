"""Causes in measured channels: exchanges, units, signs, scales, delays, AC coupling."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from strainwave.domain import Clause, Correction, channel_parts
from strainwave.domain.corrections import exchange_corrections
from strainwave.signals.consistency.causes.case import (
    MAX_FACTOR_DIFFERENCE,
    MIN_RATIO,
    MOTOR_SIDE,
    UNIT_TOLERANCE,
    Case,
    Cause,
    Unit,
    log_corrections,
    match_known_factor,
    places_of,
)
from strainwave.signals.consistency.causes.commands import VOLTAGES
from strainwave.signals.consistency.evidence import Evidence
from strainwave.signals.consistency.motors import effort_channel
from strainwave.signals.consistency.sensors import (
    LINK_CHANNELS,
    STANDARD_GRAVITY,
    estimate_high_pass_cutoff,
)

_DEGREE = float(np.pi / 180.0)  # [rad]
# Ratios of encoder counts to encoder lines, and their inverses.
_QUADRATURE_FACTORS = (4.0, 2.0, 0.5, 0.25)
# Smallest number of counts per turn of an encoder whose scale is 2 pi over a power of two.
_MIN_POWER_COUNTS = 8.0

_ANGLES: Mapping[Unit, float] = {"degrees": _DEGREE, "turns": 2.0 * np.pi, "mrad": 1e-3}
_RATES: Mapping[Unit, float] = {"deg/s": _DEGREE, "rpm": np.pi / 30.0, "turns/s": 2.0 * np.pi}
_ACCELERATION_UNITS: Mapping[Unit, float] = {
    "g": STANDARD_GRAVITY,
    "mm/s^2": 1e-3,
    "cm/s^2": 1e-2,
    "mg": 1e-3 * STANDARD_GRAVITY,
}
_GYRO_UNITS: Mapping[Unit, float] = {"deg/s": _DEGREE, "mrad/s": 1e-3, "rpm": np.pi / 30.0}
_UNITS: Mapping[str, Mapping[Unit, float]] = {
    "a": _ACCELERATION_UNITS,
    "gyro": _GYRO_UNITS,
    **dict.fromkeys(("ax", "ay", "az"), _ACCELERATION_UNITS),
    **dict.fromkeys(("gx", "gy", "gz"), _GYRO_UNITS),
    "theta_l": _ANGLES,
    "omega_m": _RATES,
    "ref": _RATES,
    "u": VOLTAGES,
    "torque": {"mN m": 1e-3},
}
"""Non-SI units of each kind of channel and their scale to SI."""
_BASIS = {  # kind of channel -> signals that determine its scale
    **dict.fromkeys(LINK_CHANNELS, "motor-angle"),
    "omega_m": "motor-angle",
    "ref": "motor-angle",
    "u": "servo",
    "torque": "motion",
}
_ACCELERATIONS = ("a", "ax", "ay", "az")
_LINK_SIDE = (*LINK_CHANNELS, "deflection")


def propose_exchanges(case: Case) -> Iterator[Cause]:
    """Exchanged columns of two joints, of which one has contradictions if any joint has.

    All kinds, one side, one kind, or all kinds but one are exchanged.
    """
    channels = case.evidence.channels
    for first, second in combinations(range(1, case.evidence.arm.n_joints + 1), 2):
        if case.joints and case.joints.isdisjoint((first, second)):
            continue
        motors, links = (
            [kind for kind in side if {f"{kind}{first}", f"{kind}{second}"} <= channels]
            for side in (MOTOR_SIDE, _LINK_SIDE)
        )
        kinds = motors + links
        groups = [kinds, motors, links, *([kind] for kind in kinds)]
        groups += [[kind for kind in kinds if kind != left] for left in kinds]
        for group in dict.fromkeys(tuple(group) for group in groups if group):
            yield _exchange(case, group, (first, second))


def _exchange(case: Case, kinds: Sequence[str], joints: tuple[int, int]) -> Cause:
    """Exchanged columns of two joints."""
    pairs = tuple((f"{kind}{joints[0]}", f"{kind}{joints[1]}") for kind in kinds)
    places = places_of(name for pair in pairs for name in pair)
    corrections = exchange_corrections(pairs, case.evidence.study)
    clause = Clause("swapped-channels", pairs=pairs, joints=joints)
    if len(pairs) == 1:
        (names,), (joint, other_joint) = pairs, joints
        clause = Clause(
            "swapped-channels/one-kind",
            first=names[0],
            second=names[1],
            joint=joint,
            other=other_joint,
        )
    return Cause("swapped-channels", places, clause, corrections)


def propose_angle_units(case: Case) -> Iterator[Cause]:
    """Motor angles of all joints in another unit, alone or with their velocities."""
    evidence = case.evidence
    joints = range(1, evidence.arm.n_joints + 1)
    angles = [f"theta_m{joint}" for joint in joints]
    doubts = case.contradicts("torque-prediction", "speed")
    if (len(angles) < 2 and not doubts) or not (case.joints or doubts):
        return
    rates = [f"{kind}{joint}" for kind in ("omega_m", "ref") for joint in joints]
    rates = [name for name in rates if name in evidence.channels]
    for unit in _angle_scales(evidence, angles[0]):
        scales = [_angle_scales(evidence, name).get(unit, 0.0) for name in angles]
        if not all(scales):
            continue
        corrections: list[Correction] = []
        for name, scale in zip(angles, scales, strict=True):
            corrections += case.scale_corrections([name], scale / evidence.channel(name).scale)
        groups = [(angles, corrections)]
        if rates and unit == "degrees":
            rate_corrections = case.scale_corrections(rates, _DEGREE)
            groups.append(([*angles, *rates], [*corrections, *rate_corrections]))
        factor = evidence.channel(angles[0]).scale / scales[0]
        for names, changes in groups:
            clause = Clause("wrong-unit/angles", channels=tuple(names), unit=unit)
            yield Cause("wrong-unit", places_of(names), clause, tuple(changes), factor=factor)


def propose_effort_scales(case: Case) -> Iterator[Cause]:
    """The efforts of all joints in another unit, or with another sign; or without friction."""
    joints = range(1, case.evidence.arm.n_joints + 1)
    names = [name for i in joints if (name := effort_channel(case.evidence.channels, i))]
    negative = {o.joint for o in case.contradictions if o.kind == "inertia"}
    factors: list[tuple[float, Unit | None]] = [(-1.0, None)] if len(negative) > 1 else []
    if case.contradicts("mass"):
        factors += [(1e-3, "mN m"), (1e-2, "N cm")]
    for factor, unit in factors:
        code = "wrong-sign" if unit is None else "wrong-unit"
        clause = Clause(f"{code}/efforts", channels=tuple(names), unit=unit)
        changes = case.scale_corrections(names, factor)
        yield Cause(code, places_of(names), clause, changes, factor=1.0 / factor)
    if case.contradicts("friction"):
        efforts = tuple(name for name in names if channel_parts(name)[0] == "torque")
        share = next(o.value for o in case.contradictions if o.kind == "friction")
        changes = tuple(Correction("channels", n, "meaning", "without-friction") for n in efforts)
        clause = Clause("effort-without-friction", channels=efforts, share=share)
        yield Cause("effort-without-friction", places_of(efforts), clause, changes)


def propose_record_signs(case: Case) -> Iterator[Cause]:
    """Efforts with another sign in single records."""
    signs = [o for o in case.contradictions if o.kind == "inertia" and o.place.experiments]
    for record in dict.fromkeys(o.place.experiments for o in signs):
        places = tuple(o.place for o in signs if o.place.experiments == record)
        names = tuple(place.channel or "" for place in places)
        clause = Clause("record", record=record[0], fault=Clause("wrong-sign/some", channels=names))
        remedy = Clause("remedy/record", record=record[0])
        yield Cause("wrong-sign", places, clause, (), remedy, factor=-1.0, excluded=record)


def propose_dead_channels(case: Case) -> Iterator[Cause]:
    """Sensors that show noise alone."""
    for name, size in case.by_channel("presence").items():
        clause = Clause("dead-channel", channel=name, share=size)
        changes = log_corrections([name], "unusable", 0.0)
        yield Cause("dead-channel", places_of([name]), clause, changes)


def _angle_scales(evidence: Evidence, name: str) -> dict[Unit, float]:
    """Scales to radians of the units in which a motor angle can be logged."""
    units = dict(_ANGLES)
    per_turn = evidence.arm.joints[channel_parts(name)[1] - 1].encoder_counts
    if per_turn:
        units["encoder counts"] = 2.0 * np.pi / per_turn
        units["quadrature counts"] = np.pi / 2.0 / per_turn
        units["encoder lines"] = 8.0 * np.pi / per_turn
    scale = evidence.channel(name).scale
    return units | {Clause("counts/scaled", factor=f): f * scale for f in _QUADRATURE_FACTORS}


def propose_ac_coupling(case: Case) -> Iterator[Cause]:
    """AC-coupled accelerometers, for example piezoelectric ones."""
    names = {o.place.channel for o in case.contradictions if o.place.channel and o.kind != "count"}
    cutoffs = {
        name: hz
        for name in sorted(names & case.evidence.channels)
        if channel_parts(name)[0] in _ACCELERATIONS
        if (hz := estimate_high_pass_cutoff(case.evidence, name))
    }
    groups = [list(cutoffs)] if len(cutoffs) > 1 else []
    for group in [*groups, *([name] for name in cutoffs)]:
        hertz = tuple(Clause("frequency", value=cutoffs[name]) for name in group)
        clause = Clause("ac-coupled", channels=tuple(group), cutoffs=hertz)
        changes = tuple(Correction("log", name, "high_pass_hz", cutoffs[name]) for name in group)
        yield Cause("ac-coupled", places_of(group), clause, changes)


def propose_sensor_delays(case: Case) -> Iterator[Cause]:
    """Link sensors with a delay or a drift of the delay: all, one kind, or one channel."""
    names = sorted(n for n in case.evidence.channels if channel_parts(n)[0] in _LINK_SIDE)
    by_kind = [[n for n in names if channel_parts(n)[0] == kind] for kind in LINK_CHANNELS]
    proposals: dict[str, Callable[[tuple[str, ...], float], Cause]]
    proposals = {"drift": _clock_drift, "delay": _sensor_delay}
    for kind, propose in proposals.items():
        values = case.by_channel(kind)
        for group in (names, *by_kind, *([name] for name in values)):
            estimates = [values[name] for name in group if name in values]
            if estimates:
                yield propose(tuple(group), float(np.median(estimates)))


def _sensor_delay(names: tuple[str, ...], delay: float) -> Cause:
    """A common delay of several channels [s]."""
    side = "late" if delay > 0.0 else "early"
    clause = Clause("misaligned/sensor", channels=names, delay=abs(delay), side=side)
    changes, remedy = log_corrections(names, "delay_s", delay), Clause("remedy/sensor-delay")
    return Cause("misaligned", places_of(names), clause, changes, remedy, delay_s=delay)


def _clock_drift(names: tuple[str, ...], drift: float) -> Cause:
    """A common drift of the delay of several channels [s/s]."""
    side, error = "slow" if drift > 0.0 else "fast", abs(drift)
    clause = Clause("clock-drift/sensor", channels=names, drift=drift, error=error, side=side)
    changes, remedy = log_corrections(names, "clock", drift), Clause("remedy/sensor-clock")
    return Cause("clock-drift", places_of(names), clause, changes, remedy, factor=1.0 - drift)


def scale_cause(case: Case, name: str, factor: float, unit: Unit | None, basis: str) -> Cause:
    """One channel in another unit or with another sign; `basis` determines its scale."""
    is_reversed = factor == -1.0
    code = template = "wrong-sign" if is_reversed else "wrong-unit"
    if not is_reversed and (unit is None or factor < 0.0):
        template += "/unknown" if unit is None else "/reversed"
    based_on = Clause(f"basis/{basis}", joint=channel_parts(name)[1])
    return Cause(
        code,
        places_of([name]),
        Clause(template, channel=name, ratio=1.0 / factor, basis=based_on, unit=unit),
        case.scale_corrections([name], factor),
        factor=1.0 / factor,
        has_estimated_factor=unit is None and not is_reversed,
    )


def _candidate_factors(
    ratios: Iterable[float], units: Mapping[Unit, float]
) -> Iterator[tuple[float, Unit | None]]:
    """Candidate factors of a channel with their units: -1 first, then one per estimated ratio.

    An estimate near the factor of a known unit is replaced by that factor.
    """
    yield -1.0, None
    tried: list[float] = []
    for ratio in ratios:
        unit, factor = match_known_factor(1.0 / ratio, units) or (None, 1.0 / ratio)
        is_repeated = any(abs(factor / other - 1.0) < MAX_FACTOR_DIFFERENCE for other in tried)
        if abs(abs(factor) - 1.0) > 1e-9 and not is_repeated:
            tried.append(factor)
            yield factor, unit


def propose_channel_scales(case: Case, joint: int) -> Iterator[Cause]:
    """Wrong units, signs or scales of all channels of one joint except the motor angle."""
    for kind, basis in _BASIS.items():
        name = f"{kind}{joint}"
        if name not in case.evidence.channels:
            continue
        ratios = _scale_ratios(case, kind, joint)
        if not ratios and not _is_contradicted(case, kind, joint):
            continue
        scale = case.evidence.channel(name).scale
        units: dict[Unit, float] = {unit: si / scale for unit, si in _UNITS[kind].items()}
        units["SI units"] = 1.0 / abs(scale)
        if kind == "a":  # Other factors can be a wrong distance: see `propose_geometry`.
            ratios = [ratio for ratio in ratios if match_known_factor(1.0 / ratio, units)]
        if kind in ("u", "torque"):
            ratios += [1.0 / factor for factor in units.values()]
        for factor, unit in _candidate_factors(ratios, units):
            yield scale_cause(case, name, factor, unit, basis)


def _scale_ratios(case: Case, kind: str, joint: int) -> list[float]:
    """Estimated ratios of a channel to its SI value."""
    name = f"{kind}{joint}"
    if kind in LINK_CHANNELS:
        return case.values(name, "scale", "gravity")
    if kind == "ref":
        return [1.0 / ratio for ratio in case.values(f"theta_m{joint}", "reference")]
    if kind == "omega_m":
        return case.values(name, "velocity")
    ratios = [r for r in case.values(name, "level", "servo", "limit") if abs(r) > MIN_RATIO]
    if kind == "torque":
        ratios += [1.0 / ratio for ratio in case.values(f"tau_l{joint}", "torque-sensor")]
    return ratios


def _is_contradicted(case: Case, kind: str, joint: int) -> bool:
    """Whether a contradiction depends on a channel."""
    kinds = {"u": ("inertia", "servo"), "torque": ("inertia",)}.get(kind, ())
    return any(
        o.place.channel == f"{kind}{joint}" or (o.joint == joint and o.kind in kinds)
        for o in case.contradictions
    )


def propose_motor_angle_scales(case: Case, joint: int) -> Iterator[Cause]:
    """One motor angle with a wrong unit, count or sign."""
    if joint not in case.joints:
        return
    name = f"theta_m{joint}"
    ratios = case.values(name, "count", "reference")
    ratios += [1.0 / factor for factor in case.rotation_factors(joint)]
    ratios += [1.0 / factor for factor in case.values(f"omega_m{joint}", "velocity")]
    # Unit factors differ from 1 by more than the tolerance.
    ratios = [ratio for ratio in ratios if abs(np.log(abs(ratio))) > UNIT_TOLERANCE]
    per_turn = case.evidence.arm.joints[joint - 1].encoder_counts
    scale = case.evidence.channel(name).scale
    units = {unit: si / scale for unit, si in _angle_scales(case.evidence, name).items()}
    units |= _power_scales(scale, ratios)
    for factor, unit in _candidate_factors(ratios, units):
        yield scale_cause(case, name, factor, unit, "resolution" if per_turn else "signals")


def _power_scales(scale: float, ratios: Sequence[float]) -> dict[Unit, float]:
    """Factors that change a scale to 2 pi / 2^k, the scale of an encoder with 2^k counts."""
    units: dict[Unit, float] = {}
    for ratio in ratios:
        counts = 2.0 * np.pi / abs(scale / ratio)
        if counts >= _MIN_POWER_COUNTS:
            power = 2 ** round(np.log2(counts))
            units[Clause("counts/power", counts=power)] = 2.0 * np.pi / power / abs(scale)
    return units


def propose_reversed_gear(case: Case, joint: int) -> Iterator[Cause]:
    """A reversing gear: motor angle and torque are consistent, the link has the opposite sign."""
    names = [f"{k}{joint}" for k in MOTOR_SIDE if f"{k}{joint}" in case.evidence.channels]
    clause, remedy = Clause("wrong-sign/gear", joint=joint), Clause("remedy/gear")
    changes = case.scale_corrections(names, -1.0)
    yield Cause("wrong-sign", places_of(names), clause, changes, remedy, factor=-1.0)
