"""Faults of the input, one at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.studies.faults.inputs import EFFORTS, Case, Columns, Input
from benchmarks.studies.faults.torques import desired, loaded, locked, stating, without
from strainwave.domain import Correction
from strainwave.domain.study import Meaning

_DEGREES = 180.0 / np.pi
_ANGLES = ("theta_m", "theta_l", "deflection", "omega_m", "ref", "gyro", "gx", "gy", "gz")
_ACCELERATIONS = ("a", "ax", "ay", "az")
_RATED = (39.0, 27.0, 31.0, 9.0, 13.0, 7.0, 11.0)  # torques [N m] that per cent refer to
_TORQUE_CONSTANTS = (0.11, 0.087, 0.062, 0.05, 0.071, 0.043, 0.055)  # [N m/A] of the motors
_GEAR = 100.0  # motor turns per turn of the joint, where the logs state torques at the joints


def faults(given: Input, joint: int) -> Iterator[Case]:
    """Faults of the input; those of one joint in `joint`."""
    for kind in (_signal_faults, _effort_faults, _record_faults, _study_faults, _sensor_faults):
        for case in kind(given, joint):
            yield case if case.truth is not None else replace(case, truth=given)


def _each_scaled(given: Input, factors: Sequence[float]) -> Input:
    """With the efforts of each joint multiplied by its factor."""
    for i, factor in enumerate(factors[: given.study.arm.n_joints], start=1):
        given = given.scaled(given.efforts(i), factor)
    return given


def _zero_moved(given: Input, joint: int, angle: float) -> Input:
    """With another zero [rad at the link] of the angle of a motor."""
    name, offset = f"theta_m{joint}", angle / given.study.arm.joints[joint - 1].gear_ratio
    return given.changed(lambda table: {**table, name: table[name] + offset})


def _of_joint(given: Input, joint: int, key: str, factor: float) -> Correction:
    value = getattr(given.study.arm.joints[joint - 1], key)
    return Correction("joint", str(joint), key, factor * value)


def _neighbour(given: Input, joint: int) -> int:
    return joint + 1 if joint < given.study.arm.n_joints else joint - 1


def _signal_faults(given: Input, j: int) -> Iterator[Case]:
    """Faults of constants, units, signs, joints, zeros and delays in all records."""
    arm, other = given.study.arm, _neighbour(given, j)
    for name, factor in (("1 %", 100 / 101), ("20 %", 0.8)):
        wrong = given.stated(_of_joint(given, j, "gear_ratio", factor))
        yield Case(f"gear ratio {name}", wrong, ("wrong-gear-ratio",), (j,))
    motors = given.motors_only()
    wrong = motors.stated(_of_joint(given, j, "gear_ratio", 1.25))
    name = "gear ratio x 1.25, motors only"
    yield Case(name, wrong, ("wrong-gear-ratio",), (j,), truth=motors)
    angles = given.of_kinds(("theta_m",))
    unit = ("wrong-unit",)
    yield Case("degrees of one", given.scaled([f"theta_m{j}"], _DEGREES), unit, (j,))
    yield Case("angles in degrees", given.scaled(angles, _DEGREES), unit)
    yield Case("everything in degrees", given.scaled(given.of_kinds(_ANGLES), _DEGREES), unit)
    yield Case("angles in turns", given.scaled(angles, 0.5 / np.pi), unit)
    yield Case("angle reversed", given.scaled([f"theta_m{j}"], -1.0), ("wrong-sign",), (j,))
    swapped = ("swapped-channels",)
    a, b = (given.of_kinds(("theta_m", "omega_m", "torque", "u", "ref"), i) for i in (j, other))
    yield Case("joints exchanged", given.exchanged(a, b), swapped, (j, other))
    # without gravity, the zero of the first joint is free, and the inertia shows that of the others
    if arm.gravity or j > 1:
        for size in (0.1, np.pi / 2):
            moved = _zero_moved(given, j, size)
            yield Case(f"zero {size:.2g} rad", moved, ("wrong-zero",), (j,))
    if arm.gravity and arm.kind == "planar-two-link":
        for name, size in (("pi/2", np.pi / 2), ("pi", np.pi)):
            yield Case(f"hanging zero {name}", _zero_moved(given, 1, size), ("wrong-zero",), (1,))
    yield Case("angle 20 ms late", given.late([f"theta_m{j}"], 0.02), ("misaligned",), (j,))


def _effort_faults(given: Input, j: int) -> Iterator[Case]:
    """Faults of the scales, signs, delays and meanings of efforts."""
    other, efforts, all_efforts = _neighbour(given, j), given.efforts(j), given.of_kinds(EFFORTS)
    unit, scale = ("wrong-unit",), ("wrong-torque-constant", "wrong-unit")
    yield Case("torque x 0.8", given.scaled(efforts, 0.8), scale, (j,))
    yield Case("torque reversed", given.scaled(efforts, -1.0), ("wrong-sign",), (j,))
    yield Case("all torques reversed", given.scaled(all_efforts, -1.0), ("wrong-sign",))
    yield Case("torque in mN m", given.scaled(efforts, 1e3), unit, (j,))
    yield Case("all torques in mN m", given.scaled(all_efforts, 1e3), unit)
    torques = given.with_torques()  # a voltage has no rated value, no current and no meaning
    rated = [100.0 / torque for torque in _RATED]
    yield Case("torques in per cent", _each_scaled(torques, rated), scale, truth=torques)
    at_joints = all(abs(joint.gear_ratio) == 1.0 for joint in given.study.arm.joints)
    currents = [1.0 / (_GEAR * k if at_joints else k) for k in _TORQUE_CONSTANTS]
    yield Case("torques in A", _each_scaled(torques, currents), scale, truth=torques)
    exchanged = given.exchanged(efforts, given.efforts(other))
    yield Case("torques exchanged", exchanged, ("swapped-channels",), (j, other))
    misaligned = ("misaligned",)
    yield Case("torque 20 ms late", given.late(efforts, 0.02), misaligned, (j,))
    yield Case("all torques 20 ms late", given.late(all_efforts, 0.02), misaligned)
    parts = ("gravity", "friction") if given.study.arm.gravity else ("friction",)
    for part in parts:
        changed = without(torques, (part,))
        if changed is not None:
            meaning: Meaning = "without-gravity" if part == "gravity" else "without-friction"
            truth = stating(changed, meaning)
            yield Case(f"effort without {part}", changed, (f"effort-{meaning}",), truth=truth)
    model = desired(torques)
    if model is not None:
        yield Case("desired effort", model, ("desired-effort",), truth=stating(model, "desired"))


def _record_faults(given: Input, j: int) -> Iterator[Case]:
    """Faults of single records."""
    other, efforts, motions = _neighbour(given, j), given.efforts(j), given.motions
    first, last = motions[0], motions[-1]
    clamped = Case("motors at a locked output", locked(given), ("locked-output",))
    yield replace(clamped, records=tuple(motions))
    kinds = ("theta_m", "omega_m", *EFFORTS, "ref")
    a, b = given.of_kinds(kinds, j), given.of_kinds(kinds, other)
    one = given.exchanged(a, b, [first])
    yield Case("exchanged in one record", one, ("swapped-channels",), (j, other), (first,))
    if len(motions) > 1:
        signed = given.changed(
            lambda t: {k: -v if k in efforts else v for k, v in t.items()}, [first]
        )
        yield Case("torque reversed in one record", signed, ("wrong-sign",), (j,), (first,))
        load = loaded(given, last)
        if load is not None:
            code = ("unstated-payload",)
            yield Case("payload in one record", load[0], code, (), (last,), truth=load[1])
    tests = [e.name for e in given.study.experiments if e.use in ("frequency", "sweep")]
    if tests:
        slow = given.changed(lambda t: {**t, "t": 1.05 * t["t"]}, tests)
        clock = ("clock-drift", "wrong-unit")
        yield Case("t of PRBS records x 1.05", slow, clock, (), tuple(tests))
        files = dict(given.tables)
        files[tests[0]], files[first] = files[first], files[tests[0]]
        exchanged = replace(given, tables=files)
        yield Case("files exchanged", exchanged, ("swapped-channels",), (), (tests[0], first))


def _sensor_faults(given: Input, j: int) -> Iterator[Case]:
    """Channels that show nothing, or that belong to no relation."""
    angle, dead = f"theta_m{j}", ("dead-channel",)
    step = given.study.arm.joints[j - 1].encoder_resolution or 1e-4

    def standing(table: Columns) -> Columns:
        counts = np.round(0.5 + 0.5 * np.sin(40.0 * table["t"]))
        return {**table, angle: table[angle][0] + step * counts}

    constant = given.changed(lambda t: {**t, angle: np.full_like(t["t"], t[angle][0])})
    yield Case("encoder stands still", constant, dead, (j,))
    if len(given.motions) > 1:
        first = given.motions[0]
        one = given.changed(standing, [first])
        yield Case("encoder stands still in one record", one, dead, (j,), (first,))
    for name in given.of_kinds(("a", "ax"), j):
        silent = given.changed(lambda t: {**t, name: 1e-3 * np.sin(9e3 * t["t"] ** 2)})  # noqa: B023
        yield Case("dead accelerometer", silent, dead, (j,))
    for kind in ("temperature", "tau_l"):
        name = f"{kind}{j}"
        if not given.of_kinds((kind,)):
            drifting = given.changed(lambda t: {**t, name: 30.0 + np.sin(0.7 * t["t"])})  # noqa: B023
            yield Case(f"unrelated {kind}", drifting, dead, (j,), unchecked=name)
    yield Case("encoder dithers by a count", given.changed(standing), dead, (j,))


def _study_faults(given: Input, j: int) -> Iterator[Case]:
    """Faults of the geometry, of gravity, of test signals and of current loops."""
    study, arm, geometry = given.study, given.study.arm, ("wrong-geometry",)
    if arm.kind == "serial":
        if arm.gravity:
            down = arm.gravity[2]
            for name, vector in (("direction", (0.0, down, 0.0)), ("up", (0.0, 0.0, -down))):
                turned = given.stated(Correction("arm", "", "gravity", vector))
                yield Case(f"gravity {name}", turned, geometry)
        lengths = [
            Correction("joint", str(i), "origin.xyz", tuple(0.65 * x for x in each.origin.xyz))
            for i, each in enumerate(arm.joints, start=1)
        ]
        yield Case("lengths x 0.65", given.stated(*lengths), geometry)
    elif given.of_kinds(_ACCELERATIONS):  # the torques of a planar arm do not depend on its lengths
        short = Correction("arm", "", "link_length", 0.65 * arm.joints[1].origin.xyz[0])
        yield Case("lengths x 0.65", given.stated(short), geometry)
        if given.of_kinds(("a",), j) and arm.joints[j - 1].accelerometer_distance:
            far = given.stated(_of_joint(given, j, "accelerometer_distance", 1.5))
            yield Case("distance x 1.5", far, geometry, (j,))
    doubled = [
        Correction("experiment", e.name, "prbs.clock", 2.0 * e.prbs.clock)
        for e in study.experiments
        if e.prbs is not None
    ]
    if doubled:
        yield Case("PRBS clock x 2", given.stated(*doubled), ("wrong-prbs-clock",))
    # No current loop of 1 kHz makes a command 0.16 ms early, below the accuracy of a delay; torques
    # have none. There is no code of its own: the delay of command and motion is another one.
    if given.of_kinds(("u",), j) and arm.joints[j - 1].current_loop_hz:
        for name, factor in (("ten times too slow", 0.1), ("of 60 Hz", 0.06)):
            slow = given.stated(_of_joint(given, j, "current_loop_hz", factor))
            yield Case(f"current loop {name}", slow, ("misaligned",), (j,))
