"""Arms with a cause in the project's own plant: effects by the core, the rest around it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lsim

from benchmarks.studies.causes.drawn import NOTHING, Cause
from strainwave.domain import FloatArray
from strainwave.domain.effects import all_effects, effect_named
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Quantity, Trajectory, simulate

_AROUND_IT = (
    "drive-gain",
    "encoder-zero",
    "sensor-mount",
    "friction-by-record",
    "drive-gain-by-record",
)
"""Causes that need no equation of the core."""
_FINER = 10  # times the samples between which a mount's motion is straight lines


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
    """The same read by an encoder whose zero is off by an angle of the link."""
    if cause.name != "encoder-zero" or "encoder" not in found.quantities:
        return found
    encoder: FloatArray = found["encoder"].copy()
    encoder[:, cause.joint - 1] += cause.sizes["angle"] / arm.joints[cause.joint - 1].gear_ratio
    return replace(found, quantities=dict(found.quantities) | {"encoder": encoder})


def with_sensor_mount(
    simulated: Callable[[float, int], Trajectory], sample_time: float, samples: int, cause: Cause
) -> Trajectory:
    """What is simulated at a sample time, an accelerometer of it on a mount that rings."""
    if cause.name != "sensor-mount":
        return simulated(sample_time, samples)
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
