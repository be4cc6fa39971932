"""LinkSignals -> spectra of motor torques, velocities and directions, piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, LinkSignals
from strainwave.numerics.spectra import window_spectra

LONGEST_PIECE = 4.1
"""[s] of a record in one spectrum: its lines lie denser than the anti-resonance is wide."""

_MOST_PIECES = 8  # of a record
_LOWEST = 3.0  # lines that the window makes of a constant, and of what is slower than a piece
_SHARE = 0.2  # of the sampling frequency, up to which differences are velocities
_SLIDES = 0.5  # share of a piece in which a motor must slide for its friction to be known


@dataclass(frozen=True, slots=True)
class Piece:
    """Spectra of a stretch of one record, behind a Hann window."""

    experiment: str
    s: ComplexArray  # (n_lines,) [rad/s]
    torque: ComplexArray  # (n_lines, n_joints) [N m] of the motors
    direction: ComplexArray  # (n_lines, n_joints) of sgn(velocity), which Coulomb friction follows
    velocity: ComplexArray  # (n_lines, n_joints) [rad/s] of the motors
    link_angle: FloatArray  # (n_joints,) [rad] mean posture
    rows: tuple[int, ...]  # joints, from 0, that the stretch shows


def pieces(signals: LinkSignals, ratio: FloatArray, *, most_lines: int) -> Iterator[Piece]:
    """Spectra of one record, in pieces of a few seconds.

    `ratio` (n_joints,): Gear ratios.
    `most_lines`: Of a piece; of more those with most torque are taken, band by band on a
        logarithmic scale.

    Yields: Of the joint that the experiment names, or of all where it names none.
    """
    T, n = signals.sample_time, len(signals.time)
    length = min(n, round(LONGEST_PIECE / T))
    count = min(_MOST_PIECES, max(1, n // length))
    named = signals.experiment.joint
    excited = range(len(ratio)) if named is None else (named - 1,)
    frequency = np.fft.rfftfreq(length, T)
    highest = min(_SHARE / T, signals.bandwidth_hz or np.inf)
    inside = np.flatnonzero((frequency >= _LOWEST * frequency[1]) & (frequency <= highest))
    for first in np.linspace(0, n - length, count).astype(int):
        at = slice(first, first + length)
        slides = np.mean(np.abs(signals.direction[at]) > 0.5, axis=0)
        torque, direction, velocity = (
            _lines(x[at])[inside]
            for x in (signals.motor_torque, signals.direction, signals.motor_velocity)
        )
        whole = Piece(
            signals.experiment.name,
            np.asarray(2j * np.pi * frequency[inside]),
            torque,
            direction,
            velocity,
            (ratio * signals.motor_angle[at]).mean(axis=0),
            tuple(i for i in excited if slides[i] >= _SLIDES),
        )
        yield thinned(whole, most_lines)


def thinned(piece: Piece, most_lines: int) -> Piece:
    """A piece with fewer lines: of each of so many bands the line with most torque."""
    size, n = np.abs(piece.torque[:, list(piece.rows)]).sum(axis=1), len(piece.s)
    edges = np.geomspace(piece.s[0].imag, 1.001 * piece.s[-1].imag, most_lines + 1)
    band = np.searchsorted(edges, piece.s.imag, side="right")
    order = np.lexsort((-size, band))
    first = np.unique(band[order], return_index=True)[1]
    chosen = np.sort(order[first]) if n > most_lines else np.arange(n)
    return replace(
        piece,
        s=piece.s[chosen],
        torque=piece.torque[chosen],
        direction=piece.direction[chosen],
        velocity=piece.velocity[chosen],
    )


def _lines(columns: FloatArray) -> ComplexArray:
    (lines,) = window_spectra(columns, np.hanning(len(columns)), len(columns))
    return np.asarray(lines)
