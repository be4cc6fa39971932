"""What motor signals say of one another: references, servo, velocity channel, torques.

At low frequency a servoed motor follows its reference, its voltage is what the servo makes of the
difference, and the torques are those of rigid joints, (5) to (7), whatever the gears' stiffness.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate
from strainwave.signals.consistency.evidence import Evidence, SlowRecord, is_slow
from strainwave.signals.consistency.regression import Fit, regress

_SATURATED = 0.01  # share of a record at the servo's limit, from which its law no longer holds
_SLIDING = 0.8  # of a row's neighbourhood, that a motor slides one way
_FEWEST_ROWS = 60  # of those; with fewer, all are taken
_WIDEST = float(np.log(1e3))  # of the torque constants' ratio that is looked for: a unit's factor
_RATIOS = 2001  # tried, 0.7 % apart
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
    shared: tuple[str, ...]  # of beta, gamma and G2 those that its equation has
    coupling: FloatArray  # (n_shared,) their values by this joint's equation
    coupling_covariance: FloatArray  # (n_shared, n_shared)


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
    servo = seen.arm.servo
    for record, i in _servoed(seen):
        name = f"u{i}"
        own = record.experiment.prbs is not None and record.experiment.joint in (None, i)
        if servo is None or own or name not in record.channels:
            continue
        angle, reference = record.channels[f"theta_m{i}"], record.channels[f"ref{i}"]
        error = reference - differentiate(angle, record.sample_time)
        whole = np.cumsum(reference) * record.sample_time - angle
        if servo.position_gain is not None:
            correction = servo.position_gain[i - 1] * (whole - whole[0])
            error = error + correction
            whole = whole + np.cumsum(correction) * record.sample_time
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
        for i in range(1, seen.arm.n_joints + 1):
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
        Of the joints whose torque some record has.
    """
    slow = [r for r in seen.records if is_slow(r.experiment)]
    found = []
    for i in range(seen.arm.n_joints):
        own = slow or [r for r in seen.records if r.experiment.joint in (None, i + 1)]
        own = [r for r in own if {f"u{i + 1}", f"torque{i + 1}"} & set(r.channels)]
        fit, names = _torque(own, seen.arm, i)
        if fit is None:
            continue
        deviation = np.sqrt(np.diag(fit.covariance))
        at = [names.index(name) for name in _COUPLED if name in names]
        shared = tuple(names[k] for k in at)
        inertia = float(fit.value[0]), float(deviation[0])
        coupling = fit.value[at], fit.covariance[np.ix_(at, at)]
        found.append(Torque(i + 1, *inertia, fit.explained, shared, *coupling))
    return found


def _servoed(seen: Evidence) -> Iterator[tuple[SlowRecord, int]]:
    if seen.arm.servo is None:
        return
    limit = 0.999 * seen.arm.servo.limit
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


def _torque(records: list[SlowRecord], arm: Arm, i: int) -> tuple[Fit | None, list[str]]:
    """All records' rows of one joint's equation, each record with a constant of its own."""
    targets, blocks = [], []
    names: list[str] = []
    for record in records:
        columns = _columns(record, arm, i)
        names = list(columns)
        # about a reversal friction is anywhere between its two values
        rows = record.inside & (np.abs(record.direction[:, i]) > _SLIDING)
        rows = rows if rows.sum() > _FEWEST_ROWS else record.inside
        torque = motor_torque(record, arm, i)[rows]
        block = np.column_stack(list(columns.values()))[rows]
        targets.append(torque - torque.mean())
        blocks.append(block - block.mean(axis=0))
    if not targets:
        return None, names
    return regress(np.concatenate(targets), np.concatenate(blocks)), names


def motor_torque(record: SlowRecord, arm: Arm, i: int) -> FloatArray:
    """A motor's torque as logged, or as its voltage makes it [N m].

    Parameters
    ----------
    record : SlowRecord
    arm : Arm
    i : int
        Joint, from 0.

    Returns
    -------
    (n_rows,)
    """
    name = f"torque{i + 1}"
    if name in record.channels:
        return record.channels[name]
    return (arm.joints[i].torque_per_volt or 1.0) * record.channels[f"u{i + 1}"]


def _columns(record: SlowRecord, arm: Arm, i: int) -> dict[str, FloatArray]:
    """Motor torque per parameter of one joint's equation, taken apart from the other's."""
    n = arm.gear_ratios
    joints = range(1, arm.n_joints + 1)
    motor = np.column_stack([record.channels[f"theta_m{j}"] for j in joints])
    q = motor * n
    dq = differentiate(q, record.sample_time)
    ddq = differentiate(dq, record.sample_time)
    friction = {"viscous": dq[:, i] / n[i], "coulomb": record.direction[:, i]}
    gravity = arm.gravity is not None
    if arm.n_joints == 1:
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
    the minimum over r of (x1 - r x2)' (C1 + r^2 C2)^-1 (x1 - r x2). A ratio of 1 is no more
    deviations off than the root of what it costs more.

    Parameters
    ----------
    found : list of Torque
        From `torques`.

    Returns
    -------
    value, standard deviation, or None
        None where the arm has one joint, or its motion does not show it.
    """
    if len(found) < 2 or found[0].shared != found[1].shared or not found[0].shared:
        return None
    first, second = found

    def costs_of(ratios: FloatArray) -> FloatArray:
        off = first.coupling - ratios[:, None] * second.coupling
        squares = ratios[:, None, None] ** 2
        spread = first.coupling_covariance + squares * second.coupling_covariance
        return np.asarray((off * np.linalg.solve(spread, off[..., None])[..., 0]).sum(axis=1))

    grid = np.exp(np.linspace(-_WIDEST, _WIDEST, _RATIOS))
    costs = costs_of(grid)
    best = int(np.argmin(costs))
    if best in (0, len(grid) - 1) or costs[best] + 4.0 > min(costs[0], costs[-1]):
        return None
    # a parabola through the lowest three: its bottom, and how far from it the cost is one more
    step = float(np.log(grid[1] / grid[0]))
    left, middle, right = (float(c) for c in costs[best - 1 : best + 2])
    bend = max((left - 2.0 * middle + right) / step**2, 1e-12)
    ratio = float(grid[best]) * float(np.exp(0.5 * (left - right) / (step * bend)))
    excess = max(1.0, middle / max(1, len(first.shared) - 1))
    deviation = ratio * float(np.sqrt(2.0 / bend * excess))
    more = float(costs_of(np.ones(1))[0]) - middle
    if more > 1.0:  # far from its bottom the cost is no parabola
        deviation = max(deviation, abs(ratio - 1.0) * float(np.sqrt(excess / more)))
    return ratio, deviation
