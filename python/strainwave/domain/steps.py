"""Preprocessing steps of a record: `steps` of an `[[experiment]]`.

They are part of the study file, so that every command repeats them. `study_keys.toml` has their
keys by kind; `strainwave.io.logs.steps` applies them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import MinLen

from strainwave.domain.arm.description import Positive


@dataclass(frozen=True, slots=True)
class Detrend:
    """Subtract the mean of channels over the record, or their straight line of least squares."""

    kind: ClassVar[str] = "detrend"
    channels: Annotated[tuple[str, ...], MinLen(1)]
    degree: Literal[0, 1] = 0


@dataclass(frozen=True, slots=True)
class LowPass:
    """Filter all channels alike by a zero-phase low-pass, so that linear equations still hold."""

    kind: ClassVar[str] = "lowpass"
    cutoff_hz: Positive


@dataclass(frozen=True, slots=True)
class Resample:
    """Reduce the sampling rate of all channels behind an anti-alias low-pass."""

    kind: ClassVar[str] = "resample"
    sample_time: Positive  # [s]


@dataclass(frozen=True, slots=True)
class Merge:
    """Continue the record with a second log of the same columns."""

    kind: ClassVar[str] = "merge"
    file: Annotated[str, MinLen(1)]  # relative to the study file


Step = Detrend | LowPass | Resample | Merge

STEPS: Mapping[str, type[Step]] = {each.kind: each for each in (Detrend, LowPass, Resample, Merge)}
"""Records of the steps by their kind."""

RATES = ("omega_m", "gyro", "gx", "gy", "gz")
DETRENDABLE = (*RATES, "u", "torque", "tau_l", "a", "ax", "ay", "az", "deflection")
"""Kinds of channels in which a mean or a slope can be a fault of the sensor; `RATES` also under
gravity, which has a mean in all others."""


def files_of(table: Mapping[str, Any]) -> list[str]:
    """Files that an unchecked `[[experiment]]` table names: its log, and those that it merges."""
    steps = table.get("steps")
    tables = [table, *(steps if isinstance(steps, list) else [])]
    names = [each.get("file") for each in tables if isinstance(each, Mapping)]
    return [name for name in names if isinstance(name, str) and name]


def files_named(study: Mapping[str, Any]) -> list[str]:
    """Files that an unchecked study names, each once: logs, and the URDF if any."""
    experiments, arm = study.get("experiment"), study.get("arm")
    tables = experiments if isinstance(experiments, list) else []
    files = [name for each in tables if isinstance(each, Mapping) for name in files_of(each)]
    urdf = arm.get("urdf") if isinstance(arm, Mapping) else None
    return list(dict.fromkeys([*files, *([urdf] if isinstance(urdf, str) and urdf else [])]))
