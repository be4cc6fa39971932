"""Logs, and the signals made of them: of the motors alone, and of both sides of every gear."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from strainwave.display import Displayed
from strainwave.domain.arrays import BoolArray, FloatArray
from strainwave.domain.estimates import Diagnostic
from strainwave.domain.study import Experiment


@dataclass(frozen=True, slots=True)
class Log(Displayed):
    """One experiment's measured channels on a uniform time base, in SI units."""

    experiment: Experiment
    time: FloatArray  # (n_samples,) [s], uniform
    sample_time: float  # [s]
    channels: Mapping[str, FloatArray]  # contract's channel name -> (n_samples,)
    warnings: tuple[Diagnostic, ...] = ()
    # channel -> (n_samples,) True where it was bridged and is no measurement
    masked: Mapping[str, BoolArray] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The experiment's."""
        return self.experiment.name

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, slots=True)
class Signals:
    """Motor-side signals of one experiment, every one through the same zero-phase filter.

    Filtered quantities of different kinds may be put into one equation: the same linear filter
    acts on both sides of it. What is not linear, the direction of sliding, comes unfiltered.
    """

    experiment: Experiment
    time: FloatArray  # (n_samples,) [s]
    sample_time: float  # [s]
    motor_torque: FloatArray  # (n_samples, n_joints) [N m] at the motor, filtered
    motor_angle: FloatArray  # (n_samples, n_joints) [rad], filtered
    motor_velocity: FloatArray  # (n_samples, n_joints) [rad/s], filtered
    motor_acceleration: FloatArray  # (n_samples, n_joints) [rad/s^2], filtered
    direction: FloatArray  # (n_samples, n_joints) +-1 where the motor slides; 0: it may stand
    bandwidth_hz: float | None  # of the zero-phase filter; None where nothing was filtered
    angle_noise: FloatArray  # (n_joints,) [rad] standard deviation, white
    valid: BoolArray  # (n_samples, n_joints): False at edges, limits of the drive, defects
    unfiltered_torque: FloatArray  # (n_samples, n_joints) [N m] at the motor, at the stamps
    torque_channel: tuple[str, ...]  # the log's channel each torque came from
    warnings: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True, slots=True)
class Lag:
    """A low-pass filter that a sensor or a drive has."""

    order: Literal[1, 2]  # 2: Butterworth
    cutoff_hz: float


@dataclass(frozen=True, slots=True)
class Fusion:
    """How a link velocity was put together, (10), with the low-pass F of unit gain at 0 Hz.

    dtheta_L = (1 - F) integral(ddtheta_L) + F n dtheta_M: above the corner from the acceleration,
    below it from the motor. F = 1/(1 + s T_V), or 1/(1 + sqrt(2) s T_V + (s T_V)^2).
    """

    time_constant: float  # T_V [s]
    order: Literal[1, 2]


@dataclass(frozen=True, slots=True)
class Delay:
    """How far one channel lags behind another."""

    value: float  # [s]
    std: float  # [s]


@dataclass(frozen=True, slots=True)
class Activity:
    """How hard one joint worked in the fitted records: root mean squares, seen at the motor.

    What makes a parameter's interval a torque, so that "nearly nothing" has a size.
    """

    joint: int  # from 1
    torque: float  # [N m], or [N]
    velocity: float  # [rad/s], or [m/s]
    acceleration: float  # [rad/s^2], or [m/s^2]


@dataclass(frozen=True, slots=True)
class LinkSummary:
    """How one link's motion was put together in one record, and how late its channels came."""

    experiment: str
    joint: int  # from 1
    source: LinkSource
    fusion: Fusion | None  # None: the velocity is a sensor's own
    fusion_error: float  # [rad/s] rms that (10) is wrong by, estimated
    bias: float  # [rad/s^2] taken off the link acceleration
    sensor_delay: Delay | None  # link sensor behind encoder; None: not identifiable
    drive_delay: Delay | None  # torque behind the log's; None: not identifiable


LinkSource = Literal["accelerometer", "encoder", "deflection", "gyro", "motor"]
"""Where a link's acceleration comes from; "motor": the gear was taken as rigid."""


@dataclass(frozen=True, slots=True)
class LinkSignals:
    """Both sides of every gear in one experiment, every signal through the same filters.

    Angles, velocities and accelerations of links are relative, as in the equations of motion.
    """

    experiment: Experiment
    time: FloatArray  # (n_samples,) [s]
    sample_time: float  # [s]
    motor_torque: FloatArray  # (n_samples, n_joints) [N m] at the motor, behind the current loop
    motor_angle: FloatArray  # (n_samples, n_joints) [rad]
    motor_velocity: FloatArray  # (n_samples, n_joints) [rad/s]
    direction: (
        FloatArray  # (n_samples, n_joints) sgn of the motor's velocity, in (-1, 1): may stand
    )
    sliding: (
        FloatArray  # (n_samples, n_joints) +-1 where the motor surely slides, else 0; unfiltered
    )
    link_angle: FloatArray  # (n_samples, n_joints) [rad]
    link_velocity: FloatArray  # (n_samples, n_joints) [rad/s]
    link_acceleration: FloatArray  # (n_samples, n_joints) [rad/s^2]
    valid: BoolArray  # (n_samples, n_joints): False at edges and where the drive saturates
    sources: tuple[LinkSource, ...]  # one per joint
    held: tuple[bool, ...]  # one per joint: the torque stays constant until the next sample
    shared: tuple[Lag, ...]  # low-passes that every signal has behind it
    bandwidth_hz: float | None  # of a zero-phase filter over everything; None: there is none
    fusion: tuple[Fusion | None, ...]  # one per joint; None: the velocity is a sensor's own
    fusion_error: FloatArray  # (n_joints,) [rad/s] rms that (10) is wrong by, estimated
    bias: FloatArray  # (n_joints,) [rad/s^2] taken off the link acceleration
    sensor_delay: tuple[Delay | None, ...]  # link sensor behind encoder; None: not identifiable
    drive_delay: tuple[Delay | None, ...]  # torque behind the log's; None: not identifiable
    warnings: tuple[Diagnostic, ...] = ()
    removed_delay: tuple[Delay, ...] = ()  # of link sensors, one per joint; (): none was taken off

    @property
    def summaries(self) -> tuple[LinkSummary, ...]:
        """What there is to say of each link's motion, one per joint."""
        return tuple(
            LinkSummary(
                experiment=self.experiment.name,
                joint=i + 1,
                source=source,
                fusion=self.fusion[i],
                fusion_error=float(self.fusion_error[i]),
                bias=float(self.bias[i]),
                sensor_delay=self.sensor_delay[i],
                drive_delay=self.drive_delay[i],
            )
            for i, source in enumerate(self.sources)
        )
