"""Feed-forward of elastic arms: motor references and voltages that move the links along a motion.

The links' motion q(t) gives the torques through the gears, these the torsions, and these the
motors' motion (inverse dynamics of the reduced model, Spong 1987):

    tau = M(q) ddq + c(q, dq) + g(q) + D_L dq
    T(delta) + d_G ddelta = tau
    theta_M = (C N)^-1 (q + delta)
    e u = m_M ddtheta_M + d_M dtheta_M + f_0 + N C^T tau + dry friction

Rates of tau are those of the motion's Taylor polynomial of degree four at each instant. They are
exact but for the fourth-order differences in time. Gear damping enters to first order: T = tau -
d_G dtau / k. The neglected part of the torsion is (d_G/k)^2 ddtau / k, which is 2e-3 of the torsion
for d_G/k = 1.5 ms and a motion of 5 Hz.

A voltage is held for a period. It has the mean torque of that period: the change of the motor's
velocity, which includes its steps at the knees of a gear, and Simpson's rule for the rest. First-
order lags of the drive are led by their time constant times the rate of the torque, without that of
dry friction. Identified effects of joints that follow from a reference motion are compensated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PPoly

from strainwave.domain import FloatArray, JointLimits
from strainwave.domain.arm.effects import Effect, all_effects
from strainwave.domain.arm.parameter_table import base_name
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm

_DIFFERENCE_SHARE = 0.25  # of the period, step of differences in time: truncation and rounding 1e-9
_FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0  # fourth-order central differences
_SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
_REST_TO_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 126.0, -420.0, 540.0, -315.0, 70.0)
"""Coefficients by rising power of 126 x^5 - 420 x^6 + 540 x^7 - 315 x^8 + 70 x^9.

It rises from 0 to 1 with four derivatives of zero at both ends.
"""


@dataclass(frozen=True, slots=True, eq=False)
class LinkMotion:
    """A motion of all links with four continuous derivatives."""

    time: FloatArray  # (n_samples,) [s] ticks of the servo
    period: float  # [s] between two ticks
    angle: PPoly

    def derivatives(self, time: FloatArray) -> FloatArray:
        """Angles and their first four derivatives: (5, n_times, n_joints).

        Beyond its ends the motion stays at its end values.
        """
        inside = np.clip(time, self.time[0], self.time[-1])
        return np.stack([self.angle(inside, order) for order in range(5)])


def point_to_point(
    begin: FloatArray, end: FloatArray, duration: float, period: float
) -> LinkMotion:
    """Motion between two postures (n_joints,) at rest: a polynomial of degree nine.

    The velocity is at most 2.46 times the mean velocity. The duration [s] is rounded to whole
    periods. Raises InvalidInput if it is shorter than one period.
    """
    n_periods = round(duration / period)
    if n_periods < 1:
        raise InvalidInput(
            f"a motion of {duration:g} s is shorter than the servo period of {period:g} s",
            remedy="give a longer duration",
        )
    time: FloatArray = period * np.arange(n_periods + 1, dtype=np.float64)
    powers = np.array(_REST_TO_REST) / time[-1] ** np.arange(len(_REST_TO_REST))
    coefficients = powers[::-1, None, None] * (np.asarray(end) - begin)
    coefficients[-1] += begin
    return LinkMotion(time, float(time[-1]) / n_periods, PPoly(coefficients, time[[0, -1]]))


@dataclass(frozen=True, slots=True, eq=False)
class FeedForward:
    """References and feed-forward of all motors at the ticks of a servo: (n_samples, n_joints)."""

    time: FloatArray  # (n_samples,) [s]
    link_angle: FloatArray  # [rad]
    motor_angle: FloatArray  # [rad]
    reference_velocity: FloatArray  # [rad/s] difference of the angles, as a servo measures it
    voltage: FloatArray  # [V]

    def extended(self, n_samples: int) -> FeedForward:
        """The motion, cut or held at its end, with a number of samples."""
        row = np.minimum(np.arange(n_samples), len(self.time) - 1)
        velocity = self.reference_velocity[row]
        velocity[len(self.time) :] = 0.0
        period = self.time[1] - self.time[0]
        time: FloatArray = self.time[0] + period * np.arange(n_samples, dtype=np.float64)
        angles = self.link_angle[row], self.motor_angle[row]
        return FeedForward(time, *angles, velocity, self.voltage[row])

    def servo_reference(self, position_gain: FloatArray) -> FloatArray:
        """Velocity references [rad/s] of a servo that integrates them to its position reference.

        Such a servo (`strainwave.domain.Servo` with `position_gain` [1/s], (n_joints,)) has no
        error if the motors follow `motor_angle`. Without a position loop the references are
        `reference_velocity`.
        """
        period = self.time[1] - self.time[0]
        change = np.diff(self.reference_velocity, axis=0) * period
        lag = np.zeros_like(self.motor_angle)  # of the integral behind the motor angle
        for k, more in enumerate(change):
            lag[k + 1] = (1.0 - position_gain * period) * lag[k] + more
        return self.reference_velocity + position_gain * lag


def feed_forward(arm: IdentifiedArm, motion: LinkMotion) -> FeedForward:
    """Motor references and voltages of a motion, sampled at its ticks.

    Dry friction is compensated by a share (n_joints,) times tanh(dtheta_M / w) of its estimate,
    with the velocity of the reference, so that encoder noise cannot switch it. w is one encoder
    count per period, the resolution of the measured velocity. Without an encoder in the study it is
    the largest change of the reference velocity in a period. The share is the lower limit of the
    95 % interval of `motor_coulomb_friction` over its value, and one without an interval.

    Raises InvalidInput if a parameter is missing, or if the motion exceeds the limits of a joint or
    the voltage of the servo.
    """
    model = _InverseArm(arm, Arm.of(arm.with_identified_drives().study.arm), effects_of(arm))
    period, ticks = motion.period, motion.time
    at_ticks = model.follow(motion, ticks)
    before = model.follow(motion, ticks[:1] - period).motor_angle
    reference_velocity = np.diff(at_ticks.motor_angle, axis=0, prepend=before) / period

    held = model.follow(motion, ticks[0] + 0.5 * period * np.arange(2 * len(ticks) + 1))
    acceleration = np.diff(held.motor_velocity[::2], axis=0) / period
    counts = np.array([joint.encoder_resolution for joint in arm.study.arm.joints])
    largest = np.abs(acceleration).max(axis=0) * period
    transition = np.where(counts > 0.0, counts / period, largest)
    # zero for a joint that never moves
    rest, moves = np.zeros_like(held.motor_velocity), transition > 0.0
    sign = np.tanh(np.divide(held.motor_velocity, transition, out=rest, where=moves))
    friction = _friction_shares(arm) * _mean(held.dry_friction * sign)
    torque = model.columns["motor_inertia"] * acceleration + _mean(held.steady_torque)
    # the drives' lags (S30) and errors of their torque per volt (S21)
    loops_hz = [joint.current_loop_hz for joint in model.arm.joints]
    lags = np.array([1.0 / (math.tau * hz) if hz else 0.0 for hz in loops_hz])
    lags += [each.values.get("drive-lag", {}).get("drive_lag", 0.0) for each in model.effects]
    torque = torque + lags * np.gradient(torque, period, axis=0)
    errors = [each.values.get("drive-gain", {}).get("drive_gain", 0.0) for each in model.effects]
    voltage = (torque + friction) / (model.arm.torque_per_volt * (1.0 + np.array(errors)))
    _check_limits(arm, ticks, at_ticks, voltage)
    angles = at_ticks.link[0], at_ticks.motor_angle
    return FeedForward(ticks, *angles, reference_velocity, voltage)


@dataclass(frozen=True, slots=True, eq=False)
class _Instants:
    """The arm at instants of a motion: (n, n_joints)."""

    link: FloatArray  # (5, n, n_joints) angle and its derivatives
    link_torque: FloatArray
    motor_angle: FloatArray
    motor_velocity: FloatArray
    steady_torque: FloatArray  # motor torque without inertia of the motor and dry friction
    dry_friction: FloatArray  # without its sign


@dataclass(frozen=True, eq=False)
class _InverseArm:
    """An identified arm whose links follow a motion."""

    identified: IdentifiedArm
    arm: Arm  # with the identified torques per volt
    effects: tuple[JointEffects, ...]

    @cached_property
    def columns(self) -> Mapping[str, FloatArray]:
        """Parameters of all joints: (n_joints,); an offset that is not identified is zero."""
        need, known = self.identified.need, self.identified.values
        numbers = range(1, self.arm.n_joints + 1)
        friction = ("motor_viscous_friction", "motor_coulomb_friction", "link_viscous_friction")
        names = ("motor_inertia", *friction)
        columns = {name: np.array([need(name, number) for number in numbers]) for name in names}
        offsets = [known.get(("friction_offset", number), 0.0) for number in numbers]
        return columns | {"friction_offset": np.array(offsets)}

    @cached_property
    def base(self) -> FloatArray:
        """Base parameters: (n_base,)."""
        effective, need = set(self.arm.base.effective), self.identified.need
        return np.array([need(*key) if key in effective else 0.0 for key in self.arm.base_names])

    @cached_property
    def gears(self) -> Mapping[int, tuple[Mapping[str, float], float]]:
        """Values of the gear law and gear damping of the elastic joints, from 0.

        A curve that is identified in part has its first slopes.
        """
        need, known = self.identified.need, self.identified.values
        gears = {}
        for i, joint in enumerate(self.arm.joints):
            if joint.elastic:
                names = joint.law.drawn([name for name, number in known if number == i + 1])
                values = {name: need(name, i + 1) for name in names or joint.law.names}
                gears[i] = values, need("gear_damping", i + 1)
        return gears

    def link_torques(
        self, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Torques that the gears transmit: (n, n_joints)."""
        torques = self.arm.link_torques(self.base, angle, velocity, acceleration)
        torques = torques + self.columns["link_viscous_friction"] * velocity
        is_planar = self.arm.has_planar_program
        for i, effects in enumerate(self.effects):
            torques[:, i] += effects.load(angle[:, i])
            if is_planar:  # parallel axes: all joints before carry the link
                torques[:, : i + 1] += effects.weight(angle[:, : i + 1].sum(axis=1))[:, None]
            else:
                torques[:, i] += effects.weight(angle[:, i])
        return torques

    def follow(self, motion: LinkMotion, time: FloatArray) -> _Instants:
        """All joints at instants [s]."""
        link = motion.derivatives(time)
        step = _DIFFERENCE_SHARE * motion.period
        around = [_taylor(link, k * step) for k in (-2.0, -1.0, 0.0, 1.0, 2.0)]
        angle, velocity, acceleration = (
            np.concatenate([at[order] for at in around]) for order in range(3)
        )
        torques = self.link_torques(angle, velocity, acceleration).reshape(5, *link.shape[1:])
        rate = np.tensordot(_FIRST, torques, 1) / step
        change = np.tensordot(_SECOND, torques, 1) / step**2
        torque = torques[2]
        torsion, torsion_rate = self._torsions(torque, rate, change)
        motor = self.arm.motor_accelerations(link[0] + torsion)
        turning = self.arm.motor_accelerations(link[1] + torsion_rate)
        load = self.arm.motors_of(torque)
        steady, dry = np.empty_like(motor), np.empty_like(motor)
        viscous = self.columns["motor_viscous_friction"]
        coulomb = self.columns["motor_coulomb_friction"]
        for i, (effects, joint) in enumerate(zip(self.effects, self.arm.joints, strict=True)):
            motor[:, i], ratio = effects.motor_angle(motor[:, i], joint.gear_ratio)
            turning[:, i] /= ratio
            load[:, i] *= ratio
            steady[:, i] = load[:, i] + viscous[i] * turning[:, i]
            steady[:, i] += effects.motor_torque(motor[:, i], turning[:, i])
            dry[:, i] = coulomb[i] + effects.dry_friction(turning[:, i], load[:, i])
        steady += self.columns["friction_offset"]
        return _Instants(link, torque, motor, turning, steady, dry)

    def _torsions(
        self, torque: FloatArray, rate: FloatArray, change: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Torsions and their rates for gear torques with their first and second derivatives."""
        torsion, torsion_rate = np.zeros_like(torque), np.zeros_like(torque)
        for i, (values, damping) in self.gears.items():
            law = self.arm.joints[i].law
            slope = law.stiffness(values, law.torsion(values, torque[:, i]))
            elastic = torque[:, i] - damping * rate[:, i] / slope
            torsion[:, i] = law.torsion(values, elastic)
            slope = law.stiffness(values, torsion[:, i])
            torsion_rate[:, i] = (rate[:, i] - damping * change[:, i] / slope) / slope
        return torsion, torsion_rate


def _taylor(derivatives: FloatArray, step: float) -> FloatArray:
    """Angle, velocity and acceleration a step [s] later: (3, n, n_joints)."""
    powers = [step**k / math.factorial(k) for k in range(len(derivatives))]
    return np.stack(
        [
            np.tensordot(powers[: len(derivatives) - order], derivatives[order:], 1)
            for order in range(3)
        ]
    )


def _mean(halves: FloatArray) -> FloatArray:
    """Means over periods by Simpson's rule, from samples at half periods."""
    return np.asarray((halves[:-1:2] + 4.0 * halves[1::2] + halves[2::2]) / 6.0)


def _friction_shares(arm: IdentifiedArm) -> FloatArray:
    """Lower limits of Coulomb friction over the estimates: (n_joints,)."""
    shares = np.ones(arm.study.arm.n_joints)
    for parameter in arm.parameters:
        if parameter.name == "motor_coulomb_friction" and parameter.ci95 and parameter.value:
            share = parameter.ci95[0] / parameter.value
            shares[(parameter.joint or 1) - 1] = min(max(share, 0.0), 1.0)
    return shares


def _check_limits(arm: IdentifiedArm, time: FloatArray, at: _Instants, voltage: FloatArray) -> None:
    """Raise InvalidInput if a motion exceeds the limits of a joint or the voltage of the servo."""
    checks: list[tuple[int, str, str, FloatArray, float | None, int]] = []
    for i, joint in enumerate(arm.study.arm.joints):
        limits, angle = joint.limits or JointLimits(), at.link[0, :, i]
        position, speed, force = (
            ("m", "m/s", "N") if joint.motion == "prismatic" else ("rad", "rad/s", "N m")
        )
        checks += [
            (i, "the lower position limit", position, angle, limits.lower, -1),
            (i, "the upper position limit", position, angle, limits.upper, 1),
            (i, "the velocity limit", speed, np.abs(at.link[1, :, i]), limits.velocity, 1),
            (i, "the effort limit", force, np.abs(at.link_torque[:, i]), limits.effort, 1),
        ]
    if servo := arm.study.arm.servo:
        name = "the voltage limit of the servo"
        sizes = enumerate(np.abs(voltage).T)
        checks += [(i, name, "V", size, servo.limit, 1) for i, size in sizes]
    for i, name, unit, size, limit, sign in checks:
        sample = int(np.argmax(sign * size))
        if limit is not None and sign * size[sample] > sign * limit:
            raise InvalidInput(
                f"joint {i + 1} needs {size[sample]:.4g} {unit} at {time[sample]:.4g} s, beyond"
                f" {name} of {limit:.4g} {unit}",
                where="motion",
                remedy="make the motion slower or smaller",
            )


COMPENSATED = (
    "stribeck",
    "load-friction",
    "power-friction",
    "torque-ripple",
    "kinematic-error",
    "ground-spring",
    "tilt",
    "drive-gain",
    "drive-lag",
)
"""Effects that are functions of the reference, and those that scale or delay the drive."""

_POWER_VELOCITY = 100.0  # [rad/s] at which power friction is about f_P, as in the core
_POWER_OFFSET = 0.01  # of the relative velocity, as in the core
_N_NEWTON = 20  # steps; five reach rounding error for real gears


@dataclass(frozen=True, slots=True)
class JointEffects:
    """Values of the identified effects of one joint, by effect and parameter.

    Arrays are those of one joint: (n_samples,).
    """

    values: Mapping[str, Mapping[str, float]]

    def load(self, angle: FloatArray) -> FloatArray:
        """Torque [N m] of a ground spring at the link, (S19)."""
        spring = self.values.get("ground-spring")
        if spring is None:
            return np.zeros_like(angle)
        return spring["ground_stiffness"] * angle + spring["ground_preload"]

    def weight(self, angle: FloatArray) -> FloatArray:
        """Torque [N m] of unmodelled gravity over the angle of the link in space, (S23)."""
        tilt = self.values.get("tilt")
        if tilt is None:
            return np.zeros_like(angle)
        return np.asarray(tilt["tilt_sin"] * np.sin(angle) + tilt["tilt_cos"] * np.cos(angle))

    def dry_friction(self, velocity: FloatArray, load: FloatArray) -> FloatArray:
        """Dry friction [N m] in addition to Coulomb friction, (S10), (S15), without a sign.

        `load` [N m] is the gear torque at the motor.
        """
        friction = np.zeros_like(velocity)
        if stribeck := self.values.get("stribeck"):
            share = velocity / stribeck["stribeck_velocity"]
            friction += stribeck["stribeck_friction"] * np.exp(-(share**2))
        if teeth := self.values.get("load-friction"):
            friction += teeth["load_friction"] * np.abs(load)
        return friction

    def motor_torque(self, angle: FloatArray, velocity: FloatArray) -> FloatArray:
        """Torque [N m] that balances power friction, (S16), and torque ripple, (S17)."""
        torque = np.zeros_like(angle)
        if drag := self.values.get("power-friction"):
            power, offset = drag["power_exponent"], _POWER_OFFSET
            speed = np.abs(velocity) / _POWER_VELOCITY + offset
            torque += np.sign(velocity) * drag["power_friction"] * (speed**power - offset**power)
        if ripple := self.values.get("torque-ripple"):
            phase = ripple["torque_ripple_order"] * angle
            torque -= ripple["torque_ripple_cos"] * np.cos(phase)
            torque -= ripple["torque_ripple_sin"] * np.sin(phase)
        return torque

    def motor_angle(self, ideal: FloatArray, gear_ratio: float) -> tuple[FloatArray, FloatArray]:
        """Motor angle theta, and ratio of the output's velocity to n dtheta, (S12).

        n theta + e(theta) = n theta_ideal
        """
        error = self.values.get("kinematic-error")
        if error is None:
            return ideal, np.ones_like(ideal)
        k, a, b = (error[f"kinematic_error_{name}"] for name in ("order", "cos", "sin"))
        theta = ideal
        for _ in range(_N_NEWTON):
            cos, sin = np.cos(k * theta), np.sin(k * theta)
            ratio = 1.0 + k * (b * cos - a * sin) / gear_ratio
            theta = theta - (theta - ideal + (a * cos + b * sin) / gear_ratio) / ratio
        return theta, 1.0 + k * (b * np.cos(k * theta) - a * np.sin(k * theta)) / gear_ratio


def effects_of(arm: IdentifiedArm) -> tuple[JointEffects, ...]:
    """Identified effects of all joints that feed-forward can compensate.

    Raises InvalidInput if a shape is missing, or if a kinematic error reverses a gear.
    """
    estimated = {(base_name(p.name), p.joint) for p in arm.parameters if p.value is not None}
    joints = []
    for number in range(1, arm.study.arm.n_joints + 1):
        values = {
            effect.name: _values_of(effect, arm, number)
            for effect in all_effects()
            if effect.name in COMPENSATED
            and any((size, number) in estimated for size in effect.sizes)
        }
        if error := values.get("kinematic-error"):
            size = np.hypot(error["kinematic_error_cos"], error["kinematic_error_sin"])
            slope = error["kinematic_error_order"] * size / abs(arm.joint(number).gear_ratio)
            if slope >= 1.0:
                raise InvalidInput(
                    f"the kinematic error of joint {number} reverses the gear: its slope is "
                    f"{slope:.3g} times the gear ratio",
                    where=f"{arm.source}: parameters",
                    remedy="check kinematic_error_cos and kinematic_error_sin",
                )
        joints.append(JointEffects(values))
    return tuple(joints)


def _values_of(effect: Effect, arm: IdentifiedArm, number: int) -> Mapping[str, float]:
    """Sizes and shapes of an effect; sizes that are not identified are zero."""
    by_default = dict.fromkeys(effect.sizes, 0.0) | dict(effect.defaults)
    return {
        name: by_default[name]
        if name in by_default and (name, number) not in arm.values
        else arm.need(name, number)
        for name in effect.names
    }
