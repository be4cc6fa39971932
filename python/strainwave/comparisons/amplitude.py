"""What the gear's three slopes show over the amplitude of the PRBS: Figs. 14 and 15."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.comparisons.estimates import Estimate, estimate, estimated_curve
from strainwave.comparisons.rig import Rig, Run, slopes
from strainwave.physical import identify_joint
from strainwave.physical.two_inertia import NAMES, TwoInertia, anti_resonance, jacobian, joint_of
from strainwave.records import Comparison, FloatArray
from strainwave.report.curves import Points, bode, scatter
from strainwave.report.figures import Figure

PAYLOAD = 3  # [kg]
_STARTS = (0, 256, 512, 768)  # clocks of the PRBS that the records begin with
_SLIDES = 0.7  # share of the time below which a response is more of stiction than of the joint
_OUTSIDE = 2.0  # deviations that a value may lie beyond a bound


@dataclass(frozen=True, slots=True)
class Level:
    """One joint at one amplitude: several records of one period each."""

    amplitude: float
    state_space: Estimate  # all records at once
    squares: FloatArray  # [rad^2/s^2] of the anti-resonance, a state-space model a record
    physical: tuple[float, float]  # the same from the equations of motion, with its deviation
    true: float  # with the slope that the gear showed
    bounds: tuple[float, float]  # with K1 and with K3
    sliding: float  # share of the time in which the motor surely slides


def levels(rig: Rig, joint: int, amplitudes: Sequence[float], records: int) -> tuple[Level, ...]:
    """One joint at several amplitudes.

    Parameters
    ----------
    rig : Rig
    joint : int
    amplitudes : sequence of float [V]
    records : int
        How many at each, at most four.

    Returns
    -------
    tuple of Level
    """
    found = []
    for amplitude in amplitudes:
        rig.progress(f"joint {joint} at {amplitude:g} V")
        runs = [
            rig.prbs(joint, disks=PAYLOAD, amplitude=amplitude, periods=1, start=start)
            for start in _STARTS[:records]
        ]
        found.append(_level(rig, joint, amplitude, runs))
    return tuple(found)


def responses(swept: dict[int, tuple[Level, ...]]) -> Comparison:
    """Fig. 14: the response moves with the amplitude.

    Parameters
    ----------
    swept : dict
        Joint -> levels.

    Returns
    -------
    Comparison
    """
    values: dict[str, float] = {}
    plots, said, holds = [], [], True
    for joint, found in swept.items():
        curves = []
        for level in found:
            curves += estimated_curve(f"{level.amplitude:g} V", level.state_space)
            values[f"resonance_hz_{joint}_at_{level.amplitude:g}_v"] = _resonance_hz(level)
        plots.append(bode(curves, f"Joint {joint}, {PAYLOAD} kg"))
        hz = np.array([_resonance_hz(level) for level in found])
        rises = bool(np.all(np.diff(hz) > 0.0))
        holds &= bool(hz[-1] > hz[0])
        said.append(
            f"joint {joint}: resonance {hz[0]:.2f} to {hz[-1]:.2f} Hz"
            + ("" if rises else ", though not at every step")
        )
        values[f"sliding_share_{joint}_at_{found[0].amplitude:g}_v"] = found[0].sliding
    low, high = (swept[1][k].amplitude for k in (0, -1))
    return Comparison(
        figure=14,
        title="Frequency responses over the amplitude",
        claim="The stronger the input, the higher both joints ring: the gear stiffens.",
        holds=holds,
        values=values,
        message=f"{'; '.join(said)} from {low:g} to {high:g} V" + _stands(swept),
        plots=tuple(plots),
    )


def squares(swept: dict[int, tuple[Level, ...]]) -> Comparison:
    """Fig. 15: squared anti-resonance, proportional to the stiffness, over the amplitude.

    Parameters
    ----------
    swept : dict
        Joint -> levels.

    Returns
    -------
    Comparison
    """
    values: dict[str, float] = {}
    plots, said, holds = [], [], True
    for joint, found in swept.items():
        plots.append(_scatter(joint, found))
        square = np.array([level.physical for level in found])
        low, high = found[0].bounds
        rises = bool(np.all(np.diff(square[:, 0]) > 0.0))
        inside = bool(
            np.all(square[:, 0] > low - _OUTSIDE * square[:, 1])
            and np.all(square[:, 0] < high + _OUTSIDE * square[:, 1])
        )
        holds &= rises and inside
        share = float(found[-1].physical[0] / high)
        for level in found:
            volt = f"{joint}_at_{level.amplitude:g}_v"
            values[f"square_{volt}"], values[f"square_std_{volt}"] = level.physical
            values[f"pem_square_{volt}"] = float(np.mean(level.squares))
            values[f"true_square_{volt}"] = level.true
        values[f"share_of_k3_{joint}"] = share
        said.append(
            f"joint {joint}: {square[0, 0]:.0f} to {square[-1, 0]:.0f} rad²/s², "
            f"{'rising' if rises else 'not rising throughout'}, "
            f"{'between' if inside else 'not always between'} K1 ({low:.0f}) and K3 ({high:.0f}); "
            f"at {found[-1].amplitude:g} V it is {100.0 * share:.0f} % of K3's" + _below(found)
        )
    said.append(
        "the largest amplitude does not give K3, which would need the gear to stay beyond its "
        "second knee all the time: it gives a mean slope"
    )
    return Comparison(
        figure=15,
        title="Squared anti-resonance over the amplitude",
        claim="The equivalent stiffness rises with the amplitude and stays between the gear's "
        "softest and stiffest slope.",
        holds=holds,
        values=values,
        message="; ".join(said),
        plots=tuple(plots),
    )


def _stands(swept: dict[int, tuple[Level, ...]]) -> str:
    """Where friction, not the gear, shapes the response."""
    shares = [found[0].sliding for found in swept.values()]
    if min(shares) >= _SLIDES:
        return ""
    listed = " and ".join(f"{100.0 * share:.0f} %" for share in shares)
    return (
        f"; at {swept[1][0].amplitude:g} V the motors slide in only {listed} of the time, and "
        "stiction distorts the whole response"
    )


def _resonance_hz(level: Level) -> float:
    pole = level.state_space.resonance
    return float("nan") if pole is None else pole.frequency_hz


def _below(found: Sequence[Level]) -> str:
    """Where the state-space model alone leaves the gear's slopes."""
    low = found[0].bounds[0]
    out = [level for level in found if np.mean(level.squares) < 0.98 * low]
    if not out:
        return ""
    worst = min(out, key=lambda level: float(np.mean(level.squares)))
    return (
        f" (PEM alone falls {100.0 * (1.0 - np.mean(worst.squares) / low):.0f} % below K1 at "
        f"{worst.amplitude:g} V, where the motor often stands)"
    )


def _level(rig: Rig, joint: int, amplitude: float, runs: Sequence[Run]) -> Level:
    together = estimate(*(run.decoupled for run in runs))
    each = [estimate(run.decoupled, start=together.model) for run in runs]
    zeros = [e.anti_resonance for e in each]
    model = identify_joint(
        [(run.signals, run.decoupled) for run in runs], rig.rigid(PAYLOAD), rig.study
    )
    ratio = rig.study.joints[joint - 1].gear_ratio
    vector = np.array([model.values[name] for name in NAMES])
    count = len(NAMES)

    def square(at: FloatArray) -> FloatArray:
        return np.array([_square(joint_of(at, ratio))])

    J = jacobian(square, vector)
    deviation = float(np.sqrt((J @ model.covariance[:count, :count] @ J.T)[0, 0]))
    k1, _, k3 = slopes(runs[0].values, joint)
    truth = runs[0].truth
    low, high = (
        _square(truth.with_vector(np.where(np.arange(count) == 4, k, truth.vector)))
        for k in (k1, k3)
    )
    return Level(
        amplitude=amplitude,
        state_space=together,
        squares=np.array(
            [float("nan") if z is None else (2.0 * np.pi * z.frequency_hz) ** 2 for z in zeros]
        ),
        physical=(_square(joint_of(vector, ratio)), deviation),
        true=float(np.mean([_square(run.truth) for run in runs])),
        bounds=(low, high),
        sliding=float(np.mean([run.signals.sliding[:, joint - 1] != 0.0 for run in runs])),
    )


def _square(joint: TwoInertia) -> float:
    return (2.0 * np.pi * anti_resonance(joint).frequency_hz) ** 2


def _scatter(joint: int, found: Sequence[Level]) -> Figure:
    volt = np.array([level.amplitude for level in found])
    ends = volt[[0, -1]]
    pem = np.array([np.mean(level.squares) for level in found])
    spread = np.array(
        [np.std(level.squares, ddof=min(1, len(level.squares) - 1)) for level in found]
    )
    own = np.array([level.physical for level in found])
    low, high = found[0].bounds
    return scatter(
        [
            Points("truth: mean slope", volt, np.array([level.true for level in found]), true=True),
            Points("equations of motion", volt, own[:, 0], own[:, 1]),
            Points("state space (PEM)", volt, pem, spread),
            Points("with K1", ends, np.full(2, low)),
            Points("with K3", ends, np.full(2, high)),
        ],
        "amplitude [V]",
        "squared anti-resonance [rad²/s²]",
        f"Joint {joint}, {PAYLOAD} kg; bars: 95 %, of PEM from the scatter of the records",
    )
