"""The built-in rig: SCARA-type two-link arms with strain-wave gears and brass disks at the tip.

No paper publishes the parameters of such an arm. These are consistent with each other and with a
gear manufacturer's catalogue. At the limit of the drives a PRBS loads the gears of `SOFT` well
beyond their last knee, so that the published recipe does what was published, and those of `STIFF`
about up to it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter

from strainwave.domain import Control, Experiment, Joint, Prbs, Servo, Spring, Study, Use
from strainwave.domain.arm.gear_laws import gear_law
from strainwave.domain.arm.kinds import planar_two_link
from strainwave.domain.keys import Values
from strainwave.errors import InvalidInput

MAX_DISKS = 5  # payload of the rig
_TIP_MOUNT = (1.0, 5e-4)  # [kg], [kg m^2] about its own axis
_DISK = (1.0, 1.25e-3)  # [kg], [kg m^2] of each disk about its own axis
_SPRING = "three-slope"
_LINEAR_STIFFNESS = "gear_stiffness_k2"  # stiffness of other gear laws

Pair = tuple[float, float]  # of joint or link 1 and 2


@dataclass(frozen=True, slots=True)
class BuiltInArm:
    """Masses, gears, drives and sensors of a built-in arm."""

    description: str
    link_length: Pair  # [m]
    link_mass: Pair  # [kg]; link 1 includes the motor of joint 2
    centroid: Pair  # [m] from the link's own axis
    link_inertia: Pair  # [kg m^2] about the centroid
    gear_ratio: Pair
    gears: Mapping[str, Pair]  # parameters of the three slopes
    drives: Mapping[str, Pair]  # inertia, friction and damping
    torque_per_volt: Pair  # [N m/V]
    accelerometer_distance: Pair  # [m]
    servo: Servo
    step_speed: Pair  # [rad/s] of the motor in the steps for fine tuning

    def parameters(self, disks: int = MAX_DISKS, spring: Spring = _SPRING) -> Values:
        """Parameter values [SI] by name and joint, base parameters (3) from the masses.

            alpha = I1 + m1 lc1^2 + m2 l1^2,   beta = I2 about axis 2
            gamma = l1 (m2 lc2 + m_tip l2)

        `disks` is the payload, 0 to 5 brass disks of 1 kg at the tip. Gear laws other than that of
        the rig get its middle slope as their stiffness. Raises InvalidInput if there are too many
        disks.
        """
        if not 0 <= disks <= MAX_DISKS:
            raise InvalidInput(
                f"the rig cannot carry {disks} disks", remedy=f"use 0 to {MAX_DISKS}"
            )
        mass, centroid, length = self.link_mass, self.centroid, self.link_length
        tip = _TIP_MOUNT[0] + disks * _DISK[0]
        alpha = self.link_inertia[0] + mass[0] * centroid[0] ** 2 + (mass[1] + tip) * length[0] ** 2
        beta = self.link_inertia[1] + mass[1] * centroid[1] ** 2 + tip * length[1] ** 2
        beta += _TIP_MOUNT[1] + disks * _DISK[1]
        gamma = length[0] * (mass[1] * centroid[1] + tip * length[1])
        values: Values = {("alpha", None): alpha, ("beta", None): beta, ("gamma", None): gamma}
        for joint in (1, 2):
            drive, gear = (
                {name: of_joints[joint - 1] for name, of_joints in table.items()}
                for table in (self.drives, self.gears)
            )
            if spring != _SPRING:
                gear = gear_law(spring).straight(gear[_LINEAR_STIFFNESS])
            values |= {(name, joint): value for name, value in (drive | gear).items()}
        return values

    def study(self, folder: Path, spring: Spring = _SPRING) -> Study:
        """Study of the rig: sensors, servo and the experiments that identify it.

        `folder` is the future location of the study file and its logs, which are not written here.
        """
        joints = tuple(
            Joint(
                spring=spring,
                gear_ratio=ratio,
                torque_per_volt=torque_per_volt,
                current_loop_hz=1000.0,
                encoder_counts=8192,
                accelerometer_distance=distance,
                accelerometer_hz=300.0,
                gyro_hz=5.0,
            )
            for ratio, torque_per_volt, distance in zip(
                self.gear_ratio, self.torque_per_volt, self.accelerometer_distance, strict=True
            )
        )
        return Study(
            path=folder / "study.toml",
            sha256="",
            arm=planar_two_link(joints, link_length=self.link_length[0], servo=self.servo),
            experiments=_experiments(),
        )


ARMS = TypeAdapter(dict[str, BuiltInArm]).validate_python(
    tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
)
"""Built-in arms by name, the default first."""

SOFT, STIFF = ARMS["soft"], ARMS["stiff"]


def _experiments() -> tuple[Experiment, ...]:
    both: tuple[Control, Control] = ("servo", "servo")
    experiments = [_record("motion", "motion", both), _record("motion-check", "check", both)]
    for joint in (1, 2):
        free: tuple[Control, Control] = ("open", "open")
        prbs = Prbs(order=10, clock=1e-3, periods=4, amplitude=10.0)
        experiments += [
            _record(f"prbs-j{joint}", "frequency", free, joint=joint, prbs=prbs),
            _record(f"step-j{joint}", "tuning", both, joint=joint),
            _record(f"step-check-j{joint}", "check", both, joint=joint),
        ]
    return tuple(experiments)


def _record(
    name: str,
    use: Use,
    control: tuple[Control, Control],
    *,
    joint: int | None = None,
    prbs: Prbs | None = None,
) -> Experiment:
    return Experiment(name, f"{name}.parquet", use, control, joint=joint, prbs=prbs)
