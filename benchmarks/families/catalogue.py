"""Arms drawn over a gear catalogue: sizes 8 to 40, ratios 30 to 160, all encoders and sample times.

An arm is drawn by a designer's choices: gears, anti-resonances, and motors that match their loads
and load the gears beyond their knees at full voltage. Every drawn arm could be built.

Shortest records that identification needs: 10 to 20 s of an arm, 4 to 6 s of one core.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Le, MinLen

from benchmarks.families.rigs import Rig, between, rig_experiments
from strainwave.domain import Control, Joint, Prbs, Servo, Spring, Study
from strainwave.domain.arm.description import NonNegative, Positive
from strainwave.domain.arm.kinds import planar_two_link
from strainwave.domain.arm.kinds.planar import in_plane_gravity
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.virtual.experiments import Plan, default_plan

GEAR_CATALOGUE = {
    # size: T1, T2 [N m]; K1, K2, K3 [10^4 N m/rad] at ratios of 80 and above; the same at 50
    8: ((0.29, 0.75), (0.091, 0.104, 0.12), (0.044, 0.067, 0.084)),
    11: ((0.80, 2.0), (0.27, 0.34, 0.44), (0.22, 0.30, 0.32)),
    14: ((2.0, 6.9), (0.47, 0.61, 0.71), (0.34, 0.47, 0.57)),
    17: ((3.9, 12.0), (1.0, 1.4, 1.6), (0.81, 1.1, 1.3)),
    20: ((7.0, 25.0), (1.6, 2.5, 2.9), (1.3, 1.8, 2.3)),
    25: ((14.0, 48.0), (3.1, 5.0, 5.7), (2.5, 3.4, 4.4)),
    32: ((29.0, 108.0), (6.7, 11.0, 12.0), (5.4, 7.8, 9.8)),
    40: ((54.0, 196.0), (13.0, 20.0, 23.0), (10.0, 14.0, 18.0)),
}
GEAR_RATIOS = (30, 50, 80, 100, 120, 160)  # motor turns per link turn
ENCODER_COUNTS = (1000, 2000, 4096, 8192, 65536, 1_000_000)  # of encoders, per motor turn
SAMPLE_TIMES = (2e-3, 1e-3, 5e-4, 2.5e-4, 1e-4)  # [s]
SPRINGS: tuple[Spring, ...] = ("linear", "three-slope")
MAX_SMALL_SIZE, MIN_LARGE_SIZE = 14, 25  # of the classes "small" and "large"
_ACCELEROMETER_RANGES = tuple(
    9.81 * g for g in (2.0, 5.0, 10.0, 20.0, 50.0, 200.0, 1000.0)
)  # [m/s^2]
_VOLTAGE_LIMIT = 10.0  # [V]
_SERVO_BANDWIDTH = 20.0  # [rad/s] of the velocity loop of a rigid joint
_KI_RATIO = 12.5  # [1/s] ki over kp


Range = tuple[Positive, Positive]


@dataclass(frozen=True, slots=True, kw_only=True)
class Friction:
    """Lowest and highest factors on the catalogue's friction: `friction`."""

    coulomb: Range = (1.0, 1.0)
    viscous: Range = (1.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choices:
    """Values from which an arm is drawn."""

    sizes: Annotated[tuple[int, ...], MinLen(1)] = tuple(GEAR_CATALOGUE)  # of gears
    ratios: Annotated[tuple[Annotated[float, Ge(10.0), Le(500.0)], ...], MinLen(1)] = GEAR_RATIOS
    counts: Annotated[tuple[Annotated[int, Ge(100)], ...], MinLen(1)] = ENCODER_COUNTS[1:]
    sample_times: Annotated[tuple[Annotated[float, Ge(2e-5), Le(2e-3)], ...], MinLen(1)] = (
        SAMPLE_TIMES[:3]  # [s]
    )
    payload: tuple[NonNegative, NonNegative] | None = None  # [kg] at the tip
    friction: Friction | None = None  # None: the catalogue's


def drawn(seed: int, series: int = 0) -> Rig:
    """One arm of the catalogue with its sensors and experiments, by its seed within a series."""
    rng = np.random.default_rng([8, 40, series, seed])
    choices = Choices(counts=ENCODER_COUNTS, sample_times=SAMPLE_TIMES)
    return of_choices(rng, SPRINGS[seed % len(SPRINGS)], choices)


def of_choices(rng: np.random.Generator, spring: Spring, choices: Choices) -> Rig:
    """One arm of the catalogue, drawn from given choices.

    The gear of joint 2 has the size of joint 1's or up to two sizes less. A payload m at the tip
    adds m l1^2, m l2^2 and m l1 l2 to alpha, beta and gamma before motors and gains are chosen.
    `spring` is "linear" or "three-slope".
    """
    sizes = sorted(choices.sizes)
    base = int(rng.integers(0, len(sizes)))
    outer = int(rng.integers(max(0, base - 2), base + 1))
    ratios = rng.choice(choices.ratios, 2)
    counts = int(rng.choice(choices.counts))
    sample_time = float(rng.choice(choices.sample_times))
    bandwidth = between(rng, 50.0, 1000.0)
    frequency = [between(rng, 7.0, min(45.0, 0.04 / sample_time)) for _ in range(2)]
    slopes = [
        _gear_slopes(sizes[k], int(ratio)) for k, ratio in zip((base, outer), ratios, strict=True)
    ]
    inertia = [k[1] / (2.0 * np.pi * f) ** 2 for k, f in zip(slopes, frequency, strict=True)]
    friction = choices.friction or Friction()
    values, load, length, payload = _draw_links(rng, inertia, choices.payload)
    drives = [
        _draw_drive(rng, spring, friction, i, size, float(ratio), slopes[i], load[i])
        for i, (size, ratio) in enumerate(zip((sizes[base], sizes[outer]), ratios, strict=True))
    ]
    joints = [
        replace(
            drive.joint,
            encoder_counts=counts,
            accelerometer_distance=0.9 * length[i],
            accelerometer_hz=bandwidth,
        )
        for i, drive in enumerate(drives)
    ]
    values |= {key: value for drive in drives for key, value in drive.values.items()}
    peak = max(
        15.0 * GEAR_CATALOGUE[size][0][1] / load[i] * (0.9 * length[i] + i * length[0])
        for i, size in enumerate((sizes[base], sizes[outer]))
    )
    study = Study(
        path=Path("study.toml"),
        sha256="",
        arm=planar_two_link(
            joints,
            link_length=length[0],
            servo=Servo(
                "pi-velocity",
                period=max(1e-3, sample_time),
                kp=tuple(drive.kp for drive in drives),
                ki=tuple(_KI_RATIO * drive.kp for drive in drives),
                limit=_VOLTAGE_LIMIT,
            ),
        ),
        experiments=rig_experiments(spring, Prbs(10, max(1e-3, sample_time), 2, _VOLTAGE_LIMIT)),
    )
    sensor_range = next((a for a in _ACCELEROMETER_RANGES if a > peak), _ACCELEROMETER_RANGES[-1])
    classes = _arm_classes(sizes[base], counts, sample_time, bandwidth) | {"spring": spring}
    if choices.payload:
        classes["payload"] = f"{payload:.3g} kg"
    noise = SensorNoise(accelerometer_range=sensor_range)
    return Rig(study, values, noise, sample_time, classes)


@dataclass(frozen=True, slots=True)
class _Drive:
    """Motor and gear of one joint."""

    joint: Joint
    values: Values
    kp: float  # [V s/rad] of the servo


def _draw_drive(
    rng: np.random.Generator,
    spring: Spring,
    friction: Friction,
    i: int,
    size: int,
    ratio: float,
    slopes: Sequence[float],
    load: float,
) -> _Drive:
    """Motor and gear of joint i, from 0, for a load inertia [kg m^2] at the link."""
    n, knees, stiffness = 1.0 / ratio, GEAR_CATALOGUE[size][0], slopes[1]
    torque = float(rng.uniform(2.0, 4.5)) * knees[1] * n  # of the motor at full voltage
    motor = n**2 * load * between(rng, 0.2, 1.2)
    dry = float(rng.uniform(0.04, 0.12)) * torque
    viscous = dry * n * float(rng.uniform(0.15, 0.5)) * _draw_factor(rng, friction.viscous)
    coulomb = dry * _draw_factor(rng, friction.coulomb)
    damping = 2.0 * between(rng, 0.015, 0.05) * np.sqrt(stiffness * load)
    drive = {
        "motor_inertia": motor,
        "motor_viscous_friction": viscous,
        "motor_coulomb_friction": coulomb,
        "friction_offset": float(rng.uniform(-0.05, 0.05)) * coulomb,
        "link_viscous_friction": viscous / n**2 * float(rng.uniform(0.1, 0.4)),
        "gear_damping": damping,
    }
    if spring == "linear":
        drive["gear_stiffness"] = stiffness
    else:
        drive |= {f"gear_stiffness_k{k}": slope for k, slope in enumerate(slopes, start=1)}
        drive |= {f"gear_knee_t{k}": knee for k, knee in enumerate(knees, start=1)}
    per_volt = torque / _VOLTAGE_LIMIT
    joint = Joint(
        spring=spring,
        gear_ratio=n,
        torque_per_volt=per_volt,
        current_loop_hz=between(rng, 500.0, 1000.0),
    )
    values: Values = {(name, i + 1): float(value) for name, value in drive.items()}
    return _Drive(joint, values, _SERVO_BANDWIDTH * (motor + n**2 * load) / per_volt)


def _arm_classes(size: int, counts: int, sample_time: float, bandwidth: float) -> dict[str, str]:
    """Groups of an arm in statistics."""
    return {
        "size": _classify(size, (MAX_SMALL_SIZE, MIN_LARGE_SIZE), ("small", "medium", "large")),
        "counts": _classify(counts, (2000, 8192), ("up to 2,000", "to 8,192", "more")),
        "sampling": _classify(
            1.0 / sample_time, (1000.0, 4000.0), ("up to 1 kHz", "to 4 kHz", "more")
        ),
        "bandwidth": _classify(bandwidth, (100.0, 300.0), ("up to 100 Hz", "to 300 Hz", "more")),
    }


class _Links(NamedTuple):
    values: Values  # base parameters (3)
    load: tuple[float, float]  # inertia at each joint of the stretched arm [kg m^2]
    length: tuple[float, float]
    payload: float  # [kg]


def _draw_links(
    rng: np.random.Generator, inertia: Sequence[float], payloads: tuple[float, float] | None
) -> _Links:
    beta = min(inertia[1], inertia[0] / 3.0)  # joint 1 carries the load of joint 2
    coupling = float(rng.uniform(0.3, 0.75))
    root = -coupling * np.sqrt(beta) + np.sqrt(coupling**2 * beta + inertia[0] - beta)
    alpha, gamma = root**2, coupling * root * np.sqrt(beta)
    length = (between(rng, 0.1, 1.0), between(rng, 0.1, 1.0))
    payload = float(rng.uniform(*payloads)) if payloads else 0.0
    values: Values = {
        ("alpha", None): alpha + payload * length[0] ** 2,
        ("beta", None): beta + payload * length[1] ** 2,
        ("gamma", None): gamma + payload * length[0] * length[1],
    }
    load = (inertia[0] + payload * sum(length) ** 2, values["beta", None])
    return _Links(values, load, length, payload)


def _gear_slopes(size: int, ratio: int) -> list[float]:
    """K1, K2, K3 [N m/rad] of a gear."""
    _, high, low = GEAR_CATALOGUE[size]
    return [1e4 * slope for slope in (low if ratio <= 50 else high)]


def _draw_factor(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """Random factor within its bounds; equal bounds draw no random number."""
    return between(rng, *bounds) if bounds[0] < bounds[1] else bounds[0]


def _classify(value: float, edges: tuple[float, float], names: tuple[str, str, str]) -> str:
    return names[0] if value <= edges[0] else names[1] if value <= edges[1] else names[2]


_MOTION_DURATION = 6.0  # [s]
_STANDARD_GRAVITY = 9.81  # [m/s^2]
_MAX_GRAVITY_SHARE = 0.35  # of the largest torque of a drive
_VOLTAGE, _UPRIGHT_VOLTAGE = 10.0, 5.0  # [V]; the servo of an upright arm needs the rest


def plans(rig: Rig, seed: int) -> list[Plan]:
    """One plan per experiment of `with_short_records`. `seed` is that of the motions."""
    arm = Arm.of(rig.study.arm)
    plans = []
    for number, experiment in enumerate(rig.study.experiments):
        rng = np.random.default_rng([seed, number])
        plan = default_plan(rig.study.path, arm, experiment, rig.values, rng, rig.sample_time)
        if experiment.use == "motion":
            ticks = round(_MOTION_DURATION / plan.drive.tick)
            drive = replace(
                plan.drive,
                voltage=plan.drive.voltage[:ticks],
                reference=plan.drive.reference[:ticks],
            )
            plan = replace(plan, drive=drive, samples=round(_MOTION_DURATION / plan.sample_time))
        plans.append(plan)
    return plans


def with_short_records(rig: Rig, *, upright: bool, rng: np.random.Generator) -> Rig:
    """Rig with few short records, under servos and a gravity that they can hold if it is upright.

    The records are a motion of 6 s and, for each joint, a PRBS of two periods of 511 clocks, a
    sweep at lower amplitude for three-slope springs, and a step.
    """
    arm, values = rig.study.arm, rig.values
    servo = arm.servo
    if upright and servo is not None:
        length = arm.joints[1].origin.xyz[0]
        first = values["alpha", None] / length * rng.uniform(0.8, 1.2)
        second = values["gamma", None] / length
        limits = [
            _MAX_GRAVITY_SHARE * j.torque_per_command * servo.limit / j.gear_ratio
            for j in arm.joints
        ]
        gravity = min(_STANDARD_GRAVITY, limits[0] / (first + second), limits[1] / second)
        arm = replace(arm, gravity=in_plane_gravity(float(gravity)))
        torques: Values = {("gravity_torque_1", None): gravity * first}
        values = values | torques | {("gravity_torque_2", None): gravity * second}
    prbs = Prbs(9, servo.period if servo else 1e-3, 2, _VOLTAGE)
    control: tuple[Control, Control] = ("open", "open")
    if upright:
        control, prbs = ("servo", "servo"), replace(prbs, amplitude=_UPRIGHT_VOLTAGE)
    experiments = rig_experiments(arm.joints[0].spring, prbs, control)
    study = replace(rig.study, arm=arm, experiments=experiments)
    classes = rig.classes | {"gravity": "upright" if upright else "horizontal"}
    return replace(rig, study=study, values=values, classes=classes)
