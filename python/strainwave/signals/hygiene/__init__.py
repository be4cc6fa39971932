"""Logs -> logs without what is no measurement, and what to say of it, before any estimate.

Each kind of defect is one function from a record to a list of `Defect`. Short ones are bridged and
masked: no row of a fit rests on them. Where much of a channel is defective the record, or the
channel in it, is not used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from strainwave.domain import Diagnostic, Log
from strainwave.dynamics.arm import Arm
from strainwave.numerics.parallel import side_by_side
from strainwave.signals.hygiene import encoder_steps, flat_tops, frozen, mains_hum, spikes
from strainwave.signals.hygiene.defects import Defect, Detector, Kind
from strainwave.signals.hygiene.mending import mended
from strainwave.signals.hygiene.wording import hum_warnings, warnings_of

__all__ = ["DETECTORS", "Defect", "Kind", "defects", "without_defects"]

DETECTORS: Mapping[Kind, Detector] = {
    "spikes": spikes.detect,
    "frozen": frozen.detect,
    "encoder-steps": encoder_steps.detect,
    "flat-tops": flat_tops.detect,
    "mains-hum": mains_hum.detect,
}
"""All kinds that are looked for."""


def defects(logs: Sequence[Log], arm: Arm) -> list[list[Defect]]:
    """All defects of each record.

    Parameters
    ----------
    logs : sequence of Log
    arm : Arm

    Returns
    -------
    list of list of Defect
        One list per log; of hum that the records together confirm.
    """
    found = side_by_side([partial(_of_record, log, arm) for log in logs])
    hum = mains_hum.confirmed(logs, found)
    return [
        [each for each in own if each.kind != "mains-hum" or (each.channel, each.words) in hum]
        for own in found
    ]


def without_defects(
    logs: Sequence[Log], arm: Arm
) -> tuple[tuple[Log, ...], tuple[Diagnostic, ...]]:
    """Records fit for estimation, their defects bridged and masked.

    Parameters
    ----------
    logs : sequence of Log
    arm : Arm

    Returns
    -------
    tuple of Log
        Without those, and without the channels, of which much is defective.
    tuple of Diagnostic
        What was found where, and what to do.
    """
    kept: list[Log] = []
    warnings: list[Diagnostic] = []
    found = defects(logs, arm)
    for log, own in zip(logs, found, strict=True):
        usable, left_out = mended(log, arm, own)
        warnings += warnings_of(log, own, left_out, used=usable is not None)
        if usable is not None:
            kept.append(usable)
    return tuple(kept), (*warnings, *hum_warnings(logs, found))


def _of_record(log: Log, arm: Arm) -> list[Defect]:
    return [each for detect in DETECTORS.values() for each in detect(log, arm)]
