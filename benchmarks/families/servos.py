"""Position servos drawn over what hobby and quasi-direct drives do, simulated in MuJoCo.

A rig is a pendulum of one or two joints. Its servo reads the goal with a delay, and a 12-bit angle,
at its own period, and holds its output; the log has goal and present position alone. The goal is
held between samples of the log, or the log samples a continuous one. `_FLAVOURS` are the scales
that the study states. In studies without one, and in slow, small or absent motions, some values are
not determined.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.families.rigs import between
from strainwave.domain import FloatArray
from strainwave.domain.keys import Values

Output = Literal["torque", "current", "duty"]
Flavour = Literal["kp", "loaded", "ratios", "unexciting"]
Gear = Literal["plain", "backlash", "load-friction"]
Motion = Literal["rich", "slow", "small", "none"]

STEP = 1e-4  # [s] of MuJoCo
COUNTS = 4096  # per turn of the encoder
_COUNT = 2.0 * math.pi / COUNTS
_GRAVITY = 9.81  # [m/s^2]
_FLAVOURS: tuple[Flavour, ...] = ("kp", "loaded", "ratios", "unexciting")
_OUTPUTS: tuple[Output, ...] = ("torque", "duty", "current")
_GEARS: tuple[Gear, ...] = ("plain", "backlash", "plain", "load-friction")
_POOR_MOTIONS: tuple[Motion, ...] = ("slow", "small", "none")
_TWO_JOINTS_EVERY = 8  # rigs, of each flavour
_PERIODS = (0.001, 0.002, 0.004, 0.005)  # [s] of servos
_SAMPLE_TIMES = (0.002, 0.004, 0.005, 0.01, 0.02)  # [s] of logs
_DELAYS = (0.005, 0.03)  # [s]
_FAST_GOAL = 5e-4  # [s]
_BANDWIDTHS = (15.0, 60.0)  # [rad/s] sqrt(kp / inertia)
_MAX_SAG = 0.25  # [rad] of a horizontal link under its own weight
_DURATION, _STEPS_DURATION, _SETTLING = 25.0, 12.0, 2.0  # [s]
_LOADED_SHARE = (0.3, 1.0)  # gravity torque of the payload over that of the links
_PEAK_TORQUE = 0.75  # of the limit, in a multisine
_STEP_EVERY = 0.8  # [s]


@dataclass(frozen=True, slots=True)
class Drive:
    """Servo, motor and gear of one joint; all values at the joint."""

    kp: float  # [N m/rad]
    kd: float  # [N m s/rad]
    back_emf: float  # [N m s/rad] stall torque over no-load speed
    limit: float  # [N m]
    motor_inertia: float  # [kg m^2]
    viscous: float  # [N m s/rad]
    coulomb: float  # [N m]
    load_friction: float = 0.0  # share of the torque that the gear transmits
    backlash: float = 0.0  # [rad] half of the gap
    torque_per_output: float = 1.0  # [N m], [N m/A], [N m] at full duty

    @property
    def damping(self) -> float:
        """Damping of all origins [N m s/rad]."""
        return self.kd + self.back_emf + self.viscous


@dataclass(frozen=True, slots=True)
class Link:
    """A link along x of its frame."""

    mass: float
    centre: float  # [m] from the axis
    inertia: float  # [kg m^2] about the axis
    length: float  # [m]


@dataclass(frozen=True, slots=True)
class ServoRig:
    """A drawn arm with its servos."""

    seed: int
    flavour: Flavour
    output: Output
    gear: Gear
    motion: Motion
    period: float  # [s] of the servos
    sample_time: float  # [s] of the log
    delay: float  # [s] from goal to servo
    is_held: bool  # whether the goal changes with the samples of the log alone
    links: tuple[Link, ...]
    drives: tuple[Drive, ...]
    payload: tuple[float, float]  # [kg], [m] along the last link

    @property
    def states_scale(self) -> bool:
        """Whether the study has a known gain or stall torque; a payload is another scale."""
        return self.flavour == "kp" or (self.flavour == "unexciting" and self.seed % 8 < 4)

    @property
    def equal_delays(self) -> tuple[float, float]:
        """Delays [s] that give the servos the same goals at all of their ticks."""
        if not self.is_held:
            return self.delay, self.delay
        grid = math.gcd(round(self.period / STEP), round(self.sample_time / STEP))
        last = -(-round(self.delay / STEP) // grid) * grid
        return (last - grid) * STEP, last * STEP

    @property
    def goal_time(self) -> float:
        """Time [s] between rows of a goal, which the servo joins by lines unless it is held."""
        return self.sample_time if self.is_held else _FAST_GOAL

    @property
    def classes(self) -> dict[str, str]:
        """What the tables group by."""
        return {
            "flavour": self.flavour,
            "output": self.output,
            "gear": self.gear,
            "joints": str(len(self.links)),
            "motion": self.motion,
            "goal": "held" if self.is_held else "smooth",
        }


def draw_servo(seed: int) -> ServoRig:
    """Rig of a seed; consecutive seeds cycle through flavours, then outputs, gears and joints."""
    rng = np.random.default_rng([4, 5, seed])
    turn = seed // len(_FLAVOURS)
    flavour = _FLAVOURS[seed % len(_FLAVOURS)]
    n = 2 if turn % _TWO_JOINTS_EVERY == _TWO_JOINTS_EVERY - 1 else 1
    output, gear = _OUTPUTS[turn % len(_OUTPUTS)], _GEARS[turn % len(_GEARS)]
    gear = "plain" if n > 1 else gear
    links = []
    for i in range(n):
        length, mass = between(rng, 0.06, 0.35), between(rng, 0.05, 2.0) * 0.5**i
        centre = length * float(rng.uniform(0.5, 1.0))
        links.append(Link(mass, centre, mass * centre**2 * float(rng.uniform(1.05, 1.3)), length))
    period = float(rng.choice(_PERIODS))
    loads = [_load(links[i:]) for i in range(n)]
    return ServoRig(
        seed,
        flavour,
        output,
        gear,
        _POOR_MOTIONS[turn % len(_POOR_MOTIONS)] if flavour == "unexciting" else "rich",
        period,
        float(rng.choice(_SAMPLE_TIMES)),
        round(float(rng.uniform(*_DELAYS)), 4),
        bool(np.random.default_rng([6, seed]).uniform() < 0.5),
        tuple(links),
        tuple(_draw_drive(rng, *load, output, gear, period) for load in loads),
        _draw_payload(rng, links[-1]),
    )


def _load(links: list[Link]) -> tuple[float, float]:
    """Inertia [kg m^2] and gravity torque [N m] of stretched links about the first axis."""
    inertia, moment, reach = 0.0, 0.0, 0.0
    for link in links:
        inertia += link.inertia + link.mass * (reach**2 + 2.0 * reach * link.centre)
        moment += link.mass * (reach + link.centre)
        reach += link.length
    return inertia, _GRAVITY * moment


def _draw_payload(rng: np.random.Generator, link: Link) -> tuple[float, float]:
    x = round(link.length * float(rng.uniform(0.7, 1.0)), 5)
    return round(between(rng, *_LOADED_SHARE) * link.mass * link.centre / x, 4), x


def _draw_drive(
    rng: np.random.Generator,
    load: float,
    weight: float,
    output: Output,
    gear: Gear,
    period: float,
) -> Drive:
    """Damped more than its held output needs for stability."""
    motor = load * between(rng, 0.1, 2.0)
    inertia = load + motor
    kp = max(inertia * between(rng, *_BANDWIDTHS) ** 2, weight / _MAX_SAG)
    bandwidth = math.sqrt(kp / inertia)
    damping_ratio = max(between(rng, 0.12, 0.7), 0.75 * bandwidth * period + 0.05)
    damping = 2.0 * damping_ratio * math.sqrt(kp * inertia)
    back_emf = damping * float(rng.uniform(0.3, 0.6)) if output == "duty" else 0.0
    viscous = damping * float(rng.uniform(0.1, 0.35))
    limit = float(rng.uniform(2.5, 6.0)) * weight
    constant = between(rng, 0.3, 3.0)  # [N m/A]
    return Drive(
        kp=kp,
        kd=damping - back_emf - viscous,
        back_emf=back_emf,
        limit=limit,
        motor_inertia=motor,
        viscous=viscous,
        coulomb=float(rng.uniform(0.03, 0.13)) * weight,
        load_friction=float(rng.uniform(0.05, 0.2)) if gear == "load-friction" else 0.0,
        backlash=0.5 * math.radians(between(rng, 0.1, 0.8)) if gear == "backlash" else 0.0,
        torque_per_output={"torque": 1.0, "current": constant, "duty": limit}[output],
    )


def true_values(rig: ServoRig) -> Values:
    """Values of a rig under the names of results."""
    values: Values = {("servo_delay", None): rig.delay}
    last = rig.links[-1]
    if len(rig.links) == 1:
        values["inertia", 1] = last.inertia + rig.drives[0].motor_inertia
        values["gravity_torque_1", None] = _GRAVITY * last.mass * last.centre
    else:
        first = rig.links[0]
        alpha = first.inertia + last.mass * first.length**2
        moment = first.mass * first.centre + last.mass * first.length
        values |= {
            ("alpha", None): alpha,
            ("rigid_inertia", 1): alpha + rig.drives[0].motor_inertia,
            ("motor_inertia", 2): rig.drives[1].motor_inertia,
            ("beta", None): last.inertia,
            ("gamma", None): first.length * last.mass * last.centre,
            ("gravity_torque_1", None): _GRAVITY * moment,
            ("gravity_torque_2", None): _GRAVITY * last.mass * last.centre,
        }
    for i, drive in enumerate(rig.drives, start=1):
        values |= {
            ("motor_coulomb_friction", i): drive.coulomb,
            ("motor_viscous_friction", i): drive.viscous,
            ("total_viscous_friction", i): drive.viscous,
            ("servo_kp", i): drive.kp,
            ("servo_kd", i): drive.kd,
            ("servo_damping", i): drive.damping,
            ("servo_delay", i): rig.delay,
            ("torque_limit", i): drive.limit,
            ("load_friction", i): drive.load_friction,
            ("backlash", i): drive.backlash,
            ("friction_offset", i): 0.0,
        }
    return values


def write_rig(rig: ServoRig, folder: Path) -> None:
    """Simulate the records of a rig; write logs, study.toml and truth.json."""
    rng = np.random.default_rng([5, 4, rig.seed])
    names = [f"_{i}" for i in range(1, len(rig.links) + 1)] if len(rig.links) > 1 else [""]
    head = ",".join(["time", *(f"{c}_position{x}" for x in names for c in ("goal", "present"))])
    goals = _goals(rig, rng)
    for name, goal in goals.items():
        present = simulate(rig, goal, payload=name == "loaded")
        time = rig.sample_time * np.arange(len(present))
        logged = goal[:: round(rig.sample_time / rig.goal_time)]
        pairs = np.stack([logged, present], axis=2).reshape(len(time), -1)
        columns = np.column_stack([time, pairs])
        path = folder / f"{name}.csv"
        np.savetxt(path, columns, fmt="%.8g", delimiter=",", header=head, comments="")
    (folder / "study.toml").write_text(study_text(rig, tuple(goals)))
    truth: dict[str, Any] = {
        f"{name}_{joint}" if joint and len(rig.links) > 1 else name: value
        for (name, joint), value in true_values(rig).items()
    }
    text = json.dumps(truth | {"classes": rig.classes}, indent=1)
    (folder / "truth.json").write_text(text + "\n")


def study_text(rig: ServoRig, records: tuple[str, ...]) -> str:
    """Study of a rig, with the scale of its flavour."""
    n = len(rig.links)
    lines = ["[arm]", 'kind = "planar-two-link"' if n > 1 else 'kind = "single-joint"']
    lines += [f"link_length = {rig.links[0].length!r}"] if n > 1 else []
    lines += [f"gravity = {_GRAVITY}", ""]
    for _ in rig.links:
        joint = ("[[joint]]", 'spring = "rigid"', "gear_ratio = 1.0", f"encoder_counts = {COUNTS}")
        lines += [*joint, ""]
    lines += [*_servo_lines(rig), ""]
    lines += ["[channels]", 't = "time"']
    for i in range(1, n + 1):
        suffix = f"_{i}" if n > 1 else ""
        lines.append(f'ref{i} = "goal_position{suffix}"')
        lines.append(f'theta_m{i} = "present_position{suffix}"')
    for name in records:
        use = "check" if name == "steps" else "motion"
        control = ", ".join(['"servo"'] * n)
        lines += ["", "[[experiment]]", f'name = "{name}"', f'file = "{name}.csv"']
        lines += [f'use = "{use}"', f"control = [{control}]"]
        if name == "loaded":
            mass, x = rig.payload
            lines.append(f"payload = {{ mass = {mass}, xyz = [{x}, 0.0, 0.0] }}")
    return "\n".join(lines) + "\n"


def _servo_lines(rig: ServoRig) -> list[str]:
    """Table of the servos; gains have the unit of the output.

    Of duties, every other study with a scale states the stall torque in place of kp.
    """
    unknown = ['"unknown"'] * len(rig.drives)
    states_kp = rig.states_scale and (rig.output != "duty" or rig.seed % 8 < 4)

    def row(values: Iterable[float]) -> str:
        return f"[{', '.join(f'{value:.6g}' for value in values)}]"

    per_output = [drive.torque_per_output for drive in rig.drives]
    lines = ["[servo]", 'kind = "position"', f"period = {rig.period}", f'output = "{rig.output}"']
    gains = (drive.kp / scale for drive, scale in zip(rig.drives, per_output, strict=True))
    lines.append(f"kp = {row(gains) if states_kp else '[' + ', '.join(unknown) + ']'}")
    lines += [f"kd = [{', '.join(unknown)}]", 'delay = "unknown"']
    if rig.output == "current":
        lines.append(f"torque_constant = {row(per_output)}")
    if rig.output == "duty" and rig.states_scale:
        lines.append(f"stall_torque = {row(per_output)}")
        lines.append(f"no_load_speed = {row(d.limit / d.back_emf for d in rig.drives)}")
    return lines


def _goals(rig: ServoRig, rng: np.random.Generator) -> dict[str, FloatArray]:
    """Goals of the records: (n_samples, n_joints) each."""
    n = round(_DURATION / rig.goal_time)
    time: FloatArray = rig.goal_time * np.arange(n, dtype=np.float64)
    joints = range(len(rig.links))
    if rig.motion == "rich":
        multisine = np.column_stack([_multisine(rig, i, time, rng) for i in joints])
        goals = {"multisine": multisine, "chirp": _chirp(rig, time, rng)}
        if rig.flavour == "loaded":
            goals["loaded"] = multisine
    else:
        size = {"slow": 0.5, "small": 1.5 * _COUNT, "none": 0.0}[rig.motion]  # [rad]
        waves = [_waves(time, rng.integers(1, 4, 3), rng) for _ in joints]
        goals = {"slow": size * np.column_stack(waves) + 0.2}
    short = rig.goal_time * np.arange(round(_STEPS_DURATION / rig.goal_time))
    levels = rng.uniform(-0.3, 0.5, (round(_STEPS_DURATION / _STEP_EVERY) + 1, len(rig.links)))
    goals["steps"] = levels[(short / _STEP_EVERY).astype(int)]
    return goals


def _waves(time: FloatArray, lines: NDArray[Any], rng: np.random.Generator) -> FloatArray:
    """Sines of whole periods in a record, of peak 1."""
    phases = rng.uniform(0.0, 2.0 * np.pi, len(lines))
    waves = np.sin(2.0 * np.pi / _DURATION * np.outer(time, lines) + phases).sum(axis=1)
    return np.asarray(waves / np.abs(waves).max())


def _multisine(rig: ServoRig, i: int, time: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Slow lines of large amplitude, and lines around the bandwidth as the limit allows."""
    drive, (load, weight) = rig.drives[i], _load(list(rig.links[i:]))
    inertia = load + drive.motor_inertia
    bandwidth = math.sqrt(drive.kp / inertia) / (2.0 * math.pi)  # [Hz]
    slow = float(rng.uniform(0.45, 0.85)) * _waves(time, rng.integers(2, 18, 8), rng)
    high = np.geomspace(0.7, 1.2 * bandwidth, 12) * _DURATION
    fast = _waves(time, np.unique(high.round()), rng)
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(time), time[1])
    late = np.exp(-1j * omega * rig.delay)
    closed = drive.kp - inertia * omega**2 + 1j * omega * drive.damping
    servo = drive.kp * late * (1.0 - (drive.kp + 1j * omega * drive.kd) / closed)
    torques = [np.abs(np.fft.irfft(np.fft.rfft(x) * servo, len(time))).max() for x in (slow, fast)]
    room = _PEAK_TORQUE * drive.limit - weight - torques[0]
    return np.asarray(slow + min(max(room, 0.1 * weight) / torques[1], 0.3) * fast)


def _chirp(rig: ServoRig, time: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Chirps from rest; most saturate, some do not."""
    columns = []
    for i, drive in enumerate(rig.drives):
        load = _load(list(rig.links[i:]))[0] + drive.motor_inertia
        last = 1.3 * math.sqrt(drive.kp / load) / (2.0 * math.pi)  # [Hz]
        phase = 2.0 * np.pi * (0.2 * time + 0.5 * (last - 0.2) * time**2 / _DURATION)
        columns.append(float(rng.choice((0.25, 0.25, 0.03))) * np.sin(phase + 0.5 * np.pi * i))
    return np.column_stack(columns)


def simulate(rig: ServoRig, goal: FloatArray, *, payload: bool = False) -> FloatArray:
    """Present positions (n_samples, n_joints) [rad] of a record that starts at rest.

    `goal` has a row every `rig.goal_time`: (n_goals, n_joints).
    """
    model = _model(rig, payload)
    data = mujoco.MjData(model)
    n = len(rig.links)
    joints = [model.joint(f"joint{i}").qposadr[0] for i in range(1, n + 1)]
    kp, kd, limit = np.array([(d.kp, d.kd, d.limit) for d in rig.drives]).T
    data.qpos[joints] = goal[0]
    per_tick, per_sample = round(rig.period / STEP), round(rig.sample_time / STEP)
    late, settling = round(rig.delay / STEP), round(_SETTLING / STEP)
    rubs, (mass, x) = rig.gear == "load-friction", rig.payload if payload else (0.0, 0.0)
    inertia = rig.links[0].inertia + mass * x**2
    weight = _GRAVITY * (rig.links[0].mass * rig.links[0].centre + mass * x)
    per_goal = round(rig.goal_time / STEP)
    end = (len(goal) * per_goal - 1) // per_sample * per_sample
    present = np.empty((end // per_sample + 1, n))
    k = -settling
    while k <= end:
        angle = _COUNT * np.round(data.qpos[joints] / _COUNT)
        if k >= 0 and k % per_sample == 0:
            present[k // per_sample] = angle
        if k % per_tick == 0:
            row, rest = divmod(max(k - late, 0), per_goal)
            target = goal[row]
            if rest and not rig.is_held and row + 1 < len(goal):
                target = target + rest / per_goal * (goal[row + 1] - target)
            torque = kp * (target - angle) - kd * data.qvel[joints]
            data.ctrl[:] = np.clip(torque, -limit, limit)
        if rubs:
            drive = rig.drives[0]
            load = inertia * data.qacc[0] + weight * math.cos(data.qpos[0])
            model.dof_frictionloss[0] = drive.coulomb + drive.load_friction * abs(load)
        following = (
            k + 1 if rubs else min(k + per_tick - k % per_tick, k + per_sample - k % per_sample)
        )
        mujoco.mj_step(model, data, following - k)
        k = following
    if not np.all(np.isfinite(present)):
        raise FloatingPointError("MuJoCo diverged")
    return present


def _model(rig: ServoRig, payload: bool) -> Any:
    """Links in the x-z plane; a gap of a gear is a joint with stops between motor and link."""
    opened, closed, actuators = "", "", ""
    for i, (link, drive) in enumerate(zip(rig.links, rig.drives, strict=True), start=1):
        reach = rig.links[i - 2].length if i > 1 else 0.0
        hinge = 'type="hinge" axis="0 -1 0"'
        opened += f'<body pos="{reach!r} 0 0"><joint name="joint{i}" {hinge} '
        opened += (
            f'armature="{drive.motor_inertia!r}" damping="{drive.viscous + drive.back_emf!r}" '
        )
        opened += f'frictionloss="{drive.coulomb!r}" solreffriction="{2.0 * STEP} 1" '
        opened += 'solimpfriction="0.999 0.9999 0.001"/>'
        closed += "</body>"
        if drive.backlash:
            gap = f'range="{-drive.backlash!r} {drive.backlash!r}" solreflimit="{2.0 * STEP} 1"'
            opened += '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'
            opened += f'<body><joint name="gap{i}" {hinge} limited="true" {gap}/>'
            closed += "</body>"
        central = link.inertia - link.mass * link.centre**2
        opened += f'<inertial pos="{link.centre!r} 0 0" mass="{link.mass!r}" '
        opened += f'diaginertia="{central!r} {central!r} {central!r}"/>'
        actuators += f'<motor joint="joint{i}"/>'
    if payload:
        mass, x = rig.payload
        opened += f'<body pos="{x} 0 0"><inertial pos="0 0 0" mass="{mass}" '
        opened += 'diaginertia="1e-9 1e-9 1e-9"/></body>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{STEP}" gravity="0 0 {-_GRAVITY}" '
        'integrator="implicitfast"><flag contact="disable"/></option>'
        f"<worldbody>{opened}{closed}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )
