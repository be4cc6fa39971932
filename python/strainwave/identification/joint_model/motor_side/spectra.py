"""Spectra of motor torques, velocities and directions of motion, for pieces of a record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, LinkSignals
from strainwave.dynamics.arm import Arm
from strainwave.numerics.spectra import window_spectra

MAX_PIECE_SECONDS = 4.1
"""Maximum duration [s] of a piece: line spacing is below the width of the anti-resonance."""

_MAX_PIECES = 8  # maximum number of pieces of a record
_FIRST_LINE = 3.0  # first line; the window spreads a constant and slow drift over the lines below
_MAX_RATE_SHARE = 0.2  # share of the sampling rate up to which differences approximate velocities
# minimum share of a piece in which a motor slides, so that its friction is known
_MIN_SLIDING_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class Piece:
    """Spectra of one piece of a record, with a Hann window."""

    experiment: str
    s: ComplexArray  # (n_lines,) [rad/s]
    torque: ComplexArray  # (n_lines, n_joints) [N m] of the motors
    direction: ComplexArray  # (n_lines, n_joints) of sgn(velocity), for Coulomb friction
    velocity: ComplexArray  # (n_lines, n_joints) [rad/s] of the motors
    link_angle: FloatArray  # (n_joints,) [rad] mean posture
    rows: tuple[int, ...]  # joints, from 0, that are driven and slide


def pieces(signals: LinkSignals, arm: Arm, *, max_lines: int) -> Iterator[Piece]:
    """Yield spectra of one record, in pieces of a few seconds.

    A piece has at most `max_lines` lines: the line with the largest torque of each band on a
    logarithmic scale. If the experiment names a joint, only that joint is driven; otherwise all
    joints are.
    """
    T, n = signals.sample_time, len(signals.time)
    length = min(n, round(MAX_PIECE_SECONDS / T))
    count = min(_MAX_PIECES, max(1, n // length))
    named_joint = signals.experiment.joint
    excited = range(arm.n_joints) if named_joint is None else (named_joint - 1,)
    frequency = np.fft.rfftfreq(length, T)
    highest = min(_MAX_RATE_SHARE / T, signals.bandwidth_hz or np.inf)
    inside = np.flatnonzero((frequency >= _FIRST_LINE * frequency[1]) & (frequency <= highest))
    for start in np.linspace(0, n - length, count).astype(int):
        chunk = slice(start, start + length)
        sliding_share = np.mean(np.abs(signals.direction[chunk]) > 0.5, axis=0)
        torque, direction, velocity = (
            window_spectra(x[chunk], np.hanning(length), length)[0][inside]
            for x in (signals.motor_torque, signals.direction, signals.motor_velocity)
        )
        piece = Piece(
            signals.experiment.name,
            np.asarray(2j * np.pi * frequency[inside]),
            torque,
            direction,
            velocity,
            arm.links_of(signals.motor_angle[chunk]).mean(axis=0),
            tuple(i for i in excited if sliding_share[i] >= _MIN_SLIDING_SHARE),
        )
        yield thin_lines(piece, max_lines)


def thin_lines(piece: Piece, max_lines: int) -> Piece:
    """Reduce a piece to `max_lines` bands, with the line of largest torque in each."""
    torque_sum, n = np.abs(piece.torque[:, list(piece.rows)]).sum(axis=1), len(piece.s)
    edges = np.geomspace(piece.s[0].imag, 1.001 * piece.s[-1].imag, max_lines + 1)
    band = np.searchsorted(edges, piece.s.imag, side="right")
    order = np.lexsort((-torque_sum, band))
    first_of_band = np.unique(band[order], return_index=True)[1]
    chosen = np.sort(order[first_of_band]) if n > max_lines else np.arange(n)
    return replace(
        piece,
        s=piece.s[chosen],
        torque=piece.torque[chosen],
        direction=piece.direction[chosen],
        velocity=piece.velocity[chosen],
    )
