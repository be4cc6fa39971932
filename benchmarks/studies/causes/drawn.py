"""An arm, its records and one cause by chance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from benchmarks.studies import catalogue
from benchmarks.studies.arms import Rig
from strainwave.domain import Control, Experiment, FloatArray, Prbs, Spring, Study, Use
from strainwave.domain.effects import KnownJoint, effect_named, names
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate
from strainwave.virtual.plans import Plan, invented

NOTHING = "none"
_SIZES = (0.3, 3.0)  # of an effect's typical sizes
_SHAPES = 1.3  # times and over those that an effect starts from
_OF_THE_MOTOR = {"torque_ripple_order", "kinematic_error_order"}  # shapes that are whole numbers
_SEEDS = 1_000_000  # even: an arm that is drawn again has the same kind of spring
_SERIES = 7000  # of the catalogue, from here on
_FEWEST_COUNTS = 2000
_SHORTEST_SAMPLE = 5e-4  # [s]
_MOTION_SECONDS = 6.0
_UPRIGHT = 1.0 / 3.0  # of the arms
_GRAVITY = 9.81  # [m/s^2]
_HELD = 0.35  # of a drive's largest torque that gravity may take
_UPRIGHT_SHARE = 0.5  # of the voltage that shakes an upright arm, the rest being its servo's
_SWEEP_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class Cause:
    """What an arm has and its study does not mention."""

    name: str
    joint: int  # from 1
    sizes: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Run:
    """A drawn arm with a cause; `number` counts the runs of one cause."""

    rig: Rig
    cause: Cause
    number: int


def causes(engine: str) -> tuple[str, ...]:
    """What an engine can give an arm: "own" or "mujoco"."""
    if engine == "mujoco":
        from benchmarks.studies.causes.in_mujoco import CAUSES
    else:
        from benchmarks.studies.causes.in_own_plant import causes_of_the_plant

        return causes_of_the_plant()
    return CAUSES


def drawn(name: str, number: int, series: int = 0) -> Run:
    """The arm and the sizes of one run.

    Parameters
    ----------
    name : str
        Of the cause.
    number : int
        Among the runs of that cause.
    series : int
        Another one draws all anew.

    Returns
    -------
    Run
    """
    of_cause = crc32(name.encode())
    rig = _with_a_fair_encoder(of_cause % _SEEDS + number, series)
    rig = replace(rig, sample_time=max(rig.sample_time, _SHORTEST_SAMPLE))
    rng = np.random.default_rng([series, of_cause, number])
    rig = _with_records(rig, upright=bool(rng.uniform() < _UPRIGHT), rng=rng)
    joint = int(rng.integers(1, rig.study.arm.n_joints + 1))
    if name == "encoder-zero" and not rig.study.arm.gravity:
        joint = 2  # the first one's is not observable without gravity
    if name in ("tilt", "soft-base"):
        joint = 1  # and all above it
    return Run(rig, Cause(name, joint, _sizes(name, joint, rig, rng)), number)


def _with_a_fair_encoder(seed: int, series: int) -> Rig:
    """An arm of the catalogue whose short records show its friction."""
    while True:
        rig = catalogue.drawn(seed, _SERIES + series)
        if min(joint.encoder_counts or 0.0 for joint in rig.study.arm.joints) >= _FEWEST_COUNTS:
            return rig
        seed += _SEEDS


def plans(rig: Rig, seed: int) -> list[Plan]:
    """What is applied in each experiment."""
    arm = Arm.of(rig.study.arm)
    found = []
    for number, experiment in enumerate(rig.study.experiments):
        rng = np.random.default_rng([seed, number])
        plan = invented(rig.study.path, arm, experiment, rig.values, rng, rig.sample_time)
        if experiment.use == "motion":
            plan = _shortened(plan, _MOTION_SECONDS)
        found.append(plan)
    return found


def _shortened(plan: Plan, seconds: float) -> Plan:
    ticks = round(seconds / plan.drive.tick)
    drive = replace(
        plan.drive, voltage=plan.drive.voltage[:ticks], reference=plan.drive.reference[:ticks]
    )
    return replace(plan, drive=drive, samples=round(seconds / plan.sample_time))


def _with_records(rig: Rig, *, upright: bool, rng: np.random.Generator) -> Rig:
    """Few records; servos hold what stands upright, under a gravity that they can hold."""
    arm, values = rig.study.arm, rig.values
    servo = arm.servo
    if upright and servo is not None and arm.link_length is not None:
        first = values["alpha", None] / arm.link_length * rng.uniform(0.8, 1.2)
        second = values["gamma", None] / arm.link_length
        held = [_HELD * (j.torque_per_volt or 1.0) * servo.limit / j.gear_ratio for j in arm.joints]
        gravity = min(_GRAVITY, held[0] / (first + second), held[1] / second)
        arm = replace(arm, gravity=float(gravity))
        torques: Values = {("gravity_torque_1", None): gravity * first}
        values = values | torques | {("gravity_torque_2", None): gravity * second}
    clock = servo.period if servo else 1e-3
    experiments = _experiments(arm.joints[0].spring, clock, upright=upright)
    study = replace(rig.study, arm=arm, experiments=experiments)
    classes = rig.classes | {"gravity": "upright" if upright else "horizontal"}
    return replace(rig, study=study, values=values, classes=classes)


def _experiments(spring: Spring, clock: float, *, upright: bool) -> tuple[Experiment, ...]:
    both: tuple[Control, Control] = ("servo", "servo")
    control: tuple[Control, Control] = both if upright else ("open", "open")
    volt = 10.0 * (_UPRIGHT_SHARE if upright else 1.0)
    found = [Experiment("motion", "motion.csv", "motion", both)]

    def shaken(name: str, use: Use, joint: int, volt: float) -> None:
        prbs = Prbs(9, clock, 2, volt)
        name = f"{name}-j{joint}"
        found.append(Experiment(name, f"{name}.csv", use, control, joint=joint, prbs=prbs))

    for j in (1, 2):
        shaken("prbs", "frequency", j, volt)
        if spring == "three-slope":
            shaken("sweep", "sweep", j, _SWEEP_SHARE * volt)
        found.append(Experiment(f"step-j{j}", f"step-j{j}.csv", "tuning", both, joint=j))
    return tuple(found)


def _sizes(name: str, joint: int, rig: Rig, rng: np.random.Generator) -> dict[str, float]:
    """Those of an effect about what it calls typical, of all others what rigs are known for."""
    stated = _stated(name, rig, joint, rng)
    effect = effect_named(name) if name in names() else None
    if effect is None or effect.core_name is None:
        return stated
    typical = effect.typical_sizes(known_joint(rig, joint))
    factor = between(rng, *_SIZES)
    sizes = {key: factor * value for key, value in typical.items()}
    signed = [key for key in effect.sizes if effect.is_signed(key)]
    angle = rng.uniform(0.0, 2.0 * np.pi)
    if len(signed) == 2:
        sizes[signed[0]] *= float(np.cos(angle))
        sizes[signed[1]] *= float(np.sin(angle))
    elif signed:
        sizes[signed[0]] *= float(np.sign(np.cos(angle)))
    for key, value in effect.shapes.items():
        own = 1.0 if key in _OF_THE_MOTOR else between(rng, 1.0 / _SHAPES, _SHAPES)
        sizes[key] = own * value
    return sizes | stated


def _stated(name: str, rig: Rig, joint: int, rng: np.random.Generator) -> dict[str, float]:
    """Sizes that are not drawn about an effect's typical ones; those of effects by their names."""
    study = rig.study
    limit = study.arm.servo.limit if study.arm.servo else 10.0
    sign, azimuth = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-np.pi, np.pi))
    log_factors = rng.standard_normal(len(study.experiments))
    log_factors -= log_factors.mean()

    def by_record(least: float, most: float) -> dict[str, float]:
        factors = np.exp(between(rng, least, most) * log_factors)
        return {f"factor_{k}": float(factor) for k, factor in enumerate(factors)}

    sizes: dict[str, Callable[[], dict[str, float]]] = {
        "drive-gain": lambda: {"gain": 1.0 + sign * between(rng, 0.01, 0.1)},
        # the torque constant falls with the current
        "drive-saturation": lambda: {"drive_saturation": between(rng, 0.02, 0.15) / limit},
        "drive-limit": lambda: {  # it clips
            "drive_limit_loss": 1.0,
            "drive_limit": rng.uniform(0.6, 0.9) * known_joint(rig, joint).largest_voltage,
        },
        "drive-lag": lambda: _slower(between(rng, 60.0, 300.0), study, joint),
        "kinematic-error": lambda: {"kinematic_error_order": float(rng.choice([2.0, 4.0]))},
        "dead-zone": lambda: {"dead_zone": between(rng, 0.003, 0.03) * limit},
        "tilt": lambda: {"angle": sign * np.radians(between(rng, 0.3, 3.0)), "azimuth": azimuth},
        "encoder-zero": lambda: {"angle": sign * np.radians(between(rng, 0.5, 5.0))},
        "sensor-mount": lambda: {
            "frequency": between(rng, 40.0, 200.0),
            "damping_ratio": between(rng, 0.01, 0.1),
        },
        "friction-by-record": lambda: by_record(0.05, 0.3),
        "drive-gain-by-record": lambda: by_record(0.01, 0.05),
        "flexible-link": lambda: {  # stiffness over that of the gear
            "stiffness": between(rng, 2.0, 20.0),
            "damping_ratio": between(rng, 0.005, 0.03),
        },
        "soft-base": lambda: {  # how its feet let it slide, its mass over the links'
            "sliding_frequency": between(rng, 50.0, 200.0),
            "mass": between(rng, 2.0, 10.0),
            "base_damping": between(rng, 0.01, 0.1),
        },
    }
    return sizes[name]() if name in sizes else {}


def _slower(bandwidth: float, study: Study, joint: int) -> dict[str, float]:
    """A current loop of another bandwidth [Hz], and the lag beside the study's that is as late."""
    stated = study.arm.joints[joint - 1].current_loop_hz or np.inf
    lag = (1.0 / bandwidth - 1.0 / stated) / (2.0 * np.pi)
    return {"bandwidth": bandwidth, "drive_lag": lag}


def known_joint(rig: Rig, joint: int) -> KnownJoint:
    """What effects take their typical sizes from, by the arm's truth."""
    arm = Arm.of(rig.study.arm)
    torque = voltage = 0.0
    for experiment, plan in zip(rig.study.experiments, plans(rig, 0), strict=True):
        if experiment.use == "frequency" and experiment.joint == joint:
            run = simulate(
                arm,
                rig.values,
                plan.drive,
                sample_time=plan.sample_time,
                samples=plan.samples,
                record=["gear_torque", "voltage"],
            )
            torque = float(np.abs(run["gear_torque"][:, joint - 1]).max())
            voltage = float(np.abs(run["voltage"][:, joint - 1]).max())
    law = arm.joints[joint - 1].law
    stiffness: FloatArray = law.stiffness(law.of_joint(rig.values, joint), np.zeros(1))
    return KnownJoint(
        gear_ratio=arm.joints[joint - 1].gear_ratio,
        coulomb_friction=rig.values["motor_coulomb_friction", joint],
        stiffness=float(stiffness[0]),
        largest_torque=torque,
        largest_voltage=voltage,
    )


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """Drawn evenly among logarithms."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def can_be_named(name: str) -> bool:
    """Whether a study can name a cause among its effects."""
    return name in names()
