"""Simulation of position servos: one PD law per joint around the arm of the compiled core.

The law of a joint gives the share of its torque limit,

    v_k = (kp (ref(t_k - T) - q_k) - kd w_k + feed-forward) / limit,

limited to 1 and held for a period. Its velocity w_k lies between the velocity at the reading and
the difference of two readings, by `VELOCITY_LAG`; no log tells how a servo computes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from strainwave.domain import BoolArray, FloatArray, LinearServo, PositionServo
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA
from strainwave.domain.arm.description import ControlLaw
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET
from strainwave.domain.keys import Key, Row, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, sensitivities, simulate_arms
from strainwave.identification.position_servo.records import (
    ReferenceHold,
    Segment,
    ServoRecord,
    common_period,
)

KP = "servo_kp"
KD = "servo_kd"
VISCOUS = "motor_viscous_friction"  # with the damping of the back-EMF, beyond the torque limit too
VELOCITY_LAG = "velocity_lag"  # 0: velocity at the reading; 1: difference over one period
LIMIT = "torque_limit"
DELAY = "servo_delay"
# gain by which all torques are divided [N m/rad], or, with a known gain, the ratio of the gain that
# known payloads ask for to it; left out: none
SCALE: Key = ("scale", None)

MOTOR_SHARE = "motor_share"  # of the motor in inertias of elastic joints
STIFFNESS = "gear_stiffness"
GEAR_DAMPING = "gear_damping"
GEAR_EFFECTS = {"backlash": "backlash", "load_friction": "load-friction"}
"""Parameter -> effect of a gear."""

_STEPS_PER_PERIOD = 15.0  # of the fastest resonance: a relative error of 2e-4 in its frequency
_MASS = 10.0  # [kg] above what base parameters of arms with position servos ask for
_RANK_TOLERANCE = 1e-9  # relative, of weights of base parameters
_RECORDING_STEP = 1e-3  # [s]; angles are interpolated between; at 20 Hz to 1e-5 of the amplitude
_SATURATED = 1.0 - 1e-9  # share of the torque limit
_INITIAL = ("initial_motor_angle", "initial_motor_velocity")


@dataclass(frozen=True, slots=True, eq=False)
class LoopInputs:
    """An arm with servos of given values, in one record."""

    values: Values
    record: ServoRecord
    plant: Arm
    vector: FloatArray  # parameters of the core
    servo: LinearServo
    step: float  # [s] of integrator and recording
    commands: FloatArray  # (n_ticks, n_joints) [rad] at the ticks of the servo
    output: FloatArray  # (n_ticks, n_joints) part of the output that does not depend on the motion


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """Simulated angles of a segment, with derivatives where they were requested."""

    angle: FloatArray  # (n_samples, n_joints) [rad]
    derivatives: FloatArray  # (n_samples, n_joints, n_directions)
    peak: FloatArray  # (n_joints,) of the output, over its limit

    @property
    def saturated(self) -> BoolArray:
        """Whether the output of each joint reaches its limit."""
        return np.asarray(self.peak >= _SATURATED)


@dataclass(frozen=True)
class ServoLoop:
    """An arm with its position servos.

    Values are torques in N m, or torques over the gain of joint 1 where no scale is known. They
    have the base parameters of rigid motion under their names, frictions of the joints, and those
    above for each joint.
    """

    arm: Arm
    servo: PositionServo
    hold: ReferenceHold
    has_stiff_gears: bool = False  # of a stiffness that is not fitted, for their effects

    @cached_property
    def _of_states(self) -> tuple[Key, ...]:
        """Initial states of the core by which it differentiates."""
        names = (*_INITIAL, "initial_link_velocity") if self.has_gears else _INITIAL
        return tuple((name, i) for name in names for i in self.numbers)

    @cached_property
    def plant_names(self) -> frozenset[Key]:
        """Parameters of the core."""
        return frozenset(self.arm.parameter_names)

    @property
    def has_gears(self) -> bool:
        """Whether joints are elastic."""
        return any(joint.elastic for joint in self.arm.joints)

    @property
    def numbers(self) -> range:
        """Joints from 1."""
        return range(1, self.arm.n_joints + 1)

    @property
    def n_states(self) -> int:
        """Unknowns of the initial state of a segment."""
        return len(_INITIAL) * self.arm.n_joints

    def row(self, key: Key, inputs: LoopInputs) -> Row | None:
        """Derivatives of the core's parameters by a value; None for values of the servo."""
        base, name, joint = self.arm.base, *key
        motors: list[Key] = [(MOTOR_INERTIA, i) for i in self.numbers]
        if name == MOTOR_SHARE:
            shares = self._shares(inputs.values)
            shares[(joint or 1) - 1] += 1.0  # linear in the share
            change = base.particular(shares) - base.particular(self._shares(inputs.values))
            weights = change @ np.array([inputs.values[column.key] for column in base.columns])
            return dict(zip((*base.links, *motors), weights.tolist(), strict=True))
        for k, column in enumerate(base.columns):
            if column.key == key:
                weights = base.particular(self._shares(inputs.values))[:, k]
                return dict(zip((*base.links, *motors), weights.tolist(), strict=True))
        if key == SCALE:
            carried = -self.arm.payload_vector(inputs.record.payload) / inputs.values[SCALE] ** 2
            return dict(zip(base.links, carried.tolist(), strict=True))
        if name == VISCOUS and joint is not None:
            return {key: float(self.arm.gear_ratios[joint - 1]) ** 2}
        return {key: 1.0} if key in self.plant_names else None

    def _shares(self, values: Values) -> FloatArray:
        return np.array([values.get((MOTOR_SHARE, i), 0.0) for i in self.numbers])

    @cached_property
    def _masses(self) -> FloatArray:
        """Change of the links of a chain (n_links,) by which they have masses, but no torques.

        The core checks the sign of each mass, of which base parameters determine sums.
        """
        rows = self.arm.base.rows[:, : len(self.arm.base.links)]
        _, s, Vt = np.linalg.svd(rows)
        free = Vt[int(np.sum(s > _RANK_TOLERANCE * s[0])) :].T
        masses = [k for k, (name, _) in enumerate(self.arm.base.links) if name == "link_mass"]
        if not masses or not free.size:
            return np.zeros(rows.shape[1])
        wanted = np.full(len(masses), _MASS)
        return np.asarray(free @ np.linalg.lstsq(free[masses], wanted)[0])

    def prepare(
        self, values: Values, record: ServoRecord, similar: LoopInputs | None = None
    ) -> LoopInputs:
        """Arm, servos and commands of a record; commands of equal delays are those of `similar`."""
        period, ratios = self.servo.period, self.arm.gear_ratios
        limits = np.array([values[LIMIT, i] for i in self.numbers])
        plant = self.arm.with_joints(
            replace(joint, encoder_counts=None, torque_per_volt=float(limit * abs(ratio)))
            for joint, limit, ratio in zip(self.arm.joints, limits, ratios, strict=True)
        )
        ticks: FloatArray = period * np.arange(record.time[-1] / period + 2.0, dtype=np.float64)
        commands = np.empty((len(ticks), self.arm.n_joints))
        width = common_period(period, record.sample_time)
        for i in range(self.arm.n_joints):
            late = ticks - values[DELAY, i + 1]
            if similar is not None and similar.values[DELAY, i + 1] == values[DELAY, i + 1]:
                commands[:, i] = similar.commands[:, i]
            else:
                commands[:, i] = record.commands(late, i, self.hold, width)
        output = commands * [values[KP, i] for i in self.numbers]
        for i in range(self.arm.n_joints):
            late = ticks - values[DELAY, i + 1]
            if record.feed_forward[:, i].any():
                ahead = record.feed_forwards(late, i, width)
                output[:, i] += (self.servo.torque_per_output(i + 1) or 1.0) * ahead
        known = self._core_values(values, record)
        step = _RECORDING_STEP
        if self.has_gears:
            resonance = plant.fastest_resonance(known)  # zero for an impossible arm
            step = min(step, 1.0 / (_STEPS_PER_PERIOD * max(resonance, 1.0)))
        step = period / int(np.ceil(period / step - 1e-6))
        servo = LinearServo(tuple(self._law(values, i) for i in self.numbers), period, 1.0)
        vector = plant.parameter_vector(known)
        output *= np.sign(ratios) / limits
        return LoopInputs(values, record, plant, vector, servo, step, commands, output)

    def simulate(
        self,
        inputs: LoopInputs,
        segment: Segment,
        state: FloatArray,
        directions: Sequence[Key] | None = None,
    ) -> Simulation:
        """Simulate a segment from a state (n_states,) of angles and velocities of the joints.

        With `directions`, the result has derivatives in these and then by the state.
        """
        period, ratios, n = self.servo.period, self.arm.gear_ratios, self.arm.n_joints
        time, first = segment.time, self.first_tick(segment)
        step = inputs.step
        parts = round(period / step)
        count = int(np.ceil((time[-1] / period - first) * parts - 1e-6)) + 1
        output = inputs.output[first : first + (count - 1) // parts + 1]
        drive = Drive(
            tick=period,
            voltage=output,
            reference=np.zeros_like(output),
            servo=(True,) * n,
            motor_angle=tuple((state[:n] / ratios).tolist()),
            initial_voltage=(0.0,) * n,
            motor_velocity=tuple((state[n:] / ratios).tolist()),
            link_velocity=tuple(state[n:].tolist()),
            linear_servo=inputs.servo,
        )
        position = (time - first * period) / step
        if directions is not None:
            recorded = sensitivities(
                inputs.plant,
                inputs.vector,
                drive,
                (*directions, *self._of_states),
                sample_time=step,
                samples=count,
                record=["motor_angle", "voltage"],
                max_time_step=step,
            )
            angle, derivatives = recorded["motor_angle"]
            voltage = recorded["voltage"][0]
            derivatives = _between(derivatives * ratios[:, None], position)
            if self.has_gears:  # the links start with their motors
                of_links = derivatives[..., -n:] * ratios
                derivatives = derivatives[..., :-n]
                derivatives[..., -n:] += of_links
            derivatives[..., -self.n_states :] /= np.tile(ratios, len(_INITIAL))
        else:
            runs = simulate_arms(
                inputs.plant,
                [inputs.vector],
                drive,
                sample_time=step,
                samples=count,
                record=["motor_angle", "voltage"],
                max_time_step=step,
            )
            angle, voltage = runs["motor_angle"][0], runs["voltage"][0]
            derivatives = np.zeros((len(time), n, 0))
        peak = np.max(np.abs(voltage), axis=0)
        return Simulation(_between(angle * ratios, position), derivatives, peak)

    def first_tick(self, segment: Segment) -> int:
        """The last reading of the servo before a segment."""
        return int(np.floor(segment.time[0] / self.servo.period + 1e-6))

    def _law(self, values: Values, joint: int) -> ControlLaw:
        period = self.servo.period
        scale = abs(float(self.arm.gear_ratios[joint - 1])) / values[LIMIT, joint]
        kp, kd, lead = values[KP, joint], values[KD, joint], 1.0 - values[VELOCITY_LAG, joint]
        # the velocity at the reading is the derivative of the parabola through three readings
        now, last, before = 1.0 + 0.5 * lead, -1.0 - lead, 0.5 * lead
        return ControlLaw(
            A=np.array([[0.0, 0.0], [1.0, 0.0]]),
            B=np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]),
            C=-scale * kd / period * np.array([last, before]),
            D=np.array([0.0, 0.0, -scale * (kp + kd / period * now)]),
            E=np.zeros(2),
            holds=np.zeros(2, dtype=bool),
        )

    def _core_values(self, values: Values, record: ServoRecord) -> Values:
        """Parameters of the core, with the payload of the record."""
        base = self.arm.base
        motors: list[Key] = [(MOTOR_INERTIA, i) for i in self.numbers]
        body = base.particular(self._shares(values)) @ np.array(
            [values[column.key] for column in base.columns]
        )
        body[: len(base.links)] += self._masses
        known = dict(zip((*base.links, *motors), body.tolist(), strict=True))
        for i, ratio in enumerate(self.arm.gear_ratios.tolist(), start=1):
            known[VISCOUS, i] = values[VISCOUS, i] * ratio**2
            known["link_viscous_friction", i] = 0.0
            known[COULOMB, i], known[OFFSET, i] = values[COULOMB, i], values[OFFSET, i]
            for name in (STIFFNESS, GEAR_DAMPING, *GEAR_EFFECTS):
                if (name, i) in self.plant_names:
                    known[name, i] = values[name, i]
        if record.payload is not None:
            carried = self.arm.payload_vector(record.payload) / values.get(SCALE, 1.0)
            for key, value in zip(base.links, carried.tolist(), strict=True):
                known[key] += value
        return known


def _between(values: FloatArray, position: FloatArray) -> FloatArray:
    """Rows at positions between rows, by linear interpolation along the first axis."""
    left = np.clip(np.floor(position + 1e-9).astype(int), 0, max(len(values) - 2, 0))
    share = (position - left).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[left] * (1.0 - share) + values[left + 1] * share)
