"""Smooth motions of links, with the derivatives that elastic joints need.

Motion of a payload on the last link of any arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PPoly, make_interp_spline

from strainwave.domain import FloatArray, Payload
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput

_SPLINE_DEGREE = 7  # lowest odd degree with a smooth fourth derivative
_REST_TO_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 126.0, -420.0, 540.0, -315.0, 70.0)
"""Coefficients by rising power of 126 x^5 - 420 x^6 + 540 x^7 - 315 x^8 + 70 x^9.

It rises from 0 to 1 with four derivatives of zero at both ends.
"""


@dataclass(frozen=True, slots=True, eq=False)
class LinkMotion:
    """A motion of all links with four continuous derivatives."""

    time: FloatArray  # (n_samples,) [s] ticks of the servo, evenly spaced
    of: Callable[[FloatArray, int], FloatArray]
    """Link angles or their k-th derivative at times: (n_times, n_joints)."""

    @property
    def period(self) -> float:
        """Time [s] between two ticks."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    @classmethod
    def through(cls, angle: FloatArray, period: float) -> LinkMotion:
        """The spline of degree seven through link angles (n_samples, n_joints).

        Raises InvalidInput if the samples are too few or not finite.
        """
        if angle.ndim != 2 or len(angle) <= _SPLINE_DEGREE:
            raise InvalidInput(
                f"the motion has the shape {angle.shape}, expected (n_samples, n_joints)"
                f" with at least {_SPLINE_DEGREE + 1} samples",
                remedy="give the link angles at every servo period",
            )
        if not np.isfinite(angle).all():
            sample, joint = np.argwhere(~np.isfinite(angle))[0]
            raise InvalidInput(
                f"the angle of joint {joint + 1} is not finite at {sample * period:g} s",
                remedy="correct the motion",
            )
        time: FloatArray = period * np.arange(len(angle), dtype=np.float64)
        return cls(time, make_interp_spline(time, angle, k=_SPLINE_DEGREE))

    def derivatives(self, time: FloatArray) -> FloatArray:
        """Angles and their first four derivatives: (5, n_times, n_joints).

        Beyond its ends the motion stays at its end values.
        """
        inside = np.clip(time, self.time[0], self.time[-1])
        return np.stack([self.of(inside, order) for order in range(5)])


def point_to_point(
    begin: FloatArray, end: FloatArray, duration: float, period: float
) -> LinkMotion:
    """Motion between two postures (n_joints,) at rest: a polynomial of degree nine.

    The velocity is at most 2.46 times the mean velocity. The duration [s] is rounded to whole
    periods. Raises InvalidInput if it is shorter than one period.
    """
    n_periods = round(duration / period)
    if n_periods < 1:
        raise InvalidInput(
            f"a motion of {duration:g} s is shorter than the servo period of {period:g} s",
            remedy="give a longer duration",
        )
    time: FloatArray = period * np.arange(n_periods + 1, dtype=np.float64)
    powers = np.array(_REST_TO_REST) / time[-1] ** np.arange(len(_REST_TO_REST))
    coefficients = powers[::-1, None, None] * (np.asarray(end) - begin)
    coefficients[-1] += begin
    return LinkMotion(time, PPoly(coefficients, time[[0, -1]]))


def payload_motion(
    model: Arm,
    payload: Payload,
    angle: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Jacobian (n, 3, n_joints) of a payload's position and its specific force (n, 3).

    Both in the frame of the last link; the motion has the shape (n, n_joints).
    """
    at = np.array(payload.xyz)

    def force(velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        motion = model.link_motion(angle, velocity, acceleration)[:, -1]
        rate, turning, origin = motion[:, :3], motion[:, 3:6], motion[:, 6:]
        return np.asarray(origin + np.cross(turning, at) + np.cross(rate, np.cross(rate, at)))

    rest = np.zeros_like(angle)
    load = force(rest, rest)
    units = (rest + unit for unit in np.eye(model.n_joints))
    jacobian = np.stack([force(rest, unit) - load for unit in units], axis=2)
    return jacobian, force(velocity, acceleration)


def payload_torques(
    model: Arm,
    payload: Payload,
    angle: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> FloatArray:
    """Torques of the links that move a payload: (n, n_joints)."""
    jacobian, force = payload_motion(model, payload, angle, velocity, acceleration)
    return np.asarray(payload.mass * np.einsum("pxj,px->pj", jacobian, force))
