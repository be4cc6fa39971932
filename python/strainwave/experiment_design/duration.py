"""Records of a design within the time that a session on the rig has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from strainwave.errors import InvalidInput
from strainwave.experiment_design.plan import Planned
from strainwave.experiment_design.voltages import MIN_PERIODS, SETTLING_PERIODS


def fit_duration(
    records: Sequence[Planned], longest: float
) -> tuple[tuple[Planned, ...], tuple[str, ...]]:
    """Records of at most `longest` [s] together, and the names of omitted ones.

    Sweeps are omitted first, the last joint's first; then the longest PRBS loses periods, down to
    those that separate noise from distortion. Raises `InvalidInput` if that does not suffice.
    """
    kept, omitted = list(records), list[str]()
    sweeps = [record for record in records if record.experiment.use == "sweep"]
    while (total := sum(record.duration for record in kept)) > longest:
        if sweeps:
            sweep = sweeps.pop()
            kept.remove(sweep)
            omitted.append(sweep.experiment.name)
            continue
        spare = [k for k, record in enumerate(kept) if _n_spare_periods(record) > 0]
        if not spare:
            raise InvalidInput(
                f"the shortest plan takes {total / 60.0:.1f} minutes",
                where="--minutes",
                remedy="allow at least as much",
            )
        k = max(spare, key=lambda k: kept[k].duration)
        kept[k] = _without_last_period(kept[k])
    return tuple(kept), tuple(omitted)


def _n_spare_periods(record: Planned) -> int:
    """Periods of a PRBS beyond those that it needs."""
    prbs = record.experiment.prbs
    return prbs.periods - SETTLING_PERIODS - MIN_PERIODS if prbs else 0


def _without_last_period(record: Planned) -> Planned:
    """The record with a period less, whose predicted motion is part of that of the record."""
    experiment, drive = record.experiment, record.drive
    assert experiment.prbs is not None
    periods = experiment.prbs.periods
    n = len(drive.voltage) * (periods - 1) // periods
    return replace(
        record,
        experiment=replace(experiment, prbs=replace(experiment.prbs, periods=periods - 1)),
        drive=replace(drive, voltage=drive.voltage[:n], reference=drive.reference[:n]),
        reasons=(*record.reasons, f"{periods - 1} periods for the duration that is allowed"),
    )
