"""Measured machines: `python -m benchmarks.studies.measured FOLDER KINOVA`.

FOLDER has `emps`, `dfki-double-pendulum`, `ist-flexible-arm` and `staubli-tx40`, and KINOVA is a
study of a serial arm. Printed are, for each machine by the defaults, how many primary parameters
have a value, how many published or independent values lie inside the 95 % intervals, and the
held-out torque fits of strainwave and of a plain least squares with Pinocchio's regressor, as in
`serial_rigid`. Tables of single values follow: EMPS beside the published values (A. Janot, M.
Gautier, M. Brunot, nonlinearbenchmark.org, 2019); the torque fits of the DFKI double pendulum by
our model, fitted to one record, and by the published model 2.0, in the same band; and the
parameters of the IST joint with and without its torsion sensor. The overview has those from the
motor alone, beside the values with torsion.
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
from benchmarks.peers.rigid_chain import fit_plain
from benchmarks.studies.serial_rigid import (
    FIRST,
    SECOND,
    fit_study,
    held_out_fits,
    published_by_key,
    write_tx40,
)
from strainwave.domain import Identification, Parameter, RigidModel, Signals
from strainwave.domain.keys import Key
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

PRIMARY = (
    "alpha",
    "beta",
    "gamma",
    "gravity_torque",
    "rigid_inertia",
    "inertia",
    "link_",
    "grouped_link_",
    "motor_inertia",
    "total_viscous_friction",
    "motor_coulomb_friction",
    "gear_",
)
"""Starts of the names of primary parameters."""


def signals_of(folder: Path, *names: str) -> tuple[Arm, list[Signals]]:
    """The arm of a study, and the motor signals of some records."""
    study = read_study(folder / "study.toml")
    arm, records = Arm.of(study.arm), {e.name: e for e in study.experiments}
    return arm, [prepare_motor_signals(read_log(study, records[name]), arm) for name in names]


def published_dfki(folder: Path, like: RigidModel) -> RigidModel:
    """The published model, with the order and bandwidth of another model."""
    m, of = _dfki_constants(folder), published_parameters(folder)
    body = [of["rigid_inertia", 1], _rotor(m), *list(of.values())[1:]]
    friction = [m["b1"], m["cf1"], 0.0, m["b2"], m["cf2"], 0.0]
    return replace(like, solution=np.array(body + friction), friction_terms=())


def published_parameters(folder: Path) -> dict[Key, float]:
    """Published values of the DFKI double pendulum, under the names of a two-link arm."""
    m = _dfki_constants(folder)
    second = m["m2"] * m["g"]
    return {
        ("rigid_inertia", 1): m["I1"] + m["m2"] * m["l1"] ** 2 + _rotor(m) + m["Ir"],
        ("beta", None): m["I2"],
        ("gamma", None): m["m2"] * m["l1"] * m["r2"],
        ("gravity_torque_1", None): m["m1"] * m["g"] * m["r1"] + second * m["l1"],
        ("gravity_torque_2", None): second * m["r2"],
    }


def _dfki_constants(folder: Path) -> dict[str, float]:
    lines = (folder / "model_parameters.yml").read_text().splitlines()
    return {key: float(value) for key, value in (line.split(": ") for line in lines)}


def _rotor(m: dict[str, float]) -> float:
    """Rotor inertia behind the gear."""
    return m["Ir"] * m["gr"] ** 2


def _machines(folder: Path, kinova: Path, copy: Path) -> Iterator[Table]:
    """The overview of all machines, and their values beside published or independent ones."""
    overview = Table(
        "machine", "values", "inside", "held-out fit", "least squares", box=None, title="machines"
    )
    values = Table(
        "parameter", "estimate", "half-width", "other value", "difference", box=None, title="values"
    )
    halves = write_tx40(folder / "staubli-tx40", copy, {"motion": FIRST, "check": SECOND})
    ist, ist_motor = with_and_without_torsion(folder / "ist-flexible-arm")
    with_torsion = {p.key: p.value for p in ist.parameters if p.value is not None and p.std}
    emps, dfki = (folder / name for name in ("emps", "dfki-double-pendulum"))
    machines: tuple[tuple[str, Path | Identification, dict[Key, float], float | None], ...] = (
        ("EMPS", emps / "study.toml", {(name, 1): v for name, v in EMPS.items()}, 20.0),
        ("IST", ist_motor, {key: v for key, v in with_torsion.items() if key[0] in IST}, None),
        ("DFKI", dfki / "study.toml", published_parameters(dfki), 6.4),
        ("TX40", halves, published_by_key(folder / "staubli-tx40", halves), 10.0),
        ("Kinova", kinova / "study.toml", {}, 4.0),
    )
    for name, study, others, cutoff_hz in machines:
        result = identify(study) if isinstance(study, Path) else study
        estimates = {p.key: p for p in result.parameters if p.value is not None and p.ci95}
        n_inside = n_compared = 0
        for key, other in others.items():
            if key not in estimates:
                continue
            p = estimates[key]
            assert p.value is not None
            assert p.ci95 is not None
            n_compared += 1
            n_inside += p.ci95[0] <= other <= p.ci95[1]
            values.add_row(
                f"{name} {p.label}",
                f"{p.value:.4g}",
                f"{0.5 * (p.ci95[1] - p.ci95[0]):.2g}",
                f"{other:.4g}",
                f"{100.0 * abs(p.value / other - 1.0):.2f} %" if other else "",
            )
        fits = _held_out(study, cutoff_hz) if isinstance(study, Path) and cutoff_hz else ("", "")
        verdict = result.verdict
        decided = (*verdict.identified, *verdict.not_identified, *verdict.rejected)
        n = sum(key[0].startswith(PRIMARY) for key in decided)
        n_identified = sum(key[0].startswith(PRIMARY) for key in verdict.identified)
        inside = f"{n_inside} of {n_compared}" if n_compared else ""
        overview.add_row(name, f"{n_identified} of {n}", inside, *fits)
    yield overview
    yield values


def _held_out(path: Path, cutoff_hz: float) -> tuple[str, str]:
    """Median over the joints of the held-out torque fits: our model, plain least squares."""
    arm, model, motion, checks = fit_study(path)
    chain = Arm.of(replace(read_study(path).arm, kind="serial"))
    ours = held_out_fits(arm, model.solution, checks, cutoff_hz, model.friction_terms)
    plain = held_out_fits(chain, fit_plain(chain, motion, cutoff_hz), checks, cutoff_hz)
    return f"{np.median(ours):.1f} %", f"{np.median(plain):.1f} %"


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
    parser.add_argument("kinova", type=Path)
    arguments = parser.parse_args()
    folder, console = arguments.folder, Console()
    with TemporaryDirectory() as copy:
        for table in _machines(folder, arguments.kinova, Path(copy)):
            console.print(table)
    console.print(_dfki(folder / "dfki-double-pendulum"))
    console.print(_ist(folder / "ist-flexible-arm"))


if __name__ == "__main__":
    main()
