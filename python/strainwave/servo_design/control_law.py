"""Gains and filters of a joint's servo, and their control law."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import ComplexArray, ControlLaw


@dataclass(frozen=True, slots=True)
class Biquad:
    """Second-order filter (b0 + b1 z^-1 + b2 z^-2) / (1 + a1 z^-1 + a2 z^-2)."""

    b: tuple[float, float, float]
    a: tuple[float, float]
    kind: str  # "notch" or "low-pass"
    hz: float
    width: float = 0.0  # damping ratio of the poles
    depth: float = 0.0  # gain at the centre

    def response(self, z: ComplexArray) -> ComplexArray:
        """Response at points of the unit circle."""
        w = 1.0 / z
        numerator = self.b[0] + self.b[1] * w + self.b[2] * w**2
        return np.asarray(numerator / (1.0 + self.a[0] * w + self.a[1] * w**2))


def notch(hz: float, width: float, depth: float, period: float) -> Biquad:
    """Notch (s^2 + 2 depth width w s + w^2) / (s^2 + 2 width w s + w^2), sampled.

    The bilinear transformation is warped so that the centre is exact.
    """
    c = 1.0 / math.tan(math.pi * hz * period)
    low, high = 2.0 * width * c, 2.0 * depth * width * c
    scale = c * c + low + 1.0
    b = ((c * c + high + 1.0) / scale, 2.0 * (1.0 - c * c) / scale, (c * c - high + 1.0) / scale)
    a = (2.0 * (1.0 - c * c) / scale, (c * c - low + 1.0) / scale)
    return Biquad(b, a, "notch", hz, width, depth)


def low_pass(hz: float, period: float) -> Biquad:
    """Second-order Butterworth low-pass, sampled by the warped bilinear transformation."""
    c = 1.0 / math.tan(math.pi * hz * period)
    scale = c * c + math.sqrt(2.0) * c + 1.0
    b = (1.0 / scale, 2.0 / scale, 1.0 / scale)
    a = (2.0 * (1.0 - c * c) / scale, (c * c - math.sqrt(2.0) * c + 1.0) / scale)
    return Biquad(b, a, "low-pass", hz)


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of a cascade: PI velocity loop, and a position loop around it."""

    kp: float  # [V s/rad]
    ki: float  # [V/rad]
    position_gain: float  # [1/s]
    period: float  # [s]
    filters: tuple[Biquad, ...] = ()

    def slowed(self, share: float) -> Gains:
        """Gains of a share of the bandwidth, with the same ratios of all corner frequencies."""
        kp, ki = share * self.kp, share**2 * self.ki
        return replace(self, kp=kp, ki=ki, position_gain=share * self.position_gain)

    def law(self) -> ControlLaw:
        """The cascade u = F(z) (kp e + ki T sum e), e = w + K (r - y) - (y_k - y_k-1) / T."""
        T, n = self.period, 2 + 2 * len(self.filters)
        A, B, E = np.zeros((n, n)), np.zeros((n, 3)), np.zeros(n)
        names = ["last_angle", "integral"]
        B[0, 2] = 1.0  # the last angle
        error_x = np.zeros(n)
        error_x[0] = 1.0 / T
        error_u = np.array([self.position_gain, 1.0, -self.position_gain - 1.0 / T])
        A[1] += T * error_x
        A[1, 1] += 1.0
        B[1] = T * error_u
        signal_x = self.kp * error_x + self.ki * A[1]
        signal_u = self.kp * error_u + self.ki * B[1]
        for k, one in enumerate(self.filters):
            first, second = 2 + 2 * k, 3 + 2 * k
            names += [f"{one.kind} {k + 1}, {i}" for i in (1, 2)]
            # transposed direct form II: y = b0 s + x1, x1+ = b1 s - a1 y + x2, x2+ = b2 s - a2 y
            output_x, output_u = one.b[0] * signal_x, one.b[0] * signal_u
            output_x[first] += 1.0
            A[first] = one.b[1] * signal_x - one.a[0] * output_x
            A[first, second] += 1.0
            B[first] = one.b[1] * signal_u - one.a[0] * output_u
            A[second] = one.b[2] * signal_x - one.a[1] * output_x
            B[second] = one.b[2] * signal_u - one.a[1] * output_u
            signal_x, signal_u = output_x, output_u
        holds = np.arange(n) == 1
        return ControlLaw(A, B, signal_x, signal_u, E, holds, tuple(names))

    def response(self, z: ComplexArray) -> ComplexArray:
        """Response from the motor angle to minus the voltage, without the law's matrices."""
        T = self.period
        difference = (1.0 - 1.0 / z) / T
        loop = (self.kp + self.ki / difference) * (self.position_gain + difference)
        for one in self.filters:
            loop = loop * one.response(z)
        return np.asarray(loop)
