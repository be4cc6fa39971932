"""Draw the arms of a family and simulate their experiments in memory.

`[family]` of a file describes a family of virtual arms.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le, MinLen

from benchmarks.families.catalogue import (
    GEAR_CATALOGUE,
    SPRINGS,
    Choices,
    Friction,
    Range,
    of_choices,
    plans,
    with_short_records,
)
from benchmarks.families.causes import (
    NO_CAUSE,
    Cause,
    OwnPlant,
    cause_names,
    joint_of,
    sizes_of,
)
from benchmarks.families.input_faults import INPUT_FAULTS, Fault
from benchmarks.families.rigs import Rig, between
from benchmarks.families.sensor_defects import DEFECT_SIZES, injected
from strainwave.domain import Channel, FloatArray, Log, Study
from strainwave.domain.arm.description import Joint
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, suggest_name
from strainwave.io.logs import read_logs
from strainwave.io.study.reader import Reader
from strainwave.signals.hygiene import Kind
from strainwave.virtual.experiments import derived, record_experiment

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


_GYRO_BANDWIDTH_HZ = (30.0, 200.0)  # limits of a log-uniform distribution
_STREAMS = ("arm", "sensors", "gravity", "effect", "fault", "records", "motion")
"""Independent random streams: another share of faults does not change the arms."""


@dataclass(frozen=True, slots=True)
class VirtualArm:
    """One arm of a family before its experiments are simulated."""

    rig: Rig
    cause: Cause  # not mentioned in its study
    fault: str | None  # kind of the fault in its input
    seed: tuple[int, int]  # seed of the family, number of the arm

    @property
    def truth(self) -> Values:
        """True values of the reported parameters by name and joint.

        Coulomb friction that varies between records has no true value.
        """
        values = derived(self.rig.values, self.rig.study.arm)
        if self.cause.name == "friction-by-record":
            del values["motor_coulomb_friction", self.cause.joint]
        return values


@dataclass(frozen=True, slots=True)
class Recorded:
    """Study and logs of an arm as `identify` takes them, with the fault if there is one."""

    study: Study
    data: Mapping[str, Mapping[str, FloatArray]]  # by experiment and channel, (n_samples,)
    classes: Mapping[str, Any]  # drawn properties in plain JSON values


def draw(family: Family, number: int) -> VirtualArm:
    """Arm of a family by its number, from 0."""
    rngs = {name: _rng((family.seed, number), name) for name in _STREAMS}
    spring = str(rngs["arm"].choice(family.springs))
    rig = of_choices(rngs["arm"], spring, family)
    upright = bool(rngs["gravity"].uniform() < family.gravity)
    rig = with_short_records(rig, upright=upright, rng=rngs["gravity"])
    rig = _with_sensors(rig, family.sensors or Sensors(), rngs["sensors"])
    cause = _cause(family.effects, rig, rngs["effect"])
    fault = _draw_kind(family.faults, _possible_faults(rig), rngs["fault"])
    return VirtualArm(rig, cause, fault, (family.seed, number))


def record(arm: VirtualArm) -> Recorded:
    """Simulate an arm's experiments and inject its fault into study or logs."""
    rig, study = arm.rig, arm.rig.study
    motion = int(_rng(arm.seed, "motion").integers(2**31))
    data: dict[str, dict[str, FloatArray]] = {}
    for k, (experiment, plan) in enumerate(zip(study.experiments, plans(rig, motion), strict=True)):
        rng = np.random.default_rng([*arm.seed, _STREAMS.index("records"), k])
        plant = OwnPlant(arm.cause, k)
        data[experiment.name] = record_experiment(
            study, Arm.of(study.arm), plan, rig.values, rig.noise, rng, plant
        )
    classes: dict[str, Any] = dict(rig.classes)
    if arm.cause.name != NO_CAUSE:
        sizes = {name: float(size) for name, size in arm.cause.sizes.items()}
        classes |= {"effect": arm.cause.name, "joint": arm.cause.joint, "sizes": sizes}
    if arm.fault is None:
        return Recorded(study, data, classes)
    fault = _inject(arm.fault, read_logs(study, data=data), study, _rng((*arm.seed, 1), "fault"))
    if fault is None:
        return Recorded(study, data, classes)
    classes |= {"fault": fault.kind, "fault_size": fault.size, "fault_codes": list(fault.codes)}
    data = {log.name: {"t": log.time, **log.channels} for log in fault.logs}
    return Recorded(fault.study, data, classes)


def _rng(seed: tuple[int, ...], stream: str) -> np.random.Generator:
    return np.random.default_rng([*seed, _STREAMS.index(stream)])


def _draw_kind(
    of: float | tuple[str, ...], all_kinds: tuple[str, ...], rng: np.random.Generator
) -> str | None:
    """One kind: of all kinds for a share of the arms, or of the given kinds for every arm."""
    share, kinds = (1.0, of) if isinstance(of, tuple) else (of, all_kinds)
    possible = [kind for kind in kinds if kind in all_kinds]
    draw_value, index = rng.uniform(), int(rng.integers(2**31))
    return possible[index % len(possible)] if possible and draw_value < share else None


def _cause(of: float | tuple[str, ...], rig: Rig, rng: np.random.Generator) -> Cause:
    """A cause with its sizes, or none."""
    name = _draw_kind(of, cause_names(), rng)
    if name is None:
        return Cause(NO_CAUSE, 1, {})
    joint = joint_of(name, rig.study.arm, int(rng.integers(1, rig.study.arm.n_joints + 1)))
    return Cause(name, joint, sizes_of(name, joint, rig, rng))


def _with_sensors(rig: Rig, sensors: Sensors, rng: np.random.Generator) -> Rig:
    """Rig with scaled noise and one of the sets of link sensors."""
    low, high = sensors.noise
    factor = between(rng, low, high) if low < high else low
    noise = replace(
        rig.noise,
        accelerometer_density=factor * rig.noise.accelerometer_density,
        accelerometer_bias=factor * rig.noise.accelerometer_bias,
        gyro_std=factor * rig.noise.gyro_std,
    )
    kind: LinkSensors = sensors.link[int(rng.integers(len(sensors.link)))]
    bandwidth = between(rng, *_GYRO_BANDWIDTH_HZ)
    arm = rig.study.arm
    joints = [_with_sensor(joint, kind, bandwidth) for joint in arm.joints]
    encoders = {
        name: Channel(name)
        for name in (f"theta_l{i}" for i in range(1, arm.n_joints + 1))
        if kind == "encoder"
    }
    study = replace(rig.study, arm=arm.with_joints(joints), channels=encoders)
    classes = rig.classes | {"link sensors": kind, "noise": f"{factor:.3g}"}
    return replace(rig, study=study, noise=noise, classes=classes)


def _with_sensor(joint: Joint, kind: LinkSensors, bandwidth: float) -> Joint:
    if kind not in ("accelerometer", "accelerometer-and-gyro"):
        joint = replace(joint, accelerometer_distance=None, accelerometer_hz=None)
    return replace(joint, gyro_hz=bandwidth) if "gyro" in kind else joint


def _possible_faults(rig: Rig) -> tuple[str, ...]:
    """Kinds of faults that an arm's sensors can have."""
    joints = rig.study.arm.joints
    accelerometer = all(joint.accelerometer_distance for joint in joints)
    link = accelerometer or all(joint.gyro_hz for joint in joints)
    needs_accelerometer = ("accelerometer-unit", "accelerometer-sign", "geometry", "clipped-sensor")
    without: set[str] = set() if accelerometer else {*needs_accelerometer, "flat-tops"}
    if not link:
        without |= {"late-sensors", "fast-clock", "mains-hum"}
    return tuple(kind for kind in FAULTS if kind not in without)


def _inject(
    kind: str, logs: tuple[Log, ...], study: Study, rng: np.random.Generator
) -> Fault | None:
    """Fault of a kind with random joint and size; None if the arm cannot show it."""
    if kind in INPUT_FAULTS:
        joint = int(rng.integers(1, study.arm.n_joints + 1))
        return INPUT_FAULTS[kind](logs, study, joint, rng)
    defect: Kind = next(defect_kind for defect_kind in DEFECT_SIZES if defect_kind == kind)
    unit, sizes = DEFECT_SIZES[defect]
    for size in rng.permutation(sizes).tolist():  # a small defect may have no effect
        injection = injected(logs, Arm.of(study.arm), defect, size, rng)
        if injection is not None:
            text = f"{size:g} {unit}, {injection.channel} of {injection.record}"
            return Fault(kind, text, (kind,), injection.logs, study)
    return None
