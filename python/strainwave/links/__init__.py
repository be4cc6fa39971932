"""Log -> LinkSignals: what both sides of every gear do, through the same filters: (8)-(10)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.channels import channel_of, directions, resolution, saturation, torque_channel
from strainwave.errors import InvalidInput
from strainwave.filters import differentiate, lagged, low_pass, noise_deviation, signal_band
from strainwave.links.alignment import drive_delay, sensor_delay
from strainwave.links.fusion import bias_of, complement, fuse
from strainwave.records import (
    BoolArray,
    Caution,
    Delay,
    FloatArray,
    Fusion,
    Joint,
    Lag,
    LinkOptions,
    LinkSignals,
    LinkSource,
    Log,
    Study,
)
from strainwave.regressor import gear_ratios

__all__ = ["LinkOptions", "link_side"]

_EDGE = 2.0  # periods of the slowest low-pass until its start is forgotten
_MISALIGNED = 0.6  # samples of delay that are worth a warning
_CERTAIN = 4.0  # deviations of a delay that are not by chance
_SPREAD = 0.25  # samples of uncertainty above which a delay is not told


def link_side(log: Log, study: Study, options: LinkOptions | None = None) -> LinkSignals:
    """Link angles, velocities and accelerations of one record, with the motors' beside them.

    A tangential accelerometer anywhere on the link gives (8), (9), with gravity's share g taken off
    because it reads specific force:

        ddtheta_L1 = (a1 - g cos q1) / l_a1
        ddtheta_L2 = (a2 - g cos(q1 + q2)) / l_a2 - ddtheta_L1
                     - (l_1 / l_a2) (ddtheta_L1 cos q2 + dtheta_L1^2 sin q2)

    Its bias is what its low frequencies differ by from the encoder's. Without one, a link encoder,
    the deflection, a gyro or, at last, the motor alone gives the acceleration. Low-pass filters
    that one sensor has are applied to all other signals.

    Parameters
    ----------
    log : Log
    study : Study
    options : LinkOptions, optional

    Returns
    -------
    LinkSignals

    Raises
    ------
    InvalidInput
        A channel or the accelerometer's place is missing, or the record is too short.
    """
    chosen = options or LinkOptions()
    view = _View(log, study, chosen)
    torque = np.column_stack([view.torque(i) for i in range(study.n_joints)])
    motor_velocity = differentiate(view.motor_angle, log.sample_time)
    links = _links(view, motor_velocity)
    sliding, direction = view.directions()
    valid, warnings = _valid(view)
    found = LinkSignals(
        experiment=log.experiment,
        time=log.time,
        sample_time=log.sample_time,
        motor_torque=torque,
        motor_angle=view.motor_angle,
        motor_velocity=motor_velocity,
        direction=direction,
        sliding=sliding,
        link_angle=links.angle,
        link_velocity=links.velocity,
        link_acceleration=links.acceleration,
        valid=valid,
        sources=view.sources,
        held=tuple(view.held(i) for i in range(study.n_joints)),
        shared=view.shared,
        bandwidth_hz=view.bandwidth_hz,
        fusion=tuple(links.fusion),
        fusion_error=np.array(links.fusion_error),
        bias=np.array(links.bias),
        sensor_delay=(None,) * study.n_joints,
        drive_delay=(None,) * study.n_joints,
    )
    return _aligned(found, study, view, warnings)


class _View:
    """A log seen through the filters that all its channels are to share."""

    def __init__(self, log: Log, study: Study, options: LinkOptions) -> None:
        self.log, self.study, self.options = log, study, options
        numbers = range(1, study.n_joints + 1)
        self.raw_angle = np.column_stack([channel_of(log, f"theta_m{i}") for i in numbers])
        self.channels = tuple(torque_channel(log, i) for i in numbers)
        self.sources = tuple(_source(log, study, i) for i in numbers)
        self.shared = _shared(study.joints, self.sources)
        # a joint that hardly moves has no band of its own
        self.band = max(signal_band(angle, log.sample_time) for angle in self.raw_angle.T)
        differenced = any(s != "accelerometer" for s in self.sources)
        self.bandwidth_hz = options.bandwidth_hz or (self.band if differenced else None)
        slowest = min(
            [lag.cutoff_hz for lag in self.shared]
            + ([self.bandwidth_hz] if self.bandwidth_hz else [])
            + [0.1 / log.sample_time]
        )
        self.edge = int(np.ceil(_EDGE / (slowest * log.sample_time)))
        if len(log) < 4 * self.edge + 16:
            raise InvalidInput(
                f"{len(log)} samples are too few for a filter of {slowest:.3g} Hz",
                where=log.name,
                remedy="record for longer",
            )
        self.motor_angle = self.through(self.raw_angle)

    def through(
        self, signal: FloatArray, own: Sequence[Lag] = (), *, held: bool = False
    ) -> FloatArray:
        """A channel behind the shared low-passes that its own sensor has not applied yet."""
        rest = list(self.shared)
        for lag in own:
            rest.remove(lag)
        return self.smooth(lagged(signal, rest, self.log.sample_time, held=held))

    def smooth(self, signal: FloatArray) -> FloatArray:
        """A signal through the zero-phase filter, where there is one."""
        if self.bandwidth_hz is None:
            return signal
        return low_pass(signal, self.bandwidth_hz, self.log.sample_time)

    def held(self, i: int) -> bool:
        """Whether a torque is constant between the samples."""
        loop = self.study.joints[i].current_loop_hz
        voltage = self.channels[i].startswith("u")
        return voltage and loop is None and not self.shared and self.bandwidth_hz is None

    def torque(self, i: int) -> FloatArray:
        """A motor's torque: voltages are held by the drive and pass its current loop."""
        joint, channel = self.study.joints[i], self.channels[i]
        values = self.log.channels[channel]
        if channel.startswith("torque"):
            return self.through(values)
        if joint.torque_per_volt is None:
            raise InvalidInput(
                "a voltage is logged but torque_per_volt is not given",
                where=f"joint {i + 1}",
                remedy="add torque_per_volt to the joint, or log the torque",
            )
        loop = [Lag(1, joint.current_loop_hz)] if joint.current_loop_hz else []
        T = self.log.sample_time
        torque = lagged(joint.torque_per_volt * values, [*loop, *self.shared], T, held=True)
        return self.smooth(torque)

    def directions(self) -> tuple[FloatArray, FloatArray]:
        """Where each motor surely slides and which way; and its direction as the signals show it.

        Where it may stand, the latter is the velocity over its resolution.
        """
        T = self.log.sample_time
        noise = np.array([noise_deviation(angle) for angle in self.raw_angle.T])
        certain = directions(self.raw_angle, noise, self.study, T)
        velocity = differentiate(low_pass(self.raw_angle, self.band, T), T)
        finest = np.array(
            [resolution(j, s) for j, s in zip(self.study.joints, noise.tolist(), strict=True)]
        )
        # the velocity of one count up and down at the top of the band
        softened = np.clip(velocity / np.maximum(np.pi * self.band * finest, 1e-12), -1.0, 1.0)
        return certain, self.through(np.where(certain != 0.0, certain, softened))


def _source(log: Log, study: Study, joint: int) -> LinkSource:
    """The best of what the log has of a link."""
    if f"a{joint}" in log.channels:
        drive = study.joints[joint - 1]
        if drive.motion == "revolute" and drive.accelerometer_distance is None:
            raise InvalidInput(
                f"a{joint} is logged but accelerometer_distance is not given",
                where=f"joint {joint}",
                remedy="add accelerometer_distance to the joint, or leave the channel out",
            )
        return "accelerometer"
    if f"theta_l{joint}" in log.channels:
        return "encoder"
    if f"deflection{joint}" in log.channels:
        return "deflection"
    return "gyro" if f"gyro{joint}" in log.channels else "motor"


def _own(joint: Joint, source: LinkSource) -> tuple[Lag, ...]:
    """The low-pass of a joint's link sensor."""
    if source == "accelerometer" and joint.accelerometer_hz:
        return (Lag(2, joint.accelerometer_hz),)
    if source == "gyro" and joint.gyro_hz:
        return (Lag(1, joint.gyro_hz),)
    return ()


def _shared(joints: Sequence[Joint], sources: Sequence[LinkSource]) -> tuple[Lag, ...]:
    """Every low-pass that some sensor has, once."""
    owned = [lag for j, s in zip(joints, sources, strict=True) for lag in _own(j, s)]
    return tuple(dict.fromkeys(owned))


@dataclass
class _Links:
    """The links' motion as it is put together, from the base outward."""

    angle: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    bias: list[float]
    fusion: list[Fusion | None]
    fusion_error: list[float]


def _links(view: _View, motor_velocity: FloatArray) -> _Links:
    n = gear_ratios(view.study)
    T = view.log.sample_time
    motor_side = n * motor_velocity
    # the motors' side stands in for joints further out until their turn comes
    links = _Links(n * view.motor_angle, motor_side.copy(), np.zeros_like(motor_side), [], [], [])
    links.acceleration[:] = differentiate(motor_side, T)
    for i, source in enumerate(view.sources):
        angle, slow = _slow(view, i, n[i] * view.motor_angle[:, i])
        if source != "accelerometer":
            if source == "gyro":
                gyro = view.log.channels[f"gyro{i + 1}"]
                rate = view.through(gyro, _own(view.study.joints[i], source))
                slow = rate - links.velocity[:, :i].sum(axis=1)
            links.angle[:, i], links.velocity[:, i] = angle, slow
            links.acceleration[:, i] = differentiate(slow, T)
            links.bias.append(0.0)
            links.fusion.append(None)
            links.fusion_error.append(0.0)
            continue
        read = view.through(view.log.channels[f"a{i + 1}"], _own(view.study.joints[i], source))
        acceleration = _acceleration(view.study, read, i, links)
        bias = bias_of(acceleration, slow, T, view.edge)
        acceleration = acceleration - bias
        fusion = Fusion(view.options.time_constant, view.options.order)
        links.velocity[:, i] = fuse(acceleration, slow, fusion, T)
        links.angle[:, i] = fuse(links.velocity[:, i], angle, Fusion(fusion.time_constant, 1), T)
        links.acceleration[:, i] = acceleration
        own_rate = f"theta_l{i + 1}" in view.log.channels
        own_rate = own_rate or f"deflection{i + 1}" in view.log.channels
        lost = complement(slow - links.velocity[:, i], fusion, T)[view.edge : -view.edge]
        links.bias.append(bias)
        # a link sensor's own velocity makes (10) exact
        links.fusion.append(None if own_rate else fusion)
        links.fusion_error.append(0.0 if own_rate else float(np.sqrt(np.mean(lost**2))))
    return links


def _slow(view: _View, i: int, motor_side: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A link's angle and velocity as some encoder tells them."""
    channels = view.log.channels
    if f"theta_l{i + 1}" in channels:
        motor_side = view.through(channels[f"theta_l{i + 1}"])
    elif f"deflection{i + 1}" in channels:
        motor_side = motor_side + view.through(channels[f"deflection{i + 1}"])
    return motor_side, differentiate(motor_side, view.log.sample_time)


def _acceleration(study: Study, read: FloatArray, i: int, links: _Links) -> FloatArray:
    """(8), (9), for an accelerometer anywhere on its link, with gravity."""
    joint = study.joints[i]
    if joint.motion == "prismatic":
        return read
    q, dq, ddq = links.angle, links.velocity, links.acceleration
    gravity = study.arm.gravity or 0.0
    distance = joint.accelerometer_distance or 1.0
    own = (read - gravity * np.cos(q[:, : i + 1].sum(axis=1))) / distance
    if i == 0:
        return np.asarray(own)
    elbow = ddq[:, 0] * np.cos(q[:, 1]) + dq[:, 0] ** 2 * np.sin(q[:, 1])
    return np.asarray(own - ddq[:, 0] - (study.arm.link_length or 0.0) / distance * elbow)


def _valid(view: _View) -> tuple[BoolArray, list[Caution]]:
    """Samples that edges and limits of the drive do not touch, and what to say of the sensors."""
    saturated, cautions = saturation(view.log, view.study, view.channels)
    valid = ~saturated
    valid[: view.edge] = valid[-view.edge :] = False
    warnings = list(cautions)
    for i, source in enumerate(view.sources, start=1):
        if source == "motor":
            text = f"link {i} has no sensor: its motion is taken as the motor's, which hides the"
            text += " gear's spring; log an accelerometer, a link encoder or the deflection"
            warnings.append(Caution("no-link-sensor", view.log.name, text))
    prbs = view.log.experiment.prbs
    if prbs and prbs.clock < 0.999 * view.log.sample_time:
        text = f"the voltage changes every {prbs.clock:g} s but is logged every"
        text += f" {view.log.sample_time:g} s: what lies between is lost; log at least at its clock"
        warnings.append(Caution("sub-sampled", view.log.name, text))
    return valid, warnings


def _aligned(found: LinkSignals, study: Study, view: _View, warnings: list[Caution]) -> LinkSignals:
    """With the delays between the channels, which are told and never taken away."""
    from dataclasses import replace

    sensor = tuple(
        _told(sensor_delay(found, study, i), found.sample_time) for i in range(study.n_joints)
    )
    drive = tuple(
        _told(drive_delay(found, study, i, view.band), found.sample_time)
        for i in range(study.n_joints)
    )
    for i in range(study.n_joints):
        warnings.extend(_misaligned(sensor[i], f"the link sensor of joint {i + 1}", found))
        warnings.extend(
            _misaligned(drive[i], f"motor {i + 1}'s response to {_named(view, i)}", found)
        )
    return replace(found, sensor_delay=sensor, drive_delay=drive, warnings=tuple(warnings))


def _named(view: _View, i: int) -> str:
    return f"the channel {view.channels[i]}"


def _told(delay: Delay | None, sample_time: float) -> Delay | None:
    return delay if delay is not None and delay.std < _SPREAD * sample_time else None


def _misaligned(delay: Delay | None, what: str, found: LinkSignals) -> Iterator[Caution]:
    if delay is None:
        return
    samples = delay.value / found.sample_time
    if abs(samples) < _MISALIGNED or abs(delay.value) < _CERTAIN * delay.std:
        return
    side = "late" if samples > 0.0 else "early"
    text = f"{what} is {1e3 * abs(delay.value):.3g} ms ({abs(samples):.1f} samples) too {side}"
    text += "; nothing was shifted. Check the logger's time stamps, and that the study gives"
    text += " accelerometer_hz and current_loop_hz"
    yield Caution("misaligned", found.experiment.name, text)
