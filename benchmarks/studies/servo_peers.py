"""Servos fitted by mujoco.sysid as well: `python -m benchmarks.studies.servo_peers --servos 4`.

Rigs of `drawn_servos` that the model of mujoco.sysid has: one joint, a torque as output, no effect
of the gear, a known gain or weight. Its starts are within a factor of 2 of the true values;
strainwave has none. Skipped without the packages of `mujoco[sysid]`.
"""

from __future__ import annotations

import argparse
import time
from itertools import count, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.console import Console, share_of
from benchmarks.families.servos import ServoRig, draw_servo, true_values, write_rig
from benchmarks.peers.servo_sysid import fit_by_sysid
from benchmarks.studies.drawn_servos import identify

_START = 2.0  # largest factor of the peer's starting values
_NAMES = {
    "inertia": 1,
    "gravity_torque_1": None,
    "motor_coulomb_friction": 1,
    "servo_damping": 1,
    "servo_kp": 1,
    "torque_limit": 1,
    "servo_delay": None,
}
Row = dict[str, tuple[float, float]]  # error and half-width of the interval, relative


def _is_comparable(rig: ServoRig) -> bool:
    is_simple = rig.output == "torque" and rig.gear == "plain" and len(rig.links) == 1
    return is_simple and rig.flavour in ("kp", "loaded")


def _ours(result: dict[str, Any], true: dict[str, float]) -> Row:
    found = {p["name"]: p for p in result["parameters"] if p["value"] is not None and p["ci95"]}
    return {
        name: (
            found[name]["value"] / true[name] - 1.0,
            0.5 * (found[name]["ci95"][1] - found[name]["ci95"][0]) / true[name],
        )
        for name in _NAMES
        if name in found and found[name].get("per") is None
    }


def _theirs(rig: ServoRig, folder: Path, true: dict[str, float]) -> Row:
    rng = np.random.default_rng([3, rig.seed])
    start = {name: x * _START ** float(rng.uniform(-1.0, 1.0)) for name, x in true.items()}
    start["armature"] = start["inertia"]
    if rig.states_scale:
        start["servo_kp"] = true["servo_kp"]
    values, half = fit_by_sysid(rig, folder, start)
    return {n: (values[n] / true[n] - 1.0, half[n] / true[n]) for n in _NAMES if n in half}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--servos", type=int, default=4)
    options, console = parser.parse_args(), Console(width=120)
    try:
        from mujoco import sysid

        sysid.optimize  # noqa: B018 its package is empty where a dependency is missing
    except (ImportError, AttributeError):
        console.print("skipped: mujoco.sysid needs pip install 'mujoco[sysid]>=3.5'")
        return
    rows: list[tuple[Row, Row]] = []
    seconds = np.zeros(2)
    for rig in islice(filter(_is_comparable, map(draw_servo, count())), options.servos):
        values = true_values(rig)
        true = {name: values[name, joint] for name, joint in _NAMES.items()}
        with TemporaryDirectory() as name:
            write_rig(rig, Path(name))
            begin = time.perf_counter()
            result, message = identify(Path(name) / "study.toml")
            seconds[0] += time.perf_counter() - begin
            if result is None:
                console.print(f"servo {rig.seed}: {message}")
                continue
            begin = time.perf_counter()
            rows.append((_ours(result, true), _theirs(rig, Path(name), true)))
            seconds[1] += time.perf_counter() - begin
    heads = (f"{who}{what}" for who in ("", "sysid: ") for what in ("median error", "inside"))
    table = Table("parameter", *heads, box=None)
    for name in _NAMES:
        cells = []
        for tool in (0, 1):
            values_of = [row[tool][name] for row in rows if name in row[tool]]
            errors = [100.0 * abs(error) for error, _ in values_of]
            cells.append(f"{np.median(errors):.2g} %" if errors else "")
            cells.append(share_of([abs(error) <= half for error, half in values_of]))
        table.add_row(name, *cells)
    console.print(table)
    console.print(f"time of strainwave {seconds[0]:.0f} s, of mujoco.sysid {seconds[1]:.0f} s")


if __name__ == "__main__":
    main()
