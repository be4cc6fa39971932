"""Measured machines: `python -m benchmarks.studies.measured FOLDER`.

FOLDER has `emps`, `dfki-double-pendulum` and `ist-flexible-arm`, each with a study. Printed are the
EMPS parameters with the published ones (A. Janot, M. Gautier, M. Brunot, nonlinearbenchmark.org,
2019); the torque fits of the DFKI double pendulum by our model, fitted to one record, and by the
published model 2.0, in the same band; and the parameters of the IST joint with and without its
torsion sensor.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from strainwave.domain import Identification, Parameter, RigidModel, Signals
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import band_fit
from strainwave.identification import rigid
from strainwave.io.logs import read_log
from strainwave.io.study import read_study
from strainwave.pipeline import identify
from strainwave.signals.motor import prepare_motor_signals

EMPS = {
    "inertia": 95.1089,
    "motor_viscous_friction": 203.5034,
    "motor_coulomb_friction": 20.3935,
    "friction_offset": -3.1648,
}
"""Published parameters by IDIM-LS."""
IST = (
    "motor_inertia",
    "link_inertia",
    "gear_stiffness",
    "gear_damping",
    "motor_coulomb_friction",
    "total_viscous_friction",
)


def signals_of(folder: Path, *names: str) -> tuple[Arm, list[Signals]]:
    """The arm of a study, and the motor signals of some records."""
    study = read_study(folder / "study.toml")
    arm, records = Arm.of(study.arm), {e.name: e for e in study.experiments}
    return arm, [prepare_motor_signals(read_log(study, records[name]), arm) for name in names]


def published_dfki(folder: Path, like: RigidModel) -> RigidModel:
    """The published model, with the order and bandwidth of another model."""
    lines = (folder / "model_parameters.yml").read_text().splitlines()
    m = {key: float(value) for key, value in (line.split(": ") for line in lines)}
    rotor = m["Ir"] * m["gr"] ** 2
    first = m["I1"] + m["m2"] * m["l1"] ** 2 + rotor + m["Ir"]
    gravity_2 = m["m2"] * m["g"] * m["r2"]
    gravity_1 = m["m1"] * m["g"] * m["r1"] + m["m2"] * m["g"] * m["l1"]
    body = [first, rotor, m["I2"], m["m2"] * m["l1"] * m["r2"], gravity_1, gravity_2]
    friction = [m["b1"], m["cf1"], 0.0, m["b2"], m["cf2"], 0.0]
    return replace(like, solution=np.array(body + friction), friction_terms=())


def _emps(folder: Path) -> Table:
    table = Table("parameter", "estimate", "published", "difference", box=None, title="EMPS")
    arm, motion = signals_of(folder, "estimation")
    model = rigid.fit_rigid(motion, arm)
    for name, published in EMPS.items():
        value = model.value(name, 1) or np.nan
        difference = f"{100.0 * abs(value / published - 1.0):.2f} %"
        table.add_row(name, f"{value:.6g}", f"{published:.6g}", difference)
    return table


def _dfki(folder: Path) -> Table:
    heads = (f"joint {i}, {name}" for i in (1, 2) for name in ("Strainwave", "published model"))
    table = Table("record", *heads, box=None, title="DFKI")
    arm, (fitted, *checks) = signals_of(folder, "long", "a", "b")
    model = rigid.fit_rigid([fitted], arm)
    models = model, published_dfki(folder, model)
    for record in (fitted, *checks):
        fits = np.column_stack(
            [
                band_fit(arm, each.solution, record, model.bandwidth_hz, each.friction_terms)
                for each in models
            ]
        )
        table.add_row(record.experiment.name, *(f"{fit:.1f} %" for fit in fits.ravel()))
    return table


def _ist(folder: Path) -> Table:
    heads = (f"{name}{end}" for name in ("with torsion", "motor alone") for end in ("", ", std"))
    table = Table("parameter", *heads, box=None, title="IST")
    results = list(with_and_without_torsion(folder))
    for name in IST:
        parameters = (whole_arm_parameter(result, name) for result in results)
        numbers = (x for p in parameters for x in (p.value, p.std))
        table.add_row(name, *("" if x is None else f"{x:.3g}" for x in numbers))
    return table


def with_and_without_torsion(folder: Path) -> Iterator[Identification]:
    """Results of the IST joint from all channels, and from the motor channels alone."""
    yield identify(folder / "study.toml")
    lines = (folder / "study.toml").read_text().splitlines()
    with TemporaryDirectory() as copy:
        for name in ("PRBS.csv", "square.csv"):
            (Path(copy) / name).symlink_to((folder / name).resolve())
        motor_lines = [line for line in lines if not line.startswith("deflection1")]
        (Path(copy) / "study.toml").write_text("\n".join(motor_lines) + "\n")
        yield identify(Path(copy) / "study.toml")


def whole_arm_parameter(result: Identification, name: str) -> Parameter:
    """A parameter of the whole-arm fit."""
    assert result.whole_arm is not None
    return next(p for p in result.whole_arm.parameters if p.name == name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    console = Console()
    console.print(_emps(folder / "emps"))
    console.print(_dfki(folder / "dfki-double-pendulum"))
    console.print(_ist(folder / "ist-flexible-arm"))


if __name__ == "__main__":
    main()
