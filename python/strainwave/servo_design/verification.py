"""Moves of single joints on the identified arm: steps under the loops alone, and a planned move.

The plant has drawn parameters, friction, the whole curve of the gear, and encoders with counts; the
servo knows the estimates only. The planned move has the shortest duration that the voltage limit
allows, with the elastic arm's feed-forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.control_law import ControlLaw, LinearServo
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.export.source import IdentifiedArm
from strainwave.servo_design.control_law import Gains
from strainwave.servo_design.feed_forward import FeedForward, feed_forward
from strainwave.servo_design.link_motion import point_to_point

MOVE = 0.05
"""Move [rad or m] of a link."""

_SETTLED = 0.02  # of the move
_SECONDS = 1.5  # of a simulation
_SHORTEST, _LONGEST = 0.02, 1.0  # [s] durations that are tried
_DURATION_STEP = 1.15
_VOLTAGE_SHARE = 0.8  # of the limit for the feed-forward; the rest is for the loops


@dataclass(frozen=True, slots=True)
class Move:
    """Behaviour of a link after a command at time zero: the worst of the drawn plants."""

    settling: float  # [s] to 2 % of the move; infinite if it does not settle
    overshoot: float  # share of the move
    vibration: float  # share of the move: half of the range of the last third of the simulation
    peak_voltage: float  # [V]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Moves of one joint from one posture."""

    joint: int  # from 1
    posture: FloatArray  # (n_joints,)
    duration: float  # [s] of the planned move
    current: Move | None  # step under the current servo; None without one
    step: Move
    planned: Move
    time: FloatArray  # (n_samples,) [s]
    # (n_samples, 3) over the move: smallest, with the estimates, largest
    step_link: FloatArray
    planned_link: FloatArray


def compare_moves(
    arm: IdentifiedArm,
    gains: Sequence[Gains],
    draws: Sequence[Values],
    joint: int,
    posture: FloatArray,
    limits: FloatArray,
    *,
    current: Sequence[Gains] | None = None,
    move: float = MOVE,
) -> Comparison:
    """Simulate the moves of a joint, from 1, from a posture [rad], for all draws.

    `current` are the gains of the current servo. Raises `InvalidInput` if no duration up to a
    second stays within the voltage limit.
    """
    end = posture.copy()
    end[joint - 1] += move
    plan = shortest_plan(arm, posture, end, gains[0].period, limits)
    simulated = Simulated.of(arm, limits)
    change = end - posture
    step_run = _simulate_all(simulated, draws, _step(simulated, gains, plan, change), joint)
    current_move = None
    if current is not None:
        drive = _step(simulated, current, plan, change)
        current_move = _simulate_all(simulated, draws, drive, joint).move(move)
    planned_run = _simulate_all(simulated, draws, simulated.follow(gains, plan), joint)
    return Comparison(
        joint=joint,
        posture=posture,
        duration=float(plan.time[-1]),
        current=current_move,
        step=step_run.move(move),
        planned=planned_run.move(move),
        time=step_run.time,
        step_link=step_run.band / move,
        planned_link=planned_run.band / move,
    )


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


@dataclass(frozen=True, slots=True, eq=False)
class _Runs:
    """Motion of one link and the peak voltages of its motor."""

    time: FloatArray  # (n_samples,) [s]
    link: FloatArray  # (n_draws, n_samples) from the first angle
    peaks: FloatArray  # (n_draws,) [V]

    @property
    def band(self) -> FloatArray:
        """Smallest angle, that with the estimates, and largest: (n_samples, 3)."""
        return np.stack([self.link.min(axis=0), self.link[0], self.link.max(axis=0)], axis=1)

    def move(self, size: float) -> Move:
        """The worst behaviour of all draws."""
        share = self.link / size
        if not np.isfinite(share).all():
            raise NumericalFailure("the simulated move diverges")
        is_apart = np.abs(share - 1.0) > _SETTLED
        last = share.shape[1] - np.argmax(is_apart[:, ::-1], axis=1)
        settling = np.where(is_apart[:, -1], np.inf, last * self.time[1])
        tail = share[:, 2 * share.shape[1] // 3 :]
        return Move(
            settling=float(settling.max()),
            overshoot=float(max(0.0, share.max() - 1.0)),
            vibration=float(0.5 * np.ptp(tail, axis=1).max()),
            peak_voltage=float(self.peaks.max()),
        )


def _simulate_all(simulated: Simulated, draws: Sequence[Values], drive: Drive, joint: int) -> _Runs:
    """The motion of a joint, from 1, for all draws."""
    samples, links, peaks, model = len(drive.reference), [], [], simulated.model
    for values in draws:
        run = simulate(
            model,
            values,
            drive,
            sample_time=drive.tick,
            samples=samples,
            record=["link_angle", "voltage"],
        )
        angle = run["link_angle"][:, joint - 1]
        links.append(angle - angle[0])
        peaks.append(np.abs(simulated.inputs(run["voltage"])[:, joint - 1]).max())
    time: FloatArray = drive.tick * np.arange(samples, dtype=np.float64)
    return _Runs(time, np.array(links), np.array(peaks))


def _step(
    simulated: Simulated, gains: Sequence[Gains], plan: FeedForward, change: FloatArray
) -> Drive:
    """A step of the reference angles by a change of the link angles, without feed-forward.

    It enters through the reference angle alone, or as a pulse of the velocity where a servo has no
    position loop.
    """
    period = gains[0].period
    laws = [each.law() for each in gains]
    used = [np.array([1.0, 0.0 if each.position_gain else 1.0, 1.0]) for each in gains]
    without = [
        replace(law, B=law.B * columns, D=law.D * columns)
        for law, columns in zip(laws, used, strict=True)
    ]
    reference = np.zeros((round(_SECONDS / period), len(gains)))
    reference[0] = simulated.model.motor_accelerations(change[None])[0] / period
    held = np.broadcast_to(plan.voltage[0], reference.shape)
    return simulated.drive(without, plan, reference, held)


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
