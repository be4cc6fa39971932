"""What an arm has and its study does not mention: effects by the core, the rest around it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import ArmDescription, FloatArray, Study
from strainwave.domain.effects import KnownJoint, all_effects, effect_named, names
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Quantity, Trajectory, simulate
from strainwave.virtual.families.rigs import Rig, between
from strainwave.virtual.families.short_records import plans

NOTHING = "none"
_SIZES = (0.3, 3.0)  # of an effect's typical sizes
_SHAPES = 1.3  # times and over those that an effect starts from
_OF_THE_MOTOR = {"torque_ripple_order", "kinematic_error_order"}  # shapes that are whole numbers
_AROUND_IT = (
    "drive-gain",
    "encoder-zero",
    "sensor-mount",
    "friction-by-record",
    "drive-gain-by-record",
)
"""Causes that need no equation of the core."""
_FINER = 10  # times the samples between which a mount's motion is straight lines


@dataclass(frozen=True, slots=True)
class Cause:
    """What an arm has and its study does not mention."""

    name: str
    joint: int  # from 1
    sizes: Mapping[str, float]


def causes_of_the_plant() -> tuple[str, ...]:
    """The core's effects, and what needs no equation."""
    return (
        *(e.name for e in all_effects() if e.core_name and e.name not in _AROUND_IT),
        *_AROUND_IT,
    )


@dataclass(frozen=True, slots=True)
class OwnPlant:
    """A simulator of one record."""

    cause: Cause
    record: int  # from 0

    def __call__(
        self,
        arm: Arm,
        values: Values,
        drive: Drive,
        /,
        *,
        sample_time: float,
        samples: int,
        record: Sequence[Quantity],
    ) -> Trajectory:
        """What the arm did, as its study's sensors show it."""
        cause, joint = self.cause, self.cause.joint
        own, known = arm, dict(values)
        factor = cause.sizes.get("gain", cause.sizes.get(f"factor_{self.record}", 1.0))
        if cause.name in ("drive-gain", "drive-gain-by-record"):
            per_volt = factor * (arm.joints[joint - 1].torque_per_volt or 1.0)
            own = _with_joint(arm, joint, torque_per_volt=per_volt)
        elif cause.name == "friction-by-record":
            known["motor_coulomb_friction", joint] *= factor
        elif cause.name not in (NOTHING, *_AROUND_IT):
            own = _with_joint(arm, joint, effects=(cause.name,))
            names = effect_named(cause.name).names
            known |= {(name, joint): cause.sizes[name] for name in names}

        def simulated(sample_time: float, samples: int) -> Trajectory:
            return simulate(
                own, known, drive, sample_time=sample_time, samples=samples, record=record
            )

        found = with_sensor_mount(simulated, sample_time, samples, cause)
        return with_encoder_zero(found, arm, cause)


def with_encoder_zero(found: Trajectory, arm: Arm, cause: Cause) -> Trajectory:
    """The same read by an encoder whose zero is off by an angle of the link.

    Returns: Unchanged where that is not the cause.
    """
    if cause.name != "encoder-zero" or "encoder" not in found.quantities:
        return found
    encoder: FloatArray = found["encoder"].copy()
    encoder[:, cause.joint - 1] += cause.sizes["angle"] / arm.joints[cause.joint - 1].gear_ratio
    return replace(found, quantities=dict(found.quantities) | {"encoder": encoder})


def with_sensor_mount(
    simulated: Callable[[float, int], Trajectory], sample_time: float, samples: int, cause: Cause
) -> Trajectory:
    """What is simulated at a sample time, an accelerometer of it on a mount that rings.

    `simulated`: Sample time and number of samples -> what the arm did. `sample_time` [s]. Returns:
    As simulated where that is not the cause.
    """
    if cause.name != "sensor-mount":
        return simulated(sample_time, samples)
    from scipy.signal import lsim

    fine = simulated(sample_time / _FINER, _FINER * samples)
    read = {name: quantity.copy() for name, quantity in fine.quantities.items()}
    if "accelerometer" in read:
        w, zeta = 2.0 * np.pi * cause.sizes["frequency"], cause.sizes["damping_ratio"]
        felt = read["accelerometer"][:, cause.joint - 1]
        mount = ([w**2], [1.0, 2.0 * zeta * w, w**2])
        felt[:] = felt[0] + lsim(mount, felt - felt[0], fine.time)[1]
    coarse = {name: quantity[::_FINER] for name, quantity in read.items()}
    return replace(fine, time=fine.time[::_FINER], quantities=coarse)


def _with_joint(arm: Arm, joint: int, **keys: object) -> Arm:
    joints = list(arm.joints)
    joints[joint - 1] = replace(joints[joint - 1], **keys)  # type: ignore[arg-type]
    return arm.with_joints(tuple(joints))


def joint_of(name: str, arm: ArmDescription, drawn: int) -> int:
    """The joint that can have a cause and show it.

    `name`: Of the cause. `drawn`: From 1, by chance. Returns: The one drawn, unless only another
    one can.
    """
    if name == "encoder-zero" and not arm.gravity:
        return 2  # the first one's is not observable without gravity
    return 1 if name in ("tilt", "soft-base") else drawn  # and all above it


def sizes_of(name: str, joint: int, rig: Rig, rng: np.random.Generator) -> dict[str, float]:
    """Those of an effect about what it calls typical, of all others what rigs are known for.

    `joint`: From 1. `rig`: With the experiments of `with_short_records`. Returns: Parameter, or
    what else `OwnPlant` changes -> value.
    """
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
        "drive-lag": lambda: slower(between(rng, 60.0, 300.0), study, joint),
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


def slower(bandwidth: float, study: Study, joint: int) -> dict[str, float]:
    """A current loop of another bandwidth, and the lag beside the study's that is as late.

    `bandwidth`: [Hz]. `joint`: From 1. Returns: `bandwidth` [Hz] and `drive_lag` [s].
    """
    stated = study.arm.joints[joint - 1].current_loop_hz or np.inf
    lag = (1.0 / bandwidth - 1.0 / stated) / (2.0 * np.pi)
    return {"bandwidth": bandwidth, "drive_lag": lag}


def known_joint(rig: Rig, joint: int) -> KnownJoint:
    """What effects take their typical sizes from, by the arm's truth.

    `joint`: From 1.
    """
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
