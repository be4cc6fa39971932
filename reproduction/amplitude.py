"""Effect of the gear's three slopes over the amplitude of the PRBS: Figs. 2, 14 and 15.

With the published settings a state-space model estimates each joint at each amplitude. With the
default settings the claims rely on the equations of motion, as sweeps of `identify` do, and the
state-space model is only plotted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from reproduction.document import comparison_of, criterion_of
from reproduction.joint_estimates import (
    JointEstimate,
    curve,
    estimated_curve,
    evidence_of,
    response_of,
)
from reproduction.records import Comparison, Criterion, Evidence
from reproduction.rig import Rig, Run, gear_torque, slopes
from strainwave.domain import FloatArray, JointModel, Mode
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, anti_resonance, jacobian, joint_of
from strainwave.identification.joint_model.agreement import vector_of
from strainwave.report.figures import Figure
from strainwave.report.figures.curves import Series, bode, scatter

PAYLOAD = 3  # [kg]
_STARTS = (0, 256, 512, 768)  # clocks of the PRBS at which the records start
_MAX_EXCESS_STD = 2.0  # standard deviations of a value beyond a bound
_MAX_RELATIVE_EXCESS = 0.02  # of a value without a standard deviation


@dataclass(frozen=True, slots=True)
class Level:
    """Estimates of one joint at one amplitude, from one or several records of one period each."""

    amplitude: float
    state_space: JointEstimate  # from all records
    joint: TwoInertia | None  # from the equations of motion; None: published settings
    evidence: tuple[Evidence, ...]  # the claims rely on the decisive models
    square: float  # [rad^2/s^2] squared anti-resonance of the decisive model
    std: float  # of `square`; NaN: unknown
    hz: tuple[float, float]  # anti-resonance and resonance of the decisive model
    state_space_square: float  # if the state-space model is not decisive; NaN: it is
    true: float  # `square` with the equivalent stiffness
    bounds: tuple[float, float]  # `square` with K1 and with K3
    sliding: float  # share of the time in which the motor certainly slides
    load: float  # rms torque of the gear over that of its last knee


LevelsByJoint = dict[int, tuple[Level, ...]]
"""Levels of each joint, from the lowest amplitude."""


def estimate_levels(
    rig: Rig, joint: int, amplitudes: Sequence[float], records: int
) -> tuple[Level, ...]:
    """Estimates of one joint at several amplitudes [V] from up to four records each."""
    levels = []
    for amplitude in amplitudes:
        rig.progress(f"joint {joint} at {amplitude:g} V")
        runs = [
            rig.prbs(joint, disks=PAYLOAD, amplitude=amplitude, periods=1, start=start)
            for start in _STARTS[:records]
        ]
        levels.append(_level(rig, amplitude, runs))
    return tuple(levels)


def responses(levels_by_joint: LevelsByJoint) -> Comparison:
    """Fig. 14: the frequency response changes with the amplitude."""
    criteria, plots, texts = [], [], []
    values: dict[str, float] = {}
    for joint, levels in levels_by_joint.items():
        plots.append(_responses_of(joint, levels))
        for index, name in enumerate(("anti-resonance", "resonance")):
            hz = [level.hz[index] for level in levels]
            criteria.append(_rises(f"joint {joint}, {name}", hz))
            texts.append(f"joint {joint}: {name} {_listed(hz)} Hz")
        values[f"joint {joint}, share of the time sliding at the least amplitude"] = levels[
            0
        ].sliding
    low, high = (levels_by_joint[1][k].amplitude for k in (0, -1))
    return comparison_of(
        14,
        criteria=criteria,
        evidence=_evidence(levels_by_joint),
        values=values,
        message=f"{'; '.join(texts)} from {low:g} to {high:g} V",
        plots=plots,
    )


def squares(levels_by_joint: LevelsByJoint) -> Comparison:
    """Fig. 15: squared anti-resonance, proportional to the stiffness, over the amplitude."""
    criteria, plots, texts = [], [], []
    values: dict[str, float] = {}
    for joint, levels in levels_by_joint.items():
        plots.append(_scatter(joint, levels))
        criteria += [
            _rises(f"joint {joint}, squared anti-resonance", [level.square for level in levels]),
            criterion_of(
                "outside",
                float(sum(not _inside(level) for level in levels)),
                joint=joint,
                stds=_MAX_EXCESS_STD,
                percent=100.0 * _MAX_RELATIVE_EXCESS,
            ),
        ]
        for level in levels:
            volt = f"joint {joint} at {level.amplitude:g} V, square"
            values[f"{volt} [rad²/s²]"] = level.square
            if level.joint is not None:
                values[f"{volt} by the state-space model [rad²/s²]"] = level.state_space_square
            values[f"{volt}, truth [rad²/s²]"] = level.true
        low, high = levels[0].bounds
        texts.append(
            f"joint {joint}: {_listed([level.square for level in levels], 0)} rad²/s², K1 "
            f"{low:.0f}, K3 {high:.0f}"
        )
    return comparison_of(
        15,
        criteria=criteria,
        evidence=_evidence(levels_by_joint),
        values=values,
        message="; ".join(texts),
        plots=plots,
    )


def stiffest(levels_by_joint: LevelsByJoint) -> Comparison:
    """Section 5 of the source: the largest amplitude gives K3 of Fig. 2."""
    shares = {
        joint: levels[-1].square / levels[-1].bounds[1] for joint, levels in levels_by_joint.items()
    }
    return comparison_of(
        2,
        criteria=[criterion_of("k3-share", share, joint=joint) for joint, share in shares.items()],
        evidence=[e for levels in levels_by_joint.values() for e in levels[-1].evidence],
        values={f"gear_load_{joint}": levels[-1].load for joint, levels in levels_by_joint.items()},
        message="; ".join(
            f"joint {joint}: {100.0 * share:.0f} % of that with K3, rms torque "
            f"{levels_by_joint[joint][-1].load:.2g} times that of the last knee"
            for joint, share in shares.items()
        ),
    )


def _load(run: Run, joint: int) -> float:
    _, torque = gear_torque(run.arm, run.values, run.trajectory, joint)
    return float(np.sqrt(np.mean(torque**2)) / run.values["gear_knee_t2", joint])


def _rises(name: str, values: Sequence[float]) -> Criterion:
    falls = float(np.sum(~(np.diff(values) > 0.0)))
    return criterion_of("rises", falls, what=name)


def _inside(level: Level) -> bool:
    low, high = level.bounds
    if np.isfinite(level.std):
        margin = _MAX_EXCESS_STD * level.std
    else:
        margin = _MAX_RELATIVE_EXCESS * level.square
    return low - margin < level.square < high + margin


def _listed(values: Sequence[float], digits: int = 2) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def _evidence(levels_by_joint: LevelsByJoint) -> list[Evidence]:
    return [e for levels in levels_by_joint.values() for level in levels for e in level.evidence]


def _level(rig: Rig, amplitude: float, runs: Sequence[Run]) -> Level:
    state_space = rig.estimate(*runs)
    linear = _hz(state_space.anti_resonance), _hz(state_space.resonance)
    is_default = rig.settings.protocol == "own"
    evidence = [replace(state_space.evidence, decisive=not is_default)]
    joint, hz, other, std = None, linear, float("nan"), float("nan")
    if is_default:
        model = rig.physical(*runs, disks=PAYLOAD)
        joint = joint_of(vector_of(model), runs[0].truth.gear_ratio)
        hz, other = (_hz(model.anti_resonance), _hz(model.resonance)), linear[0]
        std = _square_std(model, joint)
        evidence.append(evidence_of(model, f"equations of motion, {runs[0].name}"))
    number = runs[0].decoupled.joint
    k1, _, k3 = slopes(runs[0].values, number)
    truth = runs[0].truth
    low, high = (_square(replace(truth, gear_stiffness=k)) for k in (k1, k3))
    return Level(
        amplitude=amplitude,
        state_space=state_space,
        joint=joint,
        evidence=tuple(evidence),
        square=_squared(hz[0]),
        std=std,
        hz=hz,
        state_space_square=_squared(other),
        true=float(np.mean([_square(run.truth) for run in runs])),
        bounds=(low, high),
        load=float(np.mean([_load(run, number) for run in runs])),
        sliding=float(np.mean([run.signals.sliding[:, number - 1] != 0.0 for run in runs])),
    )


def _square_std(model: JointModel, joint: TwoInertia) -> float:
    """Standard deviation of the squared anti-resonance."""

    def square(vector: FloatArray) -> FloatArray:
        return np.array([_square(joint_of(vector, joint.gear_ratio))])

    count = len(NAMES)
    J = jacobian(square, joint.vector)
    return float(np.sqrt((J @ model.covariance[:count, :count] @ J.T)[0, 0]))


def _squared(hz: float) -> float:
    return (2.0 * np.pi * hz) ** 2


def _square(joint: TwoInertia) -> float:
    return _squared(anti_resonance(joint).frequency_hz)


def _responses_of(joint: int, levels: Sequence[Level]) -> Figure:
    curves = []
    for level in levels:
        name = f"{level.amplitude:g} V"
        if level.joint is None:
            curves += estimated_curve(name, level.state_space)
        else:
            curves += curve(name, response_of(level.joint))
    return bode(curves, f"Joint {joint}, {PAYLOAD} kg")


def _scatter(joint: int, levels: Sequence[Level]) -> Figure:
    volt = np.array([level.amplitude for level in levels])
    ends = volt[[0, -1]]
    low, high = levels[0].bounds
    square = np.array([level.square for level in levels])
    points = [
        Series("truth: mean slope", volt, np.array([level.true for level in levels]), true=True)
    ]
    if levels[0].joint is None:
        points.append(Series("state space", volt, square))
    else:
        std = np.array([level.std for level in levels])
        state_space = np.array([level.state_space_square for level in levels])
        points.append(Series("equations of motion", volt, square, std))
        points.append(Series("state space", volt, state_space))
    points.append(Series("with K1", ends, np.full(2, low)))
    points.append(Series("with K3", ends, np.full(2, high)))
    caption = f"Joint {joint}, {PAYLOAD} kg; bars: 95 %"
    return scatter(points, "amplitude [V]", "squared anti-resonance [rad²/s²]", caption)


def _hz(mode: Mode | None) -> float:
    return float("nan") if mode is None else mode.frequency_hz
