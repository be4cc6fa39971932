"""Frozen stretches: a reading that repeats itself while the arm moves.

Motors stand still, encoders resolve so much, drives hold a voltage or rest at their limit: none
of these is a fault. An encoder is frozen where it stops within a sample while it turns, and where
what it missed comes at once. A noisy sensor is frozen where it repeats itself far more often
than chance makes it, and the joint's motor turns meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from strainwave.domain import FloatArray, IntArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import (
    ENCODERS,
    NOISY,
    Defect,
    count_of,
    joint_of,
    of_kinds,
    resolution_of,
    usual,
)
from strainwave.signals.hygiene.isolated import Jump, spikes_and_steps
from strainwave.signals.standstill import runs_of

_FEWEST = 3  # equal increments of nothing before what was missed comes at once
_MISSED = 0.5  # of that, which the velocities on either side must explain
_STANDS = 0.25  # of the time before the jump, for which a motor that stands does so behind it
_FASTER = 4.0  # times its speed nearby, at which a motor may have gone on unseen
_ASIDE = 16  # increments that this speed is of
_LONGER = 2.5  # times as long as an angle rests nearby
_AROUND = 60  # increments that are nearby
_SIDE = 4  # increments on either side that a velocity is of
_ABRUPT = 4.0  # times the usual change of an increment: no motor stops so
_SHORTEST = 8  # repeated readings of a noisy sensor
_CHANCE = 1e-4  # of one run by chance in a record
_BLOCK = 128  # samples, whose share of repetitions counts
_OFTEN = 0.95  # share of blocks that repeat themselves less
_COARSE = 0.9  # share of repetitions from which a channel says nothing of that
_OUTLYING = 6.0  # times the length of nearly all runs: not by chance
_AT_END = 1e-3  # of its range, by which a reading may differ from its ends
_LEAVES = 4.0  # steps of its resolution, by which a frozen reading differs from those about it
_TURNS = 6.0  # counts by which a motor must turn meanwhile


def detect(log: Log, arm: Arm) -> list[Defect]:
    """Frozen stretches of encoders, noisy sensors and the servos' voltages."""
    found = []
    for name, x in of_kinds(log, ENCODERS).items():
        found += [_defect(log, name, *span) for span in _frozen_encoder(x, count_of(name, arm))]
    for name, x in of_kinds(log, (*NOISY, "u")).items():
        joint, drives = joint_of(name), name.startswith("u")
        if joint > arm.n_joints or (drives and log.experiment.control[joint - 1] != "servo"):
            continue
        # a link moves with every joint before it
        motors = [f"theta_m{i}" for i in range(joint if drives else 1, joint + 1)]
        spans = [
            span
            for span in _repeated(x, drives=drives)
            if any(_turns(log.channels[motor], *span, count_of(motor, arm)) for motor in motors)
        ]
        found += [_defect(log, name, *span) for span in spans]
    return found


def _turns(angle: FloatArray, start: int, stop: int, count: float) -> bool:
    """Whether a motor turns meanwhile, by more than its encoder makes of standing."""
    own = angle[start - 1 : stop]
    far = np.ptp(own) > _TURNS * (count or resolution_of(angle))
    return bool(far and np.count_nonzero(np.diff(own)) > _TURNS)  # a step of its own is no motion


def ends_a_freeze(x: FloatArray, jump: Jump, still: IntArray) -> bool:
    """Whether a step of an encoder is the motion that it missed while it was frozen.

    Parameters
    ----------
    x : (n_samples,)
    jump : Jump
    still : (n_runs, 2)
        Runs of increments that are zero.

    Returns
    -------
    bool
    """
    return _before(x, jump, still) is not None


def _before(x: FloatArray, jump: Jump, still: IntArray) -> tuple[int, int] | None:
    """The stretch that ends with a jump, if it is a frozen one.

    It is where the velocities on either side explain the jump, or where the motor, which stood for
    so long, does not stand behind it any more.
    """
    end = jump.sample - 1  # the increment that is the jump
    k = int(np.searchsorted(still[:, 1], end))
    if k == len(still) or still[k, 1] != end or end - still[k, 0] < _FEWEST:
        return None
    start = int(still[k, 0])
    missed = 0.5 * (_velocity(x, start, before=True) + _velocity(x, end + 1)) * (end + 1 - start)
    step = x[end + 1] - x[end]
    after = int(still[k + 1, 1] - end - 1) if _follows(still, k, end) else 0
    explained = abs(missed - step) < _MISSED * abs(step)
    moves_on = after < _STANDS * (end - start) + 2
    could = abs(step) < _FASTER * _speed_about(x, start, end) * (end + 1 - start)
    unlike = end - start > _FEWEST and end - start > _LONGER * _usual_rest(x, start, end)
    return (start + 1, end + 1) if explained or (moves_on and could and unlike) else None


def _speed_about(x: FloatArray, start: int, end: int) -> float:
    """The larger mean speed, per sample, on either side of a stretch and its jump."""
    before, after = x[max(0, start - _ASIDE) : start + 1], x[end + 1 : end + 2 + _ASIDE]
    return float(max(np.ptp(before), np.ptp(after))) / _ASIDE


def _usual_rest(x: FloatArray, start: int, end: int) -> int:
    """The longest run of increments of nothing on either side of a stretch of it."""
    sides = [x[max(0, start - _AROUND) : start + 1], x[end + 1 + _SIDE : end + 1 + _AROUND]]
    runs = [runs_of(np.diff(side) == 0.0) for side in sides if len(side) > 1]
    return max((int(np.max(r[:, 1] - r[:, 0], initial=0)) for r in runs), default=0)


def _follows(still: IntArray, k: int, end: int) -> bool:
    """Whether the next stretch of nothing begins right behind a jump."""
    return k + 1 < len(still) and int(still[k + 1, 0]) == end + 1


def _velocity(x: FloatArray, k: int, *, before: bool = False) -> float:
    """Mean increment on one side of a sample."""
    other = max(0, k - _SIDE) if before else min(len(x) - 1, k + _SIDE)
    return float((x[k] - x[other]) / (k - other)) if k != other else 0.0


def _frozen_encoder(x: FloatArray, count: float) -> Iterator[tuple[int, int]]:
    increment = np.diff(x)
    still = runs_of(increment == 0.0)
    if not len(still):
        return
    _, alone = spikes_and_steps(x, count)
    spans = [_before(x, jump, still) for jump in alone]
    known = {span for span in spans if span is not None}
    abrupt = _ABRUPT * max(usual(np.abs(np.diff(increment))), count or resolution_of(x))
    longer = still[still[:, 1] - still[:, 0] > _FEWEST]
    inside = longer[(longer[:, 0] > 0) & (longer[:, 1] < len(increment))]
    ends = np.minimum(np.abs(increment[inside[:, 0] - 1]), np.abs(increment[inside[:, 1]]))
    for start, end in inside[ends > abrupt].tolist():
        if min(abs(_velocity(x, start, before=True)), abs(_velocity(x, end + 1))) > abrupt:
            known.add((start + 1, end + 1))
    yield from sorted(known)


def _repeated(x: FloatArray, *, drives: bool) -> Iterator[tuple[int, int]]:
    """Runs of one reading that are no chance, and that it leaves for another one at once.

    At either end of its range it is no fault of this kind, nor, of a voltage, at zero.
    """
    same = np.diff(x) == 0.0
    still = runs_of(same)
    if not len(still):
        return
    length = still[:, 1] - still[:, 0]
    typical = float(np.quantile(length, _OFTEN))
    by_chance = same.copy()
    for start, stop in still[length > max(_SHORTEST, _OUTLYING * typical)].tolist():
        by_chance[start:stop] = False
    blocks = by_chance[: len(same) // _BLOCK * _BLOCK].reshape(-1, _BLOCK).mean(axis=1)
    share = max(float(np.quantile(blocks, _OFTEN)) if len(blocks) else 1.0, 1e-3)
    if share > _COARSE:
        return
    least = max(_SHORTEST, int(np.log(_CHANCE / len(x)) / np.log(share)), 3 * int(typical))
    low, high = x.min(), x.max()
    limit, step = _AT_END * (high - low), _LEAVES * resolution_of(x)
    for start, stop in still[length >= least].tolist():
        value = x[start]
        at_end = min(value - low, high - value) < limit
        around = np.r_[x[max(0, start - _SIDE) : start], x[stop + 1 : stop + 1 + _SIDE]]
        leaves = np.max(np.abs(around - value), initial=0.0) > step
        if leaves and not at_end and not (drives and value == 0.0):
            yield start + 1, stop + 1


def _defect(log: Log, name: str, start: int, stop: int) -> Defect:
    seconds = (stop - start) * log.sample_time
    return Defect("frozen", name, start, stop, seconds, "repeats one value while the arm moves")
