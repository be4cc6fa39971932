"""The rigid part of an arm as SDF, for Gazebo and for Drake."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from strainwave.export import completion, source
from strainwave.export.read_back_links import by_drake
from strainwave.export.rigid_links import held_parts, lost_shapes, rigid_links
from strainwave.export.source import Export, IdentifiedArm, numbers
from strainwave.io.templates import fill_text


def to_sdf(arm: IdentifiedArm) -> Export:
    """SDF for Gazebo: the links include the rotors; servos are plugins for position control."""
    return _model(arm, is_drake=False)


def to_drake(arm: IdentifiedArm) -> Export:
    """SDF for Drake: rotors and gains of servos have elements of their own.

    Drake ignores dry friction of joints.
    """
    return _model(arm, is_drake=True)


def _model(arm: IdentifiedArm, *, is_drake: bool) -> Export:
    links, notes = rigid_links(arm, has_rotors=is_drake)
    held = held_parts(arm) - ({"motor_coulomb_friction"} if is_drake else set())
    losses = source.losses(arm, held) + lost_shapes(arm)
    notes = (*notes, *source.loss_note(losses))
    text = fill_text(
        Path(__file__).with_name("arm.sdf.j2"),
        links=links,
        notes=notes,
        is_drake=is_drake,
        comment_text=source.comment_text,
        escaped=escape,
        numbers=numbers,
        quoted=quoteattr,
        sentence_of=source.sentence_of,
        zip=zip,
    )
    check = partial(by_drake, links=links, has_rotors=is_drake)
    warnings = arm.assumed() + completion.gravity_warnings(arm)
    return Export(text.encode(), warnings, notes, losses, check)
