"""Errors of units, signs, joints, geometry and clocks, injected into clean logs or their study."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from strainwave.domain import FloatArray, Log, Study, channel_parts
from strainwave.domain.arm.description import Origin

Logs = tuple[Log, ...]

_SHIFTED = ("a", "ax", "ay", "az", "gyro")  # kinds of the channels that a fault shifts


@dataclass(frozen=True, slots=True)
class Fault:
    """An error of the input, and the input that has it."""

    kind: str
    size: str
    codes: tuple[str, ...]  # warning codes that name it; empty: harmless or corrected
    logs: Logs
    study: Study


FaultInjector = Callable[[Logs, Study, int, np.random.Generator], Fault]


def _change_channels(logs: Logs, change: Callable[[Log, dict[str, FloatArray]], None]) -> Logs:
    changed = []
    for log in logs:
        channels = dict(log.channels)
        change(log, channels)
        changed.append(replace(log, channels=channels))
    return tuple(changed)


def _scale_channel(logs: Logs, name: str, factor: float) -> Logs:
    def change(_: Log, channels: dict[str, FloatArray]) -> None:
        channels[name] = factor * channels[name]

    return _change_channels(logs, change)


def _scale_time(logs: Logs, factor: float) -> Logs:
    return tuple(
        replace(log, time=factor * log.time, sample_time=factor * log.sample_time) for log in logs
    )


def _of_study(kind: str, code: str, change: Callable[[Study, int], Study]) -> FaultInjector:
    def inject(logs: Logs, study: Study, joint: int, _: np.random.Generator) -> Fault:
        return Fault(kind, f"joint {joint}", (code,), logs, change(study, joint))

    return inject


def _time_unit(logs: Logs, study: Study, _: int, rng: np.random.Generator) -> Fault:
    factor, unit = [(1e3, "ms"), (1e6, "us")][int(rng.integers(2))]
    return Fault("time-unit", unit, ("wrong-unit",), _scale_time(logs, factor), study)


def _time_scale(logs: Logs, study: Study, _: int, rng: np.random.Generator) -> Fault:
    factor = 1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(0.005, 0.05))
    return Fault("time-scale", f"{factor:.3f}", ("clock-drift",), _scale_time(logs, factor), study)


def _angle_unit(logs: Logs, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    counts = float(study.arm.joints[joint - 1].encoder_counts or 8192.0)
    units = {"degrees": 180.0 / np.pi, "counts": counts / (2 * np.pi), "turns": 0.5 / np.pi}
    unit = str(rng.choice(list(units)))
    changed = _scale_channel(logs, f"theta_m{joint}", units[unit])
    return Fault("angle-unit", unit, ("wrong-unit",), changed, study)


def _swapped(logs: Logs, study: Study, _: int, rng: np.random.Generator) -> Fault:
    present = [name for name in ("a", "u", "theta_m") if f"{name}1" in logs[0].channels]
    kind = str(rng.choice(present))

    def change(_: Log, channels: dict[str, FloatArray]) -> None:
        channels[f"{kind}1"], channels[f"{kind}2"] = channels[f"{kind}2"], channels[f"{kind}1"]

    return Fault(
        "swapped-joints", kind, ("swapped-channels",), _change_channels(logs, change), study
    )


def _with_joint(study: Study, joint: int, **changes: Any) -> Study:
    return replace(study, arm=study.arm.with_joint(joint, **changes))


def _gear_ratio(logs: Logs, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    n = study.arm.joints[joint - 1].gear_ratio
    wrong, size = [(1.0, "left at 1"), (2.0 * n, "doubled"), (0.5 * n, "halved")][
        int(rng.integers(3))
    ]
    changed = _with_joint(study, joint, gear_ratio=wrong)
    return Fault("gear-ratio", size, ("wrong-gear-ratio",), logs, changed)


def _distance(logs: Logs, study: Study, joint: int, _: np.random.Generator) -> Fault:
    distance = float(study.arm.joints[joint - 1].accelerometer_distance or 0.0)
    length = study.arm.joints[-1].origin.xyz[0]
    changed = _with_joint(study, joint, accelerometer_distance=distance + length)
    size = f"x {1.0 + length / distance:.2f}"
    return Fault("geometry", size, ("wrong-geometry",), logs, changed)


def _torque_constant(logs: Logs, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    factor = float(rng.choice([0.9, 1.1]))
    e = study.arm.joints[joint - 1].torque_per_command
    changed = _with_joint(study, joint, torque_per_volt=factor * e)
    return Fault("torque-constant", f"x {factor}", ("wrong-torque-constant",), logs, changed)


def _shift_link_sensors(logs: Logs, delay: float, fast: float) -> Logs:
    def change(log: Log, channels: dict[str, FloatArray]) -> None:
        time = log.time - log.time[0]
        shifted = time * (1.0 + fast) - delay
        link = {name: v for name, v in channels.items() if channel_parts(name)[0] in _SHIFTED}
        channels.update({name: np.interp(shifted, time, values) for name, values in link.items()})

    return _change_channels(logs, change)


def _late(logs: Logs, study: Study, _: int, rng: np.random.Generator) -> Fault:
    delay = float(rng.choice([1e-3, 2e-2]))
    codes = () if delay < 5e-3 else ("misaligned",)
    changed = _shift_link_sensors(logs, delay, 0.0)
    return Fault("late-sensors", f"{1e3 * delay:g} ms", codes, changed, study)


def _drift(logs: Logs, study: Study, _: int, __: np.random.Generator) -> Fault:
    return Fault(
        "fast-clock", "0.1 %", ("clock-drift",), _shift_link_sensors(logs, 0.0, 1e-3), study
    )


def _clipped(logs: Logs, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    share = float(rng.uniform(0.4, 0.7))
    name = f"a{joint}"
    limit = share * max(float(np.abs(log.channels[name]).max()) for log in logs)

    def change(_: Log, channels: dict[str, FloatArray]) -> None:
        channels[name] = np.clip(channels[name], -limit, limit)

    return Fault(
        "clipped-sensor", f"at {share:.2f}", ("clipped",), _change_channels(logs, change), study
    )


def _scaled(kind: str, size: str, code: str, channel: str, factor: float) -> FaultInjector:
    """Injector that multiplies a channel of the joint by a factor."""

    def inject(logs: Logs, study: Study, joint: int, _: np.random.Generator) -> Fault:
        changed = _scale_channel(logs, f"{channel}{joint}", factor)
        return Fault(kind, size, (code,), changed, study)

    return inject


INPUT_FAULTS: Mapping[str, FaultInjector] = {
    "time-unit": _time_unit,
    "time-scale": _time_scale,
    "angle-unit": _angle_unit,
    "angle-sign": _scaled("angle-sign", "-1", "wrong-sign", "theta_m", -1.0),
    "accelerometer-unit": _scaled("accelerometer-unit", "g", "wrong-unit", "a", 1.0 / 9.80665),
    "accelerometer-sign": _scaled("accelerometer-sign", "-1", "wrong-sign", "a", -1.0),
    "voltage-sign": _scaled("voltage-sign", "-1", "wrong-sign", "u", -1.0),
    "swapped-joints": _swapped,
    "gear-ratio": _gear_ratio,
    "geometry": _distance,
    "torque-constant": _torque_constant,
    "late-sensors": _late,
    "fast-clock": _drift,
    "clipped-sensor": _clipped,
}
"""Injectors of faults by kind; their arguments are logs, study, joint from 1, and generator."""


def _input_of(logs: Logs, joint: int) -> str:
    """Channel of the torque of a joint, or of its voltage."""
    name = f"torque{joint}"
    return name if name in logs[0].channels else f"u{joint}"


def _input_scaled(kind: str, code: str, factor: float) -> FaultInjector:
    """Injector that multiplies the torque or voltage of the joint."""

    def inject(logs: Logs, study: Study, joint: int, _: np.random.Generator) -> Fault:
        name = _input_of(logs, joint)
        return Fault(kind, name, (code,), _scale_channel(logs, name, factor), study)

    return inject


def _imu_sign(logs: Logs, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    kinds = [k for k in ("gz", "gy", "ax", "ay") if f"{k}{joint}" in logs[0].channels]
    name = f"{rng.choice(kinds)}{joint}" if kinds else "gz1"
    changed = _scale_channel(logs, name, -1.0) if kinds else logs
    return Fault("imu-sign", name, ("wrong-sign",), changed, study)


def _exchanged(logs: Logs, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    """All channels of a joint and of a neighbour exchanged, or those of one kind."""
    other = joint + 1 if joint < study.arm.n_joints else joint - 1
    names = {n for log in logs for n in log.channels if channel_parts(n)[1] in (joint, other)}
    kinds = sorted({channel_parts(name)[0] for name in names})
    chosen = kinds if rng.integers(2) else ["theta_m"]

    def change(log: Log, channels: dict[str, FloatArray]) -> None:
        for kind in chosen:
            first, second = f"{kind}{joint}", f"{kind}{other}"
            if first in channels and second in channels:
                channels[first], channels[second] = channels[second], channels[first]

    size = f"{joint} and {other}: {'all' if chosen == kinds else chosen[0]}"
    return Fault("swapped", size, ("swapped-channels",), _change_channels(logs, change), study)


def _axis_of(direction: tuple[float, float, float]) -> Callable[[Study, int], Study]:
    return lambda study, joint: _with_joint(study, joint, axis=direction)


def _reversed_axis(study: Study, joint: int) -> Study:
    x, y, z = study.arm.joints[joint - 1].axis
    return _with_joint(study, joint, axis=(-x, -y, -z))


def _smaller_ratio(study: Study, joint: int) -> Study:
    return _with_joint(study, joint, gear_ratio=0.8 * study.arm.joints[joint - 1].gear_ratio)


def _wrong_gravity(study: Study, _: int) -> Study:
    gravity = (0.0, -study.arm.gravity_size, 0.0)
    return replace(study, arm=replace(study.arm, gravity=gravity))


def _other_robot(logs: Logs, study: Study, _: int, rng: np.random.Generator) -> Fault:
    def moved(origin: Origin) -> Origin:
        xyz, rpy = (
            tuple((np.array(x) + 0.1 * rng.normal(size=3)).tolist())
            for x in (origin.xyz, origin.rpy)
        )
        return Origin(xyz, rpy)

    joints = [replace(joint, origin=moved(joint.origin)) for joint in study.arm.joints]
    changed = replace(study, arm=study.arm.with_joints(joints))
    return Fault("other-robot", "0.1 m, 0.1 rad", ("wrong-geometry",), logs, changed)


def _delayed(kind: str, channel: Callable[[Logs, int], str]) -> FaultInjector:
    """Injector that delays one channel of the joint by 20 ms."""

    def inject(logs: Logs, study: Study, joint: int, _: np.random.Generator) -> Fault:
        name = channel(logs, joint)

        if name not in logs[0].channels:
            return Fault(kind, name, ("misaligned",), logs, study)

        def change(log: Log, channels: dict[str, FloatArray]) -> None:
            if name in channels:
                channels[name] = np.interp(log.time - 0.02, log.time, channels[name])

        return Fault(kind, name, ("misaligned",), _change_channels(logs, change), study)

    return inject


SERIAL_FAULTS: Mapping[str, FaultInjector] = {
    "angle-degrees": _scaled("angle-degrees", "deg", "wrong-unit", "theta_m", 180.0 / np.pi),
    "torque-unit": _input_scaled("torque-unit", "wrong-unit", 1e3),
    "motor-sign": _scaled("motor-sign", "-1", "wrong-sign", "theta_m", -1.0),
    "torque-sign": _input_scaled("torque-sign", "wrong-sign", -1.0),
    "imu-sign": _imu_sign,
    "swapped": _exchanged,
    "gear-ratio": _of_study("gear-ratio", "wrong-gear-ratio", _smaller_ratio),
    "axis": _of_study("axis", "wrong-geometry", _axis_of((1.0, 0.0, 0.0))),
    "axis-sign": _of_study("axis-sign", "wrong-sign", _reversed_axis),
    "gravity": _of_study("gravity", "wrong-geometry", _wrong_gravity),
    "other-robot": _other_robot,
    "command-delay": _delayed("command-delay", _input_of),
    "angle-delay": _delayed("angle-delay", lambda _, joint: f"theta_m{joint}"),
    "imu-delay": _delayed("imu-delay", lambda _, joint: f"gz{joint}"),
}
"""Injectors of faults of serial arms by kind."""
