"""Sampled control laws of joints: gains, filters and observer as one linear system each.

From a reading of the motor angle y_k [rad] to the voltage u_k [V]:

    v_k = C x_k + D (r_k, w_k, y_k),   u_k = v_k + feed-forward_k, limited
    x_k+1 = A x_k + B (r_k, w_k, y_k) + E (u_k - feed-forward_k)

w_k [rad/s] is the velocity of the reference, r_k = y_0 + T (w_0 + ... + w_k-1) [rad] its angle,
and T the period. E multiplies the voltage that reaches the motor without the feed-forward, which is
v_k if the voltage is not limited: an observer with this input models the deviation from the motion
that the feed-forward drives. States that hold, such as integrators, keep their value while the
voltage is limited.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain.keys import BoolArray, ComplexArray, FloatArray
from strainwave.errors import InvalidInput

INPUTS = ("reference_angle", "reference_velocity", "motor_angle")
"""Inputs of a law."""

MAX_LAW_STATES = 16  # of the core
_RANK_TOLERANCE = 1e-12  # of singular values; the slowest filter or observer is far above


@dataclass(frozen=True, slots=True, eq=False)
class ControlLaw:
    """Law of one joint."""

    A: FloatArray  # (n, n)
    B: FloatArray  # (n, 3)
    C: FloatArray  # (n,)
    D: FloatArray  # (3,)
    E: FloatArray  # (n,)
    holds: BoolArray  # (n,) states that keep their value while the voltage is limited
    names: tuple[str, ...] = ()

    def feedback(self, z: ComplexArray) -> ComplexArray:
        """Response from the motor angle to minus the voltage."""
        closed = self.A + np.outer(self.E, self.C)
        inputs = self.B[:, 2] + self.E * self.D[2]
        states = np.linalg.solve(
            z[:, None, None] * np.eye(len(closed)) - closed,
            np.broadcast_to(inputs[:, None], (len(z), len(inputs), 1)),
        )[..., 0]
        return np.asarray(-(states @ self.C + self.D[2]))

    def rest(self) -> FloatArray:
        """States at rest per motor angle and per voltage, (n, 2): x = rest @ (angle, voltage).

        The reference is the motor angle, and the states are constant:

            (A - I) x = -(B (angle, 0, angle) + E voltage)

        Where this leaves states undetermined, as that of an integrator, the output is the voltage:
        C x + D (angle, 0, angle) = voltage. Both equations are solved by least squares with the
        smallest x. A law without an integrator cannot hold a voltage; its states are at rest.
        """
        n = len(self.A)
        steady = np.column_stack([self.B[:, 0] + self.B[:, 2], self.E])
        left, sizes, right = np.linalg.svd(self.A - np.eye(n))
        rank = int(np.sum(sizes > _RANK_TOLERANCE * sizes.max(initial=0.0)))
        x = -right[:rank].T @ ((left.T @ steady)[:rank] / sizes[:rank, None])
        free = right[rank:].T
        by_free = self.C @ free
        power = by_free @ by_free
        if power > (_RANK_TOLERANCE**2) * (self.C @ self.C):
            missing = np.array([-self.D[0] - self.D[2], 1.0]) - self.C @ x
            x = x + np.outer(free @ by_free / power, missing)
        return np.asarray(x)


@dataclass(frozen=True, slots=True, eq=False)
class LinearServo:
    """Control laws of all joints.

    Raises InvalidInput if a law has more than MAX_LAW_STATES states.
    """

    laws: tuple[ControlLaw, ...]  # one per joint
    period: float  # [s]
    limit: float  # [V]

    def __post_init__(self) -> None:
        sizes = [len(law.A) for law in self.laws]
        if max(sizes, default=0) > MAX_LAW_STATES:
            raise InvalidInput(
                f"a control law has {max(sizes)} states, but at most {MAX_LAW_STATES} are possible",
                remedy="reduce the number of filters",
            )
