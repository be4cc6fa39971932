"""Check of the observers on simulated moves: the errors of the estimated links.

The plant has drawn parameters, friction, the whole curve of the gear, encoder counts, and sensors
with noise and their bandwidth. The observers know the estimates of the parameters, and the
interaction torques and readings of the planned motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.keys import Values
from strainwave.domain.link_sensors.link_space import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate_arms
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm
from strainwave.servo_design.control_law import Gains
from strainwave.servo_design.link_measurements import Measurement, known_part, with_places
from strainwave.servo_design.observer import Observer
from strainwave.servo_design.plants import base_vector
from strainwave.servo_design.verification import MOVE, Simulated, shortest_plan
from strainwave.signals.link_readings import JointMotion

_QUANTITIES: tuple[Quantity, ...] = ("voltage", "motor_angle", "link_angle", "link_velocity")

Runs = dict[Quantity, FloatArray]
"""Simulated quantities (n_runs, n_samples, n_joints)."""


@dataclass(frozen=True, slots=True, eq=False)
class EstimationError:
    """Root mean square errors [rad, rad/s] of one joint, the largest over the draws."""

    joint: int  # from 1
    by_motor: float  # motor angle times gear ratio as link angle
    by_encoder: float  # observer that reads the motor encoder alone
    by_observer: float
    without_interaction: float  # observer with an interaction torque of zero
    velocity_by_motor: float
    velocity_by_encoder: float
    velocity_by_observer: float
    # of the estimates: time (n_samples,) [s] and errors [rad] (n_samples, 2), motor and observer
    time: FloatArray
    errors: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlannedInputs:
    """What observers know of a planned motion: (n_samples, ...)."""

    torques: FloatArray  # (n_samples, n_joints) [N m] of the links
    motion: JointMotion
    model: Arm

    def interaction(self, observer: Observer) -> FloatArray:
        """Interaction torque (n_samples,) [N m]: without the acceleration of the joint itself."""
        i = observer.joint - 1
        return self.torques[:, i] - observer.link_inertia * self.motion.acceleration[:, i]

    def known_readings(self, observer: Observer) -> FloatArray:
        """Parts of the readings of an observer that others cause: (n_samples, n_readings)."""
        i = observer.joint - 1
        parts = [known_part(one, self.model, self.motion, i) for one in observer.measurements]
        return np.stack(parts, axis=1)


def errors_in_a_move(
    arm: IdentifiedArm,
    observers: tuple[Sequence[Observer], Sequence[Observer]],
    draws: Sequence[Values],
    gains: Sequence[Gains],
    posture: FloatArray,
    limits: FloatArray,
) -> tuple[EstimationError, ...]:
    """Errors in a planned move of all joints from a posture.

    `observers` are those with all sensors, and those with the motor encoders alone.
    """
    period = gains[0].period
    try:
        plan = shortest_plan(arm, posture, posture + MOVE, period, limits)
    except InvalidInput:  # a limit of a joint
        plan = shortest_plan(arm, posture, posture - MOVE, period, limits)
    simulated = Simulated.of(arm, limits)
    drive = simulated.follow(gains, plan)
    planned = plan.extended(len(drive.reference)).link_angle
    return estimation_errors(simulated, *observers, draws, drive, planned, np.random.default_rng(0))


def estimation_errors(
    simulated: Simulated,
    observers: Sequence[Observer],
    encoder_observers: Sequence[Observer],
    draws: Sequence[Values],
    drive: Drive,
    planned: FloatArray,
    rng: np.random.Generator,
) -> tuple[EstimationError, ...]:
    """Errors of all observers in the motion of a drive, over draws of the parameters.

    `drive` has ticks of the servo's period, at which `planned` (n_samples, n_joints) are the
    planned link angles.
    """
    model = with_places(simulated.arm)
    axes = [axis for each in observers for one in each.measurements for axis in one.axes]
    record = dict.fromkeys([*_QUANTITIES, *(name for axis in axes for name in axis.quantities)])
    samples = len(drive.reference)
    runs = simulate_arms(
        model, draws, drive, sample_time=drive.tick, samples=samples, record=list(record)
    )
    inputs = planned_inputs(simulated.arm, planned, drive.tick)
    results = []
    for observer, by_encoder in zip(observers, encoder_observers, strict=True):
        i = observer.joint - 1
        known = inputs.known_readings(observer)
        readings = read_runs(runs, observer.measurements, i, rng) - known
        torque, voltage = inputs.interaction(observer), simulated.inputs(runs["voltage"])[..., i]
        angle = model.links_of(runs["motor_angle"])[..., i]
        velocity = np.diff(angle, axis=1, prepend=angle[:, :1]) / drive.tick
        estimates = [
            estimate_link(observer, voltage, readings, torque),
            estimate_link(by_encoder, voltage, readings[..., :1], torque),
            estimate_link(observer, voltage, readings, np.zeros_like(torque)),
            np.stack([angle, velocity], axis=-1),
        ]
        link = np.stack([runs["link_angle"][..., i], runs["link_velocity"][..., i]], axis=-1)
        own, encoder, without, motor = (_rms(each - link) for each in estimates)
        pair = [(each - link)[0, :, 0] for each in (estimates[3], estimates[0])]
        time: FloatArray = drive.tick * np.arange(samples, dtype=np.float64)
        results.append(
            EstimationError(
                joint=observer.joint,
                by_motor=motor[0],
                by_encoder=encoder[0],
                by_observer=own[0],
                without_interaction=without[0],
                velocity_by_motor=motor[1],
                velocity_by_encoder=encoder[1],
                velocity_by_observer=own[1],
                time=time,
                errors=np.stack(pair, axis=1),
            )
        )
    return tuple(results)


def _rms(errors: FloatArray) -> tuple[float, float]:
    """The largest of all runs of errors (n_runs, n_samples, 2) of angle and velocity."""
    angle, velocity = np.sqrt(np.mean(errors**2, axis=1)).max(axis=0).tolist()
    return angle, velocity


def planned_inputs(arm: IdentifiedArm, planned: FloatArray, period: float) -> PlannedInputs:
    """What observers know of planned link angles (n_samples, n_joints)."""
    velocity = np.gradient(planned, period, axis=0)
    motion = JointMotion(planned, velocity, np.gradient(velocity, period, axis=0))
    model = with_places(arm)
    torques = model.link_torques(
        base_vector(model, arm.values), motion.angle, motion.velocity, motion.acceleration
    )
    return PlannedInputs(torques, motion, model)


def estimate_link(
    observer: Observer,
    voltage: FloatArray,
    readings: FloatArray,
    interaction: FloatArray,
    start: FloatArray | None = None,
) -> FloatArray:
    """Link angles and velocities (n_runs, n_samples, 2) from logs.

    `voltage` is (n_runs, n_samples), `readings` (n_runs, n_samples, n_readings) without their
    known parts, `interaction` (n_samples,). `start` (n_runs, n) are the first states; None: at rest
    under the first inputs.
    """
    system = observer.system
    torque = np.broadcast_to(interaction, voltage.shape)
    inputs = np.concatenate([np.stack([voltage, torque], axis=-1), readings], axis=-1)
    driven, direct = inputs @ system.B.T, inputs @ system.D.T
    first = np.stack([readings[:, 0, 0], torque[:, 0], voltage[:, 0]], axis=-1)
    x = first @ observer.at_rest.T if start is None else start
    estimates = np.empty_like(direct)
    for sample in range(voltage.shape[1]):
        estimates[:, sample] = x @ system.C.T + direct[:, sample]
        x = x @ system.A.T + driven[:, sample]
    return estimates


def read_runs(
    runs: Runs, measurements: Sequence[Measurement], i: int, rng: np.random.Generator
) -> FloatArray:
    """Readings (n_runs, n_samples, n_readings) of the sensors of joint i, from 0, with errors."""
    columns = []
    for one in measurements:
        if one.axes:
            readings = [
                [
                    axis.reading({name: rows[run] for name, rows in runs.items()}, {})
                    for axis in one.axes
                ]
                for run in range(len(runs["voltage"]))
            ]
            column = np.einsum("a,rat->rt", np.array(one.weights), np.array(readings))
        else:
            column = runs["motor_angle"][..., i]
        if one.resolution:
            column = one.resolution * np.round(column / one.resolution)
        else:
            column = column + rng.normal(0.0, one.std, column.shape)
        columns.append(column)
    return np.stack(columns, axis=-1)
