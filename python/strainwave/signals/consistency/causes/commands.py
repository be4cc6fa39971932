"""Causes in time bases, commands and test signals."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import numpy as np

from strainwave.domain import Clause, Correction, Place, channel_parts
from strainwave.signals.consistency.causes.case import (
    MIN_RATIO,
    STEPS,
    Case,
    Cause,
    Unit,
    as_rival,
    log_corrections,
    match_known_factor,
    places_of,
)
from strainwave.signals.consistency.evidence import exchanged_tests

# Maximum difference between the delays of channels with a common cause [s].
_MAX_DELAY_DIFFERENCE = 5e-4
# Voltage above the supply of any servo drive [V]; a larger value is in millivolts.
_MAX_VOLTAGE = 1e3
# Units of time and their scale to seconds.
_TIMES: Mapping[Unit, float] = {
    "milliseconds": 1e-3,
    "microseconds": 1e-6,
    "nanoseconds": 1e-9,
    "minutes": 60.0,
}
VOLTAGES: Mapping[Unit, float] = {"mV": 1e-3}
"""Units of voltage and their scale to volts."""


def propose_time_bases(case: Case) -> Iterator[Cause]:
    """A time base in another unit, or a wrong clock rate of the logger."""
    clocks = case.values(None, "prbs-clock", "servo-clock")
    if not clocks and not case.contradicts("explained-share", "scale"):
        return
    estimates = [1.0 / float(np.median(clocks))] if clocks else []
    for estimate in (*estimates, *_TIMES.values()):
        unit, factor = match_known_factor(estimate, _TIMES) or (None, estimate)
        ratio, corrections = 1.0 / factor, case.scale_corrections("t", factor)
        code, clause = "clock-drift", Clause("clock-drift", ratio=ratio)
        remedy = Clause("remedy/log-clock")
        if unit is not None:
            code, clause = "wrong-unit", Clause("wrong-unit/time", ratio=ratio, unit=unit)
            remedy = STEPS
        yield Cause(code, places_of("t"), clause, corrections, remedy, factor=ratio)


def propose_record_clocks(case: Case) -> Iterator[Cause]:
    """A wrong PRBS clock of the study, or another clock of the logger, in some of the records.

    Without a second clock in these records the two cannot be told apart.
    """
    wrong = {
        o.place.experiments[0]: o
        for o in case.contradictions
        if o.kind in ("prbs-clock", "servo-clock")
    }
    clocked = [r for r in case.evidence.records if r.clocks.prbs or r.clocks.servo]
    if not wrong:
        return
    ratio = float(np.median([o.value for o in wrong.values()]))
    names = tuple(wrong)
    stated = {r.experiment.name: r.experiment.prbs for r in clocked}
    changes = tuple(
        Correction("experiment", name, "prbs.clock", float(f"{o.value * prbs.clock:.5g}"))
        for name, o in wrong.items()
        if (prbs := stated[name]) is not None and o.kind == "prbs-clock"
    )
    place = Place(experiments=names, key="prbs")
    clause = Clause("wrong-prbs-clock", records=names, ratio=ratio)
    of_prbs = Cause("wrong-prbs-clock", (place,), clause, changes, factor=ratio)
    clause = Clause("clock-drift/records", records=names, ratio=ratio)
    remedy = Clause("remedy/record-clock", records=names, ratio=1.0 / ratio)
    place = Place(experiments=names, channel="t")
    of_logger = Cause("clock-drift", (place,), clause, (), remedy, factor=ratio, excluded=names)
    if changes and len(changes) == len(wrong):
        yield replace(of_prbs, rivals=() if len(wrong) < len(clocked) else (as_rival(of_logger),))
    if len(wrong) < len(clocked):
        yield of_logger


def propose_input_delays(case: Case) -> Iterator[Cause]:
    """Commands with a delay relative to the encoders, or encoders relative to the commands.

    All commands with one delay, then one command or one motor angle.
    """
    values = case.by_channel("input-delay")
    if len(values) > 1 and np.ptp(list(values.values())) < _MAX_DELAY_DIFFERENCE:
        yield _late(values, list(values), float(np.mean(list(values.values()))), "command")
    for name, delay in values.items():
        yield _late(values, [name], delay, "command")
    for name, delay in values.items():  # link sensors tell which of the two is late
        yield _late(values, [_angle_of(name)], -delay, "angle")


def _late(commands: Collection[str], late: list[str], delay: float, kind: str) -> Cause:
    """Commands or motor angles with a common delay [s]."""
    joints = {channel_parts(name)[1] for name in late}
    clause = Clause(
        f"misaligned/{kind}",
        channels=tuple(late),
        delay=abs(delay),
        side="later" if delay > 0.0 else "earlier",
        commands=tuple(name for name in commands if channel_parts(name)[1] in joints),
        angles=tuple(map(_angle_of, late)),
    )
    shifts, remedy = log_corrections(late, "delay_s", round(delay, 6)), Clause("remedy/command")
    return Cause("misaligned", places_of(late), clause, shifts, remedy, delay_s=delay)


def _angle_of(name: str) -> str:
    """Motor angle of the joint of a channel."""
    return f"theta_m{channel_parts(name)[1]}"


def propose_excited_joints(case: Case) -> Iterator[Cause]:
    """Records whose excited joint differs from the study."""
    joints = set(range(1, case.evidence.arm.n_joints + 1))
    for each in case.contradictions:
        if each.kind != "excited-joint" or each.joint is None:
            continue
        (record,) = each.place.experiments
        place = Place(experiments=(record,), key="joint")
        for excited in sorted(joints - {each.joint}):
            clause = Clause(
                "swapped-channels/excited-joint",
                experiment=record,
                stated=each.joint,
                excited=excited,
            )
            change = Correction("experiment", record, "joint", excited)
            yield Cause("swapped-channels", (place,), clause, (change,))


def propose_exchanged_files(case: Case) -> Iterator[Cause]:
    """Exchanged files of records with a test signal and records of motion."""
    silent, signalling = exchanged_tests(case.evidence)
    if silent and signalling:
        names = (*silent, *signalling)
        clause = Clause("swapped-channels/files", records=tuple(silent), others=tuple(signalling))
        remedy, place = Clause("remedy/files", records=names), Place(experiments=names, key="file")
        yield Cause("swapped-channels", (place,), clause, (), remedy, excluded=names)


def propose_voltage_scales(case: Case) -> Iterator[Cause]:
    """A wrong PRBS amplitude in the study, or a wrong scale of the voltage.

    The amplitude comes first, unless the measured amplitude exceeds the supply of any drive.
    """
    for name in case.by_channel("level"):
        joint = channel_parts(name)[1]
        amplitudes = {
            each.name: each.prbs.amplitude
            for each in case.evidence.study.experiments
            if each.prbs is not None and each.joint == joint
        }
        levels = {r.experiment.name: r.clocks.level.get(name) for r in case.evidence.records}
        ratios = {
            record: level / amplitudes[record]
            for record, level in levels.items()
            if level is not None and record in amplitudes
        }
        wrong = {record: ratio for record, ratio in ratios.items() if not 0.5 < ratio < 2.0}
        if not wrong or min(wrong.values()) < MIN_RATIO:
            continue  # The command belongs to another joint.
        ratio = float(np.median(list(wrong.values())))
        stated = max(amplitudes[record] for record in wrong)
        unit = match_known_factor(1.0 / ratio, VOLTAGES)
        scales = case.scale_corrections([name], unit[1] if unit else 1.0 / ratio)
        corrected = {record: float(f"{amplitudes[record] * ratio:.4g}") for record in wrong}
        changes = tuple(
            Correction("experiment", record, "prbs.amplitude", amplitude)
            for record, amplitude in corrected.items()
        )
        clause = Clause(
            "wrong-unit/amplitude",
            records=tuple(wrong),
            channel=name,
            measured=stated * ratio,
            stated=stated,
            ratio=ratio,
        )
        remedy = Clause("remedy/amplitude")
        prbs = Place(experiments=tuple(wrong), key="prbs")
        alternatives = [(prbs, changes, scales), (Place(channel=name), scales, changes)]
        if stated * ratio > max(stated, _MAX_VOLTAGE):
            alternatives.reverse()
        for place, corrections, other in alternatives:
            yield Cause("wrong-unit", (place,), clause, corrections, remedy, other, factor=ratio)
