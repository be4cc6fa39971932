"""The built-in rig: a SCARA-type two-link arm with strain-wave gears and brass disks at its tip.

No paper publishes the parameters of such an arm. These are consistent with each other, with a gear
manufacturer's catalogue (sizes 20 and 14, ratio 100), and with anti-resonances of 10 to 30 Hz.
"""

from __future__ import annotations

from pathlib import Path

from strainwave.domain import Control, Experiment, Joint, Prbs, Servo, Spring, Study, Use
from strainwave.domain.gear_laws import gear_law
from strainwave.domain.keys import Values
from strainwave.domain.kinds import planar_two_link
from strainwave.errors import InvalidInput

DESCRIPTION = "a simulated SCARA-type arm with three-slope gears and noisy sensors"
LINK_LENGTH = (0.35, 0.30)  # [m]
LINK_MASS = (8.0, 3.0)  # [kg]; link 1 includes the motor of joint 2
CENTROID = (0.22, 0.15)  # [m] from the link's own axis
LINK_INERTIA = (0.12, 0.030)  # [kg m^2] about the centroid
TIP_MOUNT = (1.0, 5e-4)  # [kg], [kg m^2] about its own axis
DISK = (1.0, 1.25e-3)  # [kg], [kg m^2] of each disk about its own axis
MAX_DISKS = 5  # payload of the rig

_SPRING = "three-slope"
_LINEAR_STIFFNESS = "gear_stiffness_k2"  # stiffness of other gear laws

_DRIVES = {  # of joint 1, of joint 2
    "motor_inertia": (1.5e-4, 0.5e-4),
    "motor_viscous_friction": (2e-4, 0.8e-4),
    "motor_coulomb_friction": (0.060, 0.030),
    "friction_offset": (0.0, 0.0),
    "link_viscous_friction": (0.5, 0.15),
    "gear_damping": (20.0, 4.0),
}
_THREE_SLOPES = {
    "gear_stiffness_k1": (16000.0, 4700.0),
    "gear_stiffness_k2": (25000.0, 6100.0),
    "gear_stiffness_k3": (29000.0, 7100.0),
    "gear_knee_t1": (7.0, 2.0),
    "gear_knee_t2": (25.0, 6.9),
}


def parameters(disks: int = MAX_DISKS, spring: Spring = _SPRING) -> Values:
    """Parameter values [SI] of the rig by name and joint, base parameters (3) from its masses.

        alpha = I1 + m1 lc1^2 + m2 l1^2,   beta = I2 about axis 2,   gamma = l1 (m2 lc2 + m_tip l2)

    `disks` is the payload, 0 to 5 brass disks of 1 kg at the tip. Gear laws other than that of the
    rig get its middle slope as their stiffness. Raises InvalidInput if there are too many disks.
    """
    if not 0 <= disks <= MAX_DISKS:
        raise InvalidInput(f"the rig cannot carry {disks} disks", remedy=f"use 0 to {MAX_DISKS}")
    tip = TIP_MOUNT[0] + disks * DISK[0]
    alpha = LINK_INERTIA[0] + LINK_MASS[0] * CENTROID[0] ** 2
    alpha += (LINK_MASS[1] + tip) * LINK_LENGTH[0] ** 2
    beta = LINK_INERTIA[1] + LINK_MASS[1] * CENTROID[1] ** 2 + tip * LINK_LENGTH[1] ** 2
    beta += TIP_MOUNT[1] + disks * DISK[1]
    gamma = LINK_LENGTH[0] * (LINK_MASS[1] * CENTROID[1] + tip * LINK_LENGTH[1])
    values: Values = {("alpha", None): alpha, ("beta", None): beta, ("gamma", None): gamma}
    for joint in (1, 2):
        drive, gear = (
            {name: of_joints[joint - 1] for name, of_joints in table.items()}
            for table in (_DRIVES, _THREE_SLOPES)
        )
        if spring != _SPRING:
            gear = gear_law(spring).straight(gear[_LINEAR_STIFFNESS])
        values |= {(name, joint): value for name, value in (drive | gear).items()}
    return values


def study(folder: Path, spring: Spring = _SPRING) -> Study:
    """Study of the rig: sensors, servo and the experiments that identify it.

    `folder` is the future location of the study file and its logs, which are not written here.
    """
    joints = tuple(
        Joint(
            spring=spring,
            gear_ratio=0.01,
            torque_per_volt=torque_per_volt,
            current_loop_hz=1000.0,
            encoder_counts=8192,
            accelerometer_distance=distance,
            accelerometer_hz=300.0,
            gyro_hz=5.0,
        )
        for torque_per_volt, distance in ((0.08, 0.33), (0.03, 0.27))
    )
    return Study(
        path=folder / "study.toml",
        sha256="",
        arm=planar_two_link(
            joints,
            link_length=LINK_LENGTH[0],
            servo=Servo("pi-velocity", period=1e-3, kp=(0.12, 0.10), ki=(1.5, 1.5), limit=10.0),
        ),
        experiments=_experiments(),
    )


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
