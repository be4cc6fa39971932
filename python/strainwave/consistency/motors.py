"""What motor signals say of one another: references, servo, velocity channel, torques.

At low frequency a servoed motor follows its reference, its voltage is what the servo makes of the
difference, and the torques are those of rigid joints, (5) to (7), whatever the gears' stiffness.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from strainwave.consistency.evidence import Evidence, SlowRecord, is_slow
from strainwave.consistency.regression import Fit, regress
from strainwave.filters import differentiate
from strainwave.records import FloatArray, Study
from strainwave.regressor import gear_ratios

_SATURATED = 0.01  # share of a record at the servo's limit, from which its law no longer holds
_COUPLED = ("beta", "gamma", "gravity_torque_2")


@dataclass(frozen=True, slots=True)
class Ratio:
    """One motor signal of one record on what another implies; 1 where they agree."""

    channel: str
    record: str
    value: float
    std: float
    explained: float


@dataclass(frozen=True, slots=True)
class Torque:
    """One joint's torque on the rigid joints' equations, over all slow records."""

    joint: int
    inertia: float  # [kg m^2] motor side, what accelerates with the motor alone
    inertia_std: float
    explained: float
    coupling: dict[str, tuple[float, float]]  # beta, gamma, G2 by this joint's equation


def references(seen: Evidence) -> list[Ratio]:
    """Low-frequency motor velocity over the reference of the servo that it follows.

    Parameters
    ----------
    seen : Evidence

    Returns
    -------
    list of Ratio
        Where a servo of the study acts and its reference moves.
    """
    found: list[Ratio] = []
    for record, i in _servoed(seen):
        reference = record.channels[f"ref{i}"]
        velocity = differentiate(record.channels[f"theta_m{i}"], record.sample_time)
        slope = differentiate(reference, record.sample_time)
        slope2 = differentiate(slope, record.sample_time)
        columns = np.column_stack([reference, slope, slope2])[record.inside]
        found.extend(_ratio(record, f"theta_m{i}", velocity, columns))
    return found


def servo_outputs(seen: Evidence) -> list[Ratio]:
    """Voltage over what the study's servo makes of reference and motor angle, kp e + ki int(e).

    Parameters
    ----------
    seen : Evidence

    Returns
    -------
    list of Ratio
        Where a servo acts alone, without a PRBS on top.
    """
    found: list[Ratio] = []
    servo = seen.study.servo
    for record, i in _servoed(seen):
        name = f"u{i}"
        own = record.experiment.prbs is not None and record.experiment.joint in (None, i)
        if servo is None or own or name not in record.channels:
            continue
        angle, reference = record.channels[f"theta_m{i}"], record.channels[f"ref{i}"]
        error = reference - differentiate(angle, record.sample_time)
        whole = np.cumsum(reference) * record.sample_time - angle
        expected = servo.kp[i - 1] * error + servo.ki[i - 1] * whole
        found.extend(_ratio(record, name, record.channels[name], expected[record.inside, None]))
    return found


def velocities(seen: Evidence) -> list[Ratio]:
    """Logged motor velocity over the motor angle's derivative.

    Parameters
    ----------
    seen : Evidence

    Returns
    -------
    list of Ratio
    """
    found: list[Ratio] = []
    for record in seen.records:
        for i in range(1, seen.study.n_joints + 1):
            name = f"omega_m{i}"
            if name in record.channels:
                slope = differentiate(record.channels[f"theta_m{i}"], record.sample_time)
                columns = slope[record.inside, None]
                found.extend(_ratio(record, name, record.channels[name], columns))
    return found


def torques(seen: Evidence) -> list[Torque]:
    """Each joint's torque on what the equations of rigid joints are linear in.

    Both joints' equations are taken apart, so that beta, gamma and G2, which stand in both, come
    out twice.

    Parameters
    ----------
    seen : Evidence

    Returns
    -------
    list of Torque
        Of the joints whose torque some record tells.
    """
    slow = [r for r in seen.records if is_slow(r.experiment)]
    found = []
    for i in range(seen.study.n_joints):
        own = slow or [r for r in seen.records if r.experiment.joint in (None, i + 1)]
        fit, names = _torque(own, seen.study, i)
        if fit is None:
            continue
        deviation = np.sqrt(np.diag(fit.covariance))
        coupling = {
            name: (float(fit.value[k]), float(deviation[k]))
            for k, name in enumerate(names)
            if name in _COUPLED
        }
        inertia = float(fit.value[0]), float(deviation[0])
        found.append(Torque(i + 1, *inertia, fit.explained, coupling))
    return found


def _servoed(seen: Evidence) -> Iterator[tuple[SlowRecord, int]]:
    if seen.study.servo is None:
        return
    limit = 0.999 * seen.study.servo.limit
    for record in seen.records:
        for i, control in enumerate(record.experiment.control, start=1):
            if control != "servo" or f"ref{i}" not in record.channels:
                continue
            voltage = record.channels.get(f"u{i}")
            if voltage is not None and np.mean(np.abs(voltage) >= limit) > _SATURATED:
                continue
            if np.ptp(record.channels[f"ref{i}"]) > 0.0:
                yield record, i


def _ratio(
    record: SlowRecord, channel: str, target: FloatArray, columns: FloatArray
) -> Iterator[Ratio]:
    fit = regress(target[record.inside], columns)
    if fit is not None:
        std = float(np.sqrt(fit.covariance[0, 0]))
        yield Ratio(channel, record.experiment.name, float(fit.value[0]), std, fit.explained)


def _torque(records: list[SlowRecord], study: Study, i: int) -> tuple[Fit | None, list[str]]:
    """All records' rows of one joint's equation, each record with a constant of its own."""
    targets, blocks = [], []
    names: list[str] = []
    for record in records:
        columns = _columns(record, study, i)
        names = list(columns)
        torque = motor_torque(record, study, i)[record.inside]
        block = np.column_stack(list(columns.values()))[record.inside]
        targets.append(torque - torque.mean())
        blocks.append(block - block.mean(axis=0))
    if not targets:
        return None, names
    return regress(np.concatenate(targets), np.concatenate(blocks)), names


def motor_torque(record: SlowRecord, study: Study, i: int) -> FloatArray:
    """A motor's torque as logged, or as its voltage makes it [N m].

    Parameters
    ----------
    record : SlowRecord
    study : Study
    i : int
        Joint, from 0.

    Returns
    -------
    (n_rows,)
    """
    name = f"torque{i + 1}"
    if name in record.channels:
        return record.channels[name]
    return (study.joints[i].torque_per_volt or 1.0) * record.channels[f"u{i + 1}"]


def _columns(record: SlowRecord, study: Study, i: int) -> dict[str, FloatArray]:
    """Motor torque per parameter of one joint's equation, taken apart from the other's."""
    n = gear_ratios(study)
    joints = range(1, study.n_joints + 1)
    motor = np.column_stack([record.channels[f"theta_m{j}"] for j in joints])
    q = motor * n
    dq = differentiate(q, record.sample_time)
    ddq = differentiate(dq, record.sample_time)
    friction = {"viscous": dq[:, i] / n[i], "coulomb": record.direction[:, i]}
    gravity = study.arm.gravity is not None
    if study.n_joints == 1:
        pull = {"gravity_torque_1": n[0] * np.cos(q[:, 0])} if gravity else {}
        return {"inertia": ddq[:, 0] / n[0]} | friction | pull
    c, s = np.cos(q[:, 1]), np.sin(q[:, 1])
    own = {"inertia": ddq[:, i] / n[i]}
    if i == 0:
        both = 2.0 * ddq[:, 0] + ddq[:, 1]
        swirl = 2.0 * dq[:, 0] * dq[:, 1] + dq[:, 1] ** 2
        coupled = {"beta": n[0] * ddq[:, 1], "gamma": n[0] * (c * both - s * swirl)}
    else:
        coupled = {"beta": n[1] * ddq[:, 0], "gamma": n[1] * (c * ddq[:, 0] + s * dq[:, 0] ** 2)}
    pull = {}
    if gravity:
        pull["gravity_torque_2"] = n[i] * np.cos(q[:, 0] + q[:, 1])
        if i == 0:
            pull["gravity_torque_1"] = n[0] * np.cos(q[:, 0])
    return own | coupled | friction | pull


def torque_ratio(found: list[Torque]) -> tuple[float, float] | None:
    """How much larger joint 1's torques are than the symmetry of M(q) allows, against joint 2's.

    beta and gamma couple either joint to the other by the same torque, G2 acts on both; with torque
    constants e_i wrong by factors f_i they come out as f_i times themselves, and f_1 / f_2 follows:
    the minimum of sum_k (x1_k - r x2_k)^2 / (s1_k^2 + r^2 s2_k^2).

    Parameters
    ----------
    found : list of Torque
        From `torques`.

    Returns
    -------
    value, standard deviation, or None
        None where the arm has one joint, or its motion does not tell.
    """
    if len(found) < 2:
        return None
    shared = [name for name in found[0].coupling if name in found[1].coupling]
    if not shared:
        return None
    x1, s1 = np.array([found[0].coupling[name] for name in shared]).T
    x2, s2 = np.array([found[1].coupling[name] for name in shared]).T

    def cost(r: FloatArray) -> FloatArray:
        off = x1 - np.multiply.outer(r, x2)
        return np.asarray(np.sum(off**2 / (s1**2 + np.multiply.outer(r**2, s2**2)), axis=-1))

    grid = np.exp(np.linspace(-3.0, 3.0, 2401))
    costs = cost(grid)
    best = int(np.argmin(costs))
    near = grid[costs < costs[best] + 1.0]
    if best in (0, len(grid) - 1) or costs[best] + 4.0 > min(costs[0], costs[-1]):
        return None
    spread = 0.5 * float(near[-1] - near[0]) + float(grid[best]) * 1e-3
    excess = max(1.0, float(costs[best]) / max(1, len(shared) - 1))
    return float(grid[best]), spread * float(np.sqrt(excess))
