"""Moves of single joints on the identified arm, and of all joints to check the observers.

The plant has drawn parameters, friction, the whole curve of the gear, encoders with counts, and
sensors with noise and their bandwidth; servo and observers know the estimates only. A step is under
the loops alone. The planned move has the shortest duration that the voltage limit allows, with the
elastic arm's feed-forward. The observers also know the interaction torques and readings of the
planned motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.arm.description import ControlLaw, LinearServo
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import JointIndex, JointNumber, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import JointMotion
from strainwave.dynamics.simulation import Drive, Samples, plan_run, simulate_arms, simulate_runs
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.export.source import IdentifiedArm
from strainwave.tune.closed_loop import Gains, settling_times
from strainwave.tune.feed_forward import FeedForward, feed_forward, point_to_point
from strainwave.tune.link_measurements import Measurement, known_part, with_places
from strainwave.tune.margins import band_over
from strainwave.tune.observer import Observer
from strainwave.tune.plants import base_vector

MOVE = 0.05
"""Move [rad or m] of a link."""

_SECONDS = 1.5  # of a simulation
_SHORTEST, _LONGEST = 0.02, 1.0  # [s] durations that are tried
_DURATION_STEP = 1.15
_VOLTAGE_SHARE = 0.8  # of the limit for the feed-forward; the rest is for the loops
_QUANTITIES: tuple[Quantity, ...] = ("voltage", "motor_angle", "link_angle", "link_velocity")

Runs = dict[Quantity, FloatArray]
"""Simulated quantities (n_runs, n_samples, n_joints)."""


@dataclass(frozen=True, slots=True)
class Move:
    """Behaviour of a link after a command at time zero: the worst of the drawn plants."""

    settling: float  # [s] to 2 % of the move; infinite if it does not settle
    overshoot: float  # share of the move
    vibration: float  # share of the move: half of the range of the last third of the simulation
    peak_voltage: float  # [V]


@dataclass(frozen=True, slots=True, eq=False)
class MoveComparison:
    """Moves of one joint from one posture."""

    joint: JointNumber
    duration: float  # [s] of the planned move
    current: Move | None  # step under the current servo; None without one
    step: Move
    planned: Move
    time: FloatArray  # (n_samples,) [s]
    # (n_samples, 3) over the move: smallest, with the estimates, largest
    step_link: FloatArray
    planned_link: FloatArray


def plan_moves(
    arm: IdentifiedArm, posture: FloatArray, period: float, limits: FloatArray
) -> list[FeedForward]:
    """Plans of the shortest moves of each joint from a posture [rad].

    Raises `InvalidInput` if no duration up to a second stays within the voltage limit.
    """
    changes = MOVE * np.eye(len(posture))
    return [shortest_plan(arm, posture, posture + each, period, limits) for each in changes]


def compare_moves(
    arm: IdentifiedArm,
    servos: tuple[Sequence[Gains], Sequence[Gains] | None],
    draws: Sequence[Values],
    plans: Sequence[FeedForward],
    limits: FloatArray,
) -> tuple[MoveComparison, ...]:
    """Simulate the planned moves of each joint, for all draws.

    `servos` are the gains of the designed servo, and those of the current one if there is one.
    """
    simulated, (gains, current) = Simulated.of(arm, limits), servos
    period, changes = gains[0].period, MOVE * np.eye(len(gains))
    drives = [simulated.follow(gains, plan) for plan in plans]
    drives += [
        simulated.step(servo, plan, change)
        for servo in (gains, current)
        if servo is not None
        for plan, change in zip(plans, changes, strict=True)
    ]
    of_drives = _simulate(simulated, draws, drives, period)
    comparisons = []
    for i, plan in enumerate(plans):
        (planned, planned_link), (step, step_link), *of_current = (
            _move_of(simulated, runs, period, i) for runs in of_drives[i :: len(plans)]
        )
        comparisons.append(
            MoveComparison(
                joint=i + 1,
                duration=float(plan.time[-1]),
                current=of_current[0][0] if of_current else None,
                step=step,
                planned=planned,
                time=period * np.arange(len(step_link), dtype=np.float64),
                step_link=step_link,
                planned_link=planned_link,
            )
        )
    return tuple(comparisons)


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """An arm whose drives have one limit: inputs are scaled where limits differ."""

    arm: IdentifiedArm
    limit: float  # of the scaled inputs: the largest of all
    scale: FloatArray  # (n_joints,) scaled inputs over inputs

    @classmethod
    def of(cls, arm: IdentifiedArm, limits: FloatArray) -> Simulated:
        """The arm with the limits (n_joints,) of its drives."""
        study, limit = arm.study, float(limits.max())
        description = study.arm
        scale = limit / limits
        for number, each in enumerate(scale.tolist(), start=1):
            if each > 1.0:
                torque = description.joints[number - 1].torque_per_command / each
                description = description.with_joint(number, torque_per_volt=torque)
        return cls(replace(arm, study=replace(study, arm=description)), limit, scale)

    @property
    def model(self) -> Arm:
        """The arm with the equations."""
        return Arm.of(self.arm.study.arm)

    def inputs(self, scaled: FloatArray) -> FloatArray:
        """Inputs of the drives for scaled ones (..., n_joints)."""
        return scaled / self.scale

    def follow(self, gains: Sequence[Gains], plan: FeedForward) -> Drive:
        """A planned move with its feed-forward."""
        held = plan.extended(round(_SECONDS / gains[0].period))
        reference = held.servo_reference(np.array([each.position_gain for each in gains]))
        return self.drive([each.law() for each in gains], plan, reference, held.voltage)

    def step(self, gains: Sequence[Gains], plan: FeedForward, change: FloatArray) -> Drive:
        """A step of the reference angles by a change of the link angles, without feed-forward.

        It enters through the reference angle alone, or as a pulse of the velocity where a servo has
        no position loop.
        """
        period = gains[0].period
        laws = []
        for each in gains:
            law, used = each.law(), np.array([1.0, 0.0 if each.position_gain else 1.0, 1.0])
            laws.append(replace(law, B=law.B * used, D=law.D * used))
        reference = np.zeros((round(_SECONDS / period), len(gains)))
        reference[0] = self.model.motor_accelerations(change[None])[0] / period
        held = np.broadcast_to(plan.voltage[0], reference.shape)
        return self.drive(laws, plan, reference, held)

    def drive(
        self,
        laws: Sequence[ControlLaw],
        plan: FeedForward,
        reference: FloatArray,
        voltage: FloatArray,
    ) -> Drive:
        """All motors under control laws, from the planned posture at rest."""
        scaled = tuple(
            replace(law, C=each * law.C, D=each * law.D, E=law.E / each)
            for law, each in zip(laws, self.scale.tolist(), strict=True)
        )
        period = float(plan.time[1] - plan.time[0])
        return Drive(
            tick=period,
            voltage=np.ascontiguousarray(self.scale * voltage),
            reference=np.ascontiguousarray(reference),
            servo=(True,) * len(scaled),
            motor_angle=tuple(plan.motor_angle[0].tolist()),
            initial_voltage=tuple((self.scale * plan.voltage[0]).tolist()),
            linear_servo=LinearServo(scaled, period, self.limit),
        )


def _simulate(
    simulated: Simulated, draws: Sequence[Values], drives: Sequence[Drive], period: float
) -> list[list[Samples]]:
    """Runs of each drive over all draws; together they fill the registers."""
    model = simulated.model
    vectors, runs = [model.parameter_vector(draw) for draw in draws], []
    for drive in drives:
        run = plan_run(
            model,
            draws[0],
            drive,
            sample_time=period,
            samples=len(drive.reference),
            record=["link_angle", "voltage"],
            max_time_step=min(map(model.max_time_step, draws)),
        )
        runs += [replace(run, parameters=vector) for vector in vectors]
    samples, n = simulate_runs(runs), len(draws)
    return [samples[k : k + n] for k in range(0, len(samples), n)]


def _move_of(
    simulated: Simulated, runs: Sequence[Samples], period: float, i: JointIndex
) -> tuple[Move, FloatArray]:
    """The worst move of joint i over all runs, and the band of its link over the move."""
    angle = np.stack([run["link_angle"][:, i] for run in runs])
    peaks = np.abs([simulated.inputs(run["voltage"])[:, i] for run in runs])
    share = (angle - angle[:, :1]) / MOVE
    if not np.isfinite(share).all():
        raise NumericalFailure("the simulated move diverges")
    tail = share[:, 2 * share.shape[1] // 3 :]
    move = Move(
        settling=float(settling_times(share, period).max()),
        overshoot=float(max(0.0, share.max() - 1.0)),
        vibration=float(0.5 * np.ptp(tail, axis=1).max()),
        peak_voltage=float(peaks.max()),
    )
    return move, band_over(share)


def shortest_plan(
    arm: IdentifiedArm, begin: FloatArray, end: FloatArray, period: float, limits: FloatArray
) -> FeedForward:
    """The shortest planned move between two postures within the limits of the drives.

    Raises `InvalidInput` if a second does not suffice.
    """
    duration = _SHORTEST
    while duration <= _LONGEST:
        motion = point_to_point(begin, end, duration, period)
        try:
            plan = feed_forward(arm, motion)
        except InvalidInput:
            if duration * _DURATION_STEP > _LONGEST:
                raise
        else:
            if (np.abs(plan.voltage) <= _VOLTAGE_SHARE * limits).all():
                return plan
        duration *= _DURATION_STEP
    raise InvalidInput(
        f"a move of {float(np.abs(end - begin).max()):g} rad takes more than {_LONGEST:g} s",
        remedy="choose a smaller move",
    )


@dataclass(frozen=True, slots=True, eq=False)
class EstimationError:
    """Root mean square errors [rad, rad/s] of one joint, the largest over the draws."""

    joint: JointNumber
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

    @classmethod
    def of(cls, arm: IdentifiedArm, planned: FloatArray, period: float) -> Self:
        """The inputs for planned link angles (n_samples, n_joints)."""
        velocity = np.gradient(planned, period, axis=0)
        motion = JointMotion(planned, velocity, np.gradient(velocity, period, axis=0))
        model = with_places(arm)
        base = base_vector(model, arm.values)
        torques = model.link_torques(base, motion.angle, motion.velocity, motion.acceleration)
        return cls(torques, motion, model)

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
    inputs = PlannedInputs.of(simulated.arm, planned, drive.tick)
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
        errors = np.array(estimates) - link
        # the largest of all runs, of angle and velocity
        own, encoder, without, motor = np.sqrt(np.mean(errors**2, axis=2)).max(axis=1).tolist()
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
                time=drive.tick * np.arange(samples, dtype=np.float64),
                errors=errors[[3, 0], 0, :, 0].T,
            )
        )
    return tuple(results)


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
    runs: Runs, measurements: Sequence[Measurement], i: JointIndex, rng: np.random.Generator
) -> FloatArray:
    """Readings (n_runs, n_samples, n_readings) of the sensors of joint i with errors."""
    columns, n_runs = [], len(runs["voltage"])
    each_run = [{name: rows[run] for name, rows in runs.items()} for run in range(n_runs)]
    for one in measurements:
        if one.axes:
            readings = [[axis.reading(run, {}) for axis in one.axes] for run in each_run]
            column = np.einsum("a,rat->rt", np.array(one.weights), np.array(readings))
        else:
            column = runs["motor_angle"][..., i]
        if one.resolution:
            column = one.resolution * np.round(column / one.resolution)
        else:
            column = column + rng.normal(0.0, one.std, column.shape)
        columns.append(column)
    return np.stack(columns, axis=-1)
