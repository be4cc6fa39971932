"""Inputs without a fault: windows, rates, noise, fewer records and channels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.studies.faults.inputs import Case, Columns, Input
from strainwave.domain import Correction
from strainwave.domain.study import Experiment

_REST = 5e-3  # largest range [rad] of the link angle of a joint that its servo holds


def clean_variants(given: Input, rng: np.random.Generator) -> Iterator[Case]:
    """Inputs without a fault."""
    yield Case("as recorded", given)
    slow = given.motions

    def every(step: int) -> Callable[[Columns], Columns]:
        return lambda table: {k: v[::step] for k, v in table.items()}

    for first, last in ((0.0, 0.6), (0.3, 1.0), (0.1, 0.9)):
        yield Case(
            f"window {first:g} to {last:g}", given.changed(partial(_window, first, last), slow)
        )
    for rate in (500, 200, 100, 50):
        step = round(1.0 / (rate * np.median(np.diff(given.tables[slow[0]]["t"]))))
        if step > 1:
            yield Case(f"{rate} Hz", given.changed(every(step), slow))

    def thinned(table: Columns) -> Columns:
        kept = rng.random(len(table["t"])) > 0.05
        kept[[0, -1]] = True
        return {k: v[kept] for k, v in table.items()}

    yield Case("5 % of samples removed", given.changed(thinned, slow))

    def noisy(table: Columns) -> Columns:
        return {
            k: v
            if k == "t"
            else v + np.std(np.diff(v)) / np.sqrt(2.0) * rng.standard_normal(len(v)) * 0.5
            for k, v in table.items()
        }

    yield Case("noise", given.changed(noisy, slow))

    def coarse(table: Columns) -> Columns:
        return {
            k: v if k == "t" or not np.ptp(v) else np.round(v / (s := np.ptp(v) / 4096)) * s
            for k, v in table.items()
        }

    yield Case("12 bit", given.changed(coarse, slow))
    names = list(given.tables)
    for name in dict.fromkeys(names[:2] + names[-2:]):
        if sum(other in slow for other in given.tables if other != name):
            yield Case(f"without {name}", given.without_records(name))
    yield from _other_rigs(given)
    if given.study.arm.kind == "serial":
        moved = Correction("joint", "1", "origin.xyz", (0.2, -0.1, 0.5))
        yield Case("another URDF origin", given.stated(moved))


def _window(first: float, last: float, table: Columns) -> Columns:
    n = len(table["t"])
    return {k: v[int(first * n) : int(last * n)] for k, v in table.items()}


def _other_rigs(given: Input) -> Iterator[Case]:
    """Inputs without a fault: other channels, one record, joints at rest."""
    first = given.motions[0]
    yield Case("motors only", given.motors_only())
    if given.of_kinds(("u",)):
        yield Case("torques for voltages", given.with_torques())
    alone = given.without_records(*(set(given.tables) - {first}))
    yield Case("one record", alone)
    yield Case("window of one record", alone.changed(partial(_window, 0.3, 0.8)))
    resting = {e.name: _resting(given, e) for e in given.study.experiments}
    if any(resting.values()):
        tables = {name: _at_two_levels(given.tables[name], resting[name]) for name in given.tables}
        yield Case("two levels at rest", replace(given, tables=tables))


def _resting(given: Input, record: Experiment) -> list[str]:
    """Efforts of the joints that rest in a record."""
    table = given.tables[record.name]
    return [
        effort
        for i, joint in enumerate(given.study.arm.joints, start=1)
        for effort in given.efforts(i)
        if record.joint != i and np.ptp(joint.gear_ratio * table[f"theta_m{i}"]) < _REST
    ]


def _at_two_levels(table: Columns, efforts: Sequence[str]) -> Columns:
    """Efforts as a converter with a coarse step logs them."""
    columns = dict(table)
    for name in efforts:
        middle, step = np.median(table[name]), np.std(table[name])
        columns[name] = middle + step * np.where(table[name] > middle, 1.0, -1.0)
    return columns
