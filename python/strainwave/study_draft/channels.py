"""Columns -> channels: which column feeds each, in which unit, why, and how sure that is."""

from __future__ import annotations

import numpy as np

from strainwave.records import FloatArray
from strainwave.study_draft.candidates import AGREES, Mapping
from strainwave.study_draft.inspection import Record
from strainwave.study_draft.joint_columns import JointColumns
from strainwave.study_draft.joints import named_columns
from strainwave.study_draft.signal_features import proportion, relation


def map_channels(record: Record) -> Mapping:
    """Guess every channel of the arm that a record is of.

    Parameters
    ----------
    record : Record
        With the most columns.

    Returns
    -------
    Mapping
    """
    named, limit, notes = named_columns(record)
    count = max((each.number or 1 for each in named.values()), default=1)
    mapping = Mapping(limit=limit, notes=notes)
    for joint in range(1, count + 1):
        of_it = {n: e for n, e in named.items() if (e.number or 1) == joint}
        JointColumns(record, of_it, joint, mapping).map()
    used = {guess.column for guess in mapping.guesses.values()}
    for name, values in record.columns.items():
        if name not in used and name not in mapping.unused:
            mapping.unused[name] = _unknown(record, values, mapping)
    return mapping


def _unknown(record: Record, values: FloatArray, mapping: Mapping) -> str:
    """What can be said of a column that no channel takes."""
    if np.ptp(values) == 0.0:
        return "it never changes"
    for guess in mapping.guesses.values():
        other = record.columns.get(guess.column)
        if other is None:
            continue
        r, ratio = proportion(other - other.mean(), values - values.mean())
        if r > 0.98:
            return f"it goes with {guess.column!r} (r = {r:.3f}, {ratio:.4g} times it)"
        if guess.channel.startswith("theta_m") and relation(values, other, record.time)[0] > AGREES:
            return f"its integral goes with {guess.column!r}: a velocity or its reference?"
    return "not understood"
