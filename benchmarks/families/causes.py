"""Causes of model errors that an arm has and its study does not mention.

The core simulates effects; this module simulates the other causes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.families.catalogue import plans
from benchmarks.families.rigs import Rig, between
from strainwave.domain import ArmDescription, FloatArray, Study
from strainwave.domain.arm.effects import KnownJoint, all_effects, effect_named, names
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Trajectory, simulate

NO_CAUSE = "none"
_SIZE_FACTORS = (0.3, 3.0)  # over the typical sizes of an effect
_MAX_SHAPE_FACTOR = 1.3  # over and under the default shapes of an effect
_INTEGER_SHAPES = {"torque_ripple_order", "kinematic_error_order"}
_OTHER_CAUSES = (
    "drive-gain",
    "encoder-zero",
    "sensor-mount",
    "friction-by-record",
    "drive-gain-by-record",
)
"""Causes without equations in the core."""
_MOUNT_OVERSAMPLING = 10  # of the motion that excites a sensor mount, for linear interpolation


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause that an arm has and its study does not mention."""

    name: str
    joint: int  # from 1
    sizes: Mapping[str, float]


def cause_names() -> tuple[str, ...]:
    """Names of all causes: effects of the core, then the others."""
    return (
        *(e.name for e in all_effects() if e.core_name and e.name not in _OTHER_CAUSES),
        *_OTHER_CAUSES,
    )


@dataclass(frozen=True, slots=True)
class OwnPlant:
    """Simulator of one record of an arm with a cause."""

    cause: Cause
    record: int  # index of the record

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
        """Motion of the arm as the sensors of its study measure it."""
        cause, joint = self.cause, self.cause.joint
        plant, parameters = arm, dict(values)
        factor = cause.sizes.get("gain", cause.sizes.get(f"factor_{self.record}", 1.0))
        if cause.name in ("drive-gain", "drive-gain-by-record"):
            per_volt = factor * arm.joints[joint - 1].torque_per_command
            plant = arm.with_joint(joint, torque_per_volt=per_volt)
        elif cause.name == "friction-by-record":
            parameters["motor_coulomb_friction", joint] *= factor
        elif cause.name not in (NO_CAUSE, *_OTHER_CAUSES):
            plant = arm.with_joint(joint, effects=(cause.name,))
            names = effect_named(cause.name).names
            parameters |= {(name, joint): cause.sizes[name] for name in names}

        def simulated(sample_time: float, samples: int) -> Trajectory:
            return simulate(
                plant, parameters, drive, sample_time=sample_time, samples=samples, record=record
            )

        trajectory = with_sensor_mount(simulated, sample_time, samples, cause)
        return with_encoder_zero(trajectory, arm, cause)


def with_encoder_zero(trajectory: Trajectory, arm: Arm, cause: Cause) -> Trajectory:
    """Trajectory with a shifted encoder zero, if that is the cause."""
    if cause.name != "encoder-zero" or "encoder" not in trajectory.quantities:
        return trajectory
    encoder: FloatArray = trajectory["encoder"].copy()
    encoder[:, cause.joint - 1] += cause.sizes["angle"] / arm.joints[cause.joint - 1].gear_ratio
    return replace(trajectory, quantities=dict(trajectory.quantities) | {"encoder": encoder})


def with_sensor_mount(
    simulated: Callable[[float, int], Trajectory], sample_time: float, samples: int, cause: Cause
) -> Trajectory:
    """Trajectory with an accelerometer on a resonant mount, if that is the cause.

    `simulated` gives the trajectory for a sample time [s] and a number of samples.
    """
    if cause.name != "sensor-mount":
        return simulated(sample_time, samples)
    from scipy.signal import lsim

    fine = simulated(sample_time / _MOUNT_OVERSAMPLING, _MOUNT_OVERSAMPLING * samples)
    readings = {name: quantity.copy() for name, quantity in fine.quantities.items()}
    if "accelerometer" in readings:
        w, zeta = 2.0 * np.pi * cause.sizes["frequency"], cause.sizes["damping_ratio"]
        reading = readings["accelerometer"][:, cause.joint - 1]
        mount = ([w**2], [1.0, 2.0 * zeta * w, w**2])
        reading[:] = reading[0] + lsim(mount, reading - reading[0], fine.time)[1]
    coarse = {name: quantity[::_MOUNT_OVERSAMPLING] for name, quantity in readings.items()}
    return replace(fine, time=fine.time[::_MOUNT_OVERSAMPLING], quantities=coarse)


def joint_of(name: str, arm: ArmDescription, drawn: int) -> int:
    """Joint, from 1, with a cause: the drawn one unless only another joint can show the cause."""
    if name == "encoder-zero" and not arm.gravity:
        return 2  # the zero of joint 1 is not observable without gravity
    return 1 if name in ("tilt", "soft-base") else drawn


def sizes_of(name: str, joint: int, rig: Rig, rng: np.random.Generator) -> dict[str, float]:
    """Random sizes of a cause: around the typical sizes of an effect, or within the range of rigs.

    `rig` has the experiments of `with_short_records`. The result maps parameters, or other
    quantities that `OwnPlant` changes, to values.
    """
    special = _special_sizes(name, rig, joint, rng)
    effect = effect_named(name) if name in names() else None
    if effect is None or effect.core_name is None:
        return special
    typical = effect.typical_sizes(known_joint(rig, joint))
    factor = between(rng, *_SIZE_FACTORS)
    sizes = {key: factor * value for key, value in typical.items()}
    signed = [key for key in effect.sizes if effect.is_signed(key)]
    angle = rng.uniform(0.0, 2.0 * np.pi)
    if len(signed) == 2:
        sizes[signed[0]] *= float(np.cos(angle))
        sizes[signed[1]] *= float(np.sin(angle))
    elif signed:
        sizes[signed[0]] *= float(np.sign(np.cos(angle)))
    for key, value in effect.shapes.items():
        is_integer = key in _INTEGER_SHAPES
        shape = 1.0 if is_integer else between(rng, 1.0 / _MAX_SHAPE_FACTOR, _MAX_SHAPE_FACTOR)
        sizes[key] = shape * value
    return sizes | special


def _special_sizes(name: str, rig: Rig, joint: int, rng: np.random.Generator) -> dict[str, float]:
    """Sizes with distributions of their own; parameters of effects have their names."""
    study = rig.study
    limit = study.arm.servo.limit if study.arm.servo else 10.0
    sign, azimuth = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-np.pi, np.pi))
    log_factors = rng.standard_normal(len(study.experiments))
    log_factors -= log_factors.mean()

    def by_record(low: float, high: float) -> dict[str, float]:
        factors = np.exp(between(rng, low, high) * log_factors)
        return {f"factor_{k}": float(factor) for k, factor in enumerate(factors)}

    sizes: dict[str, Callable[[], dict[str, float]]] = {
        "drive-gain": lambda: {"gain": 1.0 + sign * between(rng, 0.01, 0.1)},
        # the torque constant falls with the current
        "drive-saturation": lambda: {"drive_saturation": between(rng, 0.02, 0.15) / limit},
        "drive-limit": lambda: {  # clipping
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
        "soft-base": lambda: {  # sliding mode of the feet; base mass over link mass
            "sliding_frequency": between(rng, 50.0, 200.0),
            "mass": between(rng, 2.0, 10.0),
            "base_damping": between(rng, 0.01, 0.1),
        },
    }
    return sizes[name]() if name in sizes else {}


def slower(bandwidth: float, study: Study, joint: int) -> dict[str, float]:
    """Another bandwidth [Hz] of the current loop, and the equivalent `drive_lag` [s]."""
    stated = study.arm.joints[joint - 1].current_loop_hz or np.inf
    lag = (1.0 / bandwidth - 1.0 / stated) / (2.0 * np.pi)
    return {"bandwidth": bandwidth, "drive_lag": lag}


def known_joint(rig: Rig, joint: int) -> KnownJoint:
    """Properties from which effects derive typical sizes, from the true values of joint `joint`."""
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
