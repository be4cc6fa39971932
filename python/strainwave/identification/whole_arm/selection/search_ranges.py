"""Search ranges of friction and damping, whose starting values may be far off."""

from __future__ import annotations

from strainwave.domain.ranges import physical_range
from strainwave.identification.whole_arm.inference.bounds import at_bounds
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import fine_search
from strainwave.identification.whole_arm.selection.candidate import Selection


def extend_ranges(fit: Fit, selection: Selection) -> Fit:
    """The fine fit with frictions and dampings at the end of their range centred in a new one."""
    bounded = [
        k
        for k, (unknown, at) in enumerate(zip(fit.space.unknowns, at_bounds(fit), strict=True))
        if at
        and not unknown.signed
        and unknown.limits is None
        and physical_range(unknown.name) == "non-negative"
    ]
    if not bounded or not fit.end.is_minimum:
        return fit
    selection.renew(fit)
    return fine_search(fit.with_unknowns(fit.space.recentre(fit.z, bounded)), selection.options)
