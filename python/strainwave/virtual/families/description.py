"""Description of a family of virtual arms: `[family]` of a campaign.toml."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le, MinLen

from strainwave.errors import InvalidInput, suggest_name
from strainwave.io.study.reader import Reader
from strainwave.virtual.families.catalogue import GEAR_CATALOGUE, SPRINGS, Choices, Friction, Range
from strainwave.virtual.families.causes import cause_names
from strainwave.virtual.families.input_faults import INPUT_FAULTS
from strainwave.virtual.families.sensor_defects import DEFECT_SIZES

Share = Annotated[float, Ge(0.0), Le(1.0)]
LinkSensors = Literal["accelerometer", "gyro", "accelerometer-and-gyro", "encoder", "none"]

FAULTS: tuple[str, ...] = (*INPUT_FAULTS, *DEFECT_SIZES)
"""Kinds of faults: errors of the study and its logs, then defects of sensors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensors:
    """Noise and link sensors: `sensors`."""

    noise: Range = (1.0, 1.0)  # factors on the densities of `SensorNoise`
    link: Annotated[tuple[LinkSensors, ...], MinLen(1)] = ("accelerometer",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Family(Choices):
    """Distribution of arms. Seed and number determine an arm."""

    arms: Annotated[int, Ge(1)]  # number of arms
    seed: Annotated[int, Ge(0)] = 0
    springs: Annotated[tuple[str, ...], MinLen(1)] = SPRINGS
    gravity: Share = 0.0  # share of arms with gravity in the plane of motion
    sensors: Sensors | None = None  # None: the sensors of the default rig
    faults: Share | tuple[str, ...] = 0.0  # share of arms with a fault, or kinds of faults
    effects: Share | tuple[str, ...] = 0.0  # unmentioned effects: share of arms, or names


def family_of(table: Mapping[str, Any], path: Path, text: str) -> Family:
    """Family of a parsed `[family]` table. `path` and `text` of the file serve messages.

    Raises InvalidInput if a key is missing or unknown, or if a value has an invalid type or range.
    """
    reader = Reader(path, text)
    family = reader.record(Family, table, "family")
    known: dict[str, tuple[Any, ...]] = {
        "sizes": tuple(GEAR_CATALOGUE),
        "springs": SPRINGS,
        "faults": FAULTS,
        "effects": cause_names(),
    }
    for key, names in known.items():
        kinds = getattr(family, key)
        if isinstance(kinds, tuple):
            _check_known(kinds, names, key, reader)
    friction, sensors = family.friction or Friction(), family.sensors or Sensors()
    ranges = {"payload": family.payload, "friction": friction.coulomb, "sensors": sensors.noise}
    for key, bounds in (*ranges.items(), ("friction", friction.viscous)):
        if bounds is not None and bounds[0] > bounds[1]:
            raise InvalidInput(
                f"the range of '{key}' from {bounds[0]:g} to {bounds[1]:g} is empty",
                where=reader.place("family", None, key),
                remedy="put the lower bound first",
            )
    return family


def _check_known(kinds: Iterable[Any], known: tuple[Any, ...], key: str, reader: Reader) -> None:
    for value in kinds:
        if value not in known:
            near = suggest_name(value, known) if isinstance(value, str) else ""
            raise InvalidInput(
                f"'{key}' contains the unknown value {value!r}",
                where=reader.place("family", None, key),
                remedy=f"use {', '.join(map(str, known))}{near}",
            )


def fields_of(family: Family) -> dict[str, Any]:
    """Table of a family in plain JSON values."""

    def known(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        return {key: value for key, value in pairs if value is not None}

    table: dict[str, Any] = json.loads(json.dumps(asdict(family, dict_factory=known)))
    return table
