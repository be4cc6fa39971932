"""What may be wrong with a channel for a while: its kind, where, and by how much."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from strainwave.domain import FloatArray, Log
from strainwave.dynamics.arm import Arm

Kind = Literal["spikes", "frozen", "encoder-steps", "flat-tops", "mains-hum"]
"""Codes of warnings, see docs/troubleshooting.md."""

ENCODERS = ("theta_m", "theta_l", "deflection")
NOISY = ("a", "gyro", "ax", "ay", "az", "gx", "gy", "gz")
"""Sensors whose noise, or motion, changes their reading from sample to sample."""

INPUTS = ("u", "torque")

_MOST_SAMPLES = 65_536  # of a channel that show how it usually changes
_USUAL = 0.995  # share of the changes below what is usual


@dataclass(frozen=True, slots=True)
class Defect:
    """One stretch of one channel that is no measurement."""

    kind: Kind
    channel: str
    start: int  # first sample
    stop: int  # behind the last one
    size: float  # in the channel's unit; of a frozen stretch [s]
    words: str  # what is seen, without place and time: "a spike"
    wraps: bool = False  # whether the step is a counter's whole range


Detector = Callable[[Log, Arm], list[Defect]]
"""One kind of defect: all of its kind in one record, by channel, then in order of time."""


def of_kinds(log: Log, kinds: tuple[str, ...]) -> Mapping[str, FloatArray]:
    """Channels of some kinds that change at all.

    Parameters
    ----------
    log : Log
    kinds : tuple of str
        Names without the joint's number.

    Returns
    -------
    dict
        Name -> (n_samples,).
    """
    return {
        name: x for name, x in log.channels.items() if kind_of(name) in kinds and x.min() < x.max()
    }


def kind_of(channel: str) -> str:
    """A channel's name without its joint: "theta_m" of "theta_m2"."""
    return channel.rstrip("0123456789")


def joint_of(channel: str) -> int:
    """The joint that a channel's name ends with, from 1."""
    return int(channel[len(kind_of(channel)) :])


def count_of(channel: str, arm: Arm) -> float:
    """One count of a motor's encoder [rad]; zero of another channel, or where it is not known."""
    if kind_of(channel) != "theta_m" or joint_of(channel) > arm.n_joints:
        return 0.0
    per_turn = arm.joints[joint_of(channel) - 1].encoder_counts
    return 2.0 * np.pi / per_turn if per_turn else 0.0


def usual(change: FloatArray) -> float:
    """What nearly all changes of a channel stay below.

    Parameters
    ----------
    change : (n,)
        Not negative.

    Returns
    -------
    float
    """
    every = change[:: max(1, len(change) // _MOST_SAMPLES)]
    if not len(every):
        return 0.0
    k = min(len(every) - 1, int(_USUAL * len(every)))
    return float(np.partition(every, k)[k])


def resolution_of(signal: FloatArray) -> float:
    """About the smallest step that a channel makes: one count, or next to nothing.

    Parameters
    ----------
    signal : (n_samples,)

    Returns
    -------
    float
    """
    step = np.abs(np.diff(signal[:_MOST_SAMPLES]))
    step = step[step > 0.0]
    if not len(step):
        return 0.0
    k = len(step) // 100
    return float(np.partition(step, k)[k])
