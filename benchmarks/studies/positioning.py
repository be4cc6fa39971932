"""A published two-inertia benchmark: `python -m benchmarks.studies.positioning`.

MATLAB's example "Robust Tuning of Positioning System" tunes a controller of a motor and a load on
an elastic shaft for a box of parameters: J1 = 1e-6 and J2 = 1.15e-7 kg m^2, stiffness 0.013 N m/rad
within 25 %, damping of the shaft 5e-7 N m s/rad within 50 %, and viscous friction 1e-6 N m s/rad on
both sides. The load must reach a step within 0.5 s for the whole box.

The plants are the middle of the box, its corners, and draws within it. Printed are the settling
time of the load, the overshoot and the smallest margins.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from strainwave.domain import ArmDescription, Joint, Servo, Study
from strainwave.domain.keys import Values
from strainwave.export.source import IdentifiedArm
from strainwave.tune.cascade_tuning import Loops, tune_cascades
from strainwave.tune.closed_loop import Clock, Steps, close
from strainwave.tune.margins import Margins, Requirements
from strainwave.tune.plants import Condition, plants_of

REQUIRED_SECONDS = 0.5
"""Settling time of the published example."""

_MIDDLE = {
    "motor_inertia": 1e-6,
    "link_inertia": 1.15e-7,
    "gear_stiffness": 0.013,
    "gear_damping": 5e-7,
    "motor_viscous_friction": 1e-6,
    "link_viscous_friction": 1e-6,
}
_SPREADS = {"gear_stiffness": 0.25, "gear_damping": 0.5}
_PERIOD, _DELAY = 1e-3, 5e-4  # [s]; the example is continuous
_TORQUE = 0.01  # [N m] of the motor


def box(draws: int, seed: int = 0) -> list[Values]:
    """The middle of the box, its corners, and draws within it."""
    rng = np.random.default_rng(seed)
    corners = product((-1.0, 1.0), repeat=len(_SPREADS))
    shares = [np.zeros(len(_SPREADS)), *corners, *rng.uniform(-1.0, 1.0, (draws, len(_SPREADS)))]
    plants = []
    for share in shares:
        scales = dict(zip(_SPREADS, share, strict=True))
        factors = {name: 1.0 + _SPREADS[name] * x for name, x in scales.items()}
        plant: Values = {}
        for name, value in _MIDDLE.items():
            plant[name, 1] = value * float(factors.get(name, 1.0))
        plants.append(plant)
    return plants


@dataclass(frozen=True, slots=True, eq=False)
class Positioning:
    """A servo for the whole box."""

    steps: Steps  # of the load
    margins: Margins


def design(draws: int) -> Positioning:
    """Tune the servo for all plants of the box."""
    servo = Servo("pi-velocity", period=_PERIOD, kp=(1.0,), ki=(1.0,), limit=_TORQUE)
    arm = replace(ArmDescription("single-joint", (Joint("linear", 1.0),)), servo=servo)
    values = box(draws)
    identified = IdentifiedArm(Study(arm=arm, experiments=()), (), "the box")
    plants = plants_of(identified, values, [Condition(np.zeros(1))])
    clock = Clock(_PERIOD, _DELAY)
    loops = Loops.of(plants, clock)
    limits = np.array([_TORQUE])
    tuned, judged = tune_cascades(loops, Requirements(), resolutions=np.zeros(1), limits=limits)
    gains = [each for each, _ in tuned]
    loop = close(loops.sampled, [each.law() for each in gains], (0,))
    return Positioning(Steps.of(loop, gains)[0], judged[0][0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    options = parser.parse_args()
    result = design(options.draws)
    settling, margins = result.steps.settling, result.margins
    table = Table("of all plants", "least", "largest", box=None)
    table.add_row("settling within 2 %, s", f"{settling.min():.3f}", f"{settling.max():.3f}")
    table.add_row("overshoot, %", "", f"{100.0 * result.steps.overshoot.max():.2g}")
    table.add_row("gain margin, dB", f"{margins.gain_db.min():.3g}", "")
    table.add_row("phase margin, degrees", f"{margins.phase_deg.min():.3g}", "")
    table.add_row("modulus margin", f"{margins.modulus.min():.2g}", "")
    table.add_row("bandwidth, Hz", f"{margins.bandwidth_hz.min():.3g}", "")
    Console().print(f"{len(settling)} plants; required are {REQUIRED_SECONDS:g} s", table)


if __name__ == "__main__":
    main()
