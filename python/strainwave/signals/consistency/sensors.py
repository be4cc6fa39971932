"""What link sensors read at low frequencies, against what the motors' angles imply.

A gear is rigid at low frequency: whatever its stiffness, the link follows n theta_M. So every link
channel has a prediction without any unknown, (8) to (10), and a regression on it must give 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, Correction, FloatArray, Lag, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate, lagged
from strainwave.signals.consistency.evidence import Evidence, SlowRecord, is_slow
from strainwave.signals.consistency.regression import Fit, regress

LINK_CHANNELS = ("a", "gyro", "theta_l")
"""Kinds whose reading follows from the motors' angles."""

STANDARD_GRAVITY = 9.80665  # [m/s^2]
_REACH = float(np.log(300.0))  # of the factors that a joint's turning is looked for in
_TRIES = 41
_HIGH_PASS_TRIES = 13
_LONGEST_DECAY = 2.0  # records that a high-pass may take: with a wrong time base it takes millions
_HIGH_PASS_LEFT = 0.02  # share of the reading that a high-pass may leave unexplained
_HIGH_PASS_GAIN = 0.2  # of the share that no high-pass leaves
_NO_TIME = 1e-3  # rows that a low-pass takes, which pass for none
_HEARD_TURNING = 5.0  # deviations from which a turning may be divided by
_TURNED = 0.1  # [rad] of tilt, or of an angle's zero, that the study does not know
_BELOW_RESONANCE = 2.0  # resonance over bandwidth, of what is known beforehand of the gears


@dataclass(frozen=True, slots=True)
class Reading:
    """One link channel of one record on its prediction."""

    channel: str
    record: str
    seconds: float  # of the record
    scale: float  # of all of it
    scale_std: float
    delay: float  # [s]
    delay_std: float
    drift: float  # [s/s] by which the delay grows
    drift_std: float
    explained: float  # share of the reading that the prediction explains
    signal: float  # size of the reading at low frequency over its noise there
    parts: dict[str, tuple[float, float]]  # "own", "elbow", "gravity" -> scale, deviation
    turn: tuple[float, float] | None  # joint 2's motion against joint 1's, deviation
    tilt: tuple[float, float] | None  # gravity that the study does not have, of 1; deviation


def readings(seen: Evidence) -> list[Reading]:
    """Every link channel on what the motors imply.

    By the slow records, where there are any with the channel; else by those that excite the joint.

    Parameters
    ----------
    seen : Evidence

    Returns
    -------
    list of Reading
        Without those of which a record has no information.
    """
    slow = {name for r in seen.records if is_slow(r.experiment) for name in r.channels}
    found: list[Reading] = []
    for record in seen.records:
        motion = _Motion.of(record, seen.arm)
        for kind in LINK_CHANNELS:
            for i in range(seen.arm.n_joints):
                name = f"{kind}{i + 1}"
                excited = record.experiment.joint in (None, i + 1)
                wanted = is_slow(record.experiment) or (name not in slow and excited)
                if wanted and name in record.channels:
                    found.extend(_read(record, seen, motion, kind, i))
    return found


def high_pass_cutoff(seen: Evidence, name: str) -> float | None:
    """The cut-off of a first-order high-pass that makes an accelerometer follow the motion [Hz].

    None where no cut-off does, or where the reading follows better without.
    """
    kind, joint = channel_parts(name)
    records = [r for r in seen.records if name in r.channels and is_slow(r.experiment)]
    if not records:
        return None
    record = max(records, key=lambda r: len(r.inside))
    motion = _Motion.of(record, seen.arm)

    def unexplained(hz: float) -> float:
        other = replace(seen, high_passes={**seen.high_passes, name: hz})
        found = _read(record, other, motion, kind, joint - 1)
        alike = [reading for reading in found if 0.5 < reading.scale < 2.0]
        return min((1.0 - reading.explained for reading in alike), default=1.0)

    edges = 0.1 / (len(record.inside) * record.sample_time), record.bandwidth_hz
    low, high = (float(np.log(edge)) for edge in edges)
    for _ in range(3):
        grid = np.linspace(low, high, _HIGH_PASS_TRIES)
        left = [unexplained(float(np.exp(each))) for each in grid]
        k = int(np.argmin(left))
        low, high = float(grid[max(k - 1, 0)]), float(grid[min(k + 1, len(grid) - 1)])
    if left[k] > min(_HIGH_PASS_LEFT, _HIGH_PASS_GAIN * unexplained(0.0)):
        return None
    return float(f"{np.exp(grid[k]):.4g}")


def turning(seen: Evidence, joint: int) -> tuple[float, ...]:
    """How much a joint's link turns over what the study implies, by the reading that says most.

    What link 2's sensors read is not proportional to its own motion: the factor is looked for that
    explains most of it, and joint 1 is taken as it is.

    Parameters
    ----------
    seen : Evidence
    joint : int
        From 1.

    Returns
    -------
    tuple of float
        None, or the one.
    """
    if joint == 1:
        return ()
    ratio = seen.arm.joints[joint - 1].gear_ratio
    slow = [r for r in seen.records if is_slow(r.experiment)] or list(seen.records)
    names = [f"{k}{joint}" for k in ("theta_l", "gyro", "a") if f"{k}{joint}" in slow[0].channels]

    def unexplained(factor: float) -> float:
        other = seen.corrected([Correction("joint", str(joint), "gear_ratio", factor * ratio)])
        motion = _Motion.of(slow[0], other.arm)
        found = _read(slow[0], other, motion, names[0][:-1], joint - 1)
        return min((1.0 - reading.explained for reading in found), default=1.0)

    if not names:
        return ()
    grid = np.linspace(-_REACH, _REACH, _TRIES)
    best, least, centre, width = 1.0, np.inf, 0.0, 1.0
    for _ in range(3):
        factors = [float(f) for f in np.exp(centre + width * grid)]
        left = [unexplained(f) for f in factors]
        k = int(np.argmin(left))
        centre += width * float(grid[k])
        width *= 4.0 / (_TRIES - 1)
        if left[k] < least:
            best, least = factors[k], left[k]
    return (best,) if least < 0.5 else ()


@dataclass(frozen=True, slots=True)
class _Motion:
    """The links' motion by the motors' angles: (n_rows, n_joints)."""

    angle: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    @classmethod
    def of(cls, record: SlowRecord, arm: Arm) -> _Motion:
        joints = range(1, arm.n_joints + 1)
        motor = np.column_stack([record.channels[f"theta_m{i}"] for i in joints])
        angle = motor * arm.gear_ratios
        velocity = differentiate(angle, record.sample_time)
        return cls(angle, velocity, differentiate(velocity, record.sample_time))


def _parts(arm: Arm, motion: _Motion, kind: str, i: int) -> dict[str, FloatArray] | None:
    """What a channel's reading is the sum of; None: the study does not say."""
    q, dq, ddq = motion.angle, motion.velocity, motion.acceleration
    if kind == "theta_l":
        return {"own": q[:, i]}
    if kind == "gyro":
        return {"own": dq[:, : i + 1].sum(axis=1)}
    joint = arm.joints[i]
    if joint.motion == "prismatic":
        return {"own": ddq[:, i]}
    if joint.accelerometer_distance is None:
        return None
    parts = {"own": joint.accelerometer_distance * ddq[:, : i + 1].sum(axis=1)}
    if i == 1:
        elbow = ddq[:, 0] * np.cos(q[:, 1]) + dq[:, 0] ** 2 * np.sin(q[:, 1])
        parts["elbow"] = (arm.link_length or 0.0) * elbow
    if arm.gravity:
        parts["gravity"] = arm.gravity * np.cos(q[:, : i + 1].sum(axis=1))
    return parts


def _turned(arm: Arm, motion: _Motion, kind: str, i: int) -> list[FloatArray]:
    """What a radian adds to an accelerometer's reading: of tilt, and of an angle's wrong zero.

    A level arm that tilts has gravity along both axes of its plane; an upright one, whose gravity
    is known, has it turned. The zero of joint 2 turns what the elbow does to link 2.
    """
    if kind != "a" or arm.joints[i].motion == "prismatic":
        return []
    q, dq, ddq = motion.angle, motion.velocity, motion.acceleration
    phi = q[:, : i + 1].sum(axis=1)
    both = [STANDARD_GRAVITY * np.sin(phi), STANDARD_GRAVITY * np.cos(phi)]
    found = [arm.gravity * np.sin(phi)] if arm.gravity else both
    if i == 1 and arm.link_length:
        elbow = dq[:, 0] ** 2 * np.cos(q[:, 1]) - ddq[:, 0] * np.sin(q[:, 1])
        found.append(arm.link_length * elbow)
    return found


def _read(
    record: SlowRecord, seen: Evidence, motion: _Motion, kind: str, i: int
) -> Iterator[Reading]:
    name, arm = f"{kind}{i + 1}", seen.arm
    parts = _parts(arm, motion, kind, i)
    if parts is None:
        return
    T = record.sample_time
    sensor = [lag for lag in _lags(arm, kind, i) if _shows(lag, T, len(record.inside))]
    cutoff = seen.high_passes.get(name)
    if cutoff and not _NO_TIME < 1.0 / (2.0 * np.pi * cutoff * T) < _LONGEST_DECAY * len(
        record.inside
    ):
        cutoff = None

    def sensed(part: FloatArray) -> FloatArray:
        part = lagged(part, sensor, T)
        return part - lagged(part, [Lag(1, cutoff)], T) if cutoff else part

    parts = {key: sensed(part) for key, part in parts.items()}
    target = record.channels[name][record.inside]
    whole = np.sum(list(parts.values()), axis=0)
    turned = [sensed(part) for part in _turned(arm, motion, kind, i)]
    # the state in which a high-pass begins the record is unknown
    decays = [np.exp(-2.0 * np.pi * cutoff * T * np.arange(len(whole)))] if cutoff else []
    beside = _Beside.of(record, whole, whole - parts.get("gravity", 0.0), turned, decays)
    together = beside.fit(target, [whole])
    if together is None:
        return
    scale, scale_std = _coefficient(together, 0)
    delay, delay_std = _over_scale(together, 2)
    drift, drift_std = _over_scale(together, 3)
    each = beside.fit(target, list(parts.values())) if len(parts) > 1 else None
    apart = {"own": (scale, scale_std)}
    if each is not None:
        apart = {key: _coefficient(each, k) for k, key in enumerate(parts)}
    size = float(np.std(target))
    shares = _shares(arm, motion, kind) if i == 1 else None
    turn = None
    if shares is not None:
        turn = beside.quotient(target, [sensed(share) for share in shares])
    yield Reading(
        channel=name,
        record=record.experiment.name,
        seconds=T * len(record.inside),
        scale=scale,
        scale_std=scale_std,
        delay=delay,
        delay_std=delay_std,
        drift=drift,
        drift_std=drift_std,
        explained=together.explained,
        signal=size / max(record.noise[name], 1e-12 * size, 1e-300),
        parts=apart,
        turn=turn,
        tilt=_tilt(together, arm, 4 + len(decays)) if len(turned) > 1 else None,
    )


def _tilt(fit: Fit, arm: Arm, first: int) -> tuple[float, float] | None:
    """Gravity in the plane of motion of an arm without, of 1, and its deviation."""
    if arm.gravity:
        return None
    own = slice(first, first + 2)
    both, spread = fit.value[own], fit.covariance[own, own]
    size = float(np.hypot(*both))
    return size, float(np.sqrt(both @ spread @ both)) / max(size, 1e-12)


@dataclass(frozen=True, slots=True)
class _Beside:
    """What a reading has besides what is regressed: springs, delay, drift, and what is turned."""

    inside: BoolArray
    columns: tuple[FloatArray, ...]
    prior: FloatArray
    n_turned: int

    @classmethod
    def of(
        cls,
        record: SlowRecord,
        whole: FloatArray,
        dynamic: FloatArray,
        turned: list[FloatArray],
        decays: list[FloatArray],
    ) -> _Beside:
        T, inside = record.sample_time, record.inside
        slope = differentiate(whole, T)
        since = record.start + T * np.arange(len(whole))
        since = since - since[inside].mean()
        # springs: the link's motion is the motor's and 1/w_a^2 of its second derivative; a drift's
        # and a delay's columns are a slope each
        springs = differentiate(differentiate(dynamic, T), T)
        top = 2.0 * np.pi * _BELOW_RESONANCE * record.bandwidth_hz
        free = [np.inf] * (2 + len(decays))
        prior = np.array([top**-2.0, *free, *[_TURNED] * len(turned)])
        columns = (springs, -slope, -since * slope, *decays, *turned)
        return cls(inside, columns, prior, len(turned))

    def fit(self, target: FloatArray, regressed: list[FloatArray]) -> Fit | None:
        """The regression, what is turned being unknown."""
        columns = [*regressed, *self.columns]
        prior = np.r_[[np.inf] * len(regressed), self.prior]
        return regress(target, np.column_stack(columns)[self.inside], prior)

    def quotient(
        self, target: FloatArray, regressed: list[FloatArray]
    ) -> tuple[float, float] | None:
        """The first coefficient over the second, by the fit that is nearer to 1 in its deviations.

        A tilt that is left out, and one that takes what springs and friction leave, spoil one each.
        """
        n_level = len(self.columns) - self.n_turned
        level = replace(self, columns=self.columns[:n_level], prior=self.prior[:n_level])
        fits = [each.fit(target, regressed) for each in (level, self)]
        found = [None if fit is None else _quotient(fit) for fit in fits]
        known = [each for each in found if each is not None]
        if len(known) < len(found):
            return None
        return min(known, key=lambda each: abs(each[0] - 1.0) / each[1])


def _coefficient(fit: Fit, k: int) -> tuple[float, float]:
    """A coefficient and its deviation."""
    return float(fit.value[k]), float(np.sqrt(fit.covariance[k, k]))


def _over_scale(fit: Fit, k: int) -> tuple[float, float]:
    """A coefficient of the reading's slope, of a reading of the predicted size."""
    (value, std), scale = _coefficient(fit, k), float(fit.value[0])
    return (value / scale, std / abs(scale)) if scale else (0.0, np.inf)


def _shares(arm: Arm, motion: _Motion, kind: str) -> list[FloatArray] | None:
    """What link 2's sensor reads of joint 2's turning, of joint 1's, and the rest."""
    parts = _parts(arm, motion, kind, 1)
    if parts is None or kind == "theta_l" or arm.joints[1].motion == "prismatic":
        return None
    turned = motion.velocity if kind == "gyro" else motion.acceleration
    distance = 1.0 if kind == "gyro" else arm.joints[1].accelerometer_distance or 0.0
    rest = [part for key, part in parts.items() if key != "own"]
    return [distance * turned[:, 1], distance * turned[:, 0], *rest]


def _quotient(fit: Fit) -> tuple[float, float] | None:
    """The first coefficient over the second, which may be of either sign but not lost in noise.

    Its deviation is that of coefficients that are alike (Fieller): where the second is vague, the
    deviation at the quotient itself passes any quotient far from 1 for a sure one.
    """
    (a, b), spread = fit.value[:2], fit.covariance[:2, :2]
    if abs(b) < _HEARD_TURNING * np.sqrt(spread[1, 1]):
        return None
    unlike = spread[0, 0] - 2.0 * spread[0, 1] + spread[1, 1]
    return float(a / b), float(np.sqrt(unlike) / abs(b))


def _shows(lag: Lag, sample_time: float, rows: int) -> bool:
    """Whether a low-pass is slower than a row by anything, and faster than the record.

    A time base that is wrong by a thousand makes it neither.
    """
    rows_taken = 1.0 / (2.0 * np.pi * lag.cutoff_hz * sample_time)
    return _NO_TIME < rows_taken < 0.1 * rows


def _lags(arm: Arm, kind: str, i: int) -> list[Lag]:
    joint = arm.joints[i]
    if kind == "a" and joint.accelerometer_hz:
        return [Lag(2, joint.accelerometer_hz)]
    if kind == "gyro" and joint.gyro_hz:
        return [Lag(1, joint.gyro_hz)]
    return []
