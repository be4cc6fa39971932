"""Random serial chains for comparisons with other programs."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from strainwave import _core

GRAVITY = (0.4, -0.7, -9.6)
SAMPLES = 20
MOTOR = [1.5e-4, 2e-4, 0.06, 0.01, 0.5, 2e4, 10.0, 0.0]  # with a linear gear

Joint = tuple[str, list[float], list[float], list[float]]
Array = NDArray[np.float64]


def random_joints(rng: np.random.Generator, n_joints: int, types: str) -> list[Joint]:
    """Random joints without parallel axes; r is revolute, p is prismatic."""
    names = {"r": "revolute", "p": "prismatic"}
    return [
        (
            names[types[i]],
            rng.uniform(-0.4, 0.4, 3).tolist(),
            rng.uniform(-3.0, 3.0, 3).tolist(),
            rng.normal(size=3).tolist(),
        )
        for i in range(n_joints)
    ]


def random_body(rng: np.random.Generator) -> dict[str, Any]:
    """Mass, centre and central inertia of a randomly oriented box."""
    mass = rng.uniform(0.5, 8.0)
    a, b, c = rng.uniform(0.05, 0.4, 3)
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    about_axes = np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) * mass / 12
    return {
        "mass": mass,
        "centre": rng.uniform(-0.3, 0.3, 3),
        "inertia": turned @ about_axes @ turned.T,
    }


def parameters_of(body: dict[str, Any]) -> list[float]:
    """Mass, first moments, and inertia about the origin of the frame (Huygens-Steiner)."""
    m, c = body["mass"], body["centre"]
    about = body["inertia"] + m * (c @ c * np.eye(3) - np.outer(c, c))
    pairs = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    return [m, *(m * c), *(about[i, j] for i, j in pairs)]


def rotation(rpy: list[float]) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll) from single rotations."""
    whole = np.eye(3)
    for axis, angle in zip((2, 1, 0), reversed(rpy), strict=True):
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        turn = np.eye(3)
        turn[[i, j], [i, j]] = np.cos(angle)
        turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
        whole = whole @ turn
    return whole


def assert_close(actual: Array, expected: Array) -> None:
    """Compare exact results; torques are of the order of 100 N m."""
    np.testing.assert_allclose(actual, expected, rtol=1e-11, atol=1e-10)


def chain(joints: list[Joint], **constants: Any) -> _core.Arm:
    """A chain with linear gears of ratio 1/100 under `GRAVITY`, unless given otherwise."""
    n = len(joints)
    springs, ratios = ["linear"] * n, [0.01] * n
    given: dict[str, Any] = {"springs": springs, "gear_ratio": ratios, "gravity": GRAVITY}
    return _core.Arm(joints, **(given | constants))
