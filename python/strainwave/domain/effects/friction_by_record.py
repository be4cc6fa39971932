"""Friction by record, (S25): Coulomb friction is (1 + phi_r) f_M in record r."""

from __future__ import annotations

from strainwave.domain.effects.interface import Input, KnownJoint, RecordEffect, Values

_COULOMB, _CHANGE = "motor_coulomb_friction", "friction_change"
_TYPICAL_CHANGE = 0.25  # grease that warms up by 10 K


class FrictionByRecord(RecordEffect):
    """Grease warms up as the joint works."""

    name = "friction-by-record"
    sizes = (_CHANGE,)
    by_record = True
    description = "Coulomb friction that differs from record to record"
    consequence = (
        "friction is an average over the records, and its error in each record biases inertias"
    )
    experiment = "repeat the first record at the end of the session, and compare the voltages"
    record = "several records of this joint's motion"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same for every joint."""
        return {_CHANGE: _TYPICAL_CHANGE}

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Coulomb friction times (1 + phi_r)."""
        friction, factor = values[_COULOMB], 1.0 + values[_CHANGE]
        slopes = {_COULOMB: factor, _CHANGE: friction}
        return (Input(_COULOMB, factor * friction, slopes),)
