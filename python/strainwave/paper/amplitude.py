"""What the gear's three slopes show over the amplitude of the PRBS: Figs. 2, 14 and 15.

As published, each joint at each amplitude is estimated by a state-space model. By our own settings
claims rest on the equations of motion, as sweeps of `identify` do; the state-space model is shown
beside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import Comparison, Criterion, Evidence, FloatArray, JointModel, Mode
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, anti_resonance, jacobian, joint_of
from strainwave.paper.claims import compared
from strainwave.paper.estimates import Estimate, curve, estimated_curve, evidence_of, response_of
from strainwave.paper.rig import Rig, Run
from strainwave.paper.truth import slopes
from strainwave.presentation.figures import Figure
from strainwave.presentation.figures.curves import Points, bode, scatter

PAYLOAD = 3  # [kg]
_STARTS = (0, 256, 512, 768)  # clocks of the PRBS that the records begin with
_OUTSIDE = 2.0  # deviations that a value may lie beyond a bound
_RELATIVE = 0.02  # the same of a value without a deviation
_NEARLY = 0.9  # share of the square with K3 that would count as it
_STANDS = "at low amplitudes friction holds the motor for much of the time"


@dataclass(frozen=True, slots=True)
class Level:
    """One joint at one amplitude, from one or several records of one period each."""

    amplitude: float
    state_space: Estimate  # all records at once
    joint: TwoInertia | None  # by the equations of motion; None: as published
    evidence: tuple[Evidence, ...]  # decisive is what the claims rest on
    square: float  # [rad^2/s^2] of the anti-resonance, of what is decisive
    deviation: float  # of it; NaN: not known
    hz: tuple[float, float]  # anti-resonance and resonance of what is decisive
    beside: float  # the square by the state-space model where it is not; NaN: none
    true: float  # with the slope that the gear showed
    bounds: tuple[float, float]  # with K1 and with K3
    sliding: float  # share of the time in which the motor surely slides


Swept = dict[int, tuple[Level, ...]]
"""Levels of each joint."""


def levels(rig: Rig, joint: int, amplitudes: Sequence[float], records: int) -> tuple[Level, ...]:
    """One joint at several amplitudes.

    `amplitudes` [V]: From the smallest. `records`: How many at each, at most four.
    """
    found = []
    for amplitude in amplitudes:
        rig.progress(f"joint {joint} at {amplitude:g} V")
        runs = [
            rig.prbs(joint, disks=PAYLOAD, amplitude=amplitude, periods=1, start=start)
            for start in _STARTS[:records]
        ]
        found.append(_level(rig, amplitude, runs))
    return tuple(found)


def responses(swept: Swept) -> Comparison:
    """Fig. 14: the response moves with the amplitude."""
    criteria, plots, said = [], [], []
    values: dict[str, float] = {}
    for joint, found in swept.items():
        plots.append(_responses_of(joint, found))
        for place, name in enumerate(("anti-resonance", "resonance")):
            hz = [level.hz[place] for level in found]
            criteria.append(_rises(f"joint {joint}, {name}", hz))
            said.append(f"joint {joint}: {name} {_listed(hz)} Hz")
        values[f"joint {joint}, share of the time sliding at the least amplitude"] = found[
            0
        ].sliding
    low, high = (swept[1][k].amplitude for k in (0, -1))
    return compared(
        14,
        criteria=criteria,
        evidence=_evidence(swept),
        values=values,
        message=f"{'; '.join(said)} from {low:g} to {high:g} V",
        plots=plots,
    )


def squares(swept: Swept) -> Comparison:
    """Fig. 15: squared anti-resonance, proportional to the stiffness, over the amplitude."""
    criteria, plots, said = [], [], []
    values: dict[str, float] = {}
    for joint, found in swept.items():
        plots.append(_scatter(joint, found))
        criteria += [
            _rises(f"joint {joint}, squared anti-resonance", [level.square for level in found]),
            Criterion(
                f"joint {joint}, amplitudes outside K1 to K3",
                float(sum(not _inside(level) for level in found)),
                "at most",
                0.0,
                f"{_OUTSIDE:g} standard deviations are allowed for, or {100.0 * _RELATIVE:g} % "
                "where there are none",
                _STANDS,
            ),
        ]
        for level in found:
            volt = f"joint {joint} at {level.amplitude:g} V, square"
            values[f"{volt} [rad²/s²]"] = level.square
            if level.joint is not None:
                values[f"{volt} by the state-space model [rad²/s²]"] = level.beside
            values[f"{volt}, truth [rad²/s²]"] = level.true
        low, high = found[0].bounds
        said.append(
            f"joint {joint}: {_listed([level.square for level in found], 0)} rad²/s², K1 "
            f"{low:.0f}, K3 {high:.0f}"
        )
    return compared(
        15,
        criteria=criteria,
        evidence=_evidence(swept),
        values=values,
        message="; ".join(said),
        plots=plots,
    )


def stiffest(swept: Swept) -> Comparison:
    """Section 5 of the source: the largest amplitude gives K3 of Fig. 2."""
    shares = {joint: found[-1].square / found[-1].bounds[1] for joint, found in swept.items()}
    return compared(
        2,
        criteria=[
            Criterion(
                f"joint {joint}, squared anti-resonance over that with K3",
                share,
                "at least",
                _NEARLY,
                "a stiffness counts as well known to 10 %",
                "the gear passes its softer middle twice in every swing, and a linear estimate is "
                "a mean over the swing",
            )
            for joint, share in shares.items()
        ],
        evidence=[e for found in swept.values() for e in found[-1].evidence],
        message="; ".join(
            f"joint {joint}: {100.0 * share:.0f} % of K3's" for joint, share in shares.items()
        ),
    )


def _rises(name: str, values: Sequence[float]) -> Criterion:
    falls = float(np.sum(~(np.diff(values) > 0.0)))
    return Criterion(
        f"{name}, steps of the amplitude at which it does not rise",
        falls,
        "at most",
        0.0,
        "the source's curves rise at every step",
        _STANDS,
    )


def _inside(level: Level) -> bool:
    low, high = level.bounds
    margin = (
        _OUTSIDE * level.deviation if np.isfinite(level.deviation) else _RELATIVE * level.square
    )
    return low - margin < level.square < high + margin


def _listed(values: Sequence[float], digits: int = 2) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def _evidence(swept: Swept) -> list[Evidence]:
    return [e for found in swept.values() for level in found for e in level.evidence]


def _level(rig: Rig, amplitude: float, runs: Sequence[Run]) -> Level:
    together = rig.estimate(*runs)
    linear = _hz(together.anti_resonance), _hz(together.resonance)
    own = rig.settings.protocol == "own"
    evidence = [replace(together.evidence, decisive=not own)]
    joint, hz, other, deviation = None, linear, float("nan"), float("nan")
    if own:
        model = rig.physical(*runs, disks=PAYLOAD)
        joint = joint_of(np.array([model.values[name] for name in NAMES]), runs[0].truth.gear_ratio)
        hz, other = (_hz(model.anti_resonance), _hz(model.resonance)), linear[0]
        deviation = _deviation(model, joint)
        evidence.append(evidence_of(model, f"equations of motion, {runs[0].name}"))
    number = runs[0].decoupled.joint
    k1, _, k3 = slopes(runs[0].values, number)
    truth = runs[0].truth
    low, high = (_square(_with_stiffness(truth, k)) for k in (k1, k3))
    return Level(
        amplitude=amplitude,
        state_space=together,
        joint=joint,
        evidence=tuple(evidence),
        square=_squared(hz[0]),
        deviation=deviation,
        hz=hz,
        beside=_squared(other),
        true=float(np.mean([_square(run.truth) for run in runs])),
        bounds=(low, high),
        sliding=float(np.mean([run.signals.sliding[:, number - 1] != 0.0 for run in runs])),
    )


def _deviation(model: JointModel, joint: TwoInertia) -> float:
    """Standard deviation of the squared anti-resonance."""

    def square(at: FloatArray) -> FloatArray:
        return np.array([_square(joint.with_vector(at))])

    count = len(NAMES)
    J = jacobian(square, joint.vector)
    return float(np.sqrt((J @ model.covariance[:count, :count] @ J.T)[0, 0]))


def _with_stiffness(joint: TwoInertia, k: float) -> TwoInertia:
    return replace(joint, gear_stiffness=k)


def _squared(hz: float) -> float:
    return (2.0 * np.pi * hz) ** 2


def _square(joint: TwoInertia) -> float:
    return _squared(anti_resonance(joint).frequency_hz)


def _responses_of(joint: int, found: Sequence[Level]) -> Figure:
    curves = []
    for level in found:
        name = f"{level.amplitude:g} V"
        if level.joint is None:
            curves += estimated_curve(name, level.state_space)
        else:
            curves += curve(name, response_of(level.joint))
    return bode(curves, f"Joint {joint}, {PAYLOAD} kg")


def _scatter(joint: int, found: Sequence[Level]) -> Figure:
    volt = np.array([level.amplitude for level in found])
    ends = volt[[0, -1]]
    low, high = found[0].bounds
    square = np.array([level.square for level in found])
    points = [
        Points("truth: mean slope", volt, np.array([level.true for level in found]), true=True)
    ]
    if found[0].joint is None:
        points.append(Points("state space", volt, square))
    else:
        deviation = np.array([level.deviation for level in found])
        beside = np.array([level.beside for level in found])
        points.append(Points("equations of motion", volt, square, deviation))
        points.append(Points("state space", volt, beside))
    points.append(Points("with K1", ends, np.full(2, low)))
    points.append(Points("with K3", ends, np.full(2, high)))
    caption = f"Joint {joint}, {PAYLOAD} kg; bars: 95 %"
    return scatter(points, "amplitude [V]", "squared anti-resonance [rad²/s²]", caption)


def _hz(mode: Mode | None) -> float:
    return float("nan") if mode is None else mode.frequency_hz
