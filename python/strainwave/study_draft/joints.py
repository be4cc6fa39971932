"""Which joint and which quantity each column is of, by names first, by numbers where names fail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from strainwave.domain import FloatArray
from strainwave.study_draft.inspection import Record
from strainwave.study_draft.names import MOST_JOINTS, Named, parse
from strainwave.study_draft.signal_features import levels, relation

_DERIVATIVE = 0.95  # correlation above which a column without a name is another's derivative


def named_columns(
    record: Record, fullest: Record | None = None
) -> tuple[dict[str, Named], str, tuple[str, ...]]:
    """Every column with its quantity, and with its joint's number from 1.

    Parameters
    ----------
    record : Record
    fullest : Record, optional
        Of the same arm, which says what joints there are; the record itself if not given.

    Returns
    -------
    dict of str to Named
        Those beyond the joints that an arm here can have are left out.
    str
        What of the log is beyond such an arm; empty: nothing.
    tuple of str
        What else to say of it.
    """
    named = {name: parse(name) for name in record.columns}
    notes: list[str] = []
    if not any(each.quantity == "angle" for each in named.values()):
        named |= _by_nature(record, named)
        notes.append("no name gave an angle away: columns were assigned by their numbers alone")
    numbered = _numbered(named)
    joints = sorted({each.number or 1 for each in numbered.values() if each.quantity == "angle"})
    moving = [j for j in joints if _moves(fullest or record, numbered, j)] or joints
    chosen = sorted(moving[:MOST_JOINTS])
    limit = ""
    if len(joints) > len(chosen):
        limit = (
            f"these logs have angles of {len(joints)} joints; an arm of one joint, or of two links "
            "in one plane, is what can be identified so far. Taken as joint "
            f"{' and '.join(str(k) for k in range(1, len(chosen) + 1))}: "
            f"{', '.join(_called(numbered, j) for j in chosen)} of the logs. The result holds only "
            "if the other joints stand still in every record"
        )
    order = {joint: k for k, joint in enumerate(chosen, start=1)}
    for name, each in numbered.items():
        on_link = each.quantity in ("acceleration", "gyro", "deflection")
        if each.number is None and chosen and (on_link or len(chosen) == 1):
            # what sits on no joint by its name, sits on the last link
            placed = len(chosen) == 1
            numbered[name] = replace(each, number=chosen[-1], placed=placed)
    kept = {
        name: replace(each, number=order[each.number or 1])
        for name, each in numbered.items()
        if (each.number or 1) in order
    }
    return kept, limit, tuple(notes)


def _numbered(named: Mapping[str, Named]) -> dict[str, Named]:
    """Joints counted from 1, whatever the names do."""
    named = {name: replace(each, label=_label(each, named)) for name, each in named.items()}
    labels = list(dict.fromkeys(each.label for each in named.values() if each.label))
    from_zero = {_kin(name, each) for name, each in named.items() if each.number == 0}
    numbered = {}
    for name, each in named.items():
        if each.label:
            numbered[name] = replace(each, number=labels.index(each.label) + 1)
        elif each.number is not None and _kin(name, each) in from_zero:
            numbered[name] = replace(each, number=each.number + 1)
        else:
            numbered[name] = each
    return numbered


def _label(each: Named, named: Mapping[str, Named]) -> str:
    """A joint's name: in a table, a word that two angles or more differ by."""
    angles = [e for e in named.values() if e.quantity == "angle" and e.number is None]
    words = {e.word_left for e in angles if e.word_left}
    return each.label or (each.word_left if len(words) > 1 and each.word_left in words else "")


def _kin(name: str, each: Named) -> tuple[str, str | None]:
    """Columns that count alike: of one topic, or of one quantity in a table."""
    return (name.partition(".")[0] if name.startswith("/") else "", each.quantity)


def _moves(record: Record, named: Mapping[str, Named], joint: int) -> bool:
    return any(
        each.quantity == "angle"
        and (each.number or 1) == joint
        and name in record.columns
        and float(_span(record, name)) > 0.0
        for name, each in named.items()
    )


def _span(record: Record, name: str) -> float:
    values = record.columns[name]
    return float(values.max() - values.min())


def _called(named: Mapping[str, Named], joint: int) -> str:
    labels = [e.label for e in named.values() if e.label and e.number == joint]
    return f"{joint} ({labels[0]})" if labels else str(joint)


def _by_nature(record: Record, named: Mapping[str, Named]) -> dict[str, Named]:
    """Angles and velocities by the one being the other's integral; voltages by their levels."""
    unknown = [n for n, e in named.items() if e.quantity is None and _span(record, n) > 0.0]
    voltages = [n for n in unknown if levels(record.columns[n]) is not None]
    unknown = [n for n in unknown if n not in voltages]
    pairs = sorted(_pairs({n: record.columns[n] for n in unknown}, record.time), reverse=True)
    found: dict[str, Named] = {}
    for _, angle, velocity in pairs:
        if angle not in found and velocity not in found:
            found[angle], found[velocity] = Named("angle"), Named("velocity")
    for quantity in ("angle", "velocity"):
        of_it = [n for n in record.columns if n in found and found[n].quantity == quantity]
        for k, name in enumerate(of_it, start=1):
            found[name] = replace(found[name], number=k)
    joints = sum(each.quantity == "angle" for each in found.values())
    rest = [n for n in unknown if n not in found]
    inputs = voltages + (rest if len(voltages) + len(rest) == joints else [])
    inputs.sort(key=list(record.columns).index)
    for k, name in enumerate(inputs, start=1):
        found[name] = Named("voltage", k)
    return found


def _pairs(columns: Mapping[str, FloatArray], time: FloatArray) -> list[tuple[float, str, str]]:
    """(correlation, angle, velocity) of columns of which one is the other's derivative."""
    found = []
    for rate, speeds in columns.items():
        for value, angles in columns.items():
            if rate != value:
                r, ratio = relation(speeds, angles, time)
                if r > _DERIVATIVE and ratio > 0.0:
                    found.append((r, value, rate))
    return found
