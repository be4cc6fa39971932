"""Draw the arms of a family, and run their experiments in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from strainwave.domain import Channel, FloatArray, Log, Study
from strainwave.domain.arm import Joint
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.io.logs import read_logs
from strainwave.signals.hygiene import Kind
from strainwave.virtual.experiments import derived
from strainwave.virtual.families.catalogue import Choices, of_choices
from strainwave.virtual.families.causes import (
    NOTHING,
    Cause,
    OwnPlant,
    causes_of_the_plant,
    joint_of,
    sizes_of,
)
from strainwave.virtual.families.description import FAULTS, Family, Friction, LinkSensors, Sensors
from strainwave.virtual.families.input_faults import INPUT_FAULTS, Fault
from strainwave.virtual.families.rigs import Rig, between
from strainwave.virtual.families.sensor_defects import SIZES, injected
from strainwave.virtual.families.short_records import plans, with_short_records
from strainwave.virtual.records import recorded

_GYRO_HZ = (30.0, 200.0)
_STREAMS = ("arm", "sensors", "gravity", "effect", "fault", "records", "motion")
"""Chances that do not depend on each other: another share of faults leaves the arms as they are."""


@dataclass(frozen=True, slots=True)
class VirtualArm:
    """One arm of a family, before its experiments run."""

    rig: Rig
    cause: Cause  # what it has and its study does not mention
    fault: str | None  # kind
    seed: tuple[int, int]  # the family's, and the arm's number

    @property
    def study(self) -> Study:
        """Without a fault."""
        return self.rig.study

    @property
    def values(self) -> Values:
        """(name, joint) -> true value."""
        return self.rig.values

    @property
    def noise(self) -> SensorNoise:
        """Of its sensors."""
        return self.rig.noise

    @property
    def sample_time(self) -> float:
        """[s] of records that excite the gears."""
        return self.rig.sample_time

    @property
    def truth(self) -> Values:
        """(name, joint) -> true value of what identification reports.

        Coulomb friction that differs from record to record has none.
        """
        found = derived(self.values, self.study.arm)
        if self.cause.name == "friction-by-record":
            del found["motor_coulomb_friction", self.cause.joint]
        return found


@dataclass(frozen=True, slots=True)
class Recorded:
    """An arm's study and logs as `identify` takes them, with the fault if there is one."""

    study: Study
    data: Mapping[str, Mapping[str, FloatArray]]  # experiment -> channel -> (n_samples,)
    classes: Mapping[str, Any]  # what the arm was drawn with: plain JSON values


def draw(family: Family, number: int) -> VirtualArm:
    """One arm of a family, by its number alone.

    `number`: From 0.
    """
    chance = {name: _chance((family.seed, number), name) for name in _STREAMS}
    friction = family.friction or Friction()
    choices = Choices(
        sizes=sorted(family.sizes),
        ratios=family.ratios,
        counts=family.counts,
        sample_times=family.sample_times,
        payload=family.payload,
        coulomb=friction.coulomb,
        viscous=friction.viscous,
    )
    spring = str(chance["arm"].choice(family.springs))
    rig = of_choices(chance["arm"], spring, choices)
    upright = bool(chance["gravity"].uniform() < family.gravity)
    rig = with_short_records(rig, upright=upright, rng=chance["gravity"])
    rig = _with_sensors(rig, family.sensors or Sensors(), chance["sensors"])
    cause = _cause(family.effects, rig, chance["effect"])
    fault = _chosen(family.faults, _possible_faults(rig), chance["fault"])
    return VirtualArm(rig, cause, fault, (family.seed, number))


def record(arm: VirtualArm) -> Recorded:
    """Run an arm's experiments; put its fault into study or logs."""
    study, own = arm.study, Arm.of(arm.study.arm)
    motion = int(_chance(arm.seed, "motion").integers(2**31))
    data: dict[str, dict[str, FloatArray]] = {}
    for k, (experiment, plan) in enumerate(
        zip(study.experiments, plans(arm.rig, motion), strict=True)
    ):
        rng = np.random.default_rng([*arm.seed, _STREAMS.index("records"), k])
        plant = OwnPlant(arm.cause, k)
        data[experiment.name] = recorded(study, own, plan, arm.values, arm.noise, rng, plant)
    classes: dict[str, Any] = dict(arm.rig.classes)
    if arm.cause.name != NOTHING:
        sizes = {name: float(size) for name, size in arm.cause.sizes.items()}
        classes |= {"effect": arm.cause.name, "joint": arm.cause.joint, "sizes": sizes}
    if arm.fault is None:
        return Recorded(study, data, classes)
    put = _put(arm.fault, read_logs(study, data=data), study, _chance((*arm.seed, 1), "fault"))
    if put is None:
        return Recorded(study, data, classes)
    classes |= {"fault": put.kind, "fault_size": put.size, "fault_codes": list(put.codes)}
    return Recorded(put.study, _as_data(put.logs), classes)


def _chance(seed: tuple[int, ...], stream: str) -> np.random.Generator:
    return np.random.default_rng([*seed, _STREAMS.index(stream)])


def _chosen(
    of: float | tuple[str, ...], all_kinds: tuple[str, ...], rng: np.random.Generator
) -> str | None:
    """One of the kinds: of all for a share of the arms, or of those listed for each arm."""
    share, kinds = (1.0, of) if isinstance(of, tuple) else (of, all_kinds)
    possible = [kind for kind in kinds if kind in all_kinds]
    drawn, at = rng.uniform(), int(rng.integers(2**31))
    return possible[at % len(possible)] if possible and drawn < share else None


def _cause(of: float | tuple[str, ...], rig: Rig, rng: np.random.Generator) -> Cause:
    """An effect and its sizes, or none."""
    name = _chosen(of, causes_of_the_plant(), rng)
    if name is None:
        return Cause(NOTHING, 1, {})
    joint = joint_of(name, rig.study.arm, int(rng.integers(1, rig.study.arm.n_joints + 1)))
    return Cause(name, joint, sizes_of(name, joint, rig, rng))


def _with_sensors(rig: Rig, sensors: Sensors, rng: np.random.Generator) -> Rig:
    """Noise times a factor, and one of the sets of link sensors."""
    low, high = sensors.noise
    factor = between(rng, low, high) if low < high else low
    noise = replace(
        rig.noise,
        accelerometer_density=factor * rig.noise.accelerometer_density,
        accelerometer_bias=factor * rig.noise.accelerometer_bias,
        gyro_deviation=factor * rig.noise.gyro_deviation,
    )
    kind: LinkSensors = sensors.link[int(rng.integers(len(sensors.link)))]
    bandwidth = between(rng, *_GYRO_HZ)
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


def _put(kind: str, logs: tuple[Log, ...], study: Study, rng: np.random.Generator) -> Fault | None:
    """The fault of a kind, its joint and size by chance; None where the arm cannot show it."""
    if kind in INPUT_FAULTS:
        joint = int(rng.integers(1, study.arm.n_joints + 1))
        return INPUT_FAULTS[kind](logs, study, joint, rng)
    defect: Kind = next(each for each in SIZES if each == kind)
    unit, sizes = SIZES[defect]
    for size in rng.permutation(sizes).tolist():  # a small one may show nowhere
        put = injected(logs, Arm.of(study.arm), defect, size, rng)
        if put is not None:
            said = f"{size:g} {unit}, {put.channel} of {put.record}"
            return Fault(kind, said, (kind,), put.logs, study)
    return None


def _as_data(logs: tuple[Log, ...]) -> dict[str, dict[str, FloatArray]]:
    return {log.name: {"t": log.time, **log.channels} for log in logs}
