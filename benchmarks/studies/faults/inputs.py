"""Inputs for the check: the records of a study in memory, clean variants of them, and faults."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from strainwave.domain import Correction, FloatArray, Study, channel_parts
from strainwave.domain.corrections import apply_corrections
from strainwave.domain.study import Payload
from strainwave.dynamics.arm import Arm
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.signals.consistency.evidence import collect_evidence
from strainwave.signals.consistency.torque_fit import fit_torques, torque_system
from strainwave.signals.link_readings import JointMotion

Columns = dict[str, FloatArray]
_DEGREES = 180.0 / np.pi
_ANGLES = ("theta_m", "theta_l", "deflection", "omega_m", "ref", "gyro", "gx", "gy", "gz")
_EFFORTS = ("torque", "u")
_N_JOINT_RECORDS = 8  # more take time, and test nothing else
_RATED = (39.0, 27.0, 31.0, 9.0, 13.0, 7.0, 11.0)  # torques [N m] that per cent refer to


@dataclass(frozen=True, slots=True)
class Input:
    """A study and its tables, by experiment; the columns have the names of the channels."""

    study: Study
    tables: dict[str, Columns]

    @classmethod
    def read(cls, path: Path) -> Input:
        """Read a study; its windows, columns and scales are applied.

        Of the records of one joint, those of the first `_N_JOINT_RECORDS` are read.
        """
        study = read_study(path)
        of_joint = [each.name for each in study.experiments if each.joint][:_N_JOINT_RECORDS]
        used = [each for each in study.experiments if not each.joint or each.name in of_joint]
        study = replace(study, experiments=tuple(used))
        tables = {log.name: {"t": log.time, **log.channels} for log in read_logs(study)}
        given = [each for each in study.experiments if each.name in tables]
        whole = tuple(replace(each, start=None, stop=None) for each in given)
        return cls(replace(study, experiments=whole, channels={}), tables)

    def changed(
        self, change: Callable[[Columns], Columns], records: Sequence[str] | None = None
    ) -> Input:
        """With a change of the tables of some records, or of all."""
        tables = {
            name: change(dict(table)) if records is None or name in records else table
            for name, table in self.tables.items()
        }
        return replace(self, tables=tables)

    def scaled(self, names: Sequence[str], factor: float) -> Input:
        """With channels multiplied by a factor."""
        return self.changed(
            lambda table: {k: factor * v if k in names else v for k, v in table.items()}
        )

    def stated(self, *corrections: Correction) -> Input:
        """With other values in the study."""
        return replace(self, study=apply_corrections(self.study, corrections))

    def obeyed(self, corrections: Sequence[Correction]) -> Input:
        """With the printed corrections of study and logs."""
        after = self.stated(*corrections)
        for each in corrections:
            if each.table == "log":
                after = after.changed(partial(_corrected, each))
        return after

    def exchanged(
        self, first: Sequence[str], second: Sequence[str], records: Sequence[str] | None = None
    ) -> Input:
        """With exchanged channels, in some records or in all."""
        names = dict(zip([*first, *second], [*second, *first], strict=True))
        return self.changed(lambda t: {k: t[names.get(k, k)] for k in t}, records)

    def late(self, names: Sequence[str], seconds: float) -> Input:
        """With delayed channels."""

        def delay(table: Columns) -> Columns:
            time = table["t"]
            late = {k: np.interp(time - seconds, time, v) for k, v in table.items() if k in names}
            return {**table, **late}

        return self.changed(delay)

    def efforts(self, joint: int) -> list[str]:
        """Channels of the torque of a joint."""
        names = {name for table in self.tables.values() for name in table}
        return [name for kind in _EFFORTS if (name := f"{kind}{joint}") in names]

    def of_kinds(self, kinds: Sequence[str], joint: int | None = None) -> list[str]:
        """Channels of some kinds, of one joint or of all."""
        names = sorted({name for table in self.tables.values() for name in table} - {"t"})
        return [
            name
            for name in names
            if channel_parts(name)[0] in kinds and joint in (None, channel_parts(name)[1])
        ]


def _corrected(each: Correction, table: Columns) -> Columns:
    name, time = each.entry, table["t"]
    if name not in table:
        return table
    if each.key in ("delay_s", "clock"):
        drift = each.number * (time - time[0]) if each.key == "clock" else each.number
        return {**table, name: np.interp(time + drift, time, table[name])}
    return {key: values for key, values in table.items() if key != name}


@dataclass(frozen=True, slots=True)
class Case:
    """An input; for a fault the codes, and the joints or records, one of which names it."""

    name: str
    given: Input
    codes: tuple[str, ...] = ()
    joints: tuple[int, ...] = ()
    records: tuple[str, ...] = ()


def clean_variants(given: Input, rng: np.random.Generator) -> Iterator[Case]:
    """Inputs without a fault."""
    yield Case("as recorded", given)
    slow = [e.name for e in given.study.experiments if e.joint is None]

    def window(first: float, last: float) -> Callable[[Columns], Columns]:
        def cut(table: Columns) -> Columns:
            n = len(table["t"])
            return {k: v[int(first * n) : int(last * n)] for k, v in table.items()}

        return cut

    def every(step: int) -> Callable[[Columns], Columns]:
        return lambda table: {k: v[::step] for k, v in table.items()}

    for first, last in ((0.0, 0.6), (0.3, 1.0), (0.1, 0.9)):
        yield Case(f"window {first:g} to {last:g}", given.changed(window(first, last), slow))
    for rate in (500, 200, 100, 50):
        step = round(1.0 / (rate * np.median(np.diff(given.tables[slow[0]]["t"]))))
        if step > 1:
            yield Case(f"{rate} Hz", given.changed(every(step), slow))

    def thinned(table: Columns) -> Columns:
        kept = rng.random(len(table["t"])) > 0.05
        kept[[0, -1]] = True
        return {k: v[kept] for k, v in table.items()}

    yield Case("5 % of samples removed", given.changed(thinned, slow))

    def noisy(table: Columns) -> Columns:
        return {
            k: v
            if k == "t"
            else v + np.std(np.diff(v)) / np.sqrt(2.0) * rng.standard_normal(len(v)) * 0.5
            for k, v in table.items()
        }

    yield Case("noise", given.changed(noisy, slow))

    def coarse(table: Columns) -> Columns:
        return {
            k: v if k == "t" or not np.ptp(v) else np.round(v / (s := np.ptp(v) / 4096)) * s
            for k, v in table.items()
        }

    yield Case("12 bit", given.changed(coarse, slow))
    for name in list(given.tables)[:2] + list(given.tables)[-2:]:
        if sum(other in slow for other in given.tables if other != name):
            left = tuple(e for e in given.study.experiments if e.name != name)
            tables = {k: v for k, v in given.tables.items() if k != name}
            yield Case(f"without {name}", Input(replace(given.study, experiments=left), tables))
    if given.study.arm.kind == "serial":
        moved = Correction("joint", "1", "origin.xyz", (0.2, -0.1, 0.5))
        yield Case("another URDF origin", given.stated(moved))


def faults(given: Input, joint: int) -> Iterator[Case]:
    """Faults of the input; those of one joint in `joint`."""
    yield from _signal_faults(given, joint)
    yield from _record_faults(given, joint)
    yield from _study_faults(given, joint)


def _moved(name: str, offset: float, table: Columns) -> Columns:
    return {**table, name: table[name] + offset}


def _of_joint(given: Input, joint: int, key: str, factor: float) -> Correction:
    value = getattr(given.study.arm.joints[joint - 1], key)
    return Correction("joint", str(joint), key, factor * value)


def _neighbour(given: Input, joint: int) -> int:
    return joint + 1 if joint < given.study.arm.n_joints else joint - 1


def _signal_faults(given: Input, j: int) -> Iterator[Case]:
    """Faults of constants, units, signs, joints, zeros and delays in all records."""
    arm, other = given.study.arm, _neighbour(given, j)
    efforts, all_efforts = given.efforts(j), given.of_kinds(_EFFORTS)
    ratio = ("wrong-gear-ratio",)
    yield Case(
        "gear ratio 1 %", given.stated(_of_joint(given, j, "gear_ratio", 100 / 101)), ratio, (j,)
    )
    yield Case("gear ratio 20 %", given.stated(_of_joint(given, j, "gear_ratio", 0.8)), ratio, (j,))
    constant = ("wrong-torque-constant", "wrong-unit")
    yield Case("torque x 0.8", given.scaled(efforts, 0.8), constant, (j,))
    yield Case("torque reversed", given.scaled(efforts, -1.0), ("wrong-sign",), (j,))
    yield Case("all torques reversed", given.scaled(all_efforts, -1.0), ("wrong-sign",))
    angles = given.of_kinds(("theta_m",))
    unit = ("wrong-unit",)
    yield Case("degrees of one", given.scaled([f"theta_m{j}"], _DEGREES), unit, (j,))
    yield Case("angles in degrees", given.scaled(angles, _DEGREES), unit)
    yield Case("everything in degrees", given.scaled(given.of_kinds(_ANGLES), _DEGREES), unit)
    yield Case("angles in turns", given.scaled(angles, 0.5 / np.pi), unit)
    yield Case("torque in mN m", given.scaled(efforts, 1e3), unit, (j,))
    yield Case("all torques in mN m", given.scaled(all_efforts, 1e3), unit)
    per_cent = given
    for name in all_efforts:
        per_cent = per_cent.scaled([name], 100.0 / _RATED[channel_parts(name)[1] - 1])
    yield Case("torques in per cent", per_cent, (*unit, "wrong-torque-constant"))
    yield Case("angle reversed", given.scaled([f"theta_m{j}"], -1.0), ("wrong-sign",), (j,))
    swapped = ("swapped-channels",)
    a, b = given.efforts(j), given.efforts(other)
    yield Case("torques exchanged", given.exchanged(a, b), swapped, (j, other))
    a, b = (given.of_kinds(("theta_m", "omega_m", "torque", "u", "ref"), i) for i in (j, other))
    yield Case("joints exchanged", given.exchanged(a, b), swapped, (j, other))
    zero = ("wrong-zero",)
    gear = arm.joints[j - 1].gear_ratio
    for size in (0.1, np.pi / 2):
        moved = given.changed(partial(_moved, f"theta_m{j}", size / gear))
        if arm.gravity:
            yield Case(f"zero {size:.2g} rad", moved, zero, (j,))
    misaligned = ("misaligned",)
    yield Case("torque 20 ms late", given.late(efforts, 0.02), misaligned, (j,))
    yield Case("all torques 20 ms late", given.late(all_efforts, 0.02), misaligned)
    yield Case("angle 20 ms late", given.late([f"theta_m{j}"], 0.02), misaligned, (j,))


def _record_faults(given: Input, j: int) -> Iterator[Case]:
    """Faults of single records, and dead channels."""
    study, other = given.study, _neighbour(given, j)
    efforts = given.efforts(j)
    motions = [e.name for e in study.experiments if not e.joint and e.use in ("motion", "check")]
    kinds = ("theta_m", "omega_m", "torque", "u", "ref")
    a, b = given.of_kinds(kinds, j), given.of_kinds(kinds, other)
    swapped = ("swapped-channels",)
    yield Case(
        "exchanged in one record",
        given.exchanged(a, b, motions[:1]),
        swapped,
        (j, other),
        (motions[0],),
    )
    signed = given.changed(
        lambda t: {k: -v if k in efforts else v for k, v in t.items()}, motions[:1]
    )
    if len(motions) > 1:
        yield Case("torque reversed in one record", signed, ("wrong-sign",), (j,), (motions[0],))
        loaded = _loaded(given, motions[-1])
        if loaded is not None:
            yield Case("payload in one record", loaded, ("unstated-payload",), (), (motions[-1],))
    still = given.changed(lambda t: {**t, f"theta_m{j}": np.full_like(t["t"], t[f"theta_m{j}"][0])})
    yield Case("encoder stands still", still, ("dead-channel",), (j,))
    if given.of_kinds(("a", "ax"), j):
        name = given.of_kinds(("a", "ax"), j)[0]
        dead = given.changed(
            lambda t: {**t, name: np.zeros_like(t["t"]) + 1e-3 * np.sin(9e3 * t["t"] ** 2)}
        )
        yield Case("dead accelerometer", dead, ("dead-channel",), (j,))


def _study_faults(given: Input, j: int) -> Iterator[Case]:
    """Faults of the geometry, of gravity, of the meaning of efforts, and of test signals."""
    study, arm = given.study, given.study.arm
    motions = [e.name for e in study.experiments if not e.joint and e.use in ("motion", "check")]
    tests = [e.name for e in study.experiments if e.use in ("frequency", "sweep")]
    swapped, geometry = ("swapped-channels",), ("wrong-geometry",)
    if arm.kind == "serial":
        down = arm.gravity or (0.0, 0.0, 0.0)
        yield Case(
            "gravity direction",
            given.stated(Correction("arm", "", "gravity", (0.0, down[2], 0.0))),
            geometry,
        )
        yield Case(
            "gravity up",
            given.stated(Correction("arm", "", "gravity", (0.0, 0.0, -down[2]))),
            geometry,
        )
        lengths = [
            Correction("joint", str(i), "origin.xyz", tuple(0.65 * x for x in each.origin.xyz))
            for i, each in enumerate(arm.joints, start=1)
        ]
        yield Case("lengths x 0.65", given.stated(*lengths), geometry)
        for name, parts in (("gravity", ("gravity",)), ("friction", ("friction",))):
            yield Case(
                f"effort without {name}", _without(given, parts), (f"effort-without-{name}",)
            )
        yield Case(
            "desired effort",
            _without(given, ("friction", "noise")),
            ("desired-effort", "effort-without-friction"),
        )
    else:
        yield Case(
            "length x 0.65",
            given.stated(Correction("arm", "", "link_length", 0.65 * arm.joints[1].origin.xyz[0])),
            geometry,
        )
        key = given.study.arm.joints[j - 1].accelerometer_distance
        if key:
            yield Case(
                "distance x 1.5",
                given.stated(_of_joint(given, j, "accelerometer_distance", 1.5)),
                geometry,
                (j,),
            )
    if tests:
        clock = ("wrong-prbs-clock",)
        doubled = [
            Correction("experiment", e.name, "prbs.clock", 2.0 * e.prbs.clock)
            for e in study.experiments
            if e.prbs is not None
        ]
        if any(c == "open" for e in study.experiments if e.prbs for c in e.control):
            yield Case("PRBS clock x 2", given.stated(*doubled), clock)
        slow = given.changed(lambda t: {**t, "t": 1.05 * t["t"]}, tests)
        yield Case(
            "t of PRBS records x 1.05", slow, ("clock-drift", "wrong-unit"), (), tuple(tests)
        )
        files = dict(given.tables)
        files[tests[0]], files[motions[0]] = files[motions[0]], files[tests[0]]
        yield Case(
            "files exchanged", replace(given, tables=files), swapped, (), (tests[0], motions[0])
        )


def _motions(given: Input) -> Iterator[tuple[str, JointMotion, Columns]]:
    arm = Arm.of(given.study.arm)
    for name, table in given.tables.items():
        motors = np.column_stack([table[f"theta_m{i + 1}"] for i in range(arm.n_joints)])
        T = float(np.median(np.diff(table["t"])))
        yield name, JointMotion.of_motors(motors, arm, T), table


def _links(given: Input) -> FloatArray | None:
    logs = read_logs(given.study, data=given.tables)
    system = torque_system(collect_evidence(logs, given.study))
    return None if system is None else fit_torques(system).links


def _without(given: Input, parts: Sequence[str]) -> Input:
    """Efforts without gravity, or without friction: the torques that the fitted links need."""
    links, arm = _links(given), Arm.of(given.study.arm)
    if links is None:
        return given
    tables = {}
    for name, motion, table in _motions(given):
        rest = np.zeros_like(motion.velocity)
        static = arm.motors_of(arm.link_torques(links, motion.angle, rest, rest))
        columns = dict(table)
        for i in range(arm.n_joints):
            effort = next(iter(given.efforts(i + 1)), None)
            if effort is None or effort not in table:
                continue
            scale = 1.0 / arm.joints[i].torque_per_command if effort[0] == "u" else 1.0
            if "gravity" in parts:
                columns[effort] = table[effort] - scale * static[:, i]
            if "friction" in parts:
                rate = motion.velocity[:, i]
                sign = np.tanh(rate / (0.02 * np.abs(rate).max() + 1e-12))
                X = np.column_stack([sign, rate])
                y = table[effort] - scale * static[:, i]
                A = np.column_stack([X, motion.acceleration[:, i], np.ones(len(y))])
                columns[effort] = table[effort] - X @ np.linalg.lstsq(A, y, rcond=None)[0][:2]
        tables[name] = columns
    return replace(given, tables=tables)


def _loaded(given: Input, record: str) -> Input | None:
    """A load on the last link in one record, of a fifth of the static torque of the arm."""
    links, arm = _links(given), Arm.of(given.study.arm)
    if links is None:
        return None
    tables = dict(given.tables)
    for name, motion, table in _motions(given):
        if name != record:
            continue
        load = 0.3 * links
        if given.study.arm.kind == "serial":
            mass = max(1.0, 0.1 * float(np.abs(links.reshape(arm.n_joints, -1)[:, 0]).sum()))
            load = np.zeros_like(links)
            load.reshape(arm.n_joints, -1)[-1] = Payload(mass, (0.0, 0.05, 0.1)).parameters
        torques = arm.motors_of(
            arm.link_torques(load, motion.angle, motion.velocity, motion.acceleration)
        )
        columns = dict(table)
        for i in range(arm.n_joints):
            for effort in given.efforts(i + 1):
                scale = 1.0 / arm.joints[i].torque_per_command if effort.startswith("u") else 1.0
                columns[effort] = table[effort] + scale * torques[:, i]
        tables[record] = columns
    return replace(given, tables=tables)
