"""Single records that a fit does not describe.

Whether a motor breaks away from stiction has no derivative. If it sticks in the simulation of a
record and slides in the log, or the reverse, a search may end far from the minimum, to which the
other records lead.
"""

from __future__ import annotations

import numpy as np

from strainwave.domain.arm_model import MAX_RESIDUAL_NOISE
from strainwave.domain.verdict import MAX_RELATIVE_RESIDUAL
from strainwave.identification.whole_arm.search.fit import Fit

_MAX_SHARE = 0.25  # of the records: if more are not described, the model is wrong


def find_undescribed(fit: Fit) -> list[int]:
    """Indices of records with residuals that are large relative to a channel and to its noise."""
    undescribed = []
    for k, (record, rows) in enumerate(
        zip(fit.objective.records, fit.objective.rows(fit.z), strict=True)
    ):
        size = np.sqrt(np.mean(rows.errors**2, axis=0))
        signal = np.std(record.measured, axis=0)
        is_large = (size > MAX_RELATIVE_RESIDUAL * signal) & (
            size > MAX_RESIDUAL_NOISE * record.noise
        )
        if is_large.any():
            undescribed.append(k)
    return undescribed


def are_exceptions(undescribed: list[int], fit: Fit) -> bool:
    """Whether some, but few, records are not described."""
    return 0 < len(undescribed) <= _MAX_SHARE * len(fit.objective.records)
