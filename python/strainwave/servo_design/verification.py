"""Moves of single joints on the identified arm: a step under the loops alone, and a planned move.

The plant has drawn parameters, friction, the whole curve of the gear, and encoders with counts; the
servo knows the estimates only. The planned move has the shortest duration that the voltage limit
allows, with the elastic arm's feed-forward.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.control_law import LinearServo
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
    step: Move
    planned: Move
    time: FloatArray  # (n_samples,) [s]
    step_link: FloatArray  # (n_draws, n_samples) over the move
    planned_link: FloatArray


def compare_moves(
    arm: IdentifiedArm,
    gains: Sequence[Gains],
    draws: Sequence[Values],
    joint: int,
    posture: FloatArray,
    limit: float,
    move: float = MOVE,
) -> Comparison:
    """Simulate both moves of a joint, from 1, from a posture [rad], for all draws.

    Raises `InvalidInput` if no duration up to a second stays within the voltage limit.
    """
    period = gains[0].period
    model = Arm.of(arm.study.arm)
    samples = round(_SECONDS / period)
    end = posture.copy()
    end[joint - 1] += move
    plan = _shortest(arm, posture, end, period, limit)
    laws = tuple(each.law() for each in gains)
    loops = LinearServo(laws, period, limit)
    # the step enters through the reference angle alone
    without = tuple(
        replace(law, B=law.B * [1.0, 0.0, 1.0], D=law.D * [1.0, 0.0, 1.0]) for law in laws
    )
    steps = LinearServo(without, period, limit)
    reference = np.zeros((samples, model.n_joints))
    reference[0] = model.motor_accelerations((end - posture)[None])[0] / period
    held = np.broadcast_to(plan.voltage[0], reference.shape)
    step_link, planned_link, volts = [], [], ([], [])  # type: ignore[var-annotated]
    padded = _padded(plan, samples)
    for values in draws:
        start = _start(plan)
        for servo, moved, added, links, peaks in (
            (steps, reference, held, step_link, volts[0]),
            (loops, padded[0], padded[1], planned_link, volts[1]),
        ):
            drive = Drive(
                tick=period,
                voltage=np.ascontiguousarray(added),
                reference=np.ascontiguousarray(moved),
                servo=(True,) * model.n_joints,
                linear_servo=servo,
                **start,
            )
            run = simulate(
                model,
                values,
                drive,
                sample_time=period,
                samples=samples,
                record=["link_angle", "voltage"],
            )
            angle = run["link_angle"][:, joint - 1]
            links.append((angle - angle[0]) / move)
            peaks.append(float(np.abs(run["voltage"][:, joint - 1]).max()))
    time = period * np.arange(samples)
    stacked = np.array(step_link), np.array(planned_link)
    return Comparison(
        joint=joint,
        posture=posture,
        duration=float(plan.time[-1]),
        step=_move(stacked[0], time, max(volts[0])),
        planned=_move(stacked[1], time, max(volts[1])),
        time=time,
        step_link=stacked[0],
        planned_link=stacked[1],
    )


def _shortest(
    arm: IdentifiedArm, begin: FloatArray, end: FloatArray, period: float, limit: float
) -> FeedForward:
    """The shortest planned move within the voltage limit."""
    duration = _SHORTEST
    while duration <= _LONGEST:
        motion = point_to_point(begin, end, duration, period)
        try:
            plan = feed_forward(arm, motion)
        except InvalidInput:
            if duration * _DURATION_STEP > _LONGEST:
                raise
        else:
            if np.abs(plan.voltage).max() <= _VOLTAGE_SHARE * limit:
                return plan
        duration *= _DURATION_STEP
    raise InvalidInput(
        f"a move of {float(np.abs(end - begin).max()):g} rad takes more than {_LONGEST:g} s",
        remedy="choose a smaller move",
    )


def _start(plan: FeedForward) -> Mapping[str, tuple[float, ...]]:
    """Initial state at rest."""
    return {
        "motor_angle": tuple(plan.motor_angle[0].tolist()),
        "initial_voltage": tuple(plan.voltage[0].tolist()),
    }


def _padded(plan: FeedForward, samples: int) -> tuple[FloatArray, FloatArray]:
    """Velocity references and voltages; at the end the arm is held."""
    reference = np.zeros((samples, plan.voltage.shape[1]))
    voltage = np.tile(plan.voltage[-1], (samples, 1))
    n = min(samples, len(plan.time))
    reference[:n], voltage[:n] = plan.reference_velocity[:n], plan.voltage[:n]
    return reference, voltage


def _move(links: FloatArray, time: FloatArray, peak: float) -> Move:
    """The worst behaviour of all draws."""
    if not np.isfinite(links).all():
        raise NumericalFailure("the simulated move diverges")
    is_apart = np.abs(links - 1.0) > _SETTLED
    last = links.shape[1] - np.argmax(is_apart[:, ::-1], axis=1)
    settling = np.where(is_apart[:, -1], np.inf, last * (time[1] - time[0]))
    tail = links[:, 2 * links.shape[1] // 3 :]
    return Move(
        float(settling.max()),
        float(max(0.0, links.max() - 1.0)),
        float(0.5 * np.ptp(tail, axis=1).max()),
        peak,
    )
