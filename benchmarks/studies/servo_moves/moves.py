"""Moves of single joints, and the tracking of a motion of all joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.studies.servo_moves.tuned import Tuned, drive_under
from strainwave.domain import FloatArray
from strainwave.dynamics.simulation import Drive
from strainwave.tune.feed_forward import FeedForward, feed_forward, point_to_point
from strainwave.tune.shapers import Impulses
from strainwave.tune.verification import shortest_plan

_SIZES = (0.01, 0.05)  # [rad] of moves
_SECONDS, _SETTLED = 1.2, 0.02
_TRACKED, _TRACKED_SECONDS = (0.6, -0.8), 0.8  # [rad] and [s] of the longer motion


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Motion of one link."""

    joint: int  # from 1
    size: float  # [rad]
    reference: str
    time: FloatArray  # (n_samples,) [s]
    share: FloatArray  # (n_samples,) link angle over the size

    def cells(self) -> tuple[str, ...]:
        """Settling, overshoot and vibration as text."""
        is_apart = np.abs(self.share - 1.0) > _SETTLED
        last = len(is_apart) - int(np.argmax(is_apart[::-1])) if is_apart.any() else 0
        settling = "does not settle" if is_apart[-1] else f"{last * self.time[1]:.3f}"
        overshoot = 100.0 * max(0.0, float(self.share.max()) - 1.0)
        # swing of the link in the last half, in which every reference rests
        vibration = 50.0 * float(np.ptp(self.share[len(self.share) // 2 :]))
        return settling, f"{overshoot:.2g}", f"{vibration:.2g}"


def moves(tuned: Tuned) -> list[Move]:
    """Moves of all joints under all references."""
    found, design = [], tuned.design
    posture = design.conditions[0].posture
    for joint in range(1, tuned.arm.n_joints + 1):
        for size in _SIZES:
            end = posture.copy()
            end[joint - 1] += size
            plan = shortest_plan(design.arm, posture, end, design.clock.period, design.limits)
            for name, drive in _drives(tuned, joint, end - posture, plan):
                link, _ = tuned.run(drive, len(drive.reference))
                share = (link[:, joint - 1] - link[0, joint - 1]) / size
                time: FloatArray = drive.tick * np.arange(len(share), dtype=np.float64)
                found.append(Move(joint, size, name, time, share))
    return found


def _drives(
    tuned: Tuned, joint: int, change: FloatArray, plan: FeedForward
) -> Iterator[tuple[str, Drive]]:
    """The references of a move, by name."""
    design = tuned.design
    period, n = design.clock.period, round(_SECONDS / design.clock.period)
    gains = [each.law() for each in design.gains]
    step = np.zeros((n, tuned.arm.n_joints))
    step[0] = tuned.arm.motor_accelerations(change[None])[0] / period
    currents = [each.current for each in design.joints]
    if all(currents):
        laws = [each.law() for each in currents if each is not None]
        yield "step, current servo", drive_under(design, laws, step, plan, by_angle=False)
    yield "step", drive_under(design, gains, step, plan)
    damping = next(one for one in design.dampings if one.joint == joint)
    if not damping.reason:
        laws = [one.law for one in design.dampings]
        yield "step, torsion feedback", drive_under(design, laws, step, plan)
    if design.shapers:
        impulses = design.shapers[0].impulses
        yield (
            "shaped step",
            drive_under(design, gains, shaped_reference(step, impulses, period), plan),
        )
    held = plan.extended(n)
    reference = held.servo_reference(np.array([each.position_gain for each in design.gains]))
    yield "planned", drive_under(design, gains, reference, plan, held.voltage)


def shaped_reference(reference: FloatArray, impulses: Impulses, period: float) -> FloatArray:
    """Sum of delayed shares of a reference."""
    shaped = np.zeros_like(reference)
    for share, at in zip(impulses.amplitudes, impulses.times, strict=True):
        late = round(at / period)
        shaped[late:] += share * reference[: len(reference) - late]
    return shaped


def tracking(tuned: Tuned) -> str:
    """Largest distance of the links from a motion of all joints."""
    design = tuned.design
    posture = design.conditions[0].posture
    end = posture + np.resize(_TRACKED, len(posture))
    plan = feed_forward(
        design.arm, point_to_point(posture, end, _TRACKED_SECONDS, design.clock.period)
    )
    gains = [each.law() for each in design.gains]
    position = np.array([each.position_gain for each in design.gains])
    errors = []
    for voltage in (np.tile(plan.voltage[0], (len(plan.time), 1)), plan.voltage):
        drive = drive_under(design, gains, plan.servo_reference(position), plan, voltage)
        link, _ = tuned.run(drive, len(plan.time))
        errors.append(1e3 * float(np.abs(link - plan.link_angle).max()))
    return (
        f"{tuned.name}: largest tracking error of a motion of {_TRACKED_SECONDS:g} s: "
        f"{errors[0]:.2f} mrad without feed-forward, {errors[1]:.2f} mrad with it"
    )
