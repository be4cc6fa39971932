"""Logs, and the signals derived from them: motor side alone, or both sides of every gear."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from strainwave.display import Displayed
from strainwave.domain.keys import BoolArray, FloatArray, JointNumber
from strainwave.domain.results.estimates import Diagnostic
from strainwave.domain.study import Experiment


@dataclass(frozen=True, slots=True)
class Log(Displayed):
    """Measured channels of one experiment on a uniform time base, in SI units."""

    experiment: Experiment
    time: FloatArray  # (n_samples,) [s], uniform
    sample_time: float  # [s]
    channels: Mapping[str, FloatArray]  # by channel name, (n_samples,)
    warnings: tuple[Diagnostic, ...] = ()
    # by channel name, (n_samples,): True where a value is interpolated, not measured
    masked: Mapping[str, BoolArray] = field(default_factory=dict)
    is_continuation: bool = False  # a later segment: the motion and its servo run already
    # by arm, or by name and settings: what stages share; see `signals.prepared_record`
    prepared: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def name(self) -> str:
        """Name of the experiment."""
        return self.experiment.name

    def __len__(self) -> int:
        return len(self.time)

    def cut(self, rows: slice) -> Log:
        """Some rows of the record."""
        return replace(
            self,
            time=self.time[rows],
            channels={name: values[rows] for name, values in self.channels.items()},
            masked={name: mask[rows] for name, mask in self.masked.items()},
        )


@dataclass(frozen=True, slots=True)
class Signals:
    """Motor-side signals of one experiment, all with the same zero-phase filter.

    A linear filter preserves linear equations, so filtered quantities can enter one equation. The
    sliding direction is nonlinear and not filtered.
    """

    experiment: Experiment
    time: FloatArray  # (n_samples,) [s]
    sample_time: float  # [s]
    motor_torque: FloatArray  # (n_samples, n_joints) [N m] motor side, filtered
    motor_angle: FloatArray  # (n_samples, n_joints) [rad], filtered
    motor_velocity: FloatArray  # (n_samples, n_joints) [rad/s], filtered
    motor_acceleration: FloatArray  # (n_samples, n_joints) [rad/s^2], filtered
    direction: FloatArray  # (n_samples, n_joints) +-1 if the motor slides, 0 if it may stick
    bandwidth_hz: float | None  # of the zero-phase filter; None: not filtered
    angle_noise: FloatArray  # (n_joints,) [rad] standard deviation of the white noise
    valid: BoolArray  # (n_samples, n_joints): False at edges, drive saturation and defects
    torque_channel: tuple[str, ...]  # log channel of each torque
    warnings: tuple[Diagnostic, ...] = ()
    torsion: FloatArray | None = None  # (n_samples, n_joints) [rad, m], filtered as the angles


@dataclass(frozen=True, slots=True)
class Lag:
    """Low-pass filter of a sensor or a drive."""

    order: Literal[1, 2]  # 2: Butterworth
    cutoff_hz: float


@dataclass(frozen=True, slots=True)
class Fusion:
    """Fusion of a link velocity, (10), with a low-pass F of unit gain at 0 Hz.

        dtheta_L = (1 - F) integral(ddtheta_L) + F n dtheta_M

    The acceleration gives the velocity above the corner frequency, the motor below it. F is 1/(1 +
    s T_V) or 1/(1 + sqrt(2) s T_V + (s T_V)^2).
    """

    time_constant: float  # T_V [s]
    order: Literal[1, 2]


@dataclass(frozen=True, slots=True)
class Delay:
    """Delay of one channel relative to another."""

    value: float  # [s]
    std: float  # [s]


@dataclass(frozen=True, slots=True)
class Activity:
    """Root mean squares of one joint's motion in the fitted records, motor side.

    They convert the interval of a parameter into a torque and so give a scale for "negligible".
    """

    joint: JointNumber
    torque: float  # [N m], or [N]
    velocity: float  # [rad/s], or [m/s]
    acceleration: float  # [rad/s^2], or [m/s^2]


@dataclass(frozen=True, slots=True)
class LinkSummary:
    """Source of one link's motion in one record, and the delays of its channels."""

    experiment: str
    joint: JointNumber
    source: LinkSource
    fusion: Fusion | None = None  # None: a sensor measures the velocity
    fusion_error: float = 0.0  # [rad/s] estimated rms error of (10)
    bias: float = 0.0  # [rad/s^2] removed from the link acceleration
    sensor_delay: Delay | None = None  # link sensor relative to encoder; None: not identifiable
    drive_delay: Delay | None = None  # torque relative to the log; None: not identifiable


LinkSource = Literal["accelerometer", "encoder", "deflection", "gyro", "motor", "rigid"]
"""Source of a link's acceleration; "motor": the gear is assumed rigid; "rigid": it is."""


@dataclass(frozen=True, slots=True)
class LinkSignals:
    """Signals on both sides of every gear in one experiment, all with the same filters.

    Angles, velocities and accelerations of links are relative, as in the equations of motion.
    """

    experiment: Experiment
    time: FloatArray  # (n_samples,) [s]
    sample_time: float  # [s]
    motor_torque: FloatArray  # (n_samples, n_joints) [N m] motor side, after the current loop
    motor_angle: FloatArray  # (n_samples, n_joints) [rad]
    motor_velocity: FloatArray  # (n_samples, n_joints) [rad/s]
    # (n_samples, n_joints) sign of the motor's velocity; in (-1, 1) if it may stick
    direction: FloatArray
    # (n_samples, n_joints) +-1 if the motor certainly slides, else 0; unfiltered
    sliding: FloatArray
    link_angle: FloatArray  # (n_samples, n_joints) [rad]
    link_velocity: FloatArray  # (n_samples, n_joints) [rad/s]
    link_acceleration: FloatArray  # (n_samples, n_joints) [rad/s^2]
    valid: BoolArray  # (n_samples, n_joints): False at edges and drive saturation
    links: tuple[LinkSummary, ...]  # one per joint
    held: tuple[bool, ...]  # one per joint: zero-order hold of the torque
    shared: tuple[Lag, ...]  # low-passes applied to every signal
    bandwidth_hz: float | None  # of a zero-phase filter of all signals; None: no filter
    warnings: tuple[Diagnostic, ...] = ()
    removed_delay: tuple[Delay, ...] = ()  # of link sensors, one per joint; (): none removed

    @property
    def sources(self) -> tuple[LinkSource, ...]:
        """Sources of the links' accelerations."""
        return tuple(link.source for link in self.links)
