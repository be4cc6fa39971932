"""Detection and repair of defective samples before any estimate: logs -> logs and warnings.

Each kind of defect has one function from a record to a list of `Defect`. Short defects are
interpolated and masked, and no row of a fit uses them. If a large share of a channel is defective,
the record, or the channel in it, is excluded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from strainwave.domain import Diagnostic, Log
from strainwave.dynamics.arm import Arm
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.hygiene import encoder_steps, flat_tops, frozen, mains_hum, spikes
from strainwave.signals.hygiene.defects import (
    Defect,
    Detector,
    Kind,
    build_defect_warnings,
    build_hum_warnings,
)
from strainwave.signals.hygiene.repair import repair_record

__all__ = ["DETECTORS", "Defect", "Kind", "detect_defects", "repair_records"]

DETECTORS: Mapping[Kind, Detector] = {
    "spikes": spikes.detect,
    "frozen": frozen.detect,
    "encoder-steps": encoder_steps.detect,
    "flat-tops": flat_tops.detect,
    "mains-hum": mains_hum.detect,
}
"""Detector of each kind of defect."""


def detect_defects(logs: Sequence[Log], arm: Arm) -> list[list[Defect]]:
    """Detect all defects of each record; one list per log.

    Mains hum is included only if the records together confirm it.
    """
    detections = run_parallel([partial(_detect_in_record, log, arm) for log in logs])
    hum = mains_hum.confirm_hum(logs, detections)
    return [
        [
            defect
            for defect in record_defects
            if defect.kind != "mains-hum" or (defect.channel, defect.level) in hum
        ]
        for record_defects in detections
    ]


def repair_records(logs: Sequence[Log], arm: Arm) -> tuple[tuple[Log, ...], tuple[Diagnostic, ...]]:
    """Interpolate and mask the defects of all records.

    Returns the usable records, without channels and records that are defective to a large extent,
    and warnings that state record, channel, time and remedy.
    """
    usable_logs: list[Log] = []
    warnings: list[Diagnostic] = []
    detections = detect_defects(logs, arm)
    for log, record_defects in zip(logs, detections, strict=True):
        usable, excluded_channels = repair_record(log, arm, record_defects)
        warnings += build_defect_warnings(
            log, record_defects, excluded_channels, used=usable is not None
        )
        if usable is not None:
            usable_logs.append(usable)
    return tuple(usable_logs), (*warnings, *build_hum_warnings(logs, detections))


def _detect_in_record(log: Log, arm: Arm) -> list[Defect]:
    """Run all detectors on one record."""
    return [defect for detect in DETECTORS.values() for defect in detect(log, arm)]
