"""Inputs for the check: a study with its records in memory, and changes of both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from strainwave.domain import Correction, FloatArray, Lag, Study, channel_parts
from strainwave.domain.arm.link_sensors import link_channel_kinds
from strainwave.domain.results.consistency import apply_corrections
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.numerics.filters import apply_lags

Columns = dict[str, FloatArray]
EFFORTS = ("torque", "u")
_N_JOINT_RECORDS = 8  # more take time, and test nothing else


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
        return [name for kind in EFFORTS if (name := f"{kind}{joint}") in names]

    def of_kinds(self, kinds: Sequence[str], joint: int | None = None) -> list[str]:
        """Channels of some kinds, of one joint or of all."""
        names = sorted({name for table in self.tables.values() for name in table} - {"t"})
        return [
            name
            for name in names
            if channel_parts(name)[0] in kinds and joint in (None, channel_parts(name)[1])
        ]

    def without_records(self, *names: str) -> Input:
        """With some records left out."""
        left = tuple(each for each in self.study.experiments if each.name not in names)
        tables = {name: table for name, table in self.tables.items() if name not in names}
        return Input(replace(self.study, experiments=left), tables)

    def motors_only(self) -> Input:
        """Without the channels of links."""
        return self.changed(
            lambda table: {
                k: v for k, v in table.items() if channel_parts(k)[0] not in link_channel_kinds()
            }
        )

    def with_torques(self) -> Input:
        """With the torques of the motors instead of their voltages."""
        joints = self.study.arm.joints

        def convert(table: Columns) -> Columns:
            columns, T = {}, float(np.median(np.diff(table["t"])))
            for name, values in table.items():
                kind, i = channel_parts(name)
                if kind != "u":
                    columns[name] = values
                    continue
                hz = joints[i - 1].current_loop_hz
                torque = joints[i - 1].torque_per_command * values
                lags = [Lag(1, hz)] if hz else []
                columns[f"torque{i}"] = apply_lags(torque, lags, T, held=True)
            return columns

        return self.changed(convert)

    @property
    def motions(self) -> list[str]:
        """Names of the records in which all joints move."""
        return [
            e.name
            for e in self.study.experiments
            if not e.joint and e.use in ("motion", "check") and e.name in self.tables
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
    unchecked: str = ""  # channel that the check may also list as unchecked
    truth: Input | None = None  # the input without the fault; None: that of the study
